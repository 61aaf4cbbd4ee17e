// The USB seam with the real libusb over an emulated device (umockdev).

#include "drivers/usb/usb.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/iidc/trigger_mode.h"
#include "drivers/iidc/usb_link.h"
#include "drivers/usb/libusb_bus.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/emulators/umockdev_usb.h"

namespace omnihdr::usb_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::HasSubstr;

TEST(UsbfsMemory, TooLittleIsExplainedWithTheNumberToSet) {
  const testing::TemporaryDirectory folder;
  const auto file = folder.path() / "usbfs_memory_mb";
  const auto check = [&](const char* content, std::size_t mib) {
    std::ofstream(file) << content;
    return usb::CheckUsbfsMemory(mib << 20, file);
  };
  EXPECT_TRUE(check("16\n", 16));
  EXPECT_TRUE(check("0\n", 5000));
  EXPECT_TRUE(check("many\n", 5000));
  EXPECT_TRUE(usb::CheckUsbfsMemory(5000, folder.path() / "none"));
  const Status status = check("16\n", 17);
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().message, HasSubstr("needs 17 MiB"));
  EXPECT_THAT(status.error().message, HasSubstr("allows 16 MiB"));
  EXPECT_THAT(status.error().message, HasSubstr("usbcore.usbfs_memory_mb=68"));
}

TEST(UsbNames, TellTheWayFromTheRootHub) {
  usb::DeviceInfo info;
  info.vendor = 0x1E10;
  info.product = 0x2004;
  info.bus = 1;
  EXPECT_EQ(info.Name(), "usb 1 (1e10:2004)");
  info.ports = {2, 3};
  EXPECT_EQ(info.Name(), "usb 1-2.3 (1e10:2004)");
}

TEST(UsbStreamOptions, OutOfRangeAreNamed) {
  usb::BulkStreamOptions options;
  EXPECT_TRUE(options.Validate());
  options.transfers = 0;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("transfers: 0"));
}

class UsbTest : public ::testing::Test {
 protected:
  std::unique_ptr<usb::Device> Open() {
    const Result<std::vector<usb::DeviceInfo>> devices = bus_->List();
    EXPECT_TRUE(devices) << devices.error().message;
    if (!devices || devices->size() != 1) return nullptr;
    Result<std::unique_ptr<usb::Device>> device = bus_->Open(devices->front());
    EXPECT_TRUE(device) << device.error().message;
    return device ? std::move(*device) : nullptr;
  }
  // Streaming and waiting for triggers.
  void OpenStreaming() {
    auto finder = iidc::MakeUsbFinder(bus_);
    Result<iidc::ReadyCamera> ready =
        iidc::OpenAndSetUp(*finder, emulated_.CameraOptions(), EmulatedTimeouts());
    ASSERT_TRUE(ready) << ready.error().message;
    camera_ = std::move(*ready);
    ASSERT_TRUE(camera_.link->StartStream(camera_.format.frame_bytes));
    ASSERT_TRUE(
        camera_.registers->WriteChecked(iidc::kIsoEnable, iidc::Bit(31), iidc::Bit(31), "ISO_EN"));
    ASSERT_TRUE(camera_.shutter->SetAbsolute(0.0001));
  }
  static iidc::RegisterTimeouts EmulatedTimeouts() {
    iidc::RegisterTimeouts timeouts;
    timeouts.access = seconds(3);
    timeouts.settle = seconds(3);
    return timeouts;
  }
  void Trigger() {
    ASSERT_TRUE(iidc::WaitForTriggerReady(*camera_.registers));
    ASSERT_TRUE(iidc::SendSoftwareTrigger(*camera_.registers));
  }

  testing::EmulatedIidc emulated_;
  emulators::UmockdevUsb plug_{emulated_.device};
  std::shared_ptr<usb::Bus> bus_ = usb::MakeLibusbBus();
  iidc::ReadyCamera camera_;
};

