#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "core/photometry/vignetting.h"

namespace omnihdr::vignetting_rig_test {
namespace {

const Vignetting kTruth{{-0.35, 0.12, -0.10}};
constexpr double kRadians = 0.017453292519943295;

// Lens frame (right, down, out) turned so that it looks along `yaw` in the rig's horizon.
Pose Looking(double yaw_deg) {
  const double yaw = yaw_deg * kRadians;
  Eigen::Matrix3d rotation;
  rotation.col(0) = Eigen::Vector3d(std::sin(yaw), -std::cos(yaw), 0.0);
  rotation.col(1) = Eigen::Vector3d(0.0, 0.0, -1.0);
  rotation.col(2) = Eigen::Vector3d(std::cos(yaw), std::sin(yaw), 0.0);
  return {Eigen::Quaterniond(rotation), Eigen::Vector3d::Zero()};
}

// Four fisheyes of 190 degrees looking round: neighbours share half their fields.
Rig Fisheyes() {
  Rig rig;
  for (int s = 0; s < 4; ++s) {
    RigSensor sensor;
    sensor.name = std::string(1, static_cast<char>('a' + s));
    sensor.lens = *Lens::Fisheye(200, 200, {58.0, 58.0}, {101.0, 98.0}, {}, 95.0 * kRadians);
    sensor.camera_from_sensor = Looking(90.0 * s);
    rig.sensors.push_back(sensor);
  }
  return rig;
}

// Five narrow lenses that share only their edges.
Rig Narrow() {
  Rig rig;
  for (int s = 0; s < 5; ++s) {
    RigSensor sensor;
    sensor.name = std::string(1, static_cast<char>('a' + s));
    sensor.lens = *Lens::Pinhole(160, 200, {85.0, 85.0}, {80.0, 100.0}, {}, 65.0 * kRadians);
    sensor.camera_from_sensor = Looking(72.0 * s);
    rig.sensors.push_back(sensor);
  }
  return rig;
}

double Light(const Eigen::Vector3d& ray_in_world) {
  const double azimuth = std::atan2(ray_in_world.y(), ray_in_world.x());
  return 90.0 * std::exp(0.5 * std::sin(3.0 * azimuth + 0.5) * std::cos(4.0 * ray_in_world.z()) +
                         0.1 * std::sin(9.0 * azimuth));
}

const std::array<std::array<double, 3>, 5> kSensitivity = {{{1.00, 1.00, 1.00},
                                                            {1.08, 0.96, 1.02},
                                                            {0.93, 1.03, 0.99},
                                                            {1.02, 0.98, 1.05},
                                                            {0.97, 1.04, 0.94}}};

std::vector<SensorPicture> Render(const Rig& rig, const Eigen::Matrix3d& world_from_rig,
                                  unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0.0, 1.0);
  std::vector<SensorPicture> pictures;
  for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
    const RigSensor& sensor = rig.sensors[s];
    const Lens& lens = sensor.lens;
    const double half = 0.5 * std::hypot(lens.width(), lens.height());
    SensorPicture picture;
    picture.values = Image<float>(lens.width(), lens.height(), 3);
    for (int y = 0; y < lens.height(); ++y) {
      for (int x = 0; x < lens.width(); ++x) {
        const std::optional<Eigen::Vector3d> ray = lens.RayFromPixel(x + 0.5, y + 0.5);
        if (!ray) continue;
        const double rho = (Eigen::Vector2d(x + 0.5, y + 0.5) - lens.centre()).norm() / half;
        const double light =
            Light(world_from_rig * (sensor.camera_from_sensor.rotation * *ray)) * kTruth.At(rho);
        for (int c = 0; c < 3; ++c) {
          const double v = light * kSensitivity[s][static_cast<std::size_t>(c)] + normal(random);
          picture.values.at(x, y, c) = static_cast<float>(std::lround(std::clamp(v, 0.0, 255.0)));
        }
      }
    }
    pictures.push_back(std::move(picture));
  }
  return pictures;
}

