#include "core/pose/pose_tracker.h"

#include <utility>

#include "core/base/profile.h"
#include "core/pose/feature_image.h"
#include "core/pose/features.h"
#include "core/pose/matching.h"
#include "core/pose/tracker.h"

namespace omnihdr {
namespace {

class PictureTracker final : public PoseTracker {
 public:
  explicit PictureTracker(const PoseOptions& options)
      : options_(options), tracker_(options), finder_([&] {
          FeatureOptions features;
          features.max_features = options.max_features;
          return features;
        }()) {}

  void Push(PositionId position, const Measurement& measurement,
            const PositionClues& clues) override {
    tracker_.Push(position, Find(measurement), clues);
  }
  std::vector<PoseEstimate> Window() const override { return tracker_.Window(); }
  std::string SaveState() const override { return tracker_.SaveState(); }
  Status RestoreState(const std::string& json) override { return tracker_.RestoreState(json); }
  void Rewarm(PositionId position, const Measurement& measurement) override {
    if (tracker_.WantsRewarm(position)) tracker_.Rewarm(position, Find(measurement));
  }
  const std::optional<SavedKeyframe>& NewKeyframe() const override {
    return tracker_.NewKeyframe();
  }
  std::vector<PositionId> Keyframes() const override { return tracker_.Keyframes(); }
  Status RestoreKeyframe(const SavedKeyframe& keyframe) override {
    return tracker_.RestoreKeyframe(keyframe);
  }

 private:
  FeatureSet Find(const Measurement& measurement) {
    const ProfileScope profile("features");
    return finder_.Find(MakeFeatureImage(measurement, options_.feature_image_width));
  }

  PoseOptions options_;
  Tracker tracker_;
  FeatureFinder finder_;
};

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
  OMNIHDR_TRY(check("keyframes", keyframes, 0, 1000));
  OMNIHDR_TRY(check("heading_sigma_deg", heading_sigma_deg, 0.0, 90.0));
  return {};
}

Result<std::unique_ptr<PoseTracker>> PoseTracker::Create(const PoseOptions& options) {
  OMNIHDR_TRY(options.Validate());
  return std::make_unique<PictureTracker>(options);
}

}  // namespace omnihdr
