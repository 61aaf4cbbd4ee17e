#include "core/sphere/sphere_remap.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <optional>
#include <type_traits>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr int kMaxSupersampling = 8;
constexpr int kRowGrain = 8;
constexpr float kUnit = 1.0F / 65536.0F;

// Solid angle of a pixel around a face point to within a few per cent (RD-map: 30 %): it only
// decides how many samples a target pixel takes.
double RoughSolidAngle(const SphereGrid& grid, const FacePoint& point) {
  constexpr double kPi = std::numbers::pi;
  const double width = grid.face_width();
  const double height = grid.face_height();
  switch (grid.kind()) {
    case SphereGridKind::kEquirectangular:
      return 2.0 * kPi * kPi / (width * height) * std::sin(kPi * point.y / height);
    case SphereGridKind::kCylindrical: {
      const double step = (grid.z_max() - grid.z_min()) / height;
      const double z = grid.z_max() - step * point.y;
      return 2.0 * kPi / width * step / std::pow(1.0 + z * z, 1.5);
    }
    case SphereGridKind::kCubeCross:
    case SphereGridKind::kCubeStrip: {
      const double u = 2.0 * point.x / width - 1.0;
      const double v = 2.0 * point.y / height - 1.0;
      return 4.0 / (width * height) / std::pow(1.0 + u * u + v * v, 1.5);
    }
    case SphereGridKind::kRhombicDodecahedron:
      return kPi / (3.0 * width * height);
  }
  return 1.0;
}

template <typename T, int kChannels>
OMNIHDR_ALWAYS_INLINE void BilinearRow(const T* source, const std::uint32_t* base,
                                       const std::uint32_t* fraction, int count, std::size_t right,
                                       std::size_t below, T* out) {
  for (int x = 0; x < count; ++x) {
    const T* p = source + static_cast<std::size_t>(base[x]) * kChannels;
    if constexpr (std::is_same_v<T, float>) {
      const float ax = static_cast<float>(fraction[x] >> 16U) * kUnit;
      const float ay = static_cast<float>(fraction[x] & 0xFFFFU) * kUnit;
      for (int c = 0; c < kChannels; ++c) {
        const float* q = p + c;
        const float upper = q[0] + ax * (q[right] - q[0]);
        const float lower = q[below] + ax * (q[below + right] - q[below]);
        out[x * kChannels + c] = upper + ay * (lower - upper);
      }
    } else {
      // 8 bits of fraction a direction: 16 in the product, which 16-bit values just leave room for.
      const std::uint32_t ax = ((fraction[x] >> 16U) + 128U) >> 8U;
      const std::uint32_t ay = ((fraction[x] & 0xFFFFU) + 128U) >> 8U;
      for (int c = 0; c < kChannels; ++c) {
        const T* q = p + c;
        const std::uint32_t upper = q[0] * (256U - ax) + q[right] * ax;
        const std::uint32_t lower = q[below] * (256U - ax) + q[below + right] * ax;
        out[x * kChannels + c] = static_cast<T>((upper * (256U - ay) + lower * ay + 32768U) >> 16U);
      }
    }
  }
}

// Three channels of a pixel in one register. A load takes up to three source pixels from the left
// one on, a store four values: the tables keep the first inside the picture, and a row's last pixel
// is not made this way.
template <typename T, std::size_t kBytes>
using Vector [[gnu::vector_size(kBytes)]] = T;

template <typename V, typename T>
OMNIHDR_ALWAYS_INLINE V Load(const T* from) {
  V v;
  std::memcpy(&v, from, sizeof(V));
  return v;
}

