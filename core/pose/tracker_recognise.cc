// Old places: remembering them, and seeing them again.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>
#include <utility>

#include "core/base/crc32c.h"
#include "core/pose/tracker.h"

namespace omnihdr {
namespace {

constexpr int kLeastPoints = 40;           // of a place worth remembering
constexpr int kLeastVotes = 10;            // for a place worth looking for
constexpr std::size_t kLookedAt = 4;       // places looked for when the track is lost
constexpr std::size_t kMostAnchors = 128;  // points of an old place that are gone on with
// Points of an old place to be seen again before positions that are followed well are moved.
constexpr std::size_t kLeastToMove = 40;
constexpr int kLeastRatios = 20;  // distances compared to get from one unit to another
// A place is seen well from within this share of the distance of what is seen there.
constexpr double kReach = 0.5;
constexpr double kDriftAllowed = 0.02;  // of the way since
// Less drift than this is told but left alone: a recognition, of a picture of another exposure
// taken some way from the place, has errors of its own.
constexpr double kLeastDriftDeg = 0.5;
constexpr double kLeastDriftShare = 0.03;  // of the distance of what is seen
constexpr double kLeastDriftScale = 0.08;  // ratio of units, less 1

double Median(std::vector<double>* values) {
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

}  // namespace

std::vector<Tracker::Candidate> Tracker::ByVotes(std::vector<Candidate> candidates,
                                                 const FeatureSet& features) const {
  if (candidates.empty()) return candidates;
  const FeatureSet voters = VotersOf(features);
  for (Candidate& candidate : candidates) candidate.votes = Votes(*candidate.keyframe, voters);
  std::erase_if(candidates, [](const Candidate& c) { return c.votes < kLeastVotes; });
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.votes > b.votes; });
  return candidates;
}

// Puts a position that could not be linked into the chain of the place it sees.
bool Tracker::Relocalise(TrackedPosition* tracked, const Evidence& evidence) {
  std::vector<Candidate> candidates;
  for (const auto& [position, keyframe] : keyframes_) candidates.push_back({&keyframe, 0});
  candidates = ByVotes(std::move(candidates), evidence.features);
  if (candidates.size() > kLookedAt) candidates.resize(kLookedAt);
  PoseEstimate& e = tracked->estimate;
  std::optional<Recognition> best;
  const Keyframe* place = nullptr;
  for (const Candidate& candidate : candidates) {
    auto found = Recognise(*candidate.keyframe, static_cast<std::uint64_t>(Value(e.position)),
                           evidence.features, options_);
    if (!found || (best && found->pairs.size() <= best->pairs.size())) continue;
    best = std::move(found);
    place = candidate.keyframe;
  }
  if (!best) return false;
  e.relocalised = Relocalisation{place->position, e.position, state_.window.back().estimate.chain,
                                 static_cast<int>(best->pairs.size())};
  e.chain = place->chain;
  e.group = state_.next_group++;
  e.world_from_camera = best->world_from_camera;
  e.metric = state_.chains.at(e.chain).metric;
  for (const auto& [point, feature] : best->pairs) {
    if (tracked->anchors.size() == kMostAnchors) break;
    tracked->anchors.push_back({feature, place->Point(point)});
  }
  std::sort(tracked->anchors.begin(), tracked->anchors.end(),
            [](const Anchor& a, const Anchor& b) { return a.feature < b.feature; });
  return true;
}

std::vector<double> Tracker::KnownInverseDistances(std::size_t index,
                                                   const std::vector<Track>& tracks) const {
  std::vector<double> inverse(evidence_[index].features.features.size(), 0.0);
  const PoseEstimate& here = estimate(index);
  for (const Track& track : tracks) {
    std::vector<Sighting> sightings;
    int feature_here = -1;
    for (const auto& [position, feature] : track.sightings) {
      const auto p = static_cast<std::size_t>(position);
      if (estimate(p).chain != here.chain) continue;
      if (p == index) feature_here = feature;
      sightings.push_back({&estimate(p).world_from_camera,
                           evidence_[p].features.features[static_cast<std::size_t>(feature)].ray});
    }
    if (feature_here < 0 || sightings.size() < 2 || LargestParallax(sightings) < kKnownParallax) {
      continue;
    }
    const BundlePoint point = Triangulate(sightings);
    const bool fits =
        std::all_of(sightings.begin(), sightings.end(), [&](const Sighting& sighting) {
          const Eigen::Vector3d seen = RayFromPoint(*sighting.world_from_camera, point);
          return seen.dot(sighting.ray) > 0.0 &&
                 seen.cross(sighting.ray).norm() < options_.ransac_threshold_rad * seen.norm();
        });
    const double length = RayFromPoint(here.world_from_camera, point).norm();
    if (!fits || !(point.inverse_distance > 0.0) || !(length > 1e-9)) continue;
    inverse[static_cast<std::size_t>(feature_here)] = point.inverse_distance / length;
  }
  return inverse;
}

