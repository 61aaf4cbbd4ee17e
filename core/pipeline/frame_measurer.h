#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/measure.h"
#include "core/photometry/stitch.h"
#include "core/photometry/white_level.h"
#include "core/session/session.h"
#include "core/stereo/confidence.h"

namespace omnihdr {

// What a session's frames measure, whatever their layout: panoramas and perspective pictures as
// they are, a rig's stacked raw frames stitched to a lat-long panorama of the width natural to the
// rig (at most 8192). Not thread-safe; uses the worker pool inside.
class FrameMeasurer {
 public:
  // `session` holds rig.toml when the layout is "rig". `mask`: what of the frames not to use,
  // white = use; empty = none. It has the frames' size (for a rig: stacked sensors, its blends
  // fade towards it) or, for a rig, is a lat-long picture of any size twice as wide as high. Errors
  // name the file and what was expected: no rig.toml, sensors that do not make up the frame's size,
  // another Bayer order than session.json's, a mask of another size. `white_balance`: gains on R,
  // G, B of a rig's sensors beside their own; pictures get theirs from MeasureOptions.
  static Result<FrameMeasurer> Open(const std::filesystem::path& session, const SessionInfo& info,
                                    ImageView<const std::uint8_t> mask = {},
                                    const std::string& mask_name = "mask",
                                    const std::array<double, 3>& white_balance = {1.0, 1.0, 1.0});

  // Merges the frames of one place. Errors as Measure and Stitcher::Stitch.
  Result<Measurement> Measure(std::span<const ExposedFrame> frames, const MeasureOptions& options);

  // Once, when frames measured so far show that a sensor clips below what counts as usable up to
  // `value_high` (MeasureOptions): which and where, and what to do.
  std::optional<std::string> WhiteLevelWarning(double value_high);

  // Of the measurements.
  const Projection& projection() const { return projection_; }
  const PanoramaOptics& optics() const { return optics_; }
  // The frames' own mask, of a rig with its lens masks: empty when there is none.
  ImageView<const std::uint8_t> frame_mask() const { return mask_.view(); }

 private:
  FrameMeasurer() = default;

  Projection projection_;
  PanoramaOptics optics_;
  int bits_ = 8;
  std::vector<Response> responses_;  // one, or one a sensor
  Image<std::uint8_t> mask_;         // of the frames as recorded
  std::optional<Stitcher> stitcher_;
  // By sensor; of pictures, one.
  std::vector<int> rows_;  // where each begins, and the frames' height
  std::vector<std::string> sensor_names_;
  std::vector<WhiteLevelFinder> white_levels_;
  bool white_level_told_ = false;
};

}  // namespace omnihdr
