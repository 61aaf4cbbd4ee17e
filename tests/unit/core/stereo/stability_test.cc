#include "core/stereo/stability.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::stability_test {
namespace {

using testing::Drive;
using testing::Share;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kWidth = testing::kMapWidth;
constexpr int kHeight = kWidth / 2;
constexpr std::size_t kCentre = 2;
constexpr auto kEverywhere = [](int, int) { return true; };

const Drive& TheDrive() {
  static const Drive drive = Drive::Through(testing::FurnishedRoom(), testing::FivePlaces(0.2));
  return drive;
}

struct Maps {
  std::vector<DisparityMap> maps;
  std::vector<NeighbourMap> neighbours;
  const DisparityMap& own() const { return maps[kCentre]; }
};
std::unique_ptr<Maps> TrueMaps() {
  auto m = std::make_unique<Maps>();
  for (std::size_t k = 0; k < 5; ++k) m->maps.push_back(TheDrive().TrueDisparity(k));
  for (const std::size_t n : {1U, 3U, 0U, 4U}) {
    m->neighbours.push_back({&m->maps[n], TheDrive().Offset(kCentre, n)});
  }
  return m;
}

bool IsRight(float found, float truth) { return std::abs(found - truth) < 0.06F * truth; }

// Whether place n does not see what the middle place sees at a pixel.
bool IsHidden(std::size_t n, int x, int y) {
  const Eigen::Vector3d here = TheDrive().poses[kCentre].translation;
  const Eigen::Vector3d there = TheDrive().poses[n].translation;
  const Eigen::Vector3d ray =
      Projection::Equirectangular(kWidth, kHeight).RayFromPixel(x + 0.5, y + 0.5);
  const Eigen::Vector3d point = here + ray * TheDrive().room.Look(here, ray).distance;
  const double distance = (point - there).norm();
  return TheDrive().room.Look(there, (point - there).normalized()).distance < 0.85 * distance;
}

TEST(CrossCheck, WhatANeighbourCannotSeeIsNotConfirmed) {
  const auto m = TrueMaps();
  const DisparityMap checked = CrossCheck(m->own(), {m->neighbours[3]}, {});
  const auto hidden = [](int x, int y) { return IsHidden(4, x, y); };
  ASSERT_GT(Share(kWidth, kHeight, kEverywhere, hidden), 0.005);
  EXPECT_GT(Share(kWidth, kHeight, hidden,
                  [&](int x, int y) { return std::isnan(checked.disparity.at(x, y)); }),
            0.9);
  EXPECT_GT(
      Share(
          kWidth, kHeight, [](int x, int y) { return !IsHidden(4, x, y); },
          [&](int x, int y) { return checked.disparity.at(x, y) == m->own().disparity.at(x, y); }),
      0.95);
}

TEST(CrossCheck, ConfidenceIsTheShareOfNeighboursThatConfirm) {
  const auto m = TrueMaps();
  DisparityMap wrong = TheDrive().TrueDisparity(1);
  for (float& d : wrong.disparity.values()) d *= 1.5F;
  const DisparityMap checked =
      CrossCheck(m->own(), {{&wrong, m->neighbours[0].offset}, m->neighbours[1]}, {});
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const float c = checked.confidence.at(x, y);
      ASSERT_TRUE(c == 0.0F || c == 0.5F || c == 1.0F);
      ASSERT_EQ(c == 0.0F, std::isnan(checked.disparity.at(x, y)));
    }
  }
  EXPECT_GT(Share(kWidth, kHeight, kEverywhere,
                  [&](int x, int y) { return checked.confidence.at(x, y) == 0.5F; }),
            0.85);
}

TEST(CrossCheck, AWrongDisparityIsUnknownAfterwards) {
  const auto m = TrueMaps();
  DisparityMap own = TheDrive().TrueDisparity(kCentre);
  for (int y = 40; y < 60; ++y) {
    for (int x = 30; x < 60; ++x) own.disparity.at(x, y) *= 2.0F;
  }
  const DisparityMap checked = CrossCheck(own, m->neighbours, {});
  int kept = 0;
  for (int y = 40; y < 60; ++y) {
    for (int x = 30; x < 60; ++x) kept += std::isnan(checked.disparity.at(x, y)) ? 0 : 1;
  }
  EXPECT_LT(kept, 30);
}

