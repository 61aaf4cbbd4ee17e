#include "drivers/v4l2/rig_member.h"

#include <fmt/format.h>

#include <chrono>
#include <iterator>
#include <thread>
#include <utility>

namespace omnihdr::v4l2 {
namespace {

constexpr Nanoseconds kSlice = std::chrono::milliseconds(20);

}  // namespace

void RigInbox::Put(std::size_t member, CameraFrame frame) {
  std::lock_guard lock(mutex_);
  // The worker takes all at every turn: so many only wait when it has ended.
  if (arrivals_.size() >= kMost) arrivals_.pop_front();
  arrivals_.push_back({member, std::move(frame)});
  changed_.notify_all();
}

std::vector<RigInbox::Arrival> RigInbox::TakeAll(Nanoseconds timeout) {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, timeout, [this] { return !arrivals_.empty(); });
  std::vector<Arrival> taken(std::make_move_iterator(arrivals_.begin()),
                             std::make_move_iterator(arrivals_.end()));
  arrivals_.clear();
  return taken;
}

void RigInbox::Clear() {
  std::lock_guard lock(mutex_);
  arrivals_.clear();
}

RigMember::RigMember(std::size_t number, std::string name, const V4l2CameraOptions& options,
                     std::unique_ptr<V4l2System> system, Nanoseconds retry, RigInbox& inbox)
    : number_(number),
      name_(std::move(name)),
      retry_(retry),
      inbox_(inbox),
      system_(system.get()),
      camera_(options, std::move(system)) {}

std::string RigMember::Explained(const std::string& why) const {
  const std::string more = system_->why();
  return more.empty() ? why : why + ": " + more;
}

Result<CameraInfo> RigMember::Open() {
  Result<CameraInfo> info = camera_.Open().Context(name_);
  if (!info) info.error().message = Explained(info.error().message);
  std::lock_guard lock(gate_);
  state_.present = info.has_value();
  state_.why = info ? std::string() : info.error().message;
  ++state_.life;
  return info;
}

void RigMember::Close() {
  Stop();
  camera_.Close();
  std::lock_guard lock(gate_);
  state_.present = false;
  state_.why = "not open";
  ++state_.life;
}

void RigMember::Expect(const CameraInfo& info) { expected_ = info; }

Status RigMember::Start() {
  if (state().present) OMNIHDR_TRY(camera_.Start().Context(name_));
  next_attempt_ = clock_.Now();
  stage_ = std::make_unique<Stage>(
      fmt::format("v4l2-rig-{}", number_),
      [this](const std::stop_token& stop, Stage& stage) { return Watch(stop, stage); });
  return {};
}

void RigMember::Stop() {
  if (stage_) {
    stage_->RequestStop();
    // It ends with an error only when an exception escaped it, and the camera stops either way.
    static_cast<void>(stage_->Join());
    stage_.reset();
  }
  camera_.Stop();
}

Status RigMember::Trigger(const ExposureRequest& request) {
  std::lock_guard lock(gate_);
  if (!state_.present) return Fail(ErrorKind::kUnavailable, "{}", state_.why);
  return camera_.Trigger(request);
}

void RigMember::Prepare(const Exposure& next) {
  std::lock_guard lock(gate_);
  if (state_.present) camera_.Prepare(next);
}

RigMember::State RigMember::state() const {
  std::lock_guard lock(gate_);
  return state_;
}

Status RigMember::Watch(const std::stop_token& stop, Stage& stage) {
  while (!stop.stop_requested()) {
    stage.Progress();
    if (!state().present) {
      if (clock_.Now() < next_attempt_) {
        std::this_thread::sleep_for(kSlice);
      } else {
        LookForIt();
      }
      continue;
    }
    Result<CameraFrame> frame = camera_.Receive(kSlice);
    if (frame) {
      inbox_.Put(number_, std::move(*frame));
    } else if (frame.error().kind != ErrorKind::kTemporary) {
      Leave(Explained(frame.error().message));
    }
  }
  return {};
}

void RigMember::Leave(std::string why) {
  {
    std::lock_guard lock(gate_);
    state_.present = false;
    state_.why = std::move(why);
    ++state_.life;
    ++state_.departures;
  }
  camera_.Stop();
  camera_.Close();
  next_attempt_ = clock_.Now() + retry_;
}

Status RigMember::IsTheSame(const CameraInfo& info) const {
  if (!expected_) return {};
  const CameraDescription& is = info.description;
  const CameraDescription& was = expected_->description;
  if (is.bits != was.bits || is.width != was.width || is.height != was.height) {
    return Fail(ErrorKind::kConfig,
                "came back with {} x {} pixels of {} bits: expected {} x {} of {}", is.width,
                is.height, is.bits, was.width, was.height, was.bits);
  }
  if (info.shortest > expected_->shortest || info.longest < expected_->longest) {
    return Fail(ErrorKind::kConfig, "came back with exposures of {} to {} s: expected {} to {} s",
                info.shortest.seconds(), info.longest.seconds(), expected_->shortest.seconds(),
                expected_->longest.seconds());
  }
  return {};
}

void RigMember::LookForIt() {
  const auto back = [this]() -> Status {
    OMNIHDR_ASSIGN(const CameraInfo info, camera_.Open());
    OMNIHDR_TRY(IsTheSame(info));
    return camera_.Start();
  }();
  if (!back) {
    camera_.Close();
    next_attempt_ = clock_.Now() + retry_;
  }
  std::lock_guard lock(gate_);
  if (back) {
    state_.present = true;
    ++state_.life;
    ++state_.returns;
  }
  state_.why = back ? std::string() : Explained(back.error().message);
}

}  // namespace omnihdr::v4l2
