#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/base/result.h"
#include "core/photometry/measurement.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/options.h"
#include "core/pipeline/view_pipeline.h"
#include "core/session/session.h"
#include "core/session/view_writer.h"

namespace omnihdr {

// What the files of a view say beyond the view itself.
struct ViewContext {
  std::string mode;  // "spatiotemporal" or "temporal"
  double reference_exposure_s = 0.0;
  std::string camera;  // model and serial
  int preview_quality = 90;
  ToneMapOptions preview;
  // Compass bearing of the camera's forward axis, when the frame's record has it.
  std::optional<double> heading_deg;
};

// view.json's content for a finished view.
ViewRecord RecordOfView(const FinishedView& view, const std::string& mode);

// Writes radiance.exr, disparity.exr, preview.jpg and view.json into `directory`. The radiance is
// stored as half; as float when it exceeds what half can hold (a warning in view.json says so).
// Channel "origin" beside R, G, B holds PixelOrigin values.
Status WriteViewFiles(const std::filesystem::path& directory, const FinishedView& view,
                      const ViewContext& context);

// The same for a temporal merge (several frames at one position, no disparity): a lat-long picture
// for a panorama, the frame's own grid for a perspective camera. No disparity.exr.
struct TemporalView {
  PositionId position{};
  std::vector<FrameId> frames;
  FrameId reference{};
  MergedView merged;
  bool is_latlong = true;
  std::vector<std::string> warnings;
};
Status WriteTemporalViewFiles(const std::filesystem::path& directory, const TemporalView& view,
                              const ViewContext& context);

// A measurement as a merged view on its own pixel grid, for cameras without a sphere.
MergedView ViewOfMeasurement(const Measurement& measurement);

}  // namespace omnihdr
