// A camera's USB traffic recorded and played back to the same driver without the camera.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <random>
#include <thread>

#include "core/base/file.h"
#include "drivers/iidc/usb_link.h"
#include "drivers/usb/libusb_bus.h"
#include "drivers/usb/recording.h"
#include "drivers/usb/recording_format.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/emulators/umockdev_usb.h"

namespace omnihdr::usb_recording_test {
namespace {

using ::testing::HasSubstr;

class UsbRecording : public ::testing::Test {
 protected:
  std::filesystem::path file() const { return emulated_.folder.path() / "camera.usb"; }
  std::unique_ptr<iidc::IidcCamera> CameraOn(std::shared_ptr<usb::Bus> bus) const {
    return std::make_unique<iidc::IidcCamera>(emulated_.CameraOptions(),
                                              iidc::MakeUsbFinder(std::move(bus)));
  }
  // What a camera delivers for a few triggers, `pause` after one another.
  static std::vector<CameraFrame> TakeSome(iidc::IidcCamera& camera, Nanoseconds pause = {}) {
    std::vector<CameraFrame> frames;
    const Result<CameraInfo> info = camera.Open();
    EXPECT_TRUE(info) << info.error().message;
    if (!info || !camera.Start()) return frames;
    std::uint64_t number = 0;
    for (const double seconds : {0.001, 0.004, 0.004, 0.016}) {
      Result<CameraFrame> frame = testing::Take(camera, number++, seconds);
      EXPECT_TRUE(frame) << frame.error().message;
      if (frame) frames.push_back(std::move(*frame));
      std::this_thread::sleep_for(pause);
    }
    camera.Stop();
    camera.Close();
    return frames;
  }
  std::vector<CameraFrame> Record() {
    emulators::UmockdevUsb plug(emulated_.device);
    auto bus = usb::MakeRecordingBus(usb::MakeLibusbBus(), {.file = file()});
    return TakeSome(*CameraOn(std::move(bus)));
  }

