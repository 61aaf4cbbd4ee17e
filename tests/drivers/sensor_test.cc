#include "drivers/sim/sensor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>

namespace omnihdr::sim::sensor_test {
namespace {

Exposure Seconds(double time, double gain_db = 0.0) {
  return {ExposureTime::Seconds(time), GainDb{gain_db}};
}

struct Statistics {
  double mean = 0.0;
  double variance = 0.0;
};
Statistics Measure(const Image<std::uint8_t>& image) {
  Statistics s;
  for (const std::uint8_t v : image.values()) s.mean += v;
  s.mean /= static_cast<double>(image.size());
  for (const std::uint8_t v : image.values()) s.variance += (v - s.mean) * (v - s.mean);
  s.variance /= static_cast<double>(image.size());
  return s;
}

TEST(Sensor, RadianceOneForOneSecondGivesTheValue128) {
  const Image<float> radiance(400, 200, 3, 1.0F);
  EXPECT_NEAR(Measure(Expose(radiance, Seconds(1.0), {}, 0)).mean, 128.0, 0.05);
  EXPECT_NEAR(Measure(Expose(radiance, Seconds(0.5), {}, 0)).mean, 64.0, 0.05);
  EXPECT_NEAR(Measure(Expose(radiance, Seconds(0.1, 20.0), {}, 0)).mean, 128.0, 0.05);
}

TEST(Sensor, TheVarianceIsThatOfTheNoiseModel) {
  SensorOptions options;
  options.full_well_e = 5000.0;
  options.read_noise = 0.8;
  options.prnu = 0.004;
  for (const double gain_db : {0.0, 6.0}) {
    const double gain = std::pow(10.0, gain_db / 20.0);
    for (const double value : {15.0, 60.0, 128.0, 200.0}) {
      const Image<float> radiance(500, 400, 3, static_cast<float>(value / 128.0 / gain));
      const Statistics s = Measure(Expose(radiance, Seconds(1.0, gain_db), options, 3));
      const double expected = gain * 255.0 / 5000.0 * value + gain * gain * 0.64 +
                              std::pow(0.004 * value, 2) + 1.0 / 12.0;
      EXPECT_NEAR(s.mean, value, 0.03) << value;
      EXPECT_NEAR(s.variance / expected, 1.0, 0.02) << value << " at " << gain_db << " dB";
    }
  }
}

TEST(Sensor, ItClipsAtBothEndsAndNeverWrapsRound) {
  const Image<float> bright(64, 64, 3, 1e9F);
  const Image<std::uint8_t> full = Expose(bright, Seconds(1.0), {}, 0);
  EXPECT_TRUE(std::all_of(full.values().begin(), full.values().end(),
                          [](std::uint8_t v) { return v == 255; }));
  const Image<float> dark(64, 64, 3, 0.0F);
  SensorOptions noisy;
  noisy.read_noise = 3.0;
  const Image<std::uint8_t> empty = Expose(dark, Seconds(1.0), noisy, 0);
  EXPECT_EQ(*std::min_element(empty.values().begin(), empty.values().end()), 0);
  EXPECT_LT(*std::max_element(empty.values().begin(), empty.values().end()), 16);
}

TEST(Sensor, NoiseFollowsFromTheSeedAndTheFrameAlone) {
  const Image<float> radiance(64, 64, 3, 1.0F);
  const auto same = [](const Image<std::uint8_t>& a, const Image<std::uint8_t>& b) {
    return std::memcmp(a.data(), b.data(), a.size()) == 0;
  };
  SensorOptions options;
  const Image<std::uint8_t> first = Expose(radiance, Seconds(1.0), options, 7);
  EXPECT_TRUE(same(first, Expose(radiance, Seconds(1.0), options, 7)));
  EXPECT_FALSE(same(first, Expose(radiance, Seconds(1.0), options, 8)));
  options.seed = 2;
  EXPECT_FALSE(same(first, Expose(radiance, Seconds(1.0), options, 7)));
}

TEST(Sensor, NoiseOfNeighboursChannelsAndFramesIsUncorrelated) {
  const Image<float> radiance(400, 300, 3, 1.0F);
  SensorOptions options;
  options.prnu = 0.0;
  options.full_well_e = 2000.0;
  const Image<std::uint8_t> a = Expose(radiance, Seconds(1.0), options, 1);
  const Image<std::uint8_t> b = Expose(radiance, Seconds(1.0), options, 2);
  const Statistics s = Measure(a);
  double next = 0.0;
  double channel = 0.0;
  double frame = 0.0;
  int count = 0;
  for (int y = 0; y < a.height(); ++y) {
    for (int x = 0; x + 1 < a.width(); ++x) {
      const double d = a.at(x, y, 0) - s.mean;
      next += d * (a.at(x + 1, y, 0) - s.mean);
      channel += d * (a.at(x, y, 1) - s.mean);
      frame += d * (b.at(x, y, 0) - s.mean);
      ++count;
    }
  }
  for (const double sum : {next, channel, frame}) {
    EXPECT_LT(std::abs(sum / count / s.variance), 0.015);
  }
}

TEST(Sensor, OptionsOutOfRangeAreNamed) {
  SensorOptions options;
  EXPECT_TRUE(options.Validate());
  options.full_well_e = 0.0;
  const Status status = options.Validate();
  ASSERT_FALSE(status);
  EXPECT_NE(status.error().message.find("full_well_e: 0"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::sim::sensor_test
