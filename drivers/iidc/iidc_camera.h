#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/stage.h"
#include "core/ports/camera.h"
#include "drivers/handover/handover.h"
#include "drivers/iidc/camera_clock.h"
#include "drivers/iidc/camera_setup.h"
#include "drivers/iidc/exposure_cycle.h"
#include "drivers/iidc/exposure_table.h"
#include "drivers/iidc/frame_assembler.h"
#include "drivers/iidc/frame_info.h"

namespace omnihdr::iidc {

// An IIDC camera (Camera's laws hold), triggered by software: a trigger sets shutter and gain,
// reads them back, waits until the camera is ready, and triggers it. One picture is on its way at a
// time; a trigger before it has arrived is refused as busy, as is one while four pictures wait to
// be received. The exposure a frame had is what the camera wrote into the frame; without that, what
// its registers said (proof readback). A picture that does not come within frame_timeout_s of its
// exposure is given up; when it comes later it is thrown away, for its time stamp is older than the
// next trigger. Registers that fail at a trigger give a kMissedTrigger frame that says so; three
// such in a row, or a camera that has gone, end in kUnavailable.
//
// With IidcCameraOptions::release a pulse on that wire takes the place of the software trigger, and
// all else is the same. A pulse that could not be given is a kMissedTrigger frame, too, but the
// wire's failure, not the camera's.
//
// Wired (IidcCameraOptions::wired), it exposes at every pulse on its input with what Prepare has
// set last. Three pictures by software at each start, thrown away, fit its clock to the host's;
// after that the edges that Trigger tells of keep the fit. A clock that has jumped is fitted in the
// same way again, and the pulses of that moment find no camera. Frames come as their pulses made
// them, and say when (CameraFrame::wired).
class IidcCamera final : public Camera {
 public:
  IidcCamera(IidcCameraOptions options, std::unique_ptr<LinkFinder> finder,
             RegisterTimeouts timeouts = {});
  ~IidcCamera() override;

  Result<CameraInfo> Open() override;
  void Close() override;
  Status Start() override;
  void Stop() override;
  Status Trigger(const ExposureRequest& request) override;
  Result<CameraFrame> Receive(Nanoseconds timeout) override;
  void Prepare(const Exposure& next) override;
  void Plan(const ExposurePlan& plan) override;
  std::optional<std::string> TakeNote() override;

  struct Counts {
    std::uint64_t torn = 0;                  // frames with lost or surplus bytes
    std::uint64_t strays = 0;                // frames that no trigger waited for
    std::uint64_t lost = 0;                  // triggers whose frame never came
    std::uint64_t cycled = 0;                // frames of the camera's own exposure cycle
    std::uint64_t cycle_discarded = 0;       // pictures thrown away for it
    std::uint64_t cycle_contradictions = 0;  // frames that had another of its steps than was due
  };
  Counts counts() const;
  std::vector<CameraCounter> Counters() const override;

 private:
  struct InForce {
    Exposure asked;
    Exposure measured;
    std::uint32_t shutter_raw = 0;
    std::uint32_t gain_raw = 0;
    bool settled = false;  // the pictures that may have had the one before are thrown away
  };
  // When the trigger was sent.
  struct Sent {
    HostTime before;
    HostTime after;
    bool confirmed = false;
    std::string unreleased;  // why the wire gave no pulse; empty = it did
  };

  struct CycleInForce {
    std::array<InForce, kCycleSteps> steps;
    CyclePhase phase;
    int pictures = 0;     // that a trigger takes as a series; 0 = one
    unsigned recent = 0;  // bit n: the frame n before the newest contradicted what was known
  };
  // What the cycle has to do with a frame.
  struct CycleMark {
    std::optional<int> due;    // the step that was expected
    std::optional<int> found;  // that its words prove
  };
  // The pictures of one trigger in mode 15.
  struct SeriesFrame {
    RawFrame raw;
    Sent sent;
    CycleMark mark;
  };
  struct Series {
    HostTime asked_at;  // trigger_time of the requests it serves
    Sent sent;
    int pictures = 0;
    int came = 0;    // or are known to be lost
    HostTime until;  // when the next one has come at the latest
    std::deque<SeriesFrame> held;
    std::vector<TriggerId> answered;
    std::uint64_t gap = 0;  // frames lost since the last one delivered
    bool over(HostTime now) const { return came >= pictures || now >= until; }
  };

