#include "drivers/replay/replay.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/session_reader.h"
#include "core/session/session_rig.h"

namespace omnihdr {
namespace {

constexpr std::size_t kMaxOnTheirWay = 4;
constexpr Nanoseconds kLookAgain = std::chrono::milliseconds(10);

}  // namespace

Status ReplayOptions::Validate() const {
  if (session.empty()) {
    return Fail(ErrorKind::kConfig, "session: empty: expected a session directory");
  }
  if (!(interval_s >= 0.0 && interval_s <= 3600.0)) {
    return Fail(ErrorKind::kConfig, "interval_s: {}: expected 0 to 3600", interval_s);
  }
  return {};
}

ReplayCamera::ReplayCamera(ReplayOptions options) : options_(std::move(options)) {}

Result<CameraInfo> ReplayCamera::Open() {
  if (Status valid = options_.Validate(); !valid) {
    return Forward(std::move(valid).error(), "replay camera");
  }
  Result<SessionContents> contents = ReadSession(options_.session);
  if (!contents) {
    Error error = std::move(contents).error();
    // A session that is not there may come (a disk to be plugged in), like any other camera.
    if (error.kind == ErrorKind::kNoInput) error.kind = ErrorKind::kUnavailable;
    return Forward(std::move(error), "replay camera");
  }
  std::vector<SessionFile> files;
  if (contents->info.camera.layout == Layout::kRig) {
    Result<std::vector<SessionFile>> rig = ReadRigFiles(options_.session);
    if (!rig) return Forward(std::move(rig).error(), "replay camera");
    files = std::move(*rig);
  }
  std::lock_guard lock(mutex_);
  open_ = true;
  info_ = contents->info;
  frames_ = std::make_shared<const std::vector<FrameRecord>>(std::move(contents->journal.frames));
  CameraInfo info;
  info.description = info_.camera;
  info.response = info_.response;
  // Any request is served, with the exposure recorded.
  info.shortest = ExposureTime::Seconds(1e-9);
  info.longest = ExposureTime::Seconds(3600.0);
  info.min_trigger_interval =
      Nanoseconds(static_cast<std::int64_t>(std::llround(options_.interval_s * 1e9)));
  info.proof = ExposureProof::kFile;
  info.extra_json = info_.extra_json;
  info.files = std::move(files);
  return info;
}

void ReplayCamera::Close() {
  Stop();
  std::lock_guard lock(mutex_);
  open_ = false;
}

Status ReplayCamera::Start() {
  std::lock_guard lock(mutex_);
  if (!open_) return Fail(ErrorKind::kUnavailable, "replay camera: start: not open");
  running_ = true;
  return {};
}

void ReplayCamera::Stop() {
  std::lock_guard lock(mutex_);
  running_ = false;
  requested_.clear();
  changed_.notify_all();
}

Status ReplayCamera::Trigger(const ExposureRequest& request) {
  std::lock_guard lock(mutex_);
  if (!running_) return Fail(ErrorKind::kUnavailable, "replay camera: trigger: not started");
  if (Value(request.trigger) >= frames_->size()) {
    return Fail(ErrorKind::kNoInput, "replay camera: {}: trigger {}: the session has {} lines",
                options_.session.string(), Value(request.trigger), frames_->size());
  }
  if (requested_.size() >= kMaxOnTheirWay) {
    return Fail(ErrorKind::kTemporary, "replay camera: busy: {} pictures are on their way",
                kMaxOnTheirWay);
  }
  requested_.push_back(request);
  changed_.notify_all();
  return {};
}

Result<CameraFrame> ReplayCamera::Receive(Nanoseconds timeout) {
  ExposureRequest request;
  std::uint64_t counter = 0;
  {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [this] { return !running_ || !requested_.empty(); });
    if (!running_) return Fail(ErrorKind::kUnavailable, "replay camera: receive: not started");
    if (requested_.empty()) {
      return Fail(ErrorKind::kTemporary, "replay camera: no picture within {} ms",
                  timeout.count() / 1'000'000);
    }
    request = requested_.front();
    requested_.pop_front();
    counter = counter_++;
    delivering_ = true;
  }
  CameraFrame frame = Load(Value(request.trigger), request);
  frame.camera_counter = counter;
  std::lock_guard lock(mutex_);
  delivering_ = false;
  return frame;
}

