#include "core/photometry/measure.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "tests/support/room.h"

namespace omnihdr::measure_test {
namespace {

Exposure Seconds(double seconds, double gain_db = 0.0) {
  return {ExposureTime::Seconds(seconds), GainDb{gain_db}};
}

// A picture of one row with the given grey values, three equal channels.
DecodedImage Row(const std::vector<int>& values) {
  Image<std::uint8_t> image(static_cast<int>(values.size()), 1, 3);
  for (std::size_t k = 0; k < image.size(); ++k) {
    image.data()[k] = static_cast<std::uint8_t>(values[k / 3]);
  }
  return {std::move(image)};
}

DecodedImage Pixel(std::uint8_t r, std::uint8_t g, std::uint8_t b) {
  Image<std::uint8_t> image(1, 1, 3);
  image.at(0, 0, 0) = r;
  image.at(0, 0, 1) = g;
  image.at(0, 0, 2) = b;
  return {std::move(image)};
}

Result<Measurement> MeasureFrames(const std::vector<ExposedFrame>& frames,
                                  const Response& response = *Response::Linear(), int bits = 8,
                                  ImageView<const std::uint8_t> mask = {}) {
  const Projection projection = frames.empty()
                                    ? Projection::Equirectangular(1, 1)
                                    : Projection::Equirectangular(frames.front().image->width(),
                                                                  frames.front().image->height());
  return Measure(frames, projection, response, bits, mask, {});
}

TEST(Measure, OneFrameReadsItsInverseResponseOverTime) {
  std::vector<int> values;
  for (int z = 0; z < 256; ++z) values.push_back(z);
  const DecodedImage image = Row(values);
  for (const Response& response :
       {*Response::Linear(), *Response::Linear(8.0),
        *Response::LogLinear({{{0.02, -3.0}, {0.021, -2.9}, {0.019, -3.2}}})}) {
    const Result<Measurement> m = MeasureFrames({{&image, Seconds(0.02, 6.0)}}, response);
    ASSERT_TRUE(m) << m.error().message;
    const double t = 0.02 * std::pow(10.0, 6.0 / 20.0);
    for (int z = 0; z < 256; ++z) {
      for (int c = 0; c < 3; ++c) {
        const double expected = response.ExposureFromValue(c, z) / t;
        if (expected == 0.0) continue;  // see below
        EXPECT_NEAR(m->radiance.at(z, 0, c), expected, 1e-5 * expected) << "value " << z;
      }
    }
    EXPECT_NEAR(m->longest_exposure_s, t, 1e-7);
    EXPECT_NEAR(m->shortest_exposure_s, t, 1e-7);
  }
}

TEST(Measure, AValueAtOrBelowBlackStandsForAQuarterOfTheFirstStepAboveIt) {
  const DecodedImage image = Row({0, 5, 8, 9});
  const Result<Measurement> m = MeasureFrames({{&image, Seconds(0.5)}}, *Response::Linear(8.0));
  ASSERT_TRUE(m);
  for (const int x : {0, 1, 2}) {
    EXPECT_NEAR(m->radiance.at(x, 0, 1), 0.25 * m->radiance.at(3, 0, 1), 1e-7);
    EXPECT_EQ(m->flags.at(x, 0), kDarkAny);
  }
}

TEST(Measure, ValuesAboveTheRangeAreSaturatedAndBelowItDark) {
  const DecodedImage image = Row({0, 9, 10, 128, 245, 246, 255});
  const Result<Measurement> m = MeasureFrames({{&image, Seconds(1.0)}});
  ASSERT_TRUE(m) << m.error().message;
  const std::vector<int> expected = {kDarkAny, kDarkAny, 0, 0, 0, kSaturatedAny, kSaturatedAny};
  for (int x = 0; x < 7; ++x) {
    EXPECT_EQ(m->flags.at(x, 0), expected[static_cast<std::size_t>(x)]) << "pixel " << x;
    EXPECT_EQ(m->radiance.at(x, 0, 3), expected[static_cast<std::size_t>(x)] == 0 ? 1.0F : 0.0F);
  }
}

TEST(Measure, ChannelBitsAreKeptApart) {
  const DecodedImage blue_clips = Pixel(100, 200, 255);
  Result<Measurement> m = MeasureFrames({{&blue_clips, Seconds(1.0)}});
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), kSaturatedB);
  EXPECT_NEAR(m->radiance.at(0, 0, 0), 100.0 / 128.0, 1e-5);
  EXPECT_EQ(m->radiance.at(0, 0, 3), 0.0F);

