#pragma once

#include <span>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/measurement.h"
#include "core/photometry/mosaic.h"
#include "core/photometry/seam_report.h"
#include "core/photometry/stitch_source.h"
#include "core/photometry/stitch_table.h"

namespace omnihdr {

// Raw frames of a rig to the measurement of a panorama: counts are linearised and merged at the
// mosaic, where every value knows whether it clipped; panorama pixels are interpolated from the
// mosaic colour by colour (MeasureOptions::demosaic) through tables built once, corrected for
// vignetting and the sensors' gains, and blended in linear radiance where sensors meet. Laws: a
// pixel is saturated in a channel when any value of that colour it was made from is, dark when all
// are, and then holds the least of those values, a bound; a saturated sample does not enter a blend
// with one that is not, unless that one is far below what it proves (BlendSamples); where no sensor
// sees, the pixel is masked. The noise of the measurement is the panorama's mean: interpolation
// lowers it, correction for vignetting raises it towards the sensors' corners, and neighbouring
// pixels share values, so their noise is not independent. The same bytes on any number of cores.
// Not thread-safe: a stitcher keeps its scratch memory; uses the worker pool inside.
class Stitcher {
 public:
  // Errors as BuildStitchTable, and where no sensor sees anything of the panorama.
  static Result<Stitcher> Create(Rig rig, const SphereGrid& grid, const StitchMasks& masks);
  static Result<Stitcher> Create(Rig rig, const Projection& projection, const StitchMasks& masks) {
    return Create(std::move(rig), SphereGrid(projection), masks);
  }

  // Frames of one place (one, or a bracket taken standing still) to a measurement. `responses`: one
  // for all sensors, or one each. `out` is overwritten, its memory used again when it has the
  // panorama's size; of grids that are no Projection (cube, RD-map) its projection is empty. Errors
  // as MergeMosaic.
  Status Stitch(std::span<const RigFrame> frames, std::span<const Response> responses, int bits,
                const MeasureOptions& options, Measurement* out);
  // How the sensors agree where they meet in the same frames. Errors as Stitch.
  Result<std::vector<Seam>> Seams(std::span<const RigFrame> frames,
                                  std::span<const Response> responses, int bits,
                                  const MeasureOptions& options);

  const Rig& rig() const { return rig_; }
  const SphereGrid& grid() const { return grid_; }
  int frame_width() const { return rig_.sensors.front().lens.width(); }
  int frame_height() const { return rows_.back(); }
  // Share of the panorama's pixels that some sensor sees.
  double covered() const { return table_.covered; }

 private:
  Stitcher() = default;
  // The source borrows the frames and this stitcher's mosaic.
  Result<StitchSource> Prepare(std::span<const RigFrame> frames,
                               std::span<const Response> responses, int bits,
                               const MeasureOptions& options, std::vector<MosaicNoise>* noise);

  Rig rig_;
  SphereGrid grid_;
  std::vector<int> rows_;
  StitchTable table_;
  RadianceMosaic mosaic_;
  Image<float> guide_;
};

// Width of a lat-long picture that keeps what the sensors resolve on their axes and does not blow
// it up: four fifths of a sensor pixel's angle a pixel for mosaics, whose colours are sampled at
// half density, a multiple of 64 in [256, 8192].
int NaturalPanoramaWidth(const Rig& rig);

}  // namespace omnihdr
