#include "core/pose/feature_image.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <utility>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

// Beyond 75° of latitude a Mercator map magnifies what the camera hardly resolves.
constexpr double kHighestOrdinate = 2.0276;
constexpr int kColumnMultiple = 32;
constexpr int kSmallestWidth = 64;
// Grey: about what each channel of a daylight picture measures best.
constexpr float kGrey[3] = {0.3F, 0.5F, 0.2F};
// Radiance added before the logarithm, in units of the noise floor. More would dampen contrast in
// the dark, where short exposures meet long ones; less would let noise speak.
constexpr float kSoftening = 0.5F;
// A pixel counts as usable when this share of its footprint does.
constexpr float kUsableShare = 0.999F;

struct Tap {
  int index;
  float weight;
};

// Source samples under [begin, end), in source pixels: box where the footprint is larger than a
// pixel, linear interpolation at its middle where it is smaller. Weights sum to 1; indices are
// clamped to [0, count) or wrapped round it.
std::vector<Tap> Footprint(double begin, double end, int count, bool wrap) {
  std::vector<Tap> taps;
  const auto add = [&](int index, double weight) {
    if (weight <= 0.0) return;
    index = wrap ? ((index % count) + count) % count : std::clamp(index, 0, count - 1);
    taps.push_back({index, static_cast<float>(weight)});
  };
  const double length = end - begin;
  if (length >= 1.0) {
    for (int i = static_cast<int>(std::floor(begin)); i < end; ++i) {
      add(i, (std::min<double>(end, i + 1) - std::max<double>(begin, i)) / length);
    }
  } else {
    const double middle = 0.5 * (begin + end) - 0.5;
    const int i = static_cast<int>(std::floor(middle));
    add(i, 1.0 - (middle - i));
    add(i + 1, middle - i);
  }
  return taps;
}

double RowOfOrdinate(const Projection& projection, double ordinate) {
  const double z = std::sinh(ordinate);
  return projection.PixelFromRay({1.0, 0.0, z}).y();
}

// Ordinate where the panorama's first or last row ends, at most the highest.
double OrdinateLimit(const Projection& projection, bool top) {
  if (projection.kind() == ProjectionKind::kEquirectangular) {
    return top ? kHighestOrdinate : -kHighestOrdinate;
  }
  const double z = top ? projection.z_max() : projection.z_min();
  return std::clamp(std::asinh(z), -kHighestOrdinate, kHighestOrdinate);
}

// Fills pixels of weight 0 from their surroundings: averages of ever larger blocks, the smallest
// that holds anything.
void FillFromSurroundings(Image<float>& values, Image<float>& weights) {
  if (values.width() <= 1 || values.height() <= 1) return;
  const int half_width = (values.width() + 1) / 2;
  const int half_height = (values.height() + 1) / 2;
  Image<float> half(half_width, half_height);
  Image<float> half_weights(half_width, half_height);
  bool complete = true;
  for (int y = 0; y < half_height; ++y) {
    for (int x = 0; x < half_width; ++x) {
      float sum = 0.0F;
      float weight = 0.0F;
      for (int v = 2 * y; v < std::min(2 * y + 2, values.height()); ++v) {
        for (int u = 2 * x; u < std::min(2 * x + 2, values.width()); ++u) {
          const float w = weights.row(v)[u];
          sum += w * values.row(v)[u];
          weight += w;
          complete = complete && w > 0.0F;
        }
      }
      half.row(y)[x] = weight > 0.0F ? sum / weight : 0.0F;
      half_weights.row(y)[x] = weight > 0.0F ? 1.0F : 0.0F;
    }
  }
  if (complete) return;
  FillFromSurroundings(half, half_weights);
  for (int y = 0; y < values.height(); ++y) {
    for (int x = 0; x < values.width(); ++x) {
      if (weights.row(y)[x] > 0.0F) continue;
      const auto sample = [&](int u, int v) {
        return half.row(std::clamp(v, 0, half_height - 1))[(u + half_width) % half_width];
      };
      const int u = x / 2;
      const int v = y / 2;
      const int du = x % 2 == 0 ? -1 : 1;
      const int dv = y % 2 == 0 ? -1 : 1;
      values.row(y)[x] = 0.5625F * sample(u, v) +
                         0.1875F * (sample(u + du, v) + sample(u, v + dv)) +
                         0.0625F * sample(u + du, v + dv);
    }
  }
}