  const DecodedImage red_is_dark = Pixel(3, 200, 100);
  m = MeasureFrames({{&red_is_dark, Seconds(1.0)}});
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), kDarkR);

  const DecodedImage both = Pixel(3, 200, 255);
  m = MeasureFrames({{&both, Seconds(1.0)}});
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), kDarkR | kSaturatedB);
}

TEST(Measure, APixelSaturatedEverywhereReadsTheShortestExposuresValue) {
  const DecodedImage longer = Row({255});
  const DecodedImage shorter = Row({250});
  const Result<Measurement> m = MeasureFrames({{&longer, Seconds(1.0)}, {&shorter, Seconds(0.1)}});
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), kSaturatedAny);
  EXPECT_NEAR(m->radiance.at(0, 0, 1), 250.0 / 128.0 / 0.1, 1e-3);
  EXPECT_NEAR(m->saturation[1], 245.0 / 128.0 / 0.1, 1e-3);
}

TEST(Measure, APixelDarkEverywhereReadsTheLongestExposuresValue) {
  const DecodedImage longer = Row({8});
  const DecodedImage shorter = Row({1});
  const Result<Measurement> m = MeasureFrames({{&shorter, Seconds(0.1)}, {&longer, Seconds(1.0)}});
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), kDarkAny);
  EXPECT_NEAR(m->radiance.at(0, 0, 1), 8.0 / 128.0, 1e-5);
}

TEST(Measure, ASaturatedFrameSaysNothingWhereAnotherMeasures) {
  const DecodedImage longer = Row({255});
  const DecodedImage shorter = Row({64});
  const Result<Measurement> m = MeasureFrames({{&longer, Seconds(1.0)}, {&shorter, Seconds(0.1)}});
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), 0);
  EXPECT_NEAR(m->radiance.at(0, 0, 1), 64.0 / 128.0 / 0.1, 1e-4);
}

TEST(Measure, MaskedPixelsHoldNothing) {
  const DecodedImage image = Row({100, 100, 100, 255});
  Image<std::uint8_t> mask(4, 1, 1, 255);
  mask.at(1, 0) = 0;
  mask.at(3, 0) = 0;
  const Result<Measurement> m =
      MeasureFrames({{&image, Seconds(1.0)}}, *Response::Linear(), 8, mask.view());
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), 0);
  for (const int x : {1, 3}) {
    EXPECT_EQ(m->flags.at(x, 0), kMasked);
    for (int c = 0; c < 4; ++c) EXPECT_EQ(m->radiance.at(x, 0, c), 0.0F);
  }
}

TEST(Measure, GreyFramesCountAsThreeEqualChannels) {
  Image<std::uint8_t> grey(1, 1, 1, 90);
  const DecodedImage image{std::move(grey)};
  const Result<Measurement> m = MeasureFrames({{&image, Seconds(0.5)}});
  ASSERT_TRUE(m);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(m->radiance.at(0, 0, c), 90.0 / 128.0 / 0.5, 1e-5);
}