OMNIHDR_ALWAYS_INLINE void ColourRow(const float* source, const std::uint32_t* base,
                                     const std::uint32_t* fraction, int count, std::size_t below,
                                     float* out) {
  using Pixel = Vector<float, 16>;
  for (int x = 0; x + 1 < count; ++x) {
    const float* p = source + static_cast<std::size_t>(base[x]) * 3;
    const float ax = static_cast<float>(fraction[x] >> 16U) * kUnit;
    const float ay = static_cast<float>(fraction[x] & 0xFFFFU) * kUnit;
    const auto left = Load<Pixel>(p);
    const auto left_below = Load<Pixel>(p + below);
    const Pixel upper = left + ax * (Load<Pixel>(p + 3) - left);
    const Pixel lower = left_below + ax * (Load<Pixel>(p + below + 3) - left_below);
    const Pixel value = upper + ay * (lower - upper);
    std::memcpy(out + static_cast<std::ptrdiff_t>(x) * 3, &value, sizeof(value));
  }
}

OMNIHDR_ALWAYS_INLINE void ColourRow(const std::uint8_t* source, const std::uint32_t* base,
                                     const std::uint32_t* fraction, int count, std::size_t below,
                                     std::uint8_t* out) {
  using Bytes = Vector<std::uint8_t, 8>;
  using Words = Vector<std::uint16_t, 16>;
  using Numbers = Vector<std::uint32_t, 16>;
  using NumberBytes = Vector<std::uint8_t, 16>;
  for (int x = 0; x + 1 < count; ++x) {
    const std::uint8_t* p = source + static_cast<std::size_t>(base[x]) * 3;
    const std::uint32_t ax = ((fraction[x] >> 16U) + 128U) >> 8U;
    const auto ay = static_cast<std::uint16_t>(((fraction[x] & 0xFFFFU) + 128U) >> 8U);
    const auto above = __builtin_convertvector(Load<Bytes>(p), Words);
    const auto under = __builtin_convertvector(Load<Bytes>(p + below), Words);
    // At most 255 * 256.
    const Words both = above * static_cast<std::uint16_t>(256 - ay) + under * ay;
    // Left and right of each channel in one 32-bit number.
    const Words pairs = __builtin_shufflevector(both, both, 0, 3, 1, 4, 2, 5, 6, 7);
    const auto numbers = std::bit_cast<Numbers>(pairs);
    const Numbers value =
        ((numbers & 0xFFFFU) * (256U - ax) + (numbers >> 16U) * ax + 32768U) >> 16U;
    const auto bytes = std::bit_cast<NumberBytes>(value);
    const NumberBytes packed =
        __builtin_shufflevector(bytes, bytes, 0, 4, 8, 12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0);
    const auto codes = std::bit_cast<std::array<std::uint32_t, 4>>(packed)[0];
    std::memcpy(out + static_cast<std::ptrdiff_t>(x) * 3, &codes, sizeof(codes));
  }
}

template <typename T>
OMNIHDR_ALWAYS_INLINE void BilinearRowOf(int channels, const T* source, const std::uint32_t* base,
                                         const std::uint32_t* fraction, int count,
                                         std::size_t right, std::size_t below, T* out) {
  switch (channels) {
    case 1:
      return BilinearRow<T, 1>(source, base, fraction, count, right, below, out);
    case 2:
      return BilinearRow<T, 2>(source, base, fraction, count, right, below, out);
    case 3:
      if constexpr (sizeof(T) != 2) {
        if (below >= 9) {
          ColourRow(source, base, fraction, count, below, out);
          const int last = count - 1;
          return BilinearRow<T, 3>(source, base + last, fraction + last, 1, right, below,
                                   out + static_cast<std::ptrdiff_t>(last) * 3);
        }
      }
      return BilinearRow<T, 3>(source, base, fraction, count, right, below, out);
    default:
      return BilinearRow<T, 4>(source, base, fraction, count, right, below, out);
  }
}

OMNIHDR_SIMD_CLONES
void Bilinear(int channels, const float* source, const std::uint32_t* base,
              const std::uint32_t* fraction, int count, std::size_t right, std::size_t below,
              float* out) {
  BilinearRowOf(channels, source, base, fraction, count, right, below, out);
}