CameraFrame ReplayCamera::Load(std::uint64_t line, const ExposureRequest& request) const {
  std::shared_ptr<const std::vector<FrameRecord>> frames;
  {
    std::lock_guard lock(mutex_);
    frames = frames_;
  }
  const FrameRecord& record = (*frames)[line];
  CameraFrame frame;
  frame.trigger = request.trigger;
  frame.status = record.status;
  frame.detail = record.detail;
  frame.measured_exposure = record.exposure;
  frame.proof = ExposureProof::kFile;
  // The exposure lies as long after the trigger as it did then.
  frame.mid_exposure = request.trigger_time + (record.timestamp - record.trigger_time);
  frame.temperature_c = record.temperature_c;
  frame.settings_readback_json = record.settings_readback_json;
  frame.truth_json = record.truth_json;
  frame.recorded = {record.utc, record.gnss, record.heading_deg, record.pose};
  if (record.file.empty()) {
    if (frame.status == FrameStatus::kOk) {
      frame.status = FrameStatus::kCorrupt;
      frame.detail = fmt::format("frame {}: no pixel file named", Value(record.frame));
    }
    return frame;
  }
  const std::filesystem::path path = options_.session / record.file;
  const auto damaged = [&](std::string why) {
    if (frame.status == FrameStatus::kOk) {
      frame.status = FrameStatus::kCorrupt;
      frame.detail = std::move(why);
    }
  };
  Result<std::vector<std::byte>> bytes = ReadFile(path);
  if (!bytes) {
    damaged(bytes.error().message);
    return frame;
  }
  if (record.crc32c && Crc32c(*bytes) != *record.crc32c) {
    damaged(fmt::format("{}: crc32c differs from the journal's", path.string()));
  }
  Result<DecodedImage> image = DecodeImage(*bytes, path.string());
  if (!image) {
    damaged(image.error().message);
    return frame;
  }
  frame.pixels = std::move(image->pixels);
  frame.partial = record.status == FrameStatus::kCorrupt;
  return frame;
}

bool ReplayCamera::Ready() const {
  std::lock_guard lock(mutex_);
  return running_ && requested_.empty() && !delivering_;
}

std::optional<FrameRecord> ReplayCamera::Line(std::uint64_t number) const {
  std::lock_guard lock(mutex_);
  if (!frames_ || number >= frames_->size()) return std::nullopt;
  return (*frames_)[number];
}

std::size_t ReplayCamera::lines() const {
  std::lock_guard lock(mutex_);
  return frames_ ? frames_->size() : 0;
}

ReplayTrigger::ReplayTrigger(std::shared_ptr<const ReplayCamera> camera,
                             ReplayTriggerOptions options)
    : camera_(std::move(camera)), options_(std::move(options)), earliest_(clock_.Now()) {}

Status ReplayTrigger::Start() {
  if (!started_) earliest_ = clock_.Now();
  started_ = true;
  return {};
}

bool ReplayTrigger::exhausted() const {
  if (options_.limit > 0 && events_ >= options_.limit) return true;
  const std::size_t lines = camera_->lines();
  return lines > 0 && options_.first + events_ >= lines;
}

Result<std::optional<TriggerEvent>> ReplayTrigger::Poll() {
  const HostTime now = clock_.Now();
  if (!started_ || now < earliest_ || exhausted() || !camera_->Ready()) return std::nullopt;
  if (options_.room && !options_.room()) return std::nullopt;
  const std::optional<FrameRecord> line = camera_->Line(options_.first + events_);
  if (!line) return std::nullopt;
  TriggerEvent event;
  event.time = now;
  event.odometer_m = line->odometer_m;
  ++events_;
  earliest_ =
      now +
      Nanoseconds(static_cast<std::int64_t>(std::llround(camera_->options().interval_s * 1e9)));
  return event;
}

std::optional<HostTime> ReplayTrigger::NextDeadline() const {
  if (!started_ || exhausted()) return std::nullopt;
  return std::max(earliest_, clock_.Now() + kLookAgain);
}

}  // namespace omnihdr
