#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/quality/seam_metrics.h"
#include "core/stereo/view_merge.h"
#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::view_merge_movers_test {
namespace {

using testing::Drive;

constexpr std::size_t kCentre = 2;
constexpr int kWidth = testing::kFrameWidth;
constexpr int kHeight = kWidth / 2;
const std::vector<std::size_t> kNeighbours = {1, 3, 0, 4};

Drive StillDrive(double step = 0.15) {
  return Drive::Through(testing::FurnishedRoom(), testing::FivePlaces(step));
}

// A drive in which a ball, so many times as bright as its surroundings, is where `places` has it
// for each view.
struct MovingDrive {
  Drive drive;
  std::vector<Image<float>> backgrounds;

  MovingDrive(float brightness, const std::vector<std::optional<Eigen::Vector3d>>& places,
              double radius = 0.4, double step = 0.15)
      : drive(StillDrive(step)) {
    for (std::size_t k = 0; k < drive.poses.size(); ++k) {
      backgrounds.push_back(drive.truths[k].radiance.Clone());
      if (!places[k]) continue;
      testing::Room room = drive.room;
      room.balls.push_back({*places[k], radius, brightness});
      drive.truths[k] = Render(room, drive.projection, drive.poses[k]);
    }
  }

  bool IsMover(std::size_t view, int x, int y) const {
    const float now = drive.truths[view].radiance.at(x, y, 1);
    const float still = backgrounds[view].at(x, y, 1);
    return std::abs(now - still) > 1e-6F;
  }
};

struct Merger {
  const Drive& drive;
  std::vector<Measurement> measurements;
  DisparityMap map;  // of the still scene
  std::vector<DisparityMap> matched;

  Merger(const Drive& of, const std::vector<double>& seconds)
      : drive(of), map(of.TrueDisparity(kCentre)) {
    for (std::size_t k = 0; k < of.poses.size(); ++k) {
      measurements.push_back(testing::MeasureOne(
          testing::Expose(of.truths[k].radiance, seconds[k], static_cast<std::uint32_t>(k) + 1),
          seconds[k], of.projection));
      matched.push_back(of.TrueDisparity(k));
    }
  }

  MergedView Merge(MergeMovers movers = MergeMovers::kKeep) const {
    MergeOptions options;
    options.movers = movers;
    options.refine_exposure = false;
    std::vector<MergeSource> sources;
    for (const std::size_t n : kNeighbours) {
      sources.push_back({&measurements[n], drive.poses[n], nullptr, &matched[n]});
    }
    return MergeViews({&measurements[kCentre], drive.poses[kCentre], nullptr}, &map, sources,
                      Eigen::Quaterniond::Identity(), kWidth, options);
  }
};

double OffBy(const Image<float>& view, const Image<float>& truth, int x, int y) {
  return std::abs(std::log10(std::max(view.at(x, y, 1), 1e-9F) / truth.at(x, y, 1)));
}

// A mover that walks by on the side of the room where no furniture stands.
std::vector<std::optional<Eigen::Vector3d>> WalkingBy() {
  std::vector<std::optional<Eigen::Vector3d>> places;
  for (int k = 0; k < 5; ++k) places.emplace_back(Eigen::Vector3d(1.2 - 0.9 * k, -2.0, 0.1));
  return places;
}

std::vector<std::optional<Eigen::Vector3d>> Only(std::size_t view) {
  std::vector<std::optional<Eigen::Vector3d>> places(5);
  places[view] = Eigen::Vector3d(0.8, -1.8, 0.1);
  return places;
}

TEST(MergeKeepingMovers, TheOwnInstantStaysAndNoOtherLeaksIn) {
  for (const float brightness : {0.1F, 6.0F}) {
    const MovingDrive moving(brightness, WalkingBy());
    const MergedView view = Merger(moving.drive, std::vector<double>(5, 0.5)).Merge();
    int mover = 0;
    int off = 0;
    for (int y = 8; y < kHeight - 8; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double error = OffBy(view.radiance, moving.drive.truths[kCentre].radiance, x, y);
        mover += moving.IsMover(kCentre, x, y) ? 1 : 0;
        // Views around are right but for edges; the mover of none of them is to be seen.
        off += error > 0.3 ? 1 : 0;
      }
    }
    ASSERT_GE(mover, 150);
    EXPECT_LE(off, mover / 100) << "brightness " << brightness << ": of " << mover;
  }
}

TEST(MergeKeepingMovers, WhereTheOwnFrameIsClippedAPasserByInOneViewDoesNotLeak) {
  // What passes is brighter than the own frame's bound, so that only the others can tell it apart;
  // if darker than the background, its smaller variance makes it count more than theirs.
  const std::vector<double> seconds = {0.3, 0.3, 30.0, 0.3, 0.3};
  const MergedView without = Merger(StillDrive(), seconds).Merge();
  for (const float brightness : {0.15F, 0.3F, 8.0F}) {
    const MovingDrive moving(brightness, Only(3));
    const MergedView with = Merger(moving.drive, seconds).Merge();
    int changed = 0;
    int clipped = 0;
    for (int y = 8; y < kHeight - 8; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const float before = without.radiance.at(x, y, 1);
        clipped += before > 1.1F * 255.0F / 128.0F / 30.0F ? 1 : 0;
        changed += std::abs(std::log10(with.radiance.at(x, y, 1) / before)) > 0.15 ? 1 : 0;
      }
    }
    ASSERT_GT(clipped, kWidth * kHeight / 10);
    EXPECT_LE(changed, brightness > 1.0F ? 4 : 12) << "brightness " << brightness;
  }
}

