#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "core/base/result.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// rig.toml, format "omnihdr-rig" version 1: the calibration of a head of several sensors (README:
// "Rigs"). Keys of the top level: format, version, model, serial, sphere_radius_m (inf = directions
// alone), blend_width_deg; then one [[sensor]] a sensor, in the order in which a raw frame stacks
// them:
//   name, size = [columns, rows], lens = "pinhole" | "fisheye" | "grid", focal = [x, y],
//   centre = [x, y] (pixels; the middle of the first pixel is 0.5, 0.5), distortion = five
//   coefficients, fov_deg (both not with a grid), rotation = [w, x, y, z] and translation =
//   [x, y, z] in metres (camera_from_sensor); and, each with a default: bayer, gain, vignetting,
//   mask (a picture's file, relative to the rig file), response (the JSON object of session.json).
// A grid lens has the tables [sensor.raw_from_rectified] and [sensor.rectified_from_raw] with
// columns, rows, step = [x, y], points = [x, y, x, y, …] row by row, nan where there is nothing.
// A key that is not known is an error: half a calibration is worse than none.

inline constexpr std::size_t kMaxRigBytes = std::size_t{4} << 20;

// Untrusted text; `name` (a path) is for the messages: "file:line: key: value, expected ...".
Result<Rig> ParseRig(std::string_view text, const std::string& name);
Result<Rig> ReadRig(const std::filesystem::path& path);
// Text that ParseRig gives back as the same rig (angles to rounding). Requires a valid rig.
// `comment`: lines put at the top, each behind "# ".
std::string FormatRig(const Rig& rig, std::string_view comment = {});

}  // namespace omnihdr
