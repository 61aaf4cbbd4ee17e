// A camera's FireWire traffic recorded and played back to the same driver without the camera.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <random>
#include <thread>

#include "core/base/file.h"
#include "drivers/firewire/recording.h"
#include "drivers/firewire/recording_format.h"
#include "drivers/iidc/firewire_link.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/emulators/iidc_firewire.h"

namespace omnihdr::firewire_recording_test {
namespace {

using emulators::IidcFirewire;
using ::testing::HasSubstr;

emulators::IidcDeviceOptions OnFirewire() {
  emulators::IidcDeviceOptions options;
  options.link_packet_bytes = IidcFirewire::kFrameEnds;
  return options;
}

class FirewireRecording : public ::testing::Test {
 protected:
  std::filesystem::path file() const { return emulated_.folder.path() / "camera.fw"; }
  std::unique_ptr<iidc::IidcCamera> CameraOn(std::shared_ptr<firewire::Bus> bus,
                                             int white_balance_blue = -1) const {
    iidc::IidcCameraOptions options = emulated_.CameraOptions();
    options.white_balance_blue = white_balance_blue;
    options.frame_timeout_s = 1.0;
    return std::make_unique<iidc::IidcCamera>(options, iidc::MakeFirewireFinder(std::move(bus)),
                                              testing::EmulatedIidc::Timeouts());
  }
  // What a camera delivers for a few triggers; `before` each of them something happens.
  template <typename Before>
  static std::vector<CameraFrame> TakeSome(iidc::IidcCamera& camera, Before before) {
    std::vector<CameraFrame> frames;
    const Result<CameraInfo> info = camera.Open();
    EXPECT_TRUE(info) << info.error().message;
    if (!info || !camera.Start()) return frames;
    std::uint64_t number = 0;
    for (const double seconds : {0.001, 0.004, 0.004, 0.016, 0.001}) {
      before(number);
      Result<CameraFrame> frame = testing::Take(camera, number++, seconds);
      EXPECT_TRUE(frame) << frame.error().message;
      if (frame) frames.push_back(std::move(*frame));
    }
    camera.Stop();
    camera.Close();
    return frames;
  }
  // A bus that is busy, is reset, and loses packets.
  std::vector<CameraFrame> Record() {
    auto bus = firewire::MakeRecordingBus(bus_.MakeBus(), {.file = file()});
    return TakeSome(*CameraOn(std::move(bus)), [this](std::uint64_t number) {
      IidcFirewire::Faults faults;
      if (number == 1) faults.busy = 3;
      if (number == 2) faults.lose_middle_packets = 1;
      bus_.Set(faults);
      if (number == 3) {
        bus_.Reset();
        std::this_thread::sleep_for(std::chrono::milliseconds(150));  // seen in the pause
      }
    });
  }

