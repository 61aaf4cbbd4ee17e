#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "core/session/rig_file.h"
#include "core/sphere/rig.h"
#include "tests/property/generators.h"

namespace omnihdr::rig_test {
namespace {

using testing::AnyPose;
using testing::Between;

constexpr double kDegree = std::numbers::pi / 180.0;

// A lens whose distortion rises up to its angle; coefficients that fold back are drawn again.
Lens AnyLens() {
  while (true) {
    const bool pinhole = *rc::gen::arbitrary<bool>();
    const int width = *rc::gen::inRange(2, 2000) * 2;
    const int height = *rc::gen::inRange(2, 2000) * 2;
    const Eigen::Vector2d focal(*Between(50.0, 2000.0), *Between(50.0, 2000.0));
    const Eigen::Vector2d centre(*Between(0.0, width), *Between(0.0, height));
    const double scale = pinhole ? 0.3 : 0.08;
    std::array<double, 5> d = {*Between(-scale, scale), *Between(-0.1 * scale, 0.1 * scale),
                               *Between(-0.002, 0.002), *Between(-0.002, 0.002),
                               *Between(-0.002, 0.002)};
    const double limit = *Between(5.0, pinhole ? 75.0 : 130.0) * kDegree;
    const LensKind kind = pinhole ? LensKind::kPinhole : LensKind::kFisheye;
    const double angle = 0.999 * Lens::UnfoldedAngle(kind, d, limit);
    const Result<Lens> lens = pinhole ? Lens::Pinhole(width, height, focal, centre, d, angle)
                                      : Lens::Fisheye(width, height, focal, centre, d, angle);
    if (lens) return *lens;
  }
}

RC_GTEST_PROP(LensLaw, APixelComesBackThroughItsRay, ()) {
  const Lens lens = AnyLens();
  const double x = *Between(0.0, lens.width());
  const double y = *Between(0.0, lens.height());
  const auto ray = lens.RayFromPixel(x, y);
  if (!ray) return;
  RC_ASSERT(std::abs(ray->norm() - 1.0) < 1e-12);
  const auto pixel = lens.PixelFromRay(*ray);
  if (!pixel) {  // only on the very rim of the field or the picture
    const double angle = std::acos(ray->z());
    RC_ASSERT(angle > lens.max_angle() - 1e-7 || x < 1e-6 || y < 1e-6 || x > lens.width() - 1e-6 ||
              y > lens.height() - 1e-6);
    return;
  }
  RC_ASSERT((*pixel - Eigen::Vector2d(x, y)).norm() < 1e-5);
}

RC_GTEST_PROP(LensLaw, ARayComesBackThroughItsPixel, ()) {
  const Lens lens = AnyLens();
  const double angle = *Between(0.0, 1.0) * lens.max_angle();
  const double azimuth = *Between(-std::numbers::pi, std::numbers::pi);
  const Eigen::Vector3d ray(std::sin(angle) * std::cos(azimuth),
                            std::sin(angle) * std::sin(azimuth), std::cos(angle));
  const auto pixel = lens.PixelFromRay(3.0 * ray);
  if (!pixel) return;
  const auto back = lens.RayFromPixel(pixel->x(), pixel->y());
  if (!back) {
    RC_ASSERT(angle > (1.0 - 1e-9) * lens.max_angle());
    return;
  }
  RC_ASSERT((*back - ray).norm() < 1e-7);
}

RC_GTEST_PROP(RigLaw, AFarPointFallsWhereItsDirectionFalls, ()) {
  RigSensor sensor;
  sensor.lens = AnyLens();
  sensor.camera_from_sensor = AnyPose();
  sensor.camera_from_sensor.translation *= 0.01;
  const Eigen::Vector3d ray = testing::AnyUnitVector();
  const auto direction = SensorPixelFromRay(sensor, ray, std::numeric_limits<double>::infinity());
  const auto far = SensorPixelFromRay(sensor, ray, 1e9);
  if (!direction || !far) return;
  RC_ASSERT((*direction - *far).norm() < 1e-3);
}

RC_GTEST_PROP(RigLaw, WhatIsWrittenReadsBackTheSame, ()) {
  Rig rig;
  rig.model = *rc::gen::container<std::string>(rc::gen::inRange(' ', '~'));
  rig.serial = *rc::gen::container<std::string>(rc::gen::inRange('\x01', '\x7F'));
  rig.sphere_radius_m = *Between(1.0, 100.0);
  rig.blend_width_deg = *Between(0.0, 20.0);
  const int sensors = *rc::gen::inRange(1, 5);
  for (int i = 0; i < sensors; ++i) {
    RigSensor sensor;
    sensor.name = std::to_string(i) + *rc::gen::container<std::string>(rc::gen::inRange(' ', '~'));
    sensor.name.resize(std::min<std::size_t>(sensor.name.size(), 64));
    sensor.lens = AnyLens();
    sensor.camera_from_sensor = AnyPose();
    sensor.camera_from_sensor.translation *= 0.04;
    sensor.bayer = static_cast<BayerOrder>(*rc::gen::inRange(0, 5));
    sensor.gain = {*Between(0.1, 4.0), *Between(0.1, 4.0), *Between(0.1, 4.0)};
    sensor.vignetting.coefficients = {*Between(-0.3, 0.3), *Between(-0.1, 0.1),
                                      *Between(-0.02, 0.02)};
    if (*rc::gen::arbitrary<bool>()) sensor.mask_file = "masks/\xC3\xA4 \"" + sensor.name + ".png";
    if (sensor.mask_file.find("/..") != std::string::npos) sensor.mask_file.clear();
    if (*rc::gen::arbitrary<bool>()) sensor.response_json = R"({"model": "linear", "black": 3.5})";
    rig.sensors.push_back(std::move(sensor));
  }
  if (!rig.Validate()) return;
  const std::string text = FormatRig(rig);
  const Result<Rig> again = ParseRig(text, "again");
  RC_ASSERT(again.has_value());
  RC_ASSERT(FormatRig(*again) == text);
  RC_ASSERT(again->model == rig.model);
  RC_ASSERT(again->serial == rig.serial);
  RC_ASSERT(again->sphere_radius_m == rig.sphere_radius_m);
  RC_ASSERT(again->blend_width_deg == rig.blend_width_deg);
  RC_ASSERT(again->sensors.size() == rig.sensors.size());
  for (std::size_t i = 0; i < rig.sensors.size(); ++i) {
    const RigSensor& a = again->sensors[i];
    const RigSensor& b = rig.sensors[i];
    RC_ASSERT(a.name == b.name);
    RC_ASSERT(a.lens.kind() == b.lens.kind());
    RC_ASSERT(a.lens.width() == b.lens.width() && a.lens.height() == b.lens.height());
    RC_ASSERT(a.lens.focal() == b.lens.focal());
    RC_ASSERT(a.lens.centre() == b.lens.centre());
    RC_ASSERT(a.lens.distortion() == b.lens.distortion());
    RC_ASSERT(std::abs(a.lens.max_angle() - b.lens.max_angle()) < 1e-14);
    RC_ASSERT(a.camera_from_sensor.translation == b.camera_from_sensor.translation);
    RC_ASSERT(
        (a.camera_from_sensor.rotation.coeffs() - b.camera_from_sensor.rotation.coeffs()).norm() <
        1e-12);
    RC_ASSERT(a.bayer == b.bayer);
    RC_ASSERT(a.gain == b.gain);
    RC_ASSERT(a.vignetting.coefficients == b.vignetting.coefficients);
    RC_ASSERT(a.mask_file == b.mask_file);
    RC_ASSERT(a.response_json == b.response_json);
  }
}

}  // namespace
}  // namespace omnihdr::rig_test
