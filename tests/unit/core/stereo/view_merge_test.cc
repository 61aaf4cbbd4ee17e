#include "core/stereo/view_merge.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/base/parallel_for.h"
#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::view_merge_test {
namespace {

using testing::Drive;
using testing::Share;

constexpr std::size_t kCentre = 2;
constexpr int kWidth = testing::kFrameWidth;
constexpr int kHeight = kWidth / 2;
constexpr auto kEverywhere = [](int, int) { return true; };

const Drive& TheDrive() {
  static const Drive drive = Drive::Through(testing::FurnishedRoom(), testing::FivePlaces(0.15));
  return drive;
}

void ExpectSound(const MergedView& view) {
  for (const float e : view.radiance.values()) {
    ASSERT_TRUE(std::isfinite(e));
    ASSERT_GE(e, 0.0F);
  }
  for (const float c : view.confidence.values()) {
    ASSERT_GE(c, 0.0F);
    ASSERT_LE(c, 1.0F);
  }
  for (const float d : view.disparity.values()) ASSERT_TRUE(std::isnan(d) || d >= 0.0F);
  for (int y = 0; y < view.radiance.height(); ++y) {
    for (int x = 0; x < view.radiance.width(); ++x) {
      if (static_cast<PixelOrigin>(view.origin.at(x, y)) != PixelOrigin::kNoData) continue;
      for (int c = 0; c < 3; ++c) ASSERT_EQ(view.radiance.at(x, y, c), 0.0F);
    }
  }
}

PixelOrigin OriginAt(const MergedView& view, int x, int y) {
  return static_cast<PixelOrigin>(view.origin.at(x, y));
}

// |log10| of green against the truth.
double ErrorAt(const MergedView& view, const Image<float>& truth, int x, int y) {
  return std::abs(std::log10(std::max(view.radiance.at(x, y, 1), 1e-9F) / truth.at(x, y, 1)));
}

double LogRmse(const MergedView& view, const Image<float>& truth) {
  double sum = 0.0;
  int count = 0;
  for (int y = 4; y < kHeight - 4; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      sum += std::pow(ErrorAt(view, truth, x, y), 2);
      ++count;
    }
  }
  return std::sqrt(sum / count);
}

// The places of a drive with exposures of their own and the true disparity of the middle one.
struct Setting {
  const Drive* drive = nullptr;
  std::vector<Measurement> measurements;
  DisparityMap map;

  MergedView Merge(const std::vector<std::size_t>& others, int width = kWidth,
                   const Eigen::Quaterniond& world_from_output = Eigen::Quaterniond::Identity(),
                   bool with_map = true) const {
    const MergeSource reference = {&measurements[kCentre], drive->poses[kCentre], nullptr};
    std::vector<MergeSource> sources;
    for (const std::size_t n : others) {
      sources.push_back({&measurements[n], drive->poses[n], nullptr});
    }
    return MergeViews(reference, with_map ? &map : nullptr, sources, world_from_output, width, {});
  }
};

// `label_errors`: true exposure over the one the measurement believes, none = 1.
Setting Expose(const Drive& drive, const std::vector<double>& seconds, const NoiseModel& noise = {},
               bool with_noise = true, const std::vector<double>& label_errors = {}) {
  Setting s;
  s.drive = &drive;
  for (std::size_t k = 0; k < drive.poses.size(); ++k) {
    s.measurements.push_back(testing::MeasureOne(
        testing::Expose(drive.truths[k].radiance, seconds[k], static_cast<std::uint32_t>(k) + 1,
                        noise, with_noise),
        label_errors.empty() ? seconds[k] : seconds[k] / label_errors[k], drive.projection, noise));
  }
  s.map = drive.TrueDisparity(kCentre);
  return s;
}

const std::vector<std::size_t> kNeighbours = {1, 3, 0, 4};

bool OwnSaturated(const Setting& s, int x, int y) {
  // With a pixel's surround, as a bilinear sample sees it.
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const int sy = std::clamp(y + dy, 0, kHeight - 1);
      const int sx = (x + dx + kWidth) % kWidth;
      if ((s.measurements[kCentre].flags.at(sx, sy) & kSaturatedAny) == 0) return false;
    }
  }
  return true;
}

