#include "core/stereo/sweep.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/base/parallel_for.h"
#include "core/stereo/sgm.h"
#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::sweep_test {
namespace {

using testing::Drive;
using testing::Share;

constexpr std::size_t kCentre = 2;
constexpr int kLabels = 64;
constexpr double kMaxDisparity = 0.8;
constexpr double kStep = kMaxDisparity / (kLabels - 1);

// Rendered once for all tests.
const Drive& TheDrive() {
  static const Drive drive = Drive::Through(testing::FurnishedRoom(), testing::FivePlaces());
  return drive;
}
const DisparityMap& TheTruth() {
  static const DisparityMap map = TheDrive().TrueDisparity(kCentre);
  return map;
}

// Matches the third place with the others, each exposed for its own time; 0 leaves noise, range and
// rounding out.
struct Matching {
  std::vector<Measurement> measurements;
  std::vector<StereoView> views;
  CostVolume volume;
  DisparityMap map;
};

SweepOptions WithLabels() {
  SweepOptions options;
  options.labels = kLabels;
  return options;
}

Matching Match(const std::vector<double>& seconds, const SweepOptions& base = WithLabels(),
               ImageView<const std::uint8_t> mask = {}) {
  const Drive& drive = TheDrive();
  Matching matching;
  float floor = 1e9F;
  float brightest = 0.0F;
  for (std::size_t k = 0; k < 5; ++k) {
    const Image<float>& radiance = drive.truths[k].radiance;
    matching.measurements.push_back(
        seconds[k] == 0.0 ? testing::Perfect(radiance, drive.projection)
                          : testing::MeasureOne(testing::Expose(radiance, seconds[k],
                                                                static_cast<std::uint32_t>(k) + 1),
                                                seconds[k], drive.projection, {}, mask));
    floor = std::min(floor, matching.measurements.back().noise_floor);
    brightest = std::max(brightest, matching.measurements.back().saturation[1]);
  }
  const LogScale scale = LogScale::For(floor, seconds[kCentre] == 0.0 ? 20.0F : brightest);
  for (const Measurement& m : matching.measurements) {
    matching.views.push_back(
        MakeStereoView(m, Eigen::Quaterniond::Identity(), 2 * testing::kMapWidth, scale));
  }
  std::vector<SweepNeighbour> neighbours;
  for (const std::size_t n : {1U, 3U, 0U, 4U}) {
    neighbours.push_back({&matching.views[n], drive.Offset(kCentre, n)});
  }
  SweepOptions options = base;
  options.max_disparity = kMaxDisparity;
  matching.volume = SweepCosts(matching.views[kCentre], neighbours, options);
  matching.map = OptimiseSemiGlobal(matching.volume, matching.views[kCentre], {});
  return matching;
}

int BestLabel(const CostVolume& volume, int x, int y) {
  const std::uint8_t* cost = volume.at(x, y);
  return static_cast<int>(std::min_element(cost, cost + volume.labels) - cost);
}

// Parallax vanishes where one looks along the drive: no method tells distance there.
bool HasParallax(int x, int y) {
  const Eigen::Vector3d ray =
      Projection::Equirectangular(testing::kMapWidth, testing::kMapWidth / 2)
          .RayFromPixel(x + 0.5, y + 0.5);
  return std::hypot(ray.y(), ray.z()) > 0.5;
}

// Share of pixels with parallax whose cheapest label is within `labels` of the truth.
template <typename Counts>
double ShareOfRightLabels(const CostVolume& volume, int labels, Counts counts) {
  return Share(
      volume.width, volume.height, [&](int x, int y) { return HasParallax(x, y) && counts(x, y); },
      [&](int x, int y) {
        return std::abs(BestLabel(volume, x, y) - TheTruth().disparity.at(x, y) / kStep) <= labels;
      });
}

template <typename Counts>
double ShareOfRightDisparities(const DisparityMap& map, Counts counts) {
  return Share(
      map.disparity.width(), map.disparity.height(),
      [&](int x, int y) { return HasParallax(x, y) && counts(x, y); },
      [&](int x, int y) {
        const float truth = TheTruth().disparity.at(x, y);
        return std::abs(map.disparity.at(x, y) - truth) <= 0.05F * truth + 0.01F;
      });
}

constexpr auto kEverywhere = [](int, int) { return true; };

TEST(SweepCosts, HaveTheSizeOfHalfTheLatticeAndTheStepAskedFor) {
  const Matching m = Match({0, 0, 0, 0, 0});
  EXPECT_EQ(m.volume.width, testing::kMapWidth);
  EXPECT_EQ(m.volume.height, testing::kMapWidth / 2);
  EXPECT_EQ(m.volume.labels, kLabels);
  EXPECT_NEAR(m.volume.step * (kLabels - 1), kMaxDisparity, 1e-12);
  EXPECT_EQ(m.volume.cost.size(), static_cast<std::size_t>(m.volume.width) *
                                      static_cast<std::size_t>(m.volume.height) *
                                      static_cast<std::size_t>(kLabels));
}

TEST(SweepCosts, AreLeastAtTheTrueDistanceOfMostPixels) {
  const Matching m = Match({0, 0, 0, 0, 0});
  const double right = ShareOfRightLabels(m.volume, 2, kEverywhere);
  RecordProperty("right_labels", fmt::format("{:.3f}", right));
  EXPECT_GT(right, 0.75);
}

TEST(SweepCosts, AreLeastAtTheTrueDistanceAcrossExposuresToo) {
  const Matching m = Match({0.5, 1.0, 0.25, 0.5, 1.0});
  const double right = ShareOfRightLabels(m.volume, 2, kEverywhere);
  RecordProperty("right_labels", fmt::format("{:.3f}", right));
  EXPECT_GT(right, 0.55);
}

TEST(SweepCosts, WhereTheReferenceIsSaturatedItsNeighboursMatchEachOther) {
  const Matching m = Match({0.25, 0.25, 6.0, 0.25, 0.25});
  const auto saturated = [&](int x, int y) {
    return (m.measurements[kCentre].flags.at(x, y) & kSaturatedAny) == kSaturatedAny;
  };
  const double share = Share(m.volume.width, m.volume.height, HasParallax, saturated);
  ASSERT_GT(share, 0.2) << "the test's exposure does not saturate enough";
  const double right = ShareOfRightLabels(m.volume, 2, saturated);
  RecordProperty("right_labels", fmt::format("{:.3f}", right));
  EXPECT_GT(right, 0.5);
  const double mapped = ShareOfRightDisparities(m.map, saturated);
  RecordProperty("right_disparities", fmt::format("{:.3f}", mapped));
  EXPECT_GT(mapped, 0.75);
}

TEST(SweepCosts, MaskedTexelsCostTheSameWhateverTheDistance) {
  const Image<std::uint8_t> mask(testing::kFrameWidth, testing::kFrameWidth / 2, 1, 0);
  SweepOptions options = WithLabels();
  options.unknown_cost = 24;
  const Matching m = Match({0.5, 0.5, 0.5, 0.5, 0.5}, options, mask.view());
  for (const std::uint8_t cost : m.volume.cost) ASSERT_EQ(cost, 24);
}

TEST(SweepCosts, AMaskedCornerLeavesTheRestUntouched) {
  Image<std::uint8_t> mask(testing::kFrameWidth, testing::kFrameWidth / 2, 1, 255);
  for (int y = 110; y < 128; ++y) std::fill_n(mask.row(y), testing::kFrameWidth, std::uint8_t{0});
  const std::vector<double> seconds(5, 0.5);
  const Matching masked = Match(seconds, WithLabels(), mask.view());
  const Matching whole = Match(seconds);
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < masked.volume.width; ++x) {
      // The label the truth has; nearer ones may look into the masked part.
      const int label = static_cast<int>(TheTruth().disparity.at(x, y) / kStep);
      ASSERT_EQ(masked.volume.at(x, y)[label], whole.volume.at(x, y)[label]) << x << ", " << y;
    }
  }
}

