#include "core/pose/features.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>

#include "core/base/parallel_for.h"
#include "core/pose/feature_kernels.h"

namespace omnihdr {
namespace {

constexpr double kBaseSigma = 1.2;   // of the first level of an octave, in its pixels
constexpr double kInputSigma = 0.5;  // blur a sampled picture has anyway
constexpr int kMinOctaveWidth = 64;
constexpr int kMinOctaveHeight = 16;
constexpr int kBorder = 3;
// Of the fitted extremum from its pixel; a little over half, or one between two pixels would be
// nobody's.
constexpr float kMaxStep = 0.6F;
constexpr int kCellRows = 16;     // equal steps of sin(latitude)
constexpr int kCellColumns = 32;  // times these: cells of equal solid angle
constexpr int kBlocks = 4;        // of the descriptor, each way
constexpr int kBins = 8;
constexpr int kPatch = 16;  // gradient samples each way
constexpr float kBlockSigmas = 3.0F;
constexpr float kTwoPi = 2.0F * std::numbers::pi_v<float>;

// Level l of an octave has sigma kBaseSigma · 2^(l/3).
double SigmaOfLevel(double level) { return kBaseSigma * std::exp2(level / 3.0); }

// Angle in [0, 2π) to 1e-4 rad, the same on every machine (polynomial of Hastings' kind).
float FastAngle(float y, float x) {
  const float ax = std::fabs(x);
  const float ay = std::fabs(y);
  const float larger = std::max(ax, ay);
  if (larger == 0.0F) return 0.0F;
  const float r = std::min(ax, ay) / larger;
  const float r2 = r * r;
  float angle = ((-0.0464964749F * r2 + 0.15931422F) * r2 - 0.327622764F) * r2 * r + r;
  if (ay > ax) angle = 0.5F * std::numbers::pi_v<float> - angle;
  if (x < 0.0F) angle = std::numbers::pi_v<float> - angle;
  return y < 0.0F ? kTwoPi - angle : angle;
}

struct PatchWeights {
  std::array<float, kPatch * kPatch> gaussian;
  std::array<int, kPatch> block;    // lower of the two blocks a sample adds to, from 0 (outside)
  std::array<float, kPatch> upper;  // share of the upper one
  PatchWeights() {
    for (int i = 0; i < kPatch; ++i) {
      const float at = (static_cast<float>(i) + 0.5F) * kBlocks / kPatch - 0.5F;  // in blocks
      const float lower = std::floor(at);
      block[static_cast<std::size_t>(i)] = static_cast<int>(lower) + 1;
      upper[static_cast<std::size_t>(i)] = at - lower;
      for (int j = 0; j < kPatch; ++j) {
        const float u = (static_cast<float>(i) + 0.5F) / kPatch * 2.0F - 1.0F;
        const float v = (static_cast<float>(j) + 0.5F) / kPatch * 2.0F - 1.0F;
        gaussian[static_cast<std::size_t>(j * kPatch + i)] = std::exp(-0.5F * (u * u + v * v));
      }
    }
  }
};

void Prepare(Image<float>& image, int width, int height) {
  if (image.width() != width || image.height() != height) image = Image<float>(width, height);
}

}  // namespace

void FeatureFinder::BuildPyramid(const FeatureImage& image) {
  std::vector<std::pair<int, int>> sizes;
  for (int w = image.width(), h = image.height(); w >= kMinOctaveWidth && h >= kMinOctaveHeight;
       w /= 2, h = (h + 1) / 2) {
    sizes.emplace_back(w, h);
    if (w % 2 != 0) break;
  }
  octaves_.resize(sizes.size());
  for (std::size_t o = 0; o < sizes.size(); ++o) {
    Octave& octave = octaves_[o];
    const auto [width, height] = sizes[o];
    for (auto& level : octave.gaussian) Prepare(level, width, height);
    for (auto& level : octave.difference) Prepare(level, width, height);
    if (o == 0) {
      BlurPanorama(image.log_radiance,
                   std::sqrt(kBaseSigma * kBaseSigma - kInputSigma * kInputSigma),
                   octave.gaussian.data(), nullptr);
    } else {
      const Image<float>& source = octaves_[o - 1].gaussian[kLevels];
      for (int y = 0; y < height; ++y) {
        const float* from = source.row(2 * y);
        float* to = octave.gaussian[0].row(y);
        for (int x = 0; x < width; ++x) to[x] = from[2 * x];
      }
    }
    for (std::size_t l = 1; l < octave.gaussian.size(); ++l) {
      const double before = SigmaOfLevel(static_cast<double>(l) - 1.0);
      const double after = SigmaOfLevel(static_cast<double>(l));
      BlurPanorama(octave.gaussian[l - 1], std::sqrt(after * after - before * before),
                   &octave.gaussian[l], &octave.difference[l - 1]);
    }
  }
}

bool FeatureFinder::Localise(const FeatureImage& image, int octave, int level, int x, int y,
                             Candidate* candidate) const {
  const Octave& pictures = octaves_[static_cast<std::size_t>(octave)];
  const int width = pictures.difference[0].width();
  const int height = pictures.difference[0].height();
  Eigen::Vector3f step;
  float value = 0.0F;
  for (int iteration = 0;; ++iteration) {
    const auto at = [&](int dl, int dx, int dy) {
      const int column = (x + dx + width) % width;
      return pictures.difference[static_cast<std::size_t>(level + dl)].row(y + dy)[column];
    };
    value = at(0, 0, 0);
    const Eigen::Vector3f gradient(0.5F * (at(0, 1, 0) - at(0, -1, 0)),
                                   0.5F * (at(0, 0, 1) - at(0, 0, -1)),
                                   0.5F * (at(1, 0, 0) - at(-1, 0, 0)));
    const float xx = at(0, 1, 0) + at(0, -1, 0) - 2.0F * value;
    const float yy = at(0, 0, 1) + at(0, 0, -1) - 2.0F * value;
    const float ss = at(1, 0, 0) + at(-1, 0, 0) - 2.0F * value;
    const float xy = 0.25F * (at(0, 1, 1) - at(0, -1, 1) - at(0, 1, -1) + at(0, -1, -1));
    const float xs = 0.25F * (at(1, 1, 0) - at(1, -1, 0) - at(-1, 1, 0) + at(-1, -1, 0));
    const float ys = 0.25F * (at(1, 0, 1) - at(1, 0, -1) - at(-1, 0, 1) + at(-1, 0, -1));
    Eigen::Matrix3f hessian;
    hessian << xx, xy, xs, xy, yy, ys, xs, ys, ss;
    const float determinant = hessian.determinant();
    if (!(std::fabs(determinant) > 1e-20F)) return false;
    step = -(hessian.inverse() * gradient);
    if (!step.allFinite()) return false;
    if (step.cwiseAbs().maxCoeff() <= kMaxStep) {
      value += 0.5F * gradient.dot(step);
      const float trace = xx + yy;
      const float det = xx * yy - xy * xy;
      const float r = options_.edge_ratio;
      if (det <= 0.0F || trace * trace * r >= (r + 1.0F) * (r + 1.0F) * det) return false;
      break;
    }
    if (iteration == 4 || step.cwiseAbs().maxCoeff() > 4.0F) return false;
    x = (x + static_cast<int>(std::lround(step.x())) + width) % width;
    y += static_cast<int>(std::lround(step.y()));
    level += static_cast<int>(std::lround(step.z()));
    if (level < 1 || level > kLevels || y < kBorder || y >= height - kBorder) return false;
  }
  candidate->octave = octave;
  candidate->level = level;
  candidate->x = static_cast<float>(x) + step.x();
  candidate->y = static_cast<float>(y) + step.y();
  candidate->sigma = static_cast<float>(SigmaOfLevel(level + static_cast<double>(step.z())));
  candidate->response = std::fabs(value);
  if (candidate->response < options_.min_contrast) return false;

  const float zoom = std::exp2(static_cast<float>(octave));
  const float sigma = candidate->sigma * zoom;
  const float needed = options_.clearance_sigmas * sigma;
  const float image_y = candidate->y * zoom;
  if (image_y < needed || image_y > static_cast<float>(image.height() - 1) - needed) return false;
  const int column =
      static_cast<int>(std::lround(candidate->x * zoom) + image.width()) % image.width();
  const int row = std::clamp(static_cast<int>(std::lround(image_y)), 0, image.height() - 1);
  if (image.clearance.row(row)[column] < std::min<float>(needed, kMostClearance)) return false;

  // White noise of variance v a pixel leaves 0.084·v/(4πσ²) in a difference of Gaussians a third of
  // an octave apart.
  const float log_radiance =
      pictures.gaussian[static_cast<std::size_t>(level)].row(y)[(x + width) % width];
  const float softened = std::exp(log_radiance);
  const float radiance = std::max(0.0F, softened - image.softening);
  const float variance =
      (image.variance_floor + image.variance_slope * radiance) / (softened * softened);
  const float noise = std::sqrt(variance * 0.0067F) / sigma;
  return candidate->response >= options_.min_contrast_over_noise * noise;
}

std::vector<FeatureFinder::Candidate> FeatureFinder::FindExtrema(const FeatureImage& image) const {
  std::vector<Candidate> all;
  const float first_threshold = 0.8F * options_.min_contrast;
  for (std::size_t o = 0; o < octaves_.size(); ++o) {
    const Octave& octave = octaves_[o];
    const int width = octave.difference[0].width();
    const int height = octave.difference[0].height();
    std::vector<std::vector<Candidate>> per_row(static_cast<std::size_t>(height));
    ParallelFor(height - 2 * kBorder, 16, [&](int begin, int end) {
      for (int y = begin + kBorder; y < end + kBorder; ++y) {
        for (int level = 1; level <= kLevels; ++level) {
          const auto row = [&](int dl, int dy) {
            return octave.difference[static_cast<std::size_t>(level + dl)].row(y + dy);
          };
          const float* centre = row(0, 0);
          const std::array<const float*, 8> others{row(0, -1), row(0, 1),  row(-1, -1), row(-1, 0),
                                                   row(-1, 1), row(1, -1), row(1, 0),   row(1, 1)};
          for (int x = 0; x < width; ++x) {
            const float v = centre[x];
            if (std::fabs(v) <= first_threshold) continue;
            const int left = x == 0 ? width - 1 : x - 1;
            const int right = x == width - 1 ? 0 : x + 1;
            bool extremum = true;
            if (v > 0.0F) {
              extremum = v > centre[left] && v >= centre[right];
              for (std::size_t k = 0; extremum && k < others.size(); ++k) {
                const float* other = others[k];
                extremum = v >= other[x] && v >= other[left] && v >= other[right];
              }
            } else {
              extremum = v < centre[left] && v <= centre[right];
              for (std::size_t k = 0; extremum && k < others.size(); ++k) {
                const float* other = others[k];
                extremum = v <= other[x] && v <= other[left] && v <= other[right];
              }
            }
            Candidate candidate;
            if (extremum && Localise(image, static_cast<int>(o), level, x, y, &candidate)) {
              per_row[static_cast<std::size_t>(y)].push_back(candidate);
            }
          }
        }
      }
    });
    for (const auto& row : per_row) all.insert(all.end(), row.begin(), row.end());
  }
  return all;
}

std::vector<FeatureFinder::Candidate> FeatureFinder::Spread(
    const FeatureImage& image, std::vector<Candidate> candidates) const {
  const auto key = [](const Candidate& c) {
    return std::tuple(-c.response, c.octave, c.level, c.y, c.x);
  };
  std::sort(candidates.begin(), candidates.end(),
            [&](const Candidate& a, const Candidate& b) { return key(a) < key(b); });
  // Two starting points can lead to one extremum.
  candidates.erase(
      std::unique(candidates.begin(), candidates.end(),
                  [&](const Candidate& a, const Candidate& b) { return key(a) == key(b); }),
      candidates.end());
  // Rank inside its cell first, strength second.
  std::vector<int> in_cell(kCellRows * kCellColumns, 0);
  std::vector<std::pair<int, std::size_t>> order;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    const Candidate& c = candidates[i];
    const float zoom = std::exp2(static_cast<float>(c.octave));
    const double x = c.x * zoom + 0.5;
    const double z = std::tanh(image.top_ordinate - image.step_rad * (c.y * zoom + 0.5));
    const int row = std::clamp(static_cast<int>((1.0 - z) * 0.5 * kCellRows), 0, kCellRows - 1);
    const int column =
        std::clamp(static_cast<int>(x / image.width() * kCellColumns), 0, kCellColumns - 1);
    order.emplace_back(in_cell[static_cast<std::size_t>(row * kCellColumns + column)]++, i);
  }
  std::sort(order.begin(), order.end());
  if (order.size() > static_cast<std::size_t>(options_.max_features)) {
    order.resize(static_cast<std::size_t>(options_.max_features));
  }
  std::vector<Candidate> chosen;
  chosen.reserve(order.size());
  for (const auto& [rank, index] : order) chosen.push_back(candidates[index]);
  return chosen;
}

