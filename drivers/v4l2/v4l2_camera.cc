#include "drivers/v4l2/v4l2_camera.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

namespace omnihdr::v4l2 {
namespace {

using std::chrono::milliseconds;

constexpr int kMaxFailures = 3;
constexpr int kMaxContradictions = 2;
constexpr int kMaxDrained = 64;
constexpr Nanoseconds kSlice = milliseconds(20);

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
}

}  // namespace

V4l2Camera::V4l2Camera(V4l2CameraOptions options, std::unique_ptr<V4l2System> system)
    : options_(std::move(options)), system_(std::move(system)), clock_(system_->clock()) {}

V4l2Camera::~V4l2Camera() { Close(); }

Result<CameraInfo> V4l2Camera::Open() {
  if (handover_.IsOpen()) return camera_->info;
  Close();
  Result<std::unique_ptr<ReadyCamera>> ready =
      OpenAndSetUp(*system_, options_, clock_).Context("V4L2 camera");
  if (!ready) return Forward(std::move(ready).error());
  camera_ = std::move(*ready);
  counter_ = 0;
  contradictions_ = 0;
  failures_ = 0;
  handover_.Open(limits());
  return camera_->info;
}

HandoverLimits V4l2Camera::limits() const {
  const ExposureControl& control = *camera_->exposure;
  HandoverLimits limits;
  limits.shortest = camera_->info.shortest;
  limits.longest = camera_->info.longest;
  limits.least_gain_db = control.least_gain().value - ExposureControl::kGainGraceDb;
  limits.most_gain_db = control.most_gain().value + ExposureControl::kGainGraceDb;
  if (!control.has_gain()) limits.gain_note = "camera.v4l2.gain_unity is not set";
  limits.requests = 2;
  return limits;
}

void V4l2Camera::Close() {
  Stop();
  handover_.Close();
  camera_.reset();
}

void V4l2Camera::ForgetStream() {
  log_.Reset(camera_->latency_frames, camera_->least_latency);
  set_.reset();
  ready_.clear();
  if (next_) next_->written = false;
  last_sequence_.reset();
  last_stamp_.reset();
  reference_.reset();
  lost_since_ = 0;
}

Status V4l2Camera::Start() {
  OMNIHDR_ASSIGN(const bool may_start, handover_.MayStart());
  if (!may_start) return {};
  OMNIHDR_TRY(camera_->stream->Start(camera_->frame).Context("V4L2 camera: start"));
  next_.reset();
  ForgetStream();
  handover_.Start("v4l2-camera", [this](std::stop_token stop, Stage& stage) {
    return Run(std::move(stop), stage);
  });
  return {};
}

void V4l2Camera::Stop() {
  handover_.Stop([this](bool) { camera_->stream->Stop(); });
}

Status V4l2Camera::Trigger(const ExposureRequest& request) { return handover_.Trigger(request); }

void V4l2Camera::Prepare(const Exposure& next) { handover_.Prepare(next); }

Result<CameraFrame> V4l2Camera::Receive(Nanoseconds timeout) { return handover_.Receive(timeout); }

V4l2Camera::Counts V4l2Camera::counts() const {
  std::lock_guard lock(mutex_);
  return counts_;
}

std::vector<CameraCounter> V4l2Camera::Counters() const {
  const Counts now = counts();
  return {
      {"damaged_buffers", now.damaged},           {"stale_frames", now.stale},
      {"sequence_gaps", now.lost_frames},         {"lost_triggers", now.lost_triggers},
      {"clamped_settings", now.clamped},          {"brightness_contradictions", now.contradictions},
      {"latency_measurements", now.measurements}, {"early_exposures", now.early},
      {"prepared_exposures", now.prepared}};
}

Status V4l2Camera::Run(std::stop_token stop, Stage& stage) {
  while (!stop.stop_requested()) {
    stage.Progress();
    std::optional<Shot> shot;
    if (next_) {
      shot = next_->shot;
      // What was written for it is in force for its frame, or soon will be.
      if (next_->written) {
        set_ = next_->set;
        set_at_ = next_->after;
        reference_ = next_->reference;
      }
      next_.reset();
    } else {
      shot = TakeTrigger(stop);
    }
    // What was said to come next may have been this one.
    if (shot) static_cast<void>(handover_.TakeHint());
    Status done = shot ? Shoot(*shot, stop) : Idle(stop);
    if (!done) {
      handover_.GoAway(std::move(done).error().message);
      return {};
    }
  }
  return {};
}

std::optional<V4l2Camera::Shot> V4l2Camera::TakeTrigger(const std::stop_token& stop) {
  V4l2Device& device = *camera_->device;
  const std::optional<Nanoseconds> patience = device.TriggerPatience();
  if (!patience) return std::nullopt;
  const std::optional<ExposureRequest> request = handover_.Take(*patience, stop);
  if (!request) return std::nullopt;
  return Shot{*request, device.TookTrigger(request->exposure, request->trigger_time)};
}

