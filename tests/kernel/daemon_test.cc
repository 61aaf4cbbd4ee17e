// omnihdrd as on a vehicle, with an IIDC camera on the kernel's USB.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <thread>

#include "core/base/realtime.h"
#include "core/image/image_io.h"
#include "daemon/api/client.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/iidc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/kernel/appliance.h"

namespace omnihdr::daemon_test {
namespace {

using integration::Eventually;
using kernel::kArmed;
using kernel::kCamera;
using kernel::kCapturing;
using kernel::kFault;
using kernel::kLost;
using kernel::kMapVersion;
using kernel::kOdometerMm;
using kernel::kReady;
using kernel::kRecorded;
using kernel::kState;
using kernel::kTrigger;
using kernel::kTriggers;
using kernel::kWheel;
using ::testing::HasSubstr;

class Appliance : public kernel::ApplianceTest {
 protected:
  // With the exposures of a bracket and what triggers.
  void Launch(const std::string& exposures, const std::string& trigger) {
    ApplianceTest::Launch(MakeSetup(exposures, trigger));
  }
  void Start(const std::string& exposures) {
    ASSERT_NO_FATAL_FAILURE(ApplianceTest::Start(MakeSetup(exposures, "")));
  }
  Setup MakeSetup(const std::string& exposures, const std::string& trigger) const {
    const emulators::IidcDeviceOptions& device = device_->options();
    std::ofstream(path("head.toml"))
        << emulators::EmulatedRig(6, device.max_width, device.rows_per_sensor, device.bayer);
    Setup setup;
    setup.camera = "driver = \"iidc\"\n[camera.iidc]\nrig = \"head.toml\"";
    setup.exposures = "exposures_s = " + exposures;
    setup.trigger = trigger;
    return setup;
  }
  // A good frame: its exposure, proved by itself, and pixels of that exposure.
  void ExpectFrame(const FrameRecord& record, double exposure_s) const {
    ASSERT_EQ(record.status, FrameStatus::kOk) << record.detail;
    EXPECT_EQ(record.proof, ExposureProof::kEmbedded);
    const double seconds = record.exposure.time.seconds();
    EXPECT_NEAR(seconds / exposure_s, 1.0, 0.01);
    const auto image = ReadImage(path("sessions") / "s" / record.file);
    ASSERT_TRUE(image) << image.error().message;
    EXPECT_EQ(std::get<Image<std::uint8_t>>(image->pixels).at(20, 100),
              device_->PixelAt(20, 100, seconds, 0.0));
  }

  std::shared_ptr<emulators::IidcDevice> device_ =
      std::make_shared<emulators::IidcDevice>(emulators::IidcDeviceOptions{}, clock_);
  emulators::VhciUsb plug_{std::make_shared<emulators::IidcUsbFunction>(device_)};
};

TEST_F(Appliance, ABracketIsRecordedEdgeByEdgeAndAMasterReadsAlong) {
  ASSERT_NO_FATAL_FAILURE(Start("[0.001, 0.004, 0.016]"));
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kReady); }));
  EXPECT_FALSE(chip_.IsHigh(kFault));
  std::vector<HostTime> around = {clock_.Now()};
  for (std::uint32_t i = 0; i < 6; ++i) {
    ASSERT_TRUE(Shoot()) << daemon_->Log();
    around.push_back(clock_.Now());
    Registers seen{};
    EXPECT_TRUE(Eventually([&] { return Long(seen = ReadModbus(), kRecorded) == i + 1; }));
    EXPECT_EQ(seen[kMapVersion], 1);
    EXPECT_TRUE(seen[kState] == kArmed || seen[kState] == kCapturing) << seen[kState];
    EXPECT_EQ(Long(seen, kTriggers), i + 1);
    EXPECT_EQ(Long(seen, kLost), 0U);
  }
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 6U);
  const double ladder[] = {0.001, 0.004, 0.016};
  for (std::size_t i = 0; i < journal.size(); ++i) {
    ExpectFrame(journal[i], ladder[i % 3]);
    // The kernel's time of the edge, on the clock of this machine; the exposure after it.
    EXPECT_GE(journal[i].trigger_time, around[i]);
    EXPECT_LE(journal[i].trigger_time, around[i + 1]);
    EXPECT_GE(journal[i].timestamp, journal[i].trigger_time);
    EXPECT_LE(journal[i].timestamp, around[i + 1]);
  }
  const auto contents = ReadSession(path("sessions") / "s");
  ASSERT_TRUE(contents);
  EXPECT_EQ(contents->info.camera.model, "Six-Eyed Test Head");
  Stop();
}