  testing::EmulatedIidc emulated_{OnFirewire()};
  IidcFirewire bus_{emulated_.device};
};

TEST_F(FirewireRecording, PlayedBackItGivesTheSameFramesLossesAndResetsIncluded) {
  const std::vector<CameraFrame> recorded = Record();
  ASSERT_EQ(recorded.size(), 5U);
  EXPECT_EQ(recorded[2].status, FrameStatus::kCorrupt);
  EXPECT_GT(bus_.refreshes(), 0);
  // As fast as it goes, and more slowly than it was recorded.
  for (const auto pause : {std::chrono::milliseconds(0), std::chrono::milliseconds(100)}) {
    auto bus = firewire::MakeReplayingBus(file());
    ASSERT_TRUE(bus) << bus.error().message;
    const auto camera = CameraOn(std::move(*bus));
    const std::vector<CameraFrame> played =
        TakeSome(*camera, [&](std::uint64_t) { std::this_thread::sleep_for(pause); });
    ASSERT_EQ(played.size(), 5U);
    EXPECT_EQ(camera->counts().strays, 0U);
    for (std::size_t i = 0; i < played.size(); ++i) {
      EXPECT_EQ(played[i].status, recorded[i].status) << i;
      EXPECT_EQ(played[i].detail, recorded[i].detail) << i;
      EXPECT_EQ(played[i].measured_exposure, recorded[i].measured_exposure);
      EXPECT_EQ(played[i].proof, recorded[i].proof);
      EXPECT_EQ(played[i].camera_counter, recorded[i].camera_counter);
      const auto& a = std::get<Image<std::uint8_t>>(played[i].pixels);
      const auto& b = std::get<Image<std::uint8_t>>(recorded[i].pixels);
      EXPECT_TRUE(
          std::equal(a.values().begin(), a.values().end(), b.values().begin(), b.values().end()));
    }
  }
}

TEST_F(FirewireRecording, ADriverThatAsksSomethingElseIsToldWhat) {
  Record();
  const auto camera = CameraOn(firewire::MakeReplayingBus(file()).value(), 99);
  const Result<CameraInfo> info = camera->Open();
  ASSERT_FALSE(info);
  EXPECT_THAT(info.error().message, HasSubstr("WHITE_BALANCE"));
  EXPECT_THAT(info.error().message, HasSubstr("recorded was \"write"));
}

TEST_F(FirewireRecording, CutOffAnywhereItIsPlayedAsFarAsItGoes) {
  Record();
  const std::vector<std::byte> whole = ReadFile(file()).value();
  int opened = 0;
  for (std::size_t length = 0; length < whole.size(); length += 1 + whole.size() / 60) {
    auto bus = firewire::MakeReplayingBus(
        std::vector<std::byte>(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(length)));
    if (length < firewire::kRecordingMagic.size()) {
      EXPECT_EQ(bus.error().kind, ErrorKind::kData);
      continue;
    }
    ASSERT_TRUE(bus);
    auto camera = CameraOn(std::move(*bus));
    if (!camera->Open() || !camera->Start()) continue;
    ++opened;
    const Result<CameraFrame> frame = testing::Take(*camera, 0, 0.001);
    if (!frame) {
      EXPECT_EQ(frame.error().kind, ErrorKind::kUnavailable) << frame.error().message;
    }
  }
  EXPECT_GT(opened, 5);
}

TEST_F(FirewireRecording, ItStopsGrowingAtItsLimitAndTheCameraGoesOn) {
  auto bus = firewire::MakeRecordingBus(bus_.MakeBus(), {.file = file(), .max_bytes = 30'000});
  EXPECT_EQ(TakeSome(*CameraOn(std::move(bus)), [](std::uint64_t) {}).size(), 5U);
  EXPECT_LE(std::filesystem::file_size(file()), 30'000U);
  EXPECT_TRUE(firewire::MakeReplayingBus(file()));
}

TEST_F(FirewireRecording, AFileThatCannotBeMadeIsSaidBeforeTheCameraIsUsed) {
  auto bus = firewire::MakeRecordingBus(bus_.MakeBus(),
                                        {.file = emulated_.folder.path() / "none" / "camera.fw"});
  const auto nodes = bus->List();
  ASSERT_FALSE(nodes);
  EXPECT_EQ(nodes.error().kind, ErrorKind::kCannotCreate);
}

TEST(FirewireRecordedCall, ComesBackAsItWasAndAnyBytesAreACallOrNot) {
  firewire::RecordedCall call;
  call.kind = firewire::RecordedCall::Kind::kRead;
  call.address = 0xFFFFF0F0062C;
  call.number = 1;
  call.answer = firewire::Answer::kBusy;
  call.error = Error{ErrorKind::kUnavailable, "taken"};
  call.nodes = {{1, 2}, {3, 4}};
  call.quadlets = {0x80000000};
  call.speed = 2;
  call.batch.bytes.resize(100);
  call.batch.packets = {{0, 60, true, 7999, 0}, {60, 40, false, 0, 3}};
  const std::vector<std::byte> bytes = firewire::EncodeCall(call);
  const auto again = firewire::DecodeCall(bytes);
  ASSERT_TRUE(again);
  EXPECT_EQ(firewire::EncodeCall(*again), bytes);
  EXPECT_EQ(again->Request(), "read 1 quadlets at 0xfffff0f0062c");
  ASSERT_EQ(again->batch.packets.size(), 2U);
  EXPECT_EQ(again->batch.packets[1].begin, 60U);
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_FALSE(firewire::DecodeCall(std::span(bytes).first(length))) << length;
  }
  std::mt19937 random(1);
  for (int round = 0; round < 20000; ++round) {
    std::vector<std::byte> damaged = bytes;
    for (int i = 0; i < 3; ++i) {
      damaged[random() % damaged.size()] = static_cast<std::byte>(random());
    }
    const auto decoded = firewire::DecodeCall(damaged);
    if (!decoded) continue;
    EXPECT_FALSE(decoded->Request().empty());
    for (const firewire::IsoPacket& packet : decoded->batch.packets) {
      ASSERT_LE(packet.begin + packet.length, decoded->batch.bytes.size());
    }
  }
}

}  // namespace
}  // namespace omnihdr::firewire_recording_test
