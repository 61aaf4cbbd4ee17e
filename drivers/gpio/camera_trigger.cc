#include "drivers/gpio/camera_trigger.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace omnihdr::gpio {
namespace {

using std::chrono::milliseconds;

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<Nanoseconds::rep>(std::llround(seconds * 1e9)));
}

}  // namespace

Status CameraTriggerOptions::Validate() const {
  if (!configured()) return {};
  if (name.chip.empty()) {
    return Fail(ErrorKind::kConfig,
                "outputs.chip: \"\": expected a chip's label or name with "
                "outputs.camera_trigger");
  }
  if (!(pulse_s >= 1e-5 && pulse_s <= 1.0)) {
    return Fail(ErrorKind::kConfig, "outputs.camera_trigger_s: {}: expected 1e-5 to 1", pulse_s);
  }
  if (!(spacing_s > pulse_s && spacing_s <= 10.0)) {
    return Fail(ErrorKind::kConfig,
                "outputs.camera_trigger_spacing_s: {}: expected more than the pulse, "
                "outputs.camera_trigger_s = {}, and at most 10",
                spacing_s, pulse_s);
  }
  return {};
}

CameraTrigger::CameraTrigger(const CameraTriggerOptions& options, std::unique_ptr<Lines> lines,
                             const Clock& clock)
    : options_(options), lines_(std::move(lines)), clock_(clock) {}

CameraTrigger::~CameraTrigger() {
  if (stage_) stage_->RequestStop();
}

Status CameraTrigger::Start() {
  if (stage_) return {};
  OMNIHDR_TRY(options_.Validate().Context("gpio"));
  stage_ = std::make_unique<Stage>("gpio-camera", [this](std::stop_token stop, Stage& self) {
    return Run(std::move(stop), self);
  });
  return {};
}

LinkReport CameraTrigger::report() const {
  std::lock_guard lock(mutex_);
  LinkReport report = report_;
  report.up = line_ != nullptr;
  if (!report.up && report.problem.empty()) report.problem = "opening the line";
  return report;
}

Nanoseconds CameraTrigger::spacing() const { return FromSeconds(options_.spacing_s); }

void CameraTrigger::Break(const Error& error) {
  report_.problem = error.message;
  ++report_.errors;
  line_.reset();
}

std::optional<HostTime> CameraTrigger::WaitsFor() const {
  std::optional<HostTime> until = pulse_end_;
  if (next_begin_ && *next_begin_ > clock_.Now())
    until = std::max(*next_begin_, until.value_or(*next_begin_));
  return until;
}

Result<CameraRelease::Moment> CameraTrigger::Release(Nanoseconds patience) {
  const HostTime deadline = clock_.Now() + patience;
  std::unique_lock lock(mutex_);
  while (line_) {
    const std::optional<HostTime> until = WaitsFor();
    if (!until) break;
    const HostTime now = clock_.Now();
    if (now >= deadline || *until > deadline) {
      ++report_.lost;
      return Fail(ErrorKind::kTemporary, "camera trigger: the pulse before was less than {} s ago",
                  options_.spacing_s);
    }
    // Ended pulses are told; spacing that has passed is not.
    changed_.wait_for(lock,
                      std::clamp(*until - now, Nanoseconds(1000), Nanoseconds(milliseconds(5))));
  }
  if (!line_) {
    ++report_.lost;
    return Fail(ErrorKind::kUnavailable, "camera trigger: {} is not open{}{}", options_.name.Text(),
                report_.problem.empty() ? "" : ": ", report_.problem);
  }
  Moment moment;
  moment.before = clock_.Now();
  if (const Status set = line_->Set(true); !set) {
    Break(set.error());
    ++report_.lost;
    return Fail(ErrorKind::kUnavailable, "camera trigger: {}", report_.problem);
  }
  moment.after = clock_.Now();
  pulse_end_ = moment.after + FromSeconds(options_.pulse_s);
  next_begin_ = moment.after + spacing();
  ++report_.messages;
  changed_.notify_all();
  return moment;
}

void CameraTrigger::EndPulse() {
  pulse_end_.reset();
  if (line_) {
    if (const Status set = line_->Set(false); !set) Break(set.error());
  }
  changed_.notify_all();
}

void CameraTrigger::Open() {
  // Not under the lock: whoever releases must not wait for a chip to be found.
  Result<std::unique_ptr<OutputLine>> line =
      lines_->RequestOutput({options_.name, options_.active_low});
  std::lock_guard lock(mutex_);
  if (!line) {
    report_.problem = line.error().message;
    ++report_.errors;
    return;
  }
  line_ = std::move(*line);
  report_.problem.clear();
  ++report_.opened;
}

Status CameraTrigger::Run(std::stop_token stop, Stage& self) {
  HostTime next_open = clock_.Now();
  std::unique_lock lock(mutex_);
  while (!stop.stop_requested()) {
    self.Progress();
    if (!line_ && clock_.Now() >= next_open) {
      lock.unlock();
      Open();
      next_open = clock_.Now() + FromSeconds(options_.reconnect_s);
      lock.lock();
    }
    if (!pulse_end_) {
      changed_.wait_for(lock, stop, milliseconds(100), [this] { return pulse_end_.has_value(); });
    }
    if (!pulse_end_) continue;
    const Nanoseconds left = *pulse_end_ - clock_.Now();
    if (left > Nanoseconds(0)) changed_.wait_for(lock, stop, left, [] { return false; });
    if (*pulse_end_ <= clock_.Now()) EndPulse();
  }
  EndPulse();
  return {};
}

}  // namespace omnihdr::gpio