Status V4l2Camera::Shoot(const Shot& shot, const std::stop_token& stop) {
  Result<std::optional<CameraFrame>> taken = TakePicture(shot, stop);
  if (stop.stop_requested()) return {};
  if (!taken) {
    if (taken.error().kind == ErrorKind::kUnavailable || ++failures_ >= kMaxFailures) {
      return Forward(std::move(taken).error());
    }
    handover_.Finish(Handover::Missed(shot.request, taken.error().message, counter_));
    return {};
  }
  if (*taken) {
    failures_ = 0;
    handover_.Deliver(std::move(**taken));
    if (contradictions_ >= kMaxContradictions) OMNIHDR_TRY(MeasureAnew());
  } else {
    ++counter_;
    {
      std::lock_guard lock(mutex_);
      ++counts_.lost_triggers;
    }
    // No frames: the stream is begun anew, as a last attempt before the camera counts as gone.
    if (++failures_ >= kMaxFailures) {
      return Fail(ErrorKind::kUnavailable, "no frames for {} triggers", failures_);
    }
    OMNIHDR_TRY(RestartStream());
  }
  handover_.Done();
  return {};
}

// Nobody waits for anything: frames come and go, and a lost camera shows.
Status V4l2Camera::Idle(const std::stop_token& stop) {
  const std::optional<Exposure> hint = camera_->device->TookHint(handover_.TakeHint());
  if (hint && (!set_ || set_->asked != *hint)) {
    const Result<bool> written = SetExposureNow(*hint, stop);
    to_be_held_ = written && *written;
    if (to_be_held_) {
      std::lock_guard lock(mutex_);
      ++counts_.prepared;
    }
    // What else fails is done again, and told, when the trigger comes.
    if (!written && written.error().kind == ErrorKind::kUnavailable) {
      return Forward(written.error(), "set the next exposure");
    }
    return {};
  }
  OMNIHDR_ASSIGN(const std::optional<Filled> filled, NextFrame(kSlice));
  if (!filled) return {};
  HoldPrepared(*filled);
  return camera_->stream->Recycle(*filled);
}

Result<std::optional<Filled>> V4l2Camera::NextFrame(Nanoseconds timeout) {
  if (ready_.empty()) return NextOfStream(timeout);
  const Filled filled = ready_.front();
  ready_.pop_front();
  return std::optional<Filled>(filled);
}

Result<std::optional<Filled>> V4l2Camera::NextOfStream(Nanoseconds timeout) {
  Result<std::optional<Filled>> next = camera_->stream->Next(timeout);
  if (!next || !*next) return next;
  const Filled& filled = **next;
  const std::int32_t since =
      last_sequence_ ? SequenceDistance(*last_sequence_, filled.sequence) : 1;
  if (since <= 0 ||
      (last_stamp_ && filled.kind != StampKind::kNone && filled.stamp < *last_stamp_)) {
    {
      std::lock_guard lock(mutex_);
      ++counts_.stale;
    }
    OMNIHDR_TRY(camera_->stream->Recycle(filled));
    return std::optional<Filled>();
  }
  last_sequence_ = filled.sequence;
  if (filled.kind != StampKind::kNone) last_stamp_ = filled.stamp;
  const auto lost = static_cast<std::uint64_t>(since - 1);
  lost_since_ += lost;
  std::lock_guard lock(mutex_);
  counts_.lost_frames += lost;
  if (filled.damaged) ++counts_.damaged;
  return next;
}

Status V4l2Camera::RecycleReady() {
  while (!ready_.empty()) {
    const Filled filled = ready_.front();
    ready_.pop_front();
    OMNIHDR_TRY(camera_->stream->Recycle(filled));
  }
  return {};
}

Status V4l2Camera::Drain() {
  for (int i = 0; i < kMaxDrained; ++i) {
    OMNIHDR_ASSIGN(const std::optional<Filled> filled, NextFrame(Nanoseconds(0)));
    if (!filled) return {};
    OMNIHDR_TRY(camera_->stream->Recycle(*filled));
  }
  return {};
}