TEST(Measure, SixteenBitFramesUseTheirDeclaredBits) {
  for (const int bits : {10, 12, 16}) {
    const double full = (1 << bits) - 1;
    Image<std::uint16_t> values(4, 1, 3);
    const std::array<double, 4> share = {0.01, 0.25, 0.5, 1.0};
    for (int x = 0; x < 4; ++x) {
      for (int c = 0; c < 3; ++c) {
        values.at(x, 0, c) =
            static_cast<std::uint16_t>(std::lround(share[static_cast<std::size_t>(x)] * full));
      }
    }
    const DecodedImage image{std::move(values)};
    const Result<Measurement> m =
        MeasureFrames({{&image, Seconds(1.0)}}, *Response::Linear(), bits);
    ASSERT_TRUE(m);
    EXPECT_EQ(m->flags.at(0, 0), kDarkAny) << bits;
    EXPECT_EQ(m->flags.at(1, 0), 0) << bits;
    EXPECT_EQ(m->flags.at(3, 0), kSaturatedAny) << bits;
    EXPECT_NEAR(m->radiance.at(1, 0, 1), 0.25 * 255.0 / 128.0, 255.0 / 128.0 / full) << bits;
    EXPECT_NEAR(m->radiance.at(2, 0, 1), 0.5 * 255.0 / 128.0, 255.0 / 128.0 / full) << bits;
  }
}

TEST(Measure, ValuesBeyondTheDeclaredBitsCountAsSaturated) {
  Image<std::uint16_t> values(1, 1, 3, 40000);
  const DecodedImage image{std::move(values)};
  const Result<Measurement> m = MeasureFrames({{&image, Seconds(1.0)}}, *Response::Linear(), 12);
  ASSERT_TRUE(m);
  EXPECT_EQ(m->flags.at(0, 0), kSaturatedAny);
  EXPECT_TRUE(std::isfinite(m->radiance.at(0, 0, 0)));
}

TEST(Measure, NothingToMeasureIsRefused) { EXPECT_FALSE(MeasureFrames({})); }

TEST(Measure, FramesOfDifferentSizesAreRefusedWithBothSizes) {
  const DecodedImage a = Row({1, 2, 3});
  const DecodedImage b = Row({1, 2});
  const Result<Measurement> m = MeasureFrames({{&a, Seconds(1.0)}, {&b, Seconds(1.0)}});
  ASSERT_FALSE(m);
  EXPECT_EQ(m.error().kind, ErrorKind::kData);
  EXPECT_NE(m.error().message.find("3x1"), std::string::npos);
  EXPECT_NE(m.error().message.find("2x1"), std::string::npos);
}

TEST(Measure, AMaskOfAnotherSizeIsRefused) {
  const DecodedImage a = Row({1, 2, 3});
  const Image<std::uint8_t> mask(3, 2, 1, 255);
  EXPECT_FALSE(MeasureFrames({{&a, Seconds(1.0)}}, *Response::Linear(), 8, mask.view()));
}

TEST(Measure, AnExposureThatIsNotPositiveAndFiniteIsRefusedWithItsValue) {
  const DecodedImage a = Row({1, 2, 3});
  for (const double t : {0.0, -0.5, std::numeric_limits<double>::quiet_NaN(),
                         std::numeric_limits<double>::infinity()}) {
    const Result<Measurement> m = MeasureFrames({{&a, Seconds(1.0)}, {&a, Seconds(t)}});
    ASSERT_FALSE(m) << t;
    EXPECT_NE(m.error().message.find(fmt::format("{} s", t)), std::string::npos);
  }
  EXPECT_FALSE(MeasureFrames({{&a, Seconds(1.0, std::numeric_limits<double>::quiet_NaN())}}));
}

TEST(Measure, TwoChannelsAreRefused) {
  const DecodedImage a{Image<std::uint8_t>(2, 2, 2)};
  EXPECT_FALSE(MeasureFrames({{&a, Seconds(1.0)}}));
}

TEST(Measure, MoreFramesAtAPositionThanCanBeMergedAreRefused) {
  const DecodedImage a = Row({100});
  EXPECT_TRUE(MeasureFrames(std::vector<ExposedFrame>(64, {&a, Seconds(1.0)})));
  EXPECT_FALSE(MeasureFrames(std::vector<ExposedFrame>(65, {&a, Seconds(1.0)})));
}