OMNIHDR_SIMD_CLONES
void Bilinear(int channels, const std::uint8_t* source, const std::uint32_t* base,
              const std::uint32_t* fraction, int count, std::size_t right, std::size_t below,
              std::uint8_t* out) {
  BilinearRowOf(channels, source, base, fraction, count, right, below, out);
}

OMNIHDR_SIMD_CLONES
void Bilinear(int channels, const std::uint16_t* source, const std::uint32_t* base,
              const std::uint32_t* fraction, int count, std::size_t right, std::size_t below,
              std::uint16_t* out) {
  BilinearRowOf(channels, source, base, fraction, count, right, below, out);
}

OMNIHDR_SIMD_CLONES
bool HasNan(const float* values, std::size_t count) {
  int found = 0;
  for (std::size_t i = 0; i < count; ++i) found |= values[i] != values[i] ? 1 : 0;
  return found != 0;
}

// Weighted mean of what there is, if it has half of the weight.
template <typename T>
class Mean {
 public:
  void Add(T value, float weight) {
    if constexpr (std::is_same_v<T, float>) {
      if (std::isnan(value) || weight <= 0.0F) return;
    }
    sum_ += weight * static_cast<float>(value);
    weight_ += weight;
  }
  T Value() const {
    // Half of the weight, less what rounding may take from it.
    const bool enough = weight_ >= 0.4999F;
    if constexpr (std::is_same_v<T, float>) {
      return enough ? sum_ / weight_ : std::numeric_limits<float>::quiet_NaN();
    } else {
      return enough ? static_cast<T>(sum_ / weight_ + 0.5F) : T{0};
    }
  }

 private:
  float sum_ = 0.0F;
  float weight_ = 0.0F;
};

constexpr std::uint32_t kNowhere = 0xFFFFFFFFU;

}  // namespace

struct SphereRemap::RowTable {
  std::vector<Gathered> gathered;  // first_tap counts from this row's first
  std::vector<Tap> taps;
};

namespace {

// The source pixels and weights of a bilinear sample anywhere, seams included.
template <typename Tap>
class TapCollector {
 public:
  explicit TapCollector(const SphereGrid& grid) : grid_(&grid) {}

  void Add(const FacePoint& point, double weight) { AddSample(point, weight, false); }
  // What was added since the last call: each pixel once, in order of pixels.
  void MoveTo(std::vector<Tap>* taps) {
    std::sort(taps_.begin(), taps_.end(),
              [](const Tap& a, const Tap& b) { return a.pixel < b.pixel; });
    std::size_t first = taps->size();
    for (const Tap& tap : taps_) {
      if (taps->size() > first && taps->back().pixel == tap.pixel) {
        taps->back().weight += tap.weight;
      } else {
        taps->push_back(tap);
      }
    }
    taps_.clear();
  }

 private:
  // `inside`: beyond the border, the border's own pixels stand in (their centres are half a pixel
  // away at most).
  void AddSample(const FacePoint& point, double weight, bool inside) {
    const double fx = std::floor(point.x - 0.5);
    const double fy = std::floor(point.y - 0.5);
    const double ax = point.x - 0.5 - fx;
    const double ay = point.y - 0.5 - fy;
    const int x = static_cast<int>(fx);
    const int y = static_cast<int>(fy);
    AddCorner(point.face, x, y, weight * (1.0 - ax) * (1.0 - ay), inside);
    AddCorner(point.face, x + 1, y, weight * ax * (1.0 - ay), inside);
    AddCorner(point.face, x, y + 1, weight * (1.0 - ax) * ay, inside);
    AddCorner(point.face, x + 1, y + 1, weight * ax * ay, inside);
  }

