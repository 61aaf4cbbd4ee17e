#pragma once

#include <filesystem>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/session/session.h"
#include "core/session/view_writer.h"

namespace omnihdr {

// A session's views for other programs. Frames: ours is X forward, Y left, Z up, for cameras and
// the world; COLMAP and OpenSfM have X right, Y down, Z forward for cameras. Only views of one
// chain have a common world.

struct ExportedView {
  std::string name;               // "000003"
  std::filesystem::path preview;  // preview.jpg
  Pose world_from_camera;
  Pose world_from_picture;  // of the panorama as it is written
  double seconds = 0.0;     // see ExportPlan::is_utc
  std::optional<GnssFix> gnss;
  FrameRecord own;  // the frame that the view is of
};

struct ExportPlan {
  int chain = 0;
  std::map<int, int> chains;  // number of views of each
  bool is_metric = false;     // every view of the chain
  bool is_utc = false;        // `seconds` count from 1970, UTC; else from the host's start
  std::vector<ExportedView> views;
};

// `chain` -1: the one with the most views. Errors: no views, views that have no poses (temporal),
// no such chain.
Result<ExportPlan> PlanExport(const std::filesystem::path& session,
                              const std::filesystem::path& views, int chain);

// With the folders above it; one that is there is none the worse for it.
Status MakeFolder(const std::filesystem::path& folder);

// "seconds x y z qx qy qz qw" a line, world_from_camera: the form of TUM's benchmark, which ROS
// tools read; the camera's axes are those of a ROS body (REP 103).
std::string FormatTum(const ExportPlan& plan);

// An OpenSfM data set: the previews as spherical images, with capture times, places, and a
// reconstruction of their poses.
Status ExportOpenSfm(const ExportPlan& plan, const std::filesystem::path& out);

// What OpenSfM is told of a picture that carries no EXIF data of its own: when and where.
nlohmann::ordered_json ExifOverrideOf(const ExportedView& view);

// A COLMAP model (text): faces of 90 degrees of every preview as pinhole images of `face_size`
// pixels, with their poses; six a view, or the four around the horizon.
Status ExportColmap(const ExportPlan& plan, int face_size, bool all_faces,
                    const std::filesystem::path& out);

}  // namespace omnihdr
