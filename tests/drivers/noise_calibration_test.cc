#include "core/photometry/noise_calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "drivers/sim/sensor.h"

namespace omnihdr::noise_calibration_test {
namespace {

using ::testing::HasSubstr;

// A flat, darker towards its corners, seen by a sensor of known noise.
std::vector<DecodedImage> Flats(const sim::SensorOptions& sensor,
                                const std::vector<double>& seconds, float texture = 0.0F) {
  Image<float> light(192, 144, 3);
  for (int y = 0; y < light.height(); ++y) {
    for (int x = 0; x < light.width(); ++x) {
      const float r = std::hypot(static_cast<float>(x) - 96.0F, static_cast<float>(y) - 72.0F);
      for (int c = 0; c < 3; ++c) {
        light.at(x, y, c) = 1.0F - 1e-5F * r * r + ((x / 3 + y / 3) % 2 == 0 ? texture : 0.0F);
      }
    }
  }
  std::vector<DecodedImage> flats;
  for (std::size_t k = 0; k < seconds.size(); ++k) {
    flats.push_back(DecodedImage{
        sim::Expose(light.view(), {ExposureTime::Seconds(seconds[k]), {}}, sensor, k)});
  }
  return flats;
}

std::vector<FlatPair> Pairs(const std::vector<DecodedImage>& flats) {
  std::vector<FlatPair> pairs;
  for (std::size_t k = 0; k + 1 < flats.size(); k += 2) {
    pairs.push_back({&flats[k], &flats[k + 1], "pair " + std::to_string(k / 2)});
  }
  return pairs;
}

const std::vector<double> kLevels = {0.06, 0.06, 0.15, 0.15, 0.4, 0.4, 0.9, 0.9, 1.7, 1.7};

struct Truth {
  double full_well_e;
  double read;
  double prnu;
};

class NoiseOf : public ::testing::TestWithParam<Truth> {};

TEST_P(NoiseOf, ASensorIsRecoveredWithinAFewPercent) {
  sim::SensorOptions sensor;
  sensor.full_well_e = GetParam().full_well_e;
  sensor.read_noise = GetParam().read;
  sensor.prnu = GetParam().prnu;
  const std::vector<DecodedImage> flats = Flats(sensor, kLevels);
  const Result<NoiseCalibration> noise = CalibrateNoise(Pairs(flats), {});
  ASSERT_TRUE(noise) << noise.error().message;
  EXPECT_NEAR(noise->full_well_e.value, sensor.full_well_e, 0.03 * sensor.full_well_e);
  EXPECT_NEAR(noise->read.value, sensor.read_noise, 0.03 * sensor.read_noise + 0.005);
  EXPECT_NEAR(noise->prnu.value, sensor.prnu, 0.03 * sensor.prnu + 0.0001);
  EXPECT_NEAR(noise->read_e.value, sensor.read_noise * sensor.full_well_e / 255.0,
              0.06 * sensor.read_noise * sensor.full_well_e / 255.0);
  EXPECT_GT(noise->r_squared, 0.99);
  EXPECT_LT(std::abs(noise->full_well_e.value - sensor.full_well_e),
            5.0 * noise->full_well_e.standard_error + 0.01 * sensor.full_well_e);
}

INSTANTIATE_TEST_SUITE_P(Sensors, NoiseOf,
                         ::testing::Values(Truth{20000, 0.5, 0.003}, Truth{5000, 1.5, 0.01},
                                           Truth{10000, 0.8, 0.02}));

TEST(NoiseCalibration, EachRefusalSaysWhy) {
  const auto expect = [](const std::vector<DecodedImage>& flats, const std::string& reason) {
    const Result<NoiseCalibration> noise = CalibrateNoise(Pairs(flats), {});
    ASSERT_FALSE(noise) << "expected: " << reason;
    EXPECT_EQ(noise.error().kind, ErrorKind::kData);
    EXPECT_THAT(noise.error().message, HasSubstr(reason));
  };
  const sim::SensorOptions sensor;
  expect({}, "no pairs");
  expect(Flats(sensor, {0.4, 0.5}), "pair 0: levels of");
  expect(Flats(sensor, {9.0, 9.0}), "values at an end of the range");
  expect(Flats(sensor, {1.0, 1.0}), "take pairs at several exposures");
  expect(Flats(sensor, {0.1, 0.1, 0.4, 0.4, 1.2, 1.2}, 0.4F), "not flat");
  std::vector<DecodedImage> sizes = Flats(sensor, {1.0, 1.0});
  sizes[1].pixels = Image<std::uint8_t>(10, 10, 3);
  expect(sizes, "expected two equal pictures");
  // One picture twice has no noise from frame to frame.
  std::vector<DecodedImage> same = Flats(sensor, {0.1, 0.1, 1.0, 1.0});
  for (const std::size_t k : {0U, 2U}) {
    same[k + 1].pixels = std::get<Image<std::uint8_t>>(same[k].pixels).Clone();
  }
  expect(same, "variance does not grow");
}

}  // namespace
}  // namespace omnihdr::noise_calibration_test
