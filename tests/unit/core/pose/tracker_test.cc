#include "core/pose/tracker.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <utility>

#include "tests/unit/core/pose/feature_world.h"

namespace omnihdr::tracker_test {
namespace {

using test::FeatureWorld;
using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr double kDegree = M_PI / 180.0;

// Round a circle, looking along the way, `step` metres a position.
constexpr double kRadius = 10.0;
Pose OnCircle(double way) {
  const double a = way / kRadius;
  Pose pose;
  pose.translation = {kRadius * std::sin(a), kRadius * (1.0 - std::cos(a)),
                      0.05 * std::sin(3.0 * a)};
  pose.rotation = Eigen::AngleAxisd(a, Eigen::Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(0.01 * std::sin(5.0 * a), Eigen::Vector3d::UnitY());
  return pose;
}

FeatureWorld Garden(std::uint32_t seed = 1, double range = 8.0, double sigma_rad = 3.0e-4,
                    int max_features = 300) {
  FeatureWorld::Options options;
  options.max_features = max_features;
  options.range = range;
  options.sigma_rad = sigma_rad;
  FeatureWorld world(seed, options);
  // The circle's centre is at (0, 10): seen from there the points are a ring.
  world.Fill({-18.0, -8.0, -2.0}, {18.0, 28.0, 4.0}, 4000);
  return world;
}

Pose Relative(const Pose& a, const Pose& b) { return a.Inverse() * b; }

double AngleDeg(const Pose& a, const Pose& b) {
  return a.rotation.angularDistance(b.rotation) / kDegree;
}

PoseEstimate Last(const Tracker& tracker) { return tracker.Window().back(); }

PositionClues Odometer(double way) {
  PositionClues clues;
  clues.odometer_m = way;
  return clues;
}

// --- Uncertainty ---

struct Spread {
  double sum = 0.0;  // of squared errors in sigmas
  int count = 0;
  int beyond_3 = 0;
  void Add(const Eigen::Vector3d& error, const Eigen::Vector3d& sigma) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      const double z = error[k] / sigma[k];
      sum += z * z;
      ++count;
      beyond_3 += std::fabs(z) > 3.0 ? 1 : 0;
    }
  }
  double Rms() const { return std::sqrt(sum / count); }
};

Eigen::Vector3d RotationError(const Eigen::Quaterniond& truth, const Eigen::Quaterniond& found) {
  const Eigen::AngleAxisd error(truth.conjugate() * found);
  return error.angle() * error.axis() / kDegree;
}

// Six positions of a chain against the truth, over many noises.
void MeasureSpread(double sigma_rad, bool odometer, Spread* rotation, Spread* translation) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    const FeatureWorld world = Garden(seed, 6.0, sigma_rad);
    std::mt19937 random(seed);
    Tracker tracker{PoseOptions{}};
    double told = 50.0;
    for (int i = 0; i < 6; ++i) {
      if (i > 0) {
        // The odometer's error is what the tracker takes it for, roughly normal.
        double noise = -6.0;
        for (int k = 0; k < 12; ++k) noise += static_cast<double>(random()) / 4294967296.0;
        told += 0.3 + (0.003 * 0.3 + 0.002) * noise;
      }
      tracker.Push(PositionId{i},
                   world.See(OnCircle(0.3 * i), 1000 * seed + static_cast<std::uint32_t>(i)),
                   odometer ? Odometer(told) : PositionClues{});
    }
    const auto window = tracker.Window();
    ASSERT_THAT(window, SizeIs(6));
    EXPECT_FALSE(window[0].sigma) << "held by definition";
    const double unit = odometer ? 1.0 : Relative(OnCircle(0.0), OnCircle(0.3)).translation.norm();
    for (std::size_t i = 1; i < window.size(); ++i) {
      ASSERT_TRUE(window[i].sigma);
      const Pose truth = Relative(OnCircle(0.0), OnCircle(0.3 * static_cast<double>(i)));
      rotation->Add(RotationError(truth.rotation, window[i].world_from_camera.rotation),
                    window[i].sigma->rotation_deg);
      // The unit's own direction of length is exact: sigma 0, error 0.
      if (!odometer && i == 1) continue;
      translation->Add(window[i].world_from_camera.translation - truth.translation / unit,
                       window[i].sigma->translation);
    }
  }
}

