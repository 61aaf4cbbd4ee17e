// The first pose of a position.

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <utility>

#include "core/pose/dead_reckoning.h"
#include "core/pose/matching.h"
#include "core/pose/scale.h"
#include "core/pose/tracker.h"

namespace omnihdr {
namespace {

constexpr int kMinAdopted = 10;    // pairs that poses lead to, worth having
constexpr int kMinScaleClues = 8;  // points needed to carry the scale on

}  // namespace

void Tracker::StartChain(TrackedPosition* tracked, std::string reason,
                         const std::optional<Pose>& prior) {
  PoseEstimate& e = tracked->estimate;
  e.chain = state_.next_chain++;
  e.group = state_.next_group++;
  e.chain_reason = std::move(reason);
  Chain chain;
  chain.first = chain.unit_from = chain.unit_to = e.position;
  if (prior) {
    e.world_from_camera = *prior;
    chain.given = chain.metric = chain.scaled = true;
    chain.source = ScaleSource::kGiven;
  }
  e.metric = chain.metric;
  state_.chains[e.chain] = chain;
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
  std::set<std::pair<int, int>> taken;  // (track or, of none, -1 - old feature; feature of newest)
  for (const Link& link : evidence.links) {
    const std::size_t from = *IndexOf(link.from);
    if (estimate(from).chain != chain) continue;
    for (const auto& [old_feature, new_feature] : link.ok() ? link.inliers : link.unexplained) {
      const int track = track_of[from][static_cast<std::size_t>(old_feature)];
      const BundlePoint* anchored = AnchorOf(from, old_feature);
      if (track < 0 && anchored == nullptr) continue;
      if (!taken.emplace(track >= 0 ? track : -1 - old_feature, new_feature).second) continue;
      std::vector<Sighting> sightings;
      if (track >= 0) {
        for (const auto& [position, feature] : tracks[static_cast<std::size_t>(track)].sightings) {
          const auto p = static_cast<std::size_t>(position);
          if (p == newest || estimate(p).chain != chain) continue;
          if (anchored == nullptr) anchored = AnchorOf(p, feature);
          sightings.push_back(
              {&estimate(p).world_from_camera,
               evidence_[p].features.features[static_cast<std::size_t>(feature)].ray});
        }
      }
      if (anchored == nullptr &&
          (sightings.size() < 2 || LargestParallax(sightings) < kKnownParallax)) {
        continue;
      }
      sights.points.push_back(
          {anchored != nullptr ? *anchored : Triangulate(sightings),
           evidence.features.features[static_cast<std::size_t>(new_feature)].ray});
      sights.similarities.push_back(DescriptorSimilarity(evidence_[from].features, old_feature,
                                                         evidence.features, new_feature));
      sights.groups.push_back(estimate(from).group);
    }
  }
  return sights;
}

const BundlePoint* Tracker::AnchorOf(std::size_t index, int feature) const {
  const std::vector<Anchor>& anchors = state_.window[index].anchors;
  const auto it = std::lower_bound(anchors.begin(), anchors.end(), feature,
                                   [](const Anchor& a, int f) { return a.feature < f; });
  return it != anchors.end() && it->feature == feature ? &it->point : nullptr;
}

// Gives the links that found no motion the pairs that the poses, now known, allow.
void Tracker::Adopt(TrackedPosition* tracked, Evidence* evidence, int least_similarity) const {
  for (Link& link : evidence->links) {
    const std::size_t from = *IndexOf(link.from);
    const PoseEstimate& old = estimate(from);
    if (link.ok() || old.chain != tracked->estimate.chain || old.group != tracked->estimate.group) {
      continue;
    }
    const Pose to_from_from = tracked->estimate.world_from_camera.Inverse() * old.world_from_camera;
    auto pairs = MatchByMotion(evidence_[from].features, evidence->features, to_from_from,
                               least_similarity, options_);
    if (static_cast<int>(pairs.size()) < kMinAdopted) continue;
    tracked->adopted.push_back({link.from, pairs});
    AdoptPairs(tracked->adopted.back(), evidence_[from].features.size(), evidence);
  }
}

void Tracker::PlaceGiven(TrackedPosition* tracked, const Pose& prior) {
  PoseEstimate& e = tracked->estimate;
  // Positions with given poses share their frame, seen to be linked or not.
  for (std::size_t i = size(); i-- > 0;) {
    if (!state_.chains.at(estimate(i).chain).given) continue;
    e.chain = estimate(i).chain;
    e.group = estimate(i).group;
    e.world_from_camera = prior;
    e.metric = true;
    return;
  }
  StartChain(tracked,
             fmt::format("position {} has a pose known from elsewhere, those before have not",
                         Value(e.position)),
             prior);
}

bool Tracker::Agrees(const Pose& pose, const PointSight& sight) const {
  const Eigen::Vector3d seen = RayFromPoint(pose, sight.point);
  return seen.dot(sight.ray) > 0.0 &&
         seen.cross(sight.ray).norm() < 2.0 * options_.ransac_threshold_rad * seen.norm();
}

// How well a pose agrees with the compass, by the newest position of its chain that has a heading.
double Tracker::HeadingSays(const TrackedPosition& tracked, int chain, const Pose& pose) const {
  if (!tracked.heading_deg) return 1.0;
  for (std::size_t i = size(); i-- > 0;) {
    const TrackedPosition& old = state_.window[i];
    if (old.estimate.chain != chain || !old.heading_deg) continue;
    const double sigma =
        std::numbers::sqrt2 * options_.heading_sigma_deg * std::numbers::pi / 180.0;
    const Eigen::Quaterniond turn =
        pose.rotation * old.estimate.world_from_camera.rotation.conjugate();
    return HeadingAgreement(TurnOf(turn), TurnFromHeadings(*old.heading_deg, *tracked.heading_deg),
                            sigma);
  }
  return 1.0;
}

// The poses that a position's links propose, and the one its known points do.
std::vector<Tracker::Proposal> Tracker::Propose(int chain_id, const TrackedPosition& tracked,
                                                const Evidence& evidence,
                                                const Sights& sights) const {
  const Chain& chain = state_.chains.at(chain_id);
  std::vector<Proposal> proposals;
  std::vector<ScaleClue> clues;
  for (const PointSight& sight : sights.points) clues.push_back({sight.point, sight.ray});
  bool all_linked = true;
  for (const Link& link : evidence.links) {
    all_linked = all_linked && link.ok();
    const std::size_t from = *IndexOf(link.from);
    if (!link.ok() || estimate(from).chain != chain_id) continue;
    const Pose& old_pose = estimate(from).world_from_camera;
    Proposal proposal;
    proposal.link = &link;
    proposal.group = estimate(from).group;
    Pose new_from_old = link.motion.b_from_a;
    if (link.has_baseline()) {
      std::optional<double> travelled;
      const auto& before = state_.window[from].odometer_m;
      if (before && tracked.odometer_m && *tracked.odometer_m > *before) {
        // Of two places alone; the adjustment knows the way before and after.
        const double turn = 2.0 * std::acos(std::min(1.0, std::fabs(new_from_old.rotation.w())));
        travelled = ChordOfArc(*tracked.odometer_m - *before, turn);
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
  if (chain.scaled && (!all_linked || proposals.empty())) {
    ResectionOptions resection;
    resection.threshold_rad = options_.ransac_threshold_rad;
    const auto found = EstimatePoseFromPoints(
        sights.points, static_cast<std::uint64_t>(Value(tracked.estimate.position)), resection);
    if (found) {
      Proposal proposal;
      proposal.pose = found->world_from_camera;
      std::map<int, int> of_group;
      for (const int i : found->inliers) ++of_group[sights.groups[static_cast<std::size_t>(i)]];
      proposal.group = std::max_element(of_group.begin(), of_group.end(), [](auto& a, auto& b) {
                         return a.second < b.second;
                       })->first;
      proposals.push_back(proposal);
    }
  }
  for (Proposal& proposal : proposals) {
    for (const PointSight& sight : sights.points) {
      if (Agrees(proposal.pose, sight)) ++proposal.support;
    }
    proposal.heading_agreement = HeadingSays(tracked, chain_id, proposal.pose);
  }
  return proposals;
}

// Of the poses proposed, that which explains most known points; else an old place seen again, or
// dead reckoning, or a new chain.
void Tracker::Place(TrackedPosition* tracked, Evidence* evidence,
                    const std::optional<Pose>& prior) {
  PoseEstimate& e = tracked->estimate;
  tracked->given = prior.has_value();
  if (size() == 0) return StartChain(tracked, "", prior);
  if (prior) return PlaceGiven(tracked, *prior);

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
  const std::vector<Proposal> proposals = Propose(chain_id, *tracked, *evidence, sights);
  const Proposal* best = nullptr;
  for (const Proposal& proposal : proposals) {
    // Without known points (second position of a chain) the link with most inliers decides.
    const auto rank = [](const Proposal& p) {
      const double inliers = p.link != nullptr ? static_cast<double>(p.link->inliers.size()) : 0.0;
      return std::pair(p.heading_agreement * p.support, p.heading_agreement * inliers);
    };
    if (best == nullptr || rank(proposal) > rank(*best)) best = &proposal;
  }
  if (best == nullptr) {
    const Link& nearest = evidence->links.front();
    const int from_features = evidence_[*IndexOf(nearest.from)].features.size();
    std::string reason =
        strongest == nullptr
            ? WhyNoLink(nearest, from_features, evidence->features.size(), options_)
            : fmt::format(
                  "{} points known from before are seen again from position {}, at least {} are "
                  "needed to carry the scale on",
                  sights.points.size(), Value(e.position), kMinScaleClues);
    if (Relocalise(tracked, *evidence) || PlaceByDeadReckoning(tracked, reason)) return;
    return StartChain(tracked, std::move(reason), prior);
  }
  e.chain = chain_id;
  e.group = best->group;
  e.world_from_camera = best->pose;
  if (best->unit) {
    chain.scaled = true;
    chain.unit_from = best->link->from;
    chain.unit_to = e.position;
    const auto& before = state_.window[*IndexOf(best->link->from)].odometer_m;
    chain.metric = before && tracked->odometer_m && *tracked->odometer_m > *before;
    if (chain.metric) chain.source = ScaleSource::kOdometer;
    // Those placed before the first baseline was known are in the same unit.
    for (TrackedPosition& placed : state_.window) {
      if (placed.estimate.chain == chain_id) placed.estimate.metric = chain.metric;
    }
  }
  e.metric = chain.metric;
  const bool all_linked = std::all_of(evidence->links.begin(), evidence->links.end(),
                                      [](const Link& link) { return link.ok(); });
  if (all_linked || best->support < kMinAdopted) return;
  std::vector<int> similarities;
  for (std::size_t i = 0; i < sights.points.size(); ++i) {
    if (Agrees(best->pose, sights.points[i])) similarities.push_back(sights.similarities[i]);
  }
  std::sort(similarities.begin(), similarities.end());
  Adopt(tracked, evidence, similarities[similarities.size() / 20]);
}

// The pose by compass and odometer, from the newest position; false when they do not give one.
bool Tracker::PlaceByDeadReckoning(TrackedPosition* tracked, const std::string& reason) {
  const TrackedPosition& last = state_.window.back();
  const PoseEstimate& from = last.estimate;
  if (!tracked->heading_deg || !last.heading_deg || !tracked->odometer_m || !last.odometer_m ||
      *tracked->odometer_m < *last.odometer_m || !state_.chains.at(from.chain).metric) {
    return false;
  }
  std::optional<Pose> before;
  if (size() >= 2 && estimate(size() - 2).chain == from.chain) {
    before = estimate(size() - 2).world_from_camera;
  }
  const double travelled = *tracked->odometer_m - *last.odometer_m;
  PoseEstimate& e = tracked->estimate;
  e.world_from_camera =
      DeadReckon(from.world_from_camera, before,
                 TurnFromHeadings(*last.heading_deg, *tracked->heading_deg), travelled);
  e.chain = from.chain;
  e.group = state_.next_group++;
  e.metric = true;
  e.sigma = DeadReckoningSigma(travelled, options_.heading_sigma_deg, from.sigma);
  e.dead_reckoned = reason;
  return true;
}

}  // namespace omnihdr
