#pragma once

#include <cstdint>
#include <string>
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
  // Angle that a pixel spans, radians; 0 = not known.
  double pixel_rad = 0.0;
};

// Angle that a pixel spans in the middle of a camera's picture: of a panorama's columns, of a
// perspective picture, or of the finest sensor of a rig, whose rig.toml is among `files`. 0 when it
// cannot be told.
double PixelAngle(const CameraDescription& camera, const std::vector<SessionFile>& files);

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
  // Frequency of the mains that lamps flicker by, hertz: exposures of at least half a period are
  // rounded to multiples of it, so that every row of every frame sees the same light; shorter ones
  // cannot be. 0 = leave them.
  int flicker_hz = 0;
  // Motion blur that is accepted, in pixels, of what is `near_m` away to the side while the vehicle
  // drives `speed_m_s`. 0 = any.
  double max_blur_px = 0.0;
  double speed_m_s = 0.0;
  double near_m = 5.0;
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

  // Exposures are rounded to half periods of the mains and to the camera's quantum. Refused
  // (kConfig, naming the step and the limit): no step or more than kMaxSteps, a time that is not
  // positive and finite or not within the limits, two equal steps (list: two equal neighbours)
  // after rounding, more blur than is accepted (where the angle of a pixel is known),
  // frames_per_position out of range.
  static Result<BracketPlan> Make(const BracketOptions& options, const ExposureLimits& limits);

  Exposure ForTrigger(TriggerId trigger) const;
  // Index into exposures().
  int StepForTrigger(TriggerId trigger) const;
  // Trigger number divided by frames_per_position.
  PositionId PositionForTrigger(TriggerId trigger) const;

  // Triggers after which the exposures begin anew, and the exposures until then.
  std::uint64_t Period() const;
  std::vector<Exposure> Turn() const;

  const std::vector<ExposureTime>& exposures() const { return exposures_; }
  BracketOrder order() const { return order_; }
  int frames_per_position() const { return frames_per_position_; }
  // What is not as it was asked for, one sentence a step: rounded by more than a thousandth.
  const std::vector<std::string>& changes() const { return changes_; }
  // For session.json.
  BracketDescription Description() const;

 private:
  BracketPlan() = default;
  BracketOrder order_ = BracketOrder::kSawtooth;
  std::vector<ExposureTime> exposures_;
  std::vector<std::string> changes_;
  GainDb gain_;
  int frames_per_position_ = 1;
};

}  // namespace omnihdr
