#include "core/photometry/vignetting.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace omnihdr::vignetting_test {
namespace {

constexpr int kWidth = 320;
constexpr int kHeight = 240;
const Eigen::Vector2d kCentre(166.0, 115.0);
const Vignetting kTruth{{-0.32, 0.10, -0.12}};

struct Field {
  double level = 180.0;
  double tilt = 0.0;  // share of the light that is lost from left to right
  double noise = 1.5;
  double texture = 0.0;
  BayerOrder bayer = BayerOrder::kNone;
};

SensorPicture Render(const Field& field, const Vignetting& falloff, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0.0, 1.0);
  const double half = 0.5 * std::hypot(kWidth, kHeight);
  const std::array<double, 3> gain = {0.7, 1.0, 0.85};
  SensorPicture picture;
  picture.bayer = field.bayer;
  picture.values = Image<float>(kWidth, kHeight, field.bayer == BayerOrder::kNone ? 3 : 1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double rho = (Eigen::Vector2d(x + 0.5, y + 0.5) - kCentre).norm() / half;
      double light = field.level * falloff.At(rho) * (1.0 - field.tilt * x / kWidth);
      light *= 1.0 + field.texture * std::sin(0.05 * x) * std::cos(0.06 * y);
      for (int c = 0; c < picture.values.channels(); ++c) {
        const int k = picture.values.channels() == 3 ? c : BayerChannel(field.bayer, x, y);
        const double v = light * gain[static_cast<std::size_t>(k)] + field.noise * normal(random);
        picture.values.at(x, y, c) = static_cast<float>(std::lround(std::clamp(v, 0.0, 255.0)));
      }
    }
  }
  return picture;
}

double WorstError(const Vignetting& fit, const Vignetting& truth, double rho_max) {
  double worst = 0.0;
  for (double rho = 0.0; rho <= rho_max; rho += 0.02) {
    worst = std::max(worst, std::abs(fit.At(rho) / truth.At(rho) - 1.0));
  }
  return worst;
}

Result<VignettingFit> Fit(const std::vector<SensorPicture>& pictures,
                          ImageView<const std::uint8_t> mask = {}, double largest_rho = 1.07) {
  std::vector<FlatField> fields;
  for (const SensorPicture& picture : pictures) fields.push_back({&picture, mask});
  return FitFlatFields(fields, kCentre, largest_rho, *Response::Linear(), {});
}

std::vector<SensorPicture> One(SensorPicture picture) {
  std::vector<SensorPicture> pictures;
  pictures.push_back(std::move(picture));
  return pictures;
}

TEST(FlatField, GivesTheFalloffBackToOnePercent) {
  for (const BayerOrder bayer : {BayerOrder::kNone, BayerOrder::kRggb}) {
    const Result<VignettingFit> fit = Fit(One(Render({.bayer = bayer}, kTruth, 1)));
    ASSERT_TRUE(fit) << fit.error().message;
    EXPECT_LT(WorstError(fit->vignetting, kTruth, fit->rho_max), 0.01);
    EXPECT_LT(fit->error, 0.01);
    EXPECT_GT(fit->error, 0.0);
    EXPECT_NEAR(fit->at_edge, kTruth.At(fit->rho_max), 0.01);
  }
}

TEST(FlatField, LightThatFallsToOneSideIsNotTakenForFalloff) {
  std::vector<SensorPicture> pictures;
  pictures.push_back(Render({.tilt = 0.15}, kTruth, 1));
  pictures.push_back(Render({.level = 140.0, .tilt = -0.2}, kTruth, 2));
  const Result<VignettingFit> fit = Fit(pictures);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_LT(WorstError(fit->vignetting, kTruth, fit->rho_max), 0.01);
}

TEST(FlatField, DustIsBounded) {
  SensorPicture picture = Render({}, kTruth, 1);
  std::mt19937 random(5);
  for (int i = 0; i < 60; ++i) {
    const int x0 = static_cast<int>(random() % (kWidth - 8));
    const int y0 = static_cast<int>(random() % (kHeight - 8));
    for (int y = y0; y < y0 + 8; ++y) {
      for (int x = x0; x < x0 + 8; ++x) {
        for (int c = 0; c < 3; ++c) picture.values.at(x, y, c) *= 0.7F;
      }
    }
  }
  const Result<VignettingFit> fit = Fit(One(std::move(picture)));
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_LT(WorstError(fit->vignetting, kTruth, fit->rho_max), 0.01);
}

TEST(FlatField, RefusesWhatDoesNotReachTheEdge) {
  Image<std::uint8_t> mask(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      mask.at(x, y) = std::hypot(x - kCentre.x(), y - kCentre.y()) < 120.0 ? 255 : 0;
    }
  }
  const Result<VignettingFit> fit = Fit(One(Render({}, kTruth, 1)), mask.view());
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().message.find("half diagonal"), std::string::npos);
}

TEST(FlatField, RefusesAHoleInTheRadii) {
  Image<std::uint8_t> mask(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double r = std::hypot(x - kCentre.x(), y - kCentre.y());
      mask.at(x, y) = r < 60.0 || r > 110.0 ? 255 : 0;
    }
  }
  const Result<VignettingFit> fit = Fit(One(Render({}, kTruth, 1)), mask.view());
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().message.find("no usable samples between"), std::string::npos);
}

TEST(FlatField, RefusesAFalloffThatRises) {
  const Result<VignettingFit> fit = Fit(One(Render({.level = 120.0}, {{0.3, 0.0, 0.0}}, 1)));
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().message.find("rises"), std::string::npos);
}