TEST(TrackerSigma, ErrorsAreAsLargeAsTheirSigmasSay) {
  for (const auto& [sigma_rad, odometer] : {std::pair(1.5e-4, false), std::pair(6.0e-4, true)}) {
    Spread rotation;
    Spread translation;
    MeasureSpread(sigma_rad, odometer, &rotation, &translation);
    std::printf(
        "%.2f mrad, odometer %d: errors of %.2f (rotation), %.2f (translation) sigmas, "
        "%d and %d of %d beyond 3\n",
        1e3 * sigma_rad, odometer ? 1 : 0, rotation.Rms(), translation.Rms(), rotation.beyond_3,
        translation.beyond_3, rotation.count);
    for (const Spread& spread : {rotation, translation}) {
      EXPECT_GT(spread.Rms(), 0.75);
      EXPECT_LT(spread.Rms(), 1.35);
      EXPECT_LT(spread.beyond_3, spread.count / 40);
    }
  }
}

TEST(TrackerSigma, AGivenPoseHasNoneAndOneThatJoinsItHas) {
  const FeatureWorld world = Garden();
  Tracker tracker{PoseOptions{}};
  for (int i = 0; i < 4; ++i) {
    PositionClues clues;
    if (i != 2) clues.prior = OnCircle(0.3 * i);
    tracker.Push(PositionId{i}, world.See(OnCircle(0.3 * i), static_cast<std::uint32_t>(i)), clues);
  }
  const auto window = tracker.Window();
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(window[i].sigma.has_value(), i == 2) << i;
  ASSERT_TRUE(window[2].sigma);
  EXPECT_GT(window[2].sigma->rotation_deg.minCoeff(), 1e-4);
  EXPECT_LT(window[2].sigma->rotation_deg.maxCoeff(), 0.1);
  EXPECT_LT(window[2].sigma->translation.maxCoeff(), 0.01);
}

// --- Old places ---

// A drive: where it is at every position, and where its pictures show nothing.
struct Drive {
  std::vector<double> way;
  std::vector<bool> blind;
};

// Onwards, then blind for `gap` positions while it is carried off and put down elsewhere, then on
// towards the beginning and past it.
Drive LostAndBack(int before, int gap, double put_down_at, int after, double step = 0.4) {
  Drive drive;
  for (int i = 0; i < before; ++i) drive.way.push_back(step * i);
  for (int i = 0; i < gap; ++i) drive.way.push_back(drive.way.back());
  for (int i = 0; i < after; ++i) drive.way.push_back(put_down_at + step * i);
  for (std::size_t i = 0; i < drive.way.size(); ++i) {
    const int k = static_cast<int>(i) - before;
    drive.blind.push_back(k >= 0 && k < gap);
  }
  return drive;
}

FeatureSet SeeOn(const FeatureWorld& world, const Drive& drive, std::size_t i) {
  if (drive.blind[i]) return {};
  return world.See(OnCircle(drive.way[i]), static_cast<std::uint32_t>(i));
}

// Everything that was ever final of each position: the estimate two positions later.
std::map<int, PoseEstimate> Follow(const FeatureWorld& world, const Drive& drive, bool odometer,
                                   Tracker* tracker) {
  std::map<int, PoseEstimate> final_of;
  for (std::size_t i = 0; i < drive.way.size(); ++i) {
    tracker->Push(PositionId{static_cast<int>(i)}, SeeOn(world, drive, i),
                  odometer ? Odometer(100.0 + 0.4 * static_cast<double>(i)) : PositionClues{});
    const auto window = tracker->Window();
    if (window.size() >= 3) {
      const PoseEstimate& e = window[window.size() - 3];
      final_of[static_cast<int>(Value(e.position))] = e;
    }
  }
  return final_of;
}

