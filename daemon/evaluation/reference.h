#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/session/session.h"
#include "core/session/session_reader.h"
#include "core/sphere/pose.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// Radiance that exposures can measure.
struct MeasurableRange {
  float low = 0.0F;                                     // of luminance
  float high = std::numeric_limits<float>::infinity();  // of every channel
  bool Has(const float* rgb) const;                     // finite, and within
};

// What is known of the scene besides the frames: what a view ought to show.
class Reference {
 public:
  struct Picture {
    Image<float> radiance;   // W×H×3, relative radiance in the session's unit; NaN = not known
    Image<float> disparity;  // W×H×1, 1/metre, 0 = infinity; empty when not known
  };
  // What is known of things that moved while a view's frames were taken.
  struct Movers {
    Image<float> background;       // W×H×3, the scene without them; empty = nothing moved
    Image<std::uint8_t> here;      // W×H, non-zero where one is seen at the view's own instant
    Image<std::uint8_t> in_sight;  // non-zero where one hid the background from another view
    // How many of the others see the background there, neither too bright nor too dark for them.
    Image<std::uint8_t> witnesses;
  };
  // A frame of another position that contributed to a view.
  struct Other {
    const FrameRecord* frame = nullptr;
    MeasurableRange range;
  };
  virtual ~Reference() = default;
  // For people: "simulation (hall, seed 1)", "photographs".
  virtual std::string_view name() const = 0;
  // world_from_camera in metres, where it is known.
  virtual Result<std::optional<Pose>> TruePose(const FrameRecord& frame) const = 0;
  // The scene as seen from where `frame` was taken, on the grid of a written view.
  virtual Result<Picture> Render(const FrameRecord& frame, const Projection& output,
                                 const Eigen::Quaterniond& camera_from_output) const = 0;
  // The same grid. `others`: one of each other position.
  virtual Result<Movers> FindMovers(const FrameRecord& /*frame*/,
                                    const std::vector<Other>& /*others*/,
                                    const Projection& /*output*/,
                                    const Eigen::Quaterniond& /*camera_from_output*/) const {
    return Movers{};
  }
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