  void AddCorner(int face, int x, int y, double weight, bool inside) {
    if (weight <= 0.0) return;
    const int width = grid_->face_width();
    const int height = grid_->face_height();
    const bool is_outside = x < 0 || y < 0 || x >= width || y >= height;
    if (grid_->faces() == 1) {
      const bool is_over_pole = y < 0 || y >= height;
      const bool is_lat_long = grid_->kind() == SphereGridKind::kEquirectangular;
      if (is_over_pole && is_lat_long) x += width / 2;
      x = (x % width + width) % width;
      y = std::clamp(y, 0, height - 1);
    } else if (is_outside && !inside) {
      const FacePoint beyond = {face, x + 0.5, y + 0.5};
      const std::optional<FacePoint> there = grid_->FaceFromRay(grid_->RayFromFace(beyond));
      if (there) AddSample(*there, weight, true);
      return;
    }
    const GridPixel origin = grid_->FaceOrigin(face);
    const int column = origin.x + std::clamp(x, 0, width - 1);
    const int row = origin.y + std::clamp(y, 0, height - 1);
    const auto pixel =
        static_cast<std::uint32_t>(row) * static_cast<std::uint32_t>(grid_->width()) +
        static_cast<std::uint32_t>(column);
    taps_.push_back({pixel, static_cast<float>(weight)});
  }

  const SphereGrid* grid_;
  std::vector<Tap> taps_;
};

}  // namespace

SphereRemap::SphereRemap(const SphereGrid& target, const SphereGrid& source,
                         const SphereRemapOptions& options,
                         const Eigen::Matrix3d& source_from_target)
    : target_(target), source_(source) {
  assert(target.width() > 0 && target.height() > 0 && source.width() > 0 && source.height() > 0);
  first_row_ = std::clamp(options.first_row, 0, target.height());
  rows_ = target.height() - first_row_;
  if (options.rows >= 0) rows_ = std::min(rows_, options.rows);
  const std::size_t pixels =
      static_cast<std::size_t>(rows_) * static_cast<std::size_t>(target.width());
  base_.resize(pixels);
  fraction_.resize(pixels);
  std::vector<RowTable> tables(static_cast<std::size_t>(rows_));
  ParallelFor(rows_, kRowGrain, [&](int begin, int end) {
    for (int row = begin; row < end; ++row) {
      tables[static_cast<std::size_t>(row)] = BuildRow(row, source_from_target, options.area);
    }
  });
  std::size_t gathered = 0;
  std::size_t taps = 0;
  for (const RowTable& table : tables) {
    gathered += table.gathered.size();
    taps += table.taps.size();
  }
  gathered_.reserve(gathered + 1);
  taps_.reserve(taps);
  for (RowTable& table : tables) {
    first_gathered_.push_back(gathered_.size());
    for (const Gathered& pixel : table.gathered) {
      gathered_.push_back({pixel.x, pixel.nearest, pixel.first_tap + taps_.size()});
    }
    taps_.insert(taps_.end(), table.taps.begin(), table.taps.end());
    table = {};
  }
  first_gathered_.push_back(gathered_.size());
  gathered_.push_back({0, kNowhere, taps_.size()});
}

