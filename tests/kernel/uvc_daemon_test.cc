// omnihdrd as on a vehicle, with a camera of the video class through the kernel's uvcvideo.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <memory>
#include <utility>

#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "daemon/api/client.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/uvc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/kernel/appliance.h"
#include "tests/kernel/serial_ports.h"

namespace omnihdr::uvc_daemon_test {
namespace {

using emulators::UvcDevice;
using emulators::UvcDeviceOptions;
using integration::Eventually;
using kernel::kArmed;
using kernel::kCapturing;
using kernel::kLost;
using kernel::kReady;
using kernel::kRecorded;
using kernel::kState;
using kernel::kTriggers;

class ApplianceWithAWebcam : public kernel::ApplianceTest {
 protected:
  void PlugIn(const UvcDeviceOptions& options) {
    device_ = std::make_shared<UvcDevice>(options, clock_);
    plug_ =
        std::make_unique<emulators::VhciUsb>(std::make_shared<emulators::UvcUsbFunction>(device_));
  }
  // A grey camera of a rig of one sensor. The latency is given: opening takes no measurement.
  void StartGrey(const std::string& modbus_server = "") {
    UvcDeviceOptions options;
    options.height = 64;
    PlugIn(options);
    const UvcDeviceOptions& device = device_->options();
    std::ofstream(path("head.toml"))
        << emulators::EmulatedRig(1, device.width, device.height, BayerOrder::kNone);
    Setup setup;
    setup.camera = fmt::format(
        "driver = \"v4l2\"\n[camera.v4l2]\nrig = \"head.toml\"\nformat = \"grey\"\n"
        "device = \"{}\"\nlatency_frames = 4",
        device.serial);
    setup.exposures = "exposures_s = [0.002, 0.008, 0.032]";
    setup.modbus_server = modbus_server;
    ASSERT_NO_FATAL_FAILURE(Start(setup));
  }
  // A good frame: the exposure read back, and pixels of it.
  void ExpectFrame(const FrameRecord& record, double exposure_s) const {
    ASSERT_EQ(record.status, FrameStatus::kOk) << record.detail;
    EXPECT_EQ(record.proof, ExposureProof::kReadback);
    EXPECT_NEAR(record.exposure.time.seconds(), exposure_s, 1e-9);
    const auto image = ReadImage(path("sessions") / "s" / record.file);
    ASSERT_TRUE(image) << image.error().message;
    EXPECT_EQ(std::get<Image<std::uint8_t>>(image->pixels).at(20, 30),
              device_->PixelAt(20, 30, exposure_s));
  }

