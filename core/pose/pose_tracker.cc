#include "core/pose/pose_tracker.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <deque>
#include <numbers>
#include <set>
#include <utility>

#include "core/base/profile.h"
#include "core/pose/bundle_adjustment.h"
#include "core/pose/feature_image.h"
#include "core/pose/features.h"
#include "core/pose/link.h"
#include "core/pose/matching.h"
#include "core/pose/resection.h"
#include "core/pose/scale.h"
#include "core/pose/tracker_state.h"
#include "core/pose/tracks.h"

namespace omnihdr {
namespace {

constexpr double kKnownParallax = 3.0e-3;  // radian; with less, where a point is is not known
constexpr int kMinAdopted = 10;            // pairs that poses lead to, worth having
constexpr int kMinScaleClues = 8;          // points needed to carry the scale on
constexpr int kMaxPoints = 3000;           // adjusted at a time, the longest tracks first
constexpr int kMaxFixed = 3;              // oldest poses that hold frame and scale of a full window
constexpr double kWildThresholds = 4.0;   // errors above this many thresholds are outliers at once
constexpr double kOdometerShare = 0.003;  // sigma of a distance between positions: share of it ...
constexpr double kOdometerFloor = 0.002;  // ... plus this, in metres
// A feature this many feature pixels (at the equator) large is as precise as they get; larger ones
// are less so, in proportion.
constexpr double kBestFeaturePixels = 2.0;

double Quantile(std::vector<double>& values, double q) {
  const auto index =
      std::min(values.size() - 1, static_cast<std::size_t>(q * static_cast<double>(values.size())));
  const auto it = values.begin() + static_cast<std::ptrdiff_t>(index);
  std::nth_element(values.begin(), it, values.end());
  return *it;
}

// What follows from a position's pixels.
struct Evidence {
  FeatureSet features;
  std::vector<Link> links;  // to older positions of the window
};

// Makes remembered pairs a link of the position they belong to. Pairs beyond the features there are
// (the pictures are not those they were found in) are left out.
void AdoptPairs(const AdoptedPairs& adopted, int from_features, Evidence* evidence) {
  for (Link& link : evidence->links) {
    if (link.from != adopted.from) continue;
    link.inliers.clear();
    for (const auto& [a, b] : adopted.features) {
      if (a < 0 || a >= from_features || b < 0 || b >= evidence->features.size()) continue;
      link.inliers.emplace_back(a, b);
    }
    link.motion.verdict = RelativePose::Verdict::kBaseline;
  }
}

class Tracker final : public PoseTracker {
 public:
  explicit Tracker(const PoseOptions& options)
      : options_(options), finder_([&] {
          FeatureOptions features;
          features.max_features = options.max_features;
          return features;
        }()) {}

  void Push(PositionId position, const Measurement& measurement, std::optional<double> odometer_m,
            const std::optional<Pose>& prior) override;
  std::vector<PoseEstimate> Window() const override;
  std::string SaveState() const override { return TrackerStateToJson(state_); }
  Status RestoreState(const std::string& json) override;
  void Rewarm(PositionId position, const Measurement& measurement) override;

 private:
  std::size_t size() const { return state_.window.size(); }
  const PoseEstimate& estimate(std::size_t i) const { return state_.window[i].estimate; }
  std::optional<std::size_t> IndexOf(PositionId position) const;
  Evidence Observe(std::size_t index, PositionId position, const Measurement& measurement);
  struct Sights {
    std::vector<PointSight> points;
    std::vector<int> similarities;  // of the features that led to them
  };
  Sights KnownPoints(int chain, const Evidence& evidence, const std::vector<Track>& tracks) const;
  void Adopt(TrackedPosition* tracked, Evidence* evidence, int least_similarity) const;
  void Place(TrackedPosition* tracked, Evidence* evidence, const std::optional<Pose>& prior);
  void StartChain(TrackedPosition* tracked, std::string reason, const std::optional<Pose>& prior);
  std::vector<Track> Tracks() const;
  void Adjust(int chain);
  void DropOldest();