constexpr double kRound = 2.0 * M_PI * kRadius;

TEST(TrackerOldPlaces, APositionThatIsLostAndSeesAnOldPlaceIsPutIntoItsChain) {
  const FeatureWorld world = Garden();
  // Carried off behind the start, out of reach of what chain 0 saw, on towards it.
  const Drive drive = LostAndBack(14, 4, 1.2, 10);
  Tracker tracker{PoseOptions{}};
  const auto found = Follow(world, drive, true, &tracker);
  const PoseEstimate& back = found.at(18);
  EXPECT_EQ(back.chain, 0);
  EXPECT_TRUE(back.metric);
  ASSERT_TRUE(back.relocalised);
  EXPECT_NE(back.relocalised->from_chain, 0);
  EXPECT_GE(back.relocalised->matches, 20);
  EXPECT_EQ(Value(back.relocalised->seen_from), 18);
  EXPECT_EQ(back.chain_reason, "");
  for (int i = 18; i < 26; ++i) {
    const PoseEstimate& e = found.at(i);
    EXPECT_EQ(e.chain, 0) << i;
    const Pose truth = Relative(OnCircle(0.0), OnCircle(drive.way[static_cast<std::size_t>(i)]));
    EXPECT_LT((e.world_from_camera.translation - truth.translation).norm(), 0.06) << i;
    EXPECT_LT(AngleDeg(e.world_from_camera, truth), 0.3) << i;
    ASSERT_TRUE(e.sigma) << i;
  }
  EXPECT_FALSE(found.at(20).relocalised) << "only where it happened";
}

TEST(TrackerOldPlaces, AChainBegunElsewhereEndsWhereAnOldPlaceIsSeenAndKeepsTheOldUnit) {
  const FeatureWorld world = Garden(1, 6.0);
  for (const bool odometer : {false, true}) {
    // Put down 20 m before the start: beyond what chain 0 saw.
    const Drive drive = LostAndBack(16, 4, kRound - 20.0, 56);
    Tracker tracker{PoseOptions{}};
    const auto found = Follow(world, drive, odometer, &tracker);
    EXPECT_NE(found.at(24).chain, 0);
    EXPECT_EQ(found.at(73).chain, 0);
    int first = 20;
    while (found.at(first).chain != 0) ++first;
    const PoseEstimate& joined = found.at(first);
    ASSERT_TRUE(joined.relocalised);
    EXPECT_EQ(joined.relocalised->from_chain, found.at(first - 1).chain);
    EXPECT_EQ(Value(joined.relocalised->seen_from), first + 2) << "views not yet made come along";
    const double unit = odometer ? 1.0 : Relative(OnCircle(0.0), OnCircle(0.4)).translation.norm();
    std::printf("joined at position %d, with %d points of position %d\n", first,
                joined.relocalised->matches, static_cast<int>(Value(joined.relocalised->place)));
    for (int i = first; i < 74; ++i) {
      const PoseEstimate& e = found.at(i);
      EXPECT_EQ(e.metric, odometer);
      const Pose truth = Relative(OnCircle(0.0), OnCircle(drive.way[static_cast<std::size_t>(i)]));
      EXPECT_LT((unit * e.world_from_camera.translation - truth.translation).norm(), 0.35) << i;
      EXPECT_LT(AngleDeg(e.world_from_camera, truth), 0.8) << i;
    }
  }
}

TEST(TrackerOldPlaces, AnotherWorldIsNotTakenForAnOldPlace) {
  const FeatureWorld here = Garden(1);
  const FeatureWorld there = Garden(2);
  Tracker tracker{PoseOptions{}};
  for (int i = 0; i < 60; ++i) {
    const FeatureWorld& world = i < 20 ? here : there;
    tracker.Push(PositionId{i}, world.See(OnCircle(0.4 * i), static_cast<std::uint32_t>(i)), {});
    const PoseEstimate e = Last(tracker);
    EXPECT_FALSE(e.relocalised || e.loop) << i;
    EXPECT_EQ(e.chain, i < 20 ? 0 : 1) << i;
  }
}

