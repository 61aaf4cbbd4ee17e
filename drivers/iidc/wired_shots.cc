#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/registers.h"
#include "drivers/iidc/trigger_mode.h"

// The camera on a wire: it exposes at pulses, and this thread sets its exposure and takes what
// comes.
namespace omnihdr::iidc {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;

constexpr int kMaxFailures = 3;
constexpr int kPicturesOfAFit = 3;
constexpr double kExposureOfAFit = 0.001;
// So soon an exposure is set that Prepare asks for.
constexpr Nanoseconds kWiredSlice = milliseconds(2);
// An edge is stamped so much after the pulse at most, and the exposure begins so much after it.
constexpr Nanoseconds kLatestStamp = milliseconds(1);
constexpr Nanoseconds kLongestStart = milliseconds(2);
// How far an edge may be from a fitted start beside the fit's own error.
constexpr Nanoseconds kEdgeTolerance = milliseconds(5);
// From the exposure's end to the frame's arrival.
constexpr Nanoseconds kLongestDelay = std::chrono::seconds(1);
// Of a start that follows from the frame's arrival.
constexpr Nanoseconds kErrorByArrival = milliseconds(20);

}  // namespace

Status IidcCamera::RunWired(std::stop_token stop, Stage& stage) {
  wanted_.reset();
  Status ready = WireUp(stop);
  if (!ready) {
    handover_.GoAway(std::move(ready).Context("wire up").error().message);
    return {};
  }
  while (!stop.stop_requested()) {
    stage.Progress();
    Status turn = PrepareWired();
    if (turn) turn = ReadWired();
    if (turn) turn = EndCycleIfSurprised();
    if (turn && (camera_clock_.jumps() != fitted_jumps_ || PlanIsNew())) turn = WireUp(stop);
    if (turn) {
      failures_ = 0;
    } else if (turn.error().kind == ErrorKind::kUnavailable || ++failures_ >= kMaxFailures) {
      handover_.GoAway(turn.error().message);
      return {};
    }
  }
  return {};
}

Status IidcCamera::WireUp(const std::stop_token& stop) {
  OMNIHDR_TRY(EndCycle());
  OMNIHDR_TRY(SetUpSoftwareTrigger(*camera_->registers, options_.trigger_mode));
  OMNIHDR_TRY(FitClock(stop).Context("fit the clock"));
  if (camera_->cycle) {
    AskForPlan();
    OMNIHDR_TRY(FollowPlan(stop));
    // What a change of the trigger does to it shows the first frame.
    if (cycle_) cycle_->phase.Forget();
  }
  return SetUpWiredTrigger(*camera_->registers, options_.trigger_mode, options_.trigger_input,
                           options_.trigger_active_low);
}

Status IidcCamera::FitClock(const std::stop_token& stop) {
  camera_clock_.Reset();
  Exposure exposure;
  exposure.time = std::clamp(ExposureTime::Seconds(kExposureOfAFit), camera_->info.shortest,
                             camera_->info.longest);
  if (camera_->gain_range) {
    exposure.gain.value =
        std::clamp(0.0, camera_->gain_range->minimum, camera_->gain_range->maximum);
  }
  OMNIHDR_TRY(SetExposure(exposure));
  int fitted = 0;
  for (int i = 0; i < kPicturesOfAFit && !stop.stop_requested(); ++i) {
    OMNIHDR_ASSIGN(const Sent sent, SendTrigger());
    OMNIHDR_ASSIGN(const std::optional<RawFrame> raw, WaitForFrame(sent, stop));
    if (!raw) continue;
    ++discarded_;
    const std::optional<FrameFacts> facts = ReadFacts(raw->bytes, camera_->picture);
    if (!facts || !facts->info.cycle_time || !sent.confirmed) continue;
    const auto cycle_ns = CycleTimeNanoseconds(*facts->info.cycle_time);
    if (!cycle_ns) continue;
    camera_clock_.Add(camera_clock_.Unwrap(*cycle_ns, raw->arrived), sent.before,
                      sent.after + kLongestStart);
    arrival_delay_ = raw->arrived - sent.after -
                     Nanoseconds(std::llround(in_force_->measured.time.seconds() * 1e9));
    ++fitted;
  }
  fitted_jumps_ = camera_clock_.jumps();
  if (fitted == 0 && !stop.stop_requested()) {
    return Fail(ErrorKind::kTemporary, "none of {} pictures came with the camera's time",
                kPicturesOfAFit);
  }
  return {};
}

