#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/sphere/lens.h"
#include "core/sphere/pose.h"

namespace omnihdr {

// Colour of the pixels of a 2×2 tile, row by row from the top left.
enum class BayerOrder { kNone, kRggb, kGrbg, kGbrg, kBggr };
std::string_view ToString(BayerOrder order);
std::optional<BayerOrder> BayerOrderFromString(std::string_view name);
// Channel (0 R, 1 G, 2 B) of pixel (x, y). Requires order != kNone.
int BayerChannel(BayerOrder order, int x, int y);

// Fall-off of a lens: relative sensitivity 1 + a·ρ² + b·ρ⁴ + c·ρ⁶, ρ = distance from the lens's
// centre in half image diagonals. Divide by it to undo it.
struct Vignetting {
  std::array<double, 3> coefficients{};
  double At(double rho) const {
    const double s = rho * rho;
    return 1.0 + s * (coefficients[0] + s * (coefficients[1] + s * coefficients[2]));
  }
};

struct RigSensor {
  std::string name;
  Lens lens;
  // camera_from_sensor: X_camera = rotation · X_lens + translation, metres; the camera (rig) frame
  // is X forward, Y left, Z up, the lens frame that of Lens.
  Pose camera_from_sensor;
  BayerOrder bayer = BayerOrder::kNone;  // kNone: the sensor delivers grey or finished colour
  Vignetting vignetting;
  // Multiplies this sensor's radiance so that all sensors and channels agree (white balance and
  // sensitivity in one).
  std::array<double, 3> gain = {1.0, 1.0, 1.0};
  // Picture of the sensor's size, white = use; relative to the rig file; empty = all of it.
  std::string mask_file;
  // A response of this sensor's own as the JSON object of session.json's `response`; empty = the
  // session's.
  std::string response_json;
  // Errors begin with the member's name in rig.toml: "gain: 0, expected ...".
  Status Validate() const;
};

// A head of several sensors that expose at one instant.
struct Rig {
  std::string model;
  std::string serial;
  std::vector<RigSensor> sensors;
  // Distance at which the sensors' pictures meet without a step: the head's lenses are not in one
  // place, so what is nearer or farther is doubled or cut by offset/distance. Metres; infinity =
  // directions alone.
  double sphere_radius_m = 10.0;
  // Width of the feather between neighbouring sensors, on the sphere.
  double blend_width_deg = 5.0;
  // Errors name the sensor and the field: no sensors, names twice, gains not positive, ...
  Status Validate() const;
};

// Where the point at `distance` along a camera-frame ray falls on a sensor (parallax included);
// infinity for direction alone. Nothing when the sensor does not see it.
std::optional<Eigen::Vector2d> SensorPixelFromRay(const RigSensor& sensor,
                                                  const Eigen::Vector3d& ray_in_camera,
                                                  double distance);

}  // namespace omnihdr
