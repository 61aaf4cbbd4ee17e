#include "core/sphere/rig_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

namespace omnihdr::rig_report_test {
namespace {

using ::testing::HasSubstr;

constexpr double kPi = std::numbers::pi;

// Looks along azimuth and elevation, picture upright.
RigSensor Looking(const std::string& name, double azimuth, double elevation, double half_angle) {
  RigSensor sensor;
  sensor.name = name;
  sensor.lens =
      *Lens::Fisheye(1000, 1000, {150, 150}, {500, 500}, std::array<double, 5>{}, half_angle);
  const Eigen::Quaterniond forward(0.5, -0.5, 0.5, -0.5);
  sensor.camera_from_sensor.rotation =
      Eigen::Quaterniond(Eigen::AngleAxisd(azimuth, Eigen::Vector3d::UnitZ()) *
                         Eigen::AngleAxisd(-elevation, Eigen::Vector3d::UnitY())) *
      forward;
  return sensor;
}

TEST(RigReport, TwoHalfSpheresCoverEverythingOnce) {
  Rig rig;
  rig.sphere_radius_m = std::numeric_limits<double>::infinity();
  rig.sensors = {Looking("front", 0.0, 0.0, kPi / 2.0 + 1e-6),
                 Looking("back", kPi, 0.0, kPi / 2.0 + 1e-6)};
  const RigReport report = ExamineRig(rig);
  EXPECT_NEAR(report.covered, 1.0, 1e-12);
  EXPECT_LT(report.covered_twice, 0.001);
  EXPECT_NEAR(report.sensors[0].share, 0.5, 0.001);
  EXPECT_EQ(report.directions[0], 0);
  EXPECT_EQ(report.directions[2], 1);
  ASSERT_TRUE(report.closed_band_deg);
  EXPECT_NEAR((*report.closed_band_deg)[0], -90.0, 1e-9);
  EXPECT_NEAR((*report.closed_band_deg)[1], 90.0, 1e-9);
  EXPECT_TRUE(report.warnings.empty());
}

TEST(RigReport, ACapOfAKnownAngleHasItsShareOfTheSphere) {
  Rig rig;
  rig.sensors = {Looking("up", 0.0, kPi / 2.0, kPi / 3.0)};
  const RigReport report = ExamineRig(rig);
  EXPECT_NEAR(report.covered, (1.0 - std::cos(kPi / 3.0)) / 2.0, 1e-3);
  ASSERT_TRUE(report.closed_band_deg);
  EXPECT_NEAR((*report.closed_band_deg)[0], 30.0, 0.51);
  EXPECT_NEAR((*report.closed_band_deg)[1], 90.0, 1e-9);
  EXPECT_EQ(report.directions, (std::array{-1, -1, -1, -1, 0, -1}));
  EXPECT_NEAR(report.sensors[0].elevation_deg, 90.0, 1e-6);
  EXPECT_NEAR(report.sensors[0].field_across_deg, 120.0, 0.2);
  ASSERT_EQ(report.warnings.size(), 1U);
  EXPECT_EQ(report.warnings[0], "no sensor looks forward");
}

TEST(RigReport, OverlapsAreThoseOfTheCaps) {
  Rig rig;
  rig.sensors = {Looking("a", 0.0, 0.0, kPi / 4.0), Looking("b", kPi / 3.0, 0.0, kPi / 4.0),
                 Looking("c", kPi, 0.0, kPi / 4.0)};
  const RigReport report = ExamineRig(rig);
  ASSERT_EQ(report.overlaps.size(), 1U);
  EXPECT_EQ(report.overlaps[0].first, 0);
  EXPECT_EQ(report.overlaps[0].second, 1);
  EXPECT_NEAR(report.overlaps[0].share, report.covered_twice, 1e-12);
  EXPECT_GT(report.overlaps[0].share, 0.01);
}

TEST(RigReport, AzimuthElevationAndRollAreTold) {
  Rig rig;
  rig.sensors = {Looking("a", 0.5, 0.25, 1.0), Looking("b", 0.0, 0.0, 1.0)};
  // A quarter turn of the sensor clockwise, seen from behind: its picture's up points right.
  rig.sensors[1].camera_from_sensor.rotation *=
      Eigen::Quaterniond(Eigen::AngleAxisd(kPi / 2.0, Eigen::Vector3d::UnitZ()));
  const RigReport report = ExamineRig(rig);
  EXPECT_NEAR(report.sensors[0].azimuth_deg, 0.5 * 180.0 / kPi, 1e-9);
  EXPECT_NEAR(report.sensors[0].elevation_deg, 0.25 * 180.0 / kPi, 1e-9);
  EXPECT_NEAR(report.sensors[0].roll_deg, 0.0, 1e-9);
  EXPECT_NEAR(report.sensors[1].roll_deg, 90.0, 1e-9);
}

TEST(RigReport, ALensThatLooksAtTheHeadItselfIsWarnedOf) {
  Rig rig;
  rig.sensors = {Looking("a", 0.0, 0.0, 1.0)};
  rig.sensors[0].camera_from_sensor.translation = {0.05, 0.0, 0.0};
  EXPECT_TRUE(ExamineRig(rig).warnings.empty());
  EXPECT_NEAR(ExamineRig(rig).sensors[0].outward_m, 0.05, 1e-12);
  rig.sensors[0].camera_from_sensor.translation = {-0.05, 0.0, 0.0};
  const RigReport report = ExamineRig(rig);
  ASSERT_EQ(report.warnings.size(), 1U);
  EXPECT_THAT(report.warnings[0], HasSubstr("looks inward"));
}

}  // namespace
}  // namespace omnihdr::rig_report_test