TEST(TrackerOldPlaces, WithoutKeyframesALostTrackIsANewChain) {
  const FeatureWorld world = Garden();
  PoseOptions options;
  options.keyframes = 0;
  Tracker tracker(options);
  const auto found = Follow(world, LostAndBack(14, 4, 1.2, 10), true, &tracker);
  EXPECT_NE(found.at(18).chain, 0);
  EXPECT_THAT(tracker.Keyframes(), SizeIs(0));
}

TEST(TrackerOldPlaces, SavedInTheMiddleAllContinuesToTheLastBit) {
  const FeatureWorld world = Garden(1, 6.0);
  const Drive drive = LostAndBack(16, 4, kRound - 20.0, 50);
  const auto push = [&](Tracker& tracker, std::size_t i) {
    tracker.Push(PositionId{static_cast<int>(i)}, SeeOn(world, drive, i), {});
  };
  PoseOptions options;
  options.keyframes = 12;  // so that they are thinned on the way
  Tracker whole(options);
  std::map<int, std::string> bytes;
  std::vector<std::string> states;
  int events = 0;
  for (std::size_t i = 0; i < drive.way.size(); ++i) {
    push(whole, i);
    if (whole.NewKeyframe()) {
      bytes[static_cast<int>(Value(whole.NewKeyframe()->position))] = whole.NewKeyframe()->bytes;
    }
    events += Last(whole).relocalised ? 1 : 0;
    states.push_back(whole.SaveState());
  }
  ASSERT_GE(events, 1);
  for (const std::size_t at : {17U, 21U, 50U}) {
    Tracker resumed(options);
    ASSERT_TRUE(resumed.RestoreState(states[at]));
    for (const PoseEstimate& e : resumed.Window()) {
      resumed.Rewarm(e.position, SeeOn(world, drive, static_cast<std::size_t>(Value(e.position))));
    }
    for (const PositionId position : resumed.Keyframes()) {
      const Status restored =
          resumed.RestoreKeyframe({position, bytes.at(static_cast<int>(Value(position)))});
      ASSERT_TRUE(restored) << restored.error().message;
    }
    for (std::size_t i = at + 1; i < drive.way.size(); ++i) push(resumed, i);
    EXPECT_EQ(resumed.SaveState(), states.back()) << "saved at " << at;
  }
}

TEST(TrackerOldPlaces, AKeyframeThatIsNotTheSavedOneIsRefused) {
  const FeatureWorld world = Garden();
  Tracker tracker{PoseOptions{}};
  std::optional<SavedKeyframe> keyframe;
  for (int i = 0; i < 6; ++i) {
    tracker.Push(PositionId{i}, world.See(OnCircle(0.4 * i), static_cast<std::uint32_t>(i)), {});
    if (tracker.NewKeyframe()) keyframe = tracker.NewKeyframe();
  }
  ASSERT_TRUE(keyframe);
  Tracker other{PoseOptions{}};
  ASSERT_TRUE(other.RestoreState(tracker.SaveState()));
  EXPECT_TRUE(other.RestoreKeyframe(*keyframe));
  SavedKeyframe damaged = *keyframe;
  damaged.bytes[damaged.bytes.size() / 2] ^= 1;
  Status status = other.RestoreKeyframe(damaged);
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().message, HasSubstr("crc32c"));
  damaged = *keyframe;
  damaged.position = PositionId{77};
  status = other.RestoreKeyframe(damaged);
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().message, HasSubstr("position 77 is not remembered"));
}

// --- Scale ---

