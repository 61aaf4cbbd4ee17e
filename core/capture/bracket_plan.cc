#include "core/capture/bracket_plan.h"

#include <cmath>
#include <cstddef>
#include <cstdint>

namespace omnihdr {
namespace {

Result<std::vector<ExposureTime>> Steps(const BracketOptions& options) {
  if (!options.exposures.empty()) return options.exposures;
  if (options.order == BracketOrder::kList) {
    return Fail(ErrorKind::kConfig, "bracket: the list of exposures is empty");
  }
  if (options.count < 1 || options.count > BracketPlan::kMaxSteps) {
    return Fail(ErrorKind::kConfig, "bracket: count {}: expected 1 to {}", options.count,
                BracketPlan::kMaxSteps);
  }
  if (!std::isfinite(options.step.value)) {
    return Fail(ErrorKind::kConfig, "bracket: step {} stops: expected a finite number",
                options.step.value);
  }
  std::vector<ExposureTime> steps;
  for (int i = 0; i < options.count; ++i) {
    steps.push_back(options.start + Stops{options.step.value * i});
  }
  return steps;
}

}  // namespace

Result<BracketPlan> BracketPlan::Make(const BracketOptions& options, const ExposureLimits& limits) {
  OMNIHDR_ASSIGN(std::vector<ExposureTime> steps, Steps(options));
  if (steps.size() > static_cast<std::size_t>(kMaxSteps)) {
    return Fail(ErrorKind::kConfig, "bracket: {} exposures: expected at most {}", steps.size(),
                kMaxSteps);
  }
  if (!std::isfinite(options.gain.value)) {
    return Fail(ErrorKind::kConfig, "bracket: gain {} dB: expected a finite number",
                options.gain.value);
  }
  if (options.frames_per_position < 1 || options.frames_per_position > kMaxFramesPerPosition) {
    return Fail(ErrorKind::kConfig, "bracket: frames per position {}: expected 1 to {}",
                options.frames_per_position, kMaxFramesPerPosition);
  }
  // One part in a million: a limit written in decimal and a step computed in binary may differ
  // there.
  constexpr double kSlack = 1e-6;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    if (!steps[i].IsValid()) {
      return Fail(ErrorKind::kConfig,
                  "bracket: exposure {} is {} s: expected a positive finite time", i,
                  steps[i].seconds());
    }
    const double asked_s = steps[i].seconds();
    if (limits.quantum_s > 0.0) {
      steps[i] = ExposureTime::Seconds(std::round(asked_s / limits.quantum_s) * limits.quantum_s);
    }
    if (steps[i].seconds() < limits.shortest.seconds() * (1.0 - kSlack) || !steps[i].IsValid()) {
      return Fail(ErrorKind::kConfig,
                  "bracket: exposure {} is {:.9g} s: the camera's shortest is {:.9g} s", i, asked_s,
                  limits.shortest.seconds());
    }
    if (steps[i].seconds() > limits.longest.seconds() * (1.0 + kSlack)) {
      return Fail(ErrorKind::kConfig,
                  "bracket: exposure {} is {:.9g} s: the camera's longest is {:.9g} s", i, asked_s,
                  limits.longest.seconds());
    }
  }
  const bool neighbours_only = options.order == BracketOrder::kList;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    for (std::size_t j = i + 1; j < steps.size(); ++j) {
      const bool neighbours = j == i + 1 || (i == 0 && j + 1 == steps.size());
      if ((neighbours || !neighbours_only) && steps[i] == steps[j]) {
        return Fail(
            ErrorKind::kConfig,
            "bracket: exposures {} and {} are both {:.9g} s (the camera's quantum is {:.9g} s): "
            "expected different ones",
            i, j, steps[i].seconds(), limits.quantum_s);
      }
    }
  }
  BracketPlan plan;
  plan.order_ = options.order;
  plan.exposures_ = std::move(steps);
  plan.gain_ = options.gain;
  plan.frames_per_position_ = options.frames_per_position;
  return plan;
}

int BracketPlan::StepForTrigger(TriggerId trigger) const {
  const auto count = static_cast<std::uint64_t>(exposures_.size());
  if (order_ == BracketOrder::kTriangle && count > 1) {
    const std::uint64_t period = 2 * (count - 1);
    const std::uint64_t phase = Value(trigger) % period;
    return static_cast<int>(phase < count ? phase : period - phase);
  }
  return static_cast<int>(Value(trigger) % count);
}

Exposure BracketPlan::ForTrigger(TriggerId trigger) const {
  return Exposure{exposures_[static_cast<std::size_t>(StepForTrigger(trigger))], gain_};
}

PositionId BracketPlan::PositionForTrigger(TriggerId trigger) const {
  return PositionId{
      static_cast<std::int64_t>(Value(trigger) / static_cast<std::uint64_t>(frames_per_position_))};
}

BracketDescription BracketPlan::Description() const {
  return BracketDescription{order_, exposures_, frames_per_position_};
}

}  // namespace omnihdr
