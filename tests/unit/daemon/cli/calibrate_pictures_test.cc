// calibrate white-balance, sensors and vignetting, called as from the command line.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/rig_file.h"
#include "daemon/cli/calibrate_command.h"
#include "tests/support/chart_scene.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::calibrate_pictures_test {
namespace {

namespace fs = std::filesystem;

class CalibratePictures : public ::testing::Test {
 protected:
  std::string Path(const std::string& name) const { return (directory_.path() / name).string(); }

  void Write(const std::string& name, const DecodedImage& image) const {
    const auto png =
        std::visit([](const auto& pixels) { return EncodePng(pixels.view()); }, image.pixels);
    ASSERT_TRUE(png);
    ASSERT_TRUE(WriteFileAtomic(Path(name), *png));
  }

  // The outcome of `omnihdr calibrate WORDS`.
  Result<int> Run(std::vector<std::string> words) {
    return testing::RunCommand(
        {AddCalibrateWhiteBalance, AddCalibrateSensors, AddCalibrateVignetting}, std::move(words),
        &printed_);
  }

  // A rig of `sensors` equal lenses for pictures of 480 × 360.
  void WriteRig(int sensors, BayerOrder bayer) const {
    Rig rig;
    for (int s = 0; s < sensors; ++s) {
      RigSensor sensor;
      sensor.name = std::string(1, static_cast<char>('a' + s));
      sensor.lens = *Lens::Pinhole(480, 360, {375.0, 375.0}, {240.0, 180.0}, {}, 0.8);
      sensor.bayer = bayer;
      sensor.gain = {1.0, 1.5, 1.0};
      rig.sensors.push_back(sensor);
    }
    ASSERT_TRUE(WriteFileAtomic(Path("rig.toml"), FormatRig(rig, kOwnersRemark)));
  }

  bool RemarkIsKept() const {
    const Result<std::string> text = ReadTextFile(Path("rig.toml"));
    return text && text->starts_with("# " + std::string(kOwnersRemark));
  }

  static constexpr std::string_view kOwnersRemark = "Calibrated in May.";
  testing::TemporaryDirectory directory_;
  std::string printed_;
};

int Count(const std::string& text, const std::string& part) {
  int count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) {
    ++count;
  }
  return count;
}

TEST_F(CalibratePictures, WhiteBalanceIsPrintedDrawnAndWrittenIntoTheRig) {
  ChartScene scene;
  scene.gain = {0.6, 1.0, 0.8};
  scene.noise = 1.0;
  scene.mirrored = true;
  Write("chart.png", RenderChart(scene).image);
  WriteRig(1, BayerOrder::kNone);
  const Result<int> result = Run({"white-balance", Path("chart.png"), "--json", "--rig",
                                  Path("rig.toml"), "--apply", "--overlay", Path("found.png")});
  ASSERT_TRUE(result) << result.error().message;
  const nlohmann::json report = nlohmann::json::parse(printed_);
  EXPECT_NEAR(report["gain"]["red"].get<double>(), 1.0 / 0.6, 0.02);
  EXPECT_NEAR(report["gain"]["blue"].get<double>(), 1.0 / 0.8, 0.015);
  EXPECT_TRUE(report["pictures"][0]["mirrored"].get<bool>());
  EXPECT_EQ(report["pictures"][0]["patches"].size(), 24U);
  const Result<DecodedImage> overlay = ReadImage(Path("found.png"));
  ASSERT_TRUE(overlay);
  EXPECT_EQ(overlay->channels(), 3);
  // The green gain stays; red and blue stand to it as measured.
  const Result<Rig> rig = ReadRig(Path("rig.toml"));
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_NEAR(rig->sensors[0].gain[0], 1.5 / 0.6, 0.03);
  EXPECT_NEAR(rig->sensors[0].gain[1], 1.5, 1e-12);
  EXPECT_TRUE(RemarkIsKept());
}

