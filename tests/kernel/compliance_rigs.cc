// The camera that takes the suite of tests/compliance through the kernel's own driver.

#include <fstream>
#include <memory>

#include "core/base/clock.h"
#include "drivers/v4l2/find_camera.h"
#include "drivers/v4l2/kernel_device.h"
#include "drivers/v4l2/v4l2_camera.h"
#include "tests/compliance/camera_suite.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/uvc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::compliance {
namespace {

struct Webcam {
  Webcam() {
    const emulators::UvcDeviceOptions& options = device->options();
    std::ofstream(rig()) << emulators::EmulatedRig(1, options.width, options.height,
                                                   BayerOrder::kNone);
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }
  // The kernel enumerates at its own pace.
  static void WaitUntilThere() {
    const auto system = v4l2::MakeKernelSystem();
    integration::Eventually([&] { return !v4l2::ListCameras(*system).empty(); });
  }

  const SystemClock clock;
  const testing::TemporaryDirectory folder;
  const std::shared_ptr<emulators::UvcDevice> device =
      std::make_shared<emulators::UvcDevice>(emulators::UvcDeviceOptions{}, clock);
  emulators::VhciUsb plug{std::make_shared<emulators::UvcUsbFunction>(device)};
};

Rig MakeWebcamRig() {
  auto webcam = std::make_shared<Webcam>();
  Webcam::WaitUntilThere();
  v4l2::V4l2CameraOptions options;
  options.device = webcam->device->options().serial;
  options.rig_file = webcam->rig();
  options.coding = v4l2::Coding::kGrey;
  // It is opened a hundred times: the latency is given. uvc_test.cc and camera_tool_test.cc measure
  // it.
  options.latency_frames = webcam->device->options().latency_frames + 2;
  options.frame_timeout_s = 10.0;
  Rig rig;
  rig.surroundings = webcam;
  rig.camera = std::make_unique<v4l2::V4l2Camera>(options, v4l2::MakeKernelSystem());
  rig.frame_timeout = std::chrono::seconds(20);
  rig.unplug = [webcam] { webcam->plug.Unplug(); };
  rig.plug_in = [webcam] {
    webcam->plug.PlugIn();
    Webcam::WaitUntilThere();
  };
  for (const double t : {0.0001, 0.0005, 0.002, 0.01, 0.05}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

}  // namespace

// The IIDC camera takes it through libusb on an emulated device (tests/compliance).
std::vector<RigFactory> AllRigs() { return {{"v4l2_of_the_kernel", MakeWebcamRig}}; }

}  // namespace omnihdr::compliance