Result<OverlapFit> Calibrate(const Rig& rig, const std::vector<Eigen::Matrix3d>& rotations,
                             bool rotations_known) {
  std::vector<std::vector<SensorPicture>> pictures;
  std::vector<RigPictures> stands;
  for (std::size_t k = 0; k < rotations.size(); ++k) {
    pictures.push_back(Render(rig, rotations[k], static_cast<unsigned>(k) + 1));
  }
  for (std::size_t k = 0; k < rotations.size(); ++k) {
    RigPictures stand;
    for (const SensorPicture& picture : pictures[k]) stand.sensors.push_back(&picture);
    stand.seconds.assign(rig.sensors.size(), 1.0);
    if (rotations_known) stand.world_from_rig = rotations[k];
    stands.push_back(stand);
  }
  std::vector<std::string> names;
  std::vector<double> reach;
  for (const RigSensor& sensor : rig.sensors) {
    names.push_back(sensor.name);
    reach.push_back(LargestRho(sensor));
  }
  const std::vector<Response> responses(rig.sensors.size(), *Response::Linear());
  return FitOverlaps(CollectOverlapSamples(rig, stands, responses, 2.0, {}), names, reach, {});
}

double WorstError(const VignettingFit& fit) {
  double worst = 0.0;
  for (double rho = 0.0; rho <= fit.rho_max; rho += 0.02) {
    worst = std::max(worst, std::abs(fit.vignetting.At(rho) / kTruth.At(rho) - 1.0));
  }
  return worst;
}

TEST(RigOverlaps, FisheyesAtOneStandGiveFalloffAndGainsBackToOnePercent) {
  const Result<OverlapFit> fit = Calibrate(Fisheyes(), {Eigen::Matrix3d::Identity()}, false);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_LT(WorstError(fit->sensors[0]), 0.01);
  for (std::size_t s = 1; s < 4; ++s) {
    for (std::size_t c = 0; c < 3; ++c) {
      const double expected = kSensitivity[0][c] / kSensitivity[s][c];
      EXPECT_NEAR(fit->gain[s][c] / fit->gain[0][c], expected, 0.01 * expected) << s << ' ' << c;
    }
  }
}

TEST(RigOverlaps, NarrowLensesShareTooLittleAtOneStand) {
  const Result<OverlapFit> fit = Calibrate(Narrow(), {Eigen::Matrix3d::Identity()}, false);
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().message.find("half diagonal"), std::string::npos) << fit.error().message;
}

TEST(RigOverlaps, NarrowLensesInKnownRotationsGiveTheFalloffBackToOnePercent) {
  std::vector<Eigen::Matrix3d> rotations;
  for (int k = 0; k < 4; ++k) {
    rotations.emplace_back(Eigen::AngleAxisd(18.0 * k * kRadians, Eigen::Vector3d::UnitZ()) *
                           Eigen::AngleAxisd(12.0 * k * kRadians, Eigen::Vector3d::UnitY()));
  }
  const Result<OverlapFit> fit = Calibrate(Narrow(), rotations, true);
  ASSERT_TRUE(fit) << fit.error().message;
  EXPECT_LT(WorstError(fit->sensors[0]), 0.01);
  EXPECT_LT(fit->difference_after, 0.5 * fit->difference_before);
}

TEST(RigOverlaps, TheLensesReachIsMeasuredFromItsCentre) {
  const Rig rig = Fisheyes();
  // 95 degrees at 58 pixels a radian: a circle within the picture.
  EXPECT_NEAR(LargestRho(rig.sensors[0]), 58.0 * 95.0 * kRadians / (100.0 * std::sqrt(2.0)), 0.03);
  EXPECT_NEAR(LargestRho(Narrow().sensors[0]), 1.0, 0.02);
}

}  // namespace
}  // namespace omnihdr::vignetting_rig_test
