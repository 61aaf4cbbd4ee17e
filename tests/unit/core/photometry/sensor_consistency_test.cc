#include "core/photometry/sensor_consistency.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace omnihdr::sensor_consistency_test {
namespace {

struct Truth {
  std::array<double, 3> sensitivity = {1.0, 1.0, 1.0};
  double bend = 0.0;  // value = E·(1 − bend·E): not linear
};

// A chart as the sensor would read it, with `noise` relative to each value.
SensorChart Chart(int sensor, const Truth& truth, double seconds, double noise,
                  std::mt19937* random) {
  std::normal_distribution<double> normal(0.0, 1.0);
  SensorChart out;
  out.sensor = sensor;
  out.seconds = seconds;
  for (int p = 0; p < kChartPatches; ++p) {
    const std::array<double, 3> light = ChartLinearLight(p);
    for (std::size_t c = 0; c < 3; ++c) {
      // Greys exactly neutral: the truth the gains are held against.
      const double l = p >= kChartFirstGrey ? light[1] : light[c];
      double e = 100.0 * l * truth.sensitivity[c] * seconds;
      e *= 1.0 - truth.bend * e;
      e *= 1.0 + noise * normal(*random);
      PatchChannel& patch = out.chart[static_cast<std::size_t>(p)][c];
      patch.exposure = e;
      patch.exposure_error = std::max(noise, 1e-3) * e;
      patch.mean = patch.median = 128.0 * e;
      patch.pixels = 100;
      patch.usable = patch.mean > 4.0 && patch.mean < 250.0;
      patch.clipped = patch.mean >= 250.0 ? 1.0 : 0.0;
    }
  }
  return out;
}

const std::vector<double> kSeconds = {0.002, 0.004, 0.008, 0.012, 0.016};

TEST(SensorConsistency, GainsMakeSensorsAndChannelsAgree) {
  const std::vector<Truth> truth = {
      {{0.60, 1.00, 0.80}}, {{0.63, 1.04, 0.79}}, {{0.58, 0.97, 0.83}}};
  std::mt19937 random(11);
  std::vector<SensorChart> charts;
  for (int s = 0; s < 3; ++s) {
    for (const double t : kSeconds) {
      charts.push_back(Chart(s, truth[static_cast<std::size_t>(s)], t, 0.002, &random));
    }
  }
  const Result<SensorConsistency> result = CompareSensors(charts, {"a", "b", "c"});
  ASSERT_TRUE(result) << result.error().message;
  const double green = std::cbrt(1.00 * 1.04 * 0.97);
  for (std::size_t s = 0; s < 3; ++s) {
    for (std::size_t c = 0; c < 3; ++c) {
      const double expected = green / truth[s].sensitivity[c];
      EXPECT_NEAR(result->sensors[s].gain[c], expected, 0.005 * expected) << s << ' ' << c;
      EXPECT_LT(result->sensors[s].gain_error[c], 0.01);
    }
  }
  // Green: 1.00, 1.04, 0.97 about their mean 1.0033.
  EXPECT_NEAR(result->worst_difference[1], 0.0366, 0.004);
  EXPECT_LT(result->worst_difference_after[1], 0.005);
  EXPECT_TRUE(result->warnings.empty());
}

TEST(SensorConsistency, ALinearSensorHasRSquaredOfOneAndABentOneShowsIt) {
  std::mt19937 random(3);
  std::vector<SensorChart> charts;
  for (const double t : kSeconds) charts.push_back(Chart(0, {}, t, 0.0, &random));
  for (const double t : kSeconds) {
    charts.push_back(Chart(1, {{1.0, 1.0, 1.0}, 0.15}, t, 0.0, &random));
  }
  const Result<SensorConsistency> result = CompareSensors(charts, {"straight", "bent"});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_GT(result->sensors[0].least_r_squared[1], 1.0 - 1e-12);
  EXPECT_LT(result->sensors[0].worst_deviation[1], 1e-9);
  EXPECT_LT(result->sensors[1].least_r_squared[1], 0.999);
  EXPECT_GT(result->sensors[1].worst_deviation[1], 0.01);
  EXPECT_EQ(result->sensors[0].exposures, 5);
}

TEST(SensorConsistency, ExposuresInWhichAPatchClipsDoNotBendItsLine) {
  std::mt19937 random(3);
  std::vector<SensorChart> charts;
  for (const double t : {0.004, 0.008, 0.012, 0.03, 0.06}) {
    charts.push_back(Chart(0, {}, t, 0.0, &random));
  }
  const Result<SensorConsistency> result = CompareSensors(charts, {"a"});
  ASSERT_TRUE(result) << result.error().message;
  const ExposureLine& white = result->sensors[0].lines[18][1];
  EXPECT_EQ(white.points, 3);
  EXPECT_GT(white.r_squared, 1.0 - 1e-12);
  EXPECT_TRUE(std::isnan(result->worst_difference[1]));  // one sensor has nobody to differ from
}

TEST(SensorConsistency, OneExposureHasNoLinearityButComparesSensors) {
  std::mt19937 random(3);
  const std::vector<SensorChart> charts = {Chart(0, {}, 0.01, 0.0, &random),
                                           Chart(1, {{1.1, 1.1, 1.1}}, 0.01, 0.0, &random)};
  const Result<SensorConsistency> result = CompareSensors(charts, {"a", "b"});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_FALSE(result->sensors[0].lines[18][1].fitted);
  EXPECT_TRUE(std::isnan(result->sensors[0].least_r_squared[1]));
  EXPECT_NEAR(result->sensors[0].gain[1] / result->sensors[1].gain[1], 1.1, 1e-6);
}

TEST(SensorConsistency, ASensorWithoutUsableGreyPatchesIsNamed) {
  std::mt19937 random(3);
  const std::vector<SensorChart> charts = {Chart(0, {}, 0.01, 0.0, &random),
                                           Chart(1, {}, 10.0, 0.0, &random)};
  const Result<SensorConsistency> result = CompareSensors(charts, {"front", "left"});
  ASSERT_FALSE(result);
  EXPECT_NE(result.error().message.find("sensor left"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::sensor_consistency_test
