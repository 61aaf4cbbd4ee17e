#include "core/stereo/cost_volume.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "core/stereo/sgm.h"

namespace omnihdr::cost_volume_test {
namespace {

constexpr int kLabels = 96;
constexpr double kMaxDisparity = 0.95;
constexpr double kStep = kMaxDisparity / (kLabels - 1);

DisparityMap Guide(int width, int height, double label, float confidence = 1.0F) {
  DisparityMap guide;
  guide.disparity = Image<float>(width, height, 1, static_cast<float>(label * kStep));
  guide.confidence = Image<float>(width, height, 1, confidence);
  return guide;
}

TEST(CostVolume, WithoutRangesHasEveryLabelAtEveryPixel) {
  const CostVolume volume = CostVolume::Allocate(70, 3, 10, 0.9, {});
  EXPECT_EQ(volume.cost.size(), 70U * 3U * 10U);
  EXPECT_NEAR(volume.step, 0.1, 1e-12);
  EXPECT_EQ(volume.offset(69, 2), (2U * 70U + 69U) * 10U);
  EXPECT_EQ(volume.range(69, 2), (LabelRange{0, 10}));
}

TEST(CostVolume, PixelsOfTilesOfDifferentRangesFollowEachOther) {
  // 40 columns: a whole tile and one of eight columns.
  const CostVolume volume = CostVolume::Allocate(40, 2, 16, 1.0, {{0, 8}, {8, 8}, {0, 16}, {4, 8}});
  EXPECT_EQ(volume.offset(31, 0), 31U * 8U);
  EXPECT_EQ(volume.offset(32, 0), 32U * 8U);
  EXPECT_EQ(volume.offset(0, 1), 40U * 8U);
  EXPECT_EQ(volume.offset(1, 1), 40U * 8U + 16U);
  EXPECT_EQ(volume.range(39, 1), (LabelRange{4, 8}));
  EXPECT_EQ(volume.cost.size(), 40U * 8U + 32U * 16U + 8U * 8U);
}

TEST(RangesAround, AreNarrowAroundAnEvenGuideAndWholeTilesOfLabels) {
  RangeOptions options;
  options.margin = 4.0;
  const auto ranges = RangesAround(Guide(128, 64, 40), 128, 64, kLabels, kMaxDisparity, options);
  ASSERT_EQ(ranges.size(), 4U * 64U);
  for (const LabelRange& range : ranges) {
    EXPECT_EQ(range.count % kTileLabels, 0);
    EXPECT_LE(range.count, 16);
    EXPECT_LE(range.first, 36);
    EXPECT_GE(range.first + range.count, 45);
  }
}

TEST(RangesAround, AreWiderWhereTheGuideIsNotConfident) {
  const auto width_of = [](float confidence) {
    return RangesAround(Guide(64, 32, 40, confidence), 64, 32, kLabels, kMaxDisparity,
                        {.margin = 4.0, .more_margin = 16.0})[0]
        .count;
  };
  EXPECT_GT(width_of(0.0F), width_of(1.0F) + 16);
}

TEST(RangesAround, StayAmongTheLabelsAtBothEnds) {
  for (const double label : {0.0, 95.0, 120.0}) {
    for (const LabelRange& range :
         RangesAround(Guide(64, 32, label), 128, 64, kLabels, kMaxDisparity, RangeOptions{})) {
      EXPECT_GE(range.first, 0);
      EXPECT_GT(range.count, 0);
      EXPECT_LE(range.first + range.count, kLabels);
    }
  }
}

// Whatever the guide, what it says of a pixel, and of those around it, is searched at that pixel.
TEST(RangesAround, HoldWhatTheGuideSaysAroundEveryPixel) {
  std::mt19937 random(7);
  for (const int scale : {1, 2}) {
    constexpr int kWidth = 192;
    constexpr int kHeight = 96;
    DisparityMap guide = Guide(kWidth / scale, kHeight / scale, 20);
    // Patches at any distance, across the seam too.
    for (int k = 0; k < 30; ++k) {
      const auto x0 = static_cast<int>(random() % static_cast<unsigned>(kWidth / scale));
      const auto y0 = static_cast<int>(random() % static_cast<unsigned>(kHeight / scale - 6));
      const auto d = static_cast<float>((random() % kLabels) * kStep);
      for (int y = y0; y < y0 + 6; ++y) {
        for (int x = x0; x < x0 + 9; ++x) guide.disparity.at(x % (kWidth / scale), y) = d;
      }
    }
    RangeOptions options;
    options.reach = 1;
    options.margin = 2.0;
    const CostVolume volume =
        CostVolume::Allocate(kWidth, kHeight, kLabels, kMaxDisparity,
                             RangesAround(guide, kWidth, kHeight, kLabels, kMaxDisparity, options));
    EXPECT_LT(volume.cost.size(), static_cast<std::size_t>(kWidth) * kHeight * kLabels * 3 / 4);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const LabelRange& range = volume.range(x, y);
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            const int gx = (x / scale + dx + kWidth / scale) % (kWidth / scale);
            const int gy = std::clamp(y / scale + dy, 0, kHeight / scale - 1);
            const double label = guide.disparity.at(gx, gy) / kStep;
            ASSERT_LE(range.first, std::max(0.0, label - 1.99)) << x << ", " << y;
            ASSERT_GE(range.first + range.count - 1, std::min(kLabels - 1.0, label + 1.99));
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace omnihdr::cost_volume_test
