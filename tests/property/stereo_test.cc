#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <vector>

#include "core/stereo/fuse.h"
#include "core/stereo/view_merge.h"
#include "tests/property/generators.h"

namespace omnihdr::stereo_test {
namespace {

using testing::Between;

constexpr int kWidth = 32;
constexpr int kHeight = 16;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// One value of `choices` a pixel.
template <typename T>
Image<T> AnyOf(const std::vector<T>& choices) {
  const auto picks = *rc::gen::container<std::vector<std::size_t>>(
      static_cast<std::size_t>(kWidth * kHeight), rc::gen::inRange<std::size_t>(0, choices.size()));
  Image<T> image(kWidth, kHeight);
  for (std::size_t k = 0; k < picks.size(); ++k) image.data()[k] = choices[picks[k]];
  return image;
}

DisparityMap AnyMap(bool with_holes) {
  std::vector<float> choices = {0.0F, 0.05F, 0.2F, 0.21F, 0.9F};
  if (with_holes) choices.insert(choices.end(), {kNan, kNan});
  DisparityMap map;
  map.disparity = AnyOf(choices);
  map.confidence = AnyOf<float>({0.0F, 0.3F, 1.0F});
  return map;
}

Measurement AnyMeasurement() {
  Measurement m;
  m.projection = *rc::gen::element(Projection::Equirectangular(kWidth, kHeight),
                                   Projection::Cylindrical(kWidth, kHeight, -1.0, 1.5));
  m.flags = AnyOf<std::uint8_t>(
      {0, 0, 0, kSaturatedAny, kSaturatedB, kDarkAny, kDarkR, kMasked, kSaturatedR | kDarkB});
  const Image<float> values = AnyOf<float>({0.0F, 1e-4F, 0.3F, 1.0F, 50.0F, 3e4F});
  m.radiance = Image<float>(kWidth, kHeight, 4);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if ((m.flags.at(x, y) & kMasked) != 0) continue;
      for (int c = 0; c < 3; ++c) m.radiance.at(x, y, c) = values.at((x + c) % kWidth, y);
      m.radiance.at(x, y, 3) = m.flags.at(x, y) == 0 ? 1.0F : 0.0F;
    }
  }
  m.saturation = {2.0F, 2.0F, 2.0F};
  m.variance_floor = {1e-6F, 1e-6F, 1e-6F};
  m.variance_per_radiance = {1e-4F, 1e-4F, 1e-4F};
  m.noise_floor = 1e-3F;
  m.longest_exposure_s = m.shortest_exposure_s = 1.0;
  return m;
}

Eigen::Vector3f AnyOffset() {
  return (*Between(0.05, 1.5) * testing::AnyUnitVector()).cast<float>();
}

RC_GTEST_PROP(MergeLaw, RadianceIsANumberAndAbsentOnlyWhereNothingSawIt, ()) {
  const int count = *rc::gen::inRange(1, 5);
  std::vector<Measurement> measurements;
  std::vector<MergeSource> sources;
  for (int k = 0; k < count; ++k) measurements.push_back(AnyMeasurement());
  for (const Measurement& m : measurements) sources.push_back({&m, testing::AnyPose(), nullptr});
  const bool by_rotation = *rc::gen::arbitrary<bool>();
  if (by_rotation) {
    for (MergeSource& s : sources) s.world_from_camera.translation.setZero();
  }
  const DisparityMap map = AnyMap(true);
  const MergedView view =
      MergeViews(sources.front(), by_rotation ? nullptr : &map,
                 {sources.begin() + 1, sources.end()}, testing::AnyPose().rotation, 2 * kWidth, {});
  RC_ASSERT(view.radiance.width() == 2 * kWidth);
  for (int y = 0; y < view.radiance.height(); ++y) {
    for (int x = 0; x < view.radiance.width(); ++x) {
      const auto origin = static_cast<PixelOrigin>(view.origin.at(x, y));
      for (int c = 0; c < 3; ++c) {
        const float e = view.radiance.at(x, y, c);
        RC_ASSERT(std::isfinite(e));
        RC_ASSERT(e >= 0.0F);
        RC_ASSERT(origin != PixelOrigin::kNoData || e == 0.0F);
      }
      const float d = view.disparity.at(x, y);
      RC_ASSERT(std::isnan(d) || (d >= 0.0F && !by_rotation));
    }
  }
}

RC_GTEST_PROP(FuseLaw, AFusedValueLiesBetweenWhatTheMapsSay, ()) {
  const int count = *rc::gen::inRange(0, 4);
  const DisparityMap reference = AnyMap(true);
  std::vector<DisparityMap> maps;
  for (int k = 0; k < count; ++k) maps.push_back(AnyMap(true));
  std::vector<NeighbourMap> neighbours;
  std::vector<Image<float>> warped;
  for (const DisparityMap& map : maps) {
    neighbours.push_back({&map, AnyOffset()});
    warped.push_back(WarpDisparity(map, -neighbours.back().offset));
  }
  const DisparityMap fused = FuseDisparity(reference, neighbours, {});
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const float c = fused.confidence.at(x, y);
      RC_ASSERT(c >= 0.0F && c <= 1.0F);
      const float d = fused.disparity.at(x, y);
      if (std::isnan(d)) continue;
      float low = std::numeric_limits<float>::infinity();
      float high = -1.0F;
      const auto take = [&](float v) {
        if (std::isnan(v)) return;
        low = std::min(low, v);
        high = std::max(high, v);
      };
      take(reference.disparity.at(x, y));
      for (const Image<float>& w : warped) take(w.at(x, y));
      RC_ASSERT(d >= low * (1.0F - 1e-5F));
      RC_ASSERT(d <= high * (1.0F + 1e-5F));
    }
  }
}

RC_GTEST_PROP(FillLaw, EveryHoleIsFilledWithAKnownValueAndNothingElseChanges, ()) {
  DisparityMap map = AnyMap(true);
  const Image<float> before = map.disparity.Clone();
  const Image<std::uint8_t> brightness = AnyOf<std::uint8_t>({20, 100, 101, 240});
  FillHoles(brightness, {.reach = *rc::gen::inRange(1, 40), .colour_codes = 10.0F}, &map);
  std::set<float> known = {0.0F};
  for (const float d : before.values()) {
    if (!std::isnan(d)) known.insert(d);
  }
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const float d = map.disparity.at(x, y);
      RC_ASSERT(known.contains(d));
      if (std::isnan(before.at(x, y))) {
        RC_ASSERT(map.confidence.at(x, y) == 0.0F);
      } else {
        RC_ASSERT(d == before.at(x, y));
      }
    }
  }
}

RC_GTEST_PROP(WarpLaw, NothingLandsThatIsNotSomewhereInTheMap, ()) {
  const DisparityMap map = AnyMap(true);
  const Eigen::Vector3f offset = AnyOffset();
  const Image<float> warped = WarpDisparity(map, offset);
  // A surface at distance r lies between r - |b| and r + |b| from the other place.
  float nearest = 0.0F;
  for (const float d : map.disparity.values()) {
    if (!std::isnan(d)) nearest = std::max(nearest, d);
  }
  for (const float d : warped.values()) {
    if (std::isnan(d)) continue;
    RC_ASSERT(d >= 0.0F);
    RC_ASSERT(std::isfinite(d));
    if (nearest * offset.norm() < 0.99F) {
      RC_ASSERT(d <= 1.001F / (1.0F / nearest - offset.norm()));
    }
  }
}

}  // namespace
}  // namespace omnihdr::stereo_test
