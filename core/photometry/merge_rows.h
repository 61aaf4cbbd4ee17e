#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/image/image.h"
#include "core/image/image_io.h"

namespace omnihdr {

// How the frames that measured a pixel are weighted against each other.
enum class MergeWeights {
  kInverseVariance,  // 1 / variance of the signal the frames agree on, from the noise model
  kHat,              // Z in the lower half of the values, 255 − Z above (thesis eq. 2.5)
};

// File value to E·t of the three channels, for all frames of one bit depth.
struct ExposureTable {
  std::array<std::vector<float>, 3> exposure;  // by file value
  std::int32_t low = 0;                        // usable file values: low..high
  std::int32_t high = 0;
  std::int32_t largest = 255;
  // When `is_linear`: from `linear_from` on, exposure = (value − linear_black)·linear_scale.
  bool is_linear = false;
  std::array<float, 3> linear_scale{};
  float linear_black = 0.0F;
  std::int32_t linear_from = 0;
};

// One frame to merge. Image and table are borrowed.
struct FramePlan {
  const DecodedImage* image = nullptr;
  const ExposureTable* table = nullptr;
  float seconds = 0.0F;
  float inverse_seconds = 0.0F;
};

// A bracket ready to merge. Variance of E·t in a frame: read + shot·E·t + prnu·(E·t)² per channel.
struct MergePlan {
  std::vector<FramePlan> frames;  // shortest exposure first, 1 to 64
  std::array<float, 3> read{};
  std::array<float, 3> shot{};
  float prnu = 0.0F;
  MergeWeights weights = MergeWeights::kInverseVariance;
};

// Merges rows of a plan's frames, borrowed for its life; each thread has its own.
class RowMerger {
 public:
  explicit RowMerger(const MergePlan& plan);
  ~RowMerger();
  // Row `y` into `radiance` (width × R, G, B, usable) and `flags` (width PixelFlag bytes). What is
  // written depends on the row's pixels alone.
  void Merge(int y, float* radiance, std::uint8_t* flags);

 private:
  struct Chunk;

  void Read(std::size_t k, int y, int x, int count);
  void Combine(std::size_t channel);
  // A pixel of which some channel is measured by no frame.
  void MergeUnmeasured(int x, int y, float* rgb, std::uint8_t* flags) const;

  const MergePlan& plan_;
  std::size_t shortest_ = 1;    // how many frames share the shortest exposure
  bool is_well_scaled_ = true;  // products of three variances stay within float's range
  std::vector<std::unique_ptr<Chunk>> chunks_;  // one a frame
  std::array<std::array<float, 256>, 3> merged_{};
};

}  // namespace omnihdr
