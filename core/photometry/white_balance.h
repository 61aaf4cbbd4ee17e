#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/color_chart.h"

namespace omnihdr {

// One grey patch of one picture.
struct GreyPatchBalance {
  int picture = 0;
  int patch = 0;  // 18 (white) … 23 (black)
  bool used = false;
  std::string excluded;  // why not, when it was not used
  // What is left between the channels after the gains: R/G − 1 and B/G − 1.
  double red_residual = 0.0;
  double blue_residual = 0.0;
};

// Gains that make the grey row of charts grey, green = 1: multiply linear red and blue by them.
struct WhiteBalance {
  double red = 1.0;
  double blue = 1.0;
  double red_error = 0.0;  // relative standard error, from noise and from the patches' disagreement
  double blue_error = 0.0;
  double worst_residual = 0.0;  // largest |residual| of a used patch
  std::vector<GreyPatchBalance> patches;
  std::vector<std::string> warnings;
};

// Weighted mean of ln(G/R) and ln(G/B) over the grey patches that are neither clipped nor dark in
// any channel; a quarter of a code value of black level and half a percent of the chart itself
// bound the weights. Error (kData): fewer than two patches left, with what became of the others.
Result<WhiteBalance> SolveWhiteBalance(std::span<const ChartMeasurement> charts);

}  // namespace omnihdr