  PoseOptions options_;
  FeatureFinder finder_;
  TrackerState state_;
  // Parallel to state_.window, but shorter while rewarming and one longer while placing.
  std::deque<Evidence> evidence_;
};

std::optional<std::size_t> Tracker::IndexOf(PositionId position) const {
  for (std::size_t i = 0; i < size(); ++i) {
    if (estimate(i).position == position) return i;
  }
  return std::nullopt;
}

std::vector<PoseEstimate> Tracker::Window() const {
  std::vector<PoseEstimate> estimates;
  for (const TrackedPosition& tracked : state_.window) estimates.push_back(tracked.estimate);
  return estimates;
}

// Features of a position that is (or will be) at `index` of the window, and its links to those
// before.
Evidence Tracker::Observe(std::size_t index, PositionId position, const Measurement& measurement) {
  Evidence evidence;
  {
    const ProfileScope profile("features");
    evidence.features = finder_.Find(MakeFeatureImage(measurement, options_.feature_image_width));
  }
  const ProfileScope profile("match and relative pose");
  for (std::size_t back = 1; back <= static_cast<std::size_t>(options_.link_span); ++back) {
    if (back > index) break;
    const std::size_t older = index - back;
    evidence.links.push_back(LinkPositions(estimate(older).position, evidence_[older].features,
                                           position, evidence.features, options_));
  }
  return evidence;
}

void Tracker::StartChain(TrackedPosition* tracked, std::string reason,
                         const std::optional<Pose>& prior) {
  PoseEstimate& e = tracked->estimate;
  e.chain = state_.next_chain++;
  e.chain_reason = std::move(reason);
  Chain chain;
  chain.first = chain.unit_from = chain.unit_to = e.position;
  if (prior) {
    e.world_from_camera = *prior;
    chain.given = chain.metric = chain.scaled = true;
  }
  e.metric = chain.metric;
  state_.chains[e.chain] = chain;
}

std::vector<Track> Tracker::Tracks() const {
  std::vector<int> counts;
  std::vector<FeaturePairs> pairs;
  for (std::size_t i = 0; i < evidence_.size(); ++i) {
    counts.push_back(evidence_[i].features.size());
    for (const Link& link : evidence_[i].links) {
      const auto from = IndexOf(link.from);
      if (link.ok() && from) {
        pairs.push_back({static_cast<int>(*from), static_cast<int>(i), link.inliers});
      }
    }
  }
  return BuildTracks(counts, pairs);
}

// Points of a chain whose places are known, with the rays under which the newest position (the last
// of evidence_, not yet of the window) may see them: through the matches of all its links, good or
// not.
Tracker::Sights Tracker::KnownPoints(int chain, const Evidence& evidence,
                                     const std::vector<Track>& tracks) const {
  const std::size_t newest = size();
  // Which track a feature belongs to.
  std::vector<std::vector<int>> track_of(newest);
  for (std::size_t i = 0; i < newest; ++i) {
    track_of[i].assign(evidence_[i].features.features.size(), -1);
  }
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    for (const auto& [position, feature] : tracks[t].sightings) {
      if (static_cast<std::size_t>(position) == newest) continue;
      track_of[static_cast<std::size_t>(position)][static_cast<std::size_t>(feature)] =
          static_cast<int>(t);
    }
  }
  Sights sights;
  std::set<std::pair<int, int>> taken;  // (track, feature of the newest)
  for (const Link& link : evidence.links) {
    const std::size_t from = *IndexOf(link.from);
    if (estimate(from).chain != chain) continue;
    for (const auto& [old_feature, new_feature] : link.ok() ? link.inliers : link.unexplained) {
      const int track = track_of[from][static_cast<std::size_t>(old_feature)];
      if (track < 0 || !taken.emplace(track, new_feature).second) continue;
      std::vector<Sighting> sightings;
      for (const auto& [position, feature] : tracks[static_cast<std::size_t>(track)].sightings) {
        const auto p = static_cast<std::size_t>(position);
        if (p == newest || estimate(p).chain != chain) continue;
        sightings.push_back(
            {&estimate(p).world_from_camera,
             evidence_[p].features.features[static_cast<std::size_t>(feature)].ray});
      }
      if (sightings.size() < 2 || LargestParallax(sightings) < kKnownParallax) continue;
      sights.points.push_back(
          {Triangulate(sightings),
           evidence.features.features[static_cast<std::size_t>(new_feature)].ray});
      sights.similarities.push_back(DescriptorSimilarity(evidence_[from].features, old_feature,
                                                         evidence.features, new_feature));
    }
  }
  return sights;
}

// Gives the links that found no motion the pairs that the poses, now known, allow.
void Tracker::Adopt(TrackedPosition* tracked, Evidence* evidence, int least_similarity) const {
  for (Link& link : evidence->links) {
    const std::size_t from = *IndexOf(link.from);
    if (link.ok() || estimate(from).chain != tracked->estimate.chain) continue;
    const Pose to_from_from =
        tracked->estimate.world_from_camera.Inverse() * estimate(from).world_from_camera;
    auto pairs = MatchByMotion(evidence_[from].features, evidence->features, to_from_from,
                               least_similarity, options_);
    if (static_cast<int>(pairs.size()) < kMinAdopted) continue;
    tracked->adopted.push_back({link.from, pairs});
    AdoptPairs(tracked->adopted.back(), evidence_[from].features.size(), evidence);
  }
}

// The first pose of a position just observed (the last of evidence_, not yet of the window): of
// those its links propose, and the one its known points do, that which explains most known points;
// or a new chain.
void Tracker::Place(TrackedPosition* tracked, Evidence* evidence,
                    const std::optional<Pose>& prior) {
  PoseEstimate& e = tracked->estimate;
  tracked->given = prior.has_value();
  if (size() == 0) return StartChain(tracked, "", prior);
  if (prior) {
    // Positions with given poses share their frame, seen to be linked or not.
    for (std::size_t i = size(); i-- > 0;) {
      if (!state_.chains.at(estimate(i).chain).given) continue;
      e.chain = estimate(i).chain;
      e.world_from_camera = *prior;
      e.metric = true;
      return;
    }
    return StartChain(
        tracked,
        fmt::format("position {} has a pose known from elsewhere, those before have not",
                    Value(e.position)),
        prior);
  }

  const Link* strongest = nullptr;
  for (const Link& link : evidence->links) {
    if (link.ok() && (strongest == nullptr || link.inliers.size() > strongest->inliers.size())) {
      strongest = &link;
    }
  }
  const int chain_id =
      estimate(*IndexOf(strongest != nullptr ? strongest->from : evidence->links.front().from))
          .chain;
  Chain& chain = state_.chains.at(chain_id);
  const Sights sights = KnownPoints(chain_id, *evidence, Tracks());

  struct Proposal {
    Pose pose;
    const Link* link = nullptr;  // null: from known points
    bool unit = false;           // sets the length of a chain that had none
    int support = 0;             // known points that agree
  };
  std::vector<Proposal> proposals;
  std::vector<ScaleClue> clues;
  for (const PointSight& sight : sights.points) clues.push_back({sight.point, sight.ray});
  for (const Link& link : evidence->links) {
    const std::size_t from = *IndexOf(link.from);
    if (!link.ok() || estimate(from).chain != chain_id) continue;
    const Pose& old_pose = estimate(from).world_from_camera;
    Proposal proposal;
    proposal.link = &link;
    Pose new_from_old = link.motion.b_from_a;
    if (link.has_baseline()) {
      std::optional<double> travelled;
      const auto& before = state_.window[from].odometer_m;
      if (before && tracked->odometer_m && *tracked->odometer_m > *before) {
        const double turn = 2.0 * std::acos(std::min(1.0, std::fabs(new_from_old.rotation.w())));
        travelled = ChordOfArc(*tracked->odometer_m - *before, turn);
      }
      std::optional<double> baseline;
      if (chain.scaled) {
        baseline = BaselineFromPoints(clues, old_pose, new_from_old, kMinScaleClues);
        if (!baseline && chain.metric) baseline = travelled;
        if (!baseline) continue;
      } else {
        baseline = travelled.value_or(1.0);
        proposal.unit = true;
      }
      new_from_old.translation *= *baseline;
    }
    proposal.pose = old_pose * new_from_old.Inverse();
    proposals.push_back(proposal);
  }
  const bool all_linked = std::all_of(evidence->links.begin(), evidence->links.end(),
                                      [](const Link& link) { return link.ok(); });
  if (chain.scaled && (!all_linked || proposals.empty())) {
    ResectionOptions resection;
    resection.threshold_rad = options_.ransac_threshold_rad;
    const auto found = EstimatePoseFromPoints(
        sights.points, static_cast<std::uint64_t>(Value(e.position)), resection);
    if (found) proposals.push_back({.pose = found->world_from_camera});
  }
  const auto agrees = [&](const Pose& pose, const PointSight& sight) {
    const Eigen::Vector3d seen = RayFromPoint(pose, sight.point);
    return seen.dot(sight.ray) > 0.0 &&
           seen.cross(sight.ray).norm() < 2.0 * options_.ransac_threshold_rad * seen.norm();
  };
  const Proposal* best = nullptr;
  for (Proposal& proposal : proposals) {
    for (const PointSight& sight : sights.points) {
      if (agrees(proposal.pose, sight)) ++proposal.support;
    }
    // Without known points (second position of a chain) the link with most inliers decides.
    const auto rank = [](const Proposal& p) {
      return std::pair(p.support, p.link != nullptr ? p.link->inliers.size() : 0);
    };
    if (best == nullptr || rank(proposal) > rank(*best)) best = &proposal;
  }
  if (best == nullptr && strongest == nullptr) {
    const Link& nearest = evidence->links.front();
    const int from_features = evidence_[*IndexOf(nearest.from)].features.size();
    return StartChain(
        tracked, WhyNoLink(nearest, from_features, evidence->features.size(), options_), prior);
  }
  if (best == nullptr) {
    return StartChain(
        tracked,
        fmt::format("{} points known from before are seen again from position {}, at least {} are "
                    "needed to carry the scale on",
                    sights.points.size(), Value(e.position), kMinScaleClues),
        prior);
  }
  e.chain = chain_id;
  e.world_from_camera = best->pose;
  if (best->unit) {
    chain.scaled = true;
    chain.unit_from = best->link->from;
    chain.unit_to = e.position;
    const auto& before = state_.window[*IndexOf(best->link->from)].odometer_m;
    chain.metric = before && tracked->odometer_m && *tracked->odometer_m > *before;
    // Those placed before the first baseline was known are in the same unit.
    for (TrackedPosition& placed : state_.window) {
      if (placed.estimate.chain == chain_id) placed.estimate.metric = chain.metric;
    }
  }
  e.metric = chain.metric;
  if (all_linked || best->support < kMinAdopted) return;
  std::vector<int> similarities;
  for (std::size_t i = 0; i < sights.points.size(); ++i) {
    if (agrees(best->pose, sights.points[i])) similarities.push_back(sights.similarities[i]);
  }
  std::sort(similarities.begin(), similarities.end());
  Adopt(tracked, evidence, similarities[similarities.size() / 20]);
}

// Adjusts the window's positions of one chain together, and takes stock of distances.
void Tracker::Adjust(int chain_id) {
  const ProfileScope profile("adjust");
  const Chain& chain = state_.chains.at(chain_id);
  std::vector<std::size_t> members;
  std::vector<int> camera_of(size(), -1);
  for (std::size_t i = 0; i < size(); ++i) {
    if (estimate(i).chain != chain_id) continue;
    camera_of[i] = static_cast<int>(members.size());
    members.push_back(i);
  }
  const int count = static_cast<int>(members.size());
  if (count < 2 || !chain.scaled) return;

  Bundle bundle;
  bool any_given = false;
  for (const std::size_t i : members) {
    const TrackedPosition& tracked = state_.window[i];
    bundle.cameras.push_back({tracked.estimate.world_from_camera, tracked.given});
    any_given = any_given || tracked.given;
  }
  const auto camera = [&](int i) -> BundleCamera& {
    return bundle.cameras[static_cast<std::size_t>(i)];
  };
  const bool from_start = estimate(members.front()).position == chain.first;
  camera(0).fixed = true;
  if (!from_start) {
    // The frame and the scale are those of the oldest poses, which had their full share of
    // adjustments.
    const int fixed = std::max(2, std::min(kMaxFixed, count - 4));
    for (int i = 1; i < count; ++i) {
      const bool apart =
          (camera(i - 1).world_from_camera.translation - camera(0).world_from_camera.translation)
              .norm() > 1e-9;
      if (i >= fixed && apart) break;
      camera(i).fixed = true;
    }
  }

  const double best_sigma =
      kBestFeaturePixels * 2.0 * std::numbers::pi / options_.feature_image_width;
  std::vector<Track> tracks = Tracks();
  std::vector<double> parallaxes;
  for (const Track& track : tracks) {
    if (bundle.points.size() >= static_cast<std::size_t>(kMaxPoints)) break;
    std::vector<Sighting> sightings;
    std::vector<BundleObservation> observations;
    for (const auto& [position, feature_index] : track.sightings) {
      const int c = camera_of[static_cast<std::size_t>(position)];
      if (c < 0) continue;
      const Feature& feature = evidence_[static_cast<std::size_t>(position)]
                                   .features.features[static_cast<std::size_t>(feature_index)];
      sightings.push_back({&camera(c).world_from_camera, feature.ray});
      observations.push_back({c, static_cast<int>(bundle.points.size()), feature.ray,
                              std::min(1.0, best_sigma / feature.sigma_rad)});
    }
    if (sightings.size() < 2) continue;
    bundle.points.push_back(Triangulate(sightings));
    bool wild = false;
    for (const BundleObservation& observation : observations) {
      wild = wild ||
             AngularError(bundle, observation) > kWildThresholds * options_.ransac_threshold_rad;
    }
    if (wild) {
      bundle.points.pop_back();
      continue;
    }
    parallaxes.push_back(LargestParallax(sightings));
    bundle.observations.insert(bundle.observations.end(), observations.begin(), observations.end());
  }
  if (bundle.points.empty()) return;

  if (chain.metric) {
    for (int i = 1; i < count; ++i) {
      const auto& before = state_.window[members[static_cast<std::size_t>(i - 1)]].odometer_m;
      const auto& after = state_.window[members[static_cast<std::size_t>(i)]].odometer_m;
      if (!before || !after || *after <= *before) continue;
      if (camera(i - 1).fixed && camera(i).fixed) continue;
      const double turn = camera(i - 1).world_from_camera.rotation.angularDistance(
          camera(i).world_from_camera.rotation);
      const double chord = ChordOfArc(*after - *before, turn);
      bundle.distances.push_back({i - 1, i, chord, kOdometerShare * chord + kOdometerFloor});
    }
  }

  BundleOptions adjust;
  adjust.huber_rad = options_.huber_rad;
  const Bundle before = bundle;
  if (!AdjustBundle(adjust, &bundle)) return;
  // Second round without what does not fit, judged by the spread of what does.
  std::vector<double> errors;
  for (const BundleObservation& observation : bundle.observations) {
    errors.push_back(AngularError(bundle, observation) * observation.weight);
  }
  std::vector<double> sorted = errors;
  const double limit = std::clamp(5.0 * Quantile(sorted, 0.5), 0.3 * options_.ransac_threshold_rad,
                                  options_.ransac_threshold_rad);
  std::vector<int> sightings_left(bundle.points.size(), 0);
  for (std::size_t i = 0; i < errors.size(); ++i) {
    if (errors[i] <= limit)
      ++sightings_left[static_cast<std::size_t>(bundle.observations[i].point)];
  }
  std::vector<BundleObservation> kept;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const BundleObservation& observation = bundle.observations[i];
    if (errors[i] <= limit && sightings_left[static_cast<std::size_t>(observation.point)] >= 2) {
      kept.push_back(observation);
    }
  }
  if (kept.size() < errors.size()) {
    bundle.observations = std::move(kept);
    if (!AdjustBundle(adjust, &bundle)) return;
  }