SphereRemap::RowTable SphereRemap::BuildRow(int row, const Eigen::Matrix3d& source_from_target,
                                            bool area) {
  RowTable table;
  TapCollector<Tap> collector(source_);
  const int y = first_row_ + row;
  const int width = target_.width();
  const std::size_t start = static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
  for (int x = 0; x < width; ++x) {
    const std::size_t i = start + static_cast<std::size_t>(x);
    const std::optional<int> face = target_.FaceOfPixel(x, y);
    std::optional<FacePoint> hit;
    FacePoint centre;
    if (face) {
      const GridPixel origin = target_.FaceOrigin(*face);
      centre = {*face, x - origin.x + 0.5, y - origin.y + 0.5};
      hit = source_.FaceFromRay(source_from_target * target_.RayFromFace(centre));
    }
    if (!hit) {
      table.gathered.push_back({x, kNowhere, table.taps.size()});
      continue;
    }
    int samples = 1;
    if (area) {
      const double ratio = RoughSolidAngle(target_, centre) / RoughSolidAngle(source_, *hit);
      samples = static_cast<int>(
          std::clamp(std::sqrt(ratio) + 0.5, 1.0, static_cast<double>(kMaxSupersampling)));
    }
    const GridPixel origin = source_.FaceOrigin(hit->face);
    const double left = std::floor(hit->x - 0.5);
    const double top = std::floor(hit->y - 0.5);
    // The vector code's loads may take one pixel more to the right, which the last row's end lacks.
    const bool is_end =
        origin.y + top + 2.0 >= source_.height() && origin.x + left + 3.0 > source_.width();
    const bool is_inner = left >= 0.0 && top >= 0.0 && left + 2.0 <= source_.face_width() &&
                          top + 2.0 <= source_.face_height() && !is_end;
    if (samples == 1 && is_inner) {
      const auto fraction = [](double f) {
        return std::min(static_cast<std::uint32_t>(std::lround(f * 65536.0)), 65535U);
      };
      base_[i] = static_cast<std::uint32_t>(origin.y + static_cast<int>(top)) *
                     static_cast<std::uint32_t>(source_.width()) +
                 static_cast<std::uint32_t>(origin.x + static_cast<int>(left));
      fraction_[i] = fraction(hit->x - 0.5 - left) << 16U | fraction(hit->y - 0.5 - top);
      continue;
    }
    const int nearest_x = std::min(static_cast<int>(hit->x), source_.face_width() - 1);
    const int nearest_y = std::min(static_cast<int>(hit->y), source_.face_height() - 1);
    table.gathered.push_back({x,
                              static_cast<std::uint32_t>(origin.y + nearest_y) *
                                      static_cast<std::uint32_t>(source_.width()) +
                                  static_cast<std::uint32_t>(origin.x + nearest_x),
                              table.taps.size()});
    const double weight = 1.0 / (samples * samples);
    for (int v = 0; v < samples; ++v) {
      for (int u = 0; u < samples; ++u) {
        const FacePoint at = {centre.face, centre.x - 0.5 + (u + 0.5) / samples,
                              centre.y - 0.5 + (v + 0.5) / samples};
        const auto point = source_.FaceFromRay(source_from_target * target_.RayFromFace(at));
        if (point) collector.Add(*point, weight);
      }
    }
    collector.MoveTo(&table.taps);
  }
  return table;
}

template <typename T>
void SphereRemap::ApplyTo(ImageView<const T> source, ImageView<T> target) const {
  const int channels = source.channels();
  assert(source.width() == source_.width() && source.height() == source_.height());
  assert(target.width() == target_.width() && target.height() == target_.height());
  assert(target.channels() == channels && channels >= 1 && channels <= 4);
  assert(source.stride() == static_cast<std::ptrdiff_t>(source.width()) * channels);
  const auto n = static_cast<std::size_t>(channels);
  const std::size_t right = source.width() > 1 ? n : 0;
  const std::size_t below = source.height() > 1 ? n * static_cast<std::size_t>(source.width()) : 0;
  const T* pixels = source.row(0);
  ParallelFor(rows_, kRowGrain, [&](int begin, int end) {
    for (int row = begin; row < end; ++row) {
      T* out = target.row(first_row_ + row);
      const std::size_t start =
          static_cast<std::size_t>(row) * static_cast<std::size_t>(target_.width());
      Bilinear(channels, pixels, &base_[start], &fraction_[start], target_.width(), right, below,
               out);
      if constexpr (std::is_same_v<T, float>) {
        const std::size_t values = n * static_cast<std::size_t>(target_.width());
        if (HasNan(out, values)) {
          for (std::size_t i = 0; i < values; ++i) {
            if (!std::isnan(out[i])) continue;
            const float* p = pixels + base_[start + i / n] * n + i % n;
            const float ax = static_cast<float>(fraction_[start + i / n] >> 16U) * kUnit;
            const float ay = static_cast<float>(fraction_[start + i / n] & 0xFFFFU) * kUnit;
            Mean<float> mean;
            mean.Add(p[0], (1.0F - ax) * (1.0F - ay));
            mean.Add(p[right], ax * (1.0F - ay));
            mean.Add(p[below], (1.0F - ax) * ay);
            mean.Add(p[below + right], ax * ay);
            out[i] = mean.Value();
          }
        }
      }
      for (std::size_t k = first_gathered_[static_cast<std::size_t>(row)];
           k < first_gathered_[static_cast<std::size_t>(row) + 1]; ++k) {
        T* pixel = out + static_cast<std::ptrdiff_t>(gathered_[k].x) * channels;
        for (std::size_t c = 0; c < n; ++c) {
          Mean<T> mean;
          for (std::size_t t = gathered_[k].first_tap; t < gathered_[k + 1].first_tap; ++t) {
            mean.Add(pixels[taps_[t].pixel * n + c], taps_[t].weight);
          }
          pixel[c] = mean.Value();
        }
      }
    }
  });
}

