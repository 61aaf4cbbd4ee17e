#include "core/sphere/rig.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <numbers>

namespace omnihdr::rig_test {
namespace {

using ::testing::HasSubstr;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Looks along the camera's X (forward): lens Z = X, lens X (right) = -Y, lens Y (down) = -Z.
const Eigen::Quaterniond kForward(0.5, -0.5, 0.5, -0.5);

RigSensor Sensor(const std::string& name) {
  RigSensor sensor;
  sensor.name = name;
  sensor.lens = *Lens::Pinhole(200, 100, {100, 100}, {100, 50}, std::array<double, 5>{},
                               0.25 * std::numbers::pi);
  sensor.camera_from_sensor = {kForward, {0.04, 0.0, 0.0}};
  sensor.bayer = BayerOrder::kBggr;
  return sensor;
}

Rig TwoSensors() {
  Rig rig;
  rig.model = "two";
  rig.sensors = {Sensor("0"), Sensor("1")};
  return rig;
}

TEST(Rig, BayerOrdersHaveNamesThatReadBack) {
  for (const BayerOrder order : {BayerOrder::kNone, BayerOrder::kRggb, BayerOrder::kGrbg,
                                 BayerOrder::kGbrg, BayerOrder::kBggr}) {
    EXPECT_EQ(BayerOrderFromString(ToString(order)), order);
  }
  EXPECT_EQ(BayerOrderFromString("rggb"), std::nullopt);
}

TEST(Rig, ABayerOrderNamesTheTileRowByRow) {
  for (const BayerOrder order :
       {BayerOrder::kRggb, BayerOrder::kGrbg, BayerOrder::kGbrg, BayerOrder::kBggr}) {
    std::string tile;
    for (int y = 10; y < 12; ++y) {
      for (int x = 20; x < 22; ++x) tile += "RGB"[BayerChannel(order, x, y)];
    }
    EXPECT_EQ(tile, ToString(order));
  }
}

TEST(Rig, FarAwayOnlyTheDirectionCounts) {
  const RigSensor sensor = Sensor("0");
  EXPECT_LT((*SensorPixelFromRay(sensor, {1, 0, 0}, kInfinity) - Eigen::Vector2d(100, 50)).norm(),
            1e-9);
  // To the left (+Y) and up (+Z): left and up in the picture.
  EXPECT_LT((*SensorPixelFromRay(sensor, {10, 2, 1}, kInfinity) - Eigen::Vector2d(80, 40)).norm(),
            1e-9);
  EXPECT_FALSE(SensorPixelFromRay(sensor, {-1, 0, 0}, kInfinity));
}

TEST(Rig, NearbyTheOffsetOfTheSensorShiftsThePoint) {
  RigSensor sensor = Sensor("0");
  sensor.camera_from_sensor.translation = {0.0, 0.05, 0.0};
  // 5 cm to the left of the centre, a point 1 m ahead is 0.05 rad to the right.
  const Eigen::Vector2d pixel = *SensorPixelFromRay(sensor, {3, 0, 0}, 1.0);
  EXPECT_LT((pixel - Eigen::Vector2d(105, 50)).norm(), 1e-9);
  const Eigen::Vector2d farther = *SensorPixelFromRay(sensor, {3, 0, 0}, 10.0);
  EXPECT_LT((farther - Eigen::Vector2d(100.5, 50)).norm(), 1e-9);
}

TEST(Rig, AGoodRigIsAccepted) {
  Rig rig = TwoSensors();
  const Status ok = rig.Validate();
  EXPECT_TRUE(ok) << ok.error().message;
  rig.sphere_radius_m = kInfinity;
  EXPECT_TRUE(rig.Validate());
}

TEST(Rig, WhatMakesNoSenseIsRefusedByItsName) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const struct {
    std::function<void(Rig&)> spoil;
    const char* expected;
  } cases[] = {
      {[](Rig& rig) { rig.sensors.clear(); }, "sensors: 0"},
      {[](Rig& rig) { rig.sensors[1].name = rig.sensors[0].name; }, "\"0\" twice"},
      {[](Rig& rig) { rig.sensors[1].name.clear(); }, "sensor 1: name: empty"},
      {[](Rig& rig) { rig.sensors[1].lens = Lens(); }, "sensor \"1\": lens: missing"},
      {[&](Rig& rig) { rig.sensors[0].gain[2] = 0.0; }, "sensor \"0\": gain: 0"},
      {[&](Rig& rig) { rig.sensors[0].gain[2] = nan; }, "gain: nan"},
      {[&](Rig& rig) {
         rig.sensors[0].vignetting.coefficients = {nan, 0, 0};
       },
       "vignetting: nan"},
      {[&](Rig& rig) {
         rig.sensors[0].vignetting.coefficients = {-1.5, 0, 0};
       },
       "vignetting: sensitivity"},
      {[&](Rig& rig) { rig.sensors[0].camera_from_sensor.rotation.coeffs() *= 2.0; },
       "rotation: norm 2"},
      {[&](Rig& rig) { rig.sensors[0].camera_from_sensor.translation.x() = nan; }, "translation"},
      {[&](Rig& rig) { rig.sensors[0].camera_from_sensor.translation.x() = 11.0; },
       "translation: 11 m"},
      {[&](Rig& rig) { rig.sphere_radius_m = 0.0; }, "sphere_radius_m"},
      {[&](Rig& rig) { rig.sphere_radius_m = nan; }, "sphere_radius_m"},
      {[&](Rig& rig) { rig.blend_width_deg = -1.0; }, "blend_width_deg"},
      {[&](Rig& rig) {
         rig.sensors[0].lens =
             *Lens::Pinhole(201, 100, {100, 100}, {100, 50}, std::array<double, 5>{}, 0.7);
       },
       "expected even sides"},
  };
  for (const auto& c : cases) {
    Rig rig = TwoSensors();
    c.spoil(rig);
    const Status status = rig.Validate();
    ASSERT_FALSE(status) << c.expected;
    EXPECT_EQ(status.error().kind, ErrorKind::kData);
    EXPECT_THAT(status.error().message, HasSubstr(c.expected));
  }
}

}  // namespace
}  // namespace omnihdr::rig_test
