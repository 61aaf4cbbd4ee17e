// calibrate noise, called as from the command line, on frames of a sensor whose noise is known.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/journal.h"
#include "daemon/cli/calibrate_command.h"
#include "daemon/config.h"
#include "drivers/sim/sensor.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::calibrate_noise_test {
namespace {

using ::testing::HasSubstr;

// Nearly a decade and a half of levels; two frames each.
const std::vector<double> kSeconds = {0.06, 0.15, 0.4, 0.9, 1.7};

class CalibrateNoiseCommand : public ::testing::Test {
 protected:
  CalibrateNoiseCommand() {
    sensor_.full_well_e = 8000.0;
    sensor_.read_noise = 1.1;
    sensor_.prnu = 0.01;
  }

  std::string Path(const std::string& name) const { return (directory_.path() / name).string(); }

  // A flat, darker towards its corners, 192 columns wide.
  DecodedImage Flat(double seconds, std::uint64_t number, int height = 144) const {
    Image<float> light(192, height, 3);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < 192; ++x) {
        const float r = std::hypot(static_cast<float>(x) - 96.0F, static_cast<float>(y) - 72.0F);
        for (int c = 0; c < 3; ++c) light.at(x, y, c) = 1.0F - 1e-5F * r * r;
      }
    }
    return DecodedImage{
        sim::Expose(light.view(), {ExposureTime::Seconds(seconds), {}}, sensor_, number)};
  }

  static std::vector<std::byte> Png(const DecodedImage& image) {
    return EncodePng(std::get<Image<std::uint8_t>>(image.pixels).view()).value();
  }

  std::string Write(const std::string& name, const DecodedImage& image) const {
    EXPECT_TRUE(WriteFileAtomic(Path(name), Png(image)));
    return Path(name);
  }

  // Pairs of flats at these exposures, as the command takes them.
  std::vector<std::string> Flats(const std::vector<double>& seconds) const {
    std::vector<std::string> words = {"noise"};
    for (std::size_t k = 0; k < seconds.size(); ++k) {
      for (const std::size_t i : {2 * k, 2 * k + 1}) {
        words.push_back(Write(fmt::format("flat{}.png", i), Flat(seconds[k], i)));
      }
    }
    return words;
  }

  Result<int> Run(std::vector<std::string> words) {
    return testing::RunCommand({AddCalibrateNoise}, std::move(words), &printed_);
  }

  std::string MessageOf(std::vector<std::string> words, ErrorKind kind = ErrorKind::kData) {
    const Result<int> result = Run(std::move(words));
    EXPECT_FALSE(result) << printed_;
    if (result) return {};
    EXPECT_EQ(result.error().kind, kind);
    return result.error().message;
  }

  void ExpectTheSensor(const nlohmann::json& report, double tolerance) const {
    const auto value = [&](const char* key) { return report[key]["value"].get<double>(); };
    EXPECT_NEAR(value("full_well_e"), sensor_.full_well_e, tolerance * sensor_.full_well_e);
    EXPECT_NEAR(value("read_noise"), sensor_.read_noise, tolerance * sensor_.read_noise);
    EXPECT_NEAR(value("prnu"), sensor_.prnu, tolerance * sensor_.prnu);
    EXPECT_NEAR(value("read_noise_e"), sensor_.read_noise * sensor_.full_well_e / 255.0,
                2.0 * tolerance * sensor_.read_noise * sensor_.full_well_e / 255.0);
    EXPECT_GT(report["r_squared"].get<double>(), 0.99);
  }

  sim::SensorOptions sensor_;
  testing::TemporaryDirectory directory_;
  std::string printed_;
};

TEST_F(CalibrateNoiseCommand, ASensorIsRecoveredFromPairsOfPicturesAndDrawn) {
  std::vector<std::string> words = Flats(kSeconds);
  words.insert(words.end(), {"--json", "--plot", Path("transfer.png")});
  const Result<int> result = Run(words);
  ASSERT_TRUE(result) << result.error().message;
  const nlohmann::json report = nlohmann::json::parse(printed_);
  ExpectTheSensor(report, 0.04);
  EXPECT_EQ(report["pairs"].get<int>(), 5);
  EXPECT_GE(report["points"].size(), 5U);
  const Result<DecodedImage> plot = ReadImage(Path("transfer.png"));
  ASSERT_TRUE(plot) << plot.error().message;
  EXPECT_EQ(plot->channels(), 3);
}

