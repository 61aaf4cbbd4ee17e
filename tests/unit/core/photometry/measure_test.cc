#include "core/photometry/measure.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "tests/support/room.h"

namespace omnihdr {
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

// Three exposures of a scene, its radiance spread evenly in the logarithm, as a noisy sensor sees
// it.
TEST(Measure, ABracketOfThreeComesCloseToTheBoundOfItsNoise) {
  constexpr NoiseModel kNoise{.read = 0.5, .gain = 0.0255, .prnu = 0.0};  // full well of 10 ke
  constexpr double kDarkest = 0.01;
  constexpr double kBrightest = 20.0;
  const std::array<double, 3> times = {1.0 / 32.0, 0.25, 2.0};
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
  MeasureOptions options;
  options.noise = kNoise;
  const Result<Measurement> m =
      Measure(frames, Projection::Equirectangular(512, 256), *Response::Linear(), 8, {}, options);
  ASSERT_TRUE(m);
  double squares = 0.0;
  double bound = 0.0;
  double usable_squares = 0.0;
  double usable_bound = 0.0;
  int usable = 0;
  for (int y = 0; y < 256; ++y) {
    for (int x = 0; x < 512; ++x) {
      const double e = truth.at(x, y, 1);
      // Fisher information of ln E in the frames that are not clipped.
      double information = 0.0;
      for (const double t : times) {
        const double z = 128.0 * e * t;
        if (z <= 245.0) information += z * z / kNoise.VarianceOfValue(z);
      }
      EXPECT_GT(m->radiance.at(x, y, 1), 0.0F);
      const double error = std::log(m->radiance.at(x, y, 1) / e);
      squares += error * error;
      bound += 1.0 / information;
      if (m->flags.at(x, y) != 0) continue;
      ++usable;
      usable_squares += error * error;
      usable_bound += 1.0 / information;
    }
  }
  const double rms = std::sqrt(usable_squares / usable);
  const double best = std::sqrt(usable_bound / usable);
  RecordProperty("rms_ln_usable", fmt::format("{:.4f}", rms));
  RecordProperty("bound_usable", fmt::format("{:.4f}", best));
  RecordProperty("rms_ln_all", fmt::format("{:.4f}", std::sqrt(squares / (512 * 256))));
  RecordProperty("bound_all", fmt::format("{:.4f}", std::sqrt(bound / (512 * 256))));
  EXPECT_GT(usable, 512 * 256 * 3 / 4);
  EXPECT_LE(rms, 0.030);
  EXPECT_LE(rms, 1.15 * best);
  // Below the usable range the longest exposure alone speaks, and still says what it can.
  EXPECT_LE(std::sqrt(squares / bound), 1.3);
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

}  // namespace
}  // namespace omnihdr
