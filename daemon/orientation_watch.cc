#include "daemon/orientation_watch.h"

#include <fmt/format.h>

#include <utility>
#include <variant>

#include "core/base/background.h"
#include "core/image/image_io.h"
#include "core/session/rig_file.h"

namespace omnihdr {

OrientationWatch::OrientationWatch(Told told, const OrientationWatchOptions& options)
    : told_(std::move(told)),
      options_(options),
      stage_(std::make_unique<Stage>(
          "orientation",
          [this](const std::stop_token& stop, Stage& self) { return Run(stop, self); })) {}

OrientationWatch::~OrientationWatch() {
  stage_->RequestStop();
  // An exception in the thread is the only error, and there is nobody left to tell.
  static_cast<void>(stage_->Join());
}

void OrientationWatch::Begin(std::string rig_toml) {
  std::lock_guard lock(mutex_);
  if (rig_toml == rig_toml_) return;
  rig_toml_ = std::move(rig_toml);
  ++heads_;
  offered_.clear();
  state_ = {};
  if (!rig_toml_.empty()) {
    state_.what = "looking";
    state_.text = "no frame has been looked at";
  }
}

void OrientationWatch::Offer(const std::filesystem::path& file) {
  {
    std::lock_guard lock(mutex_);
    if (state_.what != "looking" || offered_.size() >= options_.most_waiting) return;
    offered_.push_back(file);
  }
  changed_.notify_all();
}

OrientationState OrientationWatch::state() const {
  std::lock_guard lock(mutex_);
  return state_;
}

void OrientationWatch::SetState(const OrientationState& state, std::uint64_t of) {
  {
    std::lock_guard lock(mutex_);
    if (heads_ != of) return;  // another head has come meanwhile
    state_ = state;
  }
  if (told_ && state.what != "looking") told_(state);
}

void OrientationWatch::Look(const std::filesystem::path& file) {
  std::string rig_toml;
  std::uint64_t head = 0;
  {
    std::lock_guard lock(mutex_);
    rig_toml = rig_toml_;
    head = heads_;
  }
  OrientationState state;
  state.what = "looking";
  if (head != head_) {
    head_ = head;
    looks_ = 0;
    frames_ = 0;
    check_.reset();
    const Result<Rig> rig = ParseRig(rig_toml, "rig.toml");
    Result<OrientationCheck> check =
        rig ? OrientationCheck::Create(*rig) : Forward(Error(rig.error()));
    if (!check) {
      state.what = "off";
      state.text = check.error().message;
      return SetState(state, head);
    }
    check_ = std::move(*check);
  }
  if (!check_) return;
  ++looks_;
  // A frame that cannot be read is the storage's problem, which is told there.
  if (const Result<DecodedImage> frame = ReadImage(file)) {
    const Result<bool> says = std::visit(
        [this](const auto& pixels) { return check_->Add(pixels.view()); }, frame->pixels);
    if (says && *says) ++frames_;
  }
  const OrientationReport report = check_->Report();
  state.agreement = report.configured.agreement;
  state.frames = frames_;
  state.looks = looks_;
  state.text = report.Text();
  const bool enough = frames_ >= options_.frames || looks_ >= options_.most_looks;
  if (enough &&
      (report.verdict != OrientationVerdict::kUndecided || looks_ >= options_.most_looks)) {
    state.what = ToString(report.verdict);
  }
  SetState(state, head);
}

Status OrientationWatch::Run(const std::stop_token& stop, Stage& self) {
  const BackgroundThread background;
  while (!stop.stop_requested()) {
    self.Progress();
    std::filesystem::path file;
    {
      std::unique_lock lock(mutex_);
      changed_.wait_for(lock, stop, std::chrono::seconds(1), [this] { return !offered_.empty(); });
      if (state_.what != "looking") offered_.clear();
      if (offered_.empty()) continue;
      file = std::move(offered_.front());
      offered_.pop_front();
    }
    Look(file);
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, stop, options_.rest, [] { return false; });
  }
  return {};
}

}  // namespace omnihdr
