// Every fault of a camera in every state of the appliance: afterwards it takes pictures again by
// itself, with its settings made anew, and the journal tells of every trigger. The camera is the
// IIDC driver over an emulated device.

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <ostream>
#include <string>
#include <vector>

#include "core/image/image_io.h"
#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/registers.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/unit/daemon/app/app_fixture.h"

namespace omnihdr::camera_faults_test {
namespace {

namespace fs = std::filesystem;
using emulators::IidcDevice;
using std::chrono::milliseconds;
using std::chrono::seconds;

struct Bench {
  IidcDevice& device;
  IidcDevice& other;  // another head of the same model, not plugged in
};

struct CameraFault {
  const char* name;
  std::function<void(Bench)> strike;
  // How long it lasts before the device is whole and there again.
  milliseconds lasts{0};
  // Another camera is no fault before there is a session of the first.
  bool needs_session = false;
};

void PrintTo(const CameraFault& fault, std::ostream* out) { *out << fault.name; }

CameraFault Device(const char* name, const IidcDevice::Faults& faults, milliseconds lasts = {}) {
  return {name, [faults](Bench bench) { bench.device.Set(faults); }, lasts};
}

std::vector<CameraFault> AllFaults() {
  std::vector<CameraFault> faults = {
      {"UnpluggedForAMoment", [](Bench b) { b.device.Unplug(); }},
      {"UnpluggedForLong", [](Bench b) { b.device.Unplug(); }, milliseconds(400)},
      {"UnpluggedTwice",
       [](Bench b) {
         b.device.Unplug();
         std::this_thread::sleep_for(milliseconds(30));
         b.device.PlugIn();
         std::this_thread::sleep_for(milliseconds(30));
         b.device.Unplug();
       },
       milliseconds(30)},
      {"ALooseContact",
       [](Bench b) {
         for (int i = 0; i < 20; ++i) {
           b.device.Unplug();
           std::this_thread::sleep_for(milliseconds(i));
           b.device.PlugIn();
         }
       }},
      {"SwappedForAnother",
       [](Bench b) {
         b.device.Unplug();
         b.other.PlugIn();
       },
       milliseconds(300), true},
      {"RefusingRegistersWhenItReturns",
       [](Bench b) {
         b.device.Unplug();
         b.device.Set({.stall_after = 9});
         b.device.PlugIn();
       }},
  };
  const auto add = [&](const char* name, const IidcDevice::Faults& device,
                       milliseconds lasts = {}) { faults.push_back(Device(name, device, lasts)); };
  // With what lasts for a while, the counts are more than are used up.
  add("ARegisterRefused", {.stall_registers = 1});
  add("RegistersRefusedForLong", {.stall_registers = 1'000'000}, milliseconds(300));
  add("ARegisterNotAnswered", {.nak_registers = 1});
  add("RegistersNotAnsweredForLong", {.nak_registers = 1'000'000}, milliseconds(300));
  add("TheStreamStallsOnce", {.stall_stream = 1});
  add("TheStreamStallsForLong", {.stall_stream = 1'000'000}, milliseconds(300));
  add("AFrameLost", {.lose_frames = 1});
  add("FramesLostInARow", {.lose_frames = 4});
  add("AFrameCutShort", {.short_frames = 1});
  add("FramesCutShortInARow", {.short_frames = 4});
  add("BytesLostUnmarked", {.unmarked_losses = 2});
  add("AFrameMuchTooLate", {.late_frames = 1, .late_s = 0.6});
  add("AWrongExposure", {.wrong_exposures = 1});
  add("WrongExposuresInARow", {.wrong_exposures = 4});
  add("Babble", {.babbling_frames = 4});
  return faults;
}

class CameraFaults : public testing_app::AppFixture,
                     public ::testing::WithParamInterface<CameraFault> {
 protected:
  CameraFaults() {
    emulators::IidcDeviceOptions other;
    other.guid = 0x00B09D0100000007;
    other.serial = 7;
    other_ = std::make_shared<IidcDevice>(other, emulated_.clock);
    other_->Unplug();
    iidc::IidcCameraOptions options = emulated_.CameraOptions();
    options.frame_timeout_s = 0.3;
    other_camera_ = std::make_shared<iidc::IidcCamera>(
        options, emulators::MakeEmulatedFinder({emulated_.device, other_}),
        testing::EmulatedIidc::Timeouts());
    config_.camera.frame_timeout_s = 0.5;
    config_.trigger.armed_at_start = false;
    config_.trigger.rearm_after = 3;
    config_.bracket.exposures_s = {0.001, 0.004, 0.03};
  }
  IidcDevice& device() { return *emulated_.device; }

  void Strike() {
    const CameraFault& fault = GetParam();
    fault.strike({device(), *other_});
    std::this_thread::sleep_for(fault.lasts);
  }
  void Heal() {
    if (other_->plugged_in()) other_->Unplug();
    if (!device().plugged_in()) device().PlugIn();
    if (GetParam().lasts > milliseconds(0)) device().Set({});
  }
  bool CameraReady() const {
    return StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; });
  }
  // Answered triggers of which the last one is a picture that was stored.
  void TakesPictures(const std::string& state) {
    ASSERT_TRUE(CameraReady()) << "struck while " << state;
    ASSERT_TRUE(Client().Post("/v1/arm")) << "struck while " << state;
    const auto stored = [this] {
      const auto status = Client().Get("/v1/status");
      return status ? (*status)["frames_recorded"].get<int>() : -1;
    };
    const int before = stored();
    bool taken = false;
    for (int i = 0; i < 60 && !taken; ++i) {
      if (Client().Post("/v1/trigger")) ++accepted_;
      ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
      taken = stored() > before;
      if (!taken) std::this_thread::sleep_for(milliseconds(50));
    }
    ASSERT_TRUE(taken) << "no picture after it was struck while " << state << ": "
                       << Client().Get("/v1/status").value().dump(1);
    // Switched on when the camera comes from its maker: what is set was set anew.
    EXPECT_EQ(device().Register(iidc::kGamma) & iidc::Bit(25), 0U) << state;
    EXPECT_NE(device().Register(iidc::kTriggerMode) & iidc::Bit(25), 0U) << state;
  }
  void Shoot() {
    if (Client().Post("/v1/trigger")) ++accepted_;
  }
  void StruckWhile(const std::string& state) {
    SCOPED_TRACE(state);
    Strike();
    Heal();
    TakesPictures(state);
  }
  // One line for every trigger that was accepted, each loss with its reason, each picture that of
  // its exposure.
  void TheJournalTellsEverything() {
    const auto contents = ReadSession(session());
    ASSERT_TRUE(contents) << contents.error().message;
    const std::vector<FrameRecord>& frames = contents->journal.frames;
    EXPECT_TRUE(contents->journal.rejected.empty());
    EXPECT_EQ(frames.size(), accepted_);
    for (std::size_t i = 0; i < frames.size(); ++i) {
      ASSERT_EQ(Value(frames[i].frame), i);
      if (frames[i].status != FrameStatus::kOk) {
        EXPECT_FALSE(frames[i].detail.empty()) << "line " << i;
        continue;
      }
      const auto image = ReadImage(session() / frames[i].file);
      ASSERT_TRUE(image) << image.error().message;
      EXPECT_EQ(std::get<Image<std::uint8_t>>(image->pixels).at(20, 100),
                device().PixelAt(20, 100, frames[i].exposure.time.seconds(), 0.0))
          << "line " << i;
    }
  }