// Whether the newest position, by its own account, may be near a place of its chain again after
// having been away from it.
bool Tracker::IsBack(const Keyframe& keyframe) const {
  const TrackedPosition& newest = state_.window.back();
  const double reach = kReach / keyframe.median_inverse_distance;
  const Eigen::Vector3d& there = keyframe.world_from_camera.translation;
  const double way = state_.chains.at(keyframe.chain).path - keyframe.path;
  const double away = (newest.estimate.world_from_camera.translation - there).norm();
  if (away > reach + kDriftAllowed * way) return false;
  return std::any_of(keyframes_.begin(), keyframes_.end(), [&](const auto& entry) {
    const Keyframe& between = entry.second;
    return between.chain == keyframe.chain && between.ordinal > keyframe.ordinal &&
           (between.world_from_camera.translation - there).norm() > 2.0 * reach;
  });
}

// Lengths in the place's unit over lengths in the newest position's.
std::optional<double> Tracker::ScaleOf(const Keyframe& keyframe, const Recognition& recognition,
                                       const std::vector<Track>& tracks) const {
  const int from = state_.window.back().estimate.chain;
  if (state_.chains.at(from).metric && state_.chains.at(keyframe.chain).metric) return 1.0;
  const std::vector<double> inverse = KnownInverseDistances(size() - 1, tracks);
  std::vector<double> ratios;
  for (const auto& [index, feature] : recognition.pairs) {
    const double here = inverse[static_cast<std::size_t>(feature)];
    const BundlePoint point = keyframe.Point(index);
    const double length = RayFromPoint(recognition.world_from_camera, point).norm();
    if (here > 0.0) ratios.push_back(here * length / point.inverse_distance);
  }
  if (static_cast<int>(ratios.size()) < kLeastRatios) return std::nullopt;
  return Median(&ratios);
}

// Moves the window's positions of a chain such that `from` becomes `to`.
void Tracker::Reexpress(int from_chain, int to_chain, const Pose& from, const Pose& to,
                        double scale) {
  const Eigen::Quaterniond turn = (to.rotation * from.rotation.conjugate()).normalized();
  const auto moved = [&](const Eigen::Vector3d& x) -> Eigen::Vector3d {
    return to.translation + scale * (turn * (x - from.translation));
  };
  const bool metric = state_.chains.at(to_chain).metric;
  ++state_.revision;
  for (TrackedPosition& tracked : state_.window) {
    PoseEstimate& e = tracked.estimate;
    if (e.chain != from_chain) continue;
    e.chain = to_chain;
    e.metric = metric;
    e.revision = state_.revision;
    e.world_from_camera.rotation = (turn * e.world_from_camera.rotation).normalized();
    e.world_from_camera.translation = moved(e.world_from_camera.translation);
    e.median_inverse_distance /= scale;
    e.max_inverse_distance /= scale;
    if (e.sigma) e.sigma->translation *= scale;
    for (Anchor& anchor : tracked.anchors) {
      anchor.point.reference = moved(anchor.point.reference);
      anchor.point.direction = turn * anchor.point.direction;
      anchor.point.inverse_distance /= scale;
    }
  }
}

// Looks whether the newest position sees an old place: one of an older chain, which is then gone on
// with, or one of its own, to which it has come back.
void Tracker::SeeOldPlaces(const std::vector<Track>& tracks) {
  TrackedPosition& newest = state_.window.back();
  PoseEstimate& e = newest.estimate;
  const Chain& chain = state_.chains.at(e.chain);
  if (newest.given || chain.given || !chain.scaled || e.relocalised || !e.dead_reckoned.empty()) {
    return;
  }
  std::vector<Candidate> candidates;
  for (const auto& [position, keyframe] : keyframes_) {
    if (keyframe.chain == e.chain) {
      if (IsBack(keyframe)) candidates.push_back({&keyframe, 0});
    } else if (keyframe.chain < e.chain &&
               (state_.chains.at(keyframe.chain).metric || !chain.metric)) {
      candidates.push_back({&keyframe, 0});
    }
  }
  candidates = ByVotes(std::move(candidates), evidence_.back().features);
  if (candidates.empty()) return;
  const Keyframe& place = *candidates.front().keyframe;
  const auto found = Recognise(place, static_cast<std::uint64_t>(Value(e.position)),
                               evidence_.back().features, options_);
  if (!found || found->pairs.size() < kLeastToMove) return;
  auto scale = ScaleOf(place, *found, tracks);
  const int from_chain = e.chain;
  const int matches = static_cast<int>(found->pairs.size());
  std::optional<Relocalisation> relocalised;
  std::optional<LoopClosure> loop;
  if (place.chain != from_chain) {
    if (!scale) return;  // perhaps from the next position
    relocalised = Relocalisation{place.position, e.position, from_chain, matches};
  } else {
    loop = LoopClosure{place.position, e.position, matches};
    loop->drift_rotation_deg =
        e.world_from_camera.rotation.angularDistance(found->world_from_camera.rotation) * 180.0 /
        std::numbers::pi;
    loop->drift_translation =
        (e.world_from_camera.translation - found->world_from_camera.translation).norm();
    loop->drift_scale = scale.value_or(1.0);
    loop->corrected =
        scale && (loop->drift_rotation_deg > kLeastDriftDeg ||
                  loop->drift_translation * place.median_inverse_distance > kLeastDriftShare ||
                  std::fabs(*scale - 1.0) > kLeastDriftScale);
    e.loop = loop;
    if (scale && std::fabs(*scale - 1.0) <= kLeastDriftScale) scale = 1.0;
    if (!loop->corrected) return;
  }
  Reexpress(from_chain, place.chain, Pose(e.world_from_camera), found->world_from_camera, *scale);
  // What is said of the positions whose views are still to come.
  constexpr std::size_t kUnfinished = PoseTracker::kFinalAfter + 1;
  for (std::size_t i = size() - std::min(size(), kUnfinished); i < size(); ++i) {
    PoseEstimate& member = state_.window[i].estimate;
    if (member.revision != state_.revision) continue;
    if (loop) member.loop = loop;
    if (relocalised) {
      member.relocalised = relocalised;
      member.chain_reason.clear();
    }
  }
  Adjust(place.chain, tracks);
}

