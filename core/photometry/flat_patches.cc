#include "core/photometry/flat_patches.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

constexpr int kLargestLevel = 1600;
constexpr int kSmallestLevel = 150;
constexpr int kLeastArea = 12;
constexpr std::size_t kMostPatches = 4000;
// Contrast of neighbours two pixels apart, on the scale of Compressed(); about 6 % to 50 % of
// light.
constexpr std::array<float, 4> kThresholds = {0.015F, 0.03F, 0.06F, 0.12F};

Image<float> Reduce(ImageView<const float> picture, int factor) {
  const int channels = picture.channels();
  Image<float> small(picture.width() / factor, picture.height() / factor, channels);
  const float scale = 1.0F / static_cast<float>(factor * factor);
  ParallelFor(small.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      float* out = small.row(y);
      for (int dy = 0; dy < factor; ++dy) {
        const float* in = picture.row(y * factor + dy);
        for (int x = 0; x < small.width(); ++x) {
          for (int dx = 0; dx < factor; ++dx) {
            for (int c = 0; c < channels; ++c) {
              out[x * channels + c] += in[(x * factor + dx) * channels + c];
            }
          }
        }
      }
      for (int i = 0; i < small.width() * channels; ++i) out[i] *= scale;
    }
  });
  return small;
}

Image<float> ColourTiles(const SensorPicture& picture) {
  Image<float> rgb(picture.width() / 2, picture.height() / 2, 3);
  for (int y = 0; y < 2 * rgb.height(); ++y) {
    for (int x = 0; x < 2 * rgb.width(); ++x) {
      const int c = BayerChannel(picture.bayer, x, y);
      rgb.at(x / 2, y / 2, c) += (c == 1 ? 0.5F : 1.0F) * picture.values.at(x, y);
    }
  }
  return rgb;
}

// Logarithmic above a floor that lies well under the picture's bright parts, in [0, 1].
Image<float> Compressed(const Image<float>& linear) {
  std::vector<float> sample;
  const std::size_t stride = std::max<std::size_t>(1, linear.size() / 65536);
  for (std::size_t i = 0; i < linear.size(); i += stride) sample.push_back(linear.values()[i]);
  const auto rank = sample.begin() + static_cast<std::ptrdiff_t>(sample.size() * 99 / 100);
  std::nth_element(sample.begin(), rank, sample.end());
  const float white = std::max(*rank, 1.0F);
  constexpr float kFloor = 0.03F;
  const float range = 1.0F / std::log(1.0F + 1.0F / kFloor);
  Image<float> out(linear.width(), linear.height(), linear.channels());
  ParallelFor(linear.height(), 32, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const float* in = linear.row(y);
      float* to = out.row(y);
      for (int i = 0; i < linear.width() * linear.channels(); ++i) {
        to[i] = range * std::log(1.0F + std::max(in[i], 0.0F) / (kFloor * white));
      }
    }
  });
  return out;
}

// Largest difference over all channels between the neighbours left and right, above and below.
Image<float> LocalContrast(const Image<float>& p) {
  Image<float> contrast(p.width(), p.height(), 1, 1.0F);
  const int channels = p.channels();
  ParallelFor(p.height() - 2, 32, [&](int begin, int end) {
    for (int y = begin + 1; y < end + 1; ++y) {
      const float* above = p.row(y - 1);
      const float* here = p.row(y);
      const float* below = p.row(y + 1);
      float* out = contrast.row(y);
      for (int x = 1; x + 1 < p.width(); ++x) {
        float largest = 0.0F;
        for (int c = 0; c < channels; ++c) {
          const float dx = here[(x + 1) * channels + c] - here[(x - 1) * channels + c];
          const float dy = below[x * channels + c] - above[x * channels + c];
          largest = std::max({largest, std::abs(dx), std::abs(dy)});
        }
        out[x] = largest;
      }
    }
  });
  return contrast;
}

struct Moments {
  double n = 0.0;
  double x = 0.0;
  double y = 0.0;
  double xx = 0.0;
  double xy = 0.0;
  double yy = 0.0;
};

// Second moments tell a parallelogram: its area is 12·√det of the covariance; what is ragged or has
// holes has less, an ellipse 5 % more.
std::optional<FlatPatch> PatchOf(const Moments& m, double largest_area, int factor) {
  if (m.n < kLeastArea || m.n > largest_area) return std::nullopt;
  const Eigen::Vector2d centre(m.x / m.n, m.y / m.n);
  Eigen::Matrix2d covariance;
  covariance(0, 0) = m.xx / m.n - centre.x() * centre.x() + 1.0 / 12.0;
  covariance(1, 1) = m.yy / m.n - centre.y() * centre.y() + 1.0 / 12.0;
  covariance(0, 1) = covariance(1, 0) = m.xy / m.n - centre.x() * centre.y();
  const double determinant = covariance.determinant();
  if (!(determinant > 0.0)) return std::nullopt;
  const double fullness = m.n / (12.0 * std::sqrt(determinant));
  if (fullness < 0.80 || fullness > 1.10) return std::nullopt;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(covariance);
  Eigen::Vector2d sides = (12.0 * axes.eigenvalues()).cwiseSqrt();
  if (sides[1] > 3.5 * sides[0]) return std::nullopt;
  // The contrast at an edge takes one pixel and a half from each side.
  sides = sides.array() + 3.0;
  FlatPatch patch;
  patch.centre = factor * (centre + Eigen::Vector2d::Constant(0.5));
  patch.covariance = factor * factor / 12.0 * axes.eigenvectors() * sides.cwiseAbs2().asDiagonal() *
                     axes.eigenvectors().transpose();
  patch.area = factor * factor * sides[0] * sides[1];
  return patch;
}

