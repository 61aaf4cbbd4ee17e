#pragma once

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/photometry/merge_rows.h"
#include "core/sphere/pose.h"
#include "core/stereo/methods.h"
#include "core/stereo/sgm.h"

namespace omnihdr {

enum class PixelOrigin : std::uint8_t {
  kNoData = 0,    // nothing measured: outside the sensor, masked everywhere
  kMeasured = 1,  // at least one view measured it
  kClipped = 2,   // saturated in every view: the largest known lower bound, neutral
  kDark = 3,      // below the usable range in every view: best estimate
};

// One view that contributes to a merge.
struct MergeSource {
  const Measurement* measurement = nullptr;
  Pose world_from_camera;
  const DisparityMap* disparity = nullptr;  // its own map, or null when not made yet
  // Its own map as matched, for what is behind movers: read when those are to be removed. May be
  // null.
  const DisparityMap* matched = nullptr;
};

struct MergeOptions {
  float misalignment_px = 0.35F;  // expected registration error of a trusted disparity, in pixels
  float distrusted_px = 1.2F;     // of one with confidence 0
  float model_error = 0.12F;      // relative error of another view besides noise: gloss, focus, ...
  float consistency_log10 = 0.03F;  // log10 disagreement with the own view, beyond noise and
                                    // misregistration, at which a sample counts half
  float block_error = 0.02F;  // relative error of a block's mean that still counts as agreement
  float occlusion_tolerance = 0.05F;  // relative: a surface nearer by more hides the sample
  // How samples are weighed against each other: by variance, or by the hat over each sample's value
  // (its share of the radiance that saturates), dark ones only where nothing better exists.
  MergeWeights weights = MergeWeights::kInverseVariance;
  // Whether samples count by how well they agree with what the reference saw, and the views'
  // radiance is brought to the reference's. Without, every sample that is not saturated counts, as
  // in the thesis (5.2.2).
  bool consistency = true;
  bool occlusion = true;  // whether what something nearer hides in another view is left out
  MergeMovers movers = MergeMovers::kKeep;
  // Whether the reference's exposure label is tested against its neighbours; the largest relative
  // correction. See MergedView::exposure.
  bool refine_exposure = true;
  float refine_limit = 0.2F;
};

// The reference's exposure as the views around it see it.
struct ExposureTest {
  // Exposure over label: the median, over the views that share enough surfaces and the reference
  // itself, of how their radiance compares. A majority must be of one opinion, so that one view
  // with a wrong label, or light that changes steadily, moves nothing.
  float measured = 1.0F;
  float scale = 1.0F;  // what the radiance was divided by: `measured` where it is clearly off,
                       // within the limit; else 1
  int views = 0;       // that were compared
};

struct MergedView {
  Image<float> radiance;   // W×H×3, lat-long; 0 where there is no data
  Image<float> disparity;  // W×H; NaN = unknown
  Image<float>
      confidence;  // W×H, 0..1: the map's score; a probability once calibrated (confidence.h)
  Image<std::uint8_t> origin;  // W×H, PixelOrigin
  // W×H: which views a pixel is made of, those with a tenth of the weight or more (of a clipped
  // pixel: those whose bound it is): bit 0 the reference, bit n the n-th of `others`.
  Image<std::uint8_t> sources;
  ExposureTest exposure;
};

// A line for the user, or "" when the label is right or could not be tested.
std::string DescribeExposureTest(const ExposureTest& test, const MergeOptions& options);

// The radiance map of `reference` on a lat-long grid of `width` × width/2 whose axes are turned by
// `world_from_output`: every pixel is sought in the other views through the reference's disparity
// (backward warp), unless hidden there; what is found is weighed by the inverse of its variance -
// sensor noise, local contrast times the expected misregistration, a constant model error - and by
// how well it agrees with what the reference itself saw, as an interval: a saturated reference
// pixel only says "at least". Saturated samples never contribute a value. Where the reference is
// saturated and every other view counts as hidden, what they hold there is taken after all if it
// is bright enough: one wrong disparity would otherwise leave a dark dot. For the same reason the
// bound of a view that is clipped there counts unless the disparity is sure. On the rim of a
// clipped area, where an output pixel lies between clipped pixels and others, the reference's blend
// is such a bound, and what is found in the other views is taken for the clipped part of it alone.
// A reference pixel too dark to contradict anything is helped by those around it (dark_surround.h).
// Where the reference is masked, others fill in only where the disparity is trusted. `map` is the
// reference's disparity (world-aligned lat-long, holes filled) or null: merge by rotation alone,
// disparity unknown.
MergedView MergeViews(const MergeSource& reference, const DisparityMap* map,
                      const std::vector<MergeSource>& others,
                      const Eigen::Quaterniond& world_from_output, int width,
                      const MergeOptions& options);

}  // namespace omnihdr