// The position whose pose is final becomes a place to remember, when it is its turn.
void Tracker::Remember(const std::vector<Track>& tracks) {
  constexpr std::size_t kBack = PoseTracker::kFinalAfter + 1;
  if (size() < kBack || options_.keyframes == 0) return;
  const std::size_t index = size() - kBack;
  const TrackedPosition& tracked = state_.window[index];
  const PoseEstimate& e = tracked.estimate;
  if (tracked.ordinal % state_.spacing != 0 || !e.dead_reckoned.empty() ||
      !state_.chains.at(e.chain).scaled) {
    return;
  }
  const std::vector<double> inverse = KnownInverseDistances(index, tracks);
  const FeatureSet& features = evidence_[index].features;
  Keyframe keyframe;
  // The first features are the strongest of each part of the picture.
  for (int i = 0; i < features.size() && keyframe.features.size() < kMaxKeyframePoints; ++i) {
    const double distance = inverse[static_cast<std::size_t>(i)];
    if (!(distance > 0.0)) continue;
    keyframe.features.features.push_back(features.features[static_cast<std::size_t>(i)]);
    const auto first = features.descriptors.begin() + std::ptrdiff_t{i} * kDescriptorLength;
    keyframe.features.descriptors.insert(keyframe.features.descriptors.end(), first,
                                         first + kDescriptorLength);
    keyframe.inverse_distance.push_back(distance);
  }
  if (keyframe.features.size() < kLeastPoints) return;
  keyframe.position = e.position;
  keyframe.ordinal = tracked.ordinal;
  keyframe.chain = e.chain;
  keyframe.world_from_camera = e.world_from_camera;
  keyframe.path = state_.chains.at(e.chain).path;
  std::vector<double> values = keyframe.inverse_distance;
  keyframe.median_inverse_distance = Median(&values);
  new_keyframe_ = SavedKeyframe{e.position, KeyframeToBytes(keyframe)};
  const std::string& bytes = new_keyframe_->bytes;
  state_.keyframes.push_back(
      {e.position, tracked.ordinal, e.chain, Crc32c(std::as_bytes(std::span(bytes)))});
  keyframes_[e.position] = std::move(keyframe);
  Thin();
}

// Every second place goes when there are too many, and only every second is added from then on.
void Tracker::Thin() {
  while (state_.keyframes.size() > static_cast<std::size_t>(options_.keyframes)) {
    state_.spacing *= 2;
    std::erase_if(state_.keyframes, [this](const KeyframeEntry& entry) {
      return entry.ordinal % state_.spacing != 0;
    });
  }
  std::erase_if(keyframes_,
                [this](const auto& held) { return held.second.ordinal % state_.spacing != 0; });
  if (new_keyframe_ && !keyframes_.contains(new_keyframe_->position)) new_keyframe_.reset();
}

std::vector<PositionId> Tracker::Keyframes() const {
  std::vector<PositionId> positions;
  for (const KeyframeEntry& entry : state_.keyframes) positions.push_back(entry.position);
  return positions;
}

Status Tracker::RestoreKeyframe(const SavedKeyframe& saved) {
  const auto entry =
      std::find_if(state_.keyframes.begin(), state_.keyframes.end(),
                   [&](const KeyframeEntry& k) { return k.position == saved.position; });
  if (entry == state_.keyframes.end()) {
    return Fail(ErrorKind::kData, "keyframe: position {} is not remembered", Value(saved.position));
  }
  const std::uint32_t crc = Crc32c(std::as_bytes(std::span(saved.bytes)));
  if (crc != entry->crc) {
    return Fail(ErrorKind::kData, "keyframe: position {}: crc32c {}, expected {} as saved",
                Value(saved.position), crc, entry->crc);
  }
  OMNIHDR_ASSIGN(Keyframe keyframe, KeyframeFromBytes(saved.bytes));
  keyframe.chain = entry->chain;
  Rescale(entry->scale, &keyframe);
  keyframes_[saved.position] = std::move(keyframe);
  return {};
}

}  // namespace omnihdr
