// Green guides and panoramas interpolated with them.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <numbers>
#include <random>
#include <utility>

#include "core/base/parallel_for.h"
#include "core/photometry/green_guide.h"
#include "core/photometry/stitch.h"
#include "tests/support/ring.h"

namespace omnihdr::edge_aware_test {
namespace {

using testing::MakeRing;
using testing::RadianceAt;
using testing::ShootRing;

constexpr double kFar = 10.0;  // radius of the scenes

// A rig of one sensor of this size, lens and pose of no matter.
Rig OneSensor(int width, int height, BayerOrder bayer) {
  Rig rig = MakeRing({.width = width, .height = height, .bayer = bayer, .equal_gains = true});
  rig.sensors.resize(1);
  rig.sensors[0].gain = {2.0, 1.0, 1.5};
  return rig;
}

// The mosaic of a neutral picture, `grey` for every pixel, as the rig's gains would balance it.
RadianceMosaic MosaicOf(const Rig& rig, const std::function<double(int x, int y)>& grey) {
  const RigSensor& sensor = rig.sensors[0];
  RadianceMosaic mosaic;
  mosaic.radiance = Image<float>(sensor.lens.width(), sensor.lens.height());
  mosaic.state = Image<std::uint8_t>(sensor.lens.width(), sensor.lens.height(), 1, kMosaicUsable);
  for (int y = 0; y < mosaic.radiance.height(); ++y) {
    for (int x = 0; x < mosaic.radiance.width(); ++x) {
      const auto c = static_cast<std::size_t>(BayerChannel(sensor.bayer, x, y));
      mosaic.radiance.at(x, y) = static_cast<float>(grey(x, y) / sensor.gain[c]);
    }
  }
  return mosaic;
}

Image<float> GuideOf(const RadianceMosaic& mosaic, const Rig& rig) {
  Image<float> guide;
  GreenGuide(mosaic, rig, StackedRows(rig).value(), &guide);
  return guide;
}

constexpr std::array kOrders = {BayerOrder::kRggb, BayerOrder::kGrbg, BayerOrder::kGbrg,
                                BayerOrder::kBggr};

TEST(GreenGuide, FollowsEdgesInsteadOfAveragingAcrossThem) {
  for (const BayerOrder order : kOrders) {
    const Rig rig = OneSensor(160, 40, order);
    for (const bool upright : {true, false}) {
      for (int at : {19, 20}) {
        const auto scene = [&](int x, int y) { return (upright ? x : y) < at ? 0.2 : 1.0; };
        const Image<float> guide = GuideOf(MosaicOf(rig, scene), rig);
        for (int y = 0; y < 40; ++y) {
          for (int x = 0; x < 160; ++x) {
            ASSERT_NEAR(guide.at(x, y), scene(x, y), 1e-5) << x << " " << y << " " << at;
          }
        }
      }
    }
  }
}

TEST(GreenGuide, TakesInTheCurvatureOfTheOtherColours) {
  const Rig rig = OneSensor(160, 40, BayerOrder::kBggr);
  const auto scene = [](int x, int y) {
    return 1.0 + 0.5 * std::sin(x * std::numbers::pi / 3.0) * std::sin(y * std::numbers::pi / 3.0);
  };
  const RadianceMosaic mosaic = MosaicOf(rig, scene);
  const Image<float> guide = GuideOf(mosaic, rig);
  double squares = 0.0;
  double squares_of_mean = 0.0;
  for (int y = 2; y < 38; ++y) {
    for (int x = 2; x < 158; ++x) {
      if (BayerChannel(BayerOrder::kBggr, x, y) == 1) continue;
      const double mean =
          0.25 * (scene(x - 1, y) + scene(x + 1, y) + scene(x, y - 1) + scene(x, y + 1));
      squares += std::pow(guide.at(x, y) - scene(x, y), 2);
      squares_of_mean += std::pow(mean - scene(x, y), 2);
    }
  }
  EXPECT_LT(squares, 0.36 * squares_of_mean);
}

TEST(GreenGuide, AClippedValueNeverEntersUnlessThereIsNoOther) {
  std::mt19937 random(7);
  std::bernoulli_distribution clipped(0.15);
  for (const BayerOrder order : kOrders) {
    const Rig rig = OneSensor(160, 40, order);
    RadianceMosaic mosaic = MosaicOf(rig, [](int, int) { return 0.5; });
    for (int y = 0; y < 40; ++y) {
      for (int x = 0; x < 160; ++x) {
        const bool is_clipped = clipped(random) || (x >= 80 && x < 90 && y >= 10 && y < 20);
        if (!is_clipped) continue;
        mosaic.radiance.at(x, y) = 7.0F;
        mosaic.state.at(x, y) = kMosaicSaturated;
      }
    }
    const Image<float> guide = GuideOf(mosaic, rig);
    int bound = 0;
    int careful = 0;
    for (int y = 1; y < 39; ++y) {
      for (int x = 1; x < 159; ++x) {
        if (BayerChannel(order, x, y) == 1) {
          ASSERT_EQ(guide.at(x, y), mosaic.radiance.at(x, y));
          continue;
        }
        int open = 0;
        for (const auto& [dx, dy] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
          open += mosaic.state.at(x + dx, y + dy) != kMosaicSaturated ? 1 : 0;
        }
        ASSERT_NEAR(guide.at(x, y), open > 0 ? 0.5 : 7.0, 1e-5) << x << " " << y;
        bound += open == 0 ? 1 : 0;
        careful += open > 0 && open < 4 ? 1 : 0;
      }
    }
    EXPECT_GT(bound, 20);
    EXPECT_GT(careful, 500);
  }
}

TEST(GreenGuide, StaysWithinItsNeighbourGreensWhateverTheMosaic) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> decade(-6.0, 3.0);
  const Rig rig = OneSensor(160, 40, BayerOrder::kGrbg);
  RadianceMosaic mosaic = MosaicOf(rig, [&](int, int) { return std::pow(10.0, decade(random)); });
  for (int x = 20; x < 50; ++x) mosaic.radiance.at(x, 7) = 0.0F;
  for (int x = 0; x < 30; ++x) mosaic.radiance.at(x, 20) = 3e38F;  // overflows
  const Image<float> guide = GuideOf(mosaic, rig);
  for (int y = 1; y < 39; ++y) {
    for (int x = 1; x < 159; ++x) {
      if (BayerChannel(BayerOrder::kGrbg, x, y) == 1) continue;
      const auto& m = mosaic.radiance;
      const auto [low, high] =
          std::minmax({m.at(x - 1, y), m.at(x + 1, y), m.at(x, y - 1), m.at(x, y + 1)});
      ASSERT_GE(guide.at(x, y), low) << x << " " << y;
      ASSERT_LE(guide.at(x, y), high) << x << " " << y;
    }
  }
}

// --- panoramas

Eigen::Vector3d Smooth(const Eigen::Vector3d& point) {
  const Eigen::Vector3d u = point.normalized();
  return {1.0 + 0.4 * u.x(), 0.9 + 0.3 * u.y() - 0.2 * u.z(), 0.8 + 0.3 * u.z()};
}

// Patches of three colours with edges in all directions.
Eigen::Vector3d Patches(const Eigen::Vector3d& point) {
  const Eigen::Vector3d u = point.normalized();
  Eigen::Vector3d colour(0.3, 0.32, 0.35);
  if (std::sin(20.0 * u.x()) * std::sin(19.0 * u.y()) * std::sin(21.0 * u.z()) > 0.0) {
    colour = {1.0, 0.9, 0.7};
  }
  if (std::sin(11.0 * u.x() + 3.0) * std::sin(12.0 * u.y() - 8.0 * u.z()) > 0.3) {
    colour = colour.cwiseProduct(Eigen::Vector3d(0.4, 1.0, 1.2));
  }
  return colour;
}

// What a pixel of 0.9 degrees sees of it: the mean of 3 × 3 directions.
Eigen::Vector3d Blurred(const RadianceAt& scene, const Eigen::Vector3d& point) {
  const Eigen::Vector3d u = point.normalized();
  const Eigen::Vector3d a =
      u.cross(std::abs(u.z()) < 0.9 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX())
          .normalized();
  const Eigen::Vector3d b = u.cross(a);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = -1; i <= 1; ++i) {
    for (int j = -1; j <= 1; ++j) sum += scene(kFar * (u + 0.0055 * (i * a + j * b)));
  }
  return sum / 9.0;
}

