#include "core/pose/gnss_scale.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "core/pose/tracker.h"
#include "tests/unit/core/pose/feature_world.h"

namespace omnihdr::gnss_scale_test {
namespace {

using ::testing::HasSubstr;

constexpr GeodeticPlace kHome{45.4, -75.7, 70.0};

class Normal {
 public:
  explicit Normal(std::uint32_t seed) : random_(seed) {}
  double operator()() {
    double sum = -6.0;
    for (int k = 0; k < 12; ++k) sum += static_cast<double>(random_()) / 4294967296.0;
    return sum;
  }

 private:
  std::mt19937 random_;
};

GnssClue ClueAt(const Eigen::Vector3d& place, double sigma, Normal& normal) {
  const Eigen::Vector3d noise(sigma * normal(), sigma * normal(), 2.0 * sigma * normal());
  return {PlaceAt(kHome, place + noise), sigma};
}

// A curved way of `count` places, `step` metres apart, in a chain whose unit is 1 / `scale` metres,
// turned and a little tilted.
std::vector<GnssSample> Way(int count, double step, double scale, double sigma,
                            std::uint32_t seed) {
  Normal normal(seed);
  const Eigen::Quaterniond chain_from_world =
      Eigen::AngleAxisd(1.1, Eigen::Vector3d::UnitZ()) *
      Eigen::AngleAxisd(0.06, Eigen::Vector3d(0.6, 0.8, 0.0));
  std::vector<GnssSample> samples;
  for (int i = 0; i < count; ++i) {
    const double a = 0.02 * i;
    const Eigen::Vector3d place(step / 0.02 * std::sin(a), step / 0.02 * (1.0 - std::cos(a)),
                                0.03 * step * i);
    samples.push_back({chain_from_world * place / scale, ClueAt(place, sigma, normal)});
  }
  return samples;
}

TEST(Geodesy, APlaceAndItsEastNorthAndUpAreOneAnothersInverse) {
  const Eigen::Vector3d enu(120.0, -340.0, 12.0);
  EXPECT_LT((EastNorthUp(kHome, PlaceAt(kHome, enu)) - enu).norm(), 1e-3);
  // A minute of latitude is a nautical mile.
  const Eigen::Vector3d north = EastNorthUp({0, 0, 0}, {1.0 / 60.0, 0, 0});
  EXPECT_NEAR(north.y(), 1852.0, 12.0);
  EXPECT_NEAR(EastNorthUp({0, 0, 0}, {0, 1.0 / 60.0, 0}).x(), 1855.3, 1.0);
}

TEST(GnssScale, IsFoundToWhatItsSigmaSaysAndTheSigmaIsHonest) {
  double sum = 0.0;
  constexpr int kTrials = 60;
  for (std::uint32_t seed = 1; seed <= kTrials; ++seed) {
    const auto scale = EstimateGnssScale(Way(40, 1.0, 0.37, 1.0, seed));
    ASSERT_TRUE(scale) << seed;
    EXPECT_EQ(scale->fixes + scale->outliers, 40);
    const double error = (scale->metres_per_unit - 0.37) / scale->sigma;
    EXPECT_LT(std::fabs(error), 4.5) << seed;
    sum += error * error;
  }
  EXPECT_GT(std::sqrt(sum / kTrials), 0.6);
  EXPECT_LT(std::sqrt(sum / kTrials), 1.4);
}

TEST(GnssScale, FixesThatJumpAreLeftOut) {
  for (std::uint32_t seed = 1; seed <= 10; ++seed) {
    std::vector<GnssSample> samples = Way(40, 1.0, 2.5, 0.5, seed);
    for (std::size_t i = 12; i < 20; ++i) {  // eight of forty are seen by way of a wall
      samples[i].clue.place = PlaceAt(samples[i].clue.place, {9.0, -14.0, 20.0});
    }
    const auto scale = EstimateGnssScale(samples);
    ASSERT_TRUE(scale) << seed;
    EXPECT_GE(scale->outliers, 8);
    EXPECT_NEAR(scale->metres_per_unit, 2.5, 4.0 * scale->sigma) << seed;
    EXPECT_LT(scale->sigma, 0.02 * 2.5);
  }
}

TEST(GnssScale, FixesThatScatterMoreThanTheyStateMakeTheSigmaLarger) {
  std::vector<GnssSample> honest = Way(40, 1.0, 1.0, 1.0, 3);
  std::vector<GnssSample> proud = honest;
  for (GnssSample& sample : proud) sample.clue.sigma_m = 0.4;
  const auto a = EstimateGnssScale(honest);
  const auto b = EstimateGnssScale(proud);
  ASSERT_TRUE(a);
  EXPECT_TRUE(!b || b->sigma > 0.6 * a->sigma);
}

TEST(GnssScale, NoiseAloneAStandstillAndTooFewFixesTellNothing) {
  EXPECT_FALSE(EstimateGnssScale(Way(3, 5.0, 1.0, 0.1, 1)));
  std::vector<GnssSample> still = Way(30, 1.0, 1.0, 1.0, 2);
  for (GnssSample& sample : still) sample.translation = {1.0, 2.0, 0.0};
  EXPECT_FALSE(EstimateGnssScale(still));
  const auto short_way = EstimateGnssScale(Way(30, 0.01, 1.0, 3.0, 4));
  EXPECT_TRUE(!short_way || !IsScaleKnown(*short_way));
}

TEST(GnssScale, AJournalLineWithoutAFixIsNoneAndOneWithoutAccuracyIsCoarse) {
  EXPECT_FALSE(ClueFromFix(std::nullopt));
  EXPECT_FALSE(ClueFromFix(GnssFix{45.0, 10.0, 0.0, "", 0}));
  EXPECT_EQ(ClueFromFix(GnssFix{45.0, 10.0, 0.0, "", 1})->sigma_m, kUnstatedGnssSigma);
  GnssFix stated = {45.0, 10.0, 0.0, "", 4};
  stated.error_m = 0.02;
  EXPECT_DOUBLE_EQ(ClueFromFix(stated)->sigma_m, 0.02 / std::numbers::sqrt2);
  stated.error_m = 0.0;
  EXPECT_EQ(ClueFromFix(stated)->sigma_m, kUnstatedGnssSigma);
}

// --- In the tracker ---

constexpr double kRadius = 10.0;
constexpr double kStep = 0.5;
Pose OnCircle(double way) {
  const double a = way / kRadius;
  Pose pose;
  pose.translation = {kRadius * std::sin(a), kRadius * (1.0 - std::cos(a)), 0.0};
  pose.rotation = Eigen::AngleAxisd(a, Eigen::Vector3d::UnitZ());
  return pose;
}

test::FeatureWorld Garden() {
  test::FeatureWorld::Options options;
  options.range = 8.0;
  test::FeatureWorld world(1, options);
  world.Fill({-18.0, -8.0, -2.0}, {18.0, 28.0, 4.0}, 4000);
  return world;
}

struct Tour {
  double sigma = 0.05;
  double odometer_factor = 0.0;  // of what is driven; 0 = no odometer
  std::optional<std::pair<int, int>> outage = std::nullopt;
  std::optional<std::pair<int, int>> jump = std::nullopt;
};

PositionClues CluesOf(const Tour& way, int i, Normal& normal) {
  PositionClues clues;
  if (way.odometer_factor > 0.0) clues.odometer_m = way.odometer_factor * kStep * i;
  Eigen::Vector3d place = OnCircle(kStep * i).translation;
  if (way.jump && i >= way.jump->first && i < way.jump->second) place += Eigen::Vector3d(6, -4, 9);
  const GnssClue clue = ClueAt(place, way.sigma, normal);
  const bool is_out = way.outage && i >= way.outage->first && i < way.outage->second;
  if (way.sigma > 0.0 && !is_out) clues.gnss = clue;
  return clues;
}

// What is final of each position.
std::map<int, PoseEstimate> Follow(const Tour& way, int count, Tracker* tracker) {
  const test::FeatureWorld world = Garden();
  Normal normal(17);
  std::map<int, PoseEstimate> final;
  for (int i = 0; i < count; ++i) {
    tracker->Push(PositionId{i}, world.See(OnCircle(kStep * i), static_cast<std::uint32_t>(i)),
                  CluesOf(way, i, normal));
    for (const PoseEstimate& e : tracker->Window()) {
      if (Value(e.position) == i - 2) final[i - 2] = e;
    }
  }
  return final;
}

double Length(const std::map<int, PoseEstimate>& path, int from, int to) {
  return (path.at(to).world_from_camera.translation - path.at(from).world_from_camera.translation)
      .norm();
}
double TrueLength(int from, int to) {
  return (OnCircle(kStep * to).translation - OnCircle(kStep * from).translation).norm();
}

TEST(TrackerGnss, WithoutOdometerTheChainGoesOnInMetresOnceItsFixesTellTheScale) {
  Tracker tracker{PoseOptions{}};
  const auto path = Follow({.sigma = 0.05}, 30, &tracker);
  int first = 0;
  while (!path.at(first).metric) {
    EXPECT_EQ(path.at(first).chain, 0);
    EXPECT_EQ(path.at(first).scale_source, ScaleSource::kNone);
    ++first;
  }
  EXPECT_GT(first, 3);
  EXPECT_LT(first, 20);
  EXPECT_EQ(path.at(first).chain, 1);
  EXPECT_THAT(path.at(first).chain_reason, HasSubstr("lengths are metres from here on"));
  for (int i = first; i < 28; ++i) {
    EXPECT_EQ(path.at(i).chain, 1) << i;
    EXPECT_EQ(path.at(i).scale_source, ScaleSource::kGnss);
    ASSERT_TRUE(path.at(i).gnss_scale);
    EXPECT_EQ(path.at(i).chain_reason.empty(), i != first) << i;
  }
  EXPECT_NEAR(Length(path, first, 27) / TrueLength(first, 27), 1.0, 0.05);
  EXPECT_NEAR(path.at(27).gnss_scale->metres_per_unit, 1.0,
              4.0 * path.at(27).gnss_scale->sigma + 0.02);
}

TEST(TrackerGnss, FixesTooCoarseForTheWayLeaveTheChainRelativeAndSayHowCoarse) {
  Tracker tracker{PoseOptions{}};
  const auto path = Follow({.sigma = 1.5}, 30, &tracker);
  EXPECT_FALSE(path.at(27).metric);
  EXPECT_EQ(path.at(27).chain, 0);
  if (path.at(27).gnss_scale) {
    EXPECT_GT(path.at(27).gnss_scale->sigma, 0.02 * path.at(27).gnss_scale->metres_per_unit);
    EXPECT_NEAR(path.at(27).gnss_scale->metres_per_unit, kStep,
                4.0 * path.at(27).gnss_scale->sigma);
  }
}

TEST(TrackerGnss, OutagesAndJumpsDelayTheScaleAndDoNotSpoilIt) {
  Tracker tracker{PoseOptions{}};
  const auto path =
      Follow({.sigma = 0.05, .outage = std::pair(4, 9), .jump = std::pair(12, 16)}, 40, &tracker);
  ASSERT_TRUE(path.at(37).metric);
  int first = 0;
  while (!path.at(first).metric) ++first;
  EXPECT_NEAR(Length(path, first, 37) / TrueLength(first, 37), 1.0, 0.06);
  EXPECT_GE(path.at(37).gnss_scale->outliers, 3);
}

TEST(TrackerGnss, TheOdometerIsPreferredAndAContradictionIsToldOnce) {
  Tracker agreeing{PoseOptions{}};
  const auto same = Follow({.sigma = 0.05, .odometer_factor = 1.0}, 30, &agreeing);
  Tracker contradicting{PoseOptions{}};
  const auto off = Follow({.sigma = 0.05, .odometer_factor = 0.9}, 30, &contradicting);
  int told = 0;
  for (int i = 0; i < 28; ++i) {
    EXPECT_EQ(same.at(i).chain, 0);
    EXPECT_EQ(off.at(i).chain, 0);
    EXPECT_EQ(off.at(i).scale_source, ScaleSource::kOdometer);
    EXPECT_TRUE(same.at(i).scale_note.empty()) << same.at(i).scale_note;
    if (off.at(i).scale_note.empty()) continue;
    ++told;
    EXPECT_THAT(off.at(i).scale_note, HasSubstr("of what the odometer has"));
  }
  EXPECT_EQ(told, 1);
  EXPECT_NEAR(Length(off, 1, 27) / TrueLength(1, 27), 0.9, 0.02);
  EXPECT_NEAR(off.at(27).gnss_scale->metres_per_unit, 1.0 / 0.9, 0.03);
}

TEST(TrackerGnss, SavedInTheMiddleAllContinuesToTheLastBit) {
  const test::FeatureWorld world = Garden();
  const Tour way{.sigma = 0.05};
  for (const int stop : {5, 12, 20}) {
    Normal normal(17);
    Tracker whole{PoseOptions{}};
    Tracker resumed{PoseOptions{}};
    std::map<PositionId, SavedKeyframe> keyframes;
    for (int i = 0; i < 26; ++i) {
      const PositionClues clues = CluesOf(way, i, normal);
      const FeatureSet seen = world.See(OnCircle(kStep * i), static_cast<std::uint32_t>(i));
      whole.Push(PositionId{i}, seen, clues);
      if (const auto& keyframe = whole.NewKeyframe()) keyframes[keyframe->position] = *keyframe;
      if (i > stop) resumed.Push(PositionId{i}, seen, clues);
      if (i == stop) {
        ASSERT_TRUE(resumed.RestoreState(whole.SaveState()));
        for (const PoseEstimate& e : whole.Window()) {
          const auto k = Value(e.position);
          resumed.Rewarm(e.position, world.See(OnCircle(kStep * static_cast<double>(k)),
                                               static_cast<std::uint32_t>(k)));
        }
        for (const PositionId position : resumed.Keyframes()) {
          ASSERT_TRUE(resumed.RestoreKeyframe(keyframes.at(position)));
        }
      }
    }
    EXPECT_EQ(resumed.SaveState(), whole.SaveState()) << stop;
  }
}

}  // namespace
}  // namespace omnihdr::gnss_scale_test