// Ranges that leave out much, none the same as that of its neighbours.
std::vector<LabelRange> ChangingRanges(const CostVolume& volume) {
  std::vector<LabelRange> ranges = volume.ranges;
  for (std::size_t k = 0; k < ranges.size(); ++k) {
    ranges[k] = {static_cast<int>(k * 5 % 40), 8 + 8 * static_cast<int>(k % 3)};
  }
  return ranges;
}

// But for a few texels' difference of where the hypotheses between the computed ones are put.
TEST(SweepCosts, OfARangeAreThoseOfTheWholeSearch) {
  const std::vector<double> seconds = {0.5, 1.0, 0.25, 0.5, 1.0};
  SweepOptions options = WithLabels();
  options.aggregates = false;  // at a range's rim there is less around
  const Matching whole = Match(seconds, options);
  options.ranges = ChangingRanges(whole.volume);
  const Matching some = Match(seconds, options);
  std::size_t compared = 0;
  std::size_t other = 0;
  for (int y = 0; y < whole.volume.height; ++y) {
    for (int x = 0; x < whole.volume.width; ++x) {
      const LabelRange& range = some.volume.range(x, y);
      const std::uint8_t* costs = whole.volume.at(x, y) + range.first;
      for (int k = 0; k < range.count; ++k) {
        ++compared;
        other += some.volume.at(x, y)[k] != costs[k] ? 1 : 0;
      }
    }
  }
  EXPECT_LT(static_cast<double>(other), 0.01 * static_cast<double>(compared));
}

