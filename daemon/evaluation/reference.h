#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <memory>
#include <optional>
#include <string_view>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/session/session.h"
#include "core/session/session_reader.h"
#include "core/sphere/pose.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// What is known of the scene besides the frames: what a view ought to show.
class Reference {
 public:
  struct Picture {
    Image<float> radiance;   // W×H×3, relative radiance in the session's unit; NaN = not known
    Image<float> disparity;  // W×H×1, 1/metre, 0 = infinity; empty when not known
  };
  virtual ~Reference() = default;
  // For people: "simulation (hall, seed 1)", "photographs".
  virtual std::string_view name() const = 0;
  // world_from_camera in metres, where it is known.
  virtual Result<std::optional<Pose>> TruePose(const FrameRecord& frame) const = 0;
  // The scene as seen from where `frame` was taken, on the grid of a written view.
  virtual Result<Picture> Render(const FrameRecord& frame, const Projection& output,
                                 const Eigen::Quaterniond& camera_from_output) const = 0;
};

// The reference of a session: the simulator's scene when session.json names one ("simulation");
// else photographs, when `photographs` (or, empty, SESSION/reference) has a how.json; else nullptr.
//   how.json  {"k": …, "contrast": …, "gain": [one a frame]}: the radiance of NNNNNN.jpg is
//             gain[N]·srgb_to_linear(value/255)^contrast, and a frame's value
//             255·k·radiance·exposure_s
//   simulation {"scene": …, "seed": …}, and "truth" in every journal line
Result<std::unique_ptr<Reference>> OpenReference(const std::filesystem::path& session,
                                                 const SessionContents& contents,
                                                 const std::filesystem::path& photographs);

}  // namespace omnihdr