TEST_F(CalibratePictures, SensorsAreComparedInStackedBayerFrames) {
  WriteRig(3, BayerOrder::kGrbg);
  std::vector<std::string> words = {"sensors",    "--json", "--rig",  Path("rig.toml"), "--apply",
                                    "--response", "linear", "--plot", Path("plot.svg")};
  const std::array<double, 2> sensitivity = {1.0, 0.9};
  for (int e = 0; e < 3; ++e) {
    // Sensor c looks at a wall without a chart.
    Image<std::uint8_t> stacked(480, 3 * 360);
    for (int s = 0; s < 3; ++s) {
      ChartScene scene;
      scene.chart = s < 2;
      scene.bayer = BayerOrder::kGrbg;
      scene.exposure = 0.3 * (1 + e);
      const double k = s < 2 ? sensitivity[static_cast<std::size_t>(s)] : 1.0;
      scene.gain = {0.6 * k, k, 0.8 * k};
      scene.seed = static_cast<std::uint32_t>(3 * e + s + 1);
      const RenderedChart rendered = RenderChart(scene);
      const auto& pixels = std::get<Image<std::uint8_t>>(rendered.image.pixels);
      std::copy(pixels.values().begin(), pixels.values().end(), stacked.row(360 * s));
    }
    DecodedImage image{std::move(stacked)};
    const std::string name = fmt::format("frame{}.png", e);
    Write(name, image);
    words.push_back(fmt::format("{}@{}/100", Path(name), e + 1));
  }
  const Result<int> result = Run(words);
  ASSERT_TRUE(result) << result.error().message;
  const nlohmann::json report = nlohmann::json::parse(printed_);
  ASSERT_EQ(report["sensors"].size(), 2U);
  EXPECT_EQ(report["without_chart"].size(), 3U);
  EXPECT_EQ(report["sensors"][0]["exposures"].get<int>(), 3);
  EXPECT_GT(report["sensors"][0]["mean_r_squared"][1].get<double>(), 0.999);
  EXPECT_NEAR(report["worst_difference"][1].get<double>(), 0.0526, 0.01);
  EXPECT_LT(report["worst_difference_after"][1].get<double>(), 0.02);
  // A dot for every usable grey patch of a picture and for every patch's line, and the legends'.
  const Result<std::string> plot = ReadTextFile(Path("plot.svg"));
  ASSERT_TRUE(plot) << plot.error().message;
  int dots = 2;
  for (const nlohmann::json& sensor : report["sensors"]) {
    for (const nlohmann::json& patch : sensor["patches"]) {
      const nlohmann::json& lines = patch["linearity"];
      if (patch["patch"] > kChartFirstGrey) dots += lines[1]["points"].get<int>();
      dots +=
          lines[0].contains("slope") || lines[1].contains("slope") || lines[2].contains("slope");
    }
  }
  EXPECT_GT(dots, 70);
  EXPECT_EQ(Count(*plot, "<circle"), dots);
  for (const char* text : {">a</text>", ">b</text>", ">proportional</text>"}) {
    EXPECT_GT(Count(*plot, text), 0) << text;
  }
  const Result<Rig> rig = ReadRig(Path("rig.toml"));
  ASSERT_TRUE(rig) << rig.error().message;
  const auto& a = rig->sensors[0].gain;
  const auto& b = rig->sensors[1].gain;
  EXPECT_NEAR(b[1] / a[1], 1.0 / 0.9, 0.01);
  EXPECT_NEAR(a[0] / a[1], 1.0 / 0.6, 0.02);
  EXPECT_NEAR(rig->sensors[2].gain[1], 1.5, 1e-12);  // saw no chart: untouched
  EXPECT_TRUE(RemarkIsKept());
}

TEST_F(CalibratePictures, AFlatFieldsFalloffIsWrittenIntoTheRig) {
  WriteRig(1, BayerOrder::kNone);
  std::mt19937 random(4);
  std::normal_distribution<double> normal(0.0, 1.0);
  Image<std::uint8_t> flat(480, 360, 3);
  for (int y = 0; y < 360; ++y) {
    for (int x = 0; x < 480; ++x) {
      const double rho = std::hypot(x + 0.5 - 240.0, y + 0.5 - 180.0) / 300.0;
      for (int c = 0; c < 3; ++c) {
        flat.at(x, y, c) = static_cast<std::uint8_t>(
            std::lround(180.0 * (1.0 - 0.3 * rho * rho) + normal(random)));
      }
    }
  }
  Write("flat.png", DecodedImage{std::move(flat)});
  const Result<int> result =
      Run({"vignetting", Path("flat.png"), "--rig", Path("rig.toml"), "--apply"});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_NE(printed_.find("fall-off of a set"), std::string::npos) << printed_;
  const Result<Rig> rig = ReadRig(Path("rig.toml"));
  ASSERT_TRUE(rig) << rig.error().message;
  for (const double rho : {0.3, 0.6, 1.0}) {
    EXPECT_NEAR(rig->sensors[0].vignetting.At(rho), 1.0 - 0.3 * rho * rho, 0.01) << rho;
  }
  EXPECT_TRUE(RemarkIsKept());
}

TEST_F(CalibratePictures, WhatIsWrongOnTheCommandLineIsNamed) {
  ChartScene scene;
  scene.chart = false;
  Write("wall.png", RenderChart(scene).image);
  const std::string wall = Path("wall.png");
  WriteRig(2, BayerOrder::kNone);
  const std::string rig = Path("rig.toml");
  const std::vector<std::tuple<std::vector<std::string>, ErrorKind, std::string>> cases = {
      {{"white-balance"}, ErrorKind::kUsage, "no pictures"},
      {{"white-balance", Path("none.png")}, ErrorKind::kNoInput, "none.png"},
      {{"white-balance", wall}, ErrorKind::kData, "--corners"},
      {{"white-balance", wall, "--corners", "1,2,3"}, ErrorKind::kUsage, "1,2,3"},
      {{"white-balance", wall, "--corners", "1,2,3,4,5,6,7,nan"}, ErrorKind::kUsage, "nan"},
      {{"white-balance", wall, "--bayer", "RGBG"}, ErrorKind::kUsage, "RGBG"},
      {{"sensors", wall + "@0"}, ErrorKind::kUsage, "SECONDS > 0"},
      {{"sensors", "=" + wall}, ErrorKind::kUsage, "SENSOR=IMAGE"},
      {{"sensors", "z=" + wall, "--rig", rig}, ErrorKind::kUsage, "sensor z"},
      {{"sensors", wall, "--rig", rig}, ErrorKind::kUsage, "of which sensor"},
      {{"vignetting", wall, "--overlaps"}, ErrorKind::kUsage, "--rig"},
      {{"vignetting", wall, "--apply"}, ErrorKind::kUsage, "--rig"},
      {{"vignetting", "a=" + wall, "--rig", rig, "--apply-gains"},
       ErrorKind::kUsage,
       "--overlaps"}};
  for (const auto& [words, kind, text] : cases) {
    const Result<int> result = Run(words);
    ASSERT_FALSE(result) << text;
    EXPECT_EQ(result.error().kind, kind) << result.error().message;
    EXPECT_NE(result.error().message.find(text), std::string::npos) << result.error().message;
  }
}

}  // namespace
}  // namespace omnihdr::calibrate_pictures_test