TEST(SemiGlobal, ChoosesWithinTheRangesOnly) {
  const std::vector<double> seconds = {0.5, 1.0, 0.25, 0.5, 1.0};
  SweepOptions options = WithLabels();
  options.ranges = ChangingRanges(Match(seconds).volume);
  const Matching m = Match(seconds, options);
  for (int y = 0; y < m.volume.height; ++y) {
    for (int x = 0; x < m.volume.width; ++x) {
      const LabelRange& range = m.volume.range(x, y);
      const double label = m.map.disparity.at(x, y) / kStep;
      ASSERT_GE(label, range.first - 1e-3);
      ASSERT_LE(label, range.first + range.count - 1 + 1e-3);
    }
  }
}

TEST(SemiGlobal, WhatAMapOfHalfTheSizeLeavesInQuestionIsEnough) {
  const std::vector<double> seconds = {0.5, 1.0, 0.25, 0.5, 1.0};
  const Matching whole = Match(seconds);
  std::vector<StereoView> halves;
  for (const StereoView& view : whole.views) halves.push_back(HalveStereoView(view));
  std::vector<SweepNeighbour> neighbours;
  for (const std::size_t n : {1U, 3U, 0U, 4U}) {
    neighbours.push_back({&halves[n], TheDrive().Offset(kCentre, n)});
  }
  SweepOptions coarse;
  coarse.labels = kLabels / 2;
  coarse.max_disparity = kMaxDisparity;
  const DisparityMap guide =
      OptimiseSemiGlobal(SweepCosts(halves[kCentre], neighbours, coarse), halves[kCentre], {});
  SweepOptions options = WithLabels();
  options.ranges = RangesAround(guide, whole.volume.width, whole.volume.height, kLabels,
                                kMaxDisparity, RangeOptions{});
  const Matching some = Match(seconds, options);
  EXPECT_LT(some.volume.cost.size(), 0.7 * static_cast<double>(whole.volume.cost.size()));
  const double of_whole = ShareOfRightDisparities(whole.map, kEverywhere);
  const double of_some = ShareOfRightDisparities(some.map, kEverywhere);
  RecordProperty("right_whole", fmt::format("{:.3f}", of_whole));
  RecordProperty("right_some", fmt::format("{:.3f}", of_some));
  EXPECT_GT(of_some, of_whole - 0.01);
}

TEST(SweepCosts, WithoutNeighboursNothingIsKnown) {
  const Matching m = Match({0, 0, 0, 0, 0});
  SweepOptions options;
  options.labels = 16;
  const CostVolume volume = SweepCosts(m.views[kCentre], {}, options);
  for (const std::uint8_t cost : volume.cost) ASSERT_EQ(cost, 0);
}

TEST(SweepCosts, AreTheSameBytesOnOneAndOnTwoWorkers) {
  SetWorkerCount(1);
  const Matching one = Match({0.5, 1.0, 0.25, 0.5, 1.0});
  SetWorkerCount(2);
  const Matching two = Match({0.5, 1.0, 0.25, 0.5, 1.0});
  SetWorkerCount(0);
  EXPECT_EQ(one.views[0].texels, two.views[0].texels);
  EXPECT_EQ(one.volume.cost, two.volume.cost);
  EXPECT_TRUE(std::ranges::equal(one.map.disparity.values(), two.map.disparity.values()));
  EXPECT_TRUE(std::ranges::equal(one.map.confidence.values(), two.map.confidence.values()));
}

