#include "core/pipeline/options.h"

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
  OMNIHDR_TRY(InRange("merge.consistency_sigma", consistency_sigma, 0.001, 10));
  return {};
}

}  // namespace omnihdr
