#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace omnihdr {

// What every sweep over inverse distances shares: blocks of rays of one row of a lat-long map, and
// where another view's lattice (see StereoView) holds the texel that a hypothesis sees.

constexpr int kSweepBlock =
    256;  // columns worked on at a time: everything stays in the first-level cache

struct RayBlock {
  alignas(64) std::array<float, kSweepBlock> x;
  alignas(64) std::array<float, kSweepBlock> y;
  float z = 0.0F;  // one row of a lat-long map has one elevation
};

// Cosine and sine of the azimuth of every column's centre.
std::vector<std::array<float, 2>> ColumnDirections(int width);

// Rays of the columns from `x0` on of row `y` of a map of `height` rows; past the last column, the
// last one again.
void FillRays(const std::vector<std::array<float, 2>>& columns, int x0, int y, int height,
              RayBlock* rays);

// Lattice index of where a neighbour at `offset` sees the hypothesis: texel of (u − d·b).
void LatticeIndices(const RayBlock& u, const float* offset, float d, int lattice_width,
                    int lattice_height, std::int32_t* index);

void GatherTexels(const std::uint64_t* texels, const std::int32_t* index, std::uint64_t* out);

// sum·multiplier / 65536, rounded, of a block.
void NormaliseSums(const std::uint16_t* sum, std::uint16_t multiplier, std::uint8_t* out);

// Costs of `columns` pixels, one block of kSweepBlock values a label, to label-fastest order.
void StoreLabelFastest(const std::uint8_t* by_label, int columns, int labels, std::uint8_t* out);

}  // namespace omnihdr
