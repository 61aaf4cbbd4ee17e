#include "core/pose/dead_reckoning.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/pose/tracker.h"
#include "tests/unit/core/pose/feature_world.h"

namespace omnihdr::dead_reckoning_test {
namespace {

using ::testing::HasSubstr;

constexpr double kDegree = M_PI / 180.0;

TEST(DeadReckoning, BearingsGrowClockwiseAndTurnsAreToTheLeftTheShortWayRound) {
  EXPECT_NEAR(TurnFromHeadings(10.0, 350.0), 20.0 * kDegree, 1e-12);
  EXPECT_NEAR(TurnFromHeadings(350.0, 10.0), -20.0 * kDegree, 1e-12);
  const Eigen::Quaterniond left(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()));
  EXPECT_NEAR(TurnOf(left), 0.3, 1e-12);
  const Eigen::Quaterniond nod(Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()));
  EXPECT_NEAR(TurnOf(left * nod), 0.3, 1e-3);
}

TEST(DeadReckoning, HeadingsAgreeWithinTheirNoiseAndHardlyBeyondIt) {
  EXPECT_DOUBLE_EQ(HeadingAgreement(0.5, 0.5, 0.05), 1.0);
  EXPECT_GT(HeadingAgreement(0.5, 0.55, 0.05), 0.85);
  EXPECT_LT(HeadingAgreement(0.5, 2.0, 0.05), 0.02);
  EXPECT_DOUBLE_EQ(HeadingAgreement(M_PI, -M_PI, 0.05), 1.0);
}

TEST(DeadReckoning, AQuarterOfACircleEndsWhereItsChordDoes) {
  // A camera that looks to the side of the way: forward of the vehicle is its -Y.
  const auto on_circle = [](double a) {
    Pose pose;
    pose.translation = 5.0 * Eigen::Vector3d(std::sin(a), 1.0 - std::cos(a), 0.0);
    pose.rotation = Eigen::AngleAxisd(a + 0.5 * M_PI, Eigen::Vector3d::UnitZ());
    return pose;
  };
  const Pose found = DeadReckon(on_circle(0.2), on_circle(0.1), 1.0, 5.0);
  EXPECT_LT((found.translation - on_circle(1.2).translation).norm(), 1e-9);
  EXPECT_LT(found.rotation.angularDistance(on_circle(1.2).rotation), 1e-9);
}

TEST(DeadReckoning, IsTheLessCertainTheFurtherItGoes) {
  const PoseSigma near_one = DeadReckoningSigma(1.0, 3.0, std::nullopt);
  const PoseSigma far_one = DeadReckoningSigma(10.0, 3.0, near_one);
  EXPECT_NEAR(near_one.rotation_deg.x(), 3.0 * std::sqrt(2.0), 1e-9);
  EXPECT_NEAR(near_one.translation.x(), std::sin(near_one.rotation_deg.x() * kDegree), 2e-3);
  EXPECT_GT(far_one.translation.x(), 9.0 * near_one.translation.x());
}

// A straight drive to the left round a bend, with a compass that is 90 degrees off north.
Pose OnWay(int i) {
  Pose pose;
  pose.rotation = Eigen::AngleAxisd(2.0 * i * kDegree, Eigen::Vector3d::UnitZ());
  for (int k = 0; k < i; ++k) {
    const double a = (2.0 * k + 1.0) * kDegree;
    pose.translation += 0.4 * Eigen::Vector3d(std::cos(a), std::sin(a), 0.0);
  }
  return pose;
}
PositionClues CluesOn(int i, double compass_error_deg = 0.0) {
  PositionClues clues;
  clues.odometer_m = 7.0 + 0.4 * i;
  clues.heading_deg = 90.0 - 2.0 * i + compass_error_deg;
  return clues;
}

test::FeatureWorld Street() {
  test::FeatureWorld world(4, {.range = 8.0});
  world.Fill({-8.0, -8.0, -2.0}, {16.0, 14.0, 4.0}, 2000);
  return world;
}

TEST(DeadReckoning, CarriesAChainOverPicturesThatShowNothing) {
  const test::FeatureWorld world = Street();
  PoseOptions options;
  options.heading_sigma_deg = 2.0;
  options.keyframes = 0;
  Tracker tracker(options);
  const auto is_blind = [](int i) { return i >= 8 && i < 13; };
  std::vector<PoseEstimate> found;
  for (int i = 0; i < 20; ++i) {
    tracker.Push(PositionId{i},
                 is_blind(i) ? FeatureSet{} : world.See(OnWay(i), static_cast<std::uint32_t>(i)),
                 CluesOn(i, i % 2 == 0 ? 0.7 : -0.7));
    found.push_back(tracker.Window().back());
  }
  for (int i = 0; i < 20; ++i) {
    const PoseEstimate& e = found[static_cast<std::size_t>(i)];
    EXPECT_EQ(e.chain, 0) << i;
    EXPECT_EQ(e.metric, i > 0);
    // The first that sees again sees nothing of what was known: it is reckoned as well.
    EXPECT_EQ(!e.dead_reckoned.empty(), i >= 8 && i <= 13) << i;
    const double error = (e.world_from_camera.translation - OnWay(i).translation).norm();
    EXPECT_LT(error, i < 8 ? 0.02 : 0.25) << i;
    if (e.dead_reckoned.empty()) continue;
    EXPECT_THAT(e.dead_reckoned, HasSubstr("usable features"));
    ASSERT_TRUE(e.sigma);
    EXPECT_LT(error, 3.0 * e.sigma->translation.x()) << i;
    EXPECT_NEAR(e.sigma->rotation_deg.z(), 2.83, 0.01);
  }
  EXPECT_EQ(found[19].group, found[13].group) << "linked by pictures again";
  EXPECT_NE(found[19].group, found[7].group);
}

TEST(DeadReckoning, WithoutASigmaOrWithoutAnOdometerHeadingsGiveNoPose) {
  const test::FeatureWorld world = Street();
  for (const bool with_sigma : {false, true}) {
    PoseOptions options;
    options.heading_sigma_deg = with_sigma ? 2.0 : 0.0;
    Tracker tracker(options);
    for (int i = 0; i < 6; ++i) {
      PositionClues clues = CluesOn(i);
      if (with_sigma) clues.odometer_m.reset();
      tracker.Push(PositionId{i},
                   i == 5 ? FeatureSet{} : world.See(OnWay(i), static_cast<std::uint32_t>(i)),
                   clues);
    }
    EXPECT_EQ(tracker.Window().back().chain, 1);
    EXPECT_EQ(tracker.Window().back().dead_reckoned, "");
  }
}

TEST(DeadReckoning, HeadingsThatFitLeaveAGoodPoseAsItIs) {
  const test::FeatureWorld world = Street();
  std::vector<Pose> last;
  for (const double sigma : {0.0, 2.0}) {
    PoseOptions options;
    options.heading_sigma_deg = sigma;
    Tracker tracker(options);
    for (int i = 0; i < 6; ++i) {
      tracker.Push(PositionId{i}, world.See(OnWay(i), static_cast<std::uint32_t>(i)), CluesOn(i));
    }
    last.push_back(tracker.Window().back().world_from_camera);
  }
  EXPECT_LT((last[0].translation - last[1].translation).norm(), 1e-3);
}

}  // namespace
}  // namespace omnihdr::dead_reckoning_test