TEST(MergeViews, AloneAViewReadsWhatItMeasured) {
  const Setting s = Expose(TheDrive(), std::vector<double>(5, 0.5));
  const MergedView view = s.Merge({});
  ExpectSound(view);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (OriginAt(view, x, y) != PixelOrigin::kMeasured) continue;
      EXPECT_NEAR(view.radiance.at(x, y, 1), s.measurements[kCentre].radiance.at(x, y, 1),
                  1e-3 * view.radiance.at(x, y, 1) + 2e-3);
    }
  }
}

TEST(MergeViews, TheDisparityOfTheMapIsHandedOn) {
  const Setting s = Expose(TheDrive(), std::vector<double>(5, 0.5));
  const MergedView view = s.Merge({1, 3});
  for (int y = 4; y < kHeight - 4; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      EXPECT_NEAR(view.disparity.at(x, y), s.map.disparity.at(x, y),
                  0.06F * s.map.disparity.at(x, y) + 0.003F);
      EXPECT_FLOAT_EQ(view.confidence.at(x, y), 1.0F);
    }
  }
}

TEST(MergeViews, IsCloserToTheTruthThanTheOwnFrame) {
  const NoiseModel noise{.read = 2.0, .gain = 0.3, .prnu = 0.0};
  const Setting s = Expose(TheDrive(), {1.0, 0.25, 0.5, 1.0, 0.25}, noise);
  const Image<float>& truth = TheDrive().truths[kCentre].radiance;
  const MergedView merged = s.Merge(kNeighbours);
  ExpectSound(merged);
  const double own = LogRmse(s.Merge({}), truth);
  const double together = LogRmse(merged, truth);
  RecordProperty("own_log10_rmse", fmt::format("{:.4f}", own));
  RecordProperty("merged_log10_rmse", fmt::format("{:.4f}", together));
  EXPECT_LT(together, 0.75 * own);
}

TEST(MergeViews, ASaturatedPixelIsFilledFromAShorterExposure) {
  const Setting s = Expose(TheDrive(), {0.5, 0.5, 8.0, 0.5, 0.5});
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  const Image<float>& truth = TheDrive().truths[kCentre].radiance;
  const auto saturated = [&](int x, int y) { return OwnSaturated(s, x, y); };
  ASSERT_GT(Share(kWidth, kHeight, kEverywhere, saturated), 0.15);
  std::vector<double> errors;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (saturated(x, y) && OriginAt(view, x, y) == PixelOrigin::kMeasured) {
        errors.push_back(ErrorAt(view, truth, x, y));
      }
    }
  }
  EXPECT_GT(errors.size(), 0.9 * Share(kWidth, kHeight, kEverywhere, saturated) * kWidth *
                               (kHeight - kHeight / 8));
  std::sort(errors.begin(), errors.end());
  RecordProperty("median_log10_error", fmt::format("{:.4f}", errors[errors.size() / 2]));
  EXPECT_LT(errors[errors.size() / 2], std::log10(1.05));
  EXPECT_LT(errors[errors.size() * 9 / 10], std::log10(1.35));
}

TEST(MergeViews, NoiseOfMuchShorterExposuresDoesNotDimWhatTheyFillIn) {
  // All that both measured is close to the shorter one's noise: compared by which of its values
  // are above it, it passes for brighter than it is, and lamps come out too dark.
  const std::vector<double> seconds = {0.1, 0.1, 6.4, 0.1, 0.1};
  const Setting s = Expose(TheDrive(), seconds);
  const MergedView view = s.Merge(kNeighbours);
  const MergedView clean = Expose(TheDrive(), seconds, {}, false).Merge(kNeighbours);
  std::vector<float> shares;
  for (int y = 4; y < kHeight - 4; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (!OwnSaturated(s, x, y) || OriginAt(view, x, y) != PixelOrigin::kMeasured) continue;
      shares.push_back(view.radiance.at(x, y, 1) / clean.radiance.at(x, y, 1));
    }
  }
  ASSERT_GT(shares.size(), 1000U);
  const auto middle = shares.begin() + static_cast<std::ptrdiff_t>(shares.size() / 2);
  std::nth_element(shares.begin(), middle, shares.end());
  EXPECT_NEAR(*middle, 1.0F, 0.015F);
}