// Four-connected areas of contrast below the threshold.
void AddPatches(const Image<float>& contrast, float threshold, int factor,
                std::vector<FlatPatch>* patches) {
  const int width = contrast.width();
  const int height = contrast.height();
  std::vector<std::int32_t> label(
      static_cast<std::size_t>(width) * static_cast<std::size_t>(height), -1);
  std::vector<std::int32_t> parent;
  const auto root = [&parent](std::int32_t i) {
    while (parent[static_cast<std::size_t>(i)] != i) {
      std::int32_t& up = parent[static_cast<std::size_t>(i)];
      up = parent[static_cast<std::size_t>(up)];
      i = up;
    }
    return i;
  };
  for (int y = 0; y < height; ++y) {
    const float* row = contrast.row(y);
    const std::size_t start = static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
    for (int x = 0; x < width; ++x) {
      if (row[x] >= threshold) continue;
      const std::size_t at = start + static_cast<std::size_t>(x);
      const std::int32_t left = x > 0 ? label[at - 1] : -1;
      const std::int32_t up = y > 0 ? label[at - static_cast<std::size_t>(width)] : -1;
      if (left < 0 && up < 0) {
        label[at] = static_cast<std::int32_t>(parent.size());
        parent.push_back(label[at]);
      } else if (left >= 0 && up >= 0) {
        const std::int32_t a = root(left);
        const std::int32_t b = root(up);
        label[at] = std::min(a, b);
        parent[static_cast<std::size_t>(std::max(a, b))] = label[at];
      } else {
        label[at] = std::max(left, up);
      }
    }
  }
  std::vector<Moments> moments(parent.size());
  for (int y = 0; y < height; ++y) {
    const std::size_t start = static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
    for (int x = 0; x < width; ++x) {
      const std::int32_t l = label[start + static_cast<std::size_t>(x)];
      if (l < 0) continue;
      Moments& m = moments[static_cast<std::size_t>(root(l))];
      m.n += 1.0;
      m.x += x;
      m.y += y;
      m.xx += static_cast<double>(x) * x;
      m.xy += static_cast<double>(x) * y;
      m.yy += static_cast<double>(y) * y;
    }
  }
  const double largest_area = static_cast<double>(width) * height / 20.0;
  for (const Moments& m : moments) {
    const std::optional<FlatPatch> patch = PatchOf(m, largest_area, factor);
    if (patch) patches->push_back(*patch);
  }
}

}  // namespace

std::vector<PatchLevel> MakePatchLevels(const SensorPicture& picture) {
  std::vector<PatchLevel> levels;
  PatchLevel level;
  Image<float> tiles;
  ImageView<const float> source = picture.values.view();
  if (picture.values.channels() == 1 && picture.bayer != BayerOrder::kNone) {
    tiles = ColourTiles(picture);
    source = tiles.view();
    level.factor = 2;
  }
  const int largest = std::max(source.width(), source.height());
  const int shrink = std::max(1, (largest + kLargestLevel - 1) / kLargestLevel);
  level.factor *= shrink;
  level.linear = Reduce(source, shrink);
  while (std::min(level.linear.width(), level.linear.height()) >= 8) {
    Image<float> next = Reduce(level.linear.view(), 2);
    const int factor = level.factor;
    levels.push_back(std::move(level));
    level = PatchLevel{2 * factor, std::move(next)};
    if (std::max(level.linear.width(), level.linear.height()) < kSmallestLevel) break;
  }
  return levels;
}

std::vector<FlatPatch> FindFlatPatches(const PatchLevel& level) {
  const Image<float> contrast = LocalContrast(Compressed(level.linear));
  std::vector<FlatPatch> all;
  for (const float threshold : kThresholds) AddPatches(contrast, threshold, level.factor, &all);
  // The same place at several thresholds: the largest is closest to the true outline.
  std::stable_sort(all.begin(), all.end(),
                   [](const FlatPatch& a, const FlatPatch& b) { return a.area > b.area; });
  std::vector<FlatPatch> kept;
  for (const FlatPatch& patch : all) {
    const bool known = std::any_of(kept.begin(), kept.end(), [&patch](const FlatPatch& other) {
      return other.area < 4.0 * patch.area &&
             (other.centre - patch.centre).squaredNorm() < 0.06 * patch.area;
    });
    if (!known) kept.push_back(patch);
    if (kept.size() == kMostPatches) break;
  }
  return kept;
}

}  // namespace omnihdr
