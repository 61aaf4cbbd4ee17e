#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/stereo/view_merge.h"
#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::view_merge_methods_test {
namespace {

constexpr int kWidth = 128;
constexpr int kHeight = 64;

// An even scene of radiance `e`, measured with an exposure that saturates at `saturation`.
Measurement Even(float e, float saturation) {
  Measurement m = testing::Perfect(Image<float>(kWidth, kHeight, 3, e),
                                   Projection::Equirectangular(kWidth, kHeight));
  m.saturation = {saturation, saturation, saturation};
  return m;
}

// The method of the thesis: neither agreement nor occlusion is asked for.
MergeOptions Plain(MergeWeights weights) {
  MergeOptions options;
  options.weights = weights;
  options.consistency = false;
  options.occlusion = false;
  options.refine_exposure = false;
  return options;
}

MergedView MergeAtOnePlace(const Measurement& own, const Measurement& other,
                           const MergeOptions& options) {
  return MergeViews({&own, Pose{}, nullptr}, nullptr, {{&other, Pose{}, nullptr}},
                    Eigen::Quaterniond::Identity(), kWidth, options);
}

TEST(MergeWithHat, SamplesCountByHowFarTheirValueIsFromBothEnds) {
  const Measurement own = Even(0.2F, 1.0F);     // hat 0.2
  const Measurement other = Even(0.25F, 0.5F);  // hat 0.5
  const MergedView view = MergeAtOnePlace(own, other, Plain(MergeWeights::kHat));
  const float expected = (0.2F * 0.2F + 0.5F * 0.25F) / 0.7F;
  EXPECT_NEAR(view.radiance.at(40, 30, 1), expected, 1e-4F);
}

TEST(MergeWithHat, DarkValuesCountOnlyWhereThereIsNothingElse) {
  Measurement own = Even(0.2F, 1.0F);
  for (std::uint8_t& f : own.flags.values()) f = kDarkAny;
  const Measurement other = Even(0.25F, 0.5F);
  EXPECT_NEAR(MergeAtOnePlace(own, other, Plain(MergeWeights::kHat)).radiance.at(40, 30, 1), 0.25F,
              1e-4F);
  EXPECT_NEAR(MergeAtOnePlace(own, own, Plain(MergeWeights::kHat)).radiance.at(40, 30, 1), 0.2F,
              1e-4F);
}

TEST(MergeWithoutConsistency, WhatDisagreesIsAveragedIn) {
  const Measurement own = Even(0.2F, 1.0F);
  const Measurement other = Even(0.6F, 1.0F);  // something else stood there
  EXPECT_NEAR(MergeAtOnePlace(own, other, Plain(MergeWeights::kHat)).radiance.at(40, 30, 1),
              (0.2F * 0.2F + 0.4F * 0.6F) / 0.6F, 1e-4F);
}

// An even scene clipped in both views, the other one's exposure shorter; a disparity map that is
// wrong at many single pixels and so hides others from the other view. Share of pixels that read
// the shorter exposure's bound.
double ShareOfShorterBound(float confidence, float others_saturation) {
  DisparityMap map;
  map.disparity = Image<float>(kWidth, kHeight, 1, 0.05F);
  map.confidence = Image<float>(kWidth, kHeight, 1, confidence);
  for (int y = 1; y < kHeight; y += 3) {
    for (int x = y % 4; x < kWidth; x += 4) map.disparity.at(x, y) = 0.8F;
  }
  const auto clipped = [](float saturation) {
    Measurement m = Even(saturation, saturation);
    std::fill(m.flags.values().begin(), m.flags.values().end(), kSaturatedAny);
    return m;
  };
  const Measurement own = clipped(1.0F);
  const Measurement other = clipped(others_saturation);
  Pose there;
  there.translation = {0.3, 0.0, 0.0};
  const MergedView view = MergeViews({&own, Pose{}, nullptr}, &map, {{&other, there, nullptr}},
                                     Eigen::Quaterniond::Identity(), kWidth, MergeOptions{});
  int count = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      EXPECT_EQ(static_cast<PixelOrigin>(view.origin.at(x, y)), PixelOrigin::kClipped);
      count += std::abs(view.radiance.at(x, y, 1) - std::max(1.0F, others_saturation)) < 1e-3F;
    }
  }
  return static_cast<double>(count) / (kWidth * kHeight);
}

TEST(MergeOfClippedPixels, ABoundCountsAlsoWhereAnUnsureDisparityHidesIt) {
  EXPECT_EQ(ShareOfShorterBound(0.5F, 4.0F), 1.0);
  EXPECT_LT(ShareOfShorterBound(1.0F, 4.0F), 0.95);  // a sure one hides
  EXPECT_EQ(ShareOfShorterBound(0.5F, 0.3F), 1.0);   // a longer exposure's bound says nothing
}

