// `omnihdr camera` on a machine with two cameras on its USB.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>

#include "core/image/image_io.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/iidc_usb_function.h"
#include "tests/emulators/uvc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::camera_tool_test {
namespace {

using emulators::IidcDeviceOptions;
using emulators::UvcDeviceOptions;
using integration::Eventually;
using integration::RunOmnihdr;
using nlohmann::json;
using ::testing::HasSubstr;

class CameraTool : public ::testing::Test {
 protected:
  CameraTool() {
    const IidcDeviceOptions& head = head_->options();
    std::ofstream(path("head.toml"))
        << emulators::EmulatedRig(6, head.max_width, head.rows_per_sensor, head.bayer);
    const UvcDeviceOptions& webcam = webcam_->options();
    std::ofstream(path("webcam.toml"))
        << emulators::EmulatedRig(1, webcam.width, webcam.height, BayerOrder::kNone);
    std::ofstream(path("iidc.toml")) << "[camera]\ndriver = \"iidc\"\nframe_timeout_s = 20.0\n"
                                        "[camera.iidc]\nrig = \"head.toml\"\n";
    std::ofstream(path("v4l2.toml")) << fmt::format(
        "[camera]\ndriver = \"v4l2\"\nframe_timeout_s = 20.0\n[camera.v4l2]\nrig = "
        "\"webcam.toml\"\n"
        "format = \"grey\"\ndevice = \"{}\"\n",
        webcam.serial);
  }
  std::string path(const std::string& name) const { return (folder_.path() / name).string(); }
  // The answer in JSON; nothing when it is none.
  json Ask(std::vector<std::string> words, const std::string& config = "") const {
    words.insert(words.begin(), "camera");
    words.emplace_back("--json");
    if (!config.empty()) words.insert(words.end(), {"--config", path(config)});
    const auto [code, output] = RunOmnihdr(words, folder_.path());
    EXPECT_EQ(code, 0) << output;
    json answer = json::parse(output, nullptr, false);
    EXPECT_FALSE(answer.is_discarded()) << output;
    return answer;
  }