TEST_F(UsbTest, ADeviceIsListedOpenedAndGoneWhenUnplugged) {
  const Result<std::vector<usb::DeviceInfo>> devices = bus_->List();
  ASSERT_TRUE(devices);
  ASSERT_EQ(devices->size(), 1U);
  EXPECT_EQ(devices->front().vendor, 0x1E10);
  auto device = Open();
  ASSERT_TRUE(device);
  EXPECT_EQ(device->PacketBytes(0x81), 512);
  EXPECT_FALSE(device->PacketBytes(0x83));
  plug_.Unplug();
  std::array<std::byte, 4> quadlet;
  const usb::ControlSetup rom = iidc::SetupForAddress(0xFFFF'F000'0400).value();
  EXPECT_EQ(device->VendorIn(rom, quadlet, milliseconds(200)).error().kind,
            ErrorKind::kUnavailable);
  device.reset();
  EXPECT_TRUE(bus_->List()->empty());
  const auto absent = bus_->Open(devices->front());
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().kind, ErrorKind::kUnavailable);
  plug_.PlugIn();
  EXPECT_TRUE(Open());
}

TEST_F(UsbTest, ARequestIsAnsweredRefusedOrEndsInItsTimeout) {
  auto device = Open();
  ASSERT_TRUE(device);
  std::array<std::byte, 4> quadlet;
  const usb::ControlSetup rom = iidc::SetupForAddress(0xFFFF'F000'0404).value();
  ASSERT_TRUE(device->VendorIn(rom, quadlet, seconds(1)));
  EXPECT_EQ(quadlet[0], std::byte{0x34});  // little-endian "1394"
  EXPECT_EQ(quadlet[3], std::byte{0x31});
  emulated_.device->Set({.stall_registers = 1});
  EXPECT_EQ(device->VendorIn(rom, quadlet, seconds(1)).error().kind, ErrorKind::kProtocol);
  emulated_.device->Set({.nak_registers = 1});
  const HostTime before = emulated_.clock.Now();
  const Status none = device->VendorIn(rom, quadlet, milliseconds(60));
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().kind, ErrorKind::kTemporary);
  EXPECT_EQ(none.error().message, "no answer in 60 ms");
  EXPECT_LT(emulated_.clock.Now() - before, seconds(5));
  EXPECT_TRUE(device->VendorIn(rom, quadlet, seconds(1)));
}

TEST_F(UsbTest, FramesComeInOrderAndBuffersGoRound) {
  OpenStreaming();
  for (int i = 0; i < 40; ++i) {
    Trigger();
    Result<iidc::StreamChunk> chunk = camera_.link->ReadStream(seconds(2));
    ASSERT_TRUE(chunk) << chunk.error().message;
    EXPECT_TRUE(chunk->ended_short);
    EXPECT_FALSE(chunk->gap);
    ASSERT_EQ(chunk->bytes.size(), camera_.format.frame_bytes);
    const auto info = iidc::ParseEmbeddedInfo(chunk->bytes, camera_.picture.embedded);
    EXPECT_EQ(info->counter, 100U + static_cast<std::uint32_t>(i));
    camera_.link->Recycle(std::move(*chunk));
  }
  camera_.link->StopStream();
  EXPECT_EQ(camera_.link->ReadStream(milliseconds(1)).error().kind, ErrorKind::kUnavailable);
  ASSERT_TRUE(camera_.link->StartStream(camera_.format.frame_bytes));
  Trigger();
  EXPECT_TRUE(camera_.link->ReadStream(seconds(2)));
}

TEST_F(UsbTest, ABufferThatIsNotGivenBackIsMissedAsAGap) {
  OpenStreaming();
  std::vector<iidc::StreamChunk> kept;
  bool gap = false;
  for (int i = 0; i < 40 && !gap; ++i) {
    Trigger();
    Result<iidc::StreamChunk> chunk = camera_.link->ReadStream(milliseconds(200));
    if (!chunk) {
      // Everything is kept here: give one back, and what comes next tells of the loss.
      ASSERT_FALSE(kept.empty());
      camera_.link->Recycle(std::move(kept.back()));
      kept.pop_back();
      continue;
    }
    gap = chunk->gap;
    kept.push_back(std::move(*chunk));
  }
  EXPECT_TRUE(gap);
}

TEST_F(UsbTest, AStalledEndpointIsBroughtBackToLife) {
  OpenStreaming();
  emulated_.device->Set({.stall_stream = 1});
  const Result<iidc::StreamChunk> failed = camera_.link->ReadStream(seconds(2));
  ASSERT_TRUE(failed) << failed.error().message;
  EXPECT_EQ(failed->error, "the endpoint stalled");
  Trigger();
  Result<iidc::StreamChunk> chunk = Fail(ErrorKind::kTemporary, "none yet");
  for (int i = 0; i < 20 && !chunk && chunk.error().kind == ErrorKind::kTemporary; ++i) {
    chunk = camera_.link->ReadStream(milliseconds(200));
  }
  ASSERT_TRUE(chunk) << chunk.error().message;
  EXPECT_EQ(chunk->bytes.size(), camera_.format.frame_bytes);
}

