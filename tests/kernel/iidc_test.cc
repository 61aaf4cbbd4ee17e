// The IIDC driver with an emulated camera that hangs on the kernel's USB, through the real libusb.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <thread>
#include <variant>

#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/usb_link.h"
#include "drivers/usb/libusb_bus.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/emulators/iidc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/integration/programs.h"

namespace omnihdr::iidc_test {
namespace {

using integration::Eventually;
using std::chrono::seconds;
using ::testing::HasSubstr;

class CameraOnTheKernelsUsb : public ::testing::Test {
 protected:
  // With patience: the machine is emulated, too.
  std::unique_ptr<iidc::IidcCamera> MakeCamera() const {
    iidc::IidcCameraOptions options = emulated_.CameraOptions();
    options.frame_timeout_s = 20.0;
    iidc::RegisterTimeouts timeouts;
    timeouts.access = seconds(10);
    timeouts.settle = seconds(20);
    return std::make_unique<iidc::IidcCamera>(options, iidc::MakeUsbFinder(bus_), timeouts);
  }
  // The camera as a device: waits until the kernel has enumerated it.
  std::unique_ptr<usb::Device> OpenDevice() const {
    std::unique_ptr<usb::Device> device;
    EXPECT_TRUE(Eventually([&] {
      const auto listed = bus_->List();
      if (!listed) return false;
      for (const usb::DeviceInfo& info : *listed) {
        if (info.vendor != 0x1E10) continue;
        if (auto opened = bus_->Open(info)) device = std::move(*opened);
      }
      return device != nullptr;
    }));
    return device;
  }
  static Status Open(Camera& camera) {
    Status last;
    Eventually([&] {
      const Result<CameraInfo> info = camera.Open();
      last = info ? Status() : Status(Forward(Error(info.error())));
      return static_cast<bool>(info);
    });
    return last;
  }
  Result<CameraFrame> Take(Camera& camera, std::uint64_t number, double exposure_s) const {
    ExposureRequest request;
    request.trigger = TriggerId{number};
    request.exposure.time = ExposureTime::Seconds(exposure_s);
    request.trigger_time = emulated_.clock.Now();
    Status triggered;
    Eventually([&] {
      triggered = camera.Trigger(request);
      return triggered || triggered.error().kind != ErrorKind::kTemporary;
    });
    if (!triggered) return Forward(std::move(triggered).error());
    return camera.Receive(seconds(30));
  }