// Written right after a frame has come, as when the latency was measured; false when none comes.
Result<bool> V4l2Camera::SetExposureNow(const Exposure& exposure, std::stop_token stop) {
  OMNIHDR_TRY(RecycleReady());
  const HostTime deadline = clock_.Now() + LongestWait(*camera_, options_);
  bool in_step = false;
  while (!in_step && !stop.stop_requested() && clock_.Now() < deadline) {
    OMNIHDR_ASSIGN(const std::optional<Filled> filled, NextFrame(kSlice));
    if (!filled) continue;
    in_step = true;
    if (auto reference = ReferenceOf(*filled)) reference_ = *reference;
    OMNIHDR_TRY(camera_->stream->Recycle(*filled));
  }
  set_.reset();
  if (!in_step) return false;
  OMNIHDR_ASSIGN(const SetExposure set, camera_->exposure->Set(exposure));
  // Frames that were completed meanwhile had the exposure before.
  OMNIHDR_TRY(Drain());
  set_at_ = *last_sequence_;
  log_.Wrote(set_at_, set);
  set_ = set;
  if (set.clamped) {
    std::lock_guard lock(mutex_);
    ++counts_.clamped;
  }
  return true;
}

Result<std::optional<CameraFrame>> V4l2Camera::TakePicture(const Shot& shot, std::stop_token stop) {
  const ExposureRequest& request = shot.request;
  if (!set_ || set_->asked != request.exposure) {
    OMNIHDR_ASSIGN(const bool written,
                   SetExposureNow(request.exposure, stop).Context("set the exposure"));
    if (!written) return std::optional<CameraFrame>();
  }
  const Nanoseconds exposure = FromSeconds(set_->measured.time.seconds());
  const HostTime deadline = clock_.Now() + LongestWait(*camera_, options_) +
                            (camera_->latency_frames + 1) * std::max(camera_->interval, exposure);
  while (!stop.stop_requested()) {
    const Nanoseconds left = deadline - clock_.Now();
    if (left <= Nanoseconds(0)) break;
    OMNIHDR_ASSIGN(const std::optional<Filled> filled, NextFrame(std::min(left, kSlice)));
    if (!filled) continue;
    const std::optional<SetExposure> in_force = log_.InForce(filled->sequence);
    if (!in_force || in_force->asked != request.exposure ||
        ExposureStart(*filled, in_force->measured) < shot.trigger) {
      if (next_ && next_->written &&
          SequenceDistance(next_->after, filled->sequence) >= log_.least()) {
        OMNIHDR_TRY(camera_->stream->Recycle(*filled));
        return Fail(ErrorKind::kTemporary,
                    "the frame was lost, and from frame {} on the next trigger's exposure is in "
                    "force",
                    filled->sequence);
      }
      const Status commanded = CommandNext(shot, *filled, stop);
      OMNIHDR_TRY(camera_->stream->Recycle(*filled));
      if (!commanded) return Forward(commanded.error(), "set the next exposure");
      continue;
    }
    CameraFrame frame = MakeFrame(shot, *filled, *in_force);
    OMNIHDR_TRY(camera_->stream->Recycle(*filled));
    return std::optional<CameraFrame>(std::move(frame));
  }
  return std::optional<CameraFrame>();
}

std::optional<V4l2Camera::Reference> V4l2Camera::ReferenceOf(const Filled& filled) const {
  const std::optional<SetExposure> had = log_.InForce(filled.sequence);
  if (!had || filled.damaged) return std::nullopt;
  const Result<Level> level = MeasureLevel(filled.bytes, camera_->frame);
  if (!level) return std::nullopt;
  return Reference{*level, had->measured};
}

// Right after a frame: writes the next trigger's exposure when the picture of `shot` is certain to
// be taken before it can act.
Status V4l2Camera::CommandNext(const Shot& shot, const Filled& filled,
                               const std::stop_token& stop) {
  if (log_.least() < 2) return {};
  if (!next_) {
    const std::optional<Shot> taken = TakeTrigger(stop);
    if (!taken) return {};
    next_ = Next{*taken, false, 0, {}, {}};
  }
  const Exposure& exposure_then = next_->shot.request.exposure;
  if (next_->written || exposure_then == shot.request.exposure || !set_ ||
      camera_->exposure->MovesBlanking(exposure_then)) {
    return {};
  }
  // The picture: the frame after this one, if the exposure is in force by then and none can have
  // begun before the trigger, else the first with the exposure.
  const Nanoseconds exposure = FromSeconds(set_->measured.time.seconds());
  if (filled.stamp < shot.trigger || exposure > camera_->interval) return {};
  const std::uint32_t picture = set_at_ + static_cast<std::uint32_t>(log_.latency());
  const std::int32_t away = std::max(1, SequenceDistance(filled.sequence, picture));
  if (away >= log_.least()) return {};
  std::optional<Reference> reference = ReferenceOf(filled);
  OMNIHDR_ASSIGN(const SetExposure set, camera_->exposure->Set(exposure_then));
  // Frames that were completed meanwhile are looked at afterwards: one may be the picture.
  for (int i = 0; i < kMaxDrained; ++i) {
    OMNIHDR_ASSIGN(const std::optional<Filled> meanwhile, NextOfStream(Nanoseconds(0)));
    if (!meanwhile) break;
    ready_.push_back(*meanwhile);
  }
  next_->after = *last_sequence_;
  log_.Wrote(next_->after, set);
  next_->written = true;
  next_->set = set;
  next_->reference = reference;
  std::lock_guard lock(mutex_);
  ++counts_.early;
  if (set.clamped) ++counts_.clamped;
  return {};
}

