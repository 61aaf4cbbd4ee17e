#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace omnihdr {

// What every sweep over inverse distances shares: blocks of hypotheses of a tile of a lat-long map,
// and where another view's lattice (see StereoView) holds the texel that a hypothesis sees.

constexpr int kTileColumns = 32;  // pixels of a row that are searched over the same labels
constexpr int kTileLabels = 8;    // labels of a tile worked on at a time
// Hypotheses worked on at a time, columns fastest: everything stays in the first-level cache.
constexpr int kSweepBlock = kTileColumns * kTileLabels;

// Rays of the tile's columns; one row of a lat-long map has one elevation.
struct TileRays {
  alignas(64) std::array<float, kTileColumns> x;
  alignas(64) std::array<float, kTileColumns> y;
  float z = 0.0F;
};
// Normalised disparities of a block's labels.
struct LabelDisparities {
  float first = 0.0F;
  float step = 0.0F;
};

// Cosine and sine of the azimuth of every column's centre.
std::vector<std::array<float, 2>> ColumnDirections(int width);

// Rays of the tile's columns from `x0` on of row `y` of a map of `height` rows; past the last
// column, the last one again.
void FillRays(const std::vector<std::array<float, 2>>& columns, int x0, int y, int height,
              TileRays* rays);

// Lattice index of where a neighbour at `offset` sees the hypotheses: texel of (u − d·b). What a
// pixel's hypotheses show lies on a great circle, which is nearly a parabola over a block's labels:
// three of them are computed and the others put between, to a small part of a texel. A block for
// which that does not hold - near a pole of the lattice, or where its columns begin again - is
// computed one by one.
void LatticeIndices(const TileRays& u, const float* offset, const LabelDisparities& d,
                    int lattice_width, int lattice_height, std::int32_t* index);

void GatherTexels(const std::uint64_t* texels, const std::int32_t* index, std::uint64_t* out);

// sum·multiplier / 65536, rounded, of a block.
void NormaliseSums(const std::uint16_t* sum, std::uint16_t multiplier, std::uint8_t* out);

// Costs of a block's first `columns` pixels and `labels` labels to label-fastest order, the labels
// of one pixel `stride` values after those of the one before.
void StoreLabelFastest(const std::uint8_t* block, int columns, int labels, std::ptrdiff_t stride,
                       std::uint8_t* out);

}  // namespace omnihdr
