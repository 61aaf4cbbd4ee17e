#include "core/capture/capture_controller.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>

#include "core/session/utc_text.h"

namespace omnihdr {
namespace {

constexpr std::size_t kRecentLines = 16;
constexpr const char* kFreeClock = "system-free";
// Receivers report once a second or more often, at once.
constexpr double kGnssReportDelayS = 1.0;

// What is wrong with the pixels of a frame, empty when they are what the session's camera delivers.
std::string PixelFault(const CameraFrame& frame, const CameraDescription& description) {
  return std::visit(
      [&](const auto& image) -> std::string {
        using Value = std::remove_cvref_t<decltype(image.values()[0])>;
        const int bits = static_cast<int>(sizeof(Value)) * 8;
        const int expected_bits = description.bits > 8 ? 16 : 8;
        if (image.width() == description.width && image.height() == description.height &&
            bits == expected_bits) {
          return {};
        }
        return fmt::format("frame of {}x{} in {} bits: expected {}x{} in {} bits", image.width(),
                           image.height(), bits, description.width, description.height,
                           expected_bits);
      },
      frame.pixels);
}

// A machine whose clock nobody keeps may be off by minutes; the receiver's time is at most one
// report late.
void UseGnssTime(FrameRecord& record, HostTime moment) {
  if (!record.gnss || !record.gnss->age_s) return;
  const std::optional<UtcTime> told = UtcFromText(record.gnss->time);
  if (!told) return;
  const auto age = Nanoseconds(std::llround(*record.gnss->age_s * 1e9));
  record.utc = *told + (age - (moment - record.trigger_time));
  record.utc_source = "gnss";
  record.utc_error_s = kGnssReportDelayS;
}

}  // namespace

MissReason CaptureController::ReasonOf(ErrorKind refusal) {
  switch (refusal) {
    case ErrorKind::kUnavailable:
      return MissReason::kNoCamera;
    case ErrorKind::kTemporary:
      return MissReason::kCameraBusy;
    case ErrorKind::kCannotCreate:
      return MissReason::kStorageStop;
    default:
      return MissReason::kCameraError;
  }
}

std::string_view ToString(MissReason reason) {
  switch (reason) {
    case MissReason::kNoCamera:
      return "no-camera";
    case MissReason::kCameraBusy:
      return "camera-busy";
    case MissReason::kCameraError:
      return "camera-error";
    case MissReason::kStorageStop:
      return "storage-stop";
    case MissReason::kNoBuffer:
      return "no-buffer";
    case MissReason::kSourceLost:
      return "source-lost";
    case MissReason::kNotExposed:
      return "not-exposed";
  }
  return "unknown";
}

CaptureController::CaptureController(BracketPlan plan, CameraDescription description,
                                     const CaptureOptions& options, TriggerId next,
                                     CaptureSink& sink, CommandCamera command,
                                     const PositionSource* positions, const Clock& clock,
                                     const PlaceSource* place, const UtcReference* utc)
    : sink_(sink),
      command_(std::move(command)),
      positions_(positions),
      place_(place),
      utc_(utc),
      clock_(clock),
      plan_(std::move(plan)),
      description_(std::move(description)),
      options_(options),
      next_(next),
      retakes_(std::min(options.retakes, Value(next))),
      edges_(options.edge_tolerance) {}

void CaptureController::SetCamera(BracketPlan plan, CameraDescription description,
                                  const ExposureTolerance& tolerance) {
  std::lock_guard lock(mutex_);
  plan_ = std::move(plan);
  description_ = std::move(description);
  options_.tolerance = tolerance;
  camera_known_ = true;
}

bool CaptureController::camera_known() const {
  std::lock_guard lock(mutex_);
  return camera_known_;
}

ExposureRequest CaptureController::NextRequest(const TriggerEvent& event) {
  const std::uint64_t index = Value(next_) - retakes_;
  ExposureRequest request;
  request.trigger = next_;
  request.exposure = plan_.ForTrigger(TriggerId{index});
  request.trigger_time = event.time;
  request.odometer_m = event.odometer_m;
  if (!request.odometer_m && positions_ != nullptr) {
    request.odometer_m = positions_->OdometerMetres(event.time);
  }
  planned_.push_back({index, retakes_, plan_.StepForTrigger(TriggerId{index})});
  next_ = TriggerId{Value(next_) + 1};
  ++counts_.triggers;
  return request;
}

CaptureController::Upcoming CaptureController::upcoming() const {
  std::lock_guard lock(mutex_);
  // A frame that waits for its edge has had its exposure already.
  const TriggerId index{Value(next_) - retakes_ + waiting_frames_.size()};
  return {plan_.StepForTrigger(index), plan_.ForTrigger(index)};
}

void CaptureController::OpenMissed(const ExposureRequest& request, MissReason reason,
                                   std::string detail) {
  ++counts_.missed[static_cast<std::size_t>(reason)];
  ledger_.OpenFailed(request, FrameStatus::kMissedTrigger, std::move(detail));
}

int CaptureController::FramesOfAnEvent() const {
  return options_.burst ? plan_.frames_per_position() : 1;
}

void CaptureController::AddLost(const LostEvents& lost, HostTime time) {
  const int frames = FramesOfAnEvent();
  for (std::uint64_t i = 0; i < lost.count; ++i) {
    if (i >= options_.max_lost_lines || !ReserveLines(frames)) {
      counts_.lost_unlisted += lost.count - i;
      return;
    }
    if (options_.wired) {
      ObserveLostEdge(time, lost.reason);
      continue;
    }
    // Where the lost one was is not known: only its place in the order is.
    TriggerEvent unknown_place;
    unknown_place.time = time;
    for (int frame = 0; frame < frames; ++frame) {
      ExposureRequest request = NextRequest(unknown_place);
      request.odometer_m.reset();
      OpenMissed(request, MissReason::kSourceLost,
                 lost.reason.empty() ? "the trigger source lost this event before it was read"
                                     : lost.reason);
    }
  }
}

void CaptureController::EndBrokenBurst(const TriggerEvent& event) {
  const auto frames = static_cast<std::uint64_t>(FramesOfAnEvent());
  while (Value(next_) % frames != 0 && sink_.TryReserveLine()) {
    ledger_.OpenFailed(NextRequest(event), FrameStatus::kMissedTrigger,
                       "the burst of this position was cut short by a restart");
  }
}

void CaptureController::OnLost(const LostEvents& lost) {
  std::lock_guard lock(mutex_);
  AddLost(lost, clock_.Now());
  if (options_.wired) PairWaitingFrames();
  SubmitEnded();
}

bool CaptureController::ReserveLines(int lines) {
  for (int i = 0; i < lines; ++i) {
    if (sink_.TryReserveLine()) continue;
    for (; i > 0; --i) sink_.ReleaseLine();
    return false;
  }
  return true;
}

Result<AcceptedTrigger> CaptureController::OnTrigger(const TriggerEvent& event) {
  std::lock_guard lock(mutex_);
  EndBrokenBurst(event);
  AddLost({event.lost_before, event.lost_reason}, event.time);
  const int frames = FramesOfAnEvent();
  if (!ReserveLines(frames)) {
    counts_.refused += static_cast<std::uint64_t>(frames);
    SubmitEnded();
    return Fail(ErrorKind::kTemporary,
                "trigger refused: as many lines as may wait to be stored do so already");
  }
  if (!options_.burst) CommandWaiting();
  const bool busy_before = !waiting_.empty();
  AcceptedTrigger accepted;
  for (int i = 0; i < frames; ++i) {
    const ExposureRequest request = NextRequest(event);
    if (i == 0) {
      accepted.trigger = request.trigger;
      accepted.position = plan_.PositionForTrigger(request.trigger);
      accepted.step = planned_.back().step;
      accepted.exposure = request.exposure;
      accepted.time = request.trigger_time;
      accepted.odometer_m = request.odometer_m;
    }
    if (options_.wired) {
      ObserveEdge(request, request.trigger_time);
    } else if (busy_before) {
      OpenMissed(request, MissReason::kCameraBusy,
                 options_.burst ? "the burst before has not ended"
                                : "the trigger before still waits for the busy camera");
    } else if (options_.burst) {
      BeginBurst(request);
    } else {
      CommandNow(request);
    }
  }
  if (!busy_before) CommandWaiting();
  if (options_.wired) PairWaitingFrames();
  SubmitEnded();
  return accepted;
}

HostTime CaptureController::FrameDeadline(const ExposureRequest& request) const {
  const auto exposure = Nanoseconds(std::llround(request.exposure.time.seconds() * 1e9));
  // From the command on, not from the event: a late loop must not eat into the camera's time.
  return std::max(clock_.Now(), request.trigger_time) + exposure + options_.frame_timeout;
}

void CaptureController::CountCameraMiss(ErrorKind kind) {
  if (kind == ErrorKind::kUnavailable || kind == ErrorKind::kCannotCreate) return;
  // A camera that is busy with a picture that is on its way does what it should.
  if (ledger_.open() == 0) ++frameless_;
}

void CaptureController::CommandNow(const ExposureRequest& request) {
  if (!sink_.TryReserveBuffer()) {
    OpenMissed(request, MissReason::kNoBuffer,
               "no free frame buffer: the storage is slower than the triggers");
    return;
  }
  if (Status commanded = command_(request); !commanded) {
    if (WaitFor(request, commanded.error())) return;
    sink_.ReleaseBuffer();
    CountCameraMiss(commanded.error().kind);
    OpenMissed(request, ReasonOf(commanded.error().kind), commanded.error().message);
    return;
  }
  ledger_.Open(request, FrameDeadline(request), true);
}

bool CaptureController::WaitFor(const ExposureRequest& request, const Error& refusal) {
  // A camera that refuses with nothing on its way is not busy with a picture.
  if (refusal.kind != ErrorKind::kTemporary || options_.busy_patience <= Nanoseconds(0) ||
      !waiting_.empty() || ledger_.open() == 0) {
    return false;
  }
  waiting_until_ = clock_.Now() + options_.busy_patience;
  ledger_.Open(request, waiting_until_, true);
  waiting_.push_back({request, true});
  return true;
}

void CaptureController::BeginBurst(const ExposureRequest& request) {
  // All of its frames one after the other, each as slow as one may be.
  if (waiting_.empty()) {
    waiting_until_ = clock_.Now();
    burst_retakes_.clear();
  }
  waiting_until_ = waiting_until_ + (FrameDeadline(request) - clock_.Now());
  ledger_.Open(request, waiting_until_, false);
  waiting_.push_back({request, false});
}

void CaptureController::CommandWaiting() {
  while (!waiting_.empty()) {
    const Waiting next = waiting_.front();
    if (!next.holds_buffer && !sink_.TryReserveBuffer()) {
      waits_for_ = MissReason::kNoBuffer;
      break;
    }
    const Status commanded = command_(next.request);
    if (!commanded && commanded.error().kind == ErrorKind::kTemporary) {
      if (!next.holds_buffer) sink_.ReleaseBuffer();
      waits_for_ = MissReason::kCameraBusy;
      break;
    }
    waiting_.pop_front();
    ledger_.Await(next.request.trigger, FrameDeadline(next.request), true);
    if (commanded && !options_.burst) {
      ++counts_.waited;
      if (Planned* planned = FindPlanned(next.request.trigger)) planned->waited = true;
    }
    if (!commanded) {
      const MissReason reason = ReasonOf(commanded.error().kind);
      ++counts_.missed[static_cast<std::size_t>(reason)];
      ledger_.Resolve(next.request.trigger, FrameStatus::kMissedTrigger, commanded.error().message,
                      std::nullopt);
    }
  }
  ask_again_ = clock_.Now() + options_.busy_retry;
}

void CaptureController::GiveUpWaiting() {
  if (waiting_.empty() || clock_.Now() < waiting_until_) return;
  // A single trigger found the camera busy with a picture, whatever has become of that since.
  if (options_.burst && waits_for_ == MissReason::kCameraBusy &&
      ledger_.open() == waiting_.size()) {
    ++frameless_;
  }
  for (const Waiting& waiting : waiting_) {
    ++counts_.missed[static_cast<std::size_t>(waits_for_)];
    ledger_.Resolve(waiting.request.trigger, FrameStatus::kMissedTrigger,
                    !options_.burst
                        ? fmt::format("the camera was busy with the picture before for {} ms",
                                      options_.busy_patience.count() / 1'000'000)
                    : waits_for_ == MissReason::kNoBuffer
                        ? "no free frame buffer before the end of the burst's time"
                        : "the camera stayed busy until the end of the burst's time",
                    std::nullopt);
  }
  waiting_.clear();
}

bool CaptureController::TakeAgain(const ExposureRequest& request) {
  if (options_.retake <= 0) return false;
  if (options_.burst) {
    int& times = burst_retakes_[request.trigger];
    if (times >= options_.retake) return false;
    ++times;
    ++counts_.retaken;
    if (waiting_.empty()) waiting_until_ = FrameDeadline(request);
    ledger_.Await(request.trigger, waiting_until_, true);
    waiting_.push_front({request, true});
    return true;
  }
  if (plan_.frames_per_position() != 1) return false;
  const Planned* planned = FindPlanned(request.trigger);
  if (planned == nullptr) return false;
  const std::uint64_t index = planned->index;
  // It is to be taken again already, with one before it.
  if (index >= Value(next_) - retakes_) return false;
  retaken_times_ = retaken_index_ == index ? retaken_times_ + 1 : 1;
  retaken_index_ = index;
  if (retaken_times_ > options_.retake) return false;
  retakes_ = Value(next_) - index;
  ++counts_.retaken;
  return false;  // the frame that was not proved has its line all the same
}

CaptureController::Planned* CaptureController::FindPlanned(TriggerId trigger) {
  const std::uint64_t back = Value(next_) - Value(trigger);
  if (back == 0 || back > planned_.size()) return nullptr;
  return &planned_[planned_.size() - back];
}

std::optional<TriggerId> CaptureController::OnFrame(CameraFrame frame) {
  std::lock_guard lock(mutex_);
  std::uint64_t gap = 0;
  if (last_camera_counter_ && frame.camera_counter > *last_camera_counter_ + 1) {
    gap = frame.camera_counter - *last_camera_counter_ - 1;
    counts_.camera_gaps += gap;
  }
  last_camera_counter_ = frame.camera_counter;
  frameless_ = 0;
  if (frame.clock_jumps > camera_jumps_) counts_.clock_jumps += frame.clock_jumps - camera_jumps_;
  camera_jumps_ = frame.clock_jumps;
  if (frame.wired) return OnWiredFrame(std::move(frame), gap);
  const TriggerId trigger = frame.trigger;
  TakeFrame(std::move(frame));
  SubmitEnded();
  return trigger;
}

void CaptureController::TakeFrame(CameraFrame frame) {
  const TriggerId trigger = frame.trigger;
  const ExposureRequest* request = ledger_.FindOpen(trigger);
  if (request == nullptr) {
    ++counts_.late_frames;
    return;
  }
  FrameStatus status = frame.status;
  std::string detail = frame.detail;
  if (status == FrameStatus::kOk) {
    detail = PixelFault(frame, description_);
    if (!detail.empty()) status = FrameStatus::kCorrupt;
  }
  if (status == FrameStatus::kOk) {
    const ExposureCheck check =
        VerifyExposure(request->exposure, frame.measured_exposure, frame.proof, options_.tolerance);
    const bool own_choice = frame.wired || (frame.cycled && !options_.burst);
    if (!check.usable && !(own_choice && TakeAsAnotherStep(*request, frame))) {
      if (TakeAgain(*request)) {
        CommandWaiting();
        return;
      }
      status = FrameStatus::kExposureMismatch;
      detail = check.detail;
    }
  }
  if (status == FrameStatus::kMissedTrigger) {
    ++counts_.missed[static_cast<std::size_t>(MissReason::kCameraError)];
  }
  ledger_.Resolve(trigger, status, std::move(detail), std::move(frame));
  CommandWaiting();
}

void CaptureController::OnCameraLost(const std::string& reason) {
  std::lock_guard lock(mutex_);
  last_camera_counter_.reset();
  camera_jumps_ = 0;
  frameless_ = 0;
  waiting_.clear();
  // No edge is told of any more for what came before.
  while (!waiting_frames_.empty()) GiveUpWaitingFrames(waiting_frames_.front().until);
  if (options_.wired) counts_.edges_without_frame += ledger_.open();
  edges_.Clear();
  ledger_.FailOpen(FrameStatus::kCameraTimeout, fmt::format("the camera has gone: {}", reason));
  SubmitEnded();
}

void CaptureController::OnTime() {
  std::lock_guard lock(mutex_);
  GiveUpWaiting();
  GiveUpWaitingFrames(clock_.Now());
  const std::size_t open = ledger_.open();
  ledger_.Expire(clock_.Now());
  frameless_ += open - ledger_.open();
  if (options_.wired) counts_.edges_without_frame += open - ledger_.open();
  if (!waiting_.empty() && clock_.Now() >= ask_again_) CommandWaiting();
  SubmitEnded();
}

std::optional<HostTime> CaptureController::NextDeadline() const {
  std::lock_guard lock(mutex_);
  std::optional<HostTime> next = ledger_.NextDeadline();
  if (!waiting_.empty() && (!next || ask_again_ < *next)) next = ask_again_;
  if (!waiting_frames_.empty() && (!next || waiting_frames_.front().until < *next)) {
    next = waiting_frames_.front().until;
  }
  return next;
}

CaptureLine CaptureController::MakeLine(TriggerOutcome outcome) {
  CaptureLine line;
  FrameRecord& record = line.record;
  const ExposureRequest& request = outcome.request;
  const Planned planned = planned_.front();
  planned_.pop_front();
  record.frame = FrameId{Value(request.trigger)};
  record.position = plan_.PositionForTrigger(request.trigger);
  record.step = planned.step;
  record.retakes = planned.retakes;
  record.exposure = request.exposure;
  record.trigger_time = request.trigger_time;
  record.timestamp = request.trigger_time;
  record.odometer_m = request.odometer_m;
  record.status = outcome.status;
  record.detail = std::move(outcome.detail);
  if (options_.wired) {
    if (!request.unseen_edge.empty()) {
      // Its time is the camera's, when that took a picture.
      if (outcome.frame && outcome.frame->wired) record.trigger_time = outcome.frame->wired->at;
      record.detail += (record.detail.empty() ? "" : ": ") + request.unseen_edge;
    } else if (record.status == FrameStatus::kCameraTimeout && !outcome.frame && camera_known_) {
      record.detail += "; the pulse did not reach the camera, or its frame was lost";
    }
  }
  record.utc = clock_.NowUtc() - (clock_.Now() - record.trigger_time);
  if (utc_ != nullptr) {
    const UtcQuality quality = utc_->Quality();
    record.utc_source = quality.synchronised ? "system-synchronised" : kFreeClock;
    record.utc_error_s = quality.error_s;
  }
  line.holds_buffer = outcome.reserved_buffer;
  if (place_ != nullptr) {
    const HostTime moment = outcome.frame ? outcome.frame->mid_exposure : request.trigger_time;
    record.gnss = place_->Fix(moment);
    record.gnss_missing = !record.gnss && place_->has_receiver();
    if (record.utc_source == kFreeClock) UseGnssTime(record, moment);
    record.heading_deg = place_->HeadingDeg(moment);
  }
  if (outcome.frame) {
    CameraFrame& frame = *outcome.frame;
    const ExposureCheck check =
        VerifyExposure(request.exposure, frame.measured_exposure, frame.proof, options_.tolerance);
    record.exposure = check.exposure;
    record.proof = frame.measured_exposure ? frame.proof : ExposureProof::kNone;
    // Nobody asked a recorded frame for a step of this bracket.
    if (record.proof == ExposureProof::kFile) record.step.reset();
    record.timestamp = frame.mid_exposure;
    record.timestamp_error = frame.mid_exposure_error;
    if (planned.waited && positions_ != nullptr) {
      const std::optional<double> exposed_at = positions_->OdometerMetres(frame.mid_exposure);
      if (exposed_at) record.odometer_m = exposed_at;
    }
    // The edge is stamped by the kernel, and the camera's own time only says that it is the one.
    if (frame.wired && request.unseen_edge.empty()) {
      const auto exposure = Nanoseconds(std::llround(record.exposure.time.seconds() * 1e9));
      record.timestamp = request.trigger_time + exposure / 2;
      record.timestamp_error =
          std::chrono::abs(frame.wired->at - request.trigger_time) + frame.wired->error;
    }
    record.camera_time = frame.camera_time;
    record.temperature_c = frame.temperature_c;
    record.settings_readback_json = std::move(frame.settings_readback_json);
    record.truth_json = std::move(frame.truth_json);
    if (frame.recorded) {
      record.utc = frame.recorded->utc;
      record.utc_source.clear();
      record.utc_error_s.reset();
      record.gnss = std::move(frame.recorded->gnss);
      record.gnss_missing = false;
      record.heading_deg = frame.recorded->heading_deg;
      record.pose = frame.recorded->pose;
    }
    const bool partial = record.status == FrameStatus::kCorrupt && frame.partial &&
                         PixelFault(frame, description_).empty();
    if (record.status == FrameStatus::kOk || partial) {
      std::visit([&](auto& image) { line.pixels = std::move(image); }, frame.pixels);
    }
  }
  return line;
}

std::uint64_t CaptureController::frameless() const {
  std::lock_guard lock(mutex_);
  return frameless_;
}

void CaptureController::SubmitEnded() {
  while (std::optional<TriggerOutcome> outcome = ledger_.Pop()) {
    const bool lost = outcome->status != FrameStatus::kOk;
    if (lost) {
      last_reason_ = fmt::format("{}: {}", ToString(outcome->status), outcome->detail);
    }
    recent_lost_.push_back(lost);
    if (recent_lost_.size() > kRecentLines) recent_lost_.pop_front();
    CaptureLine line = MakeLine(std::move(*outcome));
    if (line.holds_buffer && std::holds_alternative<std::monostate>(line.pixels)) {
      line.holds_buffer = false;
      sink_.ReleaseBuffer();
    }
    sink_.Submit(std::move(line));
  }
}

BracketPlan CaptureController::plan() const {
  std::lock_guard lock(mutex_);
  return plan_;
}

Status CaptureController::SetPlan(BracketPlan plan) {
  std::lock_guard lock(mutex_);
  if (plan.frames_per_position() != plan_.frames_per_position()) {
    return Fail(ErrorKind::kConfig, "bracket.frames_per_position: {}, expected {} as before",
                plan.frames_per_position(), plan_.frames_per_position());
  }
  plan_ = std::move(plan);
  return {};
}

TriggerId CaptureController::next_trigger() const {
  std::lock_guard lock(mutex_);
  return next_;
}

std::size_t CaptureController::open_triggers() const {
  std::lock_guard lock(mutex_);
  return ledger_.open();
}

CaptureCounts CaptureController::counts() const {
  std::lock_guard lock(mutex_);
  return counts_;
}

CaptureController::RecentLosses CaptureController::recent_losses() const {
  std::lock_guard lock(mutex_);
  RecentLosses losses;
  losses.lost = static_cast<int>(std::count(recent_lost_.begin(), recent_lost_.end(), true));
  losses.of = static_cast<int>(recent_lost_.size());
  losses.last_reason = last_reason_;
  return losses;
}

}  // namespace omnihdr
