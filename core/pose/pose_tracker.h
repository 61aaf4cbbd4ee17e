#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/measurement.h"
#include "core/session/session.h"
#include "core/sphere/pose.h"

namespace omnihdr {

struct PoseOptions {
  int feature_image_width = 1536;        // features are found on the panorama reduced to this width
  int max_features = 3000;               // spread over equal-solid-angle buckets
  double ransac_threshold_rad = 3.5e-3;  // angle between a ray and its epipolar plane
  double min_inlier_fraction = 0.25;     // below: no link between two positions
  int min_inliers = 24;
  int window = 7;             // positions adjusted together; older ones stay as they are
  int link_span = 3;          // pairs i-1, i-2, ... i-link_span are matched
  double huber_rad = 1.0e-3;  // of the angular residual
  double min_baseline_ratio =
      0.002;  // baseline over median distance below which a pair is a pure rotation
  Status Validate() const;
};

// What the tracker says of one position.
struct PoseEstimate {
  PositionId position{};
  Pose world_from_camera;
  int chain = 0;             // positions of different chains have no common frame
  std::string chain_reason;  // set where a new chain begins (not for the first): why
  bool metric = false;       // translation in metres
  bool has_baseline =
      true;  // false: pure rotation against its neighbours, translation unknown (kept)
  double median_inverse_distance = 0.0;  // of the points seen here; 0 when none
  double max_inverse_distance = 0.0;     // 99th percentile: how near the scene comes
};

// Poses of a sequence of panoramas taken at different exposures, position by position. Features are
// found on a log-radiance picture (saturated and masked pixels excluded), so that the same surface
// looks the same at any exposure; linked to the last few positions by essential matrices on unit
// rays (LO-RANSAC), and adjusted in a sliding window (angular residuals, Huber). Deterministic: the
// same measurements give the same poses to the last bit, on any number of cores. Not thread-safe.
class PoseTracker {
 public:
  static Result<std::unique_ptr<PoseTracker>> Create(const PoseOptions& options);
  virtual ~PoseTracker() = default;

  // Adds the next position and readjusts the window. `odometer_m` gives metric scale; `prior` is a
  // pose known from elsewhere (used instead of estimating). Never fails on image content: a
  // position that cannot be linked starts a new chain.
  virtual void Push(PositionId position, const Measurement& measurement,
                    std::optional<double> odometer_m, const std::optional<Pose>& prior) = 0;
  // Estimates of the positions in the window, oldest first, as of the last Push.
  virtual std::vector<PoseEstimate> Window() const = 0;

  // The state after the last Push as JSON text (numbers round-trip exactly); a fresh tracker given
  // it, then pushed the measurements of the window's positions with `Rewarm` in order, continues as
  // if it had never stopped: later results are identical to the last bit.
  virtual std::string SaveState() const = 0;
  virtual Status RestoreState(const std::string& json) = 0;
  // After RestoreState: rebuilds what is not in the JSON (features) for one window position. One
  // that is left out (its pixels are gone) counts as a picture that shows nothing.
  virtual void Rewarm(PositionId position, const Measurement& measurement) = 0;
};

}  // namespace omnihdr
