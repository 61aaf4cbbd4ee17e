#include "core/capture/bracket_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <utility>

#include "core/session/rig_file.h"

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

// One part in a million: a limit written in decimal and a step computed in binary may differ there.
constexpr double kSlack = 1e-6;
// A change of less than this is not told.
constexpr double kTold = 1e-3;

// Rounded to a multiple of half a period of the mains, the next lower one where the camera cannot
// expose longer.
double FlickerSafe(double seconds, int flicker_hz, double longest_s) {
  const double half_s = 0.5 / flicker_hz;
  if (seconds < half_s * (1.0 - kSlack)) return seconds;
  double multiple = std::max(1.0, std::round(seconds / half_s));
  if (multiple * half_s > longest_s * (1.0 + kSlack)) {
    multiple = std::floor(longest_s / half_s * (1.0 + kSlack));
  }
  return multiple >= 1.0 ? multiple * half_s : seconds;
}

Status CheckBlur(const BracketOptions& options, const std::vector<ExposureTime>& steps,
                 double pixel_rad) {
  if (options.max_blur_px <= 0.0 || pixel_rad <= 0.0) return {};
  const double px_per_s = options.speed_m_s / options.near_m / pixel_rad;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const double blur = px_per_s * steps[i].seconds();
    if (blur <= options.max_blur_px * (1.0 + kSlack)) continue;
    return Fail(ErrorKind::kConfig,
                "bracket: exposure {} is {:.6g} s: what is {:g} m away is blurred over {:.3g} "
                "pixels at {:g} m/s: expected at most {:.3g} s for max_blur_px = {:g}",
                i, steps[i].seconds(), options.near_m, blur, options.speed_m_s,
                options.max_blur_px / px_per_s, options.max_blur_px);
  }
  return {};
}

}  // namespace

double PixelAngle(const CameraDescription& camera, const std::vector<SessionFile>& files) {
  switch (camera.layout) {
    case Layout::kPanorama:
      return camera.width > 0 ? 2.0 * std::numbers::pi / camera.width : 0.0;
    case Layout::kPerspective:
      return camera.intrinsics.fx > 0.0 ? 1.0 / camera.intrinsics.fx : 0.0;
    case Layout::kRig:
      break;
  }
  for (const SessionFile& file : files) {
    if (file.name != "rig.toml") continue;
    const Result<Rig> rig = ParseRig(file.content, file.name);
    if (!rig) return 0.0;
    double focal = 0.0;
    for (const RigSensor& sensor : rig->sensors) {
      focal = std::max(focal, sensor.lens.focal().maxCoeff());
    }
    return focal > 0.0 ? 1.0 / focal : 0.0;
  }
  return 0.0;
}

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
  if (options.flicker_hz != 0 && options.flicker_hz != 50 && options.flicker_hz != 60) {
    return Fail(ErrorKind::kConfig, "bracket: flicker_hz {}: expected 0, 50 or 60",
                options.flicker_hz);
  }
  if (options.max_blur_px > 0.0 && !(options.speed_m_s > 0.0 && options.near_m > 0.0)) {
    return Fail(ErrorKind::kConfig,
                "bracket: max_blur_px {:g} with speed_m_s {:g} and near_m {:g}: expected a speed "
                "and a distance above 0",
                options.max_blur_px, options.speed_m_s, options.near_m);
  }
  std::vector<std::string> changes;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    if (!steps[i].IsValid()) {
      return Fail(ErrorKind::kConfig,
                  "bracket: exposure {} is {} s: expected a positive finite time", i,
                  steps[i].seconds());
    }
    const double asked_s = steps[i].seconds();
    if (options.flicker_hz > 0) {
      steps[i] =
          ExposureTime::Seconds(FlickerSafe(asked_s, options.flicker_hz, limits.longest.seconds()));
    }
    const double safe_s = steps[i].seconds();
    if (limits.quantum_s > 0.0) {
      steps[i] = ExposureTime::Seconds(std::round(safe_s / limits.quantum_s) * limits.quantum_s);
    }
    if (std::abs(steps[i].seconds() - asked_s) > kTold * asked_s) {
      changes.push_back(fmt::format(
          "exposure {}: {:.6g} s instead of {:.6g} s{}{}", i, steps[i].seconds(), asked_s,
          safe_s != asked_s
              ? fmt::format(", a multiple of half a period of {} Hz", options.flicker_hz)
              : "",
          steps[i].seconds() != safe_s
              ? fmt::format(", a multiple of the camera's {:.6g} s", limits.quantum_s)
              : ""));
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
            "bracket: exposures {} and {} are both {:.9g} s (the camera's quantum is {:.9g} s{}): "
            "expected different ones",
            i, j, steps[i].seconds(), limits.quantum_s,
            options.flicker_hz > 0 ? fmt::format(", half a period of {} Hz {:.6g} s",
                                                 options.flicker_hz, 0.5 / options.flicker_hz)
                                   : "");
      }
    }
  }
  OMNIHDR_TRY(CheckBlur(options, steps, limits.pixel_rad));
  BracketPlan plan;
  plan.changes_ = std::move(changes);
  plan.order_ = options.order;
  plan.exposures_ = std::move(steps);
  plan.gain_ = options.gain;
  plan.frames_per_position_ = options.frames_per_position;
  return plan;
}

std::uint64_t BracketPlan::Period() const {
  const auto count = static_cast<std::uint64_t>(exposures_.size());
  return order_ == BracketOrder::kTriangle && count > 1 ? 2 * (count - 1) : count;
}

int BracketPlan::StepForTrigger(TriggerId trigger) const {
  const auto count = static_cast<std::uint64_t>(exposures_.size());
  const std::uint64_t phase = Value(trigger) % Period();
  return static_cast<int>(phase < count ? phase : Period() - phase);
}

std::vector<Exposure> BracketPlan::Turn() const {
  std::vector<Exposure> turn;
  for (std::uint64_t i = 0; i < Period(); ++i) turn.push_back(ForTrigger(TriggerId{i}));
  return turn;
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
