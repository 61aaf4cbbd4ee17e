#include "core/capture/bracket_plan.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <limits>
#include <set>

namespace omnihdr::bracket_plan_test {
namespace {

ExposureTime Seconds(double s) { return ExposureTime::Seconds(s); }

std::vector<int> FirstSteps(const BracketPlan& plan, int count) {
  std::vector<int> steps;
  for (int i = 0; i < count; ++i) {
    steps.push_back(plan.StepForTrigger(TriggerId{static_cast<std::uint64_t>(i)}));
  }
  return steps;
}

std::string RefusalOf(const BracketOptions& options, const ExposureLimits& limits = {}) {
  const auto plan = BracketPlan::Make(options, limits);
  if (plan) return "accepted";
  EXPECT_EQ(plan.error().kind, ErrorKind::kConfig);
  return plan.error().message;
}

TEST(BracketPlan, ASawtoothStartsOverAfterTheLastStep) {
  const auto plan = BracketPlan::Make({.order = BracketOrder::kSawtooth, .count = 3}, {}).value();
  EXPECT_EQ(FirstSteps(plan, 7), (std::vector<int>{0, 1, 2, 0, 1, 2, 0}));
}

TEST(BracketPlan, ATriangleTurnsAtItsEndsWithoutRepeatingThem) {
  const auto plan = BracketPlan::Make({.order = BracketOrder::kTriangle, .count = 3}, {}).value();
  EXPECT_EQ(FirstSteps(plan, 9), (std::vector<int>{0, 1, 2, 1, 0, 1, 2, 1, 0}));
  const auto two = BracketPlan::Make({.order = BracketOrder::kTriangle, .count = 2}, {}).value();
  EXPECT_EQ(FirstSteps(two, 4), (std::vector<int>{0, 1, 0, 1}));
  const auto one = BracketPlan::Make({.order = BracketOrder::kTriangle, .count = 1}, {}).value();
  EXPECT_EQ(FirstSteps(one, 3), (std::vector<int>{0, 0, 0}));
}

TEST(BracketPlan, AListIsTakenAsGiven) {
  BracketOptions options{.order = BracketOrder::kList};
  options.exposures = {Seconds(0.001), Seconds(0.016), Seconds(0.001), Seconds(0.004)};
  const auto plan = BracketPlan::Make(options, {}).value();
  EXPECT_DOUBLE_EQ(plan.ForTrigger(TriggerId{5}).time.seconds(), 0.016);
  EXPECT_DOUBLE_EQ(plan.ForTrigger(TriggerId{7}).time.seconds(), 0.004);
}

TEST(BracketPlan, ATurnIsWhatTriggersGetUntilTheyBeginAnew) {
  const auto saw = BracketPlan::Make({.count = 3}, {}).value();
  EXPECT_EQ(saw.Turn().size(), 3U);
  const auto plan = BracketPlan::Make({.order = BracketOrder::kTriangle, .count = 3}, {}).value();
  ASSERT_EQ(plan.Turn().size(), 4U);
  for (std::uint64_t i = 0; i < 12; ++i) {
    EXPECT_EQ(plan.ForTrigger(TriggerId{i}), plan.Turn()[i % plan.Period()]);
  }
}

TEST(BracketPlan, StepsAreStopsApartFromTheStart) {
  BracketOptions options{.start = Seconds(0.016), .step = Stops{-1.6}, .count = 3};
  options.gain = GainDb{6.0};
  const auto plan = BracketPlan::Make(options, {}).value();
  EXPECT_DOUBLE_EQ(plan.exposures()[0].seconds(), 0.016);
  EXPECT_NEAR((plan.exposures()[0] - plan.exposures()[2]).value, 3.2, 1e-12);
  EXPECT_DOUBLE_EQ(plan.ForTrigger(TriggerId{1}).gain.value, 6.0);
}

TEST(BracketPlan, ExposuresOfHalfAPeriodOfTheMainsAndMoreAreMultiplesOfIt) {
  BracketOptions options;
  options.exposures = {Seconds(0.004), Seconds(0.012), Seconds(0.036)};
  options.flicker_hz = 50;
  const auto plan = BracketPlan::Make(options, {}).value();
  EXPECT_DOUBLE_EQ(plan.exposures()[0].seconds(), 0.004) << "shorter ones cannot be safe";
  EXPECT_DOUBLE_EQ(plan.exposures()[1].seconds(), 0.01);
  EXPECT_DOUBLE_EQ(plan.exposures()[2].seconds(), 0.04);
  ASSERT_EQ(plan.changes().size(), 2U);
  EXPECT_EQ(plan.changes()[0],
            "exposure 1: 0.01 s instead of 0.012 s, a multiple of half a period of 50 Hz");
  options.flicker_hz = 60;
  EXPECT_NEAR(BracketPlan::Make(options, {}).value().exposures()[1].seconds(), 1.0 / 120.0, 1e-15);
  options.flicker_hz = 0;
  EXPECT_TRUE(BracketPlan::Make(options, {}).value().changes().empty());
  // Where the camera cannot expose so long, the multiple below.
  options.flicker_hz = 50;
  const auto limited = BracketPlan::Make(options, {.longest = Seconds(0.0375)}).value();
  EXPECT_DOUBLE_EQ(limited.exposures()[2].seconds(), 0.03);
}

TEST(BracketPlan, StepsThatTheMainsMakeEqualAreRefusedWithTheReason) {
  BracketOptions options;
  options.exposures = {Seconds(0.009), Seconds(0.011), Seconds(0.014)};
  options.flicker_hz = 50;
  EXPECT_EQ(RefusalOf(options),
            "bracket: exposures 1 and 2 are both 0.01 s (the camera's quantum is 0 s, half a "
            "period of 50 Hz 0.01 s): expected different ones");
  options.flicker_hz = 55;
  EXPECT_EQ(RefusalOf(options), "bracket: flicker_hz 55: expected 0, 50 or 60");
}

TEST(BracketPlan, WhatTheCamerasQuantumChangesIsTold) {
  BracketOptions options;
  options.exposures = {Seconds(0.001), Seconds(0.00337)};
  const auto plan = BracketPlan::Make(options, {.quantum_s = 0.0005}).value();
  EXPECT_EQ(plan.changes(),
            (std::vector<std::string>{
                "exposure 1: 0.0035 s instead of 0.00337 s, a multiple of the camera's 0.0005 s"}));
}

TEST(BracketPlan, TheStepThatBlursMoreThanIsAcceptedIsNamedWithTheTimeThatWouldDo) {
  BracketOptions options;
  options.exposures = {Seconds(0.001), Seconds(0.004), Seconds(0.016)};
  options.max_blur_px = 2.0;
  options.speed_m_s = 10.0;
  options.near_m = 5.0;
  // 2 rad/s; a pixel of 1 mrad is passed in 0.5 ms.
  EXPECT_EQ(RefusalOf(options, {.pixel_rad = 0.001}),
            "bracket: exposure 1 is 0.004 s: what is 5 m away is blurred over 8 pixels at 10 "
            "m/s: expected at most 0.001 s for max_blur_px = 2");
  EXPECT_EQ(RefusalOf(options, {.pixel_rad = 0.016}), "accepted");
  EXPECT_EQ(RefusalOf(options), "accepted") << "how large a pixel is, the camera has yet to tell";
  options.speed_m_s = 0.0;
  EXPECT_EQ(RefusalOf(options),
            "bracket: max_blur_px 2 with speed_m_s 0 and near_m 5: expected a speed and a distance "
            "above 0");
}

TEST(BracketPlan, AnAngleOfAPixelFollowsFromThePictureOrTheRig) {
  CameraDescription camera;
  camera.width = 2000;
  EXPECT_NEAR(PixelAngle(camera, {}), 0.0031416, 1e-6);
  camera.layout = Layout::kPerspective;
  camera.intrinsics.fx = 500.0;
  EXPECT_DOUBLE_EQ(PixelAngle(camera, {}), 0.002);
  camera.layout = Layout::kRig;
  EXPECT_EQ(PixelAngle(camera, {}), 0.0);
  const std::string rig =
      "format = \"omnihdr-rig\"\nversion = 1\n[[sensor]]\nname = \"0\"\nsize = [64, 64]\n"
      "lens = \"pinhole\"\nfocal = [40.0, 40.0]\ncentre = [32.0, 32.0]\n"
      "distortion = [0, 0, 0, 0, 0]\nfov_deg = 80\nrotation = [1, 0, 0, 0]\n"
      "translation = [0, 0, 0]\n";
  EXPECT_DOUBLE_EQ(PixelAngle(camera, {{"rig.toml", rig}}), 1.0 / 40.0);
}

TEST(BracketPlan, ExposuresAreMultiplesOfTheCamerasQuantum) {
  BracketOptions options;
  options.exposures = {Seconds(0.00101), Seconds(0.00396)};
  const auto plan = BracketPlan::Make(options, {.quantum_s = 0.0005}).value();
  EXPECT_DOUBLE_EQ(plan.exposures()[0].seconds(), 0.001);
  EXPECT_DOUBLE_EQ(plan.exposures()[1].seconds(), 0.004);
}

TEST(BracketPlan, FramesOfOnePositionShareIt) {
  const auto plan = BracketPlan::Make({.count = 3, .frames_per_position = 3}, {}).value();
  EXPECT_EQ(Value(plan.PositionForTrigger(TriggerId{2})), 0);
  EXPECT_EQ(Value(plan.PositionForTrigger(TriggerId{3})), 1);
}

TEST(BracketPlan, WhatACameraCannotDoIsRefusedByName) {
  const ExposureLimits limits{Seconds(0.0001), Seconds(0.01), 0.0};
  EXPECT_EQ(RefusalOf({.start = Seconds(0.004), .step = Stops{1.0}, .count = 3}, limits),
            "bracket: exposure 2 is 0.016 s: the camera's longest is 0.01 s");
  EXPECT_EQ(RefusalOf({.start = Seconds(0.00004), .step = Stops{1.0}, .count = 2}, limits),
            "bracket: exposure 0 is 4e-05 s: the camera's shortest is 0.0001 s");
}

TEST(BracketPlan, TimesThatAreNoTimesAreRefused) {
  for (const double bad : {0.0, -0.001, std::numeric_limits<double>::quiet_NaN(),
                           std::numeric_limits<double>::infinity()}) {
    BracketOptions options;
    options.exposures = {Seconds(0.001), Seconds(bad)};
    EXPECT_NE(RefusalOf(options).find("expected a positive finite time"), std::string::npos) << bad;
  }
}

TEST(BracketPlan, EqualStepsAreRefused) {
  BracketOptions options;
  options.exposures = {Seconds(0.001), Seconds(0.004), Seconds(0.001)};
  EXPECT_NE(RefusalOf(options).find("exposures 0 and 2 are both 0.001 s"), std::string::npos);
  // Different on paper, equal to this camera.
  options.exposures = {Seconds(0.0010), Seconds(0.0012)};
  EXPECT_NE(RefusalOf(options, {.quantum_s = 0.0005}).find("quantum is 0.0005 s"),
            std::string::npos);
  EXPECT_NE(RefusalOf({.step = Stops{0.0}, .count = 2}).find("are both"), std::string::npos);
}

TEST(BracketPlan, AnExposureBelowHalfAQuantumIsRefused) {
  BracketOptions options;
  options.exposures = {Seconds(0.0001)};
  EXPECT_NE(RefusalOf(options, {.quantum_s = 0.0005}).find("shortest"), std::string::npos);
}

TEST(BracketPlan, CountsOutOfRangeAreRefused) {
  EXPECT_EQ(RefusalOf({.count = 0}), "bracket: count 0: expected 1 to 64");
  EXPECT_EQ(RefusalOf({.count = 65}), "bracket: count 65: expected 1 to 64");
  EXPECT_EQ(RefusalOf({.frames_per_position = 0}),
            "bracket: frames per position 0: expected 1 to 1000");
  EXPECT_EQ(RefusalOf({.order = BracketOrder::kList}), "bracket: the list of exposures is empty");
}

RC_GTEST_PROP(BracketPlan, EveryStepComesUpInEveryPeriodAndNeighboursDiffer, ()) {
  const bool triangle = *rc::gen::arbitrary<bool>();
  const int count = *rc::gen::inRange(2, 20);
  const auto plan =
      BracketPlan::Make({.order = triangle ? BracketOrder::kTriangle : BracketOrder::kSawtooth,
                         .start = Seconds(1e-6),
                         .step = Stops{0.5},
                         .count = count},
                        {})
          .value();
  const int period = triangle ? 2 * (count - 1) : count;
  const auto from = *rc::gen::inRange<std::uint64_t>(0, std::uint64_t{1} << 40);
  std::set<int> seen;
  for (int i = 0; i < period; ++i) {
    const TriggerId now{from + static_cast<std::uint64_t>(i)};
    const TriggerId next{Value(now) + 1};
    seen.insert(plan.StepForTrigger(now));
    RC_ASSERT(plan.StepForTrigger(now) != plan.StepForTrigger(next));
  }
  RC_ASSERT(static_cast<int>(seen.size()) == count);
}

}  // namespace
}  // namespace omnihdr::bracket_plan_test
