#include "core/pose/keyframes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <string_view>
#include <type_traits>

#include "core/pose/matching.h"
#include "core/pose/resection.h"

namespace omnihdr {
namespace {

constexpr std::string_view kMagic = "omnihdr-keyframe 1\n";
constexpr int kVoters = 512;
constexpr float kVoteRatio = 0.85F;
constexpr float kMatchRatio = 0.85F;
constexpr int kLeastInliers = 20;
constexpr double kLeastShare = 0.15;  // of the matches, that agree with the pose
constexpr int kDraws = 600;
// Mean of the unit rays of what agrees: above it lies in a cone of about 25 degrees.
constexpr double kMostConcentrated = 0.95;

template <typename T>
void Put(const T& value, std::string* bytes) {
  static_assert(std::is_trivially_copyable_v<T>);
  std::array<char, sizeof(T)> raw;
  std::memcpy(raw.data(), &value, sizeof(T));
  bytes->append(raw.data(), raw.size());
}

class Reader {
 public:
  explicit Reader(std::string_view bytes) : bytes_(bytes) {}
  template <typename T>
  void Get(T* value) {
    static_assert(std::is_trivially_copyable_v<T>);
    if (bytes_.size() < sizeof(T)) {
      complete_ = false;
      return;
    }
    std::memcpy(value, bytes_.data(), sizeof(T));
    bytes_.remove_prefix(sizeof(T));
  }
  bool at_end() const { return complete_ && bytes_.empty(); }

 private:
  std::string_view bytes_;
  bool complete_ = true;
};

template <typename K, typename Visit>
void VisitHead(K& keyframe, Visit visit) {
  visit(keyframe.position);
  visit(keyframe.ordinal);
  visit(keyframe.chain);
  auto& pose = keyframe.world_from_camera;
  for (Eigen::Index i = 0; i < 4; ++i) visit(pose.rotation.coeffs()[i]);
  for (Eigen::Index i = 0; i < 3; ++i) visit(pose.translation[i]);
  visit(keyframe.path);
  visit(keyframe.median_inverse_distance);
}

template <typename F, typename Visit>
void VisitFeature(F& feature, Visit visit) {
  for (Eigen::Index i = 0; i < 3; ++i) visit(feature.ray[i]);
  visit(feature.sigma_rad);
  visit(feature.x);
  visit(feature.y);
  visit(feature.scale);
  visit(feature.angle);
  visit(feature.response);
}

}  // namespace

BundlePoint Keyframe::Point(int index) const {
  const auto i = static_cast<std::size_t>(index);
  BundlePoint point;
  point.reference = world_from_camera.translation;
  point.direction = world_from_camera.rotation * features.features[i].ray;
  point.inverse_distance = inverse_distance[i];
  point.fixed = true;
  return point;
}

std::string KeyframeToBytes(const Keyframe& keyframe) {
  std::string bytes(kMagic);
  const auto put = [&bytes](const auto& value) { Put(value, &bytes); };
  VisitHead(keyframe, put);
  put(std::int32_t{keyframe.features.size()});
  for (const Feature& feature : keyframe.features.features) VisitFeature(feature, put);
  for (const double inverse : keyframe.inverse_distance) put(inverse);
  for (const std::int16_t value : keyframe.features.descriptors) put(value);
  return bytes;
}

Result<Keyframe> KeyframeFromBytes(const std::string& bytes) {
  if (!bytes.starts_with(kMagic)) {
    return Fail(ErrorKind::kData, "keyframe: does not begin with \"omnihdr-keyframe 1\"");
  }
  Keyframe keyframe;
  Reader reader(std::string_view(bytes).substr(kMagic.size()));
  const auto get = [&reader](auto& value) { reader.Get(&value); };
  VisitHead(keyframe, get);
  std::int32_t count = -1;
  get(count);
  if (count < 1 || count > kMaxKeyframePoints) {
    return Fail(ErrorKind::kData, "keyframe: {} points, expected 1 to {}", count,
                kMaxKeyframePoints);
  }
  keyframe.features.features.resize(static_cast<std::size_t>(count));
  keyframe.inverse_distance.resize(static_cast<std::size_t>(count));
  keyframe.features.descriptors.resize(static_cast<std::size_t>(count) * kDescriptorLength);
  for (Feature& feature : keyframe.features.features) VisitFeature(feature, get);
  for (double& inverse : keyframe.inverse_distance) get(inverse);
  for (std::int16_t& value : keyframe.features.descriptors) get(value);
  if (!reader.at_end()) {
    return Fail(ErrorKind::kData, "keyframe: {} bytes are not those of {} points", bytes.size(),
                count);
  }
  const Pose& pose = keyframe.world_from_camera;
  if (!(std::fabs(pose.rotation.norm() - 1.0) < 1e-6) || !pose.translation.allFinite() ||
      !(keyframe.median_inverse_distance > 0.0)) {
    return Fail(ErrorKind::kData, "keyframe: position {}: not a pose with points at a distance",
                Value(keyframe.position));
  }
  return keyframe;
}

FeatureSet VotersOf(const FeatureSet& features) {
  const auto count = static_cast<std::ptrdiff_t>(std::min(features.size(), kVoters));
  FeatureSet voters;
  voters.features.assign(features.features.begin(), features.features.begin() + count);
  voters.descriptors.assign(features.descriptors.begin(),
                            features.descriptors.begin() + count * kDescriptorLength);
  return voters;
}

int Votes(const Keyframe& keyframe, const FeatureSet& voters) {
  return static_cast<int>(MatchFeatures(voters, keyframe.features, kVoteRatio).size());
}

std::optional<Recognition> Recognise(const Keyframe& keyframe, std::uint64_t seed,
                                     const FeatureSet& features, const PoseOptions& options) {
  const std::vector<Match> matches = MatchFeatures(keyframe.features, features, kMatchRatio);
  if (static_cast<int>(matches.size()) < kLeastInliers) return std::nullopt;
  std::vector<PointSight> sights;
  for (const Match& match : matches) {
    sights.push_back(
        {keyframe.Point(match.a), features.features[static_cast<std::size_t>(match.b)].ray});
  }
  ResectionOptions resection;
  resection.threshold_rad = options.ransac_threshold_rad;
  resection.min_inliers =
      std::max(kLeastInliers,
               static_cast<int>(std::ceil(kLeastShare * static_cast<double>(matches.size()))));
  resection.max_iterations = kDraws;
  const auto found = EstimatePoseFromPoints(sights, seed, resection);
  if (!found) return std::nullopt;
  Recognition recognition;
  recognition.world_from_camera = found->world_from_camera;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const int i : found->inliers) {
    const Match& match = matches[static_cast<std::size_t>(i)];
    recognition.pairs.emplace_back(match.a, match.b);
    mean += sights[static_cast<std::size_t>(i)].ray;
  }
  mean /= static_cast<double>(found->inliers.size());
  if (mean.norm() > kMostConcentrated) return std::nullopt;
  return recognition;
}

}  // namespace omnihdr