Measurement StitchWith(Demosaic demosaic, const Rig& rig, const DecodedImage& image, int bits = 14,
                       double read_noise = 0.5) {
  Stitcher stitcher = Stitcher::Create(rig, Projection::Equirectangular(320, 160), {}).value();
  MeasureOptions options;
  options.noise = {.read = read_noise, .gain = 0.0, .prnu = 0.0};
  options.demosaic = demosaic;
  Measurement m;
  EXPECT_TRUE(
      stitcher.Stitch(std::vector<RigFrame>{{&image, {{ExposureTime::Seconds(1.0), GainDb{}}}}},
                      std::vector{*Response::Linear()}, bits, options, &m));
  return m;
}

double RmsLog10(const Measurement& m, const RadianceAt& scene) {
  double sum = 0.0;
  int count = 0;
  for (int y = 0; y < m.radiance.height(); ++y) {
    for (int x = 0; x < m.radiance.width(); ++x) {
      if (m.flags.at(x, y) != 0) continue;
      const Eigen::Vector3d truth = scene(kFar * m.projection.RayFromPixel(x + 0.5, y + 0.5));
      for (int c = 0; c < 3; ++c) {
        const double e = std::log10(m.radiance.at(x, y, c) / truth[c]);
        sum += e * e;
        ++count;
      }
    }
  }
  EXPECT_GT(count, 60000);
  return std::sqrt(sum / count);
}