std::vector<float> FeatureFinder::Orientations(const Candidate& candidate) const {
  if (options_.upright) return {0.0F};
  constexpr int kOrientationBins = 36;
  const Image<float>& picture = octaves_[static_cast<std::size_t>(candidate.octave)]
                                    .gaussian[static_cast<std::size_t>(candidate.level)];
  const int width = picture.width();
  const int height = picture.height();
  const int x0 = static_cast<int>(std::lround(candidate.x));
  const int y0 = static_cast<int>(std::lround(candidate.y));
  const float window = 1.5F * candidate.sigma;
  const int radius = static_cast<int>(std::lround(3.0F * window));
  const int stride = radius < 8 ? 1 : 2;  // the picture is smooth at this scale
  const float falloff = -0.5F / (window * window);
  std::array<float, kOrientationBins> raw{};
  std::vector<float> across(static_cast<std::size_t>(2 * radius) + 1);
  for (int d = -radius; d <= radius; ++d) {
    across[static_cast<std::size_t>(d + radius)] =
        std::exp(falloff * static_cast<float>(d) * static_cast<float>(d));
  }
  for (int dy = -radius; dy <= radius; dy += stride) {
    const int y = y0 + dy;
    if (y < 1 || y >= height - 1) continue;
    for (int dx = -radius; dx <= radius; dx += stride) {
      const int x = (x0 + dx + width) % width;
      const int left = x == 0 ? width - 1 : x - 1;
      const int right = x == width - 1 ? 0 : x + 1;
      const float gx = picture.row(y)[right] - picture.row(y)[left];
      const float gy = picture.row(y + 1)[x] - picture.row(y - 1)[x];
      const float weight = across[static_cast<std::size_t>(dx + radius)] *
                           across[static_cast<std::size_t>(dy + radius)];
      const int bin = static_cast<int>(FastAngle(gy, gx) * (kOrientationBins / kTwoPi) + 0.5F);
      raw[static_cast<std::size_t>(bin % kOrientationBins)] +=
          weight * std::sqrt(gx * gx + gy * gy);
    }
  }
  std::array<float, kOrientationBins> smooth{};
  float highest = 0.0F;
  for (int i = 0; i < kOrientationBins; ++i) {
    const auto at = [&](int d) {
      return raw[static_cast<std::size_t>((i + d + kOrientationBins) % kOrientationBins)];
    };
    smooth[static_cast<std::size_t>(i)] =
        (at(-2) + at(2)) / 16.0F + (at(-1) + at(1)) * 0.25F + at(0) * 0.375F;
    highest = std::max(highest, smooth[static_cast<std::size_t>(i)]);
  }
  std::vector<float> angles;
  if (highest <= 0.0F) return {0.0F};
  for (int i = 0; i < kOrientationBins; ++i) {
    const float before =
        smooth[static_cast<std::size_t>((i + kOrientationBins - 1) % kOrientationBins)];
    const float here = smooth[static_cast<std::size_t>(i)];
    const float after = smooth[static_cast<std::size_t>((i + 1) % kOrientationBins)];
    if (here > before && here > after && here >= 0.8F * highest) {
      const float peak =
          static_cast<float>(i) + 0.5F * (before - after) / (before - 2.0F * here + after);
      angles.push_back(peak * (kTwoPi / kOrientationBins));
    }
  }
  return angles;
}

