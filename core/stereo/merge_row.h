#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/photometry/measurement.h"
#include "core/photometry/row_sampler.h"
#include "core/stereo/agreement_field.h"
#include "core/stereo/merge_source.h"
#include "core/stereo/row_geometry.h"

namespace omnihdr {

// A merge's arithmetic a row of output pixels at a time, one array a quantity, so that it is done
// in vectors. Rows are values, one of each per thread.

// A map at points finer than its pixels: the four around, weighed by nearness, but never a mean of
// two surfaces: only values close to the heaviest one take part. NaN where none is known.
// `confidence`: the heaviest one's.
void LookUpDisparity(const DisparityMap& map, const PointRow& points, float* disparity,
                     float* confidence);

// What another view says of a row of the output's surface points.
struct SourceRow {
  SeenRow seen;
  SampledRow sampled;                          // radiance as the reference would have measured it
  std::array<std::vector<float>, 3> variance;  // of that
  std::vector<float> trust;                    // of the block of pixels that each lies in
  std::vector<Sight> sight;
  std::vector<float> weight;  // of green in the mean of plain pixels (PlainRow::Add)
};

// How likely it is that a view shows something else than the surface sought.
struct MergeErrors {
  const float* misregistration;  // of each output pixel, in pixels
  float model_error;             // relative
};

// Fills all but `weight` of row `y` of an output of `width` pixels from `row->seen`. `block`: side
// of a block of SourceLookup::block_trust, in output pixels; `disparity`: of the reference along
// the row, NaN = unknown.
void SampleSource(const SourceLookup& source, const RowSampler& sampler, int y, int width,
                  int block, const float* disparity, float occlusion_tolerance,
                  const MergeErrors& errors, SourceRow* row);

// No trust in samples whose green is outside its pixel's limits (DarkSurround); a clipped one is a
// bound and stays.
void DistrustOutside(const std::vector<float>& least, const std::vector<float>& most,
                     SourceRow* row);

// The mean of a row's plain pixels: those that the reference measured in every channel, and those
// that are dark there while the others do not contradict each other. Values of other pixels are
// computed as well and mean nothing.
class PlainRow {
 public:
  void Start(const Measurement& own, const SampledRow& mine);
  // `consistency`: whether a sample counts by its agreement with the reference's, by as many
  // standard deviations as halve the trust, beside a relative tolerance.
  void Add(const Measurement& own, const SampledRow& mine, bool consistency,
           float half_trust_sigmas, float relative_tolerance, SourceRow* source);

  // Of a pixel that is dark in the reference and nothing else: whether the others that are trusted
  // agree well enough for a mean of all (see IsContested), and whether it is dark in all of them.
  bool IsAgreedDark(std::size_t x) const {
    return !IsContested(static_cast<int>(voters_[x]), least_[x], most_[x]);
  }
  bool IsDarkEverywhere(std::size_t x) const { return lit_[x] == 0; }

  float Mean(std::size_t x, std::size_t channel) const {
    return sum_[channel][x] / weight_[channel][x];
  }
  // Of green; of the reference's own sample.
  const std::vector<float>& weight() const { return weight_[1]; }
  const std::vector<float>& own_weight() const { return own_weight_; }

 private:
  std::array<std::vector<float>, 3> sum_;
  std::array<std::vector<float>, 3> weight_;
  std::vector<float> own_weight_;
  std::vector<float> chi_;
  std::vector<float> trust_;
  // Of rows with dark pixels.
  bool has_dark_ = false;
  std::vector<float> voters_;
  std::vector<float> least_;  // radiance of green
  std::vector<float> most_;
  std::vector<std::uint8_t> lit_;
};

}  // namespace omnihdr
