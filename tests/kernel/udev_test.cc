// What udev makes of cameras and chips: lasting names by which the drivers find them, and our own
// rules. The other tests of this program have no udev.

#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "drivers/iidc/iidc_camera.h"
#include "drivers/v4l2/kernel_device.h"
#include "drivers/v4l2/v4l2_camera.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/iidc_usb_function.h"
#include "tests/emulators/uvc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/integration/programs.h"
#include "tests/kernel/sim_chip.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::udev_test {
namespace {

namespace fs = std::filesystem;
using emulators::UvcDevice;
using emulators::UvcDeviceOptions;
using emulators::UvcUsbFunction;
using emulators::VhciUsb;
using integration::Eventually;
using ::testing::HasSubstr;

constexpr const char* kUdevd = "/usr/lib/systemd/systemd-udevd";
constexpr const char* kUdevadm = "/usr/bin/udevadm";
constexpr const char* kRun = "/run/udev";

// "gpio 660", "?" when it is not there.
std::string Access(const fs::path& node) {
  struct stat facts {};
  if (::stat(node.c_str(), &facts) != 0) return "?";
  const group* owner = ::getgrgid(facts.st_gid);
  return fmt::format("{} {:o}", owner != nullptr ? owner->gr_name : "?", facts.st_mode & 0777U);
}

class Udev : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!fs::exists(kUdevd)) GTEST_SKIP() << kUdevd << " is not installed (scripts/setup kernel)";
    udevd_ = std::make_unique<integration::Program>(kUdevd, std::vector<std::string>{"--debug"},
                                                    folder_.path() / "udevd.log");
    ASSERT_TRUE(Eventually([] { return fs::exists(fs::path(kRun) / "control"); })) << udevd_->Log();
    // That is there before it listens to the kernel: what comes meanwhile is never told it.
    integration::Program ping(kUdevadm, {"control", "--ping"}, folder_.path() / "ping.log");
    ASSERT_EQ(ping.Wait(), 0) << ping.Log() << udevd_->Log();
  }
  void TearDown() override {
    if (!udevd_) return;
    udevd_->Signal(SIGTERM);
    udevd_->Wait();
    // As if it had never run: what it does not get to take away any more is taken away here.
    std::error_code ignored;
    for (const char* folder : {kRun, "/dev/v4l", "/dev/omnihdr"}) fs::remove_all(folder, ignored);
    if (HasFailure()) std::ofstream("/out/udevd.log") << udevd_->Log();
  }
  std::string rig() const { return (folder_.path() / "head.toml").string(); }

  const SystemClock clock_;
  const testing::TemporaryDirectory folder_;
  std::unique_ptr<integration::Program> udevd_;
};

// A webcam, and its function that may be plugged in anywhere.
struct Webcam {
  explicit Webcam(const Clock& clock, const std::string& serial)
      : device(std::make_shared<UvcDevice>(UvcDeviceOptions{.serial = serial}, clock)),
        function(std::make_shared<UvcUsbFunction>(device)) {}
  std::shared_ptr<UvcDevice> device;
  std::shared_ptr<UvcUsbFunction> function;
};

// The link to the webcam's picture node in that folder whose name has `part`; empty = none.
std::string LinkIn(const std::string& folder, const std::string& part) {
  std::error_code failed;
  fs::directory_iterator at(fs::path("/dev/v4l") / folder, failed);
  for (; !failed && at != fs::directory_iterator(); at.increment(failed)) {
    const std::string link = at->path().string();
    if (link.find(part) != std::string::npos && link.ends_with("-video-index0")) return link;
  }
  return {};
}

