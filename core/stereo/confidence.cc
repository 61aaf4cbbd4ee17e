#include "core/stereo/confidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/sphere/fast_angle.h"
#include "core/sphere/latlong_grid.h"

namespace omnihdr {
namespace {

struct Knot {
  float score;
  float probability;
};
// Monotone (isotonic) fit to the shares of right pixels by score; between knots a line.
constexpr std::array<Knot, 8> kMeasured = {{{0.05F, 0.22F},
                                            {0.15F, 0.31F},
                                            {0.25F, 0.44F},
                                            {0.35F, 0.50F},
                                            {0.50F, 0.64F},
                                            {0.66F, 0.78F},
                                            {0.78F, 0.87F},
                                            {1.00F, 0.935F}}};
constexpr float kOfFilled = 0.48F;
constexpr float kLeastScore = 0.02F;  // below: filled

constexpr double kPixel = 2.0 * std::numbers::pi / 1536.0;  // of parallax
constexpr double kMatchError = 0.17;                        // columns
constexpr double kMeasuredColumns = 800.0;                  // of the drives measured, in the mean

// Share of a normal distribution within a pixel of its mean.
double WithinOnePixel(double sigma_px) {
  return std::erf(1.0 / (std::numbers::sqrt2 * std::max(sigma_px, 1e-3)));
}

constexpr int kAreaRadius = 4;            // of the square that has to agree, in map pixels
constexpr double kLeastAreaShare = 0.75;  // of that square's pixels

constexpr int kLeastWitnesses = 2;

bool SaysNothing(std::uint64_t texel) { return (texel & 0xFFU) > ((texel >> 8U) & 0xFFU); }

// How many views have something where they would see a surface point.
int Witnesses(const std::vector<SweepNeighbour>& neighbours, const Eigen::Vector3f& ray,
              float disparity) {
  if (!(disparity >= 0.0F)) return 0;
  int count = 0;
  for (const SweepNeighbour& neighbour : neighbours) {
    const StereoView& view = *neighbour.view;
    const Eigen::Vector3f v = ray - disparity * neighbour.offset;
    const float rho = std::sqrt(v.x() * v.x() + v.y() * v.y());
    const float column = (std::numbers::pi_v<float> - FastAtan2(v.y(), v.x())) *
                         static_cast<float>(view.width) / (2.0F * std::numbers::pi_v<float>);
    const float row =
        FastAtan2(rho, v.z()) * static_cast<float>(view.height) / std::numbers::pi_v<float>;
    const int j = std::clamp(static_cast<int>(column + 0.5F), 0, view.width);
    const int i = std::clamp(static_cast<int>(row + 0.5F), 0, view.height);
    count += SaysNothing(view.row(i)[j]) ? 0 : 1;
  }
  return count;
}

}  // namespace

float ProbabilityRight(float score) {
  if (!(score >= kLeastScore)) return kOfFilled;
  if (score <= kMeasured.front().score) return kMeasured.front().probability;
  for (std::size_t k = 1; k < kMeasured.size(); ++k) {
    const Knot& a = kMeasured[k - 1];
    const Knot& b = kMeasured[k];
    if (score > b.score) continue;
    return a.probability +
           (b.probability - a.probability) * (score - a.score) / (b.score - a.score);
  }
  return kMeasured.back().probability;
}

float DisparityPrecision::Within(float disparity) const {
  const double by_match = kMatchError * 1536.0 / columns;
  // Of 1/r, when r is off by the viewpoint's distance.
  const double d = static_cast<double>(disparity);
  const double by_head = d * d * viewpoint * baseline / kPixel;
  const double share = WithinOnePixel(std::hypot(by_match, by_head)) /
                       WithinOnePixel(kMatchError * 1536.0 / kMeasuredColumns);
  return static_cast<float>(std::min(share, 1.0));
}

namespace {

// DisparityPrecision::Within by table, to a thousandth.
class WithinTable {
 public:
  // For disparities up to `most`.
  WithinTable(const DisparityPrecision& precision, float most)
      : scale_(static_cast<float>(kSteps) / std::max(most, 1e-6F)) {
    for (std::size_t k = 0; k < share_.size(); ++k) {
      share_[k] = precision.Within(static_cast<float>(k) / scale_);
    }
  }
  float operator()(float disparity) const {
    const float at = std::min(disparity * scale_, static_cast<float>(kSteps));
    const auto k = std::min(static_cast<std::size_t>(at), std::size_t{kSteps - 1});
    const float part = at - static_cast<float>(k);
    return (1.0F - part) * share_[k] + part * share_[k + 1];
  }

 private:
  static constexpr int kSteps = 1024;
  std::array<float, kSteps + 1> share_{};
  float scale_;
};

float LargestFiniteOf(const Image<float>& disparity) {
  float most = 0.0F;
  for (int y = 0; y < disparity.height(); ++y) {
    const float* row = disparity.row(y);
    for (int x = 0; x < disparity.width(); ++x) {
      if (std::isfinite(row[x])) most = std::max(most, row[x]);
    }
  }
  return most;
}

}  // namespace

void CalibrateConfidence(const Image<float>& disparity, const DisparityPrecision& precision,
                         Image<float>* confidence) {
  const WithinTable within(precision, LargestFiniteOf(disparity));
  ParallelFor(disparity.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < disparity.width(); ++x) {
        float& c = confidence->at(x, y);
        const float d = disparity.at(x, y);
        c = d >= 0.0F ? ProbabilityRight(c) * within(d) : 0.0F;
      }
    }
  });
}

void ForgetUnseen(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
                  DisparityMap* map) {
  const int width = map->disparity.width();
  const int height = map->disparity.height();
  const LatLongGrid grid(width, height);
  // Of each square of a row's pixels, how many are trusted; then of the rows around.
  Image<std::uint8_t> trusted_in_row(width, height);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const float* confidence = map->confidence.row(y);
      for (int x = 0; x < width; ++x) {
        int count = 0;
        for (int k = -kAreaRadius; k <= kAreaRadius; ++k) {
          count += confidence[(x + k + width) % width] >= kTrustedScore ? 1 : 0;
        }
        trusted_in_row.at(x, y) = static_cast<std::uint8_t>(count);
      }
    }
  });
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const int above = std::max(0, y - kAreaRadius);
      const int below = std::min(height - 1, y + kAreaRadius);
      const int least = static_cast<int>(kLeastAreaShare * (2 * kAreaRadius + 1) *
                                         static_cast<double>(below - above + 1));
      for (int x = 0; x < width; ++x) {
        if (!SaysNothing(reference.row(2 * y + 1)[2 * x + 1])) continue;
        int count = 0;
        for (int k = above; k <= below; ++k) count += trusted_in_row.at(x, k);
        if (count > least &&
            Witnesses(neighbours, grid.Ray(x, y), map->disparity.at(x, y)) >= kLeastWitnesses) {
          continue;
        }
        map->disparity.at(x, y) = std::numeric_limits<float>::quiet_NaN();
        map->confidence.at(x, y) = 0.0F;
      }
    }
  });
}

}  // namespace omnihdr