// Shifted minima along a row whose ends meet: the distance to the nearest zero grows by one a
// pixel, up to kMostClearance.
void SpreadAlongRow(float* row, int width, std::vector<float>& padded) {
  padded.resize(static_cast<std::size_t>(width) + 2 * 32);
  float* middle = padded.data() + 32;
  for (int shift = 1; shift <= 32; shift *= 2) {
    std::copy_n(row, width, middle);
    std::copy_n(row + width - shift, shift, middle - shift);
    std::copy_n(row, shift, middle + width);
    const float* left = middle - shift;
    const float* right = middle + shift;
    const float more = static_cast<float>(shift);
    for (int x = 0; x < width; ++x) {
      row[x] = std::min(row[x], std::min(left[x], right[x]) + more);
    }
  }
}

// Chamfer distance to the nearest zero of `clearance` (Borgefors 1986), columns wrapping round; at
// most kMostClearance.
void DistanceToNearestZero(Image<float>& clearance) {
  const int width = clearance.width();
  const int height = clearance.height();
  constexpr float kDiagonal = 1.4142F;
  std::vector<float> padded;
  std::vector<float> before(static_cast<std::size_t>(width) + 2);
  const auto step = [&](int y, int from) {
    float* row = clearance.row(y);
    if (from >= 0 && from < height) {
      const float* other = clearance.row(from);
      std::copy_n(other, width, before.data() + 1);
      before.front() = other[width - 1];
      before.back() = other[0];
      const float* at = before.data();
      for (int x = 0; x < width; ++x) {
        row[x] =
            std::min(row[x], std::min(at[x + 1] + 1.0F, std::min(at[x], at[x + 2]) + kDiagonal));
      }
    }
    SpreadAlongRow(row, width, padded);
  };
  for (int y = 0; y < height; ++y) step(y, y - 1);
  for (int y = height - 1; y >= 0; --y) step(y, y + 1);
}

// Natural logarithm of a positive normal number to 1e-7, in operations a compiler can do many at a
// time.
float Ln(float value) {
  const auto bits = std::bit_cast<std::int32_t>(value);
  const std::int32_t exponent = (bits - 0x3f3504f3) >> 23;  // mantissa in [√½, √2)
  const float mantissa = std::bit_cast<float>(bits - exponent * (1 << 23));
  const float s = (mantissa - 1.0F) / (mantissa + 1.0F);
  const float s2 = s * s;
  const float series = 2.0F * s * (1.0F + s2 * (1.0F / 3.0F + s2 * (0.2F + s2 * (1.0F / 7.0F))));
  return static_cast<float>(exponent) * 0.693147181F + series;
}

}  // namespace

Eigen::Vector3d FeatureImage::RayFromPixel(double x, double y) const {
  const double theta = std::numbers::pi - step_rad * x;
  const double ordinate = top_ordinate - step_rad * y;
  const double c = 1.0 / std::cosh(ordinate);
  return {c * std::cos(theta), c * std::sin(theta), std::tanh(ordinate)};
}

double FeatureImage::PixelAngle(double y) const {
  return step_rad / std::cosh(top_ordinate - step_rad * y);
}