Status IidcCamera::PrepareWired() {
  if (const std::optional<Exposure> next = handover_.TakeHint()) wanted_ = next;
  if (wanted_ && cycle_) {
    if (StepOf(*wanted_) != nullptr) return {};
    cycle_suspended_ = true;
    OMNIHDR_TRY(EndCycle());
  } else if (wanted_ && cycle_suspended_ && IsPlanned(*wanted_)) {
    FollowPlanAgain();
    return {};
  }
  if (!wanted_ || (in_force_ && in_force_->asked == *wanted_)) return {};
  std::optional<InForce> before = in_force_;
  Status set = SetExposure(*wanted_).Context("set the exposure");
  if (!set && before) {
    // Half set: what frames had is in their words, and it is set anew by the next turn.
    before->asked = Exposure{};
    in_force_ = before;
  }
  return set;
}

Status IidcCamera::ReadWired() {
  Result<StreamChunk> chunk = camera_->link->ReadStream(kWiredSlice);
  if (!chunk) {
    if (chunk.error().kind == ErrorKind::kTemporary) return {};
    return Forward(Error{ErrorKind::kUnavailable, std::move(chunk).error().message});
  }
  std::vector<RawFrame> frames = assembler_->Add(*chunk);
  camera_->link->Recycle(std::move(*chunk));
  for (RawFrame& frame : frames) DeliverWired(std::move(frame));
  if (!assembler_->in_step()) OMNIHDR_TRY(RestartStream().Context("begin the stream anew"));
  return {};
}

std::optional<HostTime> IidcCamera::TakeEdge(HostTime near, Nanoseconds within) {
  std::lock_guard lock(mutex_);
  const auto nearest =
      std::min_element(edges_.begin(), edges_.end(), [near](HostTime a, HostTime b) {
        return std::chrono::abs(a - near) < std::chrono::abs(b - near);
      });
  if (nearest == edges_.end() || std::chrono::abs(*nearest - near) > within) return std::nullopt;
  const HostTime edge = *nearest;
  edges_.erase(edges_.begin(), nearest + 1);
  return edge;
}

void IidcCamera::DeliverWired(RawFrame raw) {
  if (!in_force_ || !handover_.HasRoom()) {
    // Not delivered, but counted by the camera: the next frame's counter shows the gap.
    if (cycle_) cycle_->phase.Forget();
    std::lock_guard lock(mutex_);
    ++counts_.strays;
    return;
  }
  const std::optional<FrameFacts> facts = ReadFacts(raw.bytes, camera_->picture);
  const HostTime arrived = raw.arrived;
  std::optional<std::int64_t> cycle_ns;
  if (facts && facts->info.cycle_time) cycle_ns = CycleTimeNanoseconds(*facts->info.cycle_time);
  std::optional<CycleMark> mark;
  if (cycle_) {
    // A step is left out with every frame that was lost on its way.
    if (!facts || !facts->info.counter || !last_counter_ ||
        *facts->info.counter - *last_counter_ - discarded_ != 1) {
      cycle_->phase.Forget();
    }
    mark = MarkFrame(raw);
    const InForce* found = FoundStep(*mark);
    in_force_ = found != nullptr ? *found : cycle_->steps.front();
    std::lock_guard lock(mutex_);
    ++counts_.cycled;
  }
  CameraFrame frame = MakeFrame(ExposureRequest{}, Sent{arrived, arrived, false, {}},
                                std::move(raw), mark ? &*mark : nullptr);
  const double seconds = frame.measured_exposure.value_or(in_force_->measured).time.seconds();
  const Nanoseconds exposure(std::llround(seconds * 1e9));
  WiredStart start{arrived - arrival_delay_ - exposure, kErrorByArrival};
  if (cycle_ns) {
    const CameraTime taken = camera_clock_.Unwrap(*cycle_ns, arrived);
    const std::optional<HostTime> fitted = camera_clock_.ToHost(taken);
    if (fitted) start = {*fitted, camera_clock_.uncertainty(taken)};
    // A clock that has jumped shows by frames that seem to be of another time than they came.
    const HostTime earliest = arrived - exposure - kLongestDelay;
    if (!fitted || *fitted - start.error > arrived || *fitted + start.error < earliest) {
      camera_clock_.Add(taken, earliest, arrived);
      start = {arrived - arrival_delay_ - exposure, kErrorByArrival};
    } else if (const auto edge = TakeEdge(start.at, start.error + kEdgeTolerance)) {
      camera_clock_.Add(taken, *edge - kLatestStamp, *edge + kLongestStart);
    }
  }
  if (frame.status == FrameStatus::kOk) {
    arrival_delay_ = std::clamp(arrived - start.at - exposure, Nanoseconds(0), kLongestDelay);
  }
  frame.wired = start;
  frame.mid_exposure = start.at + exposure / 2;
  frame.mid_exposure_error = start.error;
  handover_.Deliver(std::move(frame));
}

}  // namespace omnihdr::iidc