void FeatureFinder::Describe(const Candidate& candidate, float angle,
                             std::int16_t* descriptor) const {
  static const PatchWeights weights;
  const Image<float>& picture = octaves_[static_cast<std::size_t>(candidate.octave)]
                                    .gaussian[static_cast<std::size_t>(candidate.level)];
  const int width = picture.width();
  const int height = picture.height();
  const float spacing = kBlockSigmas * candidate.sigma * kBlocks / kPatch;
  const float c = std::cos(angle) * spacing;
  const float s = std::sin(angle) * spacing;

  // The patch, turned upright, with a margin of one for central differences.
  constexpr int kSide = kPatch + 2;
  std::array<float, kSide * kSide> patch;
  const float middle = 0.5F * (kSide - 1);
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const float u = static_cast<float>(i) - middle;
      const float v = static_cast<float>(j) - middle;
      const float x = candidate.x + c * u - s * v + static_cast<float>(width);  // positive
      const float y = std::clamp(candidate.y + s * u + c * v, 0.0F, static_cast<float>(height - 1));
      const int xi = static_cast<int>(x);
      const int yi = std::min(static_cast<int>(y), height - 2);
      const float fx = x - static_cast<float>(xi);
      const float fy = y - static_cast<float>(yi);
      int left = xi % width;
      if (left < 0) left += width;
      const int right = left + 1 == width ? 0 : left + 1;
      const float* upper = picture.row(yi);
      const float* lower = picture.row(yi + 1);
      const float a = upper[left] + fx * (upper[right] - upper[left]);
      const float b = lower[left] + fx * (lower[right] - lower[left]);
      patch[static_cast<std::size_t>(j * kSide + i)] = a + fy * (b - a);
    }
  }

  // One block and one bin of margin each way spare the tests.
  constexpr int kStride = kBins + 1;
  std::array<float, (kBlocks + 2) * (kBlocks + 2) * kStride> histogram{};
  for (int j = 0; j < kPatch; ++j) {
    const auto row = static_cast<std::size_t>(j);
    for (int i = 0; i < kPatch; ++i) {
      const auto column = static_cast<std::size_t>(i);
      const float* p = patch.data() + (j + 1) * kSide + (i + 1);
      const float gx = p[1] - p[-1];
      const float gy = p[kSide] - p[-kSide];
      const float magnitude =
          std::sqrt(gx * gx + gy * gy) * weights.gaussian[static_cast<std::size_t>(j * kPatch + i)];
      const float at = std::min(FastAngle(gy, gx) * (kBins / kTwoPi), kBins - 1e-4F);
      const int bin = static_cast<int>(at);
      const float upper_bin = at - static_cast<float>(bin);
      const float by_row[2] = {1.0F - weights.upper[row], weights.upper[row]};
      const float by_column[2] = {1.0F - weights.upper[column], weights.upper[column]};
      for (int v = 0; v < 2; ++v) {
        for (int u = 0; u < 2; ++u) {
          float* cell =
              histogram.data() +
              ((weights.block[row] + v) * (kBlocks + 2) + weights.block[column] + u) * kStride +
              bin;
          const float share = magnitude * by_row[v] * by_column[u];
          cell[0] += share * (1.0F - upper_bin);
          cell[1] += share * upper_bin;
        }
      }
    }
  }

  std::array<float, kDescriptorLength> values;
  std::size_t out = 0;
  float square_sum = 0.0F;
  for (int v = 1; v <= kBlocks; ++v) {
    for (int u = 1; u <= kBlocks; ++u) {
      float* cell = histogram.data() + (v * (kBlocks + 2) + u) * kStride;
      cell[0] += cell[kBins];
      for (int b = 0; b < kBins; ++b) {
        values[out++] = cell[b];
        square_sum += cell[b] * cell[b];
      }
    }
  }
  // Lowe: no gradient may rule the descriptor.
  const float limit = 0.2F * std::sqrt(square_sum);
  float sum = 1e-20F;
  for (float& value : values) {
    value = std::min(value, limit);
    sum += value;
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    const float root = std::sqrt(values[i] / sum) * static_cast<float>(kDescriptorNorm);
    descriptor[i] = static_cast<std::int16_t>(std::min(255.0F, root + 0.5F));
  }
}

