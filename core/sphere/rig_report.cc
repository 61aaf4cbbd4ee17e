#include "core/sphere/rig_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace omnihdr {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
// Half a degree at the equator.
constexpr int kRows = 360;
constexpr int kColumns = 720;

// Angle between the rays of two ends of a line through the lens's centre; the ends move in until
// rays land there.
double FieldAlong(const Lens& lens, const Eigen::Vector2d& from, const Eigen::Vector2d& to) {
  constexpr int kSteps = 2048;
  const Eigen::Vector2d c(std::clamp(lens.centre().x(), 0.0, static_cast<double>(lens.width())),
                          std::clamp(lens.centre().y(), 0.0, static_cast<double>(lens.height())));
  const bool grid = lens.kind() == LensKind::kGrid;
  const Eigen::Vector2d middle =
      grid ? Eigen::Vector2d(0.5 * lens.width(), 0.5 * lens.height()) : c;
  double field = 0.0;
  for (const Eigen::Vector2d& end : {from, to}) {
    for (int step = kSteps; step > 0; --step) {
      const Eigen::Vector2d p = middle + (end - middle) * step / kSteps;
      if (const auto ray = lens.RayFromPixel(p.x(), p.y())) {
        field += std::acos(std::clamp(ray->z(), -1.0, 1.0)) / kDegree;
        break;
      }
    }
  }
  return field;
}

SensorOptics Examine(const RigSensor& sensor) {
  const Lens& lens = sensor.lens;
  const Eigen::Quaterniond& rotation = sensor.camera_from_sensor.rotation;
  const Eigen::Vector3d& offset = sensor.camera_from_sensor.translation;
  const Eigen::Vector3d axis = rotation * Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d picture_up = rotation * -Eigen::Vector3d::UnitY();
  SensorOptics report;
  report.azimuth_deg = std::atan2(axis.y(), axis.x()) / kDegree;
  report.elevation_deg = std::asin(std::clamp(axis.z(), -1.0, 1.0)) / kDegree;
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  if (std::abs(axis.z()) > 0.9) up = {axis.z() > 0.0 ? -1.0 : 1.0, 0.0, 0.0};
  up = (up - up.dot(axis) * axis).normalized();
  const Eigen::Vector3d right = axis.cross(up);
  report.roll_deg = std::atan2(picture_up.dot(right), picture_up.dot(up)) / kDegree;
  const double w = lens.width();
  const double h = lens.height();
  const bool grid = lens.kind() == LensKind::kGrid;
  const double cx = grid ? 0.5 * w : std::clamp(lens.centre().x(), 0.0, w);
  const double cy = grid ? 0.5 * h : std::clamp(lens.centre().y(), 0.0, h);
  report.field_across_deg = FieldAlong(lens, {0.0, cy}, {w, cy});
  report.field_down_deg = FieldAlong(lens, {cx, 0.0}, {cx, h});
  report.offset_m = offset.norm();
  report.outward_m = offset.dot(axis);
  return report;
}

}  // namespace

RigReport ExamineRig(const Rig& rig) {
  const std::size_t count = rig.sensors.size();
  RigReport report;
  for (const RigSensor& sensor : rig.sensors) report.sensors.push_back(Examine(sensor));
  std::vector<double> pairs(count * count, 0.0);
  std::vector<std::size_t> seeing;
  double total = 0.0;
  double band_top = 90.0;
  double band_low = 90.0;
  for (int row = 0; row < kRows; ++row) {
    const double elevation = (90.0 - (row + 0.5) * 180.0 / kRows) * kDegree;
    const double weight = std::cos(elevation);
    const double row_top = 90.0 - row * 180.0 / kRows;
    const double row_bottom = 90.0 - (row + 1) * 180.0 / kRows;
    bool closed = true;
    for (int column = 0; column < kColumns; ++column) {
      const double azimuth = (column + 0.5) * 360.0 / kColumns * kDegree;
      const Eigen::Vector3d ray(weight * std::cos(azimuth), weight * std::sin(azimuth),
                                std::sin(elevation));
      seeing.clear();
      for (std::size_t i = 0; i < count; ++i) {
        if (SensorPixelFromRay(rig.sensors[i], ray, rig.sphere_radius_m)) seeing.push_back(i);
      }
      total += weight;
      closed = closed && !seeing.empty();
      if (!seeing.empty()) report.covered += weight;
      if (seeing.size() > 1) report.covered_twice += weight;
      for (std::size_t a = 0; a < seeing.size(); ++a) {
        report.sensors[seeing[a]].share += weight;
        for (std::size_t b = a + 1; b < seeing.size(); ++b) {
          pairs[seeing[a] * count + seeing[b]] += weight;
        }
      }
    }
    // Of several bands the widest.
    if (closed && std::abs(row_top - band_low) < 1e-9) {
      band_low = row_bottom;
    } else if (closed) {
      band_top = row_top;
      band_low = row_bottom;
    }
    if (closed &&
        (!report.closed_band_deg ||
         band_top - band_low > (*report.closed_band_deg)[1] - (*report.closed_band_deg)[0])) {
      report.closed_band_deg = {{band_low, band_top}};
    }
  }
  report.covered /= total;
  report.covered_twice /= total;
  for (SensorOptics& sensor : report.sensors) sensor.share /= total;
  for (std::size_t a = 0; a < count; ++a) {
    for (std::size_t b = a + 1; b < count; ++b) {
      const double share = pairs[a * count + b] / total;
      if (share > 0.0) {
        report.overlaps.push_back({static_cast<int>(a), static_cast<int>(b), share});
      }
    }
  }
  const std::array<Eigen::Vector3d, 6> directions = {
      Eigen::Vector3d::UnitX(),  Eigen::Vector3d::UnitY(), -Eigen::Vector3d::UnitX(),
      -Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ(), -Eigen::Vector3d::UnitZ()};
  for (std::size_t d = 0; d < directions.size(); ++d) {
    double best = -2.0;
    for (std::size_t i = 0; i < count; ++i) {
      if (!SensorPixelFromRay(rig.sensors[i], directions[d], rig.sphere_radius_m)) continue;
      const double along = (rig.sensors[i].camera_from_sensor.rotation * Eigen::Vector3d::UnitZ())
                               .dot(directions[d]);
      if (along > best) {
        best = along;
        report.directions[d] = static_cast<int>(i);
      }
    }
  }
  for (std::size_t i = 0; i < count; ++i) {
    const SensorOptics& sensor = report.sensors[i];
    if (sensor.offset_m > 0.005 && sensor.outward_m < -0.5 * sensor.offset_m) {
      report.warnings.push_back(fmt::format(
          "sensor \"{}\" looks inward ({:.3f} m against its axis): mirrored or inverted pose?",
          rig.sensors[i].name, sensor.outward_m));
    }
    if (sensor.share == 0.0) {
      report.warnings.push_back(fmt::format("sensor \"{}\" sees nothing", rig.sensors[i].name));
    }
  }
  if (report.directions[0] < 0) report.warnings.emplace_back("no sensor looks forward");
  return report;
}

}  // namespace omnihdr