  testing::EmulatedIidc emulated_;
  std::shared_ptr<IidcDevice> other_;
  std::size_t accepted_ = 0;
};

TEST_P(CameraFaults, AreOverInEveryStateWithoutAnybodysHelp) {
  const CameraFault& fault = GetParam();
  // Starting, and waiting for the camera.
  if (!fault.needs_session) Strike();
  Start();
  Heal();
  TakesPictures("starting");
  device().Unplug();
  ASSERT_TRUE(InState("waiting-for-camera"));
  StruckWhile("waiting-for-camera");

  ASSERT_TRUE(Client().Post("/v1/disarm"));
  ASSERT_TRUE(InState("idle"));
  StruckWhile("idle");

  // Some triggers without a frame are kept in mind as "degraded": enough good ones make it armed.
  for (int i = 0; i < 16; ++i) TakesPictures("before armed");
  ASSERT_TRUE(StatusHolds(
      [](const auto& s) { return s["state"] == "armed" || s["state"] == "capturing"; }));
  StruckWhile("armed");

  Shoot();
  Shoot();
  StruckWhile("capturing");

  device().Set({.lose_frames = 1});
  Shoot();
  ASSERT_TRUE(InState("degraded"));
  StruckWhile("degraded");

  const fs::path raw = session() / "raw";
  fs::rename(raw, session() / "raw-away");
  std::ofstream(raw) << "no folder";
  Shoot();
  // The trigger may be one that the fault before has left without a frame to store.
  bool full = false;
  for (int i = 0; i < 30 && !full; ++i) {
    Shoot();
    std::this_thread::sleep_for(milliseconds(100));
    full = Client().Get("/v1/status").value()["state"] == "storage-full";
  }
  EXPECT_TRUE(full);
  Strike();
  Heal();
  fs::remove(raw);
  fs::rename(session() / "raw-away", raw);
  TakesPictures("storage-full");

  // Stopping does not wait for what never comes.
  Shoot();
  Strike();
  EXPECT_TRUE(Join(true));
  TheJournalTellsEverything();
  Heal();
  Start();
  TakesPictures("stopping");

  // A session that has ended is whole whatever the camera does then.
  ASSERT_TRUE(Client().Post("/v1/finish"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }));
  Strike();
  Heal();
  EXPECT_TRUE(CameraReady());
  EXPECT_TRUE(Join(true));
  TheJournalTellsEverything();
}

INSTANTIATE_TEST_SUITE_P(Each, CameraFaults, ::testing::ValuesIn(AllFaults()),
                         [](const auto& one) { return std::string(one.param.name); });

}  // namespace
}  // namespace omnihdr::camera_faults_test
