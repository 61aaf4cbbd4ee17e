#include "core/pose/pose_tracker.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/base/parallel_for.h"
#include "tests/unit/core/pose/room.h"

namespace omnihdr::pose_tracker_test {
namespace {

using ::testing::HasSubstr;

constexpr double kDegree = M_PI / 180.0;

Projection SmallProjection() { return Projection::Equirectangular(512, 256); }

PoseOptions SmallOptions() {
  PoseOptions options;
  options.feature_image_width = 512;
  options.max_features = 1200;
  return options;
}

// A path of steps of about 0.25 m through the room, turning and swaying.
Pose PathPose(int i) {
  Pose pose;
  pose.translation = {-1.0 + 0.25 * i, 0.1 * std::sin(0.7 * i), 0.03 * std::cos(1.1 * i)};
  pose.rotation = Eigen::AngleAxisd(3.0 * i * kDegree, Eigen::Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(1.5 * std::sin(1.3 * i) * kDegree, Eigen::Vector3d::UnitY());
  return pose;
}

// The room from a pose, in the i-th exposure of a saw tooth of three.
Measurement See(const Pose& pose, int i, std::uint32_t room_seed = 1, double stops = 1.6) {
  const double exposure_s = 0.12 * std::exp2(stops * (i % 3 - 1));
  return test::Expose(test::Room(room_seed).Render(pose, SmallProjection()), SmallProjection(),
                      exposure_s, 100 + static_cast<std::uint32_t>(i));
}

Measurement Uniform(float radiance, std::uint8_t flags) {
  Measurement m;
  m.projection = SmallProjection();
  m.radiance = Image<float>(512, 256, 4, radiance);
  m.flags = Image<std::uint8_t>(512, 256, 1, flags);
  m.saturation = {radiance, radiance, radiance};
  m.noise_floor = 1e-3F;
  return m;
}

std::unique_ptr<PoseTracker> MakeTracker(const PoseOptions& options = SmallOptions()) {
  return std::move(*PoseTracker::Create(options));
}

PoseEstimate Last(const PoseTracker& tracker) { return tracker.Window().back(); }

struct PoseErrors {
  double rotation_deg = 0.0;
  double translation_share = 0.0;  // of the distance from the first
};

// Against the path, in the frame of the first pose given; `scale` metres a unit.
PoseErrors Compare(const std::vector<PoseEstimate>& estimates, double scale) {
  PoseErrors errors;
  const int first = static_cast<int>(Value(estimates.front().position));
  for (std::size_t k = 1; k < estimates.size(); ++k) {
    const int i = static_cast<int>(Value(estimates[k].position));
    const Pose truth = PathPose(first).Inverse() * PathPose(i);
    const Pose found =
        estimates.front().world_from_camera.Inverse() * estimates[k].world_from_camera;
    errors.rotation_deg =
        std::max(errors.rotation_deg, truth.rotation.angularDistance(found.rotation) / kDegree);
    errors.translation_share =
        std::max(errors.translation_share,
                 (scale * found.translation - truth.translation).norm() / truth.translation.norm());
  }
  return errors;
}

double Travelled(int i) {
  double sum = 0.0;
  for (int k = 1; k <= i; ++k) {
    sum += (PathPose(k).translation - PathPose(k - 1).translation).norm();
  }
  return sum;
}

TEST(PoseTracker, FollowsASawToothOfExposuresInMetresOfTheOdometer) {
  const auto tracker = MakeTracker();
  for (int i = 0; i < 9; ++i) {
    tracker->Push(PositionId{i}, See(PathPose(i), i), 100.0 + Travelled(i), std::nullopt);
  }
  const auto window = tracker->Window();
  ASSERT_EQ(window.size(), 7U);
  for (const PoseEstimate& e : window) {
    EXPECT_EQ(e.chain, 0);
    EXPECT_TRUE(e.metric);
    EXPECT_TRUE(e.has_baseline);
    // Walls are 1.5 to 5 m away.
    EXPECT_GT(e.median_inverse_distance, 0.2);
    EXPECT_LT(e.median_inverse_distance, 0.65);
    EXPECT_GE(e.max_inverse_distance, e.median_inverse_distance);
    EXPECT_LT(e.max_inverse_distance, 1.0);
  }
  const PoseErrors errors = Compare(window, 1.0);
  EXPECT_LT(errors.rotation_deg, 0.15);
  EXPECT_LT(errors.translation_share, 0.015);
}

TEST(PoseTracker, WithoutOdometerTheFirstBaselineIsOneAndTheScaleIsCarriedOn) {
  const auto tracker = MakeTracker();
  std::vector<PoseEstimate> path;
  for (int i = 0; i < 10; ++i) {
    tracker->Push(PositionId{i}, See(PathPose(i), i), std::nullopt, std::nullopt);
    if (i == 6) {
      const auto window = tracker->Window();
      EXPECT_NEAR(
          (window[1].world_from_camera.translation - window[0].world_from_camera.translation)
              .norm(),
          1.0, 1e-9);
      path = window;
    }
  }
  for (const PoseEstimate& e : tracker->Window()) {
    if (Value(e.position) > 6) path.push_back(e);
    EXPECT_FALSE(e.metric);
  }
  ASSERT_EQ(path.size(), 10U);
  const PoseErrors errors = Compare(path, Travelled(1));
  EXPECT_LT(errors.rotation_deg, 0.2);
  EXPECT_LT(errors.translation_share, 0.03);
}

TEST(PoseTracker, TheNumberOfWorkersDoesNotShow) {
  std::vector<std::string> states;
  for (const int workers : {1, 3}) {
    SetWorkerCount(workers);
    const auto tracker = MakeTracker();
    for (int i = 0; i < 4; ++i) {
      tracker->Push(PositionId{i}, See(PathPose(i), i), Travelled(i), std::nullopt);
    }
    states.push_back(tracker->SaveState());
  }
  SetWorkerCount(0);
  EXPECT_EQ(states[0], states[1]);
}

TEST(PoseTracker, SavedRestoredAndRewarmedItContinuesToTheLastBit) {
  PoseOptions options = SmallOptions();
  options.window = 5;
  std::vector<Measurement> seen;
  for (int i = 0; i < 10; ++i) seen.push_back(See(PathPose(i), i));
  for (const bool odometer : {false, true}) {
    const auto distance = [&](int i) {
      return odometer ? std::optional(Travelled(i)) : std::nullopt;
    };
    const auto whole = MakeTracker(options);
    const auto first = MakeTracker(options);
    const auto second = MakeTracker(options);
    for (int i = 0; i < 10; ++i) {
      const auto k = static_cast<std::size_t>(i);
      whole->Push(PositionId{i}, seen[k], distance(i), std::nullopt);
      if (i < 7) first->Push(PositionId{i}, seen[k], distance(i), std::nullopt);
    }
    ASSERT_TRUE(second->RestoreState(first->SaveState()));
    for (const PoseEstimate& e : second->Window()) {
      second->Rewarm(e.position, seen[static_cast<std::size_t>(Value(e.position))]);
    }
    EXPECT_EQ(second->SaveState(), first->SaveState());
    for (int i = 7; i < 10; ++i) {
      second->Push(PositionId{i}, seen[static_cast<std::size_t>(i)], distance(i), std::nullopt);
    }
    EXPECT_EQ(second->SaveState(), whole->SaveState()) << odometer;
  }
}

TEST(PoseTracker, GoesOnWhenSomeOfTheWindowCannotBeRewarmed) {
  const auto first = MakeTracker();
  for (int i = 0; i < 4; ++i) {
    first->Push(PositionId{i}, See(PathPose(i), i), std::nullopt, std::nullopt);
  }
  for (const std::vector<int>& rewarmed : {std::vector<int>{}, {3}, {0, 2}, {1, 1, 9}}) {
    const auto second = MakeTracker();
    ASSERT_TRUE(second->RestoreState(first->SaveState()));
    for (const int i : rewarmed) second->Rewarm(PositionId{i}, See(PathPose(i), i));
    second->Push(PositionId{4}, See(PathPose(4), 4), std::nullopt, std::nullopt);
    EXPECT_EQ(second->Window().size(), 5U);
  }
}

TEST(PoseTracker, PairsThatOnlyPosesLedToAreRememberedAcrossARestart) {
  // Seven stops between neighbours: hardly a link from picture to picture.
  std::vector<Measurement> seen;
  for (int i = 0; i < 8; ++i) seen.push_back(See(PathPose(i), i, 1, 3.5));
  const auto whole = MakeTracker();
  const auto first = MakeTracker();
  const auto second = MakeTracker();
  for (int i = 0; i < 8; ++i) {
    whole->Push(PositionId{i}, seen[static_cast<std::size_t>(i)], Travelled(i), std::nullopt);
    if (i < 7)
      first->Push(PositionId{i}, seen[static_cast<std::size_t>(i)], Travelled(i), std::nullopt);
  }
  ASSERT_THAT(first->SaveState(), HasSubstr("\"adopted\""));
  ASSERT_TRUE(second->RestoreState(first->SaveState()));
  for (const PoseEstimate& e : second->Window()) {
    second->Rewarm(e.position, seen[static_cast<std::size_t>(Value(e.position))]);
  }
  second->Push(PositionId{7}, seen[7], Travelled(7), std::nullopt);
  EXPECT_EQ(second->SaveState(), whole->SaveState());
  std::vector<PoseEstimate> main_chain;
  for (const PoseEstimate& e : whole->Window()) {
    if (e.chain == 0) main_chain.push_back(e);
  }
  EXPECT_GE(main_chain.size(), 5U);
  EXPECT_LT(Compare(main_chain, 1.0).translation_share, 0.03);
}

TEST(PoseTracker, ATurnOnTheSpotKeepsTheTranslationAndTheChainGetsItsScaleLater) {
  const auto tracker = MakeTracker();
  const auto turned = [](double degrees) {
    return Pose{Eigen::Quaterniond(Eigen::AngleAxisd(degrees * kDegree, Eigen::Vector3d::UnitZ())),
                Eigen::Vector3d(0.2, 0.1, 0.0)};
  };
  tracker->Push(PositionId{0}, See(turned(0.0), 0), std::nullopt, std::nullopt);
  tracker->Push(PositionId{1}, See(turned(20.0), 1), std::nullopt, std::nullopt);
  PoseEstimate e = Last(*tracker);
  EXPECT_EQ(e.chain, 0);
  EXPECT_FALSE(e.has_baseline);
  EXPECT_EQ(e.world_from_camera.translation, Eigen::Vector3d::Zero());
  EXPECT_NEAR(e.world_from_camera.rotation.angularDistance(turned(20.0).rotation) / kDegree, 0.0,
              0.1);

  Pose moved = turned(20.0);
  moved.translation.x() += 0.3;
  tracker->Push(PositionId{2}, See(moved, 2), std::nullopt, std::nullopt);
  moved.translation.x() += 0.3;
  tracker->Push(PositionId{3}, See(moved, 3), std::nullopt, std::nullopt);
  e = Last(*tracker);
  EXPECT_EQ(e.chain, 0);
  EXPECT_TRUE(e.has_baseline);
  EXPECT_LT((e.world_from_camera.translation - Eigen::Vector3d(2.0, 0.0, 0.0)).norm(), 0.04);
}

TEST(PoseTracker, ABlackAWhiteAndAGreyPictureAreChainsOfTheirOwnAndTheNextGoesOn) {
  for (const auto& [radiance, flags] :
       {std::pair(0.0F, int{kDarkAny}), std::pair(50.0F, int{kSaturatedAny}), std::pair(1.0F, 0),
        std::pair(0.0F, int{kMasked})}) {
    const auto tracker = MakeTracker();
    for (int i = 0; i < 5; ++i) {
      const bool blank = i == 2;
      tracker->Push(
          PositionId{i},
          blank ? Uniform(radiance, static_cast<std::uint8_t>(flags)) : See(PathPose(i), i),
          std::nullopt, std::nullopt);
    }
    const auto window = tracker->Window();
    EXPECT_EQ(window[1].chain, 0);
    EXPECT_EQ(window[2].chain, 1);
    EXPECT_THAT(window[2].chain_reason, HasSubstr("position 2 shows 0 usable features"));
    EXPECT_EQ(window[3].chain, 0);
    EXPECT_EQ(window[4].chain, 0);
    EXPECT_LT(Compare({window[0], window[1], window[3], window[4]}, Travelled(1)).translation_share,
              0.03);
  }
}

TEST(PoseTracker, AJumpToAnotherRoomBeginsANewChainAndSaysWhy) {
  const auto tracker = MakeTracker();
  for (int i = 0; i < 3; ++i) {
    tracker->Push(PositionId{i}, See(PathPose(i), i), std::nullopt, std::nullopt);
  }
  for (int i = 3; i < 6; ++i) {
    tracker->Push(PositionId{i}, See(PathPose(i), i, 77), std::nullopt, std::nullopt);
  }
  const auto window = tracker->Window();
  EXPECT_EQ(window[2].chain, 0);
  for (std::size_t i = 3; i < 6; ++i) EXPECT_EQ(window[i].chain, 1);
  EXPECT_THAT(window[3].chain_reason,
              HasSubstr("matches agree with any motion between positions 2 and 3"));
  EXPECT_EQ(window[4].chain_reason, "");
  EXPECT_NEAR(
      (window[4].world_from_camera.translation - window[3].world_from_camera.translation).norm(),
      1.0, 1e-9);
}

TEST(PoseTracker, AGivenPoseIsTakenAsItIsAndOthersJoinIt) {
  const auto tracker = MakeTracker();
  for (int i = 0; i < 5; ++i) {
    const auto prior = i == 3 ? std::nullopt : std::optional(PathPose(i));
    tracker->Push(PositionId{i}, See(PathPose(i), i), std::nullopt, prior);
  }
  const auto window = tracker->Window();
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(window[i].chain, 0);
    EXPECT_TRUE(window[i].metric);
    EXPECT_GT(window[i].median_inverse_distance, 0.2);
    if (i == 3) continue;
    EXPECT_EQ(window[i].world_from_camera.translation, PathPose(static_cast<int>(i)).translation);
  }
  EXPECT_LT((window[3].world_from_camera.translation - PathPose(3).translation).norm(), 0.01);
  EXPECT_LT(window[3].world_from_camera.rotation.angularDistance(PathPose(3).rotation) / kDegree,
            0.1);
}

TEST(PoseTracker, AGivenPoseAfterEstimatedOnesBeginsAChain) {
  const auto tracker = MakeTracker();
  tracker->Push(PositionId{0}, See(PathPose(0), 0), std::nullopt, std::nullopt);
  tracker->Push(PositionId{1}, See(PathPose(1), 1), std::nullopt, PathPose(1));
  EXPECT_EQ(Last(*tracker).chain, 1);
  EXPECT_THAT(Last(*tracker).chain_reason, HasSubstr("position 1 has a pose known from elsewhere"));
}

TEST(PoseTracker, AStateThatIsNotOneIsRefusedWithItsFault) {
  const auto tracker = MakeTracker();
  for (const char* text :
       {"", "{", "[]", "{\"version\": 7}",
        R"({"version":1,"next_chain":0,"chains":[],"window":[{"position":1}]})"}) {
    const Status status = tracker->RestoreState(text);
    ASSERT_FALSE(status) << text;
    EXPECT_THAT(status.error().message, HasSubstr("pose state: ")) << text;
  }
  EXPECT_TRUE(tracker->Window().empty());
}

TEST(PoseTracker, OptionsOutOfRangeAreRefusedByName) {
  PoseOptions options;
  options.max_features = 100000;
  const auto tracker = PoseTracker::Create(options);
  ASSERT_FALSE(tracker);
  EXPECT_THAT(tracker.error().message, HasSubstr("pose.max_features is 100000"));
}

}  // namespace
}  // namespace omnihdr::pose_tracker_test