  double scale = 1.0;
  if (!chain.metric && !any_given) {
    const auto a = IndexOf(chain.unit_from);
    const auto b = IndexOf(chain.unit_to);
    if (a && b && camera_of[*a] >= 0 && camera_of[*b] >= 0 && !camera(camera_of[*b]).fixed) {
      const double length = (camera(camera_of[*a]).world_from_camera.translation -
                             camera(camera_of[*b]).world_from_camera.translation)
                                .norm();
      if (length > 1e-9) scale = 1.0 / length;
    }
  }
  const Eigen::Vector3d origin = camera(0).world_from_camera.translation;
  for (int i = 0; i < count; ++i) {
    PoseEstimate& e = state_.window[members[static_cast<std::size_t>(i)]].estimate;
    if (!camera(i).fixed) {
      e.world_from_camera = camera(i).world_from_camera;
      e.world_from_camera.translation =
          origin + scale * (camera(i).world_from_camera.translation - origin);
    }
  }

  // Distances, of points whose parallax stands well above the noise of their rays.
  std::vector<std::vector<double>> inverse(members.size());
  for (const BundleObservation& observation : bundle.observations) {
    const auto p = static_cast<std::size_t>(observation.point);
    if (parallaxes[p] < 2.0 * options_.ransac_threshold_rad) continue;
    const BundlePoint& point = bundle.points[p];
    const double length = RayFromPoint(camera(observation.camera).world_from_camera, point).norm();
    if (point.inverse_distance > 0.0 && length > 1e-9) {
      inverse[static_cast<std::size_t>(observation.camera)].push_back(point.inverse_distance /
                                                                      (length * scale));
    }
  }
  for (std::size_t m = 0; m < members.size(); ++m) {
    PoseEstimate& e = state_.window[members[m]].estimate;
    const bool any = !inverse[m].empty();
    e.median_inverse_distance = any ? Quantile(inverse[m], 0.5) : 0.0;
    e.max_inverse_distance = any ? Quantile(inverse[m], 0.99) : 0.0;
  }
}

