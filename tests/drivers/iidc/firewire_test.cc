// An IIDC camera on FireWire: the link over a bus of this process, and the camera over the link.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/iidc/config_rom.h"
#include "drivers/iidc/firewire_link.h"
#include "drivers/iidc/registers.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/emulators/iidc_firewire.h"

namespace omnihdr::firewire_test {
namespace {

using emulators::IidcFirewire;
using std::chrono::milliseconds;
using ::testing::HasSubstr;

constexpr std::uint32_t kIsoData = 0x60C;

emulators::IidcDeviceOptions OnFirewire() {
  emulators::IidcDeviceOptions options;
  options.link_packet_bytes = IidcFirewire::kFrameEnds;
  return options;
}

class FirewireTest : public ::testing::Test {
 protected:
  void OpenLink() { link_ = iidc::MakeFirewireLink(bus_.MakeBus()->Open({}).value()); }
  void Begin() {
    camera_ = std::make_unique<iidc::IidcCamera>(emulated_.CameraOptions(),
                                                 iidc::MakeFirewireFinder(bus_.MakeBus()),
                                                 testing::EmulatedIidc::Timeouts());
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    const Status started = camera_->Start();
    ASSERT_TRUE(started) << started.error().message;
  }
  CameraFrame TakeOne(double seconds) {
    Result<CameraFrame> frame = testing::Take(*camera_, next_++, seconds);
    EXPECT_TRUE(frame) << frame.error().message;
    return frame ? std::move(*frame) : CameraFrame{};
  }
  // The frame's pixels, past those that the embedded information covers, are the scene's.
  void ExpectScene(const CameraFrame& frame, double seconds) {
    ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
    const auto& image = std::get<Image<std::uint8_t>>(frame.pixels);
    ASSERT_TRUE(frame.measured_exposure);
    const double had = frame.measured_exposure->time.seconds();
    EXPECT_NEAR(had / seconds, 1.0, 0.02);
    for (int y = 1; y < image.height(); y += 7) {
      for (int x = 0; x < image.width(); ++x) {
        ASSERT_EQ(image.at(x, y), emulated_.device->PixelAt(x, y, had, 0.0)) << x << " " << y;
      }
    }
  }

  testing::EmulatedIidc emulated_{OnFirewire()};
  IidcFirewire bus_{emulated_.device};
  std::unique_ptr<iidc::Link> link_;
  std::unique_ptr<iidc::IidcCamera> camera_;
  std::uint64_t next_ = 0;
};

TEST_F(FirewireTest, PicturesComeOverItsChannelWithTheExposureTheyProve) {
  Begin();
  EXPECT_EQ(bus_.channels().size(), 1U);
  EXPECT_GT(bus_.bandwidth(), 0);
  for (const double seconds : {0.001, 0.016, 0.004, 0.004}) {
    const CameraFrame frame = TakeOne(seconds);
    ExpectScene(frame, seconds);
    EXPECT_EQ(frame.proof, ExposureProof::kEmbedded);
  }
  camera_->Close();
  EXPECT_TRUE(bus_.channels().empty());
  EXPECT_EQ(bus_.bandwidth(), 0);
}

TEST_F(FirewireTest, TheConfigurationRomSaysWhoItIs) {
  OpenLink();
  const auto quadlets = iidc::ReadConfigRom(*link_, std::chrono::seconds(1));
  ASSERT_TRUE(quadlets) << quadlets.error().message;
  const auto rom = iidc::ParseConfigRom(*quadlets);
  ASSERT_TRUE(rom) << rom.error().message;
  EXPECT_EQ(rom->guid, emulated_.device->options().guid);
  EXPECT_EQ(link_->name(), "firewire 0 (00b09d0100c0ffee)");
}

TEST_F(FirewireTest, ABusyCameraIsAskedAgainAndAResetFoundAgain) {
  OpenLink();
  IidcFirewire::Faults faults;
  faults.busy = 3;
  faults.conflicts = 2;
  bus_.Set(faults);
  EXPECT_TRUE(link_->ReadQuadlet(iidc::kConfigRom, std::chrono::seconds(1)));
  bus_.Reset();
  EXPECT_TRUE(link_->WriteQuadlet(emulators::IidcDevice::kBase + iidc::kGamma, 0x82000000,
                                  std::chrono::seconds(1)));
  EXPECT_EQ(bus_.refreshes(), 1);
}

TEST_F(FirewireTest, ACameraThatStaysBusyOrDoesNotAnswerEndsInItsDeadline) {
  OpenLink();
  IidcFirewire::Faults faults;
  faults.busy = 1'000'000;
  bus_.Set(faults);
  const SystemClock clock;
  const HostTime before = clock.Now();
  auto read = link_->ReadQuadlet(iidc::kConfigRom, milliseconds(50));
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().kind, ErrorKind::kTemporary);
  EXPECT_EQ(read.error().message, "0xfffff0000400: busy for 50 ms");
  EXPECT_LT(clock.Now() - before, milliseconds(1000));
  // A write that may have been taken is not written twice.
  faults = {};
  faults.unanswered = 1;
  bus_.Set(faults);
  const Status written =
      link_->WriteQuadlet(emulators::IidcDevice::kBase + iidc::kGamma, 0, std::chrono::seconds(1));
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, HasSubstr("no answer in 1000 ms"));
  // A register that does not exist is refused at once.
  read = link_->ReadQuadlet(0xFFFF'FFFF'FFFC, std::chrono::seconds(1));
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().kind, ErrorKind::kProtocol);
}