TEST(MergeKeepingMovers, WhereTheOwnFrameIsDarkAPasserByInOneViewDoesNotLeak) {
  const std::vector<double> seconds = {1.0, 1.0, 0.01, 1.0, 1.0};
  const MergedView without = Merger(StillDrive(), seconds).Merge();
  for (const float brightness : {0.15F, 0.3F, 5.0F}) {
    const MovingDrive moving(brightness, Only(1));
    const MergedView with = Merger(moving.drive, seconds).Merge();
    int changed = 0;
    for (int y = 8; y < kHeight - 8; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const float ratio = with.radiance.at(x, y, 1) / without.radiance.at(x, y, 1);
        changed += std::abs(std::log10(ratio)) > 0.15 ? 1 : 0;
      }
    }
    EXPECT_LE(changed, 4) << "brightness " << brightness;
  }
}

TEST(MergeRemovingMovers, TheBackgroundIsShownWhereTheOthersAgreeOnIt) {
  for (const float brightness : {0.1F, 6.0F}) {
    const MovingDrive moving(brightness, WalkingBy());
    const Merger merger(moving.drive, std::vector<double>(5, 0.5));
    const MergedView view = merger.Merge(MergeMovers::kRemove);
    int mover = 0;
    int left = 0;
    int elsewhere = 0;
    const MergedView kept = merger.Merge();
    for (int y = 8; y < kHeight - 8; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const bool off = OffBy(view.radiance, moving.backgrounds[kCentre], x, y) > 0.3;
        if (moving.IsMover(kCentre, x, y)) {
          ++mover;
          left += off ? 1 : 0;
        } else {
          elsewhere +=
              off && OffBy(kept.radiance, moving.backgrounds[kCentre], x, y) <= 0.3 ? 1 : 0;
        }
      }
    }
    ASSERT_GE(mover, 150);
    EXPECT_LE(left, mover / 50) << "brightness " << brightness << ": of " << mover;
    EXPECT_LE(elsewhere, 4);
  }
}

TEST(MergeRemovingMovers, OneThatKeepsPaceWithTheCameraIsTakenAwayThoughAllSeeItInOneDirection) {
  constexpr double kStep = 0.5;
  std::vector<std::optional<Eigen::Vector3d>> places;
  for (int k = 0; k < 5; ++k)
    places.emplace_back(Eigen::Vector3d(0.4 + kStep * (k - 2), -1.6, 0.1));
  for (const float brightness : {0.1F, 6.0F}) {
    const MovingDrive moving(brightness, places, 0.2, kStep);
    Merger merger(moving.drive, std::vector<double>(5, 0.5));
    // What is matched is what looks infinitely far.
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (std::size_t k = 0; k < 5; ++k) {
          if (moving.IsMover(k, x, y)) merger.matched[k].disparity.at(x, y) = 0.0F;
        }
        if (moving.IsMover(kCentre, x, y)) merger.map.disparity.at(x, y) = 0.0F;
      }
    }
    const MergedView view = merger.Merge(MergeMovers::kRemove);
    int mover = 0;
    int left = 0;
    for (int y = 8; y < kHeight - 8; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (!moving.IsMover(kCentre, x, y)) continue;
        ++mover;
        left += OffBy(view.radiance, moving.backgrounds[kCentre], x, y) > 0.3 ? 1 : 0;
      }
    }
    ASSERT_GE(mover, 40);
    EXPECT_LE(left, mover / 20) << "brightness " << brightness << ": of " << mover;
  }
}

TEST(MergeRemovingMovers, OneInTheWayOfTheOthersAsWellIsNeverSeenTwice) {
  for (const float brightness : {0.1F, 6.0F}) {
    std::vector<std::optional<Eigen::Vector3d>> places;
    for (int k = 0; k < 5; ++k) places.emplace_back(Eigen::Vector3d(0.9 - 0.3 * k, -2.0, 0.1));
    const MovingDrive moving(brightness, places);
    const MergedView view =
        Merger(moving.drive, std::vector<double>(5, 0.5)).Merge(MergeMovers::kRemove);
    int mover = 0;
    int neither = 0;
    int left = 0;
    for (int y = 8; y < kHeight - 8; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const bool is_background = OffBy(view.radiance, moving.backgrounds[kCentre], x, y) <= 0.3;
        const bool is_own =
            OffBy(view.radiance, moving.drive.truths[kCentre].radiance, x, y) <= 0.3;
        const bool is_mover = moving.IsMover(kCentre, x, y);
        mover += is_mover ? 1 : 0;
        left += is_mover && !is_background ? 1 : 0;
        neither += !is_background && !is_own ? 1 : 0;
      }
    }
    ASSERT_GE(mover, 150);
    EXPECT_LE(neither, mover / 50) << "brightness " << brightness << ": of " << mover;
    // Its outer parts are seen past by two others, its middle by none.
    EXPECT_LE(left, mover * 2 / 3) << "brightness " << brightness << ": of " << mover;
  }
}

