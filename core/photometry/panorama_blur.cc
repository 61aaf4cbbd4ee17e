#include "core/photometry/panorama_blur.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

// Half of a symmetric kernel, from the centre, summing to one as a whole.
std::vector<float> GaussianTaps(double sigma, int radius) {
  std::vector<double> taps;
  double sum = 0.0;
  for (int k = 0; k <= radius; ++k) {
    taps.push_back(sigma > 0.0 ? std::exp(-0.5 * k * k / (sigma * sigma)) : (k == 0 ? 1.0 : 0.0));
    sum += (k == 0 ? 1.0 : 2.0) * taps.back();
  }
  std::vector<float> result;
  for (const double tap : taps) result.push_back(static_cast<float>(tap / sum));
  return result;
}

int RadiusOf(double sigma) { return static_cast<int>(std::ceil(3.0 * sigma)); }

OMNIHDR_SIMD_CLONES void Scale(const float* in, float tap, int count, float* out) {
  for (int x = 0; x < count; ++x) out[x] = tap * in[x];
}

OMNIHDR_SIMD_CLONES void AddPair(const float* a, const float* b, float tap, int count, float* out) {
  for (int x = 0; x < count; ++x) out[x] += tap * (a[x] + b[x]);
}

// Two taps at once: half the traffic of the sums.
OMNIHDR_SIMD_CLONES void AddPairs(const float* a0, const float* b0, float tap0, const float* a1,
                                  const float* b1, float tap1, int count, float* out) {
  for (int x = 0; x < count; ++x) out[x] += tap0 * (a0[x] + b0[x]) + tap1 * (a1[x] + b1[x]);
}

// One row; `padded` holds the row with `radius` more values on both sides.
void FilterRow(const float* padded, const std::vector<float>& taps, int radius, int width,
               float* out) {
  const float* centre = padded + radius;
  Scale(centre, taps[0], width, out);
  int k = 1;
  for (; k + 1 <= radius; k += 2) {
    AddPairs(centre - k, centre + k, taps[static_cast<std::size_t>(k)], centre - k - 1,
             centre + k + 1, taps[static_cast<std::size_t>(k) + 1], width, out);
  }
  for (; k <= radius; ++k) {
    AddPair(centre - k, centre + k, taps[static_cast<std::size_t>(k)], width, out);
  }
}

void Pad(const float* row, int width, int radius, bool wraps, std::vector<float>* padded) {
  padded->resize(static_cast<std::size_t>(width) + 2 * static_cast<std::size_t>(radius));
  for (int i = 0; i < radius; ++i) {
    const int left = radius - i;  // how far before the first pixel
    const auto at = static_cast<std::size_t>(i);
    const std::size_t mirror = padded->size() - 1 - at;
    (*padded)[at] = wraps ? row[(width - left % width) % width] : row[0];
    (*padded)[mirror] = wraps ? row[(left - 1) % width] : row[width - 1];
  }
  std::copy_n(row, width, padded->begin() + radius);
}

void BlurRows(ImageView<const float> in, double sigma, PictureShape shape, Image<float>* out) {
  const int width = in.width();
  const int height = in.height();
  // A Gaussian this wide, wrapped around the row, is flat to a few percent.
  const double flat = 0.4 * width;
  ParallelFor(height, 8, [&](int begin, int end) {
    std::vector<float> padded;
    for (int y = begin; y < end; ++y) {
      double sigma_row = sigma;
      if (shape == PictureShape::kSphere) {
        sigma_row /= std::sin(std::numbers::pi * (y + 0.5) / height);
      }
      if (shape != PictureShape::kPlane && sigma_row > flat) {
        double sum = 0.0;
        for (int x = 0; x < width; ++x) sum += static_cast<double>(in.row(y)[x]);
        std::fill_n(out->row(y), width, static_cast<float>(sum / width));
        continue;
      }
      const int radius = RadiusOf(sigma_row);
      Pad(in.row(y), width, radius, shape != PictureShape::kPlane, &padded);
      FilterRow(padded.data(), GaussianTaps(sigma_row, radius), radius, width, out->row(y));
    }
  });
}

// Rows −radius … height + radius − 1 of a picture, as pointers; those over a pole are turned
// copies.
class TallPicture {
 public:
  TallPicture(const Image<float>& image, int radius, PictureShape shape) {
    const int width = image.width();
    const int height = image.height();
    const bool over_pole = shape == PictureShape::kSphere;
    turned_.reserve(over_pole ? 2 * static_cast<std::size_t>(radius) : 0);
    for (int y = -radius; y < height + radius; ++y) {
      if (y >= 0 && y < height) {
        rows_.push_back(image.row(y));
      } else if (!over_pole) {
        rows_.push_back(image.row(std::clamp(y, 0, height - 1)));
      } else {
        // Over a pole and, for a kernel longer than the picture, over the other one.
        const int around = ((y % (2 * height)) + 2 * height) % (2 * height);
        const bool is_turned = around >= height;
        const float* row = image.row(is_turned ? 2 * height - 1 - around : around);
        std::vector<float>& copy = turned_.emplace_back(row, row + width);
        if (is_turned) std::rotate(copy.begin(), copy.begin() + width / 2, copy.end());
        rows_.push_back(copy.data());
      }
    }
  }
  // Row `index` − radius of the picture.
  const float* row(int index) const { return rows_[static_cast<std::size_t>(index)]; }

 private:
  std::vector<std::vector<float>> turned_;
  std::vector<const float*> rows_;
};

}  // namespace

void GaussianBlur(ImageView<const float> in, double sigma, PictureShape shape, Image<float>* out) {
  assert(in.channels() == 1 && sigma >= 0.0);
  const int width = in.width();
  const int height = in.height();
  if (out->width() != width || out->height() != height || out->channels() != 1) {
    *out = Image<float>(width, height, 1);
  }
  if (in.empty()) return;
  Image<float> along_rows(width, height, 1);
  BlurRows(in, sigma, shape, &along_rows);

  const int radius = RadiusOf(sigma);
  const std::vector<float> taps = GaussianTaps(sigma, radius);
  const TallPicture tall(along_rows, radius, shape);
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const int centre = y + radius;
      float* sums = out->row(y);
      Scale(tall.row(centre), taps[0], width, sums);
      int k = 1;
      for (; k + 1 <= radius; k += 2) {
        AddPairs(tall.row(centre - k), tall.row(centre + k), taps[static_cast<std::size_t>(k)],
                 tall.row(centre - k - 1), tall.row(centre + k + 1),
                 taps[static_cast<std::size_t>(k) + 1], width, sums);
      }
      for (; k <= radius; ++k) {
        AddPair(tall.row(centre - k), tall.row(centre + k), taps[static_cast<std::size_t>(k)],
                width, sums);
      }
    }
  });
}

}  // namespace omnihdr