TEST(Measure, TheStatedVarianceIsThatOfRepeatedMeasurements) {
  constexpr NoiseModel kNoise{.read = 0.8, .gain = 0.05, .prnu = 0.0};
  const Image<float> radiance(200, 200, 3, 3.0F);
  const DecodedImage image = testing::Expose(radiance, 0.3, 5, kNoise);
  MeasureOptions options;
  options.noise = kNoise;
  const std::vector<ExposedFrame> frames = {{&image, Seconds(0.3)}};
  const Result<Measurement> m =
      Measure(frames, Projection::Equirectangular(200, 200), *Response::Linear(), 8, {}, options);
  ASSERT_TRUE(m);
  double sum = 0.0;
  for (int y = 0; y < 200; ++y) {
    for (int x = 0; x < 200; ++x) sum += std::pow(m->radiance.at(x, y, 1) - 3.0, 2);
  }
  const double stated = m->variance_floor[1] + m->variance_per_radiance[1] * 3.0;
  EXPECT_NEAR(sum / 40000.0, stated, 0.05 * stated);
}

TEST(Measure, AtTheNoiseFloorTheSignalIsAsStrongAsItsNoise) {
  const DecodedImage image = Row({100});
  const Result<Measurement> m = MeasureFrames({{&image, Seconds(0.01)}});
  ASSERT_TRUE(m);
  const double e = m->noise_floor;
  EXPECT_NEAR(m->variance_floor[1] + m->variance_per_radiance[1] * e, e * e, 1e-4 * e * e);
}

// Three exposures of a scene, its radiance spread evenly in the logarithm over 11 stops, as a noisy
// sensor sees it: full well of 10 ke, read noise of 4 e, the brightest light just within the
// shortest exposure.
TEST(Measure, ABracketOfThreeComesCloseToTheBoundOfItsNoise) {
  constexpr NoiseModel kNoise{.read = 0.1, .gain = 0.0255, .prnu = 0.0};
  constexpr double kDarkest = 0.01;
  constexpr double kBrightest = 20.0;
  constexpr double kGain = 255.0 / 128.0 * 32.0 / kBrightest;
  const std::array<double, 3> times = {kGain / 32.0, kGain / 4.0, kGain * 2.0};
  Image<float> truth(512, 256, 3);
  std::mt19937 generator(4);
  std::uniform_real_distribution<double> ln(std::log(kDarkest), std::log(kBrightest));
  for (int y = 0; y < 256; ++y) {
    for (int x = 0; x < 512; ++x) {
      const auto e = static_cast<float>(std::exp(ln(generator)));
      for (int c = 0; c < 3; ++c) truth.at(x, y, c) = e;
    }
  }
  std::vector<DecodedImage> images;
  std::vector<ExposedFrame> frames;
  for (const double t : times) {
    images.push_back(
        testing::Expose(truth, t, static_cast<std::uint32_t>(images.size()) + 1, kNoise));
  }
  for (std::size_t k = 0; k < 3; ++k) frames.push_back({&images[k], Seconds(times[k])});
  const auto error = [&](MergeWeights weights) {
    MeasureOptions options;
    options.noise = kNoise;
    options.weights = weights;
    const Result<Measurement> m =
        Measure(frames, Projection::Equirectangular(512, 256), *Response::Linear(), 8, {}, options);
    double squares = 0.0;
    for (int y = 0; y < 256; ++y) {
      for (int x = 0; x < 512; ++x) {
        squares += std::pow(std::log(m->radiance.at(x, y, 1) / truth.at(x, y, 1)), 2);
      }
    }
    return std::sqrt(squares / (512 * 256));
  };
  // Fisher information of ln E in the frames that are not clipped.
  double bound = 0.0;
  for (int y = 0; y < 256; ++y) {
    for (int x = 0; x < 512; ++x) {
      double information = 0.0;
      for (const double t : times) {
        const double z = 128.0 * truth.at(x, y, 1) * t;
        if (z <= 255.0) information += z * z / kNoise.VarianceOfValue(z);
      }
      bound += 1.0 / information;
    }
  }
  bound = std::sqrt(bound / (512 * 256));
  const double rms = error(MergeWeights::kInverseVariance);
  RecordProperty("rms_ln", fmt::format("{:.4f}", rms));
  RecordProperty("rms_ln_hat", fmt::format("{:.4f}", error(MergeWeights::kHat)));
  RecordProperty("bound", fmt::format("{:.4f}", bound));
  EXPECT_LE(rms, 0.030);
  EXPECT_LE(rms, 1.15 * bound);
  EXPECT_GT(error(MergeWeights::kHat), rms);
}