void Tracker::DropOldest() {
  const int chain = state_.window.front().estimate.chain;
  state_.window.erase(state_.window.begin());
  evidence_.pop_front();
  const bool last_of_chain =
      std::none_of(state_.window.begin(), state_.window.end(),
                   [&](const TrackedPosition& tracked) { return tracked.estimate.chain == chain; });
  if (last_of_chain) state_.chains.erase(chain);
}

void Tracker::Push(PositionId position, const Measurement& measurement,
                   std::optional<double> odometer_m, const std::optional<Pose>& prior) {
  evidence_.resize(size());  // restored, but not rewarmed to the end
  while (size() >= static_cast<std::size_t>(options_.window)) DropOldest();
  TrackedPosition tracked;
  tracked.estimate.position = position;
  if (odometer_m && std::isfinite(*odometer_m)) tracked.odometer_m = odometer_m;
  evidence_.push_back(Observe(size(), position, measurement));
  Place(&tracked, &evidence_.back(), prior);
  for (Link& link : evidence_.back().links) link.unexplained = {};
  state_.window.push_back(std::move(tracked));

  // A position has a baseline when any of its links in the window has, or when it has none at all.
  std::vector<int> linked(size(), 0);
  std::vector<int> moved(size(), 0);
  for (std::size_t i = 0; i < size(); ++i) {
    for (const Link& link : evidence_[i].links) {
      const auto from = IndexOf(link.from);
      if (!link.ok() || !from) continue;
      for (const std::size_t end : {*from, i}) {
        ++linked[end];
        moved[end] += link.has_baseline() ? 1 : 0;
      }
    }
  }
  for (std::size_t i = 0; i < size(); ++i) {
    state_.window[i].estimate.has_baseline = linked[i] == 0 || moved[i] > 0;
  }
  Adjust(state_.window.back().estimate.chain);
}

