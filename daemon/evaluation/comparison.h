#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/quality/disparity_metrics.h"
#include "core/quality/radiance_metrics.h"

namespace omnihdr {

struct ComparisonOptions {
  // Of two radiance maps: the factor on the tested one.
  ScaleFit scale = ScaleFit::kMedian;
  // How pixels count: by their solid angle (an equirectangular panorama), all the same, or decided
  // by the shape: a picture twice as wide as high is taken for a panorama.
  enum class Area { kAuto, kSphere, kPlane } area = Area::kAuto;
  std::filesystem::path mask;  // 8-bit picture of the same size, white = compare; empty = all
};

// How two pictures differ. Numbers are NaN where nothing can be compared.
struct Comparison {
  std::string tested;  // the files read
  std::string reference;
  int width = 0;
  int height = 0;
  bool is_radiance = false;  // else code values
  bool on_sphere = false;
  bool is_identical = false;  // every value equal, unknown in the same places, no mask
  double compared = 0.0;      // share of the area that is known in both
  // Code values: peak 255 or 65535, over the three channels. Radiance: peak = white, the
  // reference's largest luminance, after the scale. dB, infinite for equal pictures.
  double psnr_db = 0.0;
  double psnr_mu_db = 0.0;  // radiance only
  double white = 0.0;       // radiance only
  // Of luma (Rec. 601 weights of the code values, as the paper's authors have it), or of radiance's
  // luminance as Reinhard's operator shows it, with the reference's parameters for both.
  double ssim = 0.0;
  RadianceErrors radiance;                   // radiance only
  std::optional<DisparityErrors> disparity;  // two view directories with disparity; bad1 is not set
  // log10(tested / reference) of luminance after the scale, or the difference of luma.
  Image<float> difference;
};

// Errors: a file that cannot be read, pictures of different size or kind, a mask of another size.
Result<Comparison> ComparePictures(const std::filesystem::path& tested,
                                   const std::filesystem::path& reference,
                                   const ComparisonOptions& options);

std::string FormatComparisonTable(const Comparison& comparison);
// One JSON object; numbers that are not finite are null.
std::string FormatComparisonJson(const Comparison& comparison);
// The difference in colour with its scale bar: red where the tested picture is brighter. `full`:
// decades, or a share of the peak, shown as full colour.
Image<std::uint8_t> DifferencePicture(const Comparison& comparison, double full);

}  // namespace omnihdr
