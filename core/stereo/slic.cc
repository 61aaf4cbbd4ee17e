#include "core/stereo/slic.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr int kCandidates = 9;
constexpr int kLargestSide = 512;  // of a cell, in pixels
constexpr int kSums = 6;           // count, three channels, x and y from the cell's corner
constexpr int kLanes = 16;         // rows of a cell are worked on in whole vectors

struct Centre {
  float x = 0.0F;  // in columns, not wrapped: near its own cell
  float y = 0.0F;
  std::array<float, 3> colour{};
};

struct Planes {
  std::array<Image<std::uint8_t>, 3> channel;
};

// Squared distances of a row of a cell to one centre, and whom they make the nearest.
OMNIHDR_SIMD_CLONES
void Compete(const std::uint8_t* a, const std::uint8_t* b, const std::uint8_t* c, int count,
             float x_from_centre, float x_weight, float y_term, float ca, float cb, float cc,
             std::int32_t candidate, float* least, std::int32_t* nearest) {
  for (int i = 0; i < count; ++i) {
    const float da = static_cast<float>(a[i]) - ca;
    const float db = static_cast<float>(b[i]) - cb;
    const float dc = static_cast<float>(c[i]) - cc;
    const float dx = x_from_centre + static_cast<float>(i);
    const float distance = da * da + db * db + dc * dc + x_weight * dx * dx + y_term;
    const bool nearer = distance < least[i];
    least[i] = nearer ? distance : least[i];
    nearest[i] = nearer ? candidate : nearest[i];
  }
}

class Clustering {
 public:
  Clustering(ImageView<const std::uint8_t> picture, const SlicOptions& options)
      : width_(picture.width()),
        height_(picture.height()),
        columns_(std::max(3, width_ / options.side_px)),
        rows_(std::max(1, height_ / options.side_px)),
        spatial_(static_cast<float>(options.compactness * options.compactness /
                                    (options.side_px * options.side_px))),
        centres_(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_)),
        sums_(centres_.size()),
        label_(width_, height_) {
    for (std::size_t c = 0; c < 3; ++c) {
      planes_.channel[c] = Image<std::uint8_t>(width_ + kLanes, height_);
    }
    ParallelFor(height_, 32, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < width_; ++x) {
          for (std::size_t c = 0; c < 3; ++c) {
            planes_.channel[c].at(x, y) = picture.at(x, y, static_cast<int>(c));
          }
        }
      }
    });
    for (int y = 0; y < height_; ++y) {
      const auto s =
          static_cast<float>(std::sin(std::numbers::pi * (y + 0.5) / std::max(1, height_)));
      x_weight_.push_back(spatial_ * s * s);
    }
    for (int cy = 0; cy < rows_; ++cy) {
      for (int cx = 0; cx < columns_; ++cx) PlaceCentre(cx, cy);
    }
  }

  Image<std::int32_t> Run(int iterations) {
    for (int k = 0; k < iterations; ++k) {
      ParallelFor(rows_, 1, [&](int begin, int end) {
        for (int cy = begin; cy < end; ++cy) {
          for (int cx = 0; cx < columns_; ++cx) AssignCell(cx, cy, k + 1 < iterations);
        }
      });
      if (k + 1 == iterations) break;
      ParallelFor(rows_, 4, [&](int begin, int end) {
        for (int cy = begin; cy < end; ++cy) {
          for (int cx = 0; cx < columns_; ++cx) MoveCentre(cx, cy);
        }
      });
    }
    return std::move(label_);
  }

 private:
  int Left(int cx) const { return cx * width_ / columns_; }
  int Top(int cy) const { return cy * height_ / rows_; }
  std::size_t Index(int cx, int cy) const {
    return static_cast<std::size_t>(cy) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>((cx + columns_) % columns_);
  }

  // In the middle of its cell, moved to the flattest of the nine pixels there.
  void PlaceCentre(int cx, int cy) {
    const int mx = (Left(cx) + Left(cx + 1)) / 2;
    const int my = (Top(cy) + Top(cy + 1)) / 2;
    int flattest = std::numeric_limits<int>::max();
    Centre& centre = centres_[Index(cx, cy)];
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const int x = (mx + dx + width_) % width_;
        const int y = std::clamp(my + dy, 0, height_ - 1);
        int slope = 0;
        for (const Image<std::uint8_t>& plane : planes_.channel) {
          slope += std::abs(plane.at((x + 1) % width_, y) - plane.at((x + width_ - 1) % width_, y));
          slope +=
              std::abs(plane.at(x, std::min(height_ - 1, y + 1)) - plane.at(x, std::max(0, y - 1)));
        }
        if (slope >= flattest) continue;
        flattest = slope;
        centre.x = static_cast<float>(mx + dx);
        centre.y = static_cast<float>(y);
        for (std::size_t c = 0; c < 3; ++c) centre.colour[c] = planes_.channel[c].at(x, y);
      }
    }
  }

  void AssignCell(int cx, int cy, bool with_sums) {
    const int left = Left(cx);
    const int count = Left(cx + 1) - left;
    const int padded = (count + kLanes - 1) / kLanes * kLanes;
    std::array<float, kLargestSide> least{};
    std::array<std::int32_t, kLargestSide> nearest{};
    const int top = Top(cy);
    std::array<std::int32_t, kCandidates> candidate_label{};
    for (int k = 0; k < kCandidates; ++k) {
      candidate_label[static_cast<std::size_t>(k)] =
          static_cast<std::int32_t>(Index(cx + k % 3 - 1, std::max(0, cy + k / 3 - 1)));
    }
    auto& sums = sums_[Index(cx, cy)];
    for (auto& s : sums) s.fill(0);
    for (int y = top; y < Top(cy + 1); ++y) {
      std::fill_n(least.begin(), padded, std::numeric_limits<float>::max());
      const std::array<const std::uint8_t*, 3> row = {planes_.channel[0].row(y) + left,
                                                      planes_.channel[1].row(y) + left,
                                                      planes_.channel[2].row(y) + left};
      for (int k = 0; k < kCandidates; ++k) {
        const int ny = cy + k / 3 - 1;
        const int nx = cx + k % 3 - 1;
        if (ny < 0 || ny >= rows_) continue;
        const Centre& centre = centres_[Index(nx, ny)];
        const int turn = nx < 0 ? -width_ : (nx >= columns_ ? width_ : 0);
        const float dy = static_cast<float>(y) - centre.y;
        Compete(row[0], row[1], row[2], padded,
                static_cast<float>(left) - centre.x - static_cast<float>(turn),
                x_weight_[static_cast<std::size_t>(y)], spatial_ * dy * dy, centre.colour[0],
                centre.colour[1], centre.colour[2], k, least.data(), nearest.data());
      }
      std::int32_t* label = label_.row(y) + left;
      for (int i = 0; i < count; ++i) {
        const std::int32_t k = nearest[static_cast<std::size_t>(i)];
        label[i] = candidate_label[static_cast<std::size_t>(k)];
        if (!with_sums) continue;
        auto& s = sums[static_cast<std::size_t>(k)];
        s[0] += 1;
        s[1] += row[0][i];
        s[2] += row[1][i];
        s[3] += row[2][i];
        s[4] += i;
        s[5] += y - top;
      }
    }
  }

  // To the mean of what the cells around gave it; sums of whole numbers, so any order is the same.
  void MoveCentre(int cx, int cy) {
    std::array<std::int64_t, kSums> total{};
    for (int k = 0; k < kCandidates; ++k) {
      const int ny = cy + k / 3 - 1;
      const int nx = cx + k % 3 - 1;
      if (ny < 0 || ny >= rows_) continue;
      // Seen from that cell, this centre is the candidate on the opposite side.
      const auto& s = sums_[Index(nx, ny)][static_cast<std::size_t>(kCandidates - 1 - k)];
      const int turn = nx < 0 ? -width_ : (nx >= columns_ ? width_ : 0);
      const std::int64_t left = Left((nx + columns_) % columns_) + turn;
      for (std::size_t t = 0; t < kSums; ++t) total[t] += s[t];
      total[4] += s[0] * left;
      total[5] += static_cast<std::int64_t>(s[0]) * Top(ny);
    }
    if (total[0] == 0) return;
    Centre& centre = centres_[Index(cx, cy)];
    const auto mean = [&](std::size_t t) {
      return static_cast<float>(static_cast<double>(total[t]) / static_cast<double>(total[0]));
    };
    centre = {mean(4), mean(5), {mean(1), mean(2), mean(3)}};
  }

  int width_;
  int height_;
  int columns_;
  int rows_;
  float spatial_;
  Planes planes_;
  std::vector<float> x_weight_;  // of a squared step along each row
  std::vector<Centre> centres_;
  // Of each cell: what its pixels give to the nine centres around.
  std::vector<std::array<std::array<std::int32_t, kSums>, kCandidates>> sums_;
  Image<std::int32_t> label_;
};