TEST(Measure, NoiseDoesNotBiasTheMean) {
  constexpr NoiseModel kNoise{.read = 1.0, .gain = 0.1, .prnu = 0.0};
  const Image<float> truth(200, 100, 3, 0.4F);
  const DecodedImage dim = testing::Expose(truth, 0.5, 1, kNoise);
  const DecodedImage bright = testing::Expose(truth, 4.0, 2, kNoise);
  MeasureOptions options;
  options.noise = kNoise;
  const std::vector<ExposedFrame> frames = {{&dim, Seconds(0.5)}, {&bright, Seconds(4.0)}};
  const Result<Measurement> m =
      Measure(frames, Projection::Equirectangular(200, 100), *Response::Linear(), 8, {}, options);
  ASSERT_TRUE(m);
  double sum = 0.0;
  for (int y = 0; y < 100; ++y) {
    for (int x = 0; x < 200; ++x) sum += m->radiance.at(x, y, 0);
  }
  EXPECT_NEAR(sum / 20000.0, 0.4, 0.0005);
}

// What Measure must give, in plain scalar code: the law of the vector kernels.
struct Expected {
  double radiance = 0.0;
  bool is_dark = false;
};
Expected Reference(const std::vector<std::array<int, 3>>& z, const std::vector<double>& t, int c,
                   const Response& response, const MeasureOptions& options) {
  const auto exposure = [&](std::size_t k) {
    const int value = z[k][static_cast<std::size_t>(c)];
    double e = response.ExposureFromValue(c, value);
    for (int above = value; e <= 0.0; ++above) e = 0.25 * response.ExposureFromValue(c, above + 1);
    return e;
  };
  const auto is_bright = [&](std::size_t k) { return *std::ranges::max_element(z[k]) > 245; };
  const auto value = [&](std::size_t k) { return z[k][static_cast<std::size_t>(c)]; };
  double light = 0.0;
  double time = 0.0;
  std::size_t longest = t.size();
  for (std::size_t k = 0; k < t.size(); ++k) {
    if (is_bright(k)) continue;
    if (longest == t.size() || t[k] > t[longest]) longest = k;
    if (value(k) < 10) continue;
    light += exposure(k);
    time += t[k];
  }
  if (time == 0.0) return {exposure(longest) / t[longest], true};
  const double slope = response.Slope(c, 128.0);
  double sum = 0.0;
  double weights = 0.0;
  for (std::size_t k = 0; k < t.size(); ++k) {
    if (is_bright(k) || value(k) < 10) continue;
    const double signal = light / time * t[k];
    const NoiseModel& n = options.noise;
    double w = t[k] * t[k] /
               ((n.read * n.read + 1.0 / 12.0) * slope * slope + n.gain * slope * signal +
                n.prnu * n.prnu * signal * signal);
    if (options.weights == MergeWeights::kHat) w = std::min(value(k), 255 - value(k));
    sum += w * exposure(k) / t[k];
    weights += w;
  }
  return {sum / weights, false};
}

