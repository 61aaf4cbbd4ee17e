#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/image/exr.h"
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
  std::string camera;           // model and serial
  std::optional<UtcTime> utc;   // when the reference frame was triggered
  std::optional<GnssFix> gnss;  // where; a record without a fix counts as none
  int preview_quality = 90;
  ToneMapOptions preview;
  // Compass bearing of the camera's forward axis, when the frame's record has it.
  std::optional<double> heading_deg;
  ExrPixelType exr_type = ExrPixelType::kHalf;
  Chromaticities chromaticities = kRec709;
  double white_luminance = 0.0;  // cd/m² of radiance (1, 1, 1); 0 = unknown
  NanPixels nan = NanPixels::kNever;
  std::string made_with;           // see core/pipeline/made_with.h
  std::vector<std::string> notes;  // about the position's frames, for warnings
};

// What a remembered place is recognised by, in its view's directory.
inline constexpr char kKeyframeFile[] = "keyframe.bin";

// view.json's content for a finished view.
ViewRecord RecordOfView(const FinishedView& view, const std::string& mode);

// Writes radiance.exr, disparity.exr, preview.jpg and view.json into `directory`, and keyframe.bin
// of a position that is remembered. The radiance is
// stored as context.exr_type says; as float in any case when it exceeds what half can hold (a
// warning in view.json says so). Channel "origin" beside R, G, B holds PixelOrigin values, and R,
// G, B are never NaN unless asked. OpenEXR's standard attributes, where they are known: envmap,
// chromaticities, whiteLuminance, expTime, capDate with utcOffset 0, longitude, latitude, altitude;
// `software`, `omnihdrCamera` and `omnihdrPosition` beside them.
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

// Puts NaN where `nan` says, for a picture that is to be written.
void MarkNan(const Image<std::uint8_t>& origin, NanPixels nan, Image<float>* radiance);

// What the values of the mask channel "origin" mean, as a string attribute of the file.
inline constexpr char kOriginMeaning[] = "0 no data, 1 measured, 2 clipped (lower bound), 3 dark";

// What the values of the channel "sources" mean (MergedView::sources).
inline constexpr char kSourcesMeaning[] =
    "sum of 1 (the own frame) and 2, 4, 8, ... (the other positions, nearest first)";

// A measurement as a merged view on its own pixel grid, for cameras without a sphere.
MergedView ViewOfMeasurement(const Measurement& measurement);

}  // namespace omnihdr
