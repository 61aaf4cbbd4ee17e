#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <fstream>

#include "core/image/image_io.h"
#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/umockdev_usb.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::camera_daemon_test {
namespace {

using integration::Eventually;
using integration::Program;
using ::testing::HasSubstr;

class CameraDaemon : public ::testing::Test {
 protected:
  explicit CameraDaemon(const emulators::IidcDeviceOptions& options = {},
                        const std::string& iidc = "",
                        const std::string& exposures = "0.001, 0.004, 0.016",
                        const std::string& trigger = "")
      : device_(std::make_shared<emulators::IidcDevice>(options, clock_)) {
    const emulators::IidcDeviceOptions& device = device_->options();
    std::ofstream(path("head.toml"))
        << emulators::EmulatedRig(6, device.max_width, device.rows_per_sensor, device.bayer);
    std::ofstream(path("c.toml"))
        << "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
           "[camera]\ndriver = \"iidc\"\nreconnect_s = 0.2\n[camera.iidc]\nrig = \"head.toml\"\n"
        << iidc << "[bracket]\nexposures_s = [" << exposures
        << "]\n[trigger]\nsource = \"software\"\narmed_at_start = true\n"
        << trigger
        << "[pipeline]\nenabled = false\n"
           "[storage]\nallow_root = true\nwarn_free_mb = 0\nstop_free_mb = 0\nwarn_minutes = 0\n";
  }
  std::filesystem::path path(const std::string& name) const { return directory_.path() / name; }
  std::unique_ptr<Program> Start() const {
    return std::make_unique<Program>(
        "omnihdrd", std::vector<std::string>{"--config", path("c.toml").string()}, path("log"),
        std::vector<std::string>{"LD_PRELOAD=" OMNIHDR_UMOCKDEV_PRELOAD});
  }
  ApiClient Client() const { return ApiClient(path("api.sock")); }
  bool Becomes(const std::string& state) const {
    return Eventually([&] {
      const auto status = Client().Get("/v1/status");
      return status && (*status)["state"] == state;
    });
  }
  // Triggers until one more line is in the journal and all have been answered.
  bool Shoot() const {
    if (!Eventually([&] { return static_cast<bool>(Client().Post("/v1/trigger")); })) return false;
    return Eventually([&] {
      const auto status = Client().Get("/v1/status");
      return status && (*status)["triggers"]["in_flight"] == 0;
    });
  }
  std::vector<FrameRecord> Journal() const {
    auto contents = ReadSession(path("sessions") / "s");
    EXPECT_TRUE(contents) << contents.error().message;
    return contents ? contents->journal.frames : std::vector<FrameRecord>{};
  }

  const SystemClock clock_;
  testing::TemporaryDirectory directory_;
  std::shared_ptr<emulators::IidcDevice> device_;
  emulators::UmockdevUsb plug_{device_};
};

TEST_F(CameraDaemon, FramesOfAUsbCameraAreJournaledWithTheExposureTheyProve) {
  const auto daemon = Start();
  ASSERT_TRUE(Becomes("armed")) << daemon->Log();
  for (int i = 0; i < 6; ++i) ASSERT_TRUE(Shoot()) << daemon->Log();
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 6U);
  const double ladder[] = {0.001, 0.004, 0.016};
  for (std::size_t i = 0; i < journal.size(); ++i) {
    ASSERT_EQ(journal[i].status, FrameStatus::kOk) << journal[i].detail;
    EXPECT_EQ(journal[i].proof, ExposureProof::kEmbedded);
    const double seconds = journal[i].exposure.time.seconds();
    EXPECT_NEAR(seconds / ladder[i % 3], 1.0, 0.01);
    const auto image = ReadImage(path("sessions") / "s" / journal[i].file);
    ASSERT_TRUE(image) << image.error().message;
    const auto& pixels = std::get<Image<std::uint8_t>>(image->pixels);
    EXPECT_EQ(pixels.at(20, 100), device_->PixelAt(20, 100, seconds, 0.0));
  }
  const auto contents = ReadSession(path("sessions") / "s");
  ASSERT_TRUE(contents);
  EXPECT_EQ(contents->info.camera.model, "Six-Eyed Test Head");
  EXPECT_EQ(contents->info.camera.layout, Layout::kRig);
  daemon->Signal(SIGTERM);
  EXPECT_EQ(daemon->Wait(), 0) << daemon->Log();
}

TEST_F(CameraDaemon, ACameraThatIsUnpluggedIsWaitedForAndGoesOnInTheSameSession) {
  const auto daemon = Start();
  ASSERT_TRUE(Becomes("armed")) << daemon->Log();
  ASSERT_TRUE(Shoot());
  plug_.Unplug();
  ASSERT_TRUE(Becomes("waiting-for-camera")) << daemon->Log();
  plug_.PlugIn();
  ASSERT_TRUE(Becomes("armed")) << daemon->Log();
  ASSERT_TRUE(Shoot());
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 2U);
  EXPECT_EQ(journal.back().status, FrameStatus::kOk) << journal.back().detail;
  daemon->Signal(SIGTERM);
  EXPECT_EQ(daemon->Wait(), 0) << daemon->Log();
}

// Its exposure cycle is on, and begins anywhere at each series.
emulators::IidcDeviceOptions Cycling() {
  emulators::IidcDeviceOptions options;
  options.exposure_cycle = true;
  options.cycle_start = emulators::CycleStart::kRandomStep;
  return options;
}

class CyclingCameraDaemon : public CameraDaemon {
 protected:
  CyclingCameraDaemon()
      : CameraDaemon(Cycling(), "exposure_cycle = \"on\"\n", "0.001, 0.003, 0.005, 0.007",
                     "burst = true\n") {}
};

TEST_F(CyclingCameraDaemon, OneTriggerIsAWholeBracketWithoutAnExposureBeingWritten) {
  const auto daemon = Start();
  ASSERT_TRUE(Becomes("armed")) << daemon->Log();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(Shoot()) << daemon->Log();
  EXPECT_EQ(device_->Register(0x830) >> 16 & 0xFU, 15U) << "trigger mode";
  const double ladder[] = {0.001, 0.003, 0.005, 0.007};
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 12U);
  for (std::size_t i = 0; i < journal.size(); ++i) {
    ASSERT_EQ(journal[i].status, FrameStatus::kOk) << journal[i].detail;
    EXPECT_EQ(Value(journal[i].position), static_cast<std::int64_t>(i / 4));
    EXPECT_EQ(journal[i].proof, ExposureProof::kEmbedded);
    EXPECT_THAT(journal[i].settings_readback_json, HasSubstr("cycle_step"));
    const double seconds = journal[i].exposure.time.seconds();
    EXPECT_NEAR(seconds / ladder[i % 4], 1.0, 0.01);
    const auto image = ReadImage(path("sessions") / "s" / journal[i].file);
    ASSERT_TRUE(image) << image.error().message;
    EXPECT_EQ(std::get<Image<std::uint8_t>>(image->pixels).at(20, 100),
              device_->PixelAt(20, 100, seconds, 0.0));
  }
  const auto status = Client().Get("/v1/status");
  ASSERT_TRUE(status);
  EXPECT_EQ((*status)["camera"]["counters"]["cycle_frames"], 12);
  daemon->Signal(SIGTERM);
  EXPECT_EQ(daemon->Wait(), 0) << daemon->Log();
  EXPECT_THAT(daemon->Log(), HasSubstr("exposure cycle is used: a trigger takes a series of 4"));
}

}  // namespace
}  // namespace omnihdr::camera_daemon_test