TEST(Measure, BracketsOfAnyLengthFollowTheLawInEveryPixel) {
  constexpr int kWidth = 700;  // not a multiple of the kernels' blocks
  std::array<std::vector<double>, 3> curve;
  for (std::vector<double>& channel : curve) {
    for (int z = 0; z < 256; ++z) channel.push_back(0.02 * z + 1e-5 * z * z - 3.0);
  }
  for (const Response& response :
       {*Response::Linear(), *Response::Linear(12.0), *Response::Table(curve)}) {
    for (const MergeWeights weights : {MergeWeights::kInverseVariance, MergeWeights::kHat}) {
      for (const std::size_t count : {2U, 3U, 4U, 7U}) {
        std::mt19937 generator(static_cast<unsigned>(count));
        std::uniform_real_distribution<double> ln(std::log(0.005), std::log(20.0));
        std::vector<double> times;
        std::vector<DecodedImage> images;
        for (std::size_t k = 0; k < count; ++k) times.push_back(0.02 * std::pow(3.0, k));
        std::shuffle(times.begin(), times.end(), generator);
        for (std::size_t k = 0; k < count; ++k) {
          images.push_back({Image<std::uint8_t>(kWidth, 2, 3)});
        }
        std::normal_distribution<double> noise(0.0, 4.0);
        for (int i = 0; i < 2 * kWidth; ++i) {
          const double e = std::exp(ln(generator));
          for (std::size_t k = 0; k < count; ++k) {
            for (std::size_t c = 0; c < 3; ++c) {
              const double z = 128.0 * e * times[k] * (0.6 + 0.3 * static_cast<double>(c));
              std::get<0>(images[k].pixels).data()[3 * static_cast<std::size_t>(i) + c] =
                  static_cast<std::uint8_t>(std::clamp(z + noise(generator), 0.0, 255.0));
            }
          }
        }
        std::vector<ExposedFrame> frames;
        for (std::size_t k = 0; k < count; ++k) frames.push_back({&images[k], Seconds(times[k])});
        MeasureOptions options;
        options.noise = {.read = 0.7, .gain = 0.03, .prnu = 0.01};
        options.weights = weights;
        const Result<Measurement> m =
            Measure(frames, Projection::Equirectangular(kWidth, 2), response, 8, {}, options);
        ASSERT_TRUE(m);
        int merged = 0;
        for (int y = 0; y < 2; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            std::vector<std::array<int, 3>> z(count);
            bool blind = true;
            for (std::size_t k = 0; k < count; ++k) {
              for (int c = 0; c < 3; ++c) {
                z[k][static_cast<std::size_t>(c)] = std::get<0>(images[k].pixels).at(x, y, c);
              }
              blind = blind && *std::ranges::max_element(z[k]) > 245;
            }
            ASSERT_EQ((m->flags.at(x, y) & kSaturatedAny) != 0, blind);
            if (blind) continue;
            for (int c = 0; c < 3; ++c) {
              const Expected expected = Reference(z, times, c, response, options);
              ASSERT_NEAR(m->radiance.at(x, y, c), expected.radiance, 1e-5 * expected.radiance)
                  << count << " frames, pixel " << x;
              ASSERT_EQ((m->flags.at(x, y) & (kDarkR << c)) != 0, expected.is_dark);
              merged += expected.is_dark ? 0 : 1;
            }
          }
        }
        EXPECT_GT(merged, 1000);
      }
    }
  }
}

TEST(Measure, EqualExposuresThatAreDarkAreAveragedWhicheverComesFirst) {
  const DecodedImage a = Row({4});
  const DecodedImage b = Row({8});
  for (const bool swap : {false, true}) {
    const Result<Measurement> m = MeasureFrames(
        {{swap ? &b : &a, Seconds(1.0)}, {swap ? &a : &b, Seconds(1.0)}, {&b, Seconds(0.1)}});
    ASSERT_TRUE(m);
    EXPECT_NEAR(m->radiance.at(0, 0, 0), 6.0 / 128.0, 1e-6);
    EXPECT_EQ(m->flags.at(0, 0), kDarkAny);
  }
}