Status Tracker::RestoreState(const std::string& json) {
  OMNIHDR_ASSIGN(auto state, TrackerStateFromJson(json));
  if (state.window.size() > static_cast<std::size_t>(options_.window)) {
    return Fail(ErrorKind::kData, "pose state: window of {} positions, at most {}",
                state.window.size(), options_.window);
  }
  state_ = std::move(state);
  evidence_.clear();
  return {};
}

void Tracker::Rewarm(PositionId position, const Measurement& measurement) {
  const auto index = IndexOf(position);
  if (!index || *index < evidence_.size()) return;
  evidence_.resize(*index);  // one left out shows nothing
  evidence_.push_back(Observe(*index, position, measurement));
  Evidence& evidence = evidence_.back();
  for (const AdoptedPairs& adopted : state_.window[*index].adopted) {
    if (const auto from = IndexOf(adopted.from); from && *from < *index) {
      AdoptPairs(adopted, evidence_[*from].features.size(), &evidence);
    }
  }
  for (Link& link : evidence.links) link.unexplained = {};
}

}  // namespace

Status PoseOptions::Validate() const {
  const auto check = [](std::string_view name, double value, double low, double high) -> Status {
    if (value >= low && value <= high) return {};
    return Fail(ErrorKind::kConfig, "pose.{} is {}, allowed is {} to {}", name, value, low, high);
  };
  OMNIHDR_TRY(check("feature_image_width", feature_image_width, 64, 16384));
  OMNIHDR_TRY(check("max_features", max_features, 100, kMaxMatchableFeatures));
  OMNIHDR_TRY(check("ransac_threshold_rad", ransac_threshold_rad, 1e-5, 0.1));
  OMNIHDR_TRY(check("min_inlier_fraction", min_inlier_fraction, 0.01, 1.0));
  OMNIHDR_TRY(check("min_inliers", min_inliers, 10, 1000));
  OMNIHDR_TRY(check("window", window, 4, 100));
  OMNIHDR_TRY(check("link_span", link_span, 1, window - 1));
  OMNIHDR_TRY(check("huber_rad", huber_rad, 1e-6, 0.1));
  OMNIHDR_TRY(check("min_baseline_ratio", min_baseline_ratio, 0.0, 0.5));
  return {};
}

Result<std::unique_ptr<PoseTracker>> PoseTracker::Create(const PoseOptions& options) {
  OMNIHDR_TRY(options.Validate());
  return std::make_unique<Tracker>(options);
}

}  // namespace omnihdr