TEST_F(CalibrateNoiseCommand, WhatItPrintsIsAConfigurationFile) {
  ASSERT_TRUE(Run(Flats(kSeconds)));
  ASSERT_TRUE(WriteFileAtomic(Path("noise.toml"), printed_));
  const Result<DaemonConfig> config = ConfigOrError(LoadConfig(Path("noise.toml")));
  ASSERT_TRUE(config) << config.error().message << "\n" << printed_;
  const NoiseModel& noise = config->pipeline.options.noise;
  EXPECT_NEAR(noise.read, sensor_.read_noise, 0.04 * sensor_.read_noise);
  EXPECT_NEAR(noise.gain, 255.0 / sensor_.full_well_e, 0.04 * 255.0 / sensor_.full_well_e);
  EXPECT_NEAR(noise.prnu, sensor_.prnu, 0.04 * sensor_.prnu);
}

TEST_F(CalibrateNoiseCommand, ASessionsEqualFramesArePairedByPositionAndExposure) {
  SessionInfo info;
  info.created = "2026-01-01T00:00:00Z";
  info.camera.layout = Layout::kPanorama;
  info.camera.width = 192;
  info.camera.height = 96;
  info.camera.projection = ProjectionKind::kEquirectangular;
  SessionWriter writer = SessionWriter::Create(directory_.path() / "session", info).value();
  std::uint64_t number = 0;
  // Levels in turn, then again: pairs lie far from each other; a last frame stays alone.
  for (const std::size_t k : {0U, 1U, 2U, 3U, 4U, 4U, 3U, 2U, 1U, 0U, 2U}) {
    FrameRecord record;
    record.frame = FrameId{number};
    record.position = PositionId{0};
    record.file = fmt::format("raw/{}.png", number);
    record.exposure.time = ExposureTime::Seconds(kSeconds[k]);
    ASSERT_TRUE(writer.Append(record, Png(Flat(kSeconds[k], number, 96))));
    ++number;
  }
  const Result<int> result = Run({"noise", Path("session"), "--json"});
  ASSERT_TRUE(result) << result.error().message;
  const nlohmann::json report = nlohmann::json::parse(printed_);
  EXPECT_EQ(report["pairs"].get<int>(), 5);
  ExpectTheSensor(report, 0.05);
}

TEST_F(CalibrateNoiseCommand, ABlackLevelIsTakenOffTheSignal) {
  std::vector<std::string> words = Flats({0.06, 0.15, 0.4, 0.9, 1.6});
  for (std::size_t k = 1; k < words.size(); ++k) {
    DecodedImage image = ReadImage(words[k]).value();
    for (std::uint8_t& v : std::get<Image<std::uint8_t>>(image.pixels).values()) {
      v = static_cast<std::uint8_t>(v + 16);
    }
    ASSERT_TRUE(WriteFileAtomic(words[k], Png(image)));
  }
  words.insert(words.end(), {"--json", "--black", "16"});
  ASSERT_TRUE(Run(words));
  const nlohmann::json report = nlohmann::json::parse(printed_);
  EXPECT_NEAR(report["read_noise"]["value"].get<double>(), sensor_.read_noise, 0.05);
  EXPECT_NEAR(report["prnu"]["value"].get<double>(), sensor_.prnu, 0.0005);
}

TEST_F(CalibrateNoiseCommand, EachRefusalSaysWhyAndDrawsNothing) {
  const std::vector<std::string> plot = {"--plot", Path("transfer.svg")};
  const auto with_plot = [&](std::vector<std::string> words) {
    words.insert(words.end(), plot.begin(), plot.end());
    return words;
  };
  EXPECT_THAT(MessageOf(with_plot(Flats({1.0}))), HasSubstr("take pairs at several exposures"));
  EXPECT_THAT(MessageOf(with_plot(Flats({1.0, 1.1}))), HasSubstr("levels from"));
  EXPECT_THAT(MessageOf(with_plot(Flats({9.0, 12.0}))), HasSubstr("at an end of the range"));
  std::vector<std::string> sizes = Flats(kSeconds);
  sizes[4] = Write("small.png", Flat(kSeconds[1], 3, 96));
  EXPECT_THAT(MessageOf(with_plot(sizes)), HasSubstr("small.png: 192x144"));
  EXPECT_THAT(MessageOf(with_plot(sizes)), HasSubstr("192x96"));
  std::vector<std::string> odd = Flats(kSeconds);
  odd.pop_back();
  EXPECT_THAT(MessageOf(odd, ErrorKind::kUsage), HasSubstr("9 pictures, expected pairs"));
  // The pictures in another order: no pairs any more.
  std::vector<std::string> shifted = Flats(kSeconds);
  std::rotate(shifted.begin() + 1, shifted.begin() + 2, shifted.end());
  EXPECT_THAT(MessageOf(shifted), HasSubstr("not two pictures of one light and exposure"));
  EXPECT_THAT(MessageOf({"noise", Path("none.png"), Path("none.png")}, ErrorKind::kNoInput),
              HasSubstr("none.png"));
  EXPECT_FALSE(std::filesystem::exists(Path("transfer.svg")));
}

}  // namespace
}  // namespace omnihdr::calibrate_noise_test
