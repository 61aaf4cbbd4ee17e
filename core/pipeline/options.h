#pragma once

#include <array>
#include <string>

#include "core/base/result.h"
#include "core/image/exr.h"
#include "core/photometry/demosaic.h"
#include "core/photometry/merge_rows.h"
#include "core/photometry/noise_model.h"
#include "core/photometry/tonemap.h"
#include "core/stereo/methods.h"

namespace omnihdr {

enum class ProcessMode { kAuto, kSpatiotemporal, kTemporal };
enum class OutputOrientation { kAligned, kCamera };
// Which pixels of radiance.exr read NaN instead of an estimate.
enum class NanPixels {
  kNever,
  kNoData,      // nothing was measured there: masked, outside the sensor
  kUnmeasured,  // those, and the clipped and dark ones
};

// Everything that decides what a view looks like. Two runs with equal options over equal journals
// give equal bytes. Config section in brackets.
struct PipelineOptions {
  // [pipeline]
  // auto: temporal when the session is `perspective` or a single position, else spatiotemporal.
  ProcessMode mode = ProcessMode::kAuto;
  // [output]
  int output_width =
      0;  // of the lat-long pictures; 0 = the input panorama's width, even, at most 8192
  OutputOrientation orientation = OutputOrientation::kAligned;
  int preview_quality = 90;
  ToneMapOptions preview;  // of preview.jpg; its shape follows from the picture
  // Of radiance.exr; half becomes float where it cannot hold the values.
  ExrPixelType exr_type = ExrPixelType::kHalf;
  // What the radiance's red, green, blue and white are, as the EXR files tell; they are not
  // converted.
  Chromaticities chromaticities = kRec709;
  NanPixels nan = NanPixels::kNever;
  // PNG or JPEG the size of a frame, white = use; empty = no mask. Relative paths: to the working
  // directory (command line) or to the config file.
  std::string mask_file;  // [input] mask
  // [photometry]
  double value_low = 10.0;  // usable range of pixel values in 8-bit units (thesis 5.2.2)
  double value_high = 245.0;
  NoiseModel noise = {.read = 0.0};  // read noise 0: estimated from each frame
  // Luminance of radiance (1, 1, 1) in cd/m², of a camera that is calibrated absolutely; 0 =
  // unknown.
  double white_luminance = 0.0;
  MergeWeights weights = MergeWeights::kInverseVariance;
  std::array<double, 3> white_balance = {1.0, 1.0, 1.0};  // gains on R, G, B
  // Whether exposure labels are tested where frames overlap and corrected, by at most refine_limit
  // (relative).
  bool refine_exposure = true;
  double refine_limit = 0.2;
  // [stitch]
  Demosaic demosaic = Demosaic::kBilinear;  // of a rig's raw frames
  // [stereo]
  int stereo_width = 1024;         // of the equirectangular matching grid
  int labels = 96;                 // inverse-distance hypotheses
  double max_parallax_deg = 45.0;  // largest parallax between neighbouring positions searched for
  int neighbours = 2;              // positions on each side that take part (1 or 2)
  StereoCost cost = StereoCost::kInterval;
  StereoSearch search = StereoSearch::kRanges;
  StereoFusion fusion = StereoFusion::kVotes;
  StereoFilter filter = StereoFilter::kWavelet;  // of the fused map, before it is filled
  StereoFill fill = StereoFill::kRims;
  bool sky = false;  // whether superpixels the colour of the sky are put at infinity
  // [pose]
  double min_baseline_ratio =
      0.002;           // below this (baseline over median distance) a pair is a pure rotation
  int keyframes = 64;  // places remembered to be recognised, at most; 0 = none
  double heading_sigma_deg = 0.0;  // of the frames' compass headings, degrees; 0 = not used
  // [merge]
  // log10 disagreement with the own view, beyond noise and misregistration, at which another view's
  // sample counts half
  double consistency_sigma = 0.03;
  int merge_neighbours = 2;  // positions on each side whose pixels are taken (1 or 2)
  // Weights of the positions against each other; those of one position's exposures: `weights`.
  MergeWeights merge_weights = MergeWeights::kInverseVariance;
  bool consistency = true;  // whether samples count by their agreement with the own view
  bool occlusion = true;    // whether hidden samples are left out
  MergeMovers movers = MergeMovers::kKeep;
  // Folder of pictures that show in white where something moves, named as the frames with .png; ""
  // = none. Relative paths: to the session. See MarkMovers.
  std::string mover_masks;
  Status Validate() const;  // kConfig error naming the option and its range

  // The method of Zhou's thesis (2014) as far as this program has its parts: two neighbours, the
  // radiometrically adjusted and gradient cost, stability fusion of cross-checked maps, wavelet
  // filter, superpixels, sky model, and a merge by backward warp with hat weights that asks neither
  // for agreement nor for occlusion. config/thesis.toml says the same. In place of its multi-scale
  // matching stands semi-global matching.
  static PipelineOptions Thesis();
};

// The methods of matching and merging that are not the default, as "stereo.cost = census,
// merge.occlusion = false"; "" when all are. view.json tells it (resume.methods).
std::string DescribeMethods(const PipelineOptions& options);

}  // namespace omnihdr
