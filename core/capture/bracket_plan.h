#pragma once

#include <vector>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/session/session.h"

namespace omnihdr {

// What a camera can be asked for.
struct ExposureLimits {
  ExposureTime shortest = ExposureTime::Seconds(1e-9);
  ExposureTime longest = ExposureTime::Seconds(3600.0);
  // Times are multiples of this, in seconds; 0 = continuous.
  double quantum_s = 0.0;
};

// Which exposures to take and in which order.
struct BracketOptions {
  BracketOrder order = BracketOrder::kSawtooth;
  // The steps of the bracket. When `exposures` is empty they are start, start + step, ... (count of
  // them); order kList needs the explicit list.
  std::vector<ExposureTime> exposures = {};
  ExposureTime start = ExposureTime::Seconds(0.001);
  Stops step{2.0};
  int count = 3;
  GainDb gain = {};
  // Triggers that belong to one position: 1 while driving, the whole bracket when standing still.
  int frames_per_position = 1;
};

// Which exposure and which position a trigger gets. Law: both follow from the trigger's number
// alone. A lost frame therefore does not shift the bracket - the next trigger takes the next step -
// and a restarted daemon goes on in the phase an undisturbed one would have had.
//   sawtooth  0 1 2 0 1 2 ...
//   triangle  0 1 2 1 0 1 2 ... (the ends are taken once)
//   list      in the order given, again and again
// Immutable; any thread.
class BracketPlan {
 public:
  static constexpr int kMaxSteps = 64;
  static constexpr int kMaxFramesPerPosition = 1000;

  // Exposures are rounded to the camera's quantum. Refused (kConfig, naming the step and the
  // limit): no step or more than kMaxSteps, a time that is not positive and finite or not within
  // the limits, two equal steps (list: two equal neighbours) after rounding, frames_per_position
  // out of range.
  static Result<BracketPlan> Make(const BracketOptions& options, const ExposureLimits& limits);

  Exposure ForTrigger(TriggerId trigger) const;
  // Index into exposures().
  int StepForTrigger(TriggerId trigger) const;
  // Trigger number divided by frames_per_position.
  PositionId PositionForTrigger(TriggerId trigger) const;

  const std::vector<ExposureTime>& exposures() const { return exposures_; }
  BracketOrder order() const { return order_; }
  int frames_per_position() const { return frames_per_position_; }
  // For session.json.
  BracketDescription Description() const;

 private:
  BracketPlan() = default;
  BracketOrder order_ = BracketOrder::kSawtooth;
  std::vector<ExposureTime> exposures_;
  GainDb gain_;
  int frames_per_position_ = 1;
};

}  // namespace omnihdr
