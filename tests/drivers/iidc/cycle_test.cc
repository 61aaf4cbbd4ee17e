// The camera's own exposure cycle: frames are labelled by what they prove, wherever it stands.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <map>
#include <thread>
#include <vector>

#include "drivers/iidc/exposure_cycle.h"
#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/model_table.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/emulators/pulsed_wire.h"

namespace omnihdr::cycle_test {
namespace {

using emulators::CycleStart;
using emulators::IidcDevice;
using iidc::CyclePhase;
using iidc::CycleWords;
using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::Each;
using ::testing::ElementsAre;
using testing::EmulatedIidc;
using ::testing::HasSubstr;
using testing::Take;
using ::testing::UnorderedElementsAre;

constexpr Nanoseconds kLong = std::chrono::seconds(5);

Exposure At(double seconds) { return {ExposureTime::Seconds(seconds), GainDb{0.0}}; }

std::vector<Exposure> Order(const std::vector<double>& seconds) {
  std::vector<Exposure> order;
  for (const double each : seconds) order.push_back(At(each));
  return order;
}

// Of a frame that proves one of them, its number; -1 for any other.
int StepOf(const CameraFrame& frame, const std::vector<double>& seconds) {
  if (!frame.measured_exposure || frame.proof != ExposureProof::kEmbedded) return -1;
  for (std::size_t i = 0; i < seconds.size(); ++i) {
    const double ratio = frame.measured_exposure->time.seconds() / seconds[i];
    if (std::abs(ratio - 1.0) < 0.01) return static_cast<int>(i);
  }
  return -1;
}

class Cycle : public ::testing::Test {
 protected:
  void Make(emulators::IidcDeviceOptions device, bool wired = false) {
    device.exposure_cycle = true;
    camera_.reset();  // before the device that it uses
    emulated_ = std::make_unique<EmulatedIidc>(device);
    iidc::IidcCameraOptions options = emulated_->CameraOptions();
    options.exposure_cycle = iidc::CycleUse::kOn;
    options.frame_timeout_s = 1.0;
    options.wired = wired;
    camera_ = emulated_->MakeCamera(options);
  }
  void Begin(const std::vector<double>& order, const emulators::IidcDeviceOptions& device = {},
             bool burst = false) {
    Make(device);
    BeginMade(order, burst);
  }
  void BeginMade(const std::vector<double>& order, bool burst) {
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    EXPECT_THAT(info->extra_json, HasSubstr("\"exposure_cycle\":true"));
    order_ = order;
    camera_->Plan({Order(order), burst});
    ASSERT_TRUE(camera_->Start());
  }
  CameraFrame TakeOne(double seconds) {
    Result<CameraFrame> frame = Take(*camera_, next_++, seconds);
    EXPECT_TRUE(frame) << frame.error().message;
    return frame ? std::move(*frame) : CameraFrame{};
  }
  // One frame for each exposure of the order; the pixels must be those of the exposure told.
  std::vector<int> TakeTurn() {
    std::vector<int> steps;
    for (const double seconds : order_) {
      const CameraFrame frame = TakeOne(seconds);
      EXPECT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
      ExpectTruth(frame);
      steps.push_back(StepOf(frame, order_));
    }
    return steps;
  }
  void ExpectTruth(const CameraFrame& frame) const {
    if (!frame.measured_exposure) return;
    EXPECT_EQ(std::get<Image<std::uint8_t>>(frame.pixels).at(20, 100),
              emulated_->device->PixelAt(20, 100, frame.measured_exposure->time.seconds(), 0.0));
  }
  // All steps of a burst, asked for as the capture controller does: one trigger time for all.
  std::vector<CameraFrame> TakeBurst(const std::vector<double>& seconds) {
    const HostTime event = clock_.Now();
    std::vector<CameraFrame> frames;
    for (const double each : seconds) frames.push_back(TakeOfBurst(event, each));
    return frames;
  }
  CameraFrame TakeOfBurst(HostTime event, double seconds,
                          std::optional<std::uint64_t> number = std::nullopt) {
    ExposureRequest request;
    request.trigger = TriggerId{number.value_or(next_)};
    if (!number) ++next_;
    request.trigger_time = event;
    request.exposure = At(seconds);
    for (int i = 0; i < 5000 && !camera_->Trigger(request); ++i) {
      std::this_thread::sleep_for(milliseconds(1));
    }
    Result<CameraFrame> frame = camera_->Receive(kLong);
    EXPECT_TRUE(frame) << frame.error().message;
    return frame ? std::move(*frame) : CameraFrame{};
  }
  std::vector<int> Steps(const std::vector<CameraFrame>& frames) const {
    std::vector<int> steps;
    for (const CameraFrame& frame : frames) steps.push_back(StepOf(frame, order_));
    return steps;
  }
  std::vector<std::string> Notes() const {
    std::vector<std::string> notes;
    while (auto note = camera_->TakeNote()) notes.push_back(*note);
    return notes;
  }
  bool CycleIsOn() const { return (emulated_->device->Register(0x1800) & 1U << 25) != 0; }
  std::size_t exposures() const { return emulated_->device->trigger_times().size(); }