TEST(FlatField, RefusesAFieldThatIsNotEven) {
  const Result<VignettingFit> fit = Fit(One(Render({.texture = 0.3}, kTruth, 1)));
  ASSERT_FALSE(fit);
}

TEST(FlatField, RefusesAClippedPicture) {
  const Result<VignettingFit> fit = Fit(One(Render({.level = 1000.0}, kTruth, 1)));
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().message.find("clipped"), std::string::npos);
}

// Sensors that see random directions at random radii.
struct Overlap {
  std::vector<Vignetting> falloffs;
  std::vector<std::array<double, 3>> sensitivity = {
      {1.0, 1.0, 1.0}, {1.1, 0.95, 1.05}, {0.9, 1.02, 0.97}};
  double noise = 0.01;
  double outliers = 0.0;
  bool equal_radii = false;
};

std::vector<OverlapSample> Samples(const Overlap& overlap, int directions) {
  std::mt19937 random(17);
  std::normal_distribution<double> normal(0.0, 1.0);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::vector<OverlapSample> samples;
  for (int d = 0; d < directions; ++d) {
    std::array<double, 3> light{};
    for (double& l : light) l = std::exp(normal(random));
    const int first = static_cast<int>(random() % 3);
    const double shared_rho = unit(random);
    for (int k = 0; k < 2; ++k) {
      const int s = (first + k) % 3;
      OverlapSample sample;
      sample.direction = d;
      sample.sensor = s;
      sample.rho = overlap.equal_radii ? shared_rho : unit(random);
      const bool wrong = unit(random) < overlap.outliers;
      for (std::size_t c = 0; c < 3; ++c) {
        sample.exposure[c] =
            light[c] * overlap.falloffs[static_cast<std::size_t>(s)].At(sample.rho) *
            overlap.sensitivity[static_cast<std::size_t>(s)][c] *
            std::exp(overlap.noise * normal(random) + (wrong ? normal(random) : 0.0));
      }
      samples.push_back(sample);
    }
  }
  return samples;
}

const std::vector<std::string> kNames = {"a", "b", "c"};
const std::vector<double> kReach = {1.0, 1.0, 1.0};

TEST(Overlaps, GiveFalloffAndGainsBackToOnePercentThroughOutliers) {
  const Overlap overlap{.falloffs = {kTruth, kTruth, kTruth}, .outliers = 0.15};
  const Result<OverlapFit> fit = FitOverlaps(Samples(overlap, 4000), kNames, kReach, {});
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_LT(WorstError(fit->sensors[0].vignetting, kTruth, 1.0), 0.01);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::size_t s = 1; s < 3; ++s) {
      const double expected = overlap.sensitivity[0][c] / overlap.sensitivity[s][c];
      EXPECT_NEAR(fit->gain[s][c] / fit->gain[0][c], expected, 0.01 * expected);
    }
    EXPECT_NEAR(fit->gain[0][c] * fit->gain[1][c] * fit->gain[2][c], 1.0, 1e-6);
  }
  EXPECT_LT(fit->difference_after, 0.25 * fit->difference_before);
  EXPECT_LT(fit->sensors[0].error, 0.01);
}

TEST(Overlaps, LensesThatDifferGetTheirOwnFalloff) {
  const std::vector<Vignetting> falloffs = {kTruth, {{-0.5, 0.1, 0.0}}, {{-0.1, -0.1, 0.0}}};
  OverlapOptions options;
  options.shared = false;
  const Result<OverlapFit> fit =
      FitOverlaps(Samples({.falloffs = falloffs}, 6000), kNames, kReach, options);
  ASSERT_TRUE(fit) << fit.error().message;
  for (std::size_t s = 0; s < 3; ++s) {
    EXPECT_LT(WorstError(fit->sensors[s].vignetting, falloffs[s], 1.0), 0.015) << s;
  }
}

TEST(Overlaps, EqualRadiiSayNothingAboutASharedFalloffAndAreRefused) {
  const Overlap overlap{.falloffs = {kTruth, kTruth, kTruth}, .equal_radii = true};
  const Result<OverlapFit> fit = FitOverlaps(Samples(overlap, 2000), kNames, kReach, {});
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().message.find("head turned"), std::string::npos) << fit.error().message;
}

TEST(Overlaps, ASensorThatOverlapsNoOtherIsNamed) {
  std::vector<OverlapSample> samples = Samples({.falloffs = {kTruth, kTruth, kTruth}}, 2000);
  std::vector<OverlapSample> kept;
  for (const OverlapSample& sample : samples) {
    if (sample.sensor != 2) kept.push_back(sample);
  }
  const Result<OverlapFit> fit = FitOverlaps(kept, kNames, kReach, {});
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().message.find("sensor c"), std::string::npos) << fit.error().message;
}

TEST(Overlaps, TheOrderOfSamplesDoesNotMatter) {
  std::vector<OverlapSample> samples = Samples({.falloffs = {kTruth, kTruth, kTruth}}, 1000);
  const Result<OverlapFit> one = FitOverlaps(samples, kNames, kReach, {});
  std::reverse(samples.begin(), samples.end());
  const Result<OverlapFit> other = FitOverlaps(samples, kNames, kReach, {});
  ASSERT_TRUE(one && other);
  for (double rho = 0.0; rho <= 1.0; rho += 0.1) {
    EXPECT_NEAR(one->sensors[0].vignetting.At(rho), other->sensors[0].vignetting.At(rho), 1e-6);
  }
}

}  // namespace
}  // namespace omnihdr::vignetting_test