TEST(Measure, TheHatGivesMoreErrorThanTheNoiseModelWhereReadNoiseRules) {
  constexpr NoiseModel kNoise{.read = 2.0, .gain = 0.0255, .prnu = 0.0};
  const Image<float> truth(200, 100, 3, 0.5F);
  const DecodedImage dim = testing::Expose(truth, 0.25, 1, kNoise);
  const DecodedImage bright = testing::Expose(truth, 3.0, 2, kNoise);
  const auto error = [&](MergeWeights weights) {
    MeasureOptions options;
    options.noise = kNoise;
    options.weights = weights;
    const std::vector<ExposedFrame> frames = {{&dim, Seconds(0.25)}, {&bright, Seconds(3.0)}};
    const Result<Measurement> m =
        Measure(frames, Projection::Equirectangular(200, 100), *Response::Linear(), 8, {}, options);
    double sum = 0.0;
    for (int y = 0; y < 100; ++y) {
      for (int x = 0; x < 200; ++x) sum += std::pow(m->radiance.at(x, y, 1) - 0.5, 2);
    }
    return std::sqrt(sum / 20000.0);
  };
  EXPECT_LT(error(MergeWeights::kInverseVariance), 0.7 * error(MergeWeights::kHat));
}

TEST(Measure, WhiteBalanceScalesRadianceBoundsAndNoiseAlike) {
  const DecodedImage image = Row({0, 100, 255});
  MeasureOptions options;
  const std::vector<ExposedFrame> frames = {{&image, Seconds(0.5)}};
  const Projection projection = Projection::Equirectangular(3, 1);
  const Result<Measurement> plain =
      Measure(frames, projection, *Response::Linear(), 8, {}, options);
  options.white_balance = {2.0, 1.0, 1.5};
  const Result<Measurement> balanced =
      Measure(frames, projection, *Response::Linear(), 8, {}, options);
  ASSERT_TRUE(plain && balanced);
  for (std::size_t c = 0; c < 3; ++c) {
    const auto gain = static_cast<float>(options.white_balance[c]);
    for (int x = 0; x < 3; ++x) {
      EXPECT_FLOAT_EQ(balanced->radiance.at(x, 0, static_cast<int>(c)),
                      gain * plain->radiance.at(x, 0, static_cast<int>(c)));
    }
    EXPECT_FLOAT_EQ(balanced->saturation[c], gain * plain->saturation[c]);
    EXPECT_NEAR(balanced->variance_floor[c], gain * gain * plain->variance_floor[c],
                1e-5F * balanced->variance_floor[c]);
  }
}

TEST(Measure, ACurveThatIsFlatInTheMiddleOrOverflowsStaysFinite) {
  std::array<std::vector<double>, 3> flat;
  for (std::vector<double>& channel : flat) {
    for (int z = 0; z < 256; ++z) channel.push_back(z < 100 ? -1.0 : (z < 200 ? 0.0 : 400.0));
  }
  const DecodedImage a = Row({0, 50, 128, 190, 230, 255});
  const DecodedImage b = Row({5, 120, 220, 240, 235, 250});
  for (const Response& response :
       {*Response::Table(flat), *Response::LogLinear({{{9.0, 0.0}, {9.0, 0.0}, {9.0, 0.0}}})}) {
    for (const std::vector<ExposedFrame>& frames :
         {std::vector<ExposedFrame>{{&a, Seconds(1e-9)}, {&b, Seconds(1e6)}},
          std::vector<ExposedFrame>{{&a, Seconds(0.1)}, {&b, Seconds(0.2)}}}) {
      const Result<Measurement> m = MeasureFrames(frames, response);
      ASSERT_TRUE(m);
      for (const float v : m->radiance.values()) {
        EXPECT_TRUE(std::isfinite(v));
        EXPECT_GE(v, 0.0F);
      }
    }
  }
}

}  // namespace
}  // namespace omnihdr::measure_test