TEST(MergeViews, AWrongDisparityThatHidesAClippedPixelEverywhereDoesNotLeaveAHole) {
  Setting s = Expose(TheDrive(), {0.5, 0.5, 8.0, 0.5, 0.5});
  // Lone pixels of the map lie far behind their surroundings, which then seem to cover them in
  // every other view.
  for (int y = 3; y < s.map.disparity.height(); y += 7) {
    for (int x = y % 5; x < s.map.disparity.width(); x += 5) s.map.disparity.at(x, y) *= 0.5F;
  }
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  const Image<float>& truth = TheDrive().truths[kCentre].radiance;
  int saturated = 0;
  int bare_bound = 0;
  int wrong = 0;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (!OwnSaturated(s, x, y)) continue;
      ++saturated;
      bare_bound += OriginAt(view, x, y) == PixelOrigin::kClipped ? 1 : 0;
      wrong += ErrorAt(view, truth, x, y) > std::log10(1.5) ? 1 : 0;
    }
  }
  ASSERT_GT(saturated, 2000);
  EXPECT_LT(bare_bound, saturated / 100) << "of " << saturated;
  EXPECT_LT(wrong, saturated / 20) << "of " << saturated;
}

TEST(MergeViews, AHiddenPointIsNotSoughtInTheViewThatCannotSeeIt) {
  // A bright ball near the neighbours' line of sight; behind it lies wall that the middle place
  // sees saturated, so that only the occlusion test can keep the ball out.
  testing::Room room;
  room.balls.push_back({{0.0, 1.0, 0.0}, 0.35, 12.0F});
  Drive drive = Drive::Through(room, testing::FivePlaces(0.3));
  const Setting s = Expose(drive, {0.02, 0.02, 8.0, 0.02, 0.02}, {}, false);
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  const Image<float>& truth = drive.truths[kCentre].radiance;
  const Image<float>& distance = drive.truths[kCentre].distance;
  // Wall pixels beside the ball (not on its very rim) that its neighbours see covered.
  int beside = 0;
  int leaked = 0;
  for (int y = 40; y < 88; ++y) {
    for (int x = 20; x < 110; ++x) {
      bool wall = true;
      for (int dy = -2; dy <= 2; ++dy) {
        for (int dx = -2; dx <= 2; ++dx) wall = wall && distance.at(x + dx, y + dy) > 2.0F;
      }
      if (!wall) continue;
      ++beside;
      leaked += view.radiance.at(x, y, 1) > 2.0F * truth.at(x, y, 1) + 0.5F ? 1 : 0;
    }
  }
  ASSERT_GT(beside, 500);
  EXPECT_LE(leaked, beside / 100) << leaked << " of " << beside;
}

TEST(MergeViews, AMoverSeenByOneNeighbourOnlyDoesNotLeak) {
  Drive drive = Drive::Through(testing::FurnishedRoom(), testing::FivePlaces(0.15));
  testing::Room with_mover = drive.room;
  with_mover.balls.push_back({{1.0, -1.4, 0.0}, 0.5, 4.0F});
  const Image<float> background = drive.truths[3].radiance.Clone();
  drive.truths[3] = Render(with_mover, drive.projection, drive.poses[3]);
  const Setting clean = Expose(TheDrive(), std::vector<double>(5, 0.5));
  const Setting moved = Expose(drive, std::vector<double>(5, 0.5));
  const MergedView without = clean.Merge(kNeighbours);
  const MergedView with = moved.Merge(kNeighbours);
  ExpectSound(with);
  int covered = 0;
  int leaked = 0;
  int changed = 0;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      covered += drive.truths[3].radiance.at(x, y, 1) > 2.0F * background.at(x, y, 1) ? 1 : 0;
      const double change = std::log10(with.radiance.at(x, y, 1) / without.radiance.at(x, y, 1));
      leaked += std::abs(change) > 0.15 ? 1 : 0;
      // One sample fewer is more noise, and no more.
      changed += std::abs(change) > std::log10(1.1) ? 1 : 0;
    }
  }
  ASSERT_GT(covered, 150) << "the mover is hardly seen";
  EXPECT_EQ(leaked, 0) << "the mover covers " << covered;
  EXPECT_LE(changed, covered / 20) << "the mover covers " << covered;
}