  const SystemClock clock_;
  const testing::TemporaryDirectory folder_;
  std::shared_ptr<emulators::IidcDevice> head_ =
      std::make_shared<emulators::IidcDevice>(IidcDeviceOptions{}, clock_);
  std::shared_ptr<emulators::UvcDevice> webcam_ =
      std::make_shared<emulators::UvcDevice>(UvcDeviceOptions{}, clock_);
  emulators::VhciUsb head_plug_{std::make_shared<emulators::IidcUsbFunction>(head_), 0};
  emulators::VhciUsb webcam_plug_{std::make_shared<emulators::UvcUsbFunction>(webcam_), 1};
};

TEST_F(CameraTool, BothCamerasAreListedOnceAndAnswerWhatTheyAreAskedFor) {
  json cameras;
  ASSERT_TRUE(Eventually([&] {
    cameras = Ask({"list"});
    return cameras.size() == 2 && !cameras[0].contains("problem");
  })) << cameras;
  EXPECT_EQ(cameras[0]["driver"], "iidc");
  EXPECT_EQ(cameras[0]["id"], "00b09d0100c0ffee");
  EXPECT_EQ(cameras[1]["driver"], "v4l2");
  EXPECT_EQ(cameras[1]["id"], "UVC-0001");
  EXPECT_EQ(cameras[1]["model"], "Test UVC Camera: Test UVC Camer");  // of V4L2's 31 characters

  for (const auto& [config, proof] :
       {std::pair("iidc.toml", "embedded"), std::pair("v4l2.toml", "latency")}) {
    const json info = Ask({"info"}, config);
    EXPECT_EQ(info["proof"], proof) << info;
    const json frames = Ask(
        {"grab", "--exposure", "0.008", "--count", "2", "--out", path(config + std::string("d"))},
        config);
    ASSERT_EQ(frames.size(), 2U) << frames;
    for (const json& frame : frames) {
      EXPECT_EQ(frame["status"], "ok") << frame;
      EXPECT_EQ(frame["proof"], proof);
      EXPECT_NEAR(frame["exposure_s"].get<double>(), 0.008, 1e-4);
      EXPECT_TRUE(ReadImage(frame["file"].get<std::string>()));
    }
  }
  const json steps =
      Ask({"test", "--starts", "3", "--exposures", "4", "--longest", "0.04", "--triggers", "5"},
          "iidc.toml");
  ASSERT_EQ(steps.size(), 4U) << steps;
  for (const json& step : steps) EXPECT_EQ(step["passed"], true) << step;
}

// The whole of it, as somebody at a bench does it who unplugs the camera when asked.
TEST_F(CameraTool, TheWebcamPassesTheWholeTestAndIsUnpluggedWhenAsked) {
  ASSERT_TRUE(Eventually([&] { return Ask({"list"}).size() == 2; }));
  integration::Program tool("omnihdr",
                            {"camera", "test", "--config", path("v4l2.toml"), "--device",
                             webcam_->options().serial, "--longest", "0.05", "--unplug"},
                            path("log"));
  const auto asks = [&](const char* what) {
    return Eventually([&] { return !tool.running() || tool.Log().find(what) != std::string::npos; },
                      std::chrono::seconds(300));
  };
  ASSERT_TRUE(asks(">>> unplug the camera now")) << tool.Log();
  webcam_plug_.Unplug();
  ASSERT_TRUE(asks(">>> plug the camera in again now")) << tool.Log();
  webcam_plug_.PlugIn();
  EXPECT_EQ(tool.Wait(), 0) << tool.Log();
  const std::string log = tool.Log();
  EXPECT_THAT(log, HasSubstr("started and stopped 50 times"));
  EXPECT_THAT(log, HasSubstr("5 exposures from 0.0001 to 0.05 s, proof latency, off by 0.00 %"));
  EXPECT_THAT(log, HasSubstr("8 steps of 2.0 stops, each seen in the first picture after it"));
  EXPECT_THAT(log, HasSubstr("20 triggers, 20 frames in order, 0 lost by the camera's counter"));
  EXPECT_THAT(log, HasSubstr("gone, said so, and back with a picture"));
}

TEST_F(CameraTool, WhatPassedBetweenTheWebcamsDriverAndTheKernelIsPlayedBackWithoutTheWebcam) {
  ASSERT_TRUE(Eventually([&] { return Ask({"list"}).size() == 2; }));
  const auto grab = [&](const char* with, const char* exposure) {
    return RunOmnihdr({"camera", "grab", "--exposure", exposure, "--count", "3", "--json", with,
                       path("webcam.v4l2"), "--config", path("v4l2.toml")},
                      folder_.path());
  };
  const auto recorded = grab("--record", "0.008");
  ASSERT_EQ(recorded.first, 0) << recorded.second;
  EXPECT_EQ(json::parse(recorded.second).size(), 3U);
  EXPECT_THAT(recorded.second, HasSubstr("\"proof\": \"latency\""));
  webcam_plug_.Unplug();
  const auto played = grab("--replay", "0.008");
  EXPECT_EQ(played.first, 0) << played.second;
  EXPECT_EQ(played.second, recorded.second);
  const auto other = grab("--replay", "0.016");
  EXPECT_NE(other.first, 0);
  EXPECT_THAT(other.second, HasSubstr("recorded was \"trigger with 0.008 s"));
}

// Frames are taken for those of an exposure that is not in force yet.
TEST_F(CameraTool, AWebcamWhoseLatencyIsGivenTooShortFailsTheTest) {
  std::ofstream(path("v4l2.toml"), std::ios::app) << "latency_frames = 1\n";
  ASSERT_TRUE(Eventually([&] { return Ask({"list"}).size() == 2; }));
  const auto [code, output] = RunOmnihdr(
      {"camera", "test", "--config", path("v4l2.toml"), "--starts", "1"}, folder_.path());
  EXPECT_EQ(code, 1) << output;
  EXPECT_THAT(output, HasSubstr("exposures       FAILED"));
}

}  // namespace
}  // namespace omnihdr::camera_tool_test