  const SystemClock clock_{};
  std::unique_ptr<EmulatedIidc> emulated_;
  std::unique_ptr<iidc::IidcCamera> camera_;
  std::vector<double> order_;
  std::uint64_t next_ = 0;
};

// ---- one picture a trigger

TEST_F(Cycle, FourStepsComeInTurnWithoutAnExposureBeingWritten) {
  Begin({0.001, 0.002, 0.004, 0.008});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  ASSERT_TRUE(CycleIsOn());
  EXPECT_THAT(Notes(), ElementsAre(HasSubstr("cycle is used")));
  const std::uint32_t shutter = emulated_->device->Register(0x81C);
  const std::uint64_t before = emulated_->device->requests();
  const std::size_t pictures = exposures();
  for (int turn = 0; turn < 3; ++turn) EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  EXPECT_EQ(exposures(), pictures + 12) << "none thrown away once the order is met";
  EXPECT_EQ(emulated_->device->Register(0x81C), shutter);
  // The trigger's own write, and reads of whether it is ready.
  EXPECT_LE(emulated_->device->requests() - before, 12U * 20U);
  EXPECT_EQ(camera_->counts().cycle_contradictions, 0U);
  EXPECT_EQ(camera_->counts().cycled, 16U);
}

TEST_F(Cycle, TwoStepsFillItTwice) {
  Begin({0.001, 0.004});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1));
  const std::size_t pictures = exposures();
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1));
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1));
  EXPECT_EQ(exposures(), pictures + 4);
  EXPECT_TRUE(CycleIsOn());
}

TEST_F(Cycle, OfThreeStepsTheOneLeftOverIsThrownAway) {
  Begin({0.004, 0.001, 0.002});
  for (int turn = 0; turn < 3; ++turn) EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2));
  EXPECT_TRUE(CycleIsOn());
  // The fourth has the shortest exposure.
  EXPECT_EQ(emulated_->device->Register(0x1880) & 0xFFF, IidcDevice::ShutterRaw(0.001));
}

TEST_F(Cycle, AFrameLostOnItsWayDoesNotShiftTheLabelsWhateverTheCycleDoes) {
  for (const CycleStart start : {CycleStart::kContinues, CycleStart::kSkipsAfterLoss}) {
    emulators::IidcDeviceOptions device;
    device.cycle_start = start;
    Begin({0.001, 0.002, 0.004, 0.008}, device);
    EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
    IidcDevice::Faults faults;
    faults.lose_frames = 1;
    emulated_->device->Set(faults);
    ExposureRequest request;
    request.trigger = TriggerId{next_++};
    request.exposure = At(0.001);
    ASSERT_TRUE(camera_->Trigger(request));
    EXPECT_FALSE(camera_->Receive(milliseconds(1500))) << "it was lost";
    for (int turn = 0; turn < 2; ++turn) EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
    EXPECT_TRUE(CycleIsOn());
    EXPECT_EQ(camera_->counts().cycle_contradictions, 0U) << "measured anew, not presumed";
  }
}

TEST_F(Cycle, ACycleThatBeginsAnewWithEveryTriggerOrAnywhereIsFoundOutAndNotUsed) {
  for (const CycleStart start : {CycleStart::kBeginsAnew, CycleStart::kRandomStep}) {
    emulators::IidcDeviceOptions device;
    device.cycle_start = start;
    Begin({0.001, 0.002, 0.004, 0.008}, device);
    for (int turn = 0; turn < 2; ++turn) EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
    EXPECT_FALSE(CycleIsOn());
    EXPECT_THAT(Notes(), ElementsAre(AllOf(HasSubstr("not used"), HasSubstr("one by one"))));
    EXPECT_EQ(camera_->counts().cycled, 0U);
  }
}