TEST(MergeViews, APixelClippedInEveryViewGivesItsLargestLowerBound) {
  const Setting s = Expose(TheDrive(), {4.0, 4.0, 8.0, 6.0, 6.0}, {}, false);
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  const Image<float>& truth = TheDrive().truths[kCentre].radiance;
  int clipped = 0;
  int over = 0;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (OriginAt(view, x, y) != PixelOrigin::kClipped) continue;
      ++clipped;
      EXPECT_GE(view.radiance.at(x, y, 1),
                0.999F * s.measurements[kCentre].radiance.at(x, y, 1) - 0.1F);
      // A bound: the truth is above it, up to resampling at edges.
      over += view.radiance.at(x, y, 1) > 1.25F * truth.at(x, y, 1) + 0.02F ? 1 : 0;
    }
  }
  ASSERT_GT(clipped, kWidth * kHeight / 20);
  EXPECT_LT(over, clipped / 50);
}

TEST(MergeViews, AnEvenSceneClippedEverywhereReadsTheShortestExposuresBound) {
  testing::Room room;
  room.textured = false;
  room.brightness = 50.0F;
  const Drive drive = Drive::Through(room, testing::FivePlaces());
  const Setting s = Expose(drive, {1.0, 0.5, 2.0, 1.0, 1.0}, {}, false);
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  const double clipped = Share(kWidth, kHeight, kEverywhere, [&](int x, int y) {
    return OriginAt(view, x, y) == PixelOrigin::kClipped;
  });
  EXPECT_EQ(clipped, 1.0);
  // But for corners of the room, where the shortest exposure's view is taken to be hidden.
  const double shortest = Share(kWidth, kHeight, kEverywhere, [&](int x, int y) {
    return std::abs(view.radiance.at(x, y, 1) - 255.0 / 128.0 / 0.5) < 0.01;
  });
  RecordProperty("shortest_bound", fmt::format("{:.4f}", shortest));
  EXPECT_GT(shortest, 0.97);
}

TEST(MergeViews, WhatIsDarkInEveryViewSaysSo) {
  testing::Room room;
  room.textured = false;
  room.brightness = 0.02F;
  const Drive drive = Drive::Through(room, testing::FivePlaces());
  const Setting s = Expose(drive, std::vector<double>(5, 1.0));
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) ASSERT_EQ(OriginAt(view, x, y), PixelOrigin::kDark);
  }
}

TEST(MergeViews, WhatIsMaskedInEveryViewHasNoData) {
  Setting s = Expose(TheDrive(), std::vector<double>(5, 0.5));
  for (Measurement& m : s.measurements) {
    for (int y = 100; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        m.flags.at(x, y) = kMasked;
        std::fill_n(m.radiance.pixel(x, y), 4, 0.0F);
      }
    }
  }
  const MergedView view = s.Merge({});
  ExpectSound(view);
  for (int x = 0; x < kWidth; ++x) {
    EXPECT_EQ(OriginAt(view, x, 110), PixelOrigin::kNoData);
    EXPECT_NE(OriginAt(view, x, 60), PixelOrigin::kNoData);
  }
  EXPECT_EQ(OriginAt(s.Merge(kNeighbours), 10, 126), PixelOrigin::kNoData);
}

TEST(MergeViews, WhatIsMaskedHereIsSeenByTheNeighbours) {
  Setting s = Expose(TheDrive(), std::vector<double>(5, 0.5));
  for (int y = 40; y < 80; ++y) {
    for (int x = 100; x < 140; ++x) s.measurements[kCentre].flags.at(x, y) = kMasked;
  }
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  const Image<float>& truth = TheDrive().truths[kCentre].radiance;
  std::vector<double> errors;
  for (int y = 45; y < 75; ++y) {
    for (int x = 105; x < 135; ++x) {
      EXPECT_NE(OriginAt(view, x, y), PixelOrigin::kNoData);
      if (OriginAt(view, x, y) == PixelOrigin::kMeasured) {
        errors.push_back(ErrorAt(view, truth, x, y));
      }
    }
  }
  ASSERT_FALSE(errors.empty());
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], std::log10(1.08));
}

TEST(MergeViews, WhatIsMaskedHereStaysEmptyWhereTheDistanceIsAGuess) {
  Setting s = Expose(TheDrive(), std::vector<double>(5, 0.5));
  for (int y = 40; y < 80; ++y) {
    for (int x = 100; x < 140; ++x) s.measurements[kCentre].flags.at(x, y) = kMasked;
  }
  for (float& confidence : s.map.confidence.values()) confidence = 0.1F;
  const MergedView view = s.Merge(kNeighbours);
  ExpectSound(view);
  for (int y = 42; y < 78; ++y) {
    for (int x = 102; x < 138; ++x) EXPECT_EQ(OriginAt(view, x, y), PixelOrigin::kNoData);
  }
  EXPECT_EQ(OriginAt(view, 60, 60), PixelOrigin::kMeasured);
}