// Largest error of a baseline by odometer, as a share of it, over a drive of eight positions.
double WorstBaseline(const std::function<Pose(int)>& truth, double travelled_per_step) {
  const FeatureWorld world = Garden(3, 8.0, 1.5e-4);
  Tracker tracker{PoseOptions{}};
  for (int i = 0; i < 8; ++i) {
    tracker.Push(PositionId{i}, world.See(truth(i), 77 + static_cast<std::uint32_t>(i)),
                 Odometer(20.0 + travelled_per_step * i));
  }
  const auto window = tracker.Window();
  double worst = 0.0;
  for (std::size_t i = 1; i < window.size(); ++i) {
    const int at = static_cast<int>(Value(window[i].position));
    const double found =
        Relative(window[i - 1].world_from_camera, window[i].world_from_camera).translation.norm();
    const double right = Relative(truth(at - 1), truth(at)).translation.norm();
    worst = std::max(worst, std::fabs(found / right - 1.0));
  }
  return worst;
}

TEST(TrackerScale, AHeadThatTurnsOnAStraightWayDoesNotShortenIt) {
  const auto truth = [](int i) {
    Pose pose;
    pose.translation = {0.4 * i - 1.0, 0.1 * i, 0.0};
    pose.rotation = Eigen::AngleAxisd(60.0 * kDegree * i, Eigen::Vector3d::UnitZ());
    return pose;
  };
  EXPECT_LT(WorstBaseline(truth, std::hypot(0.4, 0.1)), 0.005);
}

TEST(TrackerScale, AWayThatTurnsIsShorterThanWhatTheWheelsCounted) {
  constexpr double kTightRadius = 1.0;
  const auto truth = [](int i) {
    const double angle = 40.0 * kDegree * i;
    Pose pose;
    pose.translation = {kTightRadius * std::sin(angle), kTightRadius * (1.0 - std::cos(angle)),
                        0.0};
    pose.rotation = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ());
    return pose;
  };
  EXPECT_LT(WorstBaseline(truth, 40.0 * kDegree * kTightRadius), 0.005);
}

TEST(Keyframes, BytesReadBackAndTornOrForeignOnesAreRefused) {
  Keyframe keyframe;
  keyframe.position = PositionId{12};
  keyframe.ordinal = 9;
  keyframe.chain = 2;
  keyframe.world_from_camera = OnCircle(3.0);
  keyframe.path = 4.5;
  keyframe.median_inverse_distance = 0.25;
  keyframe.features = Garden().See(OnCircle(3.0), 5);
  keyframe.inverse_distance.assign(keyframe.features.features.size(), 0.2);
  const std::string bytes = KeyframeToBytes(keyframe);
  const Result<Keyframe> read = KeyframeFromBytes(bytes);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(KeyframeToBytes(*read), bytes);
  EXPECT_EQ(read->features.descriptors, keyframe.features.descriptors);
  for (const std::string& wrong :
       {std::string(), std::string("PNG"), bytes.substr(0, bytes.size() - 1), bytes + "x",
        bytes.substr(0, 40)}) {
    const Result<Keyframe> refused = KeyframeFromBytes(wrong);
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().message, HasSubstr("keyframe: "));
  }
}