TEST_F(Cycle, AStepThatContradictsIsLabelledAsItIsAndTheNextOnesAreRightAgain) {
  Begin({0.001, 0.002, 0.004, 0.008});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  IidcDevice::Faults faults;
  faults.skipped_steps = 1;
  emulated_->device->Set(faults);
  const CameraFrame other = TakeOne(0.001);
  EXPECT_EQ(StepOf(other, order_), 1) << "not what was asked for, and it says so";
  EXPECT_TRUE(other.cycled);
  EXPECT_THAT(other.settings_readback_json, HasSubstr("\"cycle_step\":2,\"cycle_step_due\":1"));
  ExpectTruth(other);
  EXPECT_EQ(camera_->counts().cycle_contradictions, 1U);
  for (int turn = 0; turn < 2; ++turn) EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  EXPECT_TRUE(CycleIsOn());
}

TEST_F(Cycle, AfterThreeContradictionsItIsNotUsedAnyMore) {
  Begin({0.001, 0.002, 0.004, 0.008});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  EXPECT_EQ(Notes().size(), 1U);
  IidcDevice::Faults faults;
  faults.skipped_steps = 1;
  for (int i = 0; i < 3; ++i) {
    emulated_->device->Set(faults);
    TakeOne(order_[static_cast<std::size_t>(i)]);
  }
  EXPECT_FALSE(CycleIsOn());
  EXPECT_THAT(Notes(), ElementsAre(HasSubstr("not used any more")));
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3)) << "written one by one";
}

TEST_F(Cycle, AFrameThatProvesNothingNeverGetsThePlannedExposure) {
  Begin({0.001, 0.003, 0.005, 0.007});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  IidcDevice::Faults faults;
  faults.wrong_exposures = 1;  // words that stand for nothing that was set
  emulated_->device->Set(faults);
  const CameraFrame foreign = TakeOne(0.001);
  EXPECT_FALSE(foreign.measured_exposure);
  EXPECT_EQ(foreign.proof, ExposureProof::kNone);
  EXPECT_THAT(foreign.settings_readback_json, HasSubstr("\"cycle_step\":null"));
  EXPECT_THAT(foreign.settings_readback_json, ::testing::Not(HasSubstr("exposure_s")));
  for (int turn = 0; turn < 2; ++turn) EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  faults = {};
  faults.short_frames = 1;  // its words are cut off
  faults.short_bytes = 6;
  emulated_->device->Set(faults);
  const CameraFrame cut = TakeOne(0.001);
  EXPECT_EQ(cut.status, FrameStatus::kCorrupt);
  EXPECT_FALSE(cut.measured_exposure);
  EXPECT_EQ(cut.proof, ExposureProof::kNone);
  emulated_->device->Set({});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
}

TEST_F(Cycle, AnExposureBeyondThePlanIsWrittenAndTheCycleComesBackInThePause) {
  Begin({0.001, 0.002, 0.004, 0.008});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  const CameraFrame other = TakeOne(0.016);
  EXPECT_NEAR(other.measured_exposure->time.seconds() / 0.016, 1.0, 0.01);
  EXPECT_FALSE(other.cycled);
  EXPECT_FALSE(CycleIsOn());
  camera_->Prepare(At(0.001));
  for (int i = 0; i < 5000 && !CycleIsOn(); ++i) std::this_thread::sleep_for(milliseconds(1));
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  EXPECT_TRUE(CycleIsOn());
}

TEST_F(Cycle, ABracketThatDoesNotFitIsWrittenOneByOneAndTheNextOneThatDoesIsLoaded) {
  Begin({0.001, 0.002, 0.004, 0.008, 0.016});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3, 4));
  EXPECT_FALSE(CycleIsOn());
  EXPECT_THAT(Notes(), ElementsAre(AllOf(HasSubstr("5 pictures"), HasSubstr("4 steps"))));
  order_ = {0.001, 0.004};
  camera_->Plan({Order(order_), false});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1));
  EXPECT_TRUE(CycleIsOn());
  camera_->Plan({Order({0.002}), false});
  order_ = {0.002};
  EXPECT_THAT(TakeTurn(), ElementsAre(0));
  EXPECT_FALSE(CycleIsOn()) << "one exposure needs none";
}