TEST(FuseByStability, TrueMapsStayTrue) {
  const auto m = TrueMaps();
  const DisparityMap fused = FuseByStability(m->own(), m->neighbours, {});
  EXPECT_GT(Share(kWidth, kHeight, kEverywhere,
                  [&](int x, int y) {
                    return IsRight(fused.disparity.at(x, y), m->own().disparity.at(x, y));
                  }),
            0.93);
}

TEST(FuseByStability, RejectsAnOutlierThatTheOthersSeeThrough) {
  const auto m = TrueMaps();
  DisparityMap own = TheDrive().TrueDisparity(kCentre);
  for (int y = 40; y < 60; ++y) {
    for (int x = 30; x < 60; ++x) own.disparity.at(x, y) = 0.9F;  // a ghost right before the camera
  }
  const DisparityMap fused = FuseByStability(own, m->neighbours, {});
  int right = 0;
  for (int y = 40; y < 60; ++y) {
    for (int x = 30; x < 60; ++x) {
      EXPECT_NE(fused.disparity.at(x, y), 0.9F);
      right += IsRight(fused.disparity.at(x, y), m->own().disparity.at(x, y)) ? 1 : 0;
    }
  }
  EXPECT_GT(right, 540);  // of 600: the neighbours' candidates take its place
}

TEST(FuseByStability, TakesTheNearestCandidateThatIsStable) {
  // Far away no parallax is left, so each map speaks about the same pixel. Two say 0.02, two 0.01:
  // the nearer has nothing in front (0) and is seen through by two (-2); the farther has two in
  // front and is seen through by none.
  AgreementOptions options;
  options.tolerance = 1e-3;
  const auto even = [](float d) {
    DisparityMap map;
    map.disparity = Image<float>(kWidth, kHeight, 1, d);
    map.confidence = Image<float>(kWidth, kHeight, 1, 1.0F);
    return map;
  };
  const DisparityMap near = even(0.02F);
  const DisparityMap far = even(0.01F);
  const Eigen::Vector3f offset(1e-3F, 0.0F, 0.0F);
  const DisparityMap fused =
      FuseByStability(near, {{&near, offset}, {&far, offset}, {&far, -offset}}, options);
  EXPECT_NEAR(fused.disparity.at(10, 64), 0.01F, 1e-4F);
  EXPECT_NEAR(fused.confidence.at(10, 64), 0.5F, 1e-6F);
  // One against one: the nearer one is seen through once (-1), the farther is behind one (1).
  const DisparityMap two = FuseByStability(near, {{&far, offset}}, options);
  EXPECT_NEAR(two.disparity.at(10, 64), 0.01F, 1e-4F);
  // Where the far map knows nothing, nothing contradicts the near one.
  const DisparityMap nothing = even(kNan);
  const DisparityMap alone = FuseByStability(near, {{&nothing, offset}}, options);
  EXPECT_NEAR(alone.disparity.at(10, 64), 0.02F, 1e-4F);
}

TEST(FuseByStability, OfNothingIsNothing) {
  DisparityMap nothing;
  nothing.disparity = Image<float>(kWidth, kHeight, 1, kNan);
  nothing.confidence = Image<float>(kWidth, kHeight);
  const DisparityMap fused =
      FuseByStability(nothing, {{&nothing, Eigen::Vector3f(0.1F, 0.0F, 0.0F)}}, {});
  for (const float d : fused.disparity.values()) ASSERT_TRUE(std::isnan(d));
  for (const float c : fused.confidence.values()) ASSERT_EQ(c, 0.0F);
}

TEST(FuseCrossChecked, AFarOutlierOfOneMapDoesNotPullTheViewBack) {
  // Without the cross-check a too distant value is behind the others and therefore stable.
  const auto m = TrueMaps();
  DisparityMap own = TheDrive().TrueDisparity(kCentre);
  for (int y = 40; y < 60; ++y) {
    for (int x = 30; x < 60; ++x) own.disparity.at(x, y) *= 0.3F;
  }
  const DisparityMap fused = FuseCrossChecked(own, {m->neighbours[0], m->neighbours[1]}, {});
  int wrong = 0;
  for (int y = 40; y < 60; ++y) {
    for (int x = 30; x < 60; ++x) {
      const float d = fused.disparity.at(x, y);
      wrong += !std::isnan(d) && !IsRight(d, m->own().disparity.at(x, y)) ? 1 : 0;
    }
  }
  EXPECT_LT(wrong, 30);
}

}  // namespace
}  // namespace omnihdr::stability_test