  testing::EmulatedIidc emulated_;
  emulators::VhciUsb plug_{std::make_shared<emulators::IidcUsbFunction>(emulated_.device)};
  std::shared_ptr<usb::Bus> bus_ = usb::MakeLibusbBus();
};

TEST_F(CameraOnTheKernelsUsb, ADeviceIsEnumeratedOpenedOnceAndGoneWhenUnplugged) {
  auto device = OpenDevice();
  ASSERT_TRUE(device);
  EXPECT_EQ(device->info().product, 0x2004);
  EXPECT_EQ(device->PacketBytes(0x81), 512);
  const auto second = bus_->Open(device->info());
  ASSERT_FALSE(second);
  EXPECT_THAT(second.error().message, HasSubstr("in use by another program"));
  std::array<std::byte, 4> quadlet;
  const usb::ControlSetup rom = iidc::SetupForAddress(0xFFFF'F000'0400).value();
  EXPECT_TRUE(device->VendorIn(rom, quadlet, seconds(10)));
  plug_.Unplug();
  ASSERT_TRUE(Eventually([&] {
    const Status read = device->VendorIn(rom, quadlet, seconds(10));
    return !read && read.error().kind == ErrorKind::kUnavailable;
  }));
  device.reset();
  plug_.PlugIn();
  EXPECT_TRUE(OpenDevice());
}

TEST_F(CameraOnTheKernelsUsb, ARequestIsRefusedOrEndsInItsTimeout) {
  auto device = OpenDevice();
  ASSERT_TRUE(device);
  std::array<std::byte, 4> quadlet;
  const usb::ControlSetup rom = iidc::SetupForAddress(0xFFFF'F000'0400).value();
  emulators::IidcDevice::Faults faults;
  faults.stall_registers = 1;
  emulated_.device->Set(faults);
  EXPECT_EQ(device->VendorIn(rom, quadlet, seconds(10)).error().kind, ErrorKind::kProtocol);
  EXPECT_TRUE(device->VendorIn(rom, quadlet, seconds(10)));
  faults = {};
  faults.nak_registers = 1;
  emulated_.device->Set(faults);
  EXPECT_EQ(device->VendorIn(rom, quadlet, seconds(1)).error().kind, ErrorKind::kTemporary);
  EXPECT_TRUE(device->VendorIn(rom, quadlet, seconds(10)));
}

TEST_F(CameraOnTheKernelsUsb, EveryFrameProvesItsExposureAndShowsTheScene) {
  const auto camera = MakeCamera();
  const Status opened = Open(*camera);
  ASSERT_TRUE(opened) << opened.error().message;
  ASSERT_TRUE(camera->Start());
  const double ladder[] = {0.001, 0.004, 0.016};
  std::uint64_t first = 0;
  for (std::uint64_t i = 0; i < 9; ++i) {
    const Result<CameraFrame> frame = Take(*camera, i, ladder[i % 3]);
    ASSERT_TRUE(frame) << frame.error().message;
    ASSERT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
    EXPECT_EQ(frame->trigger, TriggerId{i});
    EXPECT_EQ(frame->proof, ExposureProof::kEmbedded);
    ASSERT_TRUE(frame->measured_exposure);
    const double exposure_s = frame->measured_exposure->time.seconds();
    EXPECT_NEAR(exposure_s / ladder[i % 3], 1.0, 0.01);
    if (i == 0) first = frame->camera_counter;
    EXPECT_EQ(frame->camera_counter, first + i);
    const auto& pixels = std::get<Image<std::uint8_t>>(frame->pixels);
    for (int y = 2; y < pixels.height(); y += 31) {
      EXPECT_EQ(pixels.at(20, y), emulated_.device->PixelAt(20, y, exposure_s, 0.0)) << y;
    }
  }
  EXPECT_EQ(camera->counts().torn, 0U);
  EXPECT_EQ(camera->counts().strays, 0U);
}

TEST_F(CameraOnTheKernelsUsb, ATornFrameIsMarkedAndTheNextOneIsWhole) {
  const auto camera = MakeCamera();
  const Status opened = Open(*camera);
  ASSERT_TRUE(opened) << opened.error().message;
  ASSERT_TRUE(camera->Start());
  emulators::IidcDevice::Faults faults;
  faults.short_frames = 1;
  emulated_.device->Set(faults);
  const Result<CameraFrame> torn = Take(*camera, 0, 0.001);
  ASSERT_TRUE(torn) << torn.error().message;
  EXPECT_EQ(torn->status, FrameStatus::kCorrupt);
  const Result<CameraFrame> whole = Take(*camera, 1, 0.001);
  ASSERT_TRUE(whole) << whole.error().message;
  EXPECT_EQ(whole->status, FrameStatus::kOk) << whole->detail;
}

TEST_F(CameraOnTheKernelsUsb, UnpluggedInAnExposureItIsGoneAndWorksAgainWhenItReturns) {
  const auto camera = MakeCamera();
  Status opened = Open(*camera);
  ASSERT_TRUE(opened) << opened.error().message;
  ASSERT_TRUE(camera->Start());
  ASSERT_TRUE(Take(*camera, 0, 0.001));
  std::thread unplug([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    plug_.Unplug();
  });
  const Result<CameraFrame> gone = Take(*camera, 1, 4.0);
  unplug.join();
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable) << gone.error().message;
  EXPECT_FALSE(camera->Open());
  plug_.PlugIn();
  opened = Open(*camera);
  ASSERT_TRUE(opened) << opened.error().message;
  ASSERT_TRUE(camera->Start());
  const Result<CameraFrame> back = Take(*camera, 2, 0.004);
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->status, FrameStatus::kOk) << back->detail;
  EXPECT_EQ(back->proof, ExposureProof::kEmbedded);
}

}  // namespace
}  // namespace omnihdr::iidc_test