TEST_F(FirewireTest, APacketThatIsMissingTearsOneFrameAndShiftsNone) {
  Begin();
  ExpectScene(TakeOne(0.002), 0.002);
  IidcFirewire::Faults first;
  first.lose_first_packets = 1;
  IidcFirewire::Faults middle;
  middle.lose_middle_packets = 1;
  IidcFirewire::Faults last;
  last.lose_last_packets = 1;
  IidcFirewire::Faults dropped;
  dropped.drop_packets = 1;
  const std::pair<IidcFirewire::Faults, const char*> losses[] = {
      {first, "the first packets are missing"},
      {middle, "no packet between cycles "},
      {last, " of "},
      {dropped, "1 packets were dropped before cycle "}};
  for (const auto& [faults, why] : losses) {
    bus_.Set(faults);
    const CameraFrame torn = TakeOne(0.002);
    EXPECT_EQ(torn.status, FrameStatus::kCorrupt);
    EXPECT_THAT(torn.detail, HasSubstr(why));
    ExpectScene(TakeOne(0.002), 0.002);
  }
}

TEST_F(FirewireTest, AfterAResetOfTheBusTheSameChannelIsTakenAgainAndPicturesGoOn) {
  Begin();
  ExpectScene(TakeOne(0.002), 0.002);
  const std::set<int> before = bus_.channels();
  const int bandwidth = bus_.bandwidth();
  for (int i = 0; i < 3; ++i) {
    bus_.Reset();
    ExpectScene(TakeOne(0.002), 0.002);
    EXPECT_EQ(bus_.channels(), before);
    EXPECT_EQ(bus_.bandwidth(), bandwidth);
  }
}

TEST_F(FirewireTest, AChannelThatSomebodyElseHasIsLeftAloneAndTheCameraIsToldOfAnother) {
  bus_.Take(0);
  bus_.Take(1);
  Begin();
  EXPECT_EQ(emulated_.device->Register(kIsoData) >> 28, 2U);
  ExpectScene(TakeOne(0.002), 0.002);
  // Taken by somebody between the reset and us: the stream has ended, and says why.
  bus_.Reset();
  bus_.Take(2);
  const Result<CameraFrame> gone = camera_->Receive(std::chrono::seconds(5));
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(gone.error().message, HasSubstr("after a reset of the bus: channel 2 is taken"));
}

TEST_F(FirewireTest, ACameraPulledFromTheBusHasGoneAndComesBack) {
  Begin();
  ExpectScene(TakeOne(0.002), 0.002);
  emulated_.device->Unplug();
  const Result<CameraFrame> gone = camera_->Receive(std::chrono::seconds(5));
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(gone.error().message, HasSubstr("has left the bus"));
  camera_->Stop();
  camera_->Close();
  EXPECT_FALSE(camera_->Open());
  emulated_.device->PlugIn();
  ASSERT_TRUE(camera_->Open());
  ASSERT_TRUE(camera_->Start());
  ExpectScene(TakeOne(0.002), 0.002);
}

TEST(Firewire, BandwidthIsThePacketsQuadletsAtTheSpeed) {
  // S400 (speed 2): a quadlet is 4 units; 4096 bytes and 3 quadlets of overhead.
  EXPECT_EQ(iidc::BandwidthUnits(4096, 2), (1024 + 3) * 4);
  EXPECT_EQ(iidc::BandwidthUnits(1, 0), 4 * 16);
  EXPECT_EQ(iidc::BandwidthUnits(8192, 3), (2048 + 3) * 2);
}

}  // namespace
}  // namespace omnihdr::firewire_test
