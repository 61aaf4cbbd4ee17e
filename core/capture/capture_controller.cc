#include "core/capture/capture_controller.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>

namespace omnihdr {
namespace {

constexpr std::size_t kRecentLines = 16;

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

}  // namespace

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
  }
  return "unknown";
}

CaptureController::CaptureController(BracketPlan plan, CameraDescription description,
                                     const CaptureOptions& options, TriggerId next,
                                     CaptureSink& sink, CommandCamera command,
                                     const PositionSource* positions, const Clock& clock,
                                     const PlaceSource* place)
    : sink_(sink),
      command_(std::move(command)),
      positions_(positions),
      place_(place),
      clock_(clock),
      plan_(std::move(plan)),
      description_(std::move(description)),
      options_(options),
      next_(next) {}

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
  ExposureRequest request;
  request.trigger = next_;
  request.exposure = plan_.ForTrigger(next_);
  request.trigger_time = event.time;
  request.odometer_m = event.odometer_m;
  if (!request.odometer_m && positions_ != nullptr) {
    request.odometer_m = positions_->OdometerMetres(event.time);
  }
  next_ = TriggerId{Value(next_) + 1};
  ++counts_.triggers;
  return request;
}

void CaptureController::OpenMissed(const ExposureRequest& request, MissReason reason,
                                   std::string detail) {
  ++counts_.missed[static_cast<std::size_t>(reason)];
  ledger_.OpenFailed(request, FrameStatus::kMissedTrigger, std::move(detail));
}

void CaptureController::AddLost(const LostEvents& lost, HostTime time) {
  for (std::uint64_t i = 0; i < lost.count; ++i) {
    if (i >= options_.max_lost_lines || !sink_.TryReserveLine()) {
      counts_.lost_unlisted += lost.count - i;
      return;
    }
    // Where the lost one was is not known: only its place in the order is.
    TriggerEvent unknown_place;
    unknown_place.time = time;
    ExposureRequest request = NextRequest(unknown_place);
    request.odometer_m.reset();
    OpenMissed(request, MissReason::kSourceLost,
               lost.reason.empty() ? "the trigger source lost this event before it was read"
                                   : lost.reason);
  }
}

void CaptureController::OnLost(const LostEvents& lost) {
  std::lock_guard lock(mutex_);
  AddLost(lost, clock_.Now());
  SubmitEnded();
}

Result<AcceptedTrigger> CaptureController::OnTrigger(const TriggerEvent& event) {
  std::lock_guard lock(mutex_);
  AddLost({event.lost_before, event.lost_reason}, event.time);
  if (!sink_.TryReserveLine()) {
    ++counts_.refused;
    SubmitEnded();
    return Fail(ErrorKind::kTemporary,
                "trigger refused: as many lines as may wait to be stored do so already");
  }
  const ExposureRequest request = NextRequest(event);
  AcceptedTrigger accepted;
  accepted.trigger = request.trigger;
  accepted.position = plan_.PositionForTrigger(request.trigger);
  accepted.step = plan_.StepForTrigger(request.trigger);
  accepted.exposure = request.exposure;
  accepted.time = request.trigger_time;
  accepted.odometer_m = request.odometer_m;

  if (!sink_.TryReserveBuffer()) {
    OpenMissed(request, MissReason::kNoBuffer,
               "no free frame buffer: the storage is slower than the triggers");
  } else if (Status commanded = command_(request); !commanded) {
    sink_.ReleaseBuffer();
    const ErrorKind kind = commanded.error().kind;
    OpenMissed(request,
               kind == ErrorKind::kUnavailable    ? MissReason::kNoCamera
               : kind == ErrorKind::kTemporary    ? MissReason::kCameraBusy
               : kind == ErrorKind::kCannotCreate ? MissReason::kStorageStop
                                                  : MissReason::kCameraError,
               commanded.error().message);
  } else {
    const auto exposure = Nanoseconds(std::llround(request.exposure.time.seconds() * 1e9));
    // From the command on, not from the event: a late loop must not eat into the camera's time.
    const HostTime from = std::max(clock_.Now(), request.trigger_time);
    ledger_.Open(request, from + exposure + options_.frame_timeout, true);
  }
  SubmitEnded();
  return accepted;
}

void CaptureController::OnFrame(CameraFrame frame) {
  std::lock_guard lock(mutex_);
  if (last_camera_counter_ && frame.camera_counter > *last_camera_counter_ + 1) {
    counts_.camera_gaps += frame.camera_counter - *last_camera_counter_ - 1;
  }
  last_camera_counter_ = frame.camera_counter;

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
    if (!check.usable) {
      status = FrameStatus::kExposureMismatch;
      detail = check.detail;
    }
  }
  if (status == FrameStatus::kMissedTrigger) {
    ++counts_.missed[static_cast<std::size_t>(MissReason::kCameraError)];
  }
  ledger_.Resolve(trigger, status, std::move(detail), std::move(frame));
  SubmitEnded();
}

void CaptureController::OnCameraLost(const std::string& reason) {
  std::lock_guard lock(mutex_);
  last_camera_counter_.reset();
  ledger_.FailOpen(FrameStatus::kCameraTimeout, fmt::format("the camera has gone: {}", reason));
  SubmitEnded();
}

void CaptureController::OnTime() {
  std::lock_guard lock(mutex_);
  ledger_.Expire(clock_.Now());
  SubmitEnded();
}

std::optional<HostTime> CaptureController::NextDeadline() const {
  std::lock_guard lock(mutex_);
  return ledger_.NextDeadline();
}

CaptureLine CaptureController::MakeLine(TriggerOutcome outcome) const {
  CaptureLine line;
  FrameRecord& record = line.record;
  const ExposureRequest& request = outcome.request;
  record.frame = FrameId{Value(request.trigger)};
  record.position = plan_.PositionForTrigger(request.trigger);
  record.exposure = request.exposure;
  record.trigger_time = request.trigger_time;
  record.timestamp = request.trigger_time;
  record.odometer_m = request.odometer_m;
  record.status = outcome.status;
  record.detail = std::move(outcome.detail);
  record.utc = clock_.NowUtc() - (clock_.Now() - request.trigger_time);
  line.holds_buffer = outcome.reserved_buffer;
  if (place_ != nullptr) {
    const HostTime moment = outcome.frame ? outcome.frame->mid_exposure : request.trigger_time;
    record.gnss = place_->Fix(moment);
    record.heading_deg = place_->HeadingDeg(moment);
  }
  if (outcome.frame) {
    CameraFrame& frame = *outcome.frame;
    const ExposureCheck check =
        VerifyExposure(request.exposure, frame.measured_exposure, frame.proof, options_.tolerance);
    record.exposure = check.exposure;
    record.proof = frame.measured_exposure ? frame.proof : ExposureProof::kNone;
    record.timestamp = frame.mid_exposure;
    record.temperature_c = frame.temperature_c;
    record.settings_readback_json = std::move(frame.settings_readback_json);
    record.truth_json = std::move(frame.truth_json);
    if (frame.recorded) {
      record.utc = frame.recorded->utc;
      record.gnss = std::move(frame.recorded->gnss);
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