TEST_F(Cycle, SettingsThatShareAWordAreNotLoaded) {
  emulators::IidcDeviceOptions device;
  device.coarse_words = true;
  Begin({0.001, 0.00102}, device);
  for (int i = 0; i < 2; ++i) EXPECT_EQ(TakeOne(0.001).status, FrameStatus::kOk);
  EXPECT_FALSE(CycleIsOn());
  EXPECT_THAT(Notes(), ElementsAre(HasSubstr("by the same value")));
}

TEST_F(Cycle, StoppedTheCameraIsLeftWithoutItAndStartedItIsMeasuredAgain) {
  Begin({0.001, 0.002, 0.004, 0.008});
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  camera_->Stop();
  EXPECT_FALSE(CycleIsOn());
  ASSERT_TRUE(camera_->Start());
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  EXPECT_TRUE(CycleIsOn());
}

// ---- a series a trigger

class CycleSeries : public Cycle, public ::testing::WithParamInterface<CycleStart> {
 protected:
  void BeginSeries(const std::vector<double>& order) {
    emulators::IidcDeviceOptions device;
    device.cycle_start = GetParam();
    Begin(order, device, true);
  }
};

TEST_P(CycleSeries, OneTriggerTakesTheWholeBracketAndEveryFrameIsOfTheStepAskedFor) {
  for (const std::vector<double>& order :
       {std::vector<double>{0.001, 0.002, 0.004, 0.008}, std::vector<double>{0.004, 0.001, 0.002},
        std::vector<double>{0.002, 0.001}}) {
    BeginSeries(order);
    std::optional<std::uint64_t> counter;
    for (int turn = 0; turn < 4; ++turn) {
      const std::size_t before = exposures();
      const std::vector<CameraFrame> frames = TakeBurst(order);
      if (turn > 0) {
        EXPECT_EQ(exposures() - before, order.size() == 3 ? 4U : order.size());
      }
      for (std::size_t i = 0; i < frames.size(); ++i) {
        EXPECT_EQ(frames[i].status, FrameStatus::kOk) << frames[i].detail;
        EXPECT_EQ(StepOf(frames[i], order), static_cast<int>(i));
        EXPECT_EQ(frames[i].trigger, TriggerId{next_ - order.size() + i});
        EXPECT_TRUE(frames[i].cycled);
        ExpectTruth(frames[i]);
        if (counter) {
          EXPECT_EQ(frames[i].camera_counter, *counter + 1);
        }
        counter = frames[i].camera_counter;
      }
    }
    EXPECT_THAT(Notes(), ElementsAre(HasSubstr("trigger mode 15")));
    EXPECT_EQ(emulated_->device->Register(0x830) >> 16 & 0xFU, 15U);
    EXPECT_EQ(camera_->counts().strays, 0U);
  }
}

TEST_P(CycleSeries, OfALostFrameItsStepIsMissedAndTheOthersKeepTheirs) {
  BeginSeries({0.001, 0.002, 0.004, 0.008});
  EXPECT_THAT(Steps(TakeBurst(order_)), ElementsAre(0, 1, 2, 3));
  IidcDevice::Faults faults;
  faults.lose_frames = 1;
  emulated_->device->Set(faults);
  const std::vector<CameraFrame> frames = TakeBurst(order_);
  int missed = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (frames[i].status == FrameStatus::kMissedTrigger) {
      ++missed;
      EXPECT_THAT(frames[i].detail, HasSubstr("none of the 4 pictures"));
    } else {
      EXPECT_EQ(StepOf(frames[i], order_), static_cast<int>(i));
      ExpectTruth(frames[i]);
    }
  }
  EXPECT_GE(missed, 1);
  EXPECT_LE(missed, 2) << "a cycle that skips a step takes one of them twice";
  EXPECT_THAT(Steps(TakeBurst(order_)), ElementsAre(0, 1, 2, 3));
}

INSTANTIATE_TEST_SUITE_P(Starts, CycleSeries,
                         ::testing::Values(CycleStart::kContinues, CycleStart::kBeginsAnew,
                                           CycleStart::kRandomStep, CycleStart::kSkipsAfterLoss),
                         [](const auto& each) {
                           switch (each.param) {
                             case CycleStart::kContinues:
                               return "Continues";
                             case CycleStart::kBeginsAnew:
                               return "BeginsAnew";
                             case CycleStart::kRandomStep:
                               return "RandomStep";
                             default:
                               return "SkipsAfterLoss";
                           }
                         });