  testing::EmulatedIidc emulated_;
};

TEST_F(UsbRecording, PlayedBackItGivesTheSameFramesWithTheSameProof) {
  const std::vector<CameraFrame> recorded = Record();
  auto bus = usb::MakeReplayingBus(file());
  ASSERT_TRUE(bus) << bus.error().message;
  const std::vector<CameraFrame> played = TakeSome(*CameraOn(std::move(*bus)));
  ASSERT_EQ(recorded.size(), 4U);
  ASSERT_EQ(played.size(), 4U);
  for (std::size_t i = 0; i < played.size(); ++i) {
    EXPECT_EQ(played[i].status, FrameStatus::kOk);
    EXPECT_EQ(played[i].measured_exposure, recorded[i].measured_exposure);
    EXPECT_EQ(played[i].proof, recorded[i].proof);
    EXPECT_EQ(played[i].camera_counter, recorded[i].camera_counter);
    const auto& a = std::get<Image<std::uint8_t>>(played[i].pixels);
    const auto& b = std::get<Image<std::uint8_t>>(recorded[i].pixels);
    EXPECT_TRUE(
        std::equal(a.values().begin(), a.values().end(), b.values().begin(), b.values().end()));
  }
}

// By the host's clock the second frame would have been taken before it was asked for.
TEST_F(UsbRecording, PlayedBackMoreSlowlyThanItWasRecordedNoFrameIsTakenForAStray) {
  ASSERT_EQ(Record().size(), 4U);
  const auto camera = CameraOn(usb::MakeReplayingBus(file()).value());
  EXPECT_EQ(TakeSome(*camera, std::chrono::milliseconds(200)).size(), 4U);
  EXPECT_EQ(camera->counts().strays, 0U);
}

TEST_F(UsbRecording, ADriverThatAsksSomethingElseIsToldWhat) {
  Record();
  iidc::IidcCameraOptions options = emulated_.CameraOptions();
  options.white_balance_blue = 99;
  iidc::IidcCamera camera(options, iidc::MakeUsbFinder(usb::MakeReplayingBus(file()).value()));
  const Result<CameraInfo> info = camera.Open();
  ASSERT_FALSE(info);
  EXPECT_EQ(info.error().kind, ErrorKind::kProtocol);
  EXPECT_THAT(info.error().message, HasSubstr("WHITE_BALANCE"));
  EXPECT_THAT(info.error().message, HasSubstr("recorded was \"write request 0x7f value 0x080c"));
}

TEST_F(UsbRecording, CutOffAnywhereItIsPlayedAsFarAsItGoes) {
  Record();
  const std::vector<std::byte> whole = ReadFile(file()).value();
  for (std::size_t length = 0; length < whole.size(); length += 1 + whole.size() / 200) {
    auto bus = usb::MakeReplayingBus(
        std::vector<std::byte>(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(length)));
    if (length < usb::kRecordingMagic.size()) {
      EXPECT_EQ(bus.error().kind, ErrorKind::kData);
      continue;
    }
    ASSERT_TRUE(bus);
    auto camera = CameraOn(std::move(*bus));
    if (!camera->Open() || !camera->Start()) continue;
    std::uint64_t number = 0;
    Result<CameraFrame> frame = testing::Take(*camera, number, 0.001);
    while (frame && ++number < 4) {
      frame = testing::Take(*camera, number, number == 3 ? 0.016 : 0.004);
    }
    if (!frame) {
      EXPECT_EQ(frame.error().kind, ErrorKind::kUnavailable) << frame.error().message;
    }
  }
}

TEST_F(UsbRecording, ItStopsGrowingAtItsLimitAndTheCameraGoesOn) {
  emulators::UmockdevUsb plug(emulated_.device);
  auto bus = usb::MakeRecordingBus(usb::MakeLibusbBus(), {.file = file(), .max_bytes = 30'000});
  EXPECT_EQ(TakeSome(*CameraOn(std::move(bus))).size(), 4U);
  EXPECT_LE(std::filesystem::file_size(file()), 30'000U);
  EXPECT_TRUE(usb::MakeReplayingBus(file()));
}

TEST_F(UsbRecording, AFileThatCannotBeMadeIsSaidBeforeTheCameraIsUsed) {
  auto bus = usb::MakeRecordingBus(usb::MakeLibusbBus(),
                                   {.file = emulated_.folder.path() / "none" / "camera.usb"});
  const auto devices = bus->List();
  ASSERT_FALSE(devices);
  EXPECT_EQ(devices.error().kind, ErrorKind::kCannotCreate);
}

TEST(UsbRecordedCall, ComesBackAsItWasAndAnyBytesAreACallOrNot) {
  usb::RecordedCall call;
  call.kind = usb::RecordedCall::Kind::kIn;
  call.setup = {0x7F, 0x0614, 0xF0F0};
  call.number = 4;
  call.error = Error{ErrorKind::kTemporary, "no answer in 5 ms"};
  call.device.ports = {1, 2};
  call.devices.resize(2);
  call.chunk.bytes.resize(100);
  call.chunk.gap = true;
  const std::vector<std::byte> bytes = usb::EncodeCall(call);
  const auto again = usb::DecodeCall(bytes);
  ASSERT_TRUE(again);
  EXPECT_EQ(usb::EncodeCall(*again), bytes);
  EXPECT_EQ(again->Request(), "read request 0x7f value 0x0614 index 0xf0f0, 4 bytes");
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_FALSE(usb::DecodeCall(std::span(bytes).first(length))) << length;
  }
  std::mt19937 random(1);
  for (int round = 0; round < 20000; ++round) {
    std::vector<std::byte> damaged = bytes;
    for (int i = 0; i < 3; ++i)
      damaged[random() % damaged.size()] = static_cast<std::byte>(random());
    const auto decoded = usb::DecodeCall(damaged);
    if (decoded) {
      EXPECT_FALSE(decoded->Request().empty());
    }
  }
}

}  // namespace
}  // namespace omnihdr::usb_recording_test