// A wall that saturates the own frame, with what `at` says along each row, as an exposure that
// saturates at `saturation` measures it.
template <typename At>
Measurement Rows(float saturation, const At& at) {
  Measurement m = Even(0.0F, saturation);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const float e = at(x);
      for (int c = 0; c < 3; ++c) m.radiance.pixel(x, y)[c] = std::min(e, saturation);
      if (e >= saturation) m.flags.at(x, y) = kSaturatedAny;
    }
  }
  return m;
}

TEST(MergeOfClippedPixels, OnTheRimTheOthersSayOnlyWhatThePartThatClippedWas) {
  const Measurement own = Rows(1.0F, [](int x) { return x == 40 ? 0.1F : 3.0F; });
  // So far from its place in the other view that this shows the wall all over.
  const Measurement other = Rows(8.0F, [](int) { return 3.0F; });
  // Output pixels lie a quarter of a pixel beside the frames'.
  const Eigen::Quaterniond turned(
      Eigen::AngleAxisd(0.25 * 2.0 * std::numbers::pi / kWidth, Eigen::Vector3d::UnitZ()));
  const MergedView view = MergeViews({&own, Pose{}, nullptr}, nullptr, {{&other, Pose{}, nullptr}},
                                     turned, kWidth, MergeOptions{});
  EXPECT_NEAR(view.radiance.at(38, 32, 1), 3.0F, 0.02F);
  EXPECT_NEAR(view.radiance.at(40, 32, 1), 0.75F * 0.1F + 0.25F * 3.0F, 0.05F);
  EXPECT_NEAR(view.radiance.at(41, 32, 1), 0.25F * 0.1F + 0.75F * 3.0F, 0.05F);
  EXPECT_EQ(view.sources.at(40, 32) & 1, 1);
}

TEST(MergeOfClippedPixels, AnEdgeBesideThemThatIsHalfAPixelOffDoesNotBringTheOtherIntoDiscredit) {
  const auto scene = [](float edge) {  // of the second pixel of eight, in every fourth block
    return [edge](int x) {
      if (x % 32 == 1) return edge;
      return x % 8 == 0 ? 0.05F : (x % 8 < 5 ? 0.9F : 3.0F);
    };
  };
  const Measurement own = Rows(1.0F, scene(0.9F));
  const Measurement other = Rows(8.0F, scene(0.475F));
  const MergedView view = MergeAtOnePlace(own, other, MergeOptions{});
  EXPECT_NEAR(view.radiance.at(38, 32, 1), 3.0F, 0.1F);
}

TEST(MergeOfClippedPixels, WhatIsDarkerAllOverABlockIsNotTheSameSurface) {
  const auto scene = [](float level) {
    return [level](int x) { return x % 8 < 4 ? level : 3.0F; };
  };
  const Measurement own = Rows(1.0F, scene(0.5F));
  const Measurement other = Rows(8.0F, scene(0.1F));
  const MergedView view = MergeAtOnePlace(own, other, MergeOptions{});
  EXPECT_NEAR(view.radiance.at(42, 32, 1), 0.5F, 0.05F);
}

TEST(MergeWithoutOcclusion, WhatIsHiddenIsTakenFromWhatHidesIt) {
  // Far surroundings and a near post; the other view is brighter everywhere.
  DisparityMap map;
  map.disparity = Image<float>(kWidth, kHeight, 1, 0.05F);
  map.confidence = Image<float>(kWidth, kHeight, 1, 1.0F);
  for (int y = 16; y < 48; ++y) {
    for (int x = 28; x < 36; ++x) map.disparity.at(x, y) = 0.8F;
  }
  const Measurement own = Even(0.2F, 1.0F);
  const Measurement other = Even(0.6F, 1.0F);
  Pose there;
  there.translation = {0.3, 0.0, 0.0};
  const auto untouched = [&](bool occlusion) {
    MergeOptions options = Plain(MergeWeights::kHat);
    options.occlusion = occlusion;
    const MergedView view = MergeViews({&own, Pose{}, nullptr}, &map, {{&other, there, nullptr}},
                                       Eigen::Quaterniond::Identity(), kWidth, options);
    int count = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        count += std::abs(view.radiance.at(x, y, 1) - 0.2F) < 1e-4F ? 1 : 0;
      }
    }
    return count;
  };
  EXPECT_GT(untouched(true), 50);
  EXPECT_EQ(untouched(false), 0);
}

}  // namespace
}  // namespace omnihdr::view_merge_methods_test
