#pragma once

#include <cstddef>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/pose/features.h"
#include "core/pose/keyframes.h"
#include "core/pose/link.h"
#include "core/pose/pose_tracker.h"
#include "core/pose/resection.h"
#include "core/pose/tracker_state.h"
#include "core/pose/tracks.h"

namespace omnihdr {

// Largest parallax, in radian, below which it is not known how far away a point is.
inline constexpr double kKnownParallax = 3.0e-3;

// The pose tracker from features on: what pose_tracker.h says, without the pictures. In five files:
// the window (tracker.cc), the first pose of a position (tracker_place.cc), the adjustment
// (tracker_adjust.cc), old places (tracker_recognise.cc), satellites
// (tracker_gnss.cc). Not thread-safe.
class Tracker {
 public:
  explicit Tracker(const PoseOptions& options) : options_(options) {}

  void Push(PositionId position, FeatureSet features, const PositionClues& clues);
  std::vector<PoseEstimate> Window() const;
  std::string SaveState() const { return TrackerStateToJson(state_); }
  Status RestoreState(const std::string& json);
  // Whether Rewarm would take this position's features.
  bool WantsRewarm(PositionId position) const;
  void Rewarm(PositionId position, FeatureSet features);
  const std::optional<SavedKeyframe>& NewKeyframe() const { return new_keyframe_; }
  std::vector<PositionId> Keyframes() const;
  Status RestoreKeyframe(const SavedKeyframe& saved);

 private:
  // What follows from a position's pixels.
  struct Evidence {
    FeatureSet features;
    std::vector<Link> links;  // to older positions of the window
  };
  struct Sights {
    std::vector<PointSight> points;
    std::vector<int> similarities;  // of the features that led to them
    std::vector<int> groups;        // of the positions they were seen from
  };
  // What is proposed as a position's pose.
  struct Proposal {
    Pose pose;
    const Link* link = nullptr;      // null: from known points
    bool unit = false;               // sets the length of a chain that had none
    int support = 0;                 // known points that agree
    double heading_agreement = 1.0;  // 1: compass headings agree, or say nothing
    int group = 0;
  };
  struct Candidate {
    const Keyframe* keyframe = nullptr;
    int votes = 0;
  };

  std::size_t size() const { return state_.window.size(); }
  const PoseEstimate& estimate(std::size_t i) const { return state_.window[i].estimate; }
  std::optional<std::size_t> IndexOf(PositionId position) const;
  Evidence Observe(std::size_t index, PositionId position, FeatureSet features) const;
  // Makes remembered pairs a link of the position they belong to. Pairs beyond the features there
  // are (the pictures are not those they were found in) are left out.
  static void AdoptPairs(const AdoptedPairs& adopted, int from_features, Evidence* evidence);
  std::vector<Track> Tracks() const;
  void TellBaselines();
  void DropOldest();
  void PurgeChains();

  // The first pose of a position just observed (the last of evidence_, not yet of the window).
  void Place(TrackedPosition* tracked, Evidence* evidence, const std::optional<Pose>& prior);
  void PlaceGiven(TrackedPosition* tracked, const Pose& prior);
  Sights KnownPoints(int chain, const Evidence& evidence, const std::vector<Track>& tracks) const;
  std::vector<Proposal> Propose(int chain_id, const TrackedPosition& tracked,
                                const Evidence& evidence, const Sights& sights) const;
  double HeadingSays(const TrackedPosition& tracked, int chain, const Pose& pose) const;
  bool Agrees(const Pose& pose, const PointSight& sight) const;
  // The known point that a feature of a window position shows; null when none.
  const BundlePoint* AnchorOf(std::size_t index, int feature) const;
  void Adopt(TrackedPosition* tracked, Evidence* evidence, int least_similarity) const;
  void StartChain(TrackedPosition* tracked, std::string reason, const std::optional<Pose>& prior);
  bool PlaceByDeadReckoning(TrackedPosition* tracked, const std::string& reason);

  void Adjust(int chain_id, const std::vector<Track>& tracks);
  std::vector<std::size_t> Members(int chain_id) const;
  void HoldFrame(const Chain& chain, const std::vector<std::size_t>& members, Bundle* bundle) const;
  void AddPoints(const std::vector<int>& camera_of, const std::vector<Track>& tracks,
                 Bundle* bundle, std::vector<double>* parallaxes) const;
  void AddDistances(const std::vector<std::size_t>& members, Bundle* bundle) const;
  void TellSigmas(const BundleOptions& adjust, const Bundle& bundle,
                  const std::vector<std::size_t>& members, const std::vector<int>& camera_of,
                  double scale);

  // Old places.
  std::vector<Candidate> ByVotes(std::vector<Candidate> candidates,
                                 const FeatureSet& features) const;
  bool Relocalise(TrackedPosition* tracked, const Evidence& evidence);
  void SeeOldPlaces(const std::vector<Track>& tracks);
  bool IsBack(const Keyframe& keyframe) const;
  // Inverse distances of a position's features, 0 where not known.
  std::vector<double> KnownInverseDistances(std::size_t index,
                                            const std::vector<Track>& tracks) const;
  std::optional<double> ScaleOf(const Keyframe& keyframe, const Recognition& recognition,
                                const std::vector<Track>& tracks) const;
  void Reexpress(int from_chain, int to_chain, const Pose& from, const Pose& to, double scale);
  void Remember(const std::vector<Track>& tracks);
  void Thin();

  // Satellites (tracker_gnss.cc).
  void CompareWithGnss();
  void GoOnInMetres(int chain_id, const GnssScale& scale);
  static void Rescale(double scale, Keyframe* keyframe);

  PoseOptions options_;
  TrackerState state_;
  // Parallel to state_.window, but shorter while rewarming and one longer while placing.
  std::deque<Evidence> evidence_;
  std::map<PositionId, Keyframe> keyframes_;  // those of state_ whose content is there
  std::optional<SavedKeyframe> new_keyframe_;
};

}  // namespace omnihdr