TEST_F(Appliance, UnpluggedInTheMiddleOfABracketItGoesOnWhenTheCameraReturns) {
  ASSERT_NO_FATAL_FAILURE(Start("[0.001, 0.004, 4.0]"));
  UnplugInABracket(
      {.unplug = [&] { plug_.Unplug(); }, .plug_in = [&] { plug_.PlugIn(); }}, {0.001, 0.004},
      [&](const FrameRecord& record, double seconds) { ExpectFrame(record, seconds); });
  Stop();
}

TEST_F(Appliance, EdgesFasterThanTheCameraAreAllInTheJournal) {
  ASSERT_NO_FATAL_FAILURE(Start("[0.001, 0.004, 1.0]"));
  const double ladder[] = {0.001, 0.004, 1.0};
  OutrunTheCamera(
      60, [&](const FrameRecord& record, std::size_t i) { ExpectFrame(record, ladder[i % 3]); });
  Stop();
}

TEST_F(Appliance, ACameraAndAChipThatComeAfterItAreFound) {
  plug_.Unplug();
  chip_.Remove();
  Launch("[0.001, 0.004, 0.016]", TriggerLine());
  ASSERT_TRUE(Becomes("waiting-for-camera")) << daemon_->Log();
  plug_.PlugIn();
  chip_.Return();
  ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
  ASSERT_TRUE(Becomes("armed")) << daemon_->Log();
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kReady); }));
  ASSERT_TRUE(Shoot());
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 1U);
  ExpectFrame(journal[0], 0.001);
  Stop();
}

TEST_F(Appliance, ACameraOnTheTriggersWireIsObservedAndEveryEdgeAndFrameIsAccountedFor) {
  Launch("[0.001, 0.004, 0.016]", "wired = true\n" + TriggerLine());
  ASSERT_TRUE(Becomes("armed")) << daemon_->Log();
  ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
  const double ladder[] = {0.001, 0.004, 0.016};
  const auto prepared = [&](double seconds) {
    return Eventually([&] {
      const bool wired = (device_->Register(0x830) >> 21 & 7U) == 0U;
      return wired && (device_->Register(0x81C) & 0xFFFU) == device_->ShutterRaw(seconds);
    });
  };
  const auto pulse = [&](bool at_the_camera, bool at_the_line) {
    if (at_the_camera) device_->Pulse();
    if (at_the_line) chip_.Pulse(kTrigger);
    ++edges_;
  };
  std::vector<HostTime> around = {clock_.Now()};
  for (std::size_t i = 0; i < 6; ++i) {
    ASSERT_TRUE(prepared(ladder[i % 3])) << i << "\n" << daemon_->Log();
    pulse(true, true);
    ASSERT_TRUE(Answered()) << i << "\n" << daemon_->Log();
    around.push_back(clock_.Now());
  }
  pulse(false, true);  // the camera takes no picture
  ASSERT_TRUE(StatusHolds([&](const auto& s) { return s["triggers"]["accepted"] == edges_; }));
  pulse(true, true);
  ASSERT_TRUE(Answered()) << daemon_->Log();
  pulse(true, false);  // nobody sees the edge
  ASSERT_TRUE(Answered()) << daemon_->Log();
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 9U);
  for (std::size_t i = 0; i < 6; ++i) {
    ExpectFrame(journal[i], ladder[i % 3]);
    EXPECT_GE(journal[i].trigger_time, around[i]);
    EXPECT_LE(journal[i].trigger_time, around[i + 1]);
    ASSERT_TRUE(journal[i].timestamp_error);
    EXPECT_LT(*journal[i].timestamp_error, std::chrono::milliseconds(100));
  }
  EXPECT_EQ(journal[6].status, FrameStatus::kMissedTrigger);
  EXPECT_THAT(journal[6].detail, HasSubstr("took no picture at this edge"));
  ExpectFrame(journal[7], 0.001);
  EXPECT_EQ(journal[8].status, FrameStatus::kOk);
  EXPECT_THAT(journal[8].detail, HasSubstr("no edge was seen for this frame"));
  // Three to fit its clock, and then pulses only: nothing was commanded.
  EXPECT_EQ(device_->trigger_times().size(), 3U + 8U);
  Stop();
}