template <typename T>
void SphereRemap::ApplyNearestTo(ImageView<const T> source, ImageView<T> target) const {
  const int channels = source.channels();
  assert(source.width() == source_.width() && source.height() == source_.height());
  assert(target.width() == target_.width() && target.height() == target_.height());
  assert(target.channels() == channels);
  assert(source.stride() == static_cast<std::ptrdiff_t>(source.width()) * channels);
  const auto n = static_cast<std::size_t>(channels);
  const auto width = static_cast<std::uint32_t>(source.width());
  ParallelFor(rows_, kRowGrain, [&](int begin, int end) {
    for (int row = begin; row < end; ++row) {
      T* out = target.row(first_row_ + row);
      const std::size_t start =
          static_cast<std::size_t>(row) * static_cast<std::size_t>(target_.width());
      for (std::size_t x = 0; x < static_cast<std::size_t>(target_.width()); ++x) {
        const std::uint32_t fraction = fraction_[start + x];
        const std::uint32_t nearest =
            base_[start + x] + (fraction >> 31U) + (fraction >> 15U & 1U) * width;
        std::copy_n(source.row(0) + nearest * n, n, out + x * n);
      }
      for (std::size_t k = first_gathered_[static_cast<std::size_t>(row)];
           k < first_gathered_[static_cast<std::size_t>(row) + 1]; ++k) {
        T* pixel = out + static_cast<std::ptrdiff_t>(gathered_[k].x) * channels;
        if (gathered_[k].nearest == kNowhere) {
          std::fill_n(pixel, n,
                      std::is_same_v<T, float> ? std::numeric_limits<T>::quiet_NaN() : T{0});
        } else {
          std::copy_n(source.row(0) + gathered_[k].nearest * n, n, pixel);
        }
      }
    }
  });
}

void SphereRemap::Apply(ImageView<const float> source, ImageView<float> target) const {
  ApplyTo(source, target);
}
void SphereRemap::Apply(ImageView<const std::uint8_t> source,
                        ImageView<std::uint8_t> target) const {
  ApplyTo(source, target);
}
void SphereRemap::Apply(ImageView<const std::uint16_t> source,
                        ImageView<std::uint16_t> target) const {
  ApplyTo(source, target);
}
void SphereRemap::ApplyNearest(ImageView<const float> source, ImageView<float> target) const {
  ApplyNearestTo(source, target);
}
void SphereRemap::ApplyNearest(ImageView<const std::uint8_t> source,
                               ImageView<std::uint8_t> target) const {
  ApplyNearestTo(source, target);
}

std::size_t SphereRemap::Bytes() const {
  return base_.size() * sizeof(base_[0]) + fraction_.size() * sizeof(fraction_[0]) +
         gathered_.size() * sizeof(gathered_[0]) + taps_.size() * sizeof(taps_[0]) +
         first_gathered_.size() * sizeof(first_gathered_[0]);
}

}  // namespace omnihdr
