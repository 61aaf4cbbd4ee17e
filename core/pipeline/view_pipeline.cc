#include "core/pipeline/view_pipeline.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>

#include "core/base/profile.h"
#include "core/pipeline/quality.h"
#include "core/stereo/coarse_match.h"
#include "core/stereo/confidence.h"
#include "core/stereo/fuse.h"
#include "core/stereo/pairwise_costs.h"
#include "core/stereo/stability.h"
#include "core/stereo/superpixel_fill.h"
#include "core/stereo/sweep.h"
#include "core/stereo/wavelet_filter.h"

namespace omnihdr {
namespace {

// A view cannot wait for more neighbours than this after its own position.
constexpr std::size_t kLookahead = 2;
static_assert(kLookahead == PoseTracker::kFinalAfter);
// A prepared stereo view is made anew when its pose has been corrected by more than this.
constexpr double kStaleRotation = 5e-4;
constexpr double kLeastSkyShare = 0.5;  // of a superpixel that is taken for sky

class Stopwatch {
 public:
  double Seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

// Old places seen again, for people; what changes nothing is only in view.json.
std::vector<std::string> NotesOnOldPlaces(const PoseEstimate& pose) {
  std::vector<std::string> notes;
  if (pose.relocalised) {
    notes.push_back(fmt::format(
        "position {} was recognised from position {} ({} points): on with chain {}, after chain {}",
        Value(pose.relocalised->place), Value(pose.relocalised->seen_from),
        pose.relocalised->matches, pose.chain, pose.relocalised->from_chain));
  }
  if (pose.loop && pose.loop->corrected) {
    notes.push_back(fmt::format(
        "back at position {}, recognised from position {} ({} points): drift of {:.2f} degrees and "
        "{:.3g} {} put right from here on",
        Value(pose.loop->place), Value(pose.loop->seen_from), pose.loop->matches,
        pose.loop->drift_rotation_deg, pose.loop->drift_translation, pose.metric ? "m" : "units"));
  }
  return notes;
}

Eigen::Vector3d OffsetInWorld(const Pose& from, const Pose& to) {
  return to.translation - from.translation;
}

// A map on a grid of another width, each pixel the nearest one's value: blends of near and far
// would be surfaces that are not there.
DisparityMap OnGrid(const DisparityMap& map, int width) {
  const int from_width = map.disparity.width();
  const int from_height = map.disparity.height();
  const int height = width / 2;
  DisparityMap out;
  out.disparity = Image<float>(width, height);
  out.confidence = Image<float>(width, height);
  for (int y = 0; y < height; ++y) {
    const int from_y = std::min((2 * y + 1) * from_height / (2 * height), from_height - 1);
    for (int x = 0; x < width; ++x) {
      const int from_x = std::min((2 * x + 1) * from_width / (2 * width), from_width - 1);
      out.disparity.at(x, y) = map.disparity.at(from_x, from_y);
      out.confidence.at(x, y) = map.confidence.at(from_x, from_y);
    }
  }
  return out;
}

}  // namespace

Result<std::unique_ptr<ViewPipeline>> ViewPipeline::Create(const PipelineOptions& options) {
  OMNIHDR_TRY(options.Validate());
  std::unique_ptr<ViewPipeline> pipeline(new ViewPipeline(options));
  PoseOptions pose;
  pose.min_baseline_ratio = options.min_baseline_ratio;
  pose.keyframes = options.keyframes;
  pose.heading_sigma_deg = options.heading_sigma_deg;
  OMNIHDR_ASSIGN(pipeline->tracker_, PoseTracker::Create(pose));
  return pipeline;
}

std::vector<PositionId> ViewPipeline::RestorePositions() const {
  std::vector<PositionId> positions;
  for (const PoseEstimate& pose : tracker_->Window()) positions.push_back(pose.position);
  return positions;
}

void ViewPipeline::ExtendScale(const Measurement& m) {
  const float brightest = *std::max_element(m.saturation.begin(), m.saturation.end());
  lowest_floor_ = lowest_floor_ == 0.0F ? m.noise_floor : std::min(lowest_floor_, m.noise_floor);
  brightest_ = std::max(brightest_, brightest);
  const LogScale scale = LogScale::For(lowest_floor_, brightest_);
  if (scale == scale_) return;
  scale_ = scale;
  for (Slot& slot : slots_) {
    slot.stereo_view = slot.coarse_view = StereoView{};
    slot.stereo_view_rotation.reset();
  }
}

void ViewPipeline::UpdatePoses() {
  for (const PoseEstimate& pose : tracker_->Window()) {
    for (Slot& slot : slots_) {
      if (slot.input.position != pose.position) continue;
      // A map is of the frame and the unit it was made in.
      if (slot.pose.revision != pose.revision) slot.raw = slot.ahead = nullptr;
      slot.pose = pose;
    }
  }
}

void ViewPipeline::FixRotation(std::size_t index) {
  Slot& slot = slots_[index];
  const Eigen::Quaterniond& rotation = slot.pose.world_from_camera.rotation;
  if (slot.stereo_view_rotation &&
      slot.stereo_view_rotation->angularDistance(rotation) <= kStaleRotation) {
    return;
  }
  slot.stereo_view_rotation = rotation;
  slot.stereo_view = slot.coarse_view = StereoView{};
}

const StereoView& ViewPipeline::StereoViewOf(std::size_t index, int width) {
  FixRotation(index);
  Slot& slot = slots_[index];
  if (slot.stereo_view.width != 2 * width) {
    const ProfileScope profile("stereo views");
    slot.stereo_view =
        MakeStereoView(slot.input.measurement, *slot.stereo_view_rotation, 2 * width, scale_);
    slot.coarse_view = StereoView{};
  }
  return slot.stereo_view;
}

const StereoView& ViewPipeline::CoarseViewOf(std::size_t index, int width) {
  const StereoView& view = StereoViewOf(index, width);
  Slot& slot = slots_[index];
  if (slot.coarse_view.width == 0) slot.coarse_view = HalveStereoView(view);
  return slot.coarse_view;
}

std::vector<std::size_t> ViewPipeline::Neighbours(std::size_t index, int reach) const {
  std::vector<std::size_t> neighbours;
  const Slot& slot = slots_[index];
  for (int distance = 1; distance <= reach; ++distance) {
    for (const int sign : {-1, 1}) {
      const auto k = static_cast<std::ptrdiff_t>(index) + sign * distance;
      if (k < 0 || k >= static_cast<std::ptrdiff_t>(slots_.size())) continue;
      const Slot& other = slots_[static_cast<std::size_t>(k)];
      if (other.pose.chain == slot.pose.chain && other.pose.group == slot.pose.group) {
        neighbours.push_back(static_cast<std::size_t>(k));
      }
    }
  }
  return neighbours;
}

double ViewPipeline::SearchLimit(std::size_t index,
                                 const std::vector<std::size_t>& neighbours) const {
  const Pose& pose = slots_[index].pose.world_from_camera;
  double shortest = 0.0;
  double nearest = slots_[index].pose.max_inverse_distance;
  for (const std::size_t n : neighbours) {
    const double baseline = OffsetInWorld(pose, slots_[n].pose.world_from_camera).norm();
    shortest = shortest == 0.0 ? baseline : std::min(shortest, baseline);
    nearest = std::max(nearest, slots_[n].pose.max_inverse_distance);
  }
  const double limit = std::sin(Radians::FromDegrees(options_.max_parallax_deg).value()) / shortest;
  // Features miss the nearest surfaces (textureless, seen at a slant): search somewhat nearer.
  return nearest > 0.0 ? std::min(limit, 1.6 * nearest) : limit;
}

std::vector<std::size_t> ViewPipeline::MatchPartners(std::size_t index, int reach) const {
  const Pose& pose = slots_[index].pose.world_from_camera;
  std::vector<std::size_t> indices = Neighbours(index, reach);
  double largest = 0.0;
  for (const std::size_t n : indices) {
    largest = std::max(largest, OffsetInWorld(pose, slots_[n].pose.world_from_camera).norm());
  }
  std::erase_if(indices, [&](std::size_t n) {
    const double baseline = OffsetInWorld(pose, slots_[n].pose.world_from_camera).norm();
    return baseline == 0.0 || baseline < 0.05 * largest;
  });
  return indices;
}

std::vector<SweepNeighbour> ViewPipeline::SweepNeighbours(
    std::size_t index, const std::vector<std::size_t>& neighbours, int width, bool coarse) {
  std::vector<SweepNeighbour> swept;
  for (const std::size_t n : neighbours) {
    swept.push_back(
        {coarse ? &CoarseViewOf(n, width) : &StereoViewOf(n, width),
         OffsetInWorld(slots_[index].pose.world_from_camera, slots_[n].pose.world_from_camera)
             .cast<float>()});
  }
  return swept;
}

std::vector<LabelRange> ViewPipeline::SearchRanges(std::size_t index,
                                                   const std::vector<std::size_t>& neighbours,
                                                   const PipelineOptions& options,
                                                   const SweepOptions& sweep) {
  const int width = options.stereo_width;
  std::shared_ptr<DisparityMap> guide = slots_[index].ahead;
  if (guide == nullptr) guide = CoarseMap(index, neighbours, options, sweep);
  return RangesAround(*guide, width, width / 2, sweep.labels, sweep.max_disparity, RangeOptions{});
}

std::shared_ptr<DisparityMap> ViewPipeline::CoarseMap(std::size_t index,
                                                      const std::vector<std::size_t>& neighbours,
                                                      const PipelineOptions& options,
                                                      const SweepOptions& sweep) {
  const ProfileScope profile("coarse match");
  const int width = options.stereo_width;
  return std::make_shared<DisparityMap>(MatchCoarse(options_.cost, CoarseViewOf(index, width),
                                                    SweepNeighbours(index, neighbours, width, true),
                                                    sweep));
}

std::shared_ptr<DisparityMap> ViewPipeline::MatchSlot(std::size_t index,
                                                      const PipelineOptions& options, bool ahead) {
  std::vector<std::size_t> indices = MatchPartners(index, options_.neighbours);
  if (indices.empty()) return nullptr;
  // The same at every quality level, or later views would differ.
  FixRotation(index);
  for (const std::size_t n : indices) FixRotation(n);
  if (options.neighbours < options_.neighbours) {
    // At a reduced level only the nearest ones, unless they stand at the same place.
    const std::vector<std::size_t> nearest = MatchPartners(index, options.neighbours);
    if (!nearest.empty()) indices = nearest;
  }
  SweepOptions sweep;
  sweep.labels = options.labels;
  sweep.max_disparity = SearchLimit(index, indices);
  if (options_.search == StereoSearch::kRanges) {
    if (ahead) return CoarseMap(index, indices, options, sweep);
    sweep.ranges = SearchRanges(index, indices, options, sweep);
  }
  const StereoView& reference = StereoViewOf(index, options.stereo_width);
  const std::vector<SweepNeighbour> neighbours =
      SweepNeighbours(index, indices, options.stereo_width, false);
  const CostVolume volume = [&] {
    const ProfileScope profile("sweep");
    return MatchingCosts(options_.cost, reference, neighbours, sweep);
  }();
  const ProfileScope profile("semi-global");
  return std::make_shared<DisparityMap>(OptimiseSemiGlobal(volume, reference, SgmOptions{}));
}

DisparityMap ViewPipeline::RefineMap(std::size_t index, const PipelineOptions& options,
                                     int* level) {
  const Slot& slot = slots_[index];
  std::vector<NeighbourMap> maps;
  std::deque<DisparityMap> resized;  // of neighbours that were matched at another quality level
  const std::vector<std::size_t> neighbours = Neighbours(index, options.neighbours);
  for (const std::size_t n : neighbours) {
    const bool is_ahead = n == index + 1;
    const DisparityMap* map = (is_ahead ? slots_[n].ahead : slots_[n].raw).get();
    if (map == nullptr) continue;
    *level = std::max(*level, is_ahead ? slots_[n].ahead_level : slots_[n].raw_level);
    if (map->disparity.width() != slot.raw->disparity.width()) {
      map = &resized.emplace_back(OnGrid(*map, slot.raw->disparity.width()));
    }
    maps.push_back(
        {map, OffsetInWorld(slot.pose.world_from_camera, slots_[n].pose.world_from_camera)
                  .cast<float>()});
  }
  const double tolerance = 1.5 * SearchLimit(index, neighbours) / (options.labels - 1);
  const ProfileScope profile("fuse");
  DisparityMap fused;
  switch (options_.fusion) {
    case StereoFusion::kVotes: {
      FuseOptions fuse;
      fuse.tolerance = tolerance;
      fused = FuseDisparity(*slot.raw, maps, fuse);
      break;
    }
    case StereoFusion::kCrossCheck:
      fused = CrossCheck(*slot.raw, maps, {.tolerance = tolerance});
      break;
    case StereoFusion::kStability:
      fused = FuseCrossChecked(*slot.raw, maps, {.tolerance = tolerance});
      break;
  }
  const ProfileScope fill_profile("filter and fill");
  if (options_.filter == StereoFilter::kWavelet) {
    FilterWavelet({.tolerance = tolerance}, &fused);
  }
  if (options_.sky || options_.fill == StereoFill::kSuperpixels) {
    const Image<float> radiance = MapRadiance(
        slot.input.measurement, slot.pose.world_from_camera.rotation, fused.disparity.width());
    const Superpixels superpixels = FindSuperpixels(LogColours(radiance, scale_), SlicOptions{});
    if (options_.fill == StereoFill::kSuperpixels) FillSuperpixels(superpixels, &fused);
    if (options_.sky) PutSkyAtInfinity(superpixels, FindSky(radiance), kLeastSkyShare, &fused);
  }
  const StereoView& view = StereoViewOf(index, fused.disparity.width());
  if (options_.fill == StereoFill::kRims) FillHoles(MapBrightness(view), FillOptions{}, &fused);
  ForgetUnseen(view,
               SweepNeighbours(index, MatchPartners(index, options.neighbours),
                               fused.disparity.width(), false),
               &fused);
  return fused;
}

DisparityPrecision ViewPipeline::PrecisionOf(std::size_t index) const {
  const Slot& slot = slots_[index];
  DisparityPrecision precision;
  precision.columns = slot.input.optics.columns;
  const std::vector<std::size_t> beside = Neighbours(index, 1);
  for (const std::size_t n : beside) {
    precision.baseline +=
        OffsetInWorld(slot.pose.world_from_camera, slots_[n].pose.world_from_camera).norm() /
        static_cast<double>(beside.size());
  }
  // How large the head is in an unknown unit is not known.
  const double metres_per_unit =
      slot.pose.metric ? 1.0
                       : (slot.pose.gnss_scale ? slot.pose.gnss_scale->metres_per_unit
                                               : std::numeric_limits<double>::infinity());
  precision.viewpoint = slot.input.optics.viewpoint_m / metres_per_unit;
  return precision;
}

FinishedView ViewPipeline::FinishSlot(std::size_t index, const WantView& want, int quality_level) {
  Slot& slot = slots_[index];
  FinishedView view;
  view.pose = slot.pose;
  view.reference = slot.input.reference;
  view.frames = slot.input.frames;
  view.made = want(slot.input.position);
  // A view that is not made costs nothing more: its map serves the next ones in full.
  const int level = view.made ? quality_level : 0;
  view.quality_level = level;
  const PipelineOptions options = AtQuality(options_, level);

  const Stopwatch stereo_time;
  // What guides the search must not be of another level: without it a coarser match does.
  const int guide_level = slot.ahead_level;
  if (guide_level != level) slot.ahead.reset();
  slot.raw = MatchSlot(index, options, false);
  slot.ahead.reset();
  slot.raw_level = level;
  if (options_.search == StereoSearch::kRanges) {
    slot.raw_level = std::max(level, guide_level);
    if (view.made) view.quality_level = slot.raw_level;
  }
  if (slot.raw != nullptr) {
    // Stereo views are made when first needed, with the pose of that moment: needed must not depend
    // on whether this view is wanted, or a resumed run would differ.
    for (const std::size_t n : Neighbours(index, static_cast<int>(kLookahead))) FixRotation(n);
    // Provisional: its own later neighbours are not there yet. It guides the search of the next
    // view, so that it must not depend on whether this one is wanted either.
    const std::vector<std::size_t> next = Neighbours(index, 1);
    if ((view.made || options_.search == StereoSearch::kRanges) &&
        std::find(next.begin(), next.end(), index + 1) != next.end()) {
      Slot& following = slots_[index + 1];
      following.ahead = MatchSlot(index + 1, options, true);
      following.ahead_level = level;
    }
  }
  if (slot.raw != nullptr && view.made) {
    slot.fused = std::make_shared<DisparityMap>(RefineMap(index, options, &view.quality_level));
  }
  view.stereo_s = stereo_time.Seconds();

  if (slot.raw == nullptr) {
    view.warnings.push_back(slots_.size() == 1 && view.pose.chain_reason.empty()
                                ? "no other position to compare with: disparity unknown"
                                : "no neighbouring position with a baseline: disparity unknown");
  }
  if (!view.pose.chain_reason.empty()) {
    view.warnings.push_back("new chain of positions: " + view.pose.chain_reason);
  }
  if (!view.pose.dead_reckoned.empty()) {
    view.warnings.push_back("pose by heading and odometer alone: " + view.pose.dead_reckoned);
  }
  if (!view.pose.scale_note.empty()) view.warnings.push_back(view.pose.scale_note);
  for (const std::string& note : NotesOnOldPlaces(view.pose)) view.warnings.push_back(note);
  if (!view.made) return view;

  const Stopwatch merge_time;
  const ProfileScope profile("merge");
  std::vector<MergeSource> others;
  for (const std::size_t n : Neighbours(index, options_.merge_neighbours)) {
    const Slot& other = slots_[n];
    // Another place without a disparity to reach it through would only ghost.
    const double baseline =
        OffsetInWorld(slot.pose.world_from_camera, other.pose.world_from_camera).norm();
    if (slot.raw == nullptr && baseline > 0.0) continue;
    const bool is_ahead = n == index + 1;
    const DisparityMap* matched = (is_ahead ? other.ahead : other.raw).get();
    if (matched != nullptr) {
      view.quality_level =
          std::max(view.quality_level, is_ahead ? other.ahead_level : other.raw_level);
    }
    others.push_back({&other.input.measurement, other.pose.world_from_camera, nullptr, matched});
    view.frames.insert(view.frames.end(), other.input.frames.begin(), other.input.frames.end());
  }
  std::sort(view.frames.begin(), view.frames.end());
  const MergeSource reference = {&slot.input.measurement, slot.pose.world_from_camera, nullptr};
  const Eigen::Quaterniond world_from_output = options_.orientation == OutputOrientation::kAligned
                                                   ? Eigen::Quaterniond::Identity()
                                                   : slot.pose.world_from_camera.rotation;
  view.camera_from_output =
      (slot.pose.world_from_camera.rotation.conjugate() * world_from_output).normalized();
  MergeOptions merge;
  merge.consistency_log10 = static_cast<float>(options_.consistency_sigma);
  // Light that changes along the way is no wrong label: only views on both sides can tell.
  const std::vector<std::size_t> next_to = Neighbours(index, 1);
  merge.refine_exposure = options_.refine_exposure && next_to.size() == 2;
  merge.refine_limit = static_cast<float>(options_.refine_limit);
  merge.weights = options_.merge_weights;
  merge.consistency = options_.consistency;
  merge.occlusion = options_.occlusion;
  merge.movers = options_.movers;
  const int width = options_.output_width != 0
                        ? options_.output_width
                        : std::min(slot.input.measurement.radiance.width() / 2 * 2, 8192);
  view.merged = MergeViews(reference, slot.fused.get(), others, world_from_output, width, merge);
  CalibrateConfidence(view.merged.disparity, PrecisionOf(index), &view.merged.confidence);
  const std::string exposure = DescribeExposureTest(view.merged.exposure, merge);
  if (!exposure.empty()) view.warnings.push_back(exposure);
  view.merge_s = merge_time.Seconds();
  return view;
}

std::optional<FinishedView> ViewPipeline::Push(PositionInput input, const WantView& want,
                                               int quality_level) {
  const Stopwatch pose_time;
  {
    const ProfileScope profile("poses, the rest");
    tracker_->Push(input.position, input.measurement,
                   PositionClues{input.odometer_m, input.prior, input.heading_deg, input.gnss});
  }
  last_pose_s_ = pose_time.Seconds();
  ExtendScale(input.measurement);
  const PositionId position = input.position;
  Slot slot;
  slot.input = std::move(input);
  slots_.push_back(std::move(slot));
  UpdatePoses();

  std::optional<FinishedView> finished;
  if (slots_.size() - next_unfinished_ > kLookahead) {
    finished = FinishSlot(next_unfinished_, want, quality_level);
    finished->resume_json = SaveState(position);
    const std::optional<SavedKeyframe>& keyframe = tracker_->NewKeyframe();
    if (keyframe && keyframe->position == finished->pose.position) {
      finished->keyframe = keyframe->bytes;
    }
    ++next_unfinished_;
  }
  // Earlier positions stay as long as a view to come can see them.
  while (next_unfinished_ > kLookahead) {
    slots_.pop_front();
    --next_unfinished_;
  }
  return finished;
}

std::vector<FinishedView> ViewPipeline::Finish(const WantView& want) {
  std::vector<FinishedView> finished;
  if (!slots_.empty()) {
    const PositionId last = slots_.back().input.position;
    while (next_unfinished_ < slots_.size()) {
      finished.push_back(FinishSlot(next_unfinished_, want, 0));
      finished.back().resume_json = SaveState(last);
      ++next_unfinished_;
    }
  }
  slots_.clear();
  next_unfinished_ = 0;
  return finished;
}

std::string ViewPipeline::SaveState(PositionId after) const {
  nlohmann::json state;
  state["after"] = Value(after);
  state["lowest_floor"] = lowest_floor_;
  state["brightest"] = brightest_;
  state["poses"] = nlohmann::json::parse(tracker_->SaveState(), nullptr, false);
  if (const std::string methods = DescribeMethods(options_); !methods.empty()) {
    state["methods"] = methods;
  }
  return state.dump();
}

Status ViewPipeline::Restore(const std::string& resume_json) {
  const nlohmann::json state = nlohmann::json::parse(resume_json, nullptr, false);
  if (!state.is_object() || !state.contains("poses") || !state.contains("lowest_floor") ||
      !state["lowest_floor"].is_number() || !state.contains("brightest") ||
      !state["brightest"].is_number()) {
    return Fail(ErrorKind::kData,
                "resume state: not an object with lowest_floor, brightest, poses");
  }
  const std::string methods = state.contains("methods") && state["methods"].is_string()
                                  ? state["methods"].get<std::string>()
                                  : std::string();
  if (const std::string expected = DescribeMethods(options_); methods != expected) {
    return Fail(ErrorKind::kConfig, "resume state: made with methods \"{}\", expected \"{}\"",
                methods, expected);
  }
  OMNIHDR_TRY(tracker_->RestoreState(state["poses"].dump()));
  lowest_floor_ = state["lowest_floor"].get<float>();
  brightest_ = state["brightest"].get<float>();
  scale_ = LogScale::For(lowest_floor_, brightest_);
  return {};
}

void ViewPipeline::Rewarm(PositionId position, const Measurement& measurement) {
  tracker_->Rewarm(position, measurement);
}

}  // namespace omnihdr