TEST(EdgeAwareStitch, IsMuchNearerToASceneOfEdges) {
  const Rig rig = MakeRing();
  const RadianceAt scene = [](const Eigen::Vector3d& p) { return Blurred(Patches, p); };
  const DecodedImage image = ShootRing(rig, scene, kFar, 1.0, 14);
  const double bilinear = RmsLog10(StitchWith(Demosaic::kBilinear, rig, image), scene);
  const double edge_aware = RmsLog10(StitchWith(Demosaic::kEdgeAware, rig, image), scene);
  EXPECT_LT(edge_aware, 0.75 * bilinear) << bilinear;
}

TEST(EdgeAwareStitch, GivesASmoothSceneAndFlatColoursAsTheyAre) {
  const Rig rig = MakeRing();
  EXPECT_LT(RmsLog10(StitchWith(Demosaic::kEdgeAware, rig, ShootRing(rig, Smooth, kFar, 1.0, 14)),
                     Smooth),
            0.0005);
  const RadianceAt flat = [](const Eigen::Vector3d&) { return Eigen::Vector3d(1.2, 0.6, 0.3); };
  for (const BayerOrder order : kOrders) {
    const Rig plain = MakeRing({.bayer = order, .vignetting = {}, .equal_gains = true});
    EXPECT_LT(
        RmsLog10(StitchWith(Demosaic::kEdgeAware, plain, ShootRing(plain, flat, kFar, 1.0, 14)),
                 flat),
        1e-4)
        << ToString(order);
  }
}