FeatureImage MakeFeatureImage(const Measurement& measurement, int width) {
  const Projection& projection = measurement.projection;
  const Image<float>& radiance = measurement.radiance;
  const Image<std::uint8_t>& flags = measurement.flags;
  FeatureImage result;
  const int columns = std::min(width, radiance.width()) / kColumnMultiple * kColumnMultiple;
  if (columns < kSmallestWidth || radiance.height() < 2) return result;

  result.step_rad = 2.0 * std::numbers::pi / columns;
  result.top_ordinate = OrdinateLimit(projection, true);
  const double bottom = OrdinateLimit(projection, false);
  const int rows = static_cast<int>(std::floor((result.top_ordinate - bottom) / result.step_rad));
  if (rows < 16) return result;

  const int source_rows = radiance.height();
  const double ratio = static_cast<double>(radiance.width()) / columns;
  std::vector<Tap> column_taps;
  std::vector<std::size_t> first_tap{0};
  for (int x = 0; x < columns; ++x) {
    const auto taps = Footprint(x * ratio, (x + 1) * ratio, radiance.width(), true);
    column_taps.insert(column_taps.end(), taps.begin(), taps.end());
    first_tap.push_back(column_taps.size());
  }
  // Three sums a pixel of a row: grey, share that is not masked, share that is measured.
  const auto reduce_row = [&](int y, float* out) {
    const float* pixels = radiance.row(y);
    const std::uint8_t* why = flags.row(y);
    for (std::size_t x = 0; x < static_cast<std::size_t>(columns); ++x, out += 3) {
      float grey = 0.0F;
      float seen = 0.0F;
      float usable = 0.0F;
      for (std::size_t k = first_tap[x]; k < first_tap[x + 1]; ++k) {
        const Tap& tap = column_taps[k];
        const std::uint8_t flag = why[tap.index];
        if ((flag & (kMasked | kMover)) != 0) continue;
        const float* p = pixels + 4 * static_cast<std::ptrdiff_t>(tap.index);
        grey += tap.weight * (kGrey[0] * p[0] + kGrey[1] * p[1] + kGrey[2] * p[2]);
        seen += tap.weight;
        if ((flag & kSaturatedAny) == 0) usable += tap.weight;
      }
      out[0] = grey;
      out[1] = seen;
      out[2] = usable;
    }
  };

  result.softening = std::max(kSoftening * measurement.noise_floor, 1e-12F);
  result.log_radiance = Image<float>(columns, rows);
  result.clearance = Image<float>(columns, rows);
  Image<float> seen(columns, rows);
  const float far = static_cast<float>(kMostClearance);
  ParallelFor(rows, 64, [&](int begin, int end) {
    const auto values = static_cast<std::size_t>(columns) * 3;
    std::vector<float> sums(values);
    // Rows reduced lately: the next output row needs some of them again.
    std::vector<std::pair<int, std::vector<float>>> reduced;
    for (int y = begin; y < end; ++y) {
      const double top = RowOfOrdinate(projection, result.top_ordinate - result.step_rad * y);
      const double low = RowOfOrdinate(projection, result.top_ordinate - result.step_rad * (y + 1));
      const std::vector<Tap> taps = Footprint(top, low, source_rows, false);
      std::fill(sums.begin(), sums.end(), 0.0F);
      for (const Tap& tap : taps) {
        auto row = std::find_if(reduced.begin(), reduced.end(),
                                [&](const auto& r) { return r.first == tap.index; });
        if (row == reduced.end()) {
          // Rows come in ascending order: one before this output row's first is not needed again.
          row = std::find_if(reduced.begin(), reduced.end(),
                             [&](const auto& r) { return r.first < taps.front().index; });
          if (row == reduced.end()) row = reduced.insert(row, {0, std::vector<float>(values)});
          row->first = tap.index;
          reduce_row(tap.index, row->second.data());
        }
        const float* in = row->second.data();
        for (std::size_t i = 0; i < values; ++i) sums[i] += tap.weight * in[i];
      }
      float* out = result.log_radiance.row(y);
      for (int x = 0; x < columns; ++x) {
        const float* sum = sums.data() + 3 * static_cast<std::ptrdiff_t>(x);
        const bool any = sum[1] > 0.0F;
        out[x] = any ? std::max(0.0F, sum[0] / sum[1]) + result.softening : 1.0F;
        seen.row(y)[x] = any ? 1.0F : 0.0F;
        result.clearance.row(y)[x] = sum[2] >= kUsableShare ? far : 0.0F;
      }
      for (int x = 0; x < columns; ++x) out[x] = Ln(out[x]);
    }
  });
  const auto clear = result.clearance.values();
  if (std::find(clear.begin(), clear.end(), far) == clear.end()) return FeatureImage{};
  FillFromSurroundings(result.log_radiance, seen);
  DistanceToNearestZero(result.clearance);

  // Noise of a feature pixel: channels and the pixels under it are independent.
  const double pixels_under = std::max(1.0, ratio * ratio);
  for (int c = 0; c < 3; ++c) {
    const float share = kGrey[c] * kGrey[c] / static_cast<float>(pixels_under);
    const auto channel = static_cast<std::size_t>(c);
    result.variance_floor += share * measurement.variance_floor[channel];
    result.variance_slope += share * measurement.variance_per_radiance[channel];
  }
  return result;
}

}  // namespace omnihdr
