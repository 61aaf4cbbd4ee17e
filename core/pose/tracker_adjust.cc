// The adjustment of the window.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "core/base/profile.h"
#include "core/pose/bundle_adjustment.h"
#include "core/pose/dead_reckoning.h"
#include "core/pose/scale.h"
#include "core/pose/tracker.h"

namespace omnihdr {
namespace {

constexpr int kMaxPoints = 3000;         // adjusted at a time, the longest tracks first
constexpr int kMaxFixed = 3;             // oldest poses that hold frame and scale of a full window
constexpr int kLeastAnchors = 20;        // known points that hold frame and scale instead
constexpr double kWildThresholds = 4.0;  // errors above this many thresholds are outliers at once
// A feature this many feature pixels (at the equator) large is as precise as they get; larger ones
// are less so, in proportion.
constexpr double kBestFeaturePixels = 2.0;
constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kShortestWay = 1e-6;  // has no direction
constexpr double kArcDoubt = 0.25;     // sigma of an arc's length less its chord's, as a share

double AngleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

double Quantile(std::vector<double>& values, double q) {
  const auto index =
      std::min(values.size() - 1, static_cast<std::size_t>(q * static_cast<double>(values.size())));
  const auto it = values.begin() + static_cast<std::ptrdiff_t>(index);
  std::nth_element(values.begin(), it, values.end());
  return *it;
}

// Takes out what does not fit, judged by the spread of what does; false when there is no such.
bool RejectOutliers(double threshold_rad, Bundle* bundle) {
  std::vector<double> errors;
  for (const BundleObservation& observation : bundle->observations) {
    errors.push_back(AngularError(*bundle, observation) * observation.weight);
  }
  std::vector<double> sorted = errors;
  const double limit = std::clamp(5.0 * Quantile(sorted, 0.5), 0.3 * threshold_rad, threshold_rad);
  std::vector<int> sightings_left(bundle->points.size(), 0);
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const auto point = static_cast<std::size_t>(bundle->observations[i].point);
    // A known point says something by itself.
    if (errors[i] <= limit) sightings_left[point] += bundle->points[point].fixed ? 2 : 1;
  }
  std::vector<BundleObservation> kept;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const BundleObservation& observation = bundle->observations[i];
    if (errors[i] <= limit && sightings_left[static_cast<std::size_t>(observation.point)] >= 2) {
      kept.push_back(observation);
    }
  }
  const bool rejected = kept.size() < errors.size();
  if (rejected) bundle->observations = std::move(kept);
  return rejected;
}

}  // namespace

// The positions adjusted together: those of the chain, but not what no picture links to anything.
std::vector<std::size_t> Tracker::Members(int chain_id) const {
  std::vector<bool> linked(size(), false);
  for (std::size_t i = 0; i < size(); ++i) {
    for (const Link& link : evidence_[i].links) {
      const auto from = IndexOf(link.from);
      if (link.ok() && from) linked[i] = linked[*from] = true;
    }
  }
  std::vector<std::size_t> members;
  for (std::size_t i = 0; i < size(); ++i) {
    const PoseEstimate& e = estimate(i);
    if (e.chain == chain_id && (linked[i] || e.dead_reckoned.empty())) members.push_back(i);
  }
  return members;
}

