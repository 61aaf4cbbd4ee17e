#include "core/photometry/white_balance.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/chart_scene.h"

namespace omnihdr::white_balance_test {
namespace {

Response SrgbResponse() {
  std::array<std::vector<double>, 3> ln;
  for (std::vector<double>& channel : ln) {
    for (int z = 0; z < 256; ++z) {
      const double v = std::max(z, 1) / 255.0 * (z == 0 ? 0.5 : 1.0);
      channel.push_back(std::log(v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4)));
    }
  }
  return *Response::Table(ln);
}

ChartMeasurement Measured(const ChartScene& scene, const Response& response) {
  const RenderedChart rendered = RenderChart(scene);
  const SensorPicture picture =
      *MakeSensorPicture(rendered.image, scene.bits, scene.bayer, 0, scene.height);
  const Result<ChartDetection> found = DetectColorChart(picture, {});
  EXPECT_TRUE(found) << found.error().message;
  return *MeasureChart(picture, found->geometry, response, {});
}

TEST(WhiteBalance, UndoesTheChannelsGainsInLinearLight) {
  ChartScene scene;
  scene.gain = {0.62, 1.0, 0.81};
  scene.noise = 1.0;
  for (const BayerOrder bayer : {BayerOrder::kNone, BayerOrder::kGrbg}) {
    scene.bayer = bayer;
    const std::vector<ChartMeasurement> charts = {Measured(scene, *Response::Linear())};
    const Result<WhiteBalance> balance = SolveWhiteBalance(charts);
    ASSERT_TRUE(balance) << balance.error().message;
    EXPECT_NEAR(balance->red, 1.0 / 0.62, 0.01 / 0.62);
    EXPECT_NEAR(balance->blue, 1.0 / 0.81, 0.01 / 0.81);
    EXPECT_LT(std::abs(balance->red * 0.62 - 1.0), 4.0 * balance->red_error);
    EXPECT_LT(balance->red_error, 0.01);
    EXPECT_TRUE(balance->warnings.empty());
  }
}

TEST(WhiteBalance, NeedsThePicturesOwnResponse) {
  ChartScene scene;
  scene.gain = {0.62, 1.0, 0.81};
  scene.srgb = true;
  const std::vector<ChartMeasurement> right = {Measured(scene, SrgbResponse())};
  const std::vector<ChartMeasurement> wrong = {Measured(scene, *Response::Linear())};
  EXPECT_NEAR(SolveWhiteBalance(right)->red, 1.0 / 0.62, 0.01 / 0.62);
  EXPECT_GT(std::abs(SolveWhiteBalance(wrong)->red - 1.0 / 0.62), 0.1);
}

TEST(WhiteBalance, LeavesClippedPatchesOut) {
  ChartScene scene;
  scene.gain = {0.62, 1.0, 0.81};
  scene.exposure = 1.6;  // white clips in green and blue
  const std::vector<ChartMeasurement> charts = {Measured(scene, *Response::Linear())};
  const Result<WhiteBalance> balance = SolveWhiteBalance(charts);
  ASSERT_TRUE(balance) << balance.error().message;
  EXPECT_NEAR(balance->red, 1.0 / 0.62, 0.01 / 0.62);
  EXPECT_FALSE(balance->patches[0].used);
  EXPECT_EQ(balance->patches[0].excluded, "clipped");
  EXPECT_TRUE(balance->patches[2].used);
}

TEST(WhiteBalance, RefusesAPictureThatClipsTheGreyRowAndSaysHowToTakeABetterOne) {
  ChartMeasurement chart;
  for (auto& patch : chart) {
    for (PatchChannel& c : patch) {
      c.clipped = 1.0;
      c.exposure = 2.0;
      c.mean = 255.0;
    }
  }
  const std::vector<ChartMeasurement> charts = {chart};
  const Result<WhiteBalance> balance = SolveWhiteBalance(charts);
  ASSERT_FALSE(balance);
  EXPECT_NE(balance.error().message.find("6 clipped"), std::string::npos);
  EXPECT_NE(balance.error().message.find("shorter"), std::string::npos);
}

TEST(WhiteBalance, PatchesThatDisagreeAreAWarningAndWidenTheError) {
  ChartScene scene;
  scene.noise = 1.0;
  ChartMeasurement chart = Measured(scene, *Response::Linear());
  const std::vector<ChartMeasurement> good = {chart};
  chart[18][0].exposure *= 1.2;
  const std::vector<ChartMeasurement> bad = {chart};
  const Result<WhiteBalance> balance = SolveWhiteBalance(bad);
  ASSERT_TRUE(balance);
  EXPECT_EQ(balance->warnings.size(), 1U);
  EXPECT_GT(balance->red_error, 3.0 * SolveWhiteBalance(good)->red_error);
}

}  // namespace
}  // namespace omnihdr::white_balance_test