TEST_F(UsbTest, AnEndpointThatStallsForEverEndsTheStream) {
  OpenStreaming();
  emulated_.device->Set({.stall_stream = 1'000'000});
  ErrorKind end = ErrorKind::kTemporary;
  for (int i = 0; i < 500 && end == ErrorKind::kTemporary; ++i) {
    const Result<iidc::StreamChunk> chunk = camera_.link->ReadStream(milliseconds(100));
    if (!chunk) end = chunk.error().kind;
  }
  EXPECT_EQ(end, ErrorKind::kIo);
}

TEST_F(UsbTest, AnUnpluggedDeviceEndsTheStreamAtOnce) {
  OpenStreaming();
  plug_.Unplug();
  const HostTime before = emulated_.clock.Now();
  const Result<iidc::StreamChunk> chunk = camera_.link->ReadStream(seconds(5));
  ASSERT_FALSE(chunk);
  EXPECT_EQ(chunk.error().kind, ErrorKind::kUnavailable);
  EXPECT_LT(emulated_.clock.Now() - before, seconds(2));
}

TEST_F(UsbTest, AFrameOfSeveralTransfersIsWhole) {
  emulators::IidcDeviceOptions options;
  options.max_width = 640;
  options.rows_per_sensor = 480;
  options.max_height = 6 * 480;
  plug_.Unplug();
  testing::EmulatedIidc large(options);
  emulators::UmockdevUsb plug(large.device);
  iidc::IidcCamera camera(large.CameraOptions(), iidc::MakeUsbFinder(bus_), EmulatedTimeouts());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  for (std::uint64_t number = 0; number < 3; ++number) {
    const Result<CameraFrame> frame = testing::Take(camera, number, 0.004);
    ASSERT_TRUE(frame) << frame.error().message;
    ASSERT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
    const auto& pixels = std::get<Image<std::uint8_t>>(frame->pixels);
    const double exposure_s = frame->measured_exposure->time.seconds();
    for (int y = 1; y < pixels.height(); y += 97) {
      for (int x = 0; x < pixels.width(); x += 11) {
        ASSERT_EQ(pixels.at(x, y), large.device->PixelAt(x, y, exposure_s, 0.0)) << x << " " << y;
      }
    }
  }
  camera.Close();
}

TEST_F(UsbTest, ACameraTakesPicturesThroughStallsLossesAndAReturn) {
  auto camera = std::make_unique<iidc::IidcCamera>(emulated_.CameraOptions(),
                                                   iidc::MakeUsbFinder(bus_), EmulatedTimeouts());
  ASSERT_TRUE(camera->Open());
  ASSERT_TRUE(camera->Start());
  std::uint64_t number = 0;
  EXPECT_EQ(testing::Take(*camera, number++, 0.001)->status, FrameStatus::kOk);
  emulated_.device->Set({.short_frames = 1});
  EXPECT_EQ(testing::Take(*camera, number++, 0.001)->status, FrameStatus::kCorrupt);
  EXPECT_EQ(testing::Take(*camera, number++, 0.001)->status, FrameStatus::kOk);
  emulated_.device->Set({.unmarked_losses = 1});
  EXPECT_EQ(testing::Take(*camera, number++, 0.001)->status, FrameStatus::kCorrupt);
  EXPECT_EQ(testing::Take(*camera, number++, 0.001)->status, FrameStatus::kOk);
  emulated_.device->Set({.stall_registers = 1});
  EXPECT_EQ(testing::Take(*camera, number++, 0.002)->status, FrameStatus::kMissedTrigger);
  EXPECT_EQ(testing::Take(*camera, number++, 0.002)->status, FrameStatus::kOk);
  plug_.Unplug();
  EXPECT_EQ(camera->Receive(seconds(2)).error().kind, ErrorKind::kUnavailable);
  camera->Stop();
  camera->Close();
  EXPECT_FALSE(camera->Open());
  plug_.PlugIn();
  ASSERT_TRUE(camera->Open());
  ASSERT_TRUE(camera->Start());
  EXPECT_EQ(testing::Take(*camera, number++, 0.001)->status, FrameStatus::kOk);
}

}  // namespace
}  // namespace omnihdr::usb_test