TEST(MergeRemovingMovers, AStillSceneIsMergedAsIfMoversWereKept) {
  const Drive drive = StillDrive();
  const Merger merger(drive, {1.0, 0.25, 0.5, 1.0, 0.25});
  const MergedView kept = merger.Merge();
  const MergedView removed = merger.Merge(MergeMovers::kRemove);
  EXPECT_TRUE(std::ranges::equal(kept.radiance.values(), removed.radiance.values()));
  EXPECT_TRUE(std::ranges::equal(kept.disparity.values(), removed.disparity.values()));
}

TEST(MergeRemovingMovers, IsTheSameBytesOnOneAndOnTwoWorkers) {
  const MovingDrive moving(6.0F, WalkingBy());
  const Merger merger(moving.drive, std::vector<double>(5, 0.5));
  SetWorkerCount(1);
  const MergedView one = merger.Merge(MergeMovers::kRemove);
  SetWorkerCount(2);
  const MergedView two = merger.Merge(MergeMovers::kRemove);
  SetWorkerCount(0);
  EXPECT_TRUE(std::ranges::equal(one.radiance.values(), two.radiance.values()));
}

TEST(MergeMarkedMovers, MarkedPixelsOfAnotherViewAreUsedInNone) {
  const MovingDrive moving(1.3F, WalkingBy());  // much like its surroundings
  Merger merger(moving.drive, std::vector<double>(5, 0.5));
  for (const std::size_t n : kNeighbours) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (!moving.IsMover(n, x, y)) continue;
        merger.measurements[n].flags.at(x, y) |= kMover;
        // Whoever used it would show it.
        std::fill_n(merger.measurements[n].radiance.pixel(x, y), 3, 1e6F);
      }
    }
  }
  const MergedView view = merger.Merge();
  for (const float e : view.radiance.values()) ASSERT_LT(e, 1000.0F);
}

TEST(MergeMarkedMovers, AMarkedPixelOfTheOwnViewIsKeptAsItIsOrReplacedByWhatAnyOtherSaw) {
  const MovingDrive moving(3.0F, Only(kCentre));
  Merger merger(moving.drive, std::vector<double>(5, 0.5));
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (moving.IsMover(kCentre, x, y)) merger.measurements[kCentre].flags.at(x, y) |= kMover;
    }
  }
  const MergedView kept = merger.Merge();
  const MergedView removed = merger.Merge(MergeMovers::kRemove);
  int mover = 0;
  int wrong = 0;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (!moving.IsMover(kCentre, x, y)) continue;
      ++mover;
      EXPECT_EQ(kept.sources.at(x, y), 1);
      wrong += OffBy(removed.radiance, moving.backgrounds[kCentre], x, y) > 0.3 ? 1 : 0;
    }
  }
  ASSERT_GE(mover, 150);
  EXPECT_LE(wrong, mover / 50) << "of " << mover;
}

TEST(MergedSources, TellWhichViewsAPixelIsMadeOf) {
  const Drive drive = StillDrive();
  const MergedView alike = Merger(drive, std::vector<double>(5, 0.5)).Merge();
  const MergedView clipped = Merger(drive, {0.3, 0.3, 8.0, 0.3, 0.3}).Merge();
  int own = 0;
  int others_alone = 0;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      EXPECT_NE(alike.sources.at(x, y), 0);
      EXPECT_LT(alike.sources.at(x, y), 32);
      own += alike.sources.at(x, y) & 1;
      others_alone += (clipped.sources.at(x, y) & 1) == 0 ? 1 : 0;
    }
  }
  EXPECT_GT(own, kWidth * (kHeight - 16) * 9 / 10);
  EXPECT_GT(others_alone, kWidth * kHeight / 10);
}

TEST(MergedSources, WhereTheyChangeThereIsNoVisibleSeam) {
  // Exposures so different that views come and go all over the picture, and labels that are off.
  const Drive drive = StillDrive();
  const MergedView view = Merger(drive, {0.25, 2.0, 0.7, 0.08, 2.0}).Merge();
  const SeamErrors seams =
      FindSeams(view.radiance.view(), drive.truths[kCentre].radiance.view(), view.sources.view(),
                SphereArea(drive.projection), /*wraps=*/true);
  RecordProperty("borders", static_cast<int>(seams.borders));
  RecordProperty("excess_noise", fmt::format("{:.3f}", seams.excess_noise));
  RecordProperty("excess_log10", fmt::format("{:.4f}", seams.excess_log10));
  ASSERT_GT(seams.borders, 500U);
  EXPECT_LT(seams.excess_noise, 1.0);
  EXPECT_LT(seams.visible, 0.1);
}

}  // namespace
}  // namespace omnihdr::view_merge_movers_test
