#include "core/quality/pose_metrics.h"

#include <gtest/gtest.h>

#include <numbers>
#include <vector>

namespace omnihdr::pose_metrics_test {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

std::vector<Pose> Walk() {
  std::vector<Pose> poses;
  for (int i = 0; i < 5; ++i) {
    poses.push_back({Quaterniond(AngleAxisd(0.1 * i, Vector3d::UnitZ())),
                     Vector3d(0.3 * i, 0.02 * i * i, 0.0)});
  }
  return poses;
}

TEST(ComparePoses, AChainSeenFromAnotherWorldFrameHasNoError) {
  const std::vector<Pose> truth = Walk();
  const Pose other{Quaterniond(AngleAxisd(1.0, Vector3d(1, 2, 3).normalized())),
                   Vector3d(5, -4, 3)};
  std::vector<Pose> estimated;
  for (const Pose& pose : truth) estimated.push_back(other * pose);
  for (const PoseErrors& errors : ComparePoses(estimated, truth, false).positions) {
    EXPECT_NEAR(errors.rotation_deg, 0.0, 1e-6);
    EXPECT_NEAR(errors.translation_percent, 0.0, 1e-9);
  }
}

TEST(ComparePoses, AnotherLengthUnitIsAnErrorOnlyWhereScaleIsKnown) {
  const std::vector<Pose> truth = Walk();
  std::vector<Pose> estimated = truth;
  for (Pose& pose : estimated) pose.translation *= 2.0;
  const ChainErrors relative = ComparePoses(estimated, truth, true);
  EXPECT_NEAR(relative.scale, 0.5, 1e-12);
  EXPECT_NEAR(relative.positions.back().translation_percent, 0.0, 1e-9);
  const ChainErrors metric = ComparePoses(estimated, truth, false);
  EXPECT_GT(metric.positions.back().translation_percent, 90.0);
}

TEST(ComparePoses, ErrorsAreInDegreesAndInPercentOfTheWayTravelled) {
  std::vector<Pose> truth(3);
  truth[1].translation = {1.0, 0.0, 0.0};
  truth[2].translation = {1.0, 1.0, 0.0};
  std::vector<Pose> estimated = truth;
  estimated[2].translation += Vector3d(0.0, 0.0, 0.1);
  estimated[2].rotation =
      Quaterniond(AngleAxisd(0.5 * std::numbers::pi / 180.0, Vector3d::UnitX()));
  const ChainErrors errors = ComparePoses(estimated, truth, false);
  EXPECT_NEAR(errors.positions[2].rotation_deg, 0.5, 1e-9);
  EXPECT_NEAR(errors.positions[2].translation_percent, 5.0, 1e-9);  // 0.1 of 2
  EXPECT_EQ(errors.positions[0].translation_percent, 0.0);
  EXPECT_NEAR(errors.positions[1].translation_percent, 0.0, 1e-12);
}

TEST(ComparePoses, AChainThatNeverMovedHasScaleOne) {
  const std::vector<Pose> still(3);
  const ChainErrors errors = ComparePoses(still, still, true);
  EXPECT_EQ(errors.scale, 1.0);
  EXPECT_EQ(errors.positions.size(), 3U);
  EXPECT_TRUE(ComparePoses({}, {}, true).positions.empty());
}

}  // namespace
}  // namespace omnihdr::pose_metrics_test