  std::shared_ptr<UvcDevice> device_;
  std::unique_ptr<emulators::VhciUsb> plug_;
};

// Radiance of over 100 : 1, more than one exposure shows: dark on the left, bright on the right,
// and a pattern on it.
float SceneAt(int x, int y, int width, int height) {
  const double across = (x + 0.5) / width;
  const double down = (y + 0.5) / height;
  return static_cast<float>(1.5 * std::exp2(7.0 * across) *
                            (1.0 + 0.3 * std::sin(12.0 * across + 5.0 * down)));
}

TEST_F(ApplianceWithAWebcam, ABracketIsRecordedEdgeByEdgeProvedByTheLatencyAndFused) {
  UvcDeviceOptions options;
  options.width = 256;
  options.height = 128;
  options.interval_s = 0.1;
  PlugIn(options);
  Image<float> scene(options.width, options.height);
  for (int y = 0; y < options.height; ++y) {
    for (int x = 0; x < options.width; ++x) {
      scene.at(x, y) = SceneAt(x, y, options.width, options.height);
    }
  }
  device_->SetScene(std::move(scene));
  Setup setup;
  setup.camera =
      "driver = \"v4l2\"\n[camera.v4l2]\nlayout = \"panorama\"\nformat = \"yuyv\"\n"
      "white_balance = 4600";
  setup.exposures = "exposures_s = [0.005, 0.02, 0.08]\nframes_per_position = 3";
  setup.pipeline = "enabled = true\n[stereo]\nwidth = 256\nlabels = 32";
  ASSERT_NO_FATAL_FAILURE(Start(setup));
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kReady); }));
  for (std::uint32_t i = 0; i < 3; ++i) {
    ASSERT_TRUE(Shoot()) << daemon_->Log();
    Registers seen{};
    EXPECT_TRUE(Eventually([&] { return Long(seen = ReadModbus(), kRecorded) == i + 1; }));
    EXPECT_TRUE(seen[kState] == kArmed || seen[kState] == kCapturing) << seen[kState];
    EXPECT_EQ(Long(seen, kTriggers), i + 1);
    EXPECT_EQ(Long(seen, kLost), 0U);
  }
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 3U);
  const double ladder[] = {0.005, 0.02, 0.08};
  for (std::size_t i = 0; i < journal.size(); ++i) {
    ASSERT_EQ(journal[i].status, FrameStatus::kOk) << journal[i].detail;
    EXPECT_EQ(journal[i].proof, ExposureProof::kLatency);
    EXPECT_NEAR(journal[i].exposure.time.seconds(), ladder[i], 1e-9);
    EXPECT_GE(journal[i].timestamp, journal[i].trigger_time);
    const auto image = ReadImage(path("sessions") / "s" / journal[i].file);
    ASSERT_TRUE(image) << image.error().message;
    const auto& pixels = std::get<Image<std::uint8_t>>(image->pixels);
    for (const int x : {30, 120, 220}) {
      for (int c = 0; c < 3; ++c) {
        EXPECT_NEAR(pixels.at(x, 60, c), device_->PixelAt(x, 60, ladder[i]), 2) << i << ' ' << x;
      }
    }
  }
  // The views are finished with the session.
  EXPECT_TRUE(ApiClient(path("api.sock")).Post("/v1/finish"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }))
      << daemon_->Log();
  Stop();
  const auto radiance = ReadExr(path("sessions") / "s" / "views" / "000000" / "radiance.exr");
  ASSERT_TRUE(radiance) << radiance.error().message << daemon_->Log();
  // The scene over its whole range, which no single exposure has.
  const Image<float>& green = radiance->channels.at("G");
  ASSERT_EQ(green.width(), 2 * green.height());
  for (const double across : {0.06, 0.2, 0.4, 0.6, 0.8, 0.94}) {
    const int x = static_cast<int>(across * green.width());
    const int y = green.height() / 3;
    const double truth = SceneAt(x, y, green.width(), green.height());
    EXPECT_NEAR(static_cast<double>(green.at(x, y)) / truth, 1.0, 0.06) << across;
  }
}

TEST_F(ApplianceWithAWebcam, UnpluggedInTheMiddleOfABracketItGoesOnWhenTheCameraReturns) {
  modbus::Endpoint master;
  master.connection = modbus::Connection::kRtu;
  master.device = kernel::kOtherEnd;
  master.baud = kernel::kSerialBaud;
  ASSERT_NO_FATAL_FAILURE(StartGrey(fmt::format("connection = \"rtu\"\ndevice = \"{}\"\nbaud = {}",
                                                kernel::kOneEnd, master.baud)));
  const auto be_silent = [&](bool on) {
    UvcDevice::Faults faults;
    faults.silent = on;
    device_->Set(faults);
  };
  UnplugInABracket({.unplug =
                        [&] {
                          plug_->Unplug();
                          be_silent(false);
                        },
                    .plug_in = [&] { plug_->PlugIn(); },
                    .before_the_third = [&] { be_silent(true); },
                    .master = master},
                   {0.002, 0.008}, [&](const FrameRecord& record, double seconds) {
                     ExpectFrame(record, seconds);
                   });
  Stop();
}

TEST_F(ApplianceWithAWebcam, EdgesFasterThanTheCameraAreAllInTheJournal) {
  ASSERT_NO_FATAL_FAILURE(StartGrey());
  const double ladder[] = {0.002, 0.008, 0.032};
  OutrunTheCamera(
      40, [&](const FrameRecord& record, std::size_t i) { ExpectFrame(record, ladder[i % 3]); });
  Stop();
}

}  // namespace
}  // namespace omnihdr::uvc_daemon_test