TEST_F(Udev, AWebcamIsFoundByItsLastingNameWhenItReturnsAtAnotherPortAndAnotherHasItsNode) {
  const Webcam mine(clock_, "UVC-0001");
  const Webcam other(clock_, "UVC-0002");
  const UvcDeviceOptions& device = mine.device->options();
  std::ofstream(rig()) << emulators::EmulatedRig(1, device.width, device.height, BayerOrder::kNone);
  auto plug = std::make_unique<VhciUsb>(mine.function, 0);
  std::string by_id;
  std::string by_path;
  ASSERT_TRUE(Eventually([&] {
    by_id = LinkIn("by-id", "UVC-0001");
    by_path = LinkIn("by-path", "usb");
    return !by_id.empty() && !by_path.empty();
  }));
  EXPECT_EQ(by_id, "/dev/v4l/by-id/usb-Emulators_Test_UVC_Camera_UVC-0001-video-index0");
  const std::string node = fs::canonical(by_id).string();
  EXPECT_EQ(fs::canonical(by_path).string(), node);
  // As every camera of the kernel's, by udev's own rule.
  EXPECT_EQ(Access(node), "video 660");

  v4l2::V4l2CameraOptions options;
  options.rig_file = rig();
  options.coding = v4l2::Coding::kGrey;
  options.latency_frames = device.latency_frames + 2;
  options.frame_timeout_s = 10.0;
  // The serial number of the camera of that name; else why there is none.
  const auto serial_of = [&](const std::string& name) -> std::string {
    options.device = name;
    v4l2::V4l2Camera camera(options, v4l2::MakeKernelSystem());
    const Result<CameraInfo> info = camera.Open();
    return info ? info->description.serial : info.error().message;
  };
  for (const std::string& name : {by_path, fs::path(by_id).filename().string(), std::string()}) {
    EXPECT_EQ(serial_of(name), "UVC-0001") << name;
  }
  options.device = by_id;
  v4l2::V4l2Camera camera(options, v4l2::MakeKernelSystem());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  plug->Unplug();
  const Result<CameraFrame> gone = camera.Receive(std::chrono::seconds(20));
  ASSERT_FALSE(gone);
  ASSERT_EQ(gone.error().kind, ErrorKind::kUnavailable) << gone.error().message;
  camera.Stop();
  camera.Close();
  ASSERT_TRUE(Eventually([&] { return !fs::exists(fs::symlink_status(by_id)); }));
  EXPECT_THAT(serial_of(by_id), HasSubstr("no video device"));

  plug.reset();
  const VhciUsb other_plug(other.function, 0);
  ASSERT_TRUE(Eventually([] { return !LinkIn("by-id", "UVC-0002").empty(); }));
  mine.function->PlugIn();
  const VhciUsb elsewhere(mine.function, 3);
  ASSERT_TRUE(Eventually([&] { return fs::exists(by_id); }));
  EXPECT_NE(fs::canonical(by_id).string(), node);
  EXPECT_EQ(serial_of(node), "UVC-0002");
  EXPECT_EQ(serial_of(by_path), "UVC-0002");
  EXPECT_EQ(serial_of("UVC-0001"), "UVC-0001");
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  ExposureRequest request;
  request.exposure.time = ExposureTime::Seconds(0.008);
  request.trigger_time = clock_.Now();
  ASSERT_TRUE(camera.Trigger(request));
  const Result<CameraFrame> frame = camera.Receive(std::chrono::seconds(20));
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
  EXPECT_EQ(std::get<Image<std::uint8_t>>(frame->pixels).at(20, 20),
            mine.device->PixelAt(20, 20, 0.008));
}

TEST_F(Udev, OurRulesGiveAKnownCameraToItsGroupUnderALastingNameAndNoOtherDevice) {
  const auto head = std::make_shared<emulators::IidcDevice>(emulators::IidcDeviceOptions{}, clock_);
  const Webcam webcam(clock_, "UVC-0001");
  const fs::path lasting = fmt::format("/dev/omnihdr/camera-{:08X}", head->options().serial);
  const VhciUsb webcam_plug(webcam.function, 1);
  ASSERT_TRUE(Eventually([] { return !LinkIn("by-id", "UVC-0001").empty(); }));
  auto plug = std::make_unique<VhciUsb>(std::make_shared<emulators::IidcUsbFunction>(head), 0);
  ASSERT_TRUE(Eventually([&] { return Access(lasting) == "plugdev 660"; })) << Access(lasting);
  int given = 0;
  for (const auto& node : fs::recursive_directory_iterator("/dev/bus/usb")) {
    if (!node.is_directory() && Access(node.path()).starts_with("plugdev")) ++given;
  }
  EXPECT_EQ(given, 1);
  // The node it leads to is the camera: it opens.
  const emulators::IidcDeviceOptions& device = head->options();
  std::ofstream(rig()) << emulators::EmulatedRig(6, device.max_width, device.rows_per_sensor,
                                                 device.bayer);
  iidc::IidcCameraOptions options;
  options.rig_file = rig();
  const auto camera = iidc::MakeIidcCamera(options);
  const Result<CameraInfo> info = camera->Open();
  EXPECT_TRUE(info) << info.error().message;
  camera->Close();
  plug->Unplug();
  EXPECT_TRUE(Eventually([&] { return !fs::exists(fs::symlink_status(lasting)); }));
}

TEST_F(Udev, OurRuleGivesAChipOfLinesToItsGroup) {
  const kernel::SimChip chip("vehicle", {"trigger-in"});
  const fs::path node = fs::path("/dev") / chip.name();
  EXPECT_TRUE(Eventually([&] { return Access(node) == "gpio 660"; })) << Access(node);
}

}  // namespace
}  // namespace omnihdr::udev_test