TEST_F(Cycle, OfASeriesAFrameThatProvesNothingIsToldAsSuchAndItsStepCanBeAskedForAgain) {
  Begin({0.001, 0.003, 0.005, 0.007}, {}, true);
  EXPECT_THAT(Steps(TakeBurst(order_)), ElementsAre(0, 1, 2, 3));
  IidcDevice::Faults faults;
  faults.wrong_exposures = 1;
  emulated_->device->Set(faults);
  const HostTime event = clock_.Now();
  int unproven = -1;
  for (int i = 0; i < 4; ++i) {
    const CameraFrame frame = TakeOfBurst(event, order_[static_cast<std::size_t>(i)]);
    if (frame.measured_exposure) {
      EXPECT_EQ(StepOf(frame, order_), i);
      continue;
    }
    EXPECT_EQ(unproven, -1);
    unproven = i;
    EXPECT_EQ(frame.proof, ExposureProof::kNone);
  }
  ASSERT_NE(unproven, -1);
  const auto at = static_cast<std::size_t>(unproven);
  const CameraFrame again = TakeOfBurst(event, order_[at], next_ - 4 + at);
  EXPECT_EQ(StepOf(again, order_), unproven) << "another series";
}

TEST_F(Cycle, WithoutTriggerMode15ABurstIsASeriesOfTriggers) {
  emulators::IidcDeviceOptions device;
  device.series = false;
  Begin({0.001, 0.002, 0.004, 0.008}, device, true);
  for (int turn = 0; turn < 2; ++turn) {
    EXPECT_THAT(Steps(TakeBurst(order_)), ElementsAre(0, 1, 2, 3));
  }
  EXPECT_TRUE(CycleIsOn());
  EXPECT_EQ(emulated_->device->Register(0x830) >> 16 & 0xFU, 0U);
}

// ---- on the trigger's wire

TEST_F(Cycle, OnTheWireEveryPulseTakesTheNextStepHoweverSoonItComes) {
  Make({}, true);
  BeginMade({0.001, 0.002, 0.004, 0.008}, false);
  for (int i = 0; i < 5000 && Notes().empty(); ++i) std::this_thread::sleep_for(milliseconds(1));
  std::this_thread::sleep_for(milliseconds(50));
  std::vector<int> steps;
  const std::uint64_t before = emulated_->device->requests();
  for (int pulse = 0; pulse < 8; ++pulse) {
    emulated_->device->Pulse();
    const Result<CameraFrame> frame = camera_->Receive(kLong);
    ASSERT_TRUE(frame) << frame.error().message;
    ASSERT_TRUE(frame->wired);
    EXPECT_TRUE(frame->cycled);
    ExpectTruth(*frame);
    steps.push_back(StepOf(*frame, order_));
  }
  EXPECT_EQ(emulated_->device->requests(), before) << "no register is touched between pulses";
  for (std::size_t i = 1; i < steps.size(); ++i) EXPECT_EQ(steps[i], (steps[i - 1] + 1) % 4);
}

TEST_F(Cycle, OnTheWireABracketOfThreeIsWrittenOneByOne) {
  Make({}, true);
  BeginMade({0.001, 0.002, 0.004}, false);
  std::vector<std::string> notes;
  for (int i = 0; i < 5000 && notes.empty(); ++i) {
    notes = Notes();
    std::this_thread::sleep_for(milliseconds(1));
  }
  EXPECT_THAT(notes, ElementsAre(HasSubstr("no pulse of the wire can be left out")));
  EXPECT_FALSE(CycleIsOn());
}

// ---- released by pulses of this side's own

TEST_F(Cycle, ReleasedByAWireItStepsWithThePulsesAndACutWireIsMissed) {
  emulators::IidcDeviceOptions device;
  device.exposure_cycle = true;
  emulated_ = std::make_unique<EmulatedIidc>(device);
  const auto wire = std::make_shared<emulators::PulsedWire>([this] { emulated_->device->Pulse(); });
  iidc::IidcCameraOptions options = emulated_->CameraOptions();
  options.exposure_cycle = iidc::CycleUse::kOn;
  options.release = wire;
  camera_ = emulated_->MakeCamera(options);
  BeginMade({0.001, 0.002, 0.004, 0.008}, true);
  for (int turn = 0; turn < 2; ++turn) EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  EXPECT_TRUE(CycleIsOn());
  wire->Cut(true);
  for (const double seconds : {0.001, 0.004}) {  // the step that is due, and another one
    const CameraFrame missed = TakeOne(seconds);
    EXPECT_EQ(missed.status, FrameStatus::kMissedTrigger);
    EXPECT_THAT(missed.detail, HasSubstr("the wire is cut"));
  }
  wire->Cut(false);
  EXPECT_THAT(TakeTurn(), ElementsAre(0, 1, 2, 3));
  camera_.reset();
}

