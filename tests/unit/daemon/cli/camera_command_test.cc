// omnihdr camera, called as from the command line, with the simulated camera.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "daemon/cli/camera_trial.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::camera_command_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

class CameraCommand : public ::testing::Test {
 protected:
  void SetUp() override { Configure(""); }
  void Configure(const std::string& sim) {
    ASSERT_TRUE(WriteFileAtomic(config(),
                                "[camera]\ndriver = \"sim\"\nframe_timeout_s = 1.0\n"
                                "[camera.sim]\nwidth = 128\nlatency_s = 0.001\n" +
                                    sim));
  }
  std::string config() const { return (directory_.path() / "c.toml").string(); }
  Result<int> Run(std::vector<std::string> words) {
    words.insert(words.begin(), "camera");
    words.insert(words.end(), {"--config", config()});
    return testing::RunCommand({AddCameraCommand}, std::move(words), &printed_);
  }

  testing::TemporaryDirectory directory_;
  std::string printed_;
};

TEST_F(CameraCommand, InfoSaysWhatTheCameraCanDo) {
  const Result<int> code = Run({"info", "--json"});
  ASSERT_TRUE(code) << code.error().message;
  const auto info = nlohmann::json::parse(printed_);
  EXPECT_EQ(info["width"], 128);
  EXPECT_EQ(info["layout"], "panorama");
  EXPECT_GT(info["exposure_s"][1].get<double>(), info["exposure_s"][0].get<double>());
  EXPECT_EQ(info["proof"], "embedded");
}

TEST_F(CameraCommand, InfoForPeopleHasNoJsonInIt) {
  const Result<int> code = Run({"info"});
  ASSERT_TRUE(code) << code.error().message;
  EXPECT_THAT(printed_, HasSubstr("1e-06 to 10\n"));
  EXPECT_THAT(printed_, HasSubstr("0 (any exposure within the limits)"));
  EXPECT_THAT(printed_, HasSubstr("simulation.scene"));
  EXPECT_THAT(printed_, Not(HasSubstr("{")));
}

