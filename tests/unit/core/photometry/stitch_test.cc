#include "core/photometry/stitch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <numbers>

#include "core/base/parallel_for.h"
#include "tests/support/ring.h"

namespace omnihdr::stitch_test {
namespace {

using ::testing::HasSubstr;
using testing::MakeRing;
using testing::RingOptions;
using testing::ShootRing;

constexpr double kFar = 10.0;  // radius of the scenes

// Smooth and different in every direction and channel, around 1.
Eigen::Vector3d Smooth(const Eigen::Vector3d& point) {
  const Eigen::Vector3d u = point.normalized();
  return {1.0 + 0.4 * u.x() + 0.2 * std::sin(3.0 * u.y()), 0.9 + 0.3 * u.y() - 0.2 * u.z(),
          0.8 + 0.3 * u.z() + 0.2 * std::cos(4.0 * u.x())};
}
Eigen::Vector3d Grey(const Eigen::Vector3d& /*point*/) { return {0.7, 0.7, 0.7}; }

Exposure Seconds(double seconds) { return {ExposureTime::Seconds(seconds), GainDb{}}; }

MeasureOptions Options() {
  MeasureOptions options;
  options.noise.read = 0.5;
  return options;
}

Measurement StitchFrames(Stitcher& stitcher, const std::vector<RigFrame>& frames, int bits = 8,
                         const std::vector<Response>& responses = {*Response::Linear()}) {
  Measurement m;
  const Status stitched = stitcher.Stitch(frames, responses, bits, Options(), &m);
  EXPECT_TRUE(stitched) << (stitched ? "" : stitched.error().message);
  return m;
}

Measurement StitchOne(const Rig& rig, const DecodedImage& image, double seconds, int width = 256,
                      int bits = 8) {
  Stitcher stitcher =
      Stitcher::Create(rig, Projection::Equirectangular(width, width / 2), {}).value();
  return StitchFrames(stitcher, {{&image, {Seconds(seconds)}}}, bits);
}

// Largest and root mean square relative error of the pixels seen.
struct Errors {
  double largest = 0.0;
  double rms = 0.0;
};
Errors Compare(const Measurement& m, const testing::RadianceAt& scene) {
  Errors errors;
  double sum = 0.0;
  int count = 0;
  for (int y = 0; y < m.radiance.height(); ++y) {
    for (int x = 0; x < m.radiance.width(); ++x) {
      if ((m.flags.at(x, y) & kMasked) != 0) continue;
      const Eigen::Vector3d truth = scene(m.projection.RayFromPixel(x + 0.5, y + 0.5) * kFar);
      for (int c = 0; c < 3; ++c) {
        const double e = std::abs(m.radiance.at(x, y, c) / truth[c] - 1.0);
        errors.largest = std::max(errors.largest, e);
        sum += e * e;
        ++count;
      }
    }
  }
  errors.rms = std::sqrt(sum / std::max(1, count));
  return errors;
}

int Count(const Measurement& m, std::uint8_t flag) {
  return static_cast<int>(std::count_if(m.flags.values().begin(), m.flags.values().end(),
                                        [flag](std::uint8_t f) { return (f & flag) != 0; }));
}

TEST(Stitch, APictureIsTheSceneItsSensorsSaw) {
  const Rig rig = MakeRing();
  const DecodedImage words = ShootRing(rig, Smooth, kFar, 1.0, 14);
  const Errors exact = Compare(StitchOne(rig, words, 1.0, 256, 14), Smooth);
  EXPECT_LT(exact.largest, 0.004);
  EXPECT_LT(exact.rms, 0.001);
  const DecodedImage bytes = ShootRing(rig, Smooth, kFar, 1.0);
  const Errors rounded = Compare(StitchOne(rig, bytes, 1.0), Smooth);
  EXPECT_LT(rounded.largest, 0.02);  // half a step at the dark corners
  EXPECT_LT(rounded.rms, 0.004);
}

TEST(Stitch, WithoutItsVignettingGainOrOffsetARigDoesNotGiveTheScene) {
  const Rig rig = MakeRing({.offset_m = 0.3});
  const DecodedImage image = ShootRing(rig, Smooth, kFar, 1.0, 14);
  const double right = Compare(StitchOne(rig, image, 1.0, 256, 14), Smooth).rms;
  Rig wrong = rig;
  for (RigSensor& sensor : wrong.sensors) sensor.vignetting = {};
  EXPECT_GT(Compare(StitchOne(wrong, image, 1.0, 256, 14), Smooth).rms, 20.0 * right);
  wrong = rig;
  wrong.sensors[2].gain = {1.0, 1.0, 1.0};
  EXPECT_GT(Compare(StitchOne(wrong, image, 1.0, 256, 14), Smooth).rms, 20.0 * right);
  wrong = rig;
  wrong.sphere_radius_m = 1.0;  // the scene is not there
  EXPECT_GT(Compare(StitchOne(wrong, image, 1.0, 256, 14), Smooth).rms, 20.0 * right);
}

TEST(Stitch, BytesOfALinearSensorGiveWhatTheMergedMosaicGives) {
  const Rig rig = MakeRing();
  const testing::RadianceAt scene = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(Smooth(p) * (p.y() > 0.0 ? 2.5 : 0.08));  // clipped left, dark right
  };
  const DecodedImage bytes = ShootRing(rig, scene, kFar, 1.0);
  // The same values in 16 bits go the long way.
  const auto& narrow = std::get<Image<std::uint8_t>>(bytes.pixels);
  Image<std::uint16_t> wide(narrow.width(), narrow.height(), 1);
  std::copy(narrow.values().begin(), narrow.values().end(), wide.values().begin());
  const DecodedImage words{std::move(wide)};
  const Measurement a = StitchOne(rig, bytes, 1.0);
  const Measurement b = StitchOne(rig, words, 1.0);
  EXPECT_GT(Count(a, kSaturatedAny), 1000);
  EXPECT_GT(Count(a, kDarkAny), 1000);
  EXPECT_EQ(std::memcmp(a.flags.data(), b.flags.data(), a.flags.size()), 0);
  for (std::size_t i = 0; i < a.radiance.size(); ++i) {
    ASSERT_NEAR(a.radiance.data()[i], b.radiance.data()[i], 3e-5F * (0.03F + a.radiance.data()[i]));
  }
  EXPECT_EQ(a.variance_floor, b.variance_floor);
  EXPECT_EQ(a.saturation, b.saturation);
}

TEST(Stitch, EveryBayerOrderGivesTheSamePicture) {
  const testing::RadianceAt scene = [](const Eigen::Vector3d&) {
    return Eigen::Vector3d(1.2, 0.6, 0.3);
  };
  for (const BayerOrder order :
       {BayerOrder::kRggb, BayerOrder::kGrbg, BayerOrder::kGbrg, BayerOrder::kBggr}) {
    const Rig rig = MakeRing({.bayer = order, .vignetting = {}, .equal_gains = true});
    const Errors errors =
        Compare(StitchOne(rig, ShootRing(rig, scene, kFar, 1.0, 14), 1.0, 256, 14), scene);
    EXPECT_LT(errors.largest, 2e-4) << ToString(order);
  }
}

TEST(Stitch, ForwardIsTheCentreUpIsUpAndWritingIsNotMirrored) {
  // A letter F ahead, 40 degrees tall: what a person sees who looks along +X with +Z up.
  constexpr const char* kLetter[5] = {"#####", "#....", "####.", "#....", "#...."};
  const testing::RadianceAt scene = [&](const Eigen::Vector3d& p) -> Eigen::Vector3d {
    const double right = std::atan2(-p.y(), p.x()) * 180.0 / std::numbers::pi;
    const double up = std::asin(p.normalized().z()) * 180.0 / std::numbers::pi;
    const int column = static_cast<int>(std::floor((right + 20.0) / 8.0));
    const int row = static_cast<int>(std::floor((20.0 - up) / 8.0));
    const bool ink =
        column >= 0 && column < 5 && row >= 0 && row < 5 && kLetter[row][column] == '#';
    return Eigen::Vector3d::Constant(ink ? 0.2 : 1.0);
  };
  const Rig rig = MakeRing({.width = 256, .height = 192});
  const Measurement m = StitchOne(rig, ShootRing(rig, scene, kFar, 1.0), 1.0, 360);
  for (int row = 0; row < 5; ++row) {
    for (int column = 0; column < 5; ++column) {
      const int x = 180 - 20 + 8 * column + 4;
      const int y = 90 - 20 + 8 * row + 4;
      EXPECT_NEAR(m.radiance.at(x, y, 1), kLetter[row][column] == '#' ? 0.2 : 1.0, 0.05)
          << row << " " << column;
    }
  }
}

TEST(Stitch, AClippedMosaicValueFlagsItsColourInThePixelsMadeFromItAndNothingElse) {
  const Rig rig = MakeRing({.vignetting = {}, .equal_gains = true});
  for (int dy = 0; dy < 2; ++dy) {
    for (int dx = 0; dx < 2; ++dx) {
      DecodedImage image = ShootRing(rig, Grey, kFar, 1.0);
      const int x = 64 + dx;
      const int y = 48 + dy;
      const int channel = BayerChannel(BayerOrder::kBggr, x, y);
      std::get<Image<std::uint8_t>>(image.pixels).at(x, y) = 255;  // in sensor 0
      const Measurement m = StitchOne(rig, image, 1.0, 512);
      const std::uint8_t bit = channel == 0   ? kSaturatedR
                               : channel == 1 ? kSaturatedG
                                              : kSaturatedB;
      int flagged = 0;
      for (int v = 0; v < m.flags.height(); ++v) {
        for (int u = 0; u < m.flags.width(); ++u) {
          const auto pixel = SensorPixelFromRay(
              rig.sensors[0], m.projection.RayFromPixel(u + 0.5, v + 0.5), rig.sphere_radius_m);
          // Within the reach of bilinear interpolation between values two pixels apart.
          const double reach =
              pixel ? std::max(std::abs(pixel->x() - 0.5 - x), std::abs(pixel->y() - 0.5 - y))
                    : 9.0;
          const std::uint8_t f = m.flags.at(u, v);
          if (f == kMasked) continue;
          if (reach < 1.99) {
            EXPECT_EQ(f, bit) << u << " " << v << " reach " << reach;
            ++flagged;
          } else if (reach > 2.01) {
            EXPECT_EQ(f, 0) << u << " " << v << " reach " << reach;
          }
        }
      }
      EXPECT_GT(flagged, 10);
    }
  }
}

TEST(Stitch, WhatIsClippedAltogetherIsNeutralAtABoundThatHoldsWhateverTheGains) {
  const testing::RadianceAt bright = [](const Eigen::Vector3d&) {
    return Eigen::Vector3d(9.0, 8.0, 7.0);
  };
  for (const BayerOrder order : {BayerOrder::kBggr, BayerOrder::kNone}) {
    const Rig rig = MakeRing({.bayer = order});
    const Measurement m = StitchOne(rig, ShootRing(rig, bright, kFar, 1.0), 1.0);
    for (int y = 0; y < 128; ++y) {
      for (int x = 0; x < 256; ++x) {
        if (m.flags.at(x, y) == kMasked) continue;
        ASSERT_EQ(m.flags.at(x, y), kSaturatedAny);
        EXPECT_EQ(m.radiance.at(x, y, 0), m.radiance.at(x, y, 1));
        EXPECT_EQ(m.radiance.at(x, y, 2), m.radiance.at(x, y, 1));
        EXPECT_GT(m.radiance.at(x, y, 1), 1.5F);
        EXPECT_LT(m.radiance.at(x, y, 1), 7.0F);
      }
    }
  }
}

// A ring's frame of a grey world in which sensor 0 has clipped everywhere, stitched.
struct ClippedSensor {
  Rig rig = MakeRing({.vignetting = {}, .equal_gains = true});
  StitchTable table = BuildStitchTable(rig, SphereGrid::Equirectangular(256, 128), {}).value();
  Measurement measurement;
  explicit ClippedSensor(double seconds) {
    DecodedImage image = ShootRing(rig, Grey, kFar, seconds);
    auto& pixels = std::get<Image<std::uint8_t>>(image.pixels);
    for (int y = 0; y < 96; ++y) std::fill_n(pixels.row(y), 128, std::uint8_t{255});
    Stitcher stitcher = Stitcher::Create(rig, Projection::Equirectangular(256, 128), {}).value();
    measurement = StitchFrames(stitcher, {{&image, {Seconds(1.0)}}});
  }
};

TEST(Stitch, AClippedSensorDoesNotEnterABlendWithOneThatIsNot) {
  const ClippedSensor stitched(1.6);  // grey: 143
  const Measurement& m = stitched.measurement;
  int blends = 0;
  int alone = 0;
  for (int y = 0; y < 128; ++y) {
    for (const StitchSegment& segment : stitched.table.rows[static_cast<std::size_t>(y)]) {
      const bool has_0 = segment.sensors[0] == 0;
      for (int x = segment.x0; x < segment.x1; ++x) {
        if (has_0 && segment.count == 1) {
          EXPECT_EQ(m.flags.at(x, y), kSaturatedAny);
          EXPECT_NEAR(m.radiance.at(x, y, 1), 255.0 / 128.0, 1e-5);
          ++alone;
        } else {
          EXPECT_EQ(m.flags.at(x, y), 0);
          EXPECT_NEAR(m.radiance.at(x, y, 1), 143.0 / 128.0, 1e-5);
          blends += has_0 ? 1 : 0;
        }
      }
    }
  }
  EXPECT_GT(blends, 100);
  EXPECT_GT(alone, 1000);
}

// Not aligned for its distance, one of them sees past the edge of something bright.
TEST(Stitch, AValueFarBelowWhatAClippedSensorProvesIsLeftOutWhereThatOneHasTheLargerShare) {
  const ClippedSensor stitched(0.2);  // grey: 18
  const Measurement& m = stitched.measurement;
  int bright = 0;
  int dark = 0;
  for (int y = 0; y < 128; ++y) {
    for (const StitchSegment& segment : stitched.table.rows[static_cast<std::size_t>(y)]) {
      if (segment.sensors[0] != 0 || segment.count < 2) continue;
      for (int x = segment.x0; x < segment.x1; ++x) {
        const bool is_bound = (m.flags.at(x, y) & kSaturatedAny) == kSaturatedAny;
        EXPECT_NEAR(m.radiance.at(x, y, 1), (is_bound ? 255.0 : 18.0) / 128.0, 1e-5);
        bright += is_bound ? 1 : 0;
        dark += is_bound ? 0 : 1;
      }
    }
  }
  EXPECT_GT(bright, 100);
  EXPECT_GT(dark, 100);
}

// Share of every sensor in every pixel.
std::vector<Image<float>> SharesOf(const StitchTable& table, std::size_t sensors) {
  std::vector<Image<float>> shares;
  for (std::size_t s = 0; s < sensors; ++s) shares.emplace_back(table.width, table.height, 1);
  for (int y = 0; y < table.height; ++y) {
    for (const StitchSegment& segment : table.rows[static_cast<std::size_t>(y)]) {
      for (std::size_t k = 0; k < segment.count; ++k) {
        for (int x = segment.x0; x < segment.x1; ++x) {
          const std::size_t i = segment.first +
                                k * static_cast<std::size_t>(segment.x1 - segment.x0) +
                                static_cast<std::size_t>(x - segment.x0);
          shares[segment.sensors[k]].at(x, y) =
              static_cast<float>(ShareOf(table.packed[i])) / static_cast<float>(kFullShare);
        }
      }
    }
  }
  return shares;
}

TEST(StitchTable, SharesSumToOneAndFadeOverTheBlendWidthWithoutAStep) {
  const Rig rig = MakeRing({.width = 256, .height = 192, .blend_width_deg = 8.0});
  const Projection projection = Projection::Equirectangular(720, 360);
  const StitchTable table = BuildStitchTable(rig, SphereGrid(projection), {}).value();
  const std::vector<Image<float>> shares = SharesOf(table, 6);
  double largest_step = 0.0;
  int mixed = 0;
  for (int y = 0; y < 300; ++y) {
    for (int x = 0; x < 720; ++x) {
      double sum = 0.0;
      bool is_mixed = false;
      for (const Image<float>& share : shares) {
        sum += share.at(x, y);
        is_mixed = is_mixed || (share.at(x, y) > 0.02F && share.at(x, y) < 0.98F);
        if (y > 60 && y < 180 && x > 0) {  // where a column is half a degree
          largest_step =
              std::max<double>(largest_step, std::abs(share.at(x, y) - share.at(x - 1, y)));
        }
      }
      mixed += y == 180 && is_mixed ? 1 : 0;
      if (sum == 0.0) continue;  // below the sensors
      EXPECT_NEAR(sum, 1.0, 3e-4) << x << " " << y;
    }
  }
  // On the horizon, five seams of 8 degrees at half a degree a pixel.
  EXPECT_NEAR(mixed, 5 * 16, 10);
  // 0.5 degrees of 8, with some room for the edge map's nodes.
  EXPECT_LT(largest_step, 0.12);
}

TEST(StitchTable, TheSeamLiesMidwayAndANarrowOneTakesNoMoreThanItsWidth) {
  const Rig rig = MakeRing({.width = 256, .height = 192, .offset_m = 0.0, .blend_width_deg = 0.0});
  const StitchTable table =
      BuildStitchTable(rig, SphereGrid::Equirectangular(720, 360), {}).value();
  const auto& row = table.rows[180];
  // Sensor 0 ahead, then to the right 1, 2, …: the seams are at ±36, ±108, 180 degrees.
  ASSERT_GE(row.size(), 6U);
  std::map<int, int> pixels;
  for (const StitchSegment& segment : row) {
    if (segment.count == 1) pixels[segment.sensors[0]] += segment.x1 - segment.x0;
  }
  for (int s = 0; s < 5; ++s) EXPECT_NEAR(pixels[s], 144, 5) << s;
}

TEST(StitchTable, AMaskOnASensorIsFadedOutOfAndOneOnThePanoramaCutsSharply) {
  const Rig rig = MakeRing({.width = 256, .height = 192, .blend_width_deg = 4.0});
  const Projection projection = Projection::Equirectangular(360, 180);
  Image<std::uint8_t> sensors(256, 6 * 192, 1, 255);
  for (int y = 0; y < 192; ++y) {
    for (int x = 0; x < 256; ++x) {
      if (y > 120) sensors.at(x, y) = 0;  // a part of sensor 0 that sensor 4 sees at its rim
    }
  }
  Image<std::uint8_t> panorama(360, 180, 1, 255);
  for (int y = 100; y < 180; ++y) std::fill_n(panorama.row(y) + 170, 20, std::uint8_t{0});
  const StitchTable plain = BuildStitchTable(rig, SphereGrid(projection), {}).value();
  const StitchTable masked =
      BuildStitchTable(rig, SphereGrid(projection), {sensors.view(), panorama.view()}).value();
  const std::vector<Image<float>> before = SharesOf(plain, 6);
  const std::vector<Image<float>> after = SharesOf(masked, 6);
  int lost = 0;
  for (int y = 0; y < 180; ++y) {
    for (int x = 0; x < 360; ++x) {
      const bool cut = panorama.at(x, y) == 0;
      const auto pixel = SensorPixelFromRay(
          rig.sensors[0], projection.RayFromPixel(x + 0.5, y + 0.5), rig.sphere_radius_m);
      if (cut || (pixel && pixel->y() > 121.0)) {
        EXPECT_EQ(after[0].at(x, y), 0.0F) << x << " " << y;
      }
      lost += !cut && before[0].at(x, y) > 0.5F && after[0].at(x, y) == 0.0F ? 1 : 0;
      float sum = 0.0F;
      for (const Image<float>& share : after) sum += share.at(x, y);
      if (cut) {
        EXPECT_EQ(sum, 0.0F);
      }
    }
  }
  EXPECT_GT(lost, 100);
}

TEST(Stitch, WhereNoSensorSeesThePixelIsMaskedAndReadsNothing) {
  const Rig rig = MakeRing();
  Measurement m = StitchOne(rig, ShootRing(rig, Grey, kFar, 1.0), 1.0);
  EXPECT_EQ(m.flags.at(0, 127), kMasked);  // straight down
  EXPECT_EQ(m.radiance.at(0, 127, 0), 0.0F);
  EXPECT_EQ(m.radiance.at(0, 127, 3), 0.0F);
  EXPECT_EQ(m.flags.at(128, 64), 0);
  EXPECT_EQ(m.radiance.at(128, 64, 3), 1.0F);
  // Memory that is used again keeps nothing of what it held.
  Stitcher stitcher = Stitcher::Create(rig, Projection::Equirectangular(256, 128), {}).value();
  for (float& v : m.radiance.values()) v = 77.0F;
  for (std::uint8_t& f : m.flags.values()) f = 77;
  const DecodedImage image = ShootRing(rig, Grey, kFar, 1.0);
  const std::vector<RigFrame> frames = {{&image, {Seconds(1.0)}}};
  ASSERT_TRUE(stitcher.Stitch(frames, std::vector{*Response::Linear()}, 8, Options(), &m));
  EXPECT_EQ(m.flags.at(0, 127), kMasked);
  EXPECT_EQ(m.radiance.at(0, 127, 0), 0.0F);
}

TEST(Stitch, NoiseOfThePanoramaIsWhatTheMeasurementSays) {
  const Rig rig = MakeRing({.width = 192, .height = 144});
  constexpr double kRms = 3.0;
  Stitcher stitcher = Stitcher::Create(rig, Projection::Equirectangular(256, 128), {}).value();
  MeasureOptions options;
  options.noise = {.read = kRms, .gain = 0.0, .prnu = 0.0};
  std::array<double, 3> squares{};
  double count = 0.0;
  std::array<float, 3> said{};
  const DecodedImage clean = ShootRing(rig, Grey, kFar, 1.0, 14);
  Measurement truth = StitchFrames(stitcher, {{&clean, {Seconds(1.0)}}}, 14);
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const DecodedImage noisy = ShootRing(rig, Grey, kFar, 1.0, 14, kRms, seed);
    Measurement m;
    ASSERT_TRUE(stitcher.Stitch(std::vector<RigFrame>{{&noisy, {Seconds(1.0)}}},
                                std::vector{*Response::Linear()}, 14, options, &m));
    said = m.variance_floor;
    for (int y = 0; y < 128; ++y) {
      for (int x = 0; x < 256; ++x) {
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
    // The 1/12 of rounding that the model adds does not happen at 14 bits.
    const double expected = said[c] * kRms * kRms / (kRms * kRms + 1.0 / 12.0);
    EXPECT_NEAR(squares[c] / count / expected, 1.0, 0.06) << c;
  }
  // Two greens of the tile and bilinear weights: well below that of a raw value.
  EXPECT_LT(said[1], 0.5F * static_cast<float>(kRms * kRms / (128.0 * 128.0)));
}

TEST(Stitch, ABracketRecoversWhatItsFramesClipAndItsOrderDoesNotMatter) {
  const Rig rig = MakeRing();
  const testing::RadianceAt scene = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(Smooth(p) * std::pow(10.0, 0.12 * p.x()));  // 2.4 decades
  };
  const DecodedImage a = ShootRing(rig, scene, kFar, 1.0);
  const DecodedImage b = ShootRing(rig, scene, kFar, 0.25);
  const DecodedImage c = ShootRing(rig, scene, kFar, 0.0625);
  Stitcher stitcher = Stitcher::Create(rig, Projection::Equirectangular(256, 128), {}).value();
  const RigFrame fa{&a, {Seconds(1.0)}};
  const RigFrame fb{&b, {Seconds(0.25)}};
  const RigFrame fc{&c, {Seconds(0.0625)}};
  const Measurement one = StitchFrames(stitcher, {fa});
  EXPECT_GT(Count(one, kSaturatedAny), 3000);
  const Measurement three = StitchFrames(stitcher, {fa, fb, fc});
  EXPECT_EQ(Count(three, kSaturatedAny), 0);
  const Errors errors = Compare(three, scene);
  EXPECT_LT(errors.rms, 0.02);
  const Measurement again = StitchFrames(stitcher, {fc, fa, fb});
  for (std::size_t i = 0; i < three.radiance.size(); ++i) {
    ASSERT_NEAR(three.radiance.data()[i], again.radiance.data()[i],
                1e-5F * (1e-3F + three.radiance.data()[i]));
  }
  EXPECT_EQ(std::memcmp(three.flags.data(), again.flags.data(), three.flags.size()), 0);
  EXPECT_DOUBLE_EQ(three.longest_exposure_s, 1.0);
  EXPECT_NEAR(three.shortest_exposure_s, 0.0625, 1e-7);
}

TEST(Stitch, SensorsOfFinishedColourWithExposuresAndResponsesOfTheirOwn) {
  Rig rig = MakeRing({.bayer = BayerOrder::kNone});
  const DecodedImage image = ShootRing(rig, Smooth, kFar, 1.0, 14);
  EXPECT_LT(Compare(StitchOne(rig, image, 1.0, 256, 14), Smooth).largest, 0.004);
  // Said to be exposed twice as long: half the radiance, for that sensor alone.
  Stitcher stitcher = Stitcher::Create(rig, Projection::Equirectangular(256, 128), {}).value();
  std::vector<Exposure> exposures(6, Seconds(1.0));
  exposures[0] = Seconds(2.0);
  const Measurement m = StitchFrames(stitcher, {{&image, exposures}}, 14);
  EXPECT_NEAR(m.radiance.at(128, 64, 1), 0.5 * Smooth({kFar, 0, 0}).y(), 0.01);
  EXPECT_NEAR(m.radiance.at(0, 64, 1), Smooth({-kFar, 0, 0}).y(), 0.01);
  // A black level of its own takes that much away.
  std::vector<Response> responses(6, *Response::Linear());
  responses[0] = *Response::Linear(16.0);
  const Measurement with_black = StitchFrames(stitcher, {{&image, {Seconds(1.0)}}}, 14, responses);
  EXPECT_NEAR(with_black.radiance.at(128, 64, 1),
              (128.0 * Smooth({kFar, 0, 0}).y() - 16.0) / (128.0 - 16.0), 0.01);
  EXPECT_NEAR(with_black.radiance.at(0, 64, 1), Smooth({-kFar, 0, 0}).y(), 0.01);
}

TEST(Stitch, AnRdMapIsStitchedStraightFromTheMosaic) {
  const Rig rig = MakeRing();
  const DecodedImage image = ShootRing(rig, Smooth, kFar, 1.0, 14);
  const SphereGrid grid = SphereGrid::RhombicDodecahedron(64);
  Stitcher stitcher = Stitcher::Create(rig, grid, {}).value();
  const Measurement m = StitchFrames(stitcher, {{&image, {Seconds(1.0)}}}, 14);
  ASSERT_EQ(m.radiance.width(), 256);
  ASSERT_EQ(m.radiance.height(), 192);
  int seen = 0;
  for (int y = 0; y < 192; ++y) {
    for (int x = 0; x < 256; ++x) {
      if ((m.flags.at(x, y) & kMasked) != 0) continue;
      ++seen;
      const Eigen::Vector3d truth = Smooth(grid.RayFromPixel(x + 0.5, y + 0.5).value() * kFar);
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(m.radiance.at(x, y, c) / truth[c], 1.0, 0.005);
    }
  }
  // Pixels are nearly equal on the sphere: their share is that of the sphere seen, which the
  // sensors see down to about 60 degrees below the horizon.
  EXPECT_NEAR(seen / (256.0 * 192.0), 0.93, 0.04);
  EXPECT_EQ(m.projection.width(), 0);
}

TEST(Stitch, TheSameBytesOnOneCoreAndOnTwo) {
  const Rig rig = MakeRing();
  const DecodedImage image = ShootRing(rig, Smooth, kFar, 1.0, 8, 2.0);
  SetWorkerCount(1);
  const Measurement one = StitchOne(rig, image, 1.0);
  SetWorkerCount(2);
  const Measurement two = StitchOne(rig, image, 1.0);
  SetWorkerCount(0);
  EXPECT_EQ(std::memcmp(one.radiance.data(), two.radiance.data(), 4 * one.radiance.size()), 0);
  EXPECT_EQ(std::memcmp(one.flags.data(), two.flags.data(), one.flags.size()), 0);
  EXPECT_EQ(one.variance_floor, two.variance_floor);
}

TEST(Stitch, WhatDoesNotFitIsRefusedWithWhatWasExpected) {
  const Rig rig = MakeRing();
  const Projection projection = Projection::Equirectangular(256, 128);
  Stitcher stitcher = Stitcher::Create(rig, projection, {}).value();
  Measurement m;
  const auto say = [&](const RigFrame& frame) {
    const Status status =
        stitcher.Stitch(std::vector{frame}, std::vector{*Response::Linear()}, 8, Options(), &m);
    return status ? std::string() : status.error().message;
  };
  const DecodedImage small{Image<std::uint8_t>(128, 95, 1)};
  EXPECT_THAT(say({&small, {Seconds(1.0)}}), HasSubstr("128x95, expected 128x576"));
  const DecodedImage colour{Image<std::uint8_t>(128, 576, 3)};
  EXPECT_THAT(say({&colour, {Seconds(1.0)}}), HasSubstr("3 channels, expected 1"));
  const DecodedImage good{Image<std::uint8_t>(128, 576, 1)};
  EXPECT_THAT(say({&good, {Seconds(1.0), Seconds(2.0)}}), HasSubstr("2 exposures"));
  EXPECT_THAT(say({&good, {Seconds(0.0)}}), HasSubstr("exposure 0 s"));
  EXPECT_EQ(say({&good, {Seconds(1.0)}}), "");
  const std::vector<RigFrame> none;
  EXPECT_FALSE(stitcher.Stitch(none, std::vector{*Response::Linear()}, 8, Options(), &m));

  Rig uneven = rig;
  uneven.sensors[3].lens = Lens::Fisheye(100, 96, {60, 60}, {50, 48}, {0, 0, 0, 0, 0}, 1.0).value();
  Result<Stitcher> refused = Stitcher::Create(uneven, projection, {});
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("\"sensor3\": 100 pixels wide"));
  const Image<std::uint8_t> mask(128, 96, 1, 255);
  refused = Stitcher::Create(rig, projection, {mask.view(), {}});
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("128x96, expected 128x576"));
  const Image<std::uint8_t> black(128, 576, 1, 0);
  refused = Stitcher::Create(rig, projection, {black.view(), {}});
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("no sensor"));
}

TEST(Stitch, TheNaturalWidthFollowsTheSensorsResolution) {
  const int narrow = NaturalPanoramaWidth(MakeRing({.width = 512, .height = 384}));
  const int wide = NaturalPanoramaWidth(MakeRing({.width = 1024, .height = 768}));
  EXPECT_EQ(wide % 64, 0);
  EXPECT_NEAR(wide, 2 * narrow, 64);
  EXPECT_EQ(NaturalPanoramaWidth(MakeRing({.width = 32768, .height = 16384})), 8192);
}

}  // namespace
}  // namespace omnihdr::stitch_test