TEST_F(Appliance, ALineOfTheChipReleasesTheCameraAtEveryTrigger) {
  Setup setup = MakeSetup("[0.001, 0.004, 0.016]", "source = \"software\"");
  setup.outputs =
      "camera_trigger = \"camera-out\"\ncamera_trigger_s = 0.2\n"
      "camera_trigger_spacing_s = 0.5\n";
  ApplianceTest::Launch(setup);
  ASSERT_TRUE(Becomes("armed")) << daemon_->Log();
  ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
  EXPECT_FALSE(chip_.IsHigh(kCamera));
  // The wire from the line to the camera's input.
  std::vector<HostTime> rises;
  std::jthread wire([&](const std::stop_token& stop) {
    // A wire is faster than any program: what is behind it must not wait for the daemon's threads.
    const RealtimeThread as_hardware(RealtimePriority::kEdges);
    bool high = false;
    while (!stop.stop_requested()) {
      const bool before = std::exchange(high, chip_.IsHigh(kCamera));
      if (high && !before) {
        device_->Pulse();
        rises.push_back(clock_.Now());
      }
      std::this_thread::sleep_for(std::chrono::microseconds(300));
    }
  });
  for (int i = 0; i < 6; ++i) {
    ++edges_;
    EXPECT_TRUE(ApiClient(path("api.sock")).Post("/v1/trigger")) << i;
    ASSERT_TRUE(Answered()) << i << "\n" << daemon_->Log();
  }
  EXPECT_TRUE(Eventually([&] { return !chip_.IsHigh(kCamera); }));
  wire.request_stop();
  wire.join();
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 6U);
  const double ladder[] = {0.001, 0.004, 0.016};
  for (std::size_t i = 0; i < journal.size(); ++i) ExpectFrame(journal[i], ladder[i % 3]);
  // The camera exposed at the pulses and at nothing else, and they keep their distance.
  ASSERT_EQ(rises.size(), 6U);
  EXPECT_EQ(device_->trigger_times().size(), 6U);
  for (std::size_t i = 1; i < rises.size(); ++i) {
    EXPECT_GT(rises[i] - rises[i - 1], std::chrono::milliseconds(400)) << i;
  }
  EXPECT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["pulsed"] == true; }));
  Stop();
  EXPECT_FALSE(chip_.IsHigh(kCamera));
}

TEST_F(Appliance, PulsesOfAWheelAreWayAndMarksOnItAreFrames) {
  Launch("[0.001, 0.004, 0.016]",
         fmt::format("source = \"distance\"\nodometer = \"wheel\"\ndistance_m = 0.0625\n"
                     "[gpio.wheel]\nchip = \"{}\"\nline = \"wheel-in\"\nedge = \"both\"\n"
                     "pulses_per_metre = 64.0",
                     chip_.label()));
  // Where it stands is the first mark, which waits for the camera.
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["armed"] && s["camera"]["ready"]; }))
      << daemon_->Log();
  ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
  edges_ = 1;
  ASSERT_TRUE(Answered()) << daemon_->Log();
  // Numbers that are exact, so that a mark is passed with a pulse and not with the next one.
  for (int pulse = 1; pulse <= 24; ++pulse) {
    chip_.Pull(kWheel, pulse % 2 == 1);
    if (pulse % 4 == 0) ++edges_;
    ASSERT_TRUE(StatusHolds([&](const auto& s) { return s["odometer_m"] == pulse / 64.0; }))
        << "pulse " << pulse;
    ASSERT_TRUE(Answered()) << "pulse " << pulse << "\n" << daemon_->Log();
  }
  EXPECT_TRUE(Eventually([] { return Long(ReadModbus(), kOdometerMm) == 375; }));
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 7U);
  const double ladder[] = {0.001, 0.004, 0.016};
  for (std::size_t i = 0; i < journal.size(); ++i) {
    ExpectFrame(journal[i], ladder[i % 3]);
    ASSERT_TRUE(journal[i].odometer_m);
    EXPECT_EQ(*journal[i].odometer_m, 0.0625 * static_cast<double>(i));
  }
  Stop();
}

}  // namespace
}  // namespace omnihdr::daemon_test
