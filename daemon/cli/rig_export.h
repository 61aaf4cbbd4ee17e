#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <string>

#include "core/base/result.h"
#include "core/sphere/lens.h"
#include "core/sphere/rig.h"
#include "daemon/cli/session_export.h"

namespace omnihdr {

// A head of several sensors for programs that know rigs: every sensor's own pictures, lens and
// place instead of the stitched panorama. Lens frames are theirs as well: X right, Y down, Z
// forward.

// A lens by the models that they share: OpenCV's fisheye (k1 … k4) or radial-tangential
// (k1 k2 p1 p2 k3) model; of pixels whose corner, not centre, is at whole numbers.
struct PortableLens {
  bool is_fisheye = false;
  int width = 0;
  int height = 0;
  Eigen::Vector2d focal = Eigen::Vector2d::Zero();
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  std::array<double, 5> distortion{};
  // Largest distance from the lens itself over its picture; 0 where the model is the same.
  double error_px = 0.0;
};

// A pinhole lens and a fisheye without k5 as they are; others by the fisheye model that fits them
// best. Errors (kData): a lens that sees too little of its picture to fit one.
Result<PortableLens> MakePortable(const Lens& lens);

// What an export wrote, for people.
struct RigExportReport {
  std::size_t pictures = 0;
  double lens_error_px = 0.0;  // largest of all sensors
  bool has_poses = false;      // of metric poses alone: a rig's offsets are metres
};

// A COLMAP (3.12 or later) data set: images/head/SENSOR/VIEW.jpg, rig_config.json for its
// rig_configurator, and, of metric poses, a text model in sparse/.
Result<RigExportReport> ExportRigToColmap(const std::filesystem::path& session,
                                          const ExportPlan& plan, const std::filesystem::path& out);

// An OpenSfM data set: images/VIEW_SENSOR.jpg, rig_cameras.json, rig_assignments.json, camera
// models, and, of metric poses, reconstruction.json.
Result<RigExportReport> ExportRigToOpenSfm(const std::filesystem::path& session,
                                           const ExportPlan& plan,
                                           const std::filesystem::path& out);

// For ROS: camera_info/SENSOR.yaml (camera_calibration_parsers) and head.urdf with a fixed joint
// from `head` (REP 103: X forward, Y left, Z up) to every SENSOR_optical_frame. Needs no views.
Result<RigExportReport> ExportRigToRos(const std::filesystem::path& session,
                                       const std::filesystem::path& out);

}  // namespace omnihdr
