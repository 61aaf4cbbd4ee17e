#include "core/stereo/fuse.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::fuse_test {
namespace {

using testing::Drive;
using testing::Share;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kWidth = testing::kMapWidth;
constexpr int kHeight = kWidth / 2;

DisparityMap Even(float disparity, float confidence = 1.0F) {
  DisparityMap map;
  map.disparity = Image<float>(kWidth, kHeight, 1, disparity);
  map.confidence = Image<float>(kWidth, kHeight, 1, confidence);
  return map;
}

const Drive& TheDrive() {
  static const Drive drive = Drive::Through(testing::FurnishedRoom(), testing::FivePlaces(0.2));
  return drive;
}

TEST(WarpDisparity, WithoutMovingEverythingStays) {
  const DisparityMap map = TheDrive().TrueDisparity(2);
  const Image<float> warped = WarpDisparity(map, Eigen::Vector3f::Zero());
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      EXPECT_FLOAT_EQ(warped.at(x, y), map.disparity.at(x, y));
    }
  }
}

TEST(WarpDisparity, PutsTheRoomWhereItIsSeenFromAnotherPlace) {
  const DisparityMap here = TheDrive().TrueDisparity(2);
  const DisparityMap there = TheDrive().TrueDisparity(4);
  const Image<float> warped = WarpDisparity(here, TheDrive().Offset(2, 4));
  const auto landed = [&](int x, int y) { return !std::isnan(warped.at(x, y)); };
  EXPECT_GT(Share(
                kWidth, kHeight, [](int, int) { return true; }, landed),
            0.75);
  const double right = Share(kWidth, kHeight, landed, [&](int x, int y) {
    const float truth = there.disparity.at(x, y);
    return std::abs(warped.at(x, y) - truth) < 0.06F * truth;
  });
  EXPECT_GT(right, 0.95);
}

TEST(WarpDisparity, ThereAndBackIsWhereItWas) {
  const DisparityMap here = TheDrive().TrueDisparity(2);
  const Eigen::Vector3f offset = TheDrive().Offset(2, 3);
  DisparityMap there;
  there.disparity = WarpDisparity(here, offset);
  there.confidence = Image<float>(kWidth, kHeight, 1, 1.0F);
  const Image<float> back = WarpDisparity(there, -offset);
  const double same = Share(
      kWidth, kHeight, [&](int x, int y) { return !std::isnan(back.at(x, y)); },
      [&](int x, int y) {
        return std::abs(back.at(x, y) - here.disparity.at(x, y)) < 0.06F * here.disparity.at(x, y);
      });
  EXPECT_GT(same, 0.95);
}

TEST(WarpDisparity, TheNearestSurfaceWins) {
  // Everything far, but for a near patch: seen from the side it covers what lies behind.
  DisparityMap map = Even(0.1F);
  for (int y = 60; y < 68; ++y) {
    for (int x = 60; x < 68; ++x) map.disparity.at(x, y) = 0.5F;
  }
  const Eigen::Vector3f offset(0.4F, 0.0F,
                               0.0F);  // a quarter of the way round from the patch's side
  const Image<float> warped = WarpDisparity(map, offset);
  const Projection grid = Projection::Equirectangular(kWidth, kHeight);
  const Eigen::Vector3f v = grid.RayFromPixel(64.5, 64.5).cast<float>() - 0.5F * offset;
  const Eigen::Vector2d at = grid.PixelFromRay(v.cast<double>());
  EXPECT_NEAR(warped.at(static_cast<int>(at.x()), static_cast<int>(at.y())), 0.5F / v.norm(),
              0.02F);
}

TEST(WarpDisparity, WhatIsUnknownStaysUnknown) {
  const Image<float> warped = WarpDisparity(Even(kNan), {0.3F, 0.0F, 0.0F});
  for (const float d : warped.values()) EXPECT_TRUE(std::isnan(d));
}

TEST(WarpDisparity, InfinityDoesNotMove) {
  const Image<float> warped = WarpDisparity(Even(0.0F), {5.0F, 1.0F, -2.0F});
  for (const float d : warped.values()) EXPECT_EQ(d, 0.0F);
}

// Maps of the five places and the middle one's neighbours.
struct Maps {
  std::vector<DisparityMap> maps;
  std::vector<NeighbourMap> neighbours;
};
Maps TrueMaps() {
  Maps m;
  for (std::size_t k = 0; k < 5; ++k) m.maps.push_back(TheDrive().TrueDisparity(k));
  for (const std::size_t n : {1U, 3U, 0U, 4U}) {
    m.neighbours.push_back({&m.maps[n], TheDrive().Offset(2, n)});
  }
  return m;
}