  Status RunShots(std::stop_token stop, Stage& stage);
  Status GetReady(const Exposure& next, const std::stop_token& stop);
  Status Idle();
  // The camera's own exposure cycle (cycle_shots.cc).
  Status FollowPlan(const std::stop_token& stop);
  bool FollowPlanAgain();
  void AskForPlan();
  bool PlanIsNew() const;
  bool IsPlanned(const Exposure& exposure) const;
  Result<bool> LoadCycle(const ExposurePlan& plan, const std::stop_token& stop, std::string& why);
  Result<bool> TrySteps(const std::stop_token& stop, std::string& why);
  Result<bool> TrySeries(int pictures, const std::stop_token& stop);
  Status EndCycle();
  Status SetUpTrigger();
  Status EndCycleIfSurprised();
  const InForce* StepOf(const Exposure& exposure) const;
  const InForce* FoundStep(const CycleMark& mark) const;  // null: its words prove none
  std::optional<CycleWords> WordsOf(const EmbeddedInfo& info) const;
  CycleMark MarkFrame(const RawFrame& raw, CyclePhase::Seen* seen = nullptr);
  Result<bool> Align(const Exposure& exposure, const std::stop_token& stop);
  Result<std::optional<CycleMark>> ThrowAwayAPicture(const std::stop_token& stop,
                                                     CyclePhase::Seen* seen);
  Result<std::optional<CameraFrame>> TakeStep(const ExposureRequest& request,
                                              const std::stop_token& stop);
  Result<std::optional<CameraFrame>> TakeFromSeries(const ExposureRequest& request,
                                                    const std::stop_token& stop);
  Status BeginSeries(HostTime asked_at, const std::stop_token& stop);
  Status ReadSeries(Nanoseconds timeout);
  std::optional<SeriesFrame> Claim(const std::optional<Exposure>& exposure);
  void AddNote(std::string note);
  // Wired (wired_shots.cc).
  Status RunWired(std::stop_token stop, Stage& stage);
  Status WireUp(const std::stop_token& stop);
  Status FitClock(const std::stop_token& stop);
  Status PrepareWired();
  Status ReadWired();
  void DeliverWired(RawFrame raw);
  std::optional<HostTime> TakeEdge(HostTime near, Nanoseconds within);
  Result<std::optional<CameraFrame>> TakePicture(const ExposureRequest& request,
                                                 std::stop_token stop);
  Status SetExposure(const Exposure& exposure);
  Result<Sent> SendTrigger();
  Sent PulseWire();
  std::optional<CameraFrame> NotReleased(const ExposureRequest& request, const Sent& sent);
  Result<std::optional<RawFrame>> WaitForFrame(const Sent& sent, std::stop_token stop);
  // `mark`: of a frame of the exposure cycle. `counter`: as told outside, when it is known already.
  CameraFrame MakeFrame(const ExposureRequest& request, const Sent& sent, RawFrame raw,
                        const CycleMark* mark = nullptr,
                        std::optional<std::uint64_t> counter = std::nullopt);
  std::string Readback(const CycleMark* mark) const;
  std::uint64_t Count(std::optional<std::uint32_t> embedded);
  void Prove(const EmbeddedInfo& info, CameraFrame& frame) const;
  bool IsStray(const RawFrame& frame, const Sent& sent);
  Status DropStrays();
  Status StartLink();
  Status RestartStream();

  const IidcCameraOptions options_;
  const std::unique_ptr<LinkFinder> finder_;
  const RegisterTimeouts timeouts_;
  const SystemClock clock_;

  // Of whoever runs Open, Start, Stop and Close, and of the worker in between.
  std::optional<ReadyCamera> camera_;
  std::optional<FrameAssembler> assembler_;
  CameraClock camera_clock_;
  std::uint64_t jumps_before_ = 0;  // of camera_clock_, before the camera was opened
  ExposureTable shutters_;
  ExposureTable gains_;
  std::optional<InForce> in_force_;
  std::optional<std::uint32_t> last_counter_;
  std::uint64_t counter_ = 0;  // as told outside: pictures thrown away on purpose left out
  std::uint64_t counter_at_last_ = 0;
  std::uint32_t discarded_ = 0;  // since last_counter_
  int failures_ = 0;

  std::optional<CycleInForce> cycle_;
  std::optional<Series> series_;
  bool cycle_touched_ = false;    // the camera may have its cycle on, or its series
  std::string unreleased_;        // why the wire gave no pulse for the picture thrown away last
  bool cycle_suspended_ = false;  // the plan fits, something else was asked for

  // Wired, of the worker.
  std::optional<Exposure> wanted_;
  std::uint64_t fitted_jumps_ = 0;
  Nanoseconds arrival_delay_{0};  // from an exposure's end to its frame's arrival, as last seen

  Handover handover_{"IIDC camera"};
  mutable std::mutex mutex_;
  Counts counts_;                     // with mutex_
  std::deque<HostTime> edges_;        // with mutex_: told of by Trigger, the newest last
  std::optional<ExposurePlan> plan_;  // with mutex_
  bool plan_is_new_ = false;          // with mutex_
  std::deque<std::string> notes_;     // with mutex_
  std::string last_note_;             // with mutex_: of this plan
};

// Where the options say that the camera is: this machine's USB, recorded or not, or its FireWire.
std::unique_ptr<LinkFinder> MakeFinder(const IidcCameraOptions& options);
std::unique_ptr<Camera> MakeIidcCamera(IidcCameraOptions options);

}  // namespace omnihdr::iidc
