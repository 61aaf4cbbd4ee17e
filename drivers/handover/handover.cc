#include "drivers/handover/handover.h"

#include <fmt/format.h>

#include <utility>

#include "core/base/realtime.h"

namespace omnihdr {

void Handover::Open(HandoverLimits limits) {
  std::lock_guard lock(mutex_);
  limits_ = std::move(limits);
  open_ = true;
  away_.clear();
}

void Handover::Close() {
  std::lock_guard lock(mutex_);
  open_ = false;
}

bool Handover::IsOpen() const {
  std::lock_guard lock(mutex_);
  return open_ && away_.empty();
}

Error Handover::Unavailable(const char* doing, const std::string& why) const {
  return {ErrorKind::kUnavailable, fmt::format("{}: {}{}", camera_, doing, why)};
}

Result<bool> Handover::MayStart() const {
  std::lock_guard lock(mutex_);
  if (!open_) return Forward(Unavailable("start: ", "not open"));
  if (!away_.empty()) return Forward(Unavailable("start: ", away_));
  return !running_;
}

void Handover::Start(std::string thread, Stage::Body body) {
  std::lock_guard lock(mutex_);
  running_ = true;
  Forget();
  worker_ = std::make_unique<Stage>(std::move(thread),
                                    [body = std::move(body)](std::stop_token stop, Stage& stage) {
                                      const RealtimeThread realtime(RealtimePriority::kCamera);
                                      return body(std::move(stop), stage);
                                    });
}

void Handover::Stop(const std::function<void(bool gone)>& stop_device) {
  std::unique_ptr<Stage> worker;
  {
    std::lock_guard lock(mutex_);
    running_ = false;
    worker = std::move(worker_);
  }
  if (worker) {
    worker->RequestStop();
    asked_.notify_all();
    delivered_.notify_all();
    // It ends with an error only when an exception escaped it, and the camera stops either way.
    static_cast<void>(worker->Join());
    bool gone = false;
    {
      std::lock_guard lock(mutex_);
      gone = !away_.empty();
    }
    stop_device(gone);
  }
  std::lock_guard lock(mutex_);
  Forget();
  asked_.notify_all();
  delivered_.notify_all();
}

void Handover::Forget() {
  requests_.clear();
  hint_.reset();
  taken_ = 0;
  frames_.clear();
}

Status Handover::CheckLimits(const Exposure& exposure) const {
  if (!exposure.IsValid() || exposure.time < limits_.shortest || exposure.time > limits_.longest) {
    return Fail(ErrorKind::kUsage, "{}: exposure {} s: expected {} to {} s", camera_,
                exposure.time.seconds(), limits_.shortest.seconds(), limits_.longest.seconds());
  }
  const double gain = exposure.gain.value;
  if (!(gain >= limits_.least_gain_db && gain <= limits_.most_gain_db)) {
    return Fail(ErrorKind::kUsage, "{}: gain {} dB: expected {} to {} dB{}{}{}", camera_, gain,
                limits_.least_gain_db, limits_.most_gain_db, limits_.gain_note.empty() ? "" : " (",
                limits_.gain_note, limits_.gain_note.empty() ? "" : ")");
  }
  return {};
}

void Handover::Prepare(const Exposure& next) {
  std::lock_guard lock(mutex_);
  if (!running_ || !away_.empty() || !CheckLimits(next)) return;
  hint_ = next;
  asked_.notify_all();
}

std::optional<Exposure> Handover::TakeHint() {
  std::lock_guard lock(mutex_);
  return std::exchange(hint_, std::nullopt);
}

Status Handover::Trigger(const ExposureRequest& request) {
  std::lock_guard lock(mutex_);
  if (!away_.empty()) return Forward(Unavailable("", away_));
  if (!running_) return Forward(Unavailable("trigger: ", "not started"));
  OMNIHDR_TRY(CheckLimits(request.exposure));
  if (requests_.size() + taken_ >= limits_.requests) {
    return Fail(ErrorKind::kTemporary, "{}: busy with the picture before", camera_);
  }
  if (frames_.size() >= kMaxWaiting) {
    return Fail(ErrorKind::kTemporary, "{}: busy: {} pictures wait to be received", camera_,
                kMaxWaiting);
  }
  requests_.push_back(request);
  asked_.notify_all();
  return {};
}

Status Handover::CheckRunning(const char* doing) const {
  std::lock_guard lock(mutex_);
  if (!away_.empty()) return Forward(Unavailable("", away_));
  if (!running_) return Forward(Unavailable(doing, "not started"));
  return {};
}

bool Handover::HasRoom() const {
  std::lock_guard lock(mutex_);
  return frames_.size() < kMaxWaiting;
}

Result<CameraFrame> Handover::Receive(Nanoseconds timeout) {
  std::unique_lock lock(mutex_);
  delivered_.wait_for(lock, timeout,
                      [this] { return !running_ || !away_.empty() || !frames_.empty(); });
  if (!away_.empty()) return Forward(Unavailable("", away_));
  if (!running_) return Forward(Unavailable("receive: ", "not started"));
  if (frames_.empty()) {
    return Fail(ErrorKind::kTemporary, "{}: no picture within {} ms", camera_,
                timeout.count() / 1'000'000);
  }
  CameraFrame frame = std::move(frames_.front());
  frames_.pop_front();
  return frame;
}

std::optional<ExposureRequest> Handover::Take(Nanoseconds timeout, const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  if (timeout > Nanoseconds(0)) {
    asked_.wait_for(lock, timeout,
                    [&] { return !requests_.empty() || hint_ || stop.stop_requested(); });
  }
  if (!away_.empty() || stop.stop_requested() || requests_.empty()) return std::nullopt;
  ExposureRequest request = requests_.front();
  requests_.pop_front();
  ++taken_;
  return request;
}

void Handover::Deliver(CameraFrame frame) {
  std::lock_guard lock(mutex_);
  frames_.push_back(std::move(frame));
  delivered_.notify_all();
}

void Handover::Done() {
  std::lock_guard lock(mutex_);
  if (taken_ > 0) --taken_;
}

void Handover::Finish(CameraFrame frame) {
  std::lock_guard lock(mutex_);
  frames_.push_back(std::move(frame));
  if (taken_ > 0) --taken_;
  delivered_.notify_all();
}

void Handover::GoAway(std::string reason) {
  std::lock_guard lock(mutex_);
  away_ = std::move(reason);
  Forget();
  asked_.notify_all();
  delivered_.notify_all();
}

CameraFrame Handover::Missed(const ExposureRequest& request, std::string why,
                             std::uint64_t counter) {
  CameraFrame frame;
  frame.trigger = request.trigger;
  frame.status = FrameStatus::kMissedTrigger;
  frame.detail = std::move(why);
  frame.camera_counter = counter;
  frame.mid_exposure = request.trigger_time;
  return frame;
}

}  // namespace omnihdr
