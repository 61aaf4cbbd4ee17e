#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/measurement.h"
#include "core/pose/gnss_scale.h"
#include "core/session/pose_notes.h"
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
  // Old places remembered to be recognised, at most; 0 = none. A place is at most
  // kMaxKeyframePoints points and takes at most 140 kB, 64 of them 9 MB.
  int keyframes = 64;
  double heading_sigma_deg = 0.0;  // of a compass heading, degrees; 0 = headings are ignored
  Status Validate() const;
};

// What the tracker says of one position.
struct PoseEstimate {
  PositionId position{};
  Pose world_from_camera;
  int chain = 0;             // positions of different chains have no common frame
  std::string chain_reason;  // set where a new chain begins (not for the first): why
  bool metric = false;       // translation in metres
  ScaleSource scale_source = ScaleSource::kNone;
  // What satellite fixes along the chain say of its unit, as of when the pose became final; none
  // without fixes, or while they say too little.
  std::optional<GnssScale> gnss_scale;
  // A line for people where the fixes begin to contradict the unit's other source; empty else.
  std::string scale_note;
  bool has_baseline =
      true;  // false: pure rotation against its neighbours, translation unknown (kept)
  double median_inverse_distance = 0.0;  // of the points seen here; 0 when none
  double max_inverse_distance = 0.0;     // 99th percentile: how near the scene comes
  // How well the pose is known relative to the oldest poses of the window it was adjusted in, which
  // are held (the chain's first position, or two or three older ones), from the adjustment's normal
  // equations. None for what is known or held by definition: a given pose, a chain's first.
  std::optional<PoseSigma> sigma;
  // Why the pose was not found in pictures but follows from heading and odometer; empty when it was
  // found in pictures.
  std::string dead_reckoned;
  // Positions of a chain that pictures link to each other; what is between two groups is dead
  // reckoning.
  int group = 0;
  std::optional<Relocalisation> relocalised;
  std::optional<LoopClosure> loop;
  int revision = 0;  // grows when the pose is expressed in another frame than before
};

// What is known of a position beside its picture.
struct PositionClues {
  std::optional<double> odometer_m;   // gives metric scale
  std::optional<Pose> prior;          // known from elsewhere: used instead of estimating
  std::optional<double> heading_deg;  // bearing of the camera's forward axis, clockwise
  // Gives metric scale where the odometer does not, once the fixes along the chain tell it to 2 %.
  std::optional<GnssClue> gnss;
};

// A remembered place as bytes, to be kept for the time after a restart.
struct SavedKeyframe {
  PositionId position{};
  std::string bytes;
};

// Poses of a sequence of panoramas taken at different exposures, position by position. Features are
// found on a log-radiance picture (saturated and masked pixels excluded), so that the same surface
// looks the same at any exposure; linked to the last few positions by essential matrices on unit
// rays (LO-RANSAC), and adjusted in a sliding window (angular residuals, Huber). Places are
// remembered, evenly over the session, as points whose distance is known: a position that cannot be
// linked, or one of a later chain, that sees an old place again is put into that place's chain, and
// one that comes back to a place of its own chain tells how far it had drifted and is put right.
// Lengths are metres by the odometer, or else by satellite fixes: these are compared with the way
// of the whole chain, by some dozens of positions spread over it, and when they tell its unit the
// chain ends and goes on as a new one in metres. Where both are there, the odometer counts and a
// contradiction is told.
// Poses that have left the window never change. Time and memory for a position do not depend on how
// many came before it. Deterministic: the same measurements give the same poses to the last bit, on
// any number of cores. Not thread-safe.
class PoseTracker {
 public:
  static Result<std::unique_ptr<PoseTracker>> Create(const PoseOptions& options);
  virtual ~PoseTracker() = default;

  // A pose may still change while so many positions follow (other than by relocalisation of later
  // ones); that of the position before them is what a view is made with and what is remembered.
  static constexpr int kFinalAfter = 2;

  // Adds the next position and readjusts the window. Never fails on image content: a position that
  // cannot be linked is recognised, dead-reckoned (with heading and odometer), or starts a new
  // chain.
  virtual void Push(PositionId position, const Measurement& measurement,
                    const PositionClues& clues) = 0;
  void Push(PositionId position, const Measurement& measurement, std::optional<double> odometer_m,
            const std::optional<Pose>& prior) {
    Push(position, measurement, PositionClues{odometer_m, prior, std::nullopt, std::nullopt});
  }
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

  // The place that the last Push began to remember (kFinalAfter positions back), if any.
  virtual const std::optional<SavedKeyframe>& NewKeyframe() const = 0;
  // After RestoreState: the places that have to be given back with RestoreKeyframe. kData error
  // when the bytes are not those that were saved.
  virtual std::vector<PositionId> Keyframes() const = 0;
  virtual Status RestoreKeyframe(const SavedKeyframe& keyframe) = 0;
};

}  // namespace omnihdr