TEST(EdgeAwareStitch, FlagsAreThoseOfBilinearAndBoundsStayBounds) {
  const Rig rig = MakeRing();
  const RadianceAt scene = [](const Eigen::Vector3d& p) {
    const Eigen::Vector3d u = p.normalized();
    const bool lamp =
        std::sin(25.0 * u.x()) * std::sin(23.0 * u.y()) * std::sin(27.0 * u.z()) > 0.6;
    return Eigen::Vector3d(Patches(p) * (lamp ? 30.0 : u.y() > 0.0 ? 1.0 : 0.02));
  };
  const DecodedImage image = ShootRing(rig, scene, kFar, 1.0, 14);
  const Measurement a = StitchWith(Demosaic::kBilinear, rig, image);
  const Measurement b = StitchWith(Demosaic::kEdgeAware, rig, image);
  ASSERT_EQ(std::memcmp(a.flags.data(), b.flags.data(), a.flags.size()), 0);
  int clipped = 0;
  for (int y = 0; y < 160; ++y) {
    for (int x = 0; x < 320; ++x) {
      const std::uint8_t flags = a.flags.at(x, y);
      for (int c = 0; c < 3; ++c) {
        ASSERT_TRUE(std::isfinite(b.radiance.at(x, y, c)) && b.radiance.at(x, y, c) >= 0.0F);
        if ((flags & kSaturatedG) == 0 && (flags >> c & 1) == 0) continue;
        ASSERT_NEAR(b.radiance.at(x, y, c), a.radiance.at(x, y, c),
                    1e-4F * a.radiance.at(x, y, c) + 1e-5F)
            << x << " " << y << " " << c;
        ++clipped;
      }
    }
  }
  EXPECT_GT(clipped, 1000);
  EXPECT_EQ(a.saturation, b.saturation);
}

TEST(EdgeAwareStitch, ItsNoiseIsWhatTheMeasurementSays) {
  constexpr double kRms = 2.0;
  const RadianceAt grey = [](const Eigen::Vector3d&) { return Eigen::Vector3d(0.9, 0.9, 0.9); };
  for (const bool equal : {true, false}) {
    Rig rig = MakeRing({.width = 192, .height = 144, .equal_gains = equal});
    if (!equal) {
      for (RigSensor& sensor : rig.sensors) sensor.gain = {1.8, 1.0, 1.5};
    }
    const Measurement truth =
        StitchWith(Demosaic::kEdgeAware, rig, ShootRing(rig, grey, kFar, 1.0, 14));
    std::array<double, 3> squares{};
    std::array<float, 3> said{};
    double count = 0.0;
    for (std::uint64_t seed = 1; seed <= 3; ++seed) {
      const DecodedImage noisy = ShootRing(rig, grey, kFar, 1.0, 14, kRms, seed);
      const Measurement m = StitchWith(Demosaic::kEdgeAware, rig, noisy, 14, kRms);
      said = m.variance_floor;
      for (int y = 0; y < 160; ++y) {
        for (int x = 0; x < 320; ++x) {
          if (m.flags.at(x, y) == kMasked) continue;
          for (int c = 0; c < 3; ++c) {
            const double e = m.radiance.at(x, y, c) - truth.radiance.at(x, y, c);
            squares[static_cast<std::size_t>(c)] += e * e;
          }
          count += 1.0;
        }
      }
    }
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(squares[c] / count / said[c], 1.0, 0.12) << c << (equal ? "" : " own gains");
    }
  }
}

TEST(EdgeAwareStitch, TheSameBytesOnOneCoreAndOnTwo) {
  const Rig rig = MakeRing();
  const DecodedImage image = ShootRing(rig, Patches, kFar, 1.0, 8, 2.0);
  SetWorkerCount(1);
  const Measurement one = StitchWith(Demosaic::kEdgeAware, rig, image, 8);
  SetWorkerCount(2);
  const Measurement two = StitchWith(Demosaic::kEdgeAware, rig, image, 8);
  SetWorkerCount(0);
  EXPECT_EQ(std::memcmp(one.radiance.data(), two.radiance.data(), 4 * one.radiance.size()), 0);
}

TEST(EdgeAwareStitch, DevelopedPicturesAreAsWithout) {
  const Rig rig = MakeRing({.bayer = BayerOrder::kNone});
  const DecodedImage image = ShootRing(rig, Patches, kFar, 1.0);
  const Measurement a = StitchWith(Demosaic::kBilinear, rig, image, 8);
  const Measurement b = StitchWith(Demosaic::kEdgeAware, rig, image, 8);
  EXPECT_EQ(std::memcmp(a.radiance.data(), b.radiance.data(), 4 * a.radiance.size()), 0);
  EXPECT_EQ(a.variance_floor, b.variance_floor);
}

}  // namespace
}  // namespace omnihdr::edge_aware_test