TEST(FuseDisparity, TrueMapsStayTrue) {
  const Maps m = TrueMaps();
  const DisparityMap fused = FuseDisparity(m.maps[2], m.neighbours, {});
  const double right = Share(
      kWidth, kHeight, [](int, int) { return true; },
      [&](int x, int y) {
        const float truth = m.maps[2].disparity.at(x, y);
        return std::abs(fused.disparity.at(x, y) - truth) < 0.05F * truth + 0.005F;
      });
  EXPECT_GT(right, 0.97);
  for (const float c : fused.confidence.values()) {
    ASSERT_GE(c, 0.0F);
    ASSERT_LE(c, 1.0F);
  }
}

TEST(FuseDisparity, AnOutlierGivesWayToWhatTheOthersSay) {
  Maps m = TrueMaps();
  const DisparityMap truth = TheDrive().TrueDisparity(2);
  int planted = 0;
  for (int y = 12; y < kHeight - 12; y += 6) {
    for (int x = 3; x < kWidth; x += 6) {
      m.maps[2].disparity.at(x, y) = planted % 2 == 0 ? 2.5F * truth.disparity.at(x, y) : 0.01F;
      ++planted;
    }
  }
  const DisparityMap fused = FuseDisparity(m.maps[2], m.neighbours, {});
  int kept = 0;
  int corrected = 0;
  for (int y = 12; y < kHeight - 12; y += 6) {
    for (int x = 3; x < kWidth; x += 6) {
      const float d = fused.disparity.at(x, y);
      const float t = truth.disparity.at(x, y);
      corrected += std::abs(d - t) < 0.06F * t ? 1 : 0;
      kept += std::abs(d - m.maps[2].disparity.at(x, y)) < 0.02F * t ? 1 : 0;
    }
  }
  EXPECT_LT(kept, planted / 20);
  EXPECT_GT(corrected, planted * 9 / 10);
}

TEST(FuseDisparity, AValueNobodySupportsAndOthersSeeThroughBecomesAHole) {
  // The reference claims a near wall everywhere; both neighbours look through it into nothing known
  // at all near the reference's own rays.
  const DisparityMap reference = Even(0.5F, 0.2F);
  const DisparityMap far = Even(0.02F);
  const std::vector<NeighbourMap> neighbours = {{&far, {0.3F, 0.0F, 0.0F}},
                                                {&far, {-0.3F, 0.0F, 0.0F}}};
  const DisparityMap fused = FuseDisparity(reference, neighbours, {});
  const double near = Share(
      kWidth, kHeight, [](int, int) { return true; },
      [&](int x, int y) { return fused.disparity.at(x, y) > 0.4F; });
  EXPECT_EQ(near, 0.0);
}

TEST(FuseDisparity, FillsAHoleOfTheReferenceFromTheNeighbours) {
  Maps m = TrueMaps();
  const DisparityMap truth = TheDrive().TrueDisparity(2);
  for (int y = 50; y < 70; ++y) {
    for (int x = 100; x < 130; ++x) m.maps[2].disparity.at(x, y) = kNan;
  }
  const DisparityMap fused = FuseDisparity(m.maps[2], m.neighbours, {});
  int right = 0;
  for (int y = 50; y < 70; ++y) {
    for (int x = 100; x < 130; ++x) {
      const float t = truth.disparity.at(x, y);
      right += std::abs(fused.disparity.at(x, y) - t) < 0.06F * t ? 1 : 0;
    }
  }
  EXPECT_GT(right, 20 * 30 * 9 / 10);
}

TEST(FuseDisparity, WhereNothingIsKnownItStaysUnknown) {
  const DisparityMap none = Even(kNan);
  const DisparityMap fused = FuseDisparity(none, {{&none, {0.3F, 0.0F, 0.0F}}}, {});
  for (const float d : fused.disparity.values()) ASSERT_TRUE(std::isnan(d));
  for (const float c : fused.confidence.values()) ASSERT_EQ(c, 0.0F);
}

TEST(FuseDisparity, AloneAMapKeepsItsValues) {
  const DisparityMap own = TheDrive().TrueDisparity(2);
  const DisparityMap fused = FuseDisparity(own, {}, {});
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_FLOAT_EQ(fused.disparity.at(x, y), own.disparity.at(x, y));
    }
  }
}