FeatureSet FeatureFinder::Find(const FeatureImage& image) {
  FeatureSet result;
  if (image.log_radiance.empty()) return result;
  BuildPyramid(image);
  const std::vector<Candidate> chosen = Spread(image, FindExtrema(image));

  std::vector<std::vector<float>> angles(chosen.size());
  ParallelFor(static_cast<int>(chosen.size()), 64, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      angles[static_cast<std::size_t>(i)] = Orientations(chosen[static_cast<std::size_t>(i)]);
    }
  });
  std::vector<std::pair<std::size_t, float>> oriented;
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    for (const float angle : angles[i]) {
      if (oriented.size() < static_cast<std::size_t>(options_.max_features)) {
        oriented.emplace_back(i, angle);
      }
    }
  }
  result.features.resize(oriented.size());
  result.descriptors.resize(oriented.size() * kDescriptorLength);
  ParallelFor(static_cast<int>(oriented.size()), 64, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const auto& [index, angle] = oriented[static_cast<std::size_t>(i)];
      const Candidate& candidate = chosen[index];
      const float zoom = std::exp2(static_cast<float>(candidate.octave));
      Feature& feature = result.features[static_cast<std::size_t>(i)];
      feature.x = candidate.x * zoom + 0.5F;
      feature.y = candidate.y * zoom + 0.5F;
      feature.scale = candidate.sigma * zoom;
      feature.angle = angle;
      feature.response = candidate.response;
      feature.ray = image.RayFromPixel(feature.x, feature.y);
      feature.sigma_rad = static_cast<double>(feature.scale) * image.PixelAngle(feature.y);
      Describe(candidate, angle,
               result.descriptors.data() + static_cast<std::ptrdiff_t>(i) * kDescriptorLength);
    }
  });
  return result;
}

}  // namespace omnihdr