TEST(TrackerOldPlaces, WhatTheOdometerAddsUpRoundALoopIsToldAndPutRight) {
  const FeatureWorld world = Garden();
  Tracker tracker{PoseOptions{}};
  constexpr double kStep = 0.4;
  std::optional<LoopClosure> corrected;
  std::map<int, PoseEstimate> final_of;
  double worst_after = 0.0;
  for (int i = 0; i < 170; ++i) {
    const double way = kStep * i;
    // Wheels that slip more and more.
    tracker.Push(PositionId{i}, world.See(OnCircle(way), static_cast<std::uint32_t>(i)),
                 Odometer(way * (1.0 + 0.002 * way)));
    const auto window = tracker.Window();
    const PoseEstimate& e = window.back();
    ASSERT_EQ(e.chain, 0);
    if (window.size() >= 3) final_of[i - 2] = window[window.size() - 3];
    const double error =
        (e.world_from_camera.translation - Relative(OnCircle(0.0), OnCircle(way)).translation)
            .norm();
    if (e.loop && e.loop->corrected && !corrected) {
      corrected = e.loop;
      std::printf(
          "at position %d: place %d with %d points, drift %.2f m, %.2f degrees; now %.3f m\n", i,
          static_cast<int>(Value(e.loop->place)), e.loop->matches, e.loop->drift_translation,
          e.loop->drift_rotation_deg, error);
    }
    if (corrected) worst_after = std::max(worst_after, error);
  }
  ASSERT_TRUE(corrected);
  EXPECT_GT(corrected->drift_translation, 0.5);
  EXPECT_LT(worst_after, 0.5 * corrected->drift_translation);
  // The step is before the first view that was not yet made, and that view says so.
  const int seam = static_cast<int>(Value(corrected->seen_from)) - 2;
  EXPECT_FALSE(final_of.at(seam - 1).loop && final_of.at(seam - 1).loop->corrected);
  for (const int i : {seam, seam + 1, seam + 2}) {
    ASSERT_TRUE(final_of.at(i).loop) << i;
    EXPECT_TRUE(final_of.at(i).loop->corrected) << i;
  }
  const double step = (final_of.at(seam).world_from_camera.translation -
                       final_of.at(seam - 1).world_from_camera.translation)
                          .norm();
  EXPECT_GT(step, 0.3);
}

// --- A long drive ---

TEST(TrackerLongDrive, RoundAndRoundTheChainHoldsPlacesAreKnownAgainAndNothingGrows) {
  const FeatureWorld world = Garden(1, 6.0, 3.0e-4, 200);
  PoseOptions options;
  options.keyframes = 32;
  Tracker tracker(options);
  constexpr double kStep = 0.4;
  constexpr int kPositions = 400;  // two and a half times round
  int recognised = 0;
  double worst_before = 0.0;
  double worst_after = 0.0;
  std::vector<double> seconds;
  std::size_t largest_early = 0;
  std::size_t largest_late = 0;
  const double unit = Relative(OnCircle(0.0), OnCircle(kStep)).translation.norm();
  for (int i = 0; i < kPositions; ++i) {
    const FeatureSet features = world.See(OnCircle(kStep * i), static_cast<std::uint32_t>(i));
    const auto start = std::chrono::steady_clock::now();
    tracker.Push(PositionId{i}, features, {});
    seconds.push_back(
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    const PoseEstimate e = Last(tracker);
    ASSERT_EQ(e.chain, 0) << e.chain_reason;
    ASSERT_LE(tracker.Keyframes().size(), 32U);
    const Pose truth = Relative(OnCircle(0.0), OnCircle(kStep * i));
    const double error = (unit * e.world_from_camera.translation - truth.translation).norm();
    if (kStep * i < kRound) {
      worst_before = std::max(worst_before, error);
      EXPECT_FALSE(e.loop && kStep * i < 0.8 * kRound) << i;
    } else {
      worst_after = std::max(worst_after, error);
    }
    recognised += e.loop ? 1 : 0;
    std::size_t& largest = i < kPositions / 2 ? largest_early : largest_late;
    largest = std::max(largest, tracker.SaveState().size());
  }
  const auto median = [&](int begin, int end) {
    std::vector<double> part(seconds.begin() + begin, seconds.begin() + end);
    std::nth_element(part.begin(), part.begin() + part.size() / 2, part.end());
    return part[part.size() / 2];
  };
  std::printf(
      "%d of %d positions recognised a place; largest error %.3f m on the first round, %.3f "
      "m afterwards; %.2f ms a position at first, %.2f ms at last; state %zu and %zu bytes\n",
      recognised, kPositions, worst_before, worst_after, 1e3 * median(20, 120),
      1e3 * median(300, 400), largest_early, largest_late);
  EXPECT_GE(recognised, 100);
  EXPECT_LT(worst_after, 1.3 * worst_before + 0.1) << "no new drift on later rounds";
  EXPECT_LT(median(300, 400), 3.0 * median(20, 120));
  EXPECT_LT(largest_late, 1.5 * static_cast<double>(largest_early));
}

}  // namespace
}  // namespace omnihdr::tracker_test