TEST(MergeViews, WithoutAMapViewsOfOnePlaceMergeByRotation) {
  std::vector<Pose> poses = testing::FivePlaces(0.0);
  for (std::size_t k = 0; k < poses.size(); ++k) {
    poses[k].rotation = Eigen::AngleAxisd(0.35 * static_cast<double>(k),
                                          Eigen::Vector3d(0.1, 0.3, 1.0).normalized());
  }
  const Drive drive = Drive::Through(testing::FurnishedRoom(), poses);
  const Setting s = Expose(drive, {0.1, 0.1, 3.0, 0.1, 0.4});
  const MergedView view = s.Merge(kNeighbours, kWidth, Eigen::Quaterniond::Identity(), false);
  ExpectSound(view);
  for (const float d : view.disparity.values()) ASSERT_TRUE(std::isnan(d));
  const testing::Truth truth = Render(drive.room, drive.projection, Pose{});
  std::vector<double> errors;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      EXPECT_NE(OriginAt(view, x, y), PixelOrigin::kNoData);
      if (OriginAt(view, x, y) == PixelOrigin::kMeasured) {
        errors.push_back(ErrorAt(view, truth.radiance, x, y));
      }
    }
  }
  EXPECT_GT(errors.size(), static_cast<std::size_t>(kWidth * kHeight * 3 / 4));
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], std::log10(1.06));
}

TEST(MergeViews, TheOutputIsTurnedAsAsked) {
  const Setting s = Expose(TheDrive(), std::vector<double>(5, 0.5));
  Pose turned = TheDrive().poses[kCentre];
  turned.rotation = Eigen::AngleAxisd(1.1, Eigen::Vector3d(0.0, 0.4, 1.0).normalized());
  const MergedView view = s.Merge(kNeighbours, kWidth, turned.rotation);
  ExpectSound(view);
  const testing::Truth truth = Render(TheDrive().room, TheDrive().projection, turned);
  const double right = Share(
      kWidth, kHeight, [&](int x, int y) { return OriginAt(view, x, y) == PixelOrigin::kMeasured; },
      [&](int x, int y) { return ErrorAt(view, truth.radiance, x, y) < 0.08; });
  EXPECT_GT(right, 0.8);
}

TEST(MergeViews, TheOutputHasTheWidthAskedForAndHalfTheHeight) {
  const Setting s = Expose(TheDrive(), std::vector<double>(5, 0.5));
  const MergedView view = s.Merge({1, 3}, 100);
  EXPECT_EQ(view.radiance.width(), 100);
  EXPECT_EQ(view.radiance.height(), 50);
  EXPECT_EQ(view.radiance.channels(), 3);
  EXPECT_EQ(view.origin.width(), 100);
  ExpectSound(view);
}

TEST(MergeViews, TheOrderOfNeighboursDoesNotMatter) {
  const Setting s = Expose(TheDrive(), {1.0, 0.25, 0.5, 1.0, 0.25});
  const MergedView a = s.Merge({1, 3, 0, 4});
  const MergedView b = s.Merge({4, 0, 3, 1});
  for (std::size_t k = 0; k < a.radiance.size(); ++k) {
    const float e = a.radiance.data()[k];
    ASSERT_NEAR(b.radiance.data()[k], e, 1e-4F * e + 1e-7F);
  }
  EXPECT_TRUE(std::ranges::equal(a.origin.values(), b.origin.values()));
}

TEST(MergeViews, IsTheSameBytesOnOneAndOnTwoWorkers) {
  const Setting s = Expose(TheDrive(), {1.0, 0.25, 0.5, 1.0, 0.25});
  SetWorkerCount(1);
  const MergedView one = s.Merge(kNeighbours);
  SetWorkerCount(2);
  const MergedView two = s.Merge(kNeighbours);
  SetWorkerCount(0);
  EXPECT_TRUE(std::ranges::equal(one.radiance.values(), two.radiance.values()));
  EXPECT_TRUE(std::ranges::equal(one.origin.values(), two.origin.values()));
}

