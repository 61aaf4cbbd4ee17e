#include "core/sphere/rig.h"

#include <fmt/format.h>

#include <cmath>
#include <set>

namespace omnihdr {
namespace {

constexpr std::size_t kMaxSensors = 64;

}  // namespace

std::string_view ToString(BayerOrder order) {
  switch (order) {
    case BayerOrder::kNone:
      return "none";
    case BayerOrder::kRggb:
      return "RGGB";
    case BayerOrder::kGrbg:
      return "GRBG";
    case BayerOrder::kGbrg:
      return "GBRG";
    case BayerOrder::kBggr:
      return "BGGR";
  }
  return "?";
}

std::optional<BayerOrder> BayerOrderFromString(std::string_view name) {
  for (const BayerOrder order : {BayerOrder::kNone, BayerOrder::kRggb, BayerOrder::kGrbg,
                                 BayerOrder::kGbrg, BayerOrder::kBggr}) {
    if (name == ToString(order)) return order;
  }
  return std::nullopt;
}

int BayerChannel(BayerOrder order, int x, int y) {
  // Where red is in the tile; blue is opposite.
  int red_x = 0;
  int red_y = 0;
  switch (order) {
    case BayerOrder::kNone:
    case BayerOrder::kRggb:
      break;
    case BayerOrder::kGrbg:
      red_x = 1;
      break;
    case BayerOrder::kGbrg:
      red_y = 1;
      break;
    case BayerOrder::kBggr:
      red_x = 1;
      red_y = 1;
      break;
  }
  const int dx = (x & 1) ^ red_x;
  const int dy = (y & 1) ^ red_y;
  return dx + dy;
}

Status RigSensor::Validate() const {
  if (lens.width() < 1) return Fail(ErrorKind::kData, "lens: missing, expected one");
  const Eigen::Quaterniond& q = camera_from_sensor.rotation;
  if (!q.coeffs().allFinite() || std::abs(q.norm() - 1.0) > 1e-6) {
    return Fail(ErrorKind::kData, "rotation: norm {}, expected a quaternion of length 1", q.norm());
  }
  if (!camera_from_sensor.translation.allFinite() ||
      camera_from_sensor.translation.norm() > 1000.0) {
    return Fail(ErrorKind::kData, "translation: {} m, expected finite, at most 1000",
                camera_from_sensor.translation.norm());
  }
  if (bayer != BayerOrder::kNone && (lens.width() % 2 != 0 || lens.height() % 2 != 0)) {
    return Fail(ErrorKind::kData, "size: {}x{}, expected even sides with a Bayer pattern",
                lens.width(), lens.height());
  }
  for (const double c : vignetting.coefficients) {
    if (!std::isfinite(c)) {
      return Fail(ErrorKind::kData, "vignetting: {}, expected finite coefficients", c);
    }
  }
  // ρ = 1 is the corner of a centred picture; an off-centre one reaches a little farther.
  for (int step = 0; step <= 128; ++step) {
    const double rho = 1.25 * step / 128.0;
    const double v = vignetting.At(rho);
    if (!(v > 1e-3 && v < 1e3)) {
      return Fail(ErrorKind::kData,
                  "vignetting: sensitivity {:.4g} at {:.3g} half diagonals off the centre, "
                  "expected 0.001 to 1000",
                  v, rho);
    }
  }
  for (const double g : gain) {
    if (!(g >= 1e-6 && g <= 1e6)) {
      return Fail(ErrorKind::kData, "gain: {}, expected 1e-6 to 1e6", g);
    }
  }
  return {};
}

Status Rig::Validate() const {
  if (sensors.empty() || sensors.size() > kMaxSensors) {
    return Fail(ErrorKind::kData, "sensors: {}, expected 1 to {}", sensors.size(), kMaxSensors);
  }
  if (!(sphere_radius_m > 0.0)) {
    return Fail(ErrorKind::kData,
                "sphere_radius_m: {}, expected more than 0 (inf: directions alone)",
                sphere_radius_m);
  }
  if (!(blend_width_deg >= 0.0 && blend_width_deg <= 90.0)) {
    return Fail(ErrorKind::kData, "blend_width_deg: {}, expected 0 to 90", blend_width_deg);
  }
  std::set<std::string_view> names;
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    const RigSensor& sensor = sensors[i];
    if (sensor.name.empty()) {
      return Fail(ErrorKind::kData, "sensor {}: name: empty, expected one", i);
    }
    if (!names.insert(sensor.name).second) {
      return Fail(ErrorKind::kData, "sensor {}: name: \"{}\" twice, expected each once", i,
                  sensor.name);
    }
    if (Status ok = sensor.Validate(); !ok) {
      return std::move(ok).Context(fmt::format("sensor \"{}\"", sensor.name));
    }
    // An offset larger than the stitching sphere has no picture to meet.
    if (sensor.camera_from_sensor.translation.norm() >= sphere_radius_m) {
      return Fail(ErrorKind::kData,
                  "sensor \"{}\": translation: {} m off the centre, expected less than "
                  "sphere_radius_m, {}",
                  sensor.name, sensor.camera_from_sensor.translation.norm(), sphere_radius_m);
    }
  }
  return {};
}

std::optional<Eigen::Vector2d> SensorPixelFromRay(const RigSensor& sensor,
                                                  const Eigen::Vector3d& ray_in_camera,
                                                  double distance) {
  const Pose& pose = sensor.camera_from_sensor;
  if (std::isinf(distance)) {
    return sensor.lens.PixelFromRay(pose.rotation.conjugate() * ray_in_camera);
  }
  return sensor.lens.PixelFromRay(
      pose.CameraFromWorld(ray_in_camera * (distance / ray_in_camera.norm())));
}

}  // namespace omnihdr
