#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// Calibrations as makers and other people write them.
enum class RigTextKind {
  // Two tables of a six-sensor head, tabs or commas between the columns: "Cam_id F[px] PPx[px]
  // PPy[px]" and "Cam_id Rx[rad] Ry[rad] Rz[rad] Tx[m] Ty[m] Tz[m]".
  kLadybugCsv,
  // Lines "camera0_rotX=…" with rotX/Y/Z, transX/Y/Z, FocalLen, CameraCenterX/Y for each sensor,
  // camera_model, camera_serialHead; camera_serialBase and rotation_dRx/dRy/dRz (a levelling of
  // some hundredths of a degree) are not used. Look-up grids and other factory texts are refused:
  // their layout is not public.
  kLadybugText,
  // OpenCV YAML "CamModel_V2_Set" version 3 of an eight-lens camera.
  kVuzeYml,
};
std::string_view ToString(RigTextKind kind);  // "ladybug-csv", "ladybug-text", "vuze"
std::optional<RigTextKind> RigTextKindFromString(std::string_view name);

struct RigText {
  std::string name;  // a path, for the messages
  std::string text;
};

struct RigImportOptions {
  std::optional<RigTextKind> kind;  // nothing: told by the text
  // Of a sensor's picture (Ladybug: of the rectified picture); 0 = as the file says. The CSV files'
  // numbers are whole millionths of 4928 columns and 4096 rows: their default.
  int width = 0;
  int height = 0;
  // Full field of view used of each lens; 0 = 180 degrees of a fisheye, 110 of a rectified picture
  // (which is larger than what the sensor fills: masks say it exactly), never more than the lens
  // model carries.
  double fov_deg = 0.0;
};

// Ladybug: T = Rz·Ry·Rx and translation take a sensor's point to the head's frame (X toward sensor
// 0, Z up along sensor 5), lens frame X right, Y down, Z out in the picture as stored; an image
// coordinate counts from the middle of the first pixel, so that 0.5 is added. Lens: pinhole, of
// rectified pictures.
// Vuze: R takes the lens frame of the "straight" (upside down, 1088×1600) picture to the camera
// frame (x left, y up, z forward), CamCenter in millimetres; the stored picture (1600×1088) is the
// straight one a quarter turn back. DistortionCoeffs_0, _2, … are 1, k1, … of r = θ(1 + k1θ² + …),
// Fov_deg is half the field, and ImageCircleRadius is r there: checked to 1 %. Principal points of
// this maker are known to be off by up to 40 pixels.
// Untrusted text. Errors: "file:line: key: value, expected ...".
Result<Rig> ImportRig(const std::vector<RigText>& files, const RigImportOptions& options);

}  // namespace omnihdr