TEST(MergeViews, OutsideACylindersBandThereIsNoData) {
  Drive drive;
  drive.room = testing::FurnishedRoom();
  drive.projection = Projection::Cylindrical(kWidth, 96, -1.0, 1.0);
  drive.poses = testing::FivePlaces(0.15);
  for (const Pose& pose : drive.poses) {
    drive.truths.push_back(Render(drive.room, drive.projection, pose));
  }
  const Setting s = Expose(drive, std::vector<double>(5, 0.5));
  const MergedView view = s.Merge({});
  ExpectSound(view);
  for (int x = 0; x < kWidth; ++x) {
    EXPECT_EQ(OriginAt(view, x, 2), PixelOrigin::kNoData);
    EXPECT_EQ(OriginAt(view, x, kHeight - 3), PixelOrigin::kNoData);
    EXPECT_NE(OriginAt(view, x, kHeight / 2), PixelOrigin::kNoData);
  }
}

// Median of the view over the truth, where measured.
double MedianRatio(const MergedView& view, const Image<float>& truth) {
  std::vector<double> ratios;
  for (int y = 4; y < kHeight - 4; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (OriginAt(view, x, y) == PixelOrigin::kMeasured) {
        ratios.push_back(view.radiance.at(x, y, 1) / truth.at(x, y, 1));
      }
    }
  }
  const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
  std::nth_element(ratios.begin(), middle, ratios.end());
  return *middle;
}

const std::vector<double> kSawTooth = {0.5, 1.5, 0.5, 0.17, 0.5};

TEST(ExposureTest, RightLabelsReadRightBetweenDifferentExposures) {
  const MergedView view = Expose(TheDrive(), kSawTooth).Merge(kNeighbours);
  EXPECT_GE(view.exposure.views, 2);
  EXPECT_NEAR(view.exposure.measured, 1.0F, 0.01F);
  EXPECT_EQ(view.exposure.scale, 1.0F);
  EXPECT_EQ(DescribeExposureTest(view.exposure, {}), "");
}

TEST(ExposureTest, AWrongLabelOfTheReferenceIsCorrectedByTheViewsAround) {
  for (const double error : {1.15, 1.0 / 1.15}) {
    const Setting s = Expose(TheDrive(), kSawTooth, {}, true, {1.0, 1.0, error, 1.0, 1.0});
    const MergedView view = s.Merge(kNeighbours);
    EXPECT_NEAR(view.exposure.scale, error, 0.01);
    EXPECT_NEAR(MedianRatio(view, s.drive->truths[kCentre].radiance), 1.0, 0.01);
    EXPECT_NE(DescribeExposureTest(view.exposure, {}).find("corrected"), std::string::npos);
  }
}

TEST(ExposureTest, AWrongLabelOfOneNeighbourMovesNothing) {
  const Setting s = Expose(TheDrive(), kSawTooth, {}, true, {1.0, 1.15, 1.0, 1.0, 1.0});
  const MergedView view = s.Merge(kNeighbours);
  EXPECT_EQ(view.exposure.scale, 1.0F);
  EXPECT_NEAR(MedianRatio(view, s.drive->truths[kCentre].radiance), 1.0, 0.01);
}

TEST(ExposureTest, LightThatDriftsFromViewToViewMovesNothing) {
  std::vector<double> drift;
  for (int k = 0; k < 5; ++k) drift.push_back(std::pow(1.06, k - 2));
  const MergedView view = Expose(TheDrive(), kSawTooth, {}, true, drift).Merge(kNeighbours);
  EXPECT_EQ(view.exposure.scale, 1.0F);
}

TEST(ExposureTest, AnErrorBeyondTheLimitIsKeptAndTold) {
  const Setting s = Expose(TheDrive(), kSawTooth, {}, true, {1.0, 1.0, 1.4, 1.0, 1.0});
  const MergedView view = s.Merge(kNeighbours);
  EXPECT_EQ(view.exposure.scale, 1.0F);
  EXPECT_NEAR(view.exposure.measured, 1.4F, 0.03F);
  EXPECT_NE(DescribeExposureTest(view.exposure, {}).find("kept as labelled"), std::string::npos);
}

TEST(ExposureTest, WithoutViewsAroundThereIsNothingToTestBy) {
  const MergedView view =
      Expose(TheDrive(), kSawTooth, {}, true, {1.0, 1.0, 1.15, 1.0, 1.0}).Merge({});
  EXPECT_EQ(view.exposure.views, 0);
  EXPECT_EQ(view.exposure.scale, 1.0F);
}

}  // namespace
}  // namespace omnihdr::view_merge_test