// Every connected piece gets a label of its own, except that a small one joins the piece beside its
// first pixel.
Superpixels Connect(const Image<std::int32_t>& cluster, int least_size) {
  const int width = cluster.width();
  const int height = cluster.height();
  Superpixels out;
  out.label = Image<std::int32_t>(width, height, 1, -1);
  const std::int32_t* from = cluster.data();
  std::int32_t* label = out.label.data();
  std::vector<std::int32_t> piece;
  for (std::int32_t start = 0; start < width * height; ++start) {
    if (label[start] >= 0) continue;
    const std::int32_t id = out.count;
    const std::int32_t what = from[start];
    piece.assign(1, start);
    label[start] = id;
    for (std::size_t k = 0; k < piece.size(); ++k) {
      const std::int32_t at = piece[k];
      const std::int32_t x = at % width;
      const std::array<std::int32_t, 4> around = {
          x == 0 ? at + width - 1 : at - 1, x + 1 == width ? at - width + 1 : at + 1,
          at >= width ? at - width : at, at + width < width * height ? at + width : at};
      for (const std::int32_t n : around) {
        if (label[n] >= 0 || from[n] != what) continue;
        label[n] = id;
        piece.push_back(n);
      }
    }
    if (static_cast<int>(piece.size()) < least_size) {
      const std::int32_t x = start % width;
      const std::array<std::int32_t, 3> before = {x == 0 ? start + width - 1 : start - 1,
                                                  start >= width ? start - width : start,
                                                  x + 1 == width ? start - width + 1 : start + 1};
      const auto* other = std::find_if(before.begin(), before.end(), [&](std::int32_t n) {
        return label[n] >= 0 && label[n] != id;
      });
      if (other != before.end()) {
        for (const std::int32_t at : piece) label[at] = label[*other];
        continue;
      }
    }
    ++out.count;
  }
  return out;
}

}  // namespace

Superpixels FindSuperpixels(ImageView<const std::uint8_t> picture, const SlicOptions& options) {
  assert(options.side_px >= 4 && options.side_px <= 256 && options.iterations >= 1);
  assert(picture.channels() == 3 && picture.width() >= 3 * options.side_px);
  const Image<std::int32_t> cluster = Clustering(picture, options).Run(options.iterations);
  return Connect(cluster, options.side_px * options.side_px / 4);
}

}  // namespace omnihdr
