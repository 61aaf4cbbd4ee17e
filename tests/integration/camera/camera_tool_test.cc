// `omnihdr camera` with an emulated camera that its libusb takes for a real one.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/emulators/iidc_link.h"
#include "tests/emulators/umockdev_usb.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::camera_tool_test {
namespace {

using ::testing::HasSubstr;

class CameraTool : public ::testing::Test {
 protected:
  CameraTool() {
    const emulators::IidcDeviceOptions& device = device_->options();
    std::ofstream(path("head.toml"))
        << emulators::EmulatedRig(6, device.max_width, device.rows_per_sensor, device.bayer);
    std::ofstream(path("c.toml"))
        << "[camera]\ndriver = \"iidc\"\n[camera.iidc]\nrig = \"head.toml\"\n";
    std::ofstream(path("v.toml"))
        << "[camera]\ndriver = \"v4l2\"\n[camera.v4l2]\nrig = \"head.toml\"\n";
  }
  std::string path(const std::string& name) const { return (directory_.path() / name).string(); }
  std::pair<int, std::string> Run(std::vector<std::string> arguments,
                                  const std::string& config = "c.toml") {
    arguments.insert(arguments.begin(), "camera");
    arguments.insert(arguments.end(), {"--config", path(config)});
    std::filesystem::remove(path("out"));
    integration::Program program("omnihdr", arguments, path("out"),
                                 {"LD_PRELOAD=" OMNIHDR_UMOCKDEV_PRELOAD});
    const int code = program.Wait();
    return {code, program.Log()};
  }

  const SystemClock clock_;
  testing::TemporaryDirectory directory_;
  std::shared_ptr<emulators::IidcDevice> device_ =
      std::make_shared<emulators::IidcDevice>(emulators::IidcDeviceOptions{}, clock_);
};

TEST_F(CameraTool, SetsAFeatureReadsItBackAndSaysWhatItTakes) {
  emulators::UmockdevUsb plug(device_);
  auto [code, output] = Run({"set", "shutter=0.02", "gamma=off"});
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("shutter = 0.0"));
  EXPECT_THAT(output, HasSubstr("gamma = off; it takes"));
  EXPECT_THAT(output, HasSubstr("until it is opened for pictures, which initialises it"));
  std::tie(code, output) = Run({"set", "--json"});
  ASSERT_EQ(code, 0) << output;
  const auto all = nlohmann::json::parse(output);
  ASSERT_EQ(all.size(), 1U);
  EXPECT_GT(all[0]["settings"].size(), 3U);
  std::tie(code, output) = Run({"set", "shutter=900"});
  EXPECT_EQ(code, 64) << output;
  EXPECT_THAT(output, HasSubstr("shutter=900: expected"));
}

TEST_F(CameraTool, WhatWasRecordedIsPlayedBackWithoutTheCamera) {
  const std::vector<std::string> grab = {"grab", "--exposure", "0.004", "--count", "3", "--json"};
  const auto with = [&](const std::string& option) {
    std::vector<std::string> words = grab;
    words.insert(words.end(), {option, path("camera.usb")});
    return Run(std::move(words));
  };
  std::pair<int, std::string> recorded;
  {
    emulators::UmockdevUsb plug(device_);
    recorded = with("--record");
  }
  ASSERT_EQ(recorded.first, 0) << recorded.second;
  EXPECT_EQ(nlohmann::json::parse(recorded.second).size(), 3U);
  const auto played = with("--replay");
  EXPECT_EQ(played.first, 0) << played.second;
  EXPECT_EQ(played.second, recorded.second);
  // Another question than the recorded one is named.
  const auto other = Run({"grab", "--exposure", "0.016", "--replay", path("camera.usb")});
  EXPECT_NE(other.first, 0);
  EXPECT_THAT(other.second, HasSubstr("recorded was"));
}

TEST_F(CameraTool, WhatCannotBeRecordedOrSetIsSaid) {
  std::ofstream(path("sim.toml")) << "[camera]\ndriver = \"sim\"\n";
  auto [code, output] = Run({"info", "--record", path("x")}, "sim.toml");
  EXPECT_EQ(code, 64) << output;
  EXPECT_THAT(output, HasSubstr("\"sim\": expected \"iidc\" or \"v4l2\""));
  for (const char* config : {"c.toml", "v.toml"}) {
    std::tie(code, output) = Run({"info", "--replay", path("head.toml")}, config);
    EXPECT_EQ(code, 65) << output;
    EXPECT_THAT(output, HasSubstr("head.toml: no recording of "));
  }
  std::tie(code, output) = Run({"info", "--record", path("none/x")}, "v.toml");
  EXPECT_EQ(code, 73) << output;
  EXPECT_THAT(output, HasSubstr("V4L2 recording: "));
  std::tie(code, output) = Run({"info", "--replay", "a", "--record", "b"});
  EXPECT_NE(code, 0);
  EXPECT_THAT(output, HasSubstr("excludes"));
}

}  // namespace
}  // namespace omnihdr::camera_tool_test