Image<std::uint8_t> EvenBrightness(std::uint8_t code = 100) { return {kWidth, kHeight, 1, code}; }

TEST(FillHoles, LeavesWhatIsKnownAlone) {
  DisparityMap map = TheDrive().TrueDisparity(2);
  for (int y = 40; y < 80; ++y) {
    for (int x = 40; x < 80; ++x) map.disparity.at(x, y) = kNan;
  }
  const Image<float> before = map.disparity.Clone();
  FillHoles(EvenBrightness(), {}, &map);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_GE(map.disparity.at(x, y), 0.0F);
      if (std::isnan(before.at(x, y))) {
        EXPECT_EQ(map.confidence.at(x, y), 0.0F);
      } else {
        EXPECT_EQ(map.disparity.at(x, y), before.at(x, y));
        EXPECT_EQ(map.confidence.at(x, y), 1.0F);
      }
    }
  }
}

TEST(FillHoles, TakesTheFartherOfTwoEquallyLikelyRims) {
  // A near wall to the left, a far one to the right, a gap between: what a near edge hid is far.
  DisparityMap map = Even(0.6F);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 100; x < 160; ++x) map.disparity.at(x, y) = x < 110 ? kNan : 0.1F;
  }
  FillHoles(EvenBrightness(), {}, &map);
  for (int y = 20; y < 100; ++y) EXPECT_FLOAT_EQ(map.disparity.at(105, y), 0.1F);
}

TEST(FillHoles, TakesTheRimThatLooksTheSame) {
  DisparityMap map = Even(0.6F);
  Image<std::uint8_t> brightness = EvenBrightness(200);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 100; x < 160; ++x) {
      map.disparity.at(x, y) = x < 110 ? kNan : 0.1F;
      if (x >= 110) brightness.at(x, y) = 40;
    }
  }
  FillHoles(brightness, {}, &map);
  for (int y = 20; y < 100; ++y) EXPECT_FLOAT_EQ(map.disparity.at(105, y), 0.6F);
}

TEST(FillHoles, IsNeverABlendOfTwoSurfaces) {
  DisparityMap map = Even(0.6F);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 100; x < 160; ++x) map.disparity.at(x, y) = x < 120 ? kNan : 0.1F;
  }
  FillHoles(EvenBrightness(), {}, &map);
  for (const float d : map.disparity.values()) EXPECT_TRUE(d == 0.6F || d == 0.1F) << d;
}

TEST(FillHoles, LooksAcrossTheSeam) {
  DisparityMap map = Even(kNan);
  for (int y = 0; y < kHeight; ++y) map.disparity.at(kWidth - 4, y) = 0.3F;
  FillHoles(EvenBrightness(), {.reach = 10, .colour_codes = 10.0F}, &map);
  EXPECT_FLOAT_EQ(map.disparity.at(3, 60), 0.3F);
  EXPECT_FLOAT_EQ(map.disparity.at(40, 60), 0.0F);  // out of reach: as if at infinity
}

TEST(FillHoles, WithNothingKnownAnywhereAllIsAtInfinity) {
  DisparityMap map = Even(kNan);
  FillHoles(EvenBrightness(), {}, &map);
  for (const float d : map.disparity.values()) ASSERT_EQ(d, 0.0F);
  for (const float c : map.confidence.values()) ASSERT_EQ(c, 0.0F);
}

TEST(MapBrightness, IsTheMeanCodeAtEachPixelsCentre) {
  const Measurement m = testing::Perfect(Image<float>(kWidth, kHeight, 3, 0.5F),
                                         Projection::Equirectangular(kWidth, kHeight));
  const LogScale scale = LogScale::For(1e-3F, 10.0F);
  const StereoView view = MakeStereoView(m, Eigen::Quaterniond::Identity(), 2 * kWidth, scale);
  const Image<std::uint8_t> brightness = MapBrightness(view);
  ASSERT_EQ(brightness.width(), kWidth);
  ASSERT_EQ(brightness.height(), kHeight);
  const float code = 1.0F + (std::log(0.5F + scale.floor) - scale.ln_black) * scale.codes_per_ln;
  for (const std::uint8_t b : brightness.values()) ASSERT_NEAR(b, code, 1.0F);
}

}  // namespace
}  // namespace omnihdr::fuse_test
