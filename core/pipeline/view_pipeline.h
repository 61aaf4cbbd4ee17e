#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/measurement.h"
#include "core/pipeline/options.h"
#include "core/pose/pose_tracker.h"
#include "core/session/session.h"
#include "core/stereo/confidence.h"
#include "core/stereo/sgm.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"
#include "core/stereo/view_merge.h"

namespace omnihdr {

// One position with usable pixels, ready for fusion.
struct PositionInput {
  PositionId position{};
  Measurement measurement;
  std::vector<FrameId> frames;  // merged into the measurement
  FrameId reference{};          // of those, the one that stands for the position
  std::optional<double> odometer_m;
  std::optional<Pose> prior;
  std::optional<double> heading_deg;  // see PositionClues
  std::optional<GnssClue> gnss;
  PanoramaOptics optics;
};

// A finished view, not yet on disk.
struct FinishedView {
  PoseEstimate pose;
  std::vector<FrameId> frames;  // that may have contributed pixels, ascending
  FrameId reference{};
  MergedView merged;
  bool made = false;  // false: only the bookkeeping was done, on request (see Push)
  // Of the most reduced disparity map that took part (core/pipeline/quality.h); 0 = full.
  int quality_level = 0;
  Eigen::Quaterniond camera_from_output = Eigen::Quaterniond::Identity();
  std::vector<std::string> warnings;
  std::string resume_json;  // see SaveState
  // What the place is recognised by later, when it is remembered; "" else. Restore needs it again.
  std::string keyframe;
  double stereo_s = 0.0;
  double merge_s = 0.0;
};

// The incremental fusion of a sequence of positions in bounded memory: a window of the last
// positions and their maps. View i is finished when position i+2 is pushed, or by Finish.
// Deterministic: the same inputs give the same views to the last bit, on any number of cores, and a
// pipeline restored from resume_json and pushed the following positions goes on as if it had never
// stopped. A view whose quality_level is 0 has the same bytes whatever the levels of the views
// around it. Not thread-safe.
class ViewPipeline {
 public:
  static Result<std::unique_ptr<ViewPipeline>> Create(const PipelineOptions& options);

  // How many positions before the first view to be made a restored pipeline has to be pushed first,
  // for everything that view depends on to be there again.
  static constexpr int kWarmUpPositions = 8;
  // Positions whose measurements Restore needs again (the pose tracker's window), at most.
  std::vector<PositionId> RestorePositions() const;

  // The remembered places, whose bytes (FinishedView::keyframe) Restore needs again.
  std::vector<PositionId> RestoreKeyframes() const { return tracker_->Keyframes(); }

  // `want` tells whether the view that this push finishes is wanted (already on disk: bookkeeping
  // only), `quality_level` how much work it may cost. Returns the finished view, if this push
  // finished one.
  using WantView = std::function<bool(PositionId)>;
  std::optional<FinishedView> Push(PositionInput input, const WantView& want,
                                   int quality_level = 0);
  // The views still waiting, in order, in full quality. Afterwards the pipeline is empty.
  std::vector<FinishedView> Finish(const WantView& want);

  // Continues after the step that gave a view's resume_json.
  Status Restore(const std::string& resume_json);
  void Rewarm(PositionId position, const Measurement& measurement);
  Status RestoreKeyframe(const SavedKeyframe& keyframe) {
    return tracker_->RestoreKeyframe(keyframe);
  }

  double last_pose_s() const { return last_pose_s_; }

 private:
  struct Slot {
    PositionInput input;
    PoseEstimate pose;
    StereoView stereo_view;  // empty until needed, of one width at a time
    StereoView coarse_view;  // the same at half the size; empty until needed
    // world_from_camera it is made with at any width; none until it is first needed.
    std::optional<Eigen::Quaterniond> stereo_view_rotation;
    std::shared_ptr<DisparityMap> ahead;  // matched before its last neighbour was there
    int ahead_level = 0;                  // quality level of that
    std::shared_ptr<DisparityMap> raw;    // matched with every neighbour it will ever have
    int raw_level = 0;                    // highest quality level of what went into that
    std::shared_ptr<DisparityMap> fused;
  };
  explicit ViewPipeline(const PipelineOptions& options) : options_(options) {}
  void UpdatePoses();
  void ExtendScale(const Measurement& measurement);
  // Decides which rotation the slot's stereo view is made with from now on.
  void FixRotation(std::size_t index);
  // `width` of the map's grid, as options.stereo_width.
  const StereoView& StereoViewOf(std::size_t index, int width);
  const StereoView& CoarseViewOf(std::size_t index, int width);
  FinishedView FinishSlot(std::size_t index, const WantView& want, int quality_level);
  // Slots within `reach` of `index`, on its chain and linked by pictures, at another place; nearest
  // first.
  std::vector<std::size_t> Neighbours(std::size_t index, int reach) const;
  // Those of Neighbours that a slot can be matched with: with a baseline worth it.
  std::vector<std::size_t> MatchPartners(std::size_t index, int reach) const;
  // Null when the slot has no neighbour with a baseline. `options`: those of the quality level.
  // `ahead`: before its own later neighbours are there; with search `ranges` at half the size.
  std::shared_ptr<DisparityMap> MatchSlot(std::size_t index, const PipelineOptions& options,
                                          bool ahead);
  // What a match at half the size with the neighbours given finds.
  std::shared_ptr<DisparityMap> CoarseMap(std::size_t index,
                                          const std::vector<std::size_t>& neighbours,
                                          const PipelineOptions& options,
                                          const SweepOptions& sweep);
  // The labels in question at the slot: around what was found at half its size, before its last
  // neighbour was there if it was matched then.
  std::vector<LabelRange> SearchRanges(std::size_t index,
                                       const std::vector<std::size_t>& neighbours,
                                       const PipelineOptions& options, const SweepOptions& sweep);
  std::vector<SweepNeighbour> SweepNeighbours(std::size_t index,
                                              const std::vector<std::size_t>& neighbours, int width,
                                              bool coarse);
  // The slot's map with its neighbours' help, by the methods chosen: fused, filtered, filled.
  // Raises `level` to that of the neighbours' maps used.
  DisparityMap RefineMap(std::size_t index, const PipelineOptions& options, int* level);
  double SearchLimit(std::size_t index, const std::vector<std::size_t>& neighbours) const;
  // Of a slot's disparity.
  DisparityPrecision PrecisionOf(std::size_t index) const;
  std::string SaveState(PositionId after) const;

  PipelineOptions options_;
  std::unique_ptr<PoseTracker> tracker_;
  std::deque<Slot> slots_;
  std::size_t next_unfinished_ = 0;  // index into slots_
  LogScale scale_;
  float lowest_floor_ = 0.0F;  // over all positions so far; 0 = none yet
  float brightest_ = 0.0F;
  double last_pose_s_ = 0.0;
};

}  // namespace omnihdr
