#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "core/image/image_io.h"
#include "core/photometry/color_chart.h"
#include "core/sphere/pose.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// A ColorChecker in front of a brick wall with coloured boxes, as a sensor sees it: rendered by
// rays from the chart's own definition, so that every patch's place and light are known.
struct ChartScene {
  int width = 480;
  int height = 360;
  // Pinhole r = f·tan θ, or equidistant fisheye r = f·θ; pixels.
  double focal = 375.0;
  bool fisheye = false;
  // camera_from_chart: chart frame X along its columns, Y along its rows, Z away from the viewer,
  // metres, origin at the middle of the patches; camera frame X right, Y down, Z out.
  Pose camera_from_chart{Eigen::Quaterniond::Identity(), {0.0, 0.0, 1.0}};
  double patch_step = 0.046;  // metres from patch to patch
  double patch_share = 0.86;  // of a step that is the patch
  bool chart = true;          // false: wall and boxes alone
  bool mirrored = false;      // the picture is stored the wrong way round
  bool clutter = true;
  // Value 255 is full well: value = 255 · exposure · gain_c · light, then response and noise.
  double exposure = 0.9;
  std::array<double, 3> gain = {1.0, 1.0, 1.0};
  double crosstalk = 0.0;           // share of each channel's light that is the mean of all
  double shading = 0.0;             // light falls linearly by this share from left to right
  std::array<double, 3> falloff{};  // vignetting of the lens, 1 + aρ² + bρ⁴ + cρ⁶
  bool srgb = false;
  double noise = 0.0;  // code values rms at full light, growing as its root, plus a fifth of it
  BayerOrder bayer = BayerOrder::kNone;
  int bits = 8;
  std::uint32_t seed = 1;
};

struct RenderedChart {
  DecodedImage image;
  std::array<Eigen::Vector2d, kChartPatches> centres;  // pixels
  double patch_side = 0.0;                             // pixels, mean over the patches
};

RenderedChart RenderChart(const ChartScene& scene);

}  // namespace omnihdr
