#include "drivers/gpio/outputs.h"

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

Status OutputsOptions::Validate() const {
  if (!configured()) return {};
  if (chip.empty()) {
    return Fail(ErrorKind::kConfig, "outputs.chip: \"\": expected a chip's label or name");
  }
  if (!(strobe_s >= 1e-5 && strobe_s <= 1.0)) {
    return Fail(ErrorKind::kConfig, "outputs.strobe_s: {}: expected 1e-5 to 1", strobe_s);
  }
  std::array<std::string, 4> names = {ready, busy, fault, strobe};
  std::sort(names.begin(), names.end());
  for (std::size_t i = 1; i < names.size(); ++i) {
    if (!names[i].empty() && names[i] == names[i - 1]) {
      return Fail(ErrorKind::kConfig, "outputs: line {} twice: expected a line for each", names[i]);
    }
  }
  return {};
}

Outputs::Outputs(const OutputsOptions& options, std::unique_ptr<Lines> lines, const Clock& clock)
    : options_(options), lines_(std::move(lines)), clock_(clock) {
  outputs_[kReady].name = {options.chip, options.ready};
  outputs_[kBusy].name = {options.chip, options.busy};
  outputs_[kFault].name = {options.chip, options.fault};
  outputs_[kStrobe].name = {options.chip, options.strobe};
}

Outputs::~Outputs() {
  if (stage_) stage_->RequestStop();
}

Status Outputs::Start() {
  if (stage_) return {};
  OMNIHDR_TRY(options_.Validate().Context("gpio"));
  stage_ = std::make_unique<Stage>(
      "gpio-outputs", [this](std::stop_token stop, Stage& self) { return Run(stop, self); });
  return {};
}

LinkReport Outputs::report() const {
  std::lock_guard lock(mutex_);
  LinkReport report = report_;
  report.up = true;
  report.problem.clear();
  for (const Output& output : outputs_) {
    if (!output.name.configured()) continue;
    report.up = report.up && output.line != nullptr;
    if (!output.problem.empty()) {
      report.problem += (report.problem.empty() ? "" : "; ") + output.problem;
    }
  }
  if (!report.up && report.problem.empty()) report.problem = "opening the lines";
  return report;
}

// With the lock held.
void Outputs::Set(Output& output, bool active) {
  output.active = active;
  if (!output.line) return;
  if (const Status set = output.line->Set(active); !set) {
    output.problem = set.error().message;
    output.line.reset();
    ++report_.errors;
  }
}

void Outputs::Show(const ApplianceStatus& status) {
  const bool degraded = status.state == CaptureState::kDegraded;
  std::lock_guard lock(mutex_);
  Set(outputs_[kReady],
      degraded || status.state == CaptureState::kArmed || status.state == CaptureState::kCapturing);
  Set(outputs_[kBusy], status.busy);
  Set(outputs_[kFault], degraded || status.state == CaptureState::kFault ||
                            status.state == CaptureState::kStorageFull ||
                            status.state == CaptureState::kWaitingForCamera);
}

Status Outputs::Pulse() {
  {
    std::lock_guard lock(mutex_);
    Output& strobe = outputs_[kStrobe];
    if (!strobe.name.configured()) return {};
    if (pulse_end_) {
      ++report_.lost;
      return Fail(ErrorKind::kTemporary, "strobe: the pulse before still lasts");
    }
    if (!strobe.line) {
      ++report_.lost;
      return Fail(ErrorKind::kUnavailable, "strobe: {} is not open", strobe.name.Text());
    }
    Set(strobe, true);
    if (!strobe.line) {
      ++report_.lost;
      return Fail(ErrorKind::kUnavailable, "strobe: {}", strobe.problem);
    }
    pulse_end_ = clock_.Now() + FromSeconds(options_.strobe_s);
    ++report_.messages;
  }
  pulse_begun_.notify_all();
  return {};
}

// With the lock held.
void Outputs::EndPulse() {
  pulse_end_.reset();
  Set(outputs_[kStrobe], false);
}

void Outputs::OpenMissing() {
  for (Output& output : outputs_) {
    {
      std::lock_guard lock(mutex_);
      if (!output.name.configured() || output.line) continue;
    }
    // Not under the lock: a pulse must not wait for a chip to be found.
    Result<std::unique_ptr<OutputLine>> line =
        lines_->RequestOutput({output.name, options_.active_low});
    std::lock_guard lock(mutex_);
    if (!line) {
      output.problem = line.error().message;
      ++report_.errors;
      continue;
    }
    output.line = std::move(*line);
    output.problem.clear();
    ++report_.opened;
    if (output.active) Set(output, true);
  }
}

Status Outputs::Run(std::stop_token stop, Stage& self) {
  HostTime next_open = clock_.Now();
  while (!stop.stop_requested()) {
    self.Progress();
    if (clock_.Now() >= next_open) {
      OpenMissing();
      next_open = clock_.Now() + FromSeconds(options_.reconnect_s);
    }
    std::unique_lock lock(mutex_);
    if (!pulse_end_) {
      pulse_begun_.wait_for(lock, stop, milliseconds(100),
                            [this] { return pulse_end_.has_value(); });
    }
    if (!pulse_end_) continue;
    const Nanoseconds left = *pulse_end_ - clock_.Now();
    if (left > Nanoseconds(0)) pulse_begun_.wait_for(lock, stop, left, [] { return false; });
    if (stop.stop_requested() || *pulse_end_ <= clock_.Now()) EndPulse();
  }
  std::lock_guard lock(mutex_);
  for (Output& output : outputs_) Set(output, false);
  return {};
}

}  // namespace omnihdr::gpio
