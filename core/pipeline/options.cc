#include "core/pipeline/options.h"

#include <fmt/format.h>

#include <string_view>

namespace omnihdr {
namespace {

Status InRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}, expected {} to {}", name, value, low, high);
}

}  // namespace

Status PipelineOptions::Validate() const {
  if (output_width != 0) OMNIHDR_TRY(InRange("output.width", output_width, 64, 16384));
  if (output_width % 2 != 0) {
    return Fail(ErrorKind::kConfig, "output.width: {}, expected an even number", output_width);
  }
  OMNIHDR_TRY(InRange("output.preview_quality", preview_quality, 1, 100));
  OMNIHDR_TRY(InRange("output.preview_exposure_stops", preview.exposure_stops, -20, 20));
  OMNIHDR_TRY(preview.Validate());
  if (exr_type == ExrPixelType::kUint) {
    return Fail(ErrorKind::kConfig, "output.exr_type: uint, expected half or float");
  }
  if (const std::string reason = WhyNotChromaticities(chromaticities); !reason.empty()) {
    return Fail(ErrorKind::kConfig, "output.chromaticities: {}", reason);
  }
  if (white_luminance != 0.0) {
    OMNIHDR_TRY(InRange("photometry.white_luminance", white_luminance, 1e-6, 1e9));
  }
  OMNIHDR_TRY(InRange("photometry.value_low", value_low, 0, 127));
  OMNIHDR_TRY(InRange("photometry.value_high", value_high, 128, 255));
  OMNIHDR_TRY(InRange("photometry.read_noise", noise.read, 0, 50));
  OMNIHDR_TRY(InRange("photometry.gain", noise.gain, 0, 10));
  OMNIHDR_TRY(InRange("photometry.prnu", noise.prnu, 0, 0.2));
  for (const double gain : white_balance) {
    OMNIHDR_TRY(InRange("photometry.white_balance", gain, 0.1, 10));
  }
  OMNIHDR_TRY(InRange("photometry.refine_limit", refine_limit, 0.01, 0.5));
  OMNIHDR_TRY(InRange("stereo.width", stereo_width, 128, 4096));
  if (stereo_width % 2 != 0) {
    return Fail(ErrorKind::kConfig, "stereo.width: {}, expected an even number", stereo_width);
  }
  OMNIHDR_TRY(InRange("stereo.labels", labels, 16, 256));
  OMNIHDR_TRY(InRange("stereo.max_parallax_deg", max_parallax_deg, 1, 90));
  OMNIHDR_TRY(InRange("stereo.neighbours", neighbours, 1, 2));
  OMNIHDR_TRY(InRange("pose.min_baseline_ratio", min_baseline_ratio, 0, 0.5));
  OMNIHDR_TRY(InRange("pose.keyframes", keyframes, 0, 1000));
  OMNIHDR_TRY(InRange("pose.heading_sigma_deg", heading_sigma_deg, 0, 90));
  OMNIHDR_TRY(InRange("merge.consistency_sigma", consistency_sigma, 0.001, 10));
  OMNIHDR_TRY(InRange("merge.neighbours", merge_neighbours, 1, 2));
  return {};
}

PipelineOptions PipelineOptions::Thesis() {
  PipelineOptions options;
  options.weights = MergeWeights::kHat;
  options.refine_exposure = false;
  options.neighbours = 1;
  options.cost = StereoCost::kRadiometric;
  options.search = StereoSearch::kFull;
  options.fusion = StereoFusion::kStability;
  options.filter = StereoFilter::kWavelet;
  options.fill = StereoFill::kSuperpixels;
  options.sky = true;
  options.merge_neighbours = 1;
  options.merge_weights = MergeWeights::kHat;
  options.consistency = false;
  options.occlusion = false;
  return options;
}

std::string DescribeMethods(const PipelineOptions& options) {
  const PipelineOptions ours;
  std::string text;
  const auto tell = [&text](std::string_view name, std::string_view value) {
    text += fmt::format("{}{} = {}", text.empty() ? "" : ", ", name, value);
  };
  if (options.cost != ours.cost) tell("stereo.cost", ToString(options.cost));
  if (options.search != ours.search) tell("stereo.search", ToString(options.search));
  if (options.fusion != ours.fusion) tell("stereo.fusion", ToString(options.fusion));
  if (options.filter != ours.filter) tell("stereo.filter", ToString(options.filter));
  if (options.fill != ours.fill) tell("stereo.fill", ToString(options.fill));
  if (options.sky) tell("stereo.sky", "true");
  if (options.merge_neighbours != ours.merge_neighbours) {
    tell("merge.neighbours", std::to_string(options.merge_neighbours));
  }
  if (options.merge_weights != ours.merge_weights) tell("merge.weights", "hat");
  if (!options.consistency) tell("merge.consistency", "false");
  if (!options.occlusion) tell("merge.occlusion", "false");
  if (options.movers != ours.movers) tell("merge.movers", ToString(options.movers));
  if (!options.mover_masks.empty()) tell("merge.mover_masks", "given");
  return text;
}

}  // namespace omnihdr