// ---- which cameras

TEST(CycleUse, IsOffUnlessTheTableOrTheUserSaysSoAndNobodyHasMeasuredOne) {
  for (const iidc::CameraModel& model : iidc::CameraModels()) {
    EXPECT_NE(model.cycle, iidc::CycleKnowledge::kWorks) << model.name;
  }
  emulators::IidcDeviceOptions device;
  device.exposure_cycle = true;
  EmulatedIidc emulated(device);
  for (const iidc::CycleUse use : {iidc::CycleUse::kAuto, iidc::CycleUse::kOff}) {
    iidc::IidcCameraOptions options = emulated.CameraOptions();
    options.exposure_cycle = use;
    const auto camera = emulated.MakeCamera(options);
    const Result<CameraInfo> info = camera->Open();
    ASSERT_TRUE(info) << info.error().message;
    EXPECT_THAT(info->extra_json, HasSubstr("\"exposure_cycle\":false"));
    camera->Plan({Order({0.001, 0.002}), false});
    ASSERT_TRUE(camera->Start());
    EXPECT_EQ(Take(*camera, 0, 0.001)->status, FrameStatus::kOk);
    EXPECT_EQ(emulated.device->Register(0x1800) & 1U << 25, 0U);
    EXPECT_FALSE(camera->TakeNote());
  }
}

TEST(CycleUse, AskedForItIsAnErrorWhereTheCameraHasNoneOrItsFramesSayNothing) {
  emulators::IidcDeviceOptions device;
  const auto message = [](const emulators::IidcDeviceOptions& with) {
    EmulatedIidc emulated(with);
    iidc::IidcCameraOptions options = emulated.CameraOptions();
    options.exposure_cycle = iidc::CycleUse::kOn;
    const Result<CameraInfo> info = emulated.MakeCamera(options)->Open();
    EXPECT_FALSE(info);
    return info ? std::string() : info.error().message;
  };
  EXPECT_THAT(message(device), HasSubstr("HDR_CONTROL (0x1800): the camera has no exposure cycle"));
  device.exposure_cycle = true;
  device.embedded_info = false;
  EXPECT_THAT(message(device), HasSubstr("nothing else tells which step"));
}

// ---- the phase alone

TEST(CyclePhase, IsKnownOnlyFromWordsAndCountsWhatBreaksTheRule) {
  const std::array<CycleWords, 4> steps = {{{10, 1}, {20, 1}, {30, 1}, {20, 1}}};
  CyclePhase phase(steps);
  EXPECT_FALSE(phase.next());
  EXPECT_EQ(phase.Saw(CycleWords{20, 1}), CyclePhase::Seen::kLearnt);
  EXPECT_FALSE(phase.next()) << "the second or the fourth";
  EXPECT_EQ(phase.Saw(CycleWords{30, 1}), CyclePhase::Seen::kLearnt);
  EXPECT_EQ(phase.next(), 3);
  EXPECT_EQ(phase.Saw(CycleWords{20, 1}), CyclePhase::Seen::kExpected);
  EXPECT_EQ(phase.next(), 0);
  EXPECT_EQ(phase.Saw(CycleWords{30, 1}), CyclePhase::Seen::kContradiction);
  EXPECT_EQ(phase.next(), 3) << "learnt from the frame that contradicted";
  EXPECT_EQ(phase.Saw(CycleWords{20, 2}), CyclePhase::Seen::kForeign);
  EXPECT_FALSE(phase.next());
  EXPECT_EQ(phase.Saw(std::nullopt), CyclePhase::Seen::kForeign);
}

TEST(CyclePhase, OfTwoStepsInTurnTheFirstFrameTellsAll) {
  CyclePhase phase({{{10, 0}, {20, 0}, {10, 0}, {20, 0}}});
  EXPECT_EQ(phase.Saw(CycleWords{20, 0}), CyclePhase::Seen::kLearnt);
  ASSERT_TRUE(phase.next());
  EXPECT_EQ(*phase.next() % 2, 0);
}

}  // namespace
}  // namespace omnihdr::cycle_test