HostTime V4l2Camera::ExposureStart(const Filled& filled, const Exposure& exposure) const {
  const Nanoseconds time = FromSeconds(exposure.time.seconds());
  if (filled.kind == StampKind::kStart && !camera_->stamps_at_readout) return filled.stamp;
  return filled.stamp - time;
}

CameraFrame V4l2Camera::MakeFrame(const Shot& shot, const Filled& filled,
                                  const SetExposure& exposure) {
  CameraFrame frame;
  frame.trigger = shot.request.trigger;
  counter_ += 1 + std::exchange(lost_since_, 0);
  frame.camera_counter = counter_;
  frame.measured_exposure = exposure.measured;
  frame.proof = camera_->latency_measured ? ExposureProof::kLatency : ExposureProof::kReadback;
  const Nanoseconds time = FromSeconds(exposure.measured.time.seconds());
  const HostTime middle = std::clamp(ExposureStart(filled, exposure.measured) + time / 2,
                                     shot.trigger, std::max(shot.trigger, filled.taken_out));
  frame.mid_exposure = shot.request.trigger_time + (middle - shot.trigger);
  frame.settings_readback_json = fmt::format(
      R"({{"exposure_s":{:.9g},"gain_db":{:.9g},"exposure_raw":{},"gain_raw":{},"asked_s":{:.9g},)"
      R"("clamped":{},"sequence":{},"latency_frames":{}}})",
      exposure.measured.time.seconds(), exposure.measured.gain.value, exposure.exposure_raw,
      exposure.gain_raw, exposure.asked.time.seconds(), exposure.clamped, filled.sequence,
      log_.latency());
  Result<Pixels> pixels = ReadPixels(filled.bytes, camera_->frame);
  if (!pixels || filled.damaged) {
    frame.status = FrameStatus::kCorrupt;
    frame.detail = filled.damaged
                       ? fmt::format("the driver calls buffer {} damaged", filled.sequence)
                       : pixels.error().message;
  } else {
    if (std::optional<std::string> contradiction = Contradiction(filled, exposure)) {
      frame.proof = ExposureProof::kNone;
      frame.measured_exposure.reset();
      frame.detail = std::move(*contradiction);
    }
  }
  frame.pixels = pixels ? std::move(*pixels) : BlackPixels(camera_->frame);
  return frame;
}

std::optional<std::string> V4l2Camera::Contradiction(const Filled& filled,
                                                     const SetExposure& exposure) {
  const std::optional<Reference> before = std::exchange(reference_, std::nullopt);
  if (!before) return std::nullopt;
  const Result<Level> level = MeasureLevel(filled.bytes, camera_->frame);
  if (!level) return std::nullopt;
  const double stops =
      std::log2(exposure.measured.EffectiveSeconds() / before->exposure.EffectiveSeconds());
  const std::optional<bool> followed = BrightnessFollowed(before->level, *level, stops);
  if (!followed) return std::nullopt;
  if (*followed) {
    contradictions_ = 0;
    return std::nullopt;
  }
  ++contradictions_;
  {
    std::lock_guard lock(mutex_);
    ++counts_.contradictions;
  }
  return fmt::format(
      "brightness went from {:.3f} to {:.3f} of the range after a step of {:.1f} stops",
      before->level.mean, level->mean, stops);
}

// What was prepared is held against brightness as soon as it is in force: at its trigger, seconds
// later, the scene may be another one. One that contradicts is held against it there, too.
void V4l2Camera::HoldPrepared(const Filled& filled) {
  if (!to_be_held_ || !reference_ || !set_ || filled.damaged) return;
  const std::optional<SetExposure> in_force = log_.InForce(filled.sequence);
  if (!in_force || in_force->asked != set_->asked) return;
  to_be_held_ = false;
  const Reference before = *reference_;
  if (Contradiction(filled, *in_force)) reference_ = before;
}

Status V4l2Camera::MeasureAnew() {
  contradictions_ = 0;
  if (options_.latency_frames > 0) return {};
  OMNIHDR_TRY(RecycleReady());
  OMNIHDR_TRY(NoteLatency(*camera_, options_, clock_).Context("measure the latency anew"));
  ForgetStream();
  std::lock_guard lock(mutex_);
  ++counts_.measurements;
  return {};
}

Status V4l2Camera::RestartStream() {
  camera_->stream->Stop();
  OMNIHDR_TRY(camera_->stream->Start(camera_->frame).Context("begin the stream anew"));
  ForgetStream();
  return {};
}

}  // namespace omnihdr::v4l2
