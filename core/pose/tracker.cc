#include "core/pose/tracker.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/base/profile.h"

namespace omnihdr {

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
Tracker::Evidence Tracker::Observe(std::size_t index, PositionId position,
                                   FeatureSet features) const {
  const ProfileScope profile("match and relative pose");
  Evidence evidence;
  evidence.features = std::move(features);
  for (std::size_t back = 1; back <= static_cast<std::size_t>(options_.link_span); ++back) {
    if (back > index) break;
    const std::size_t older = index - back;
    evidence.links.push_back(LinkPositions(estimate(older).position, evidence_[older].features,
                                           position, evidence.features, options_));
  }
  return evidence;
}

void Tracker::AdoptPairs(const AdoptedPairs& adopted, int from_features, Evidence* evidence) {
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

// A position has a baseline when any of its links in the window has, or when it has none at all.
void Tracker::TellBaselines() {
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
}

void Tracker::DropOldest() {
  state_.window.erase(state_.window.begin());
  evidence_.pop_front();
}

// Chains that neither the window nor a remembered place belongs to can never be gone on with.
void Tracker::PurgeChains() {
  std::erase_if(state_.chains, [this](const auto& entry) {
    const int id = entry.first;
    return std::none_of(state_.window.begin(), state_.window.end(),
                        [id](const TrackedPosition& t) { return t.estimate.chain == id; }) &&
           std::none_of(state_.keyframes.begin(), state_.keyframes.end(),
                        [id](const KeyframeEntry& k) { return k.chain == id; });
  });
}

void Tracker::Push(PositionId position, FeatureSet features, const PositionClues& clues) {
  new_keyframe_.reset();
  evidence_.resize(size());  // restored, but not rewarmed to the end
  while (size() >= static_cast<std::size_t>(options_.window)) DropOldest();
  TrackedPosition tracked;
  tracked.estimate.position = position;
  tracked.ordinal = state_.pushed++;
  if (clues.odometer_m && std::isfinite(*clues.odometer_m)) tracked.odometer_m = clues.odometer_m;
  if (clues.heading_deg && std::isfinite(*clues.heading_deg) && options_.heading_sigma_deg > 0.0) {
    tracked.heading_deg = clues.heading_deg;
  }
  if (clues.gnss && clues.gnss->sigma_m > 0.0) tracked.gnss = clues.gnss;
  evidence_.push_back(Observe(size(), position, std::move(features)));
  Place(&tracked, &evidence_.back(), clues.prior);
  for (Link& link : evidence_.back().links) link.unexplained = {};
  state_.window.push_back(std::move(tracked));

  TellBaselines();
  const std::vector<Track> tracks = Tracks();
  const PoseEstimate& newest = state_.window.back().estimate;
  Adjust(newest.chain, tracks);
  if (size() >= 2 && estimate(size() - 2).chain == newest.chain) {
    state_.chains.at(newest.chain).path +=
        (newest.world_from_camera.translation - estimate(size() - 2).world_from_camera.translation)
            .norm();
  }
  SeeOldPlaces(tracks);
  CompareWithGnss();
  Remember(tracks);
  PurgeChains();
  for (TrackedPosition& each : state_.window) {
    each.estimate.scale_source = state_.chains.at(each.estimate.chain).source;
  }
}

Status Tracker::RestoreState(const std::string& json) {
  OMNIHDR_ASSIGN(auto state, TrackerStateFromJson(json));
  if (state.window.size() > static_cast<std::size_t>(options_.window)) {
    return Fail(ErrorKind::kData, "pose state: window of {} positions, at most {}",
                state.window.size(), options_.window);
  }
  state_ = std::move(state);
  evidence_.clear();
  keyframes_.clear();
  new_keyframe_.reset();
  return {};
}

bool Tracker::WantsRewarm(PositionId position) const {
  const auto index = IndexOf(position);
  return index && *index >= evidence_.size();
}

void Tracker::Rewarm(PositionId position, FeatureSet features) {
  if (!WantsRewarm(position)) return;
  const std::size_t index = *IndexOf(position);
  evidence_.resize(index);  // one left out shows nothing
  evidence_.push_back(Observe(index, position, std::move(features)));
  Evidence& evidence = evidence_.back();
  for (const AdoptedPairs& adopted : state_.window[index].adopted) {
    if (const auto from = IndexOf(adopted.from); from && *from < index) {
      AdoptPairs(adopted, evidence_[*from].features.size(), &evidence);
    }
  }
  for (Link& link : evidence.links) link.unexplained = {};
}

}  // namespace omnihdr