// Which poses hold the frame and the scale.
void Tracker::HoldFrame(const Chain& chain, const std::vector<std::size_t>& members,
                        Bundle* bundle) const {
  const TrackedPosition& front = state_.window[members.front()];
  const int count = static_cast<int>(members.size());
  const auto camera = [&](int i) -> BundleCamera& {
    return bundle->cameras[static_cast<std::size_t>(i)];
  };
  if (static_cast<int>(front.anchors.size()) >= kLeastAnchors) return;  // its known points do
  camera(0).fixed = true;
  if (front.estimate.position == chain.first) return;
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

// Adds the points the members see; `parallaxes`: of each point, infinite for known ones.
void Tracker::AddPoints(const std::vector<int>& camera_of, const std::vector<Track>& tracks,
                        Bundle* bundle, std::vector<double>* parallaxes) const {
  const double best_sigma =
      kBestFeaturePixels * 2.0 * std::numbers::pi / options_.feature_image_width;
  bool any_anchor = false;
  for (std::size_t i = 0; i < size(); ++i) {
    any_anchor = any_anchor || (camera_of[i] >= 0 && !state_.window[i].anchors.empty());
  }
  std::vector<std::vector<bool>> used(any_anchor ? size() : 0);
  for (std::size_t i = 0; i < used.size(); ++i)
    used[i].resize(evidence_[i].features.features.size());
  const auto add = [&](const std::vector<std::pair<int, int>>& seen) {
    std::vector<Sighting> sightings;
    std::vector<BundleObservation> observations;
    const BundlePoint* known = nullptr;
    for (const auto& [position, feature_index] : seen) {
      const auto p = static_cast<std::size_t>(position);
      const int c = camera_of[p];
      if (c < 0) continue;
      const Feature& feature =
          evidence_[p].features.features[static_cast<std::size_t>(feature_index)];
      sightings.push_back(
          {&bundle->cameras[static_cast<std::size_t>(c)].world_from_camera, feature.ray});
      observations.push_back({c, static_cast<int>(bundle->points.size()), feature.ray,
                              std::min(1.0, best_sigma / feature.sigma_rad)});
      if (!any_anchor) continue;
      used[p][static_cast<std::size_t>(feature_index)] = true;
      if (known == nullptr) known = AnchorOf(p, feature_index);
    }
    if (sightings.empty() || (known == nullptr && sightings.size() < 2)) return;
    bundle->points.push_back(known != nullptr ? *known : Triangulate(sightings));
    for (const BundleObservation& observation : observations) {
      if (AngularError(*bundle, observation) > kWildThresholds * options_.ransac_threshold_rad) {
        bundle->points.pop_back();
        return;
      }
    }
    parallaxes->push_back(known != nullptr ? INFINITY : LargestParallax(sightings));
    bundle->observations.insert(bundle->observations.end(), observations.begin(),
                                observations.end());
  };
  for (const Track& track : tracks) {
    if (bundle->points.size() >= static_cast<std::size_t>(kMaxPoints)) break;
    add(track.sightings);
  }
  // Known points that no other position sees.
  for (std::size_t i = 0; i < used.size(); ++i) {
    if (camera_of[i] < 0) continue;
    for (const Anchor& anchor : state_.window[i].anchors) {
      const bool there = anchor.feature >= 0 && anchor.feature < evidence_[i].features.size();
      if (there && !used[i][static_cast<std::size_t>(anchor.feature)]) {
        add({{static_cast<int>(i), anchor.feature}});
      }
    }
  }
}

void Tracker::AddDistances(const std::vector<std::size_t>& members, Bundle* bundle) const {
  const auto camera = [&](int i) -> const BundleCamera& {
    return bundle->cameras[static_cast<std::size_t>(i)];
  };
  // The way from the member before to member i; nothing where there is none or track was lost.
  const auto way = [&](int i) -> std::optional<Eigen::Vector3d> {
    if (i < 1 || i >= static_cast<int>(members.size())) return std::nullopt;
    const auto at = static_cast<std::size_t>(i);
    if (estimate(members[at - 1]).group != estimate(members[at]).group) return std::nullopt;
    const Eigen::Vector3d step =
        camera(i).world_from_camera.translation - camera(i - 1).world_from_camera.translation;
    if (step.norm() < kShortestWay) return std::nullopt;
    return step;
  };
  // How far the way turns between two places: what the ways before and after tell, since a head may
  // turn otherwise than what carries it; of two places alone, the head's own turn.
  const auto turn_of_way = [&](int i) {
    const auto own = way(i);
    const auto before = way(i - 1);
    const auto after = way(i + 1);
    if (before && after) return 0.5 * AngleBetween(*before, *after);
    if (own && before) return AngleBetween(*before, *own);
    if (own && after) return AngleBetween(*own, *after);
    return camera(i - 1).world_from_camera.rotation.angularDistance(
        camera(i).world_from_camera.rotation);
  };
  for (int i = 1; i < static_cast<int>(members.size()); ++i) {
    const auto& before = state_.window[members[static_cast<std::size_t>(i - 1)]].odometer_m;
    const auto& after = state_.window[members[static_cast<std::size_t>(i)]].odometer_m;
    if (!before || !after || *after <= *before) continue;
    // Who loses track may have been carried.
    if (estimate(members[static_cast<std::size_t>(i - 1)]).group !=
        estimate(members[static_cast<std::size_t>(i)]).group) {
      continue;
    }
    const BundleCamera& from = bundle->cameras[static_cast<std::size_t>(i - 1)];
    const BundleCamera& to = bundle->cameras[static_cast<std::size_t>(i)];
    if (from.fixed && to.fixed) continue;
    const double travelled = *after - *before;
    const double chord = ChordOfArc(travelled, turn_of_way(i));
    // That the way is an arc is a guess.
    const double sigma = kOdometerShare * chord + kOdometerFloor + kArcDoubt * (travelled - chord);
    bundle->distances.push_back({i - 1, i, chord, sigma});
  }
}

// Says how well the adjusted poses are known; `scale` is what lengths are multiplied by afterwards.
void Tracker::TellSigmas(const BundleOptions& adjust, const Bundle& bundle,
                         const std::vector<std::size_t>& members, const std::vector<int>& camera_of,
                         double scale) {
  const PoseEstimate& front = estimate(members.front());
  const Chain& chain = state_.chains.at(front.chain);
  std::optional<BundleDistance> held;
  const auto fixed = [](const BundleCamera& camera) { return camera.fixed; };
  const Eigen::Vector3d& origin = bundle.cameras.front().world_from_camera.translation;
  const bool two_places =
      std::any_of(bundle.cameras.begin(), bundle.cameras.end(), [&](const BundleCamera& camera) {
        return camera.fixed && (camera.world_from_camera.translation - origin).norm() > 1e-9;
      });
  const bool known_points = std::none_of(bundle.cameras.begin(), bundle.cameras.end(), fixed);
  if (!two_places && !known_points && bundle.distances.empty()) {
    const auto a = IndexOf(chain.unit_from);
    const auto b = IndexOf(chain.unit_to);
    if (!a || !b || *a == *b || camera_of[*a] < 0 || camera_of[*b] < 0) return;
    held = BundleDistance{camera_of[*a], camera_of[*b], 1.0, 1.0};
  }
  const std::vector<PoseCovariance> covariances = CameraCovariances(adjust, bundle, held);
  for (std::size_t m = 0; m < covariances.size(); ++m) {
    if (bundle.cameras[m].fixed) continue;
    // No picture says where it is: then it is not known, rather than known badly.
    if (covariances[m].diagonal().head<3>().maxCoeff() > 1.0) continue;
    PoseSigma sigma;
    sigma.rotation_deg = covariances[m].diagonal().head<3>().cwiseSqrt() / kDegree;
    sigma.translation = scale * covariances[m].diagonal().tail<3>().cwiseSqrt();
    state_.window[members[m]].estimate.sigma = sigma;
  }
}

// Adjusts the window's positions of one chain together, and takes stock of distances.
void Tracker::Adjust(int chain_id, const std::vector<Track>& tracks) {
  const ProfileScope profile("adjust");
  const Chain& chain = state_.chains.at(chain_id);
  const std::vector<std::size_t> members = Members(chain_id);
  if (members.empty() || !chain.scaled) return;
  if (members.size() < 2 && state_.window[members.front()].anchors.empty()) return;
  std::vector<int> camera_of(size(), -1);
  Bundle bundle;
  bool any_given = false;
  for (const std::size_t i : members) {
    const TrackedPosition& tracked = state_.window[i];
    camera_of[i] = static_cast<int>(bundle.cameras.size());
    const bool held = tracked.given || !tracked.estimate.dead_reckoned.empty();
    bundle.cameras.push_back({tracked.estimate.world_from_camera, held});
    any_given = any_given || tracked.given;
  }
  HoldFrame(chain, members, &bundle);
  std::vector<double> parallaxes;
  AddPoints(camera_of, tracks, &bundle, &parallaxes);
  if (bundle.points.empty()) return;
  // The unit of a chain in metres by satellites is not the odometer's, by a percent or two.
  if (chain.source == ScaleSource::kOdometer || chain.source == ScaleSource::kGiven) {
    AddDistances(members, &bundle);
  }

  BundleOptions adjust;
  adjust.huber_rad = options_.huber_rad;
  if (!AdjustBundle(adjust, &bundle)) return;
  if (RejectOutliers(options_.ransac_threshold_rad, &bundle) && !AdjustBundle(adjust, &bundle)) {
    return;
  }

  const auto& cameras = bundle.cameras;
  double scale = 1.0;
  if ((!chain.metric || chain.source == ScaleSource::kGnss) && !any_given) {
    const auto a = IndexOf(chain.unit_from);
    const auto b = IndexOf(chain.unit_to);
    if (a && b && camera_of[*a] >= 0 && camera_of[*b] >= 0) {
      const BundleCamera& from = cameras[static_cast<std::size_t>(camera_of[*a])];
      const BundleCamera& to = cameras[static_cast<std::size_t>(camera_of[*b])];
      const double length =
          (from.world_from_camera.translation - to.world_from_camera.translation).norm();
      if (!to.fixed && length > 1e-9) scale = chain.unit_length / length;
    }
  }
  TellSigmas(adjust, bundle, members, camera_of, scale);
  const Eigen::Vector3d origin = cameras.front().world_from_camera.translation;
  for (std::size_t m = 0; m < members.size(); ++m) {
    if (cameras[m].fixed) continue;
    const Pose& adjusted = cameras[m].world_from_camera;
    state_.window[members[m]].estimate.world_from_camera = {
        adjusted.rotation, origin + scale * (adjusted.translation - origin)};
  }

  // Distances, of points whose parallax stands well above the noise of their rays.
  std::vector<std::vector<double>> inverse(members.size());
  for (const BundleObservation& observation : bundle.observations) {
    const auto p = static_cast<std::size_t>(observation.point);
    if (parallaxes[p] < 2.0 * options_.ransac_threshold_rad) continue;
    const BundlePoint& point = bundle.points[p];
    const auto c = static_cast<std::size_t>(observation.camera);
    const double length = RayFromPoint(cameras[c].world_from_camera, point).norm();
    if (point.inverse_distance > 0.0 && length > 1e-9) {
      inverse[c].push_back(point.inverse_distance / (length * scale));
    }
  }
  for (std::size_t m = 0; m < members.size(); ++m) {
    PoseEstimate& e = state_.window[members[m]].estimate;
    const bool any = !inverse[m].empty();
    e.median_inverse_distance = any ? Quantile(inverse[m], 0.5) : 0.0;
    e.max_inverse_distance = any ? Quantile(inverse[m], 0.99) : 0.0;
  }
}

}  // namespace omnihdr