TEST(SemiGlobal, TheMapIsRightNearlyEverywhereWithoutNoise) {
  const double right = ShareOfRightDisparities(Match({0, 0, 0, 0, 0}).map, kEverywhere);
  RecordProperty("right_disparities", fmt::format("{:.3f}", right));
  EXPECT_GT(right, 0.9);
}

TEST(SemiGlobal, TheMapIsRightMostlyWithNoiseAndDifferentExposures) {
  const double right = ShareOfRightDisparities(Match({0.5, 1.0, 0.25, 0.5, 1.0}).map, kEverywhere);
  RecordProperty("right_disparities", fmt::format("{:.3f}", right));
  EXPECT_GT(right, 0.85);
}

TEST(SemiGlobal, ConfidenceIsHigherWhereTheMapIsRight) {
  const Matching m = Match({0.5, 1.0, 0.25, 0.5, 1.0});
  const auto right = [&](int x, int y) {
    const float truth = TheTruth().disparity.at(x, y);
    return std::abs(m.map.disparity.at(x, y) - truth) <= 0.05F * truth + 0.01F;
  };
  const auto confident = [&](int x, int y) { return m.map.confidence.at(x, y) > 0.5F; };
  const double when_right = Share(m.volume.width, m.volume.height, right, confident);
  const double when_wrong = Share(
      m.volume.width, m.volume.height, [&](int x, int y) { return !right(x, y); }, confident);
  EXPECT_GT(when_right, when_wrong + 0.2);
  for (const float c : m.map.confidence.values()) {
    ASSERT_GE(c, 0.0F);
    ASSERT_LE(c, 1.0F);
  }
}

TEST(SemiGlobal, IsFinerThanALabel) {
  SweepOptions coarse;
  coarse.labels = 12;  // about a pixel of parallax each
  const Matching m = Match({0, 0, 0, 0, 0}, coarse);
  const double step = m.volume.step;
  double error = 0.0;
  double error_of_whole_labels = 0.0;
  int count = 0;
  for (int y = 32; y < 96; ++y) {
    for (int x = 0; x < m.volume.width; ++x) {
      const double truth = TheTruth().disparity.at(x, y);
      const double found = m.map.disparity.at(x, y);
      if (!HasParallax(x, y) || std::abs(found - truth) > 1.5 * step) continue;
      error += std::abs(found - truth) / step;
      error_of_whole_labels += std::abs(std::round(found / step) * step - truth) / step;
      ++count;
    }
  }
  RecordProperty("label_error", fmt::format("{:.3f}", error / count));
  RecordProperty("whole_label_error", fmt::format("{:.3f}", error_of_whole_labels / count));
  EXPECT_LT(error, 0.85 * error_of_whole_labels);
}

TEST(SemiGlobal, AnEvenCostHasNoConfidence) {
  const Matching m = Match({0, 0, 0, 0, 0});
  CostVolume volume = CostVolume::Allocate(m.volume.width, m.volume.height, 16, 0.15, {});
  std::fill(volume.cost.begin(), volume.cost.end(), std::uint8_t{30});
  const DisparityMap map = OptimiseSemiGlobal(volume, m.views[kCentre], {});
  for (const float c : map.confidence.values()) ASSERT_EQ(c, 0.0F);
  for (const float d : map.disparity.values()) ASSERT_EQ(d, 0.0F);
}

TEST(SemiGlobal, RowsCloseRoundTheGlobe) {
  // One label is cheap in a band across the seam, and nothing is known at the seam itself.
  const Matching m = Match({0, 0, 0, 0, 0});
  CostVolume volume = CostVolume::Allocate(m.volume.width, m.volume.height, 16, 0.15, {});
  std::fill(volume.cost.begin(), volume.cost.end(), std::uint8_t{30});
  for (int y = 0; y < volume.height; ++y) {
    for (int x = 0; x < volume.width; ++x) {
      const bool at_seam = x < 3 || x >= volume.width - 3;
      if (at_seam) continue;
      volume.cost[volume.offset(x, y) + 9] = 0;
    }
  }
  const DisparityMap map = OptimiseSemiGlobal(volume, m.views[kCentre], {});
  for (int y = 8; y < volume.height - 8; ++y) {
    EXPECT_NEAR(map.disparity.at(0, y), 0.09, 0.005);
    EXPECT_NEAR(map.disparity.at(volume.width - 1, y), 0.09, 0.005);
  }
}

}  // namespace
}  // namespace omnihdr::sweep_test