TEST_F(CameraCommand, WithoutAConfigurationItIsSaidWhatToName) {
  fs::remove(config());
  const Result<int> code = Run({"info"});
  ASSERT_FALSE(code);
  EXPECT_EQ(code.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(code.error().message, HasSubstr("c.toml: there is no such file: expected --config"));
}

TEST_F(CameraCommand, ACameraWithoutACableIsNotAskedToBeUnplugged) {
  const Result<int> code = Run({"test", "--unplug"});
  ASSERT_FALSE(code);
  EXPECT_EQ(code.error().kind, ErrorKind::kUsage);
  EXPECT_THAT(code.error().message, HasSubstr("a sim camera has no cable"));
}

TEST_F(CameraCommand, ALineThatReleasesTheCameraAndIsNotThereIsNamed) {
  ASSERT_TRUE(WriteFileAtomic(config(),
                              "[camera]\ndriver = \"sim\"\n[gpio.outputs]\n"
                              "chip = \"no-such-chip\"\ncamera_trigger = \"5\"\n"));
  const Result<int> code = Run({"grab"});
  ASSERT_FALSE(code);
  EXPECT_EQ(code.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(code.error().message, HasSubstr("gpio.outputs.camera_trigger: "));
  EXPECT_THAT(code.error().message, HasSubstr("no-such-chip"));
}

TEST_F(CameraCommand, GrabWritesPicturesAndTheirProvedExposures) {
  const std::string out = (directory_.path() / "pictures").string();
  const Result<int> code =
      Run({"grab", "--exposure", "0.004", "--count", "2", "--out", out, "--json"});
  ASSERT_TRUE(code) << code.error().message;
  EXPECT_EQ(*code, 0);
  const auto frames = nlohmann::json::parse(printed_);
  ASSERT_EQ(frames.size(), 2U);
  for (const auto& frame : frames) {
    EXPECT_EQ(frame["status"], "ok");
    EXPECT_NEAR(frame["exposure_s"].get<double>(), 0.004, 1e-4);
    const auto bytes = ReadFile(frame["file"].get<std::string>());
    ASSERT_TRUE(bytes);
    EXPECT_TRUE(DecodeImage(*bytes, "picture"));
  }
}

TEST_F(CameraCommand, AnExposureTheCameraCannotMakeIsRefusedWithItsRange) {
  const Result<int> code = Run({"grab", "--exposure", "3000"});
  ASSERT_FALSE(code);
  EXPECT_THAT(code.error().message, HasSubstr("3000"));
}

TEST_F(CameraCommand, AGoodCameraPassesTheTest) {
  const Result<int> code = Run({"test", "--starts", "3", "--triggers", "6", "--json"});
  ASSERT_TRUE(code) << code.error().message;
  EXPECT_EQ(*code, 0) << printed_;
  const auto steps = nlohmann::json::parse(printed_);
  ASSERT_EQ(steps.size(), 4U);
  EXPECT_THAT(steps[2]["detail"].get<std::string>(), HasSubstr("8 steps of 2.0 stops"));
  EXPECT_THAT(steps[3]["detail"].get<std::string>(), HasSubstr("6 triggers, 6 frames in order"));
}

// A camera whose pictures have the exposure of the trigger before, and which says that they have
// the one that was asked for.
class LateCamera final : public Camera {
 public:
  static CameraInfo Info() {
    CameraInfo info;
    info.description.bits = 8;
    info.shortest = ExposureTime::Seconds(1e-4);
    info.longest = ExposureTime::Seconds(0.02);
    return info;
  }
  Result<CameraInfo> Open() override { return Info(); }
  void Close() override {}
  Status Start() override { return {}; }
  void Stop() override {}
  Status Trigger(const ExposureRequest& request) override {
    before_ = std::exchange(now_, request);
    return {};
  }
  Result<CameraFrame> Receive(Nanoseconds) override {
    CameraFrame frame;
    frame.trigger = now_.trigger;
    frame.camera_counter = Value(now_.trigger);
    frame.measured_exposure = now_.exposure;
    frame.proof = ExposureProof::kReadback;
    Image<std::uint8_t> pixels(4, 4);
    const double level = std::min(1.0, before_.exposure.time.seconds() / 0.009);
    for (auto& value : pixels.values()) value = static_cast<std::uint8_t>(255.0 * level);
    frame.pixels = std::move(pixels);
    return frame;
  }

 private:
  ExposureRequest before_;
  ExposureRequest now_;
};

TEST(CameraTrial, ACameraWhosePicturesAreOneStepLateIsFoundOutByTheirBrightness) {
  LateCamera camera;
  CameraTrialOptions options;
  options.starts = 1;
  options.exposures = 20;
  const auto steps =
      RunCameraTrial(camera, LateCamera::Info(), options, [](const CameraTrialStep&) {});
  ASSERT_EQ(steps.size(), 3U);
  EXPECT_TRUE(steps[1].passed) << steps[1].detail;
  EXPECT_EQ(steps[2].name, "latency");
  EXPECT_FALSE(steps[2].passed) << steps[2].detail;
  EXPECT_THAT(steps[2].detail, HasSubstr("expected a step of -2.0 stops"));
}

TEST_F(CameraCommand, AnotherDeviceThanTheConfigurationsIsRefusedWhereTheDriverHasNone) {
  const Result<int> code = Run({"info", "--device", "/dev/video0"});
  ASSERT_FALSE(code);
  EXPECT_EQ(code.error().kind, ErrorKind::kUsage);
  EXPECT_THAT(code.error().message, HasSubstr("--device /dev/video0: expected a configuration"));
}

TEST_F(CameraCommand, ACameraWithWrongExposuresFailsItByName) {
  Configure("exposure_error_probability = 1.0\n");
  const Result<int> code = Run({"test", "--starts", "2", "--triggers", "4"});
  ASSERT_TRUE(code) << code.error().message;
  EXPECT_EQ(*code, 1);
  EXPECT_THAT(printed_, HasSubstr("exposures       FAILED"));
  EXPECT_THAT(printed_, HasSubstr("off by"));
}

TEST_F(CameraCommand, ACameraThatLosesFramesFailsIt) {
  Configure("lost_frame_probability = 1.0\n");
  const Result<int> code = Run({"test", "--starts", "2", "--triggers", "4"});
  ASSERT_TRUE(code) << code.error().message;
  EXPECT_EQ(*code, 1);
  EXPECT_THAT(printed_, HasSubstr("FAILED"));
}

TEST_F(CameraCommand, AConfigurationThatIsNotThereIsSaid) {
  std::string printed;
  const Result<int> code = testing::RunCommand(
      {AddCameraCommand}, {"camera", "info", "--config", "/does/not/exist.toml"}, &printed);
  ASSERT_FALSE(code);
  EXPECT_THAT(code.error().message, HasSubstr("/does/not/exist.toml"));
}

}  // namespace
}  // namespace omnihdr::camera_command_test
