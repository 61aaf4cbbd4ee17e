#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace omnihdr {

// How the reference's radiance compares with one source's where both measured the same surface: a
// smooth field of reference / source over the sphere (light that changed, wrong exposure labels,
// vignetting, a tone curve that is not quite undone, gloss) and how much they still differ beyond
// what noise explains. Ratios are averaged, not their logarithms: the reference may be dark and
// noisy, and the mean of a ratio to a cleaner source stays unbiased. The field of two consistent
// views is one.
class AgreementField {
 public:
  static constexpr int kWidth = 128;
  static constexpr int kHeight = 64;

  // What the residuals' ratios are of.
  enum class Ratio { kReferenceToSource, kSourceToReference };
  struct Residual {
    int cell = 0;
    float ratio = 1.0F;
    float noise = 0.0F;  // variance of the ratio that noise and misregistration explain
  };

  void Fit(const std::vector<Residual>& residuals, Ratio of = Ratio::kReferenceToSource) {
    field_.assign(static_cast<std::size_t>(kWidth) * kHeight, 1.0F);
    excess_ = kUnknownExcess;
    if (residuals.size() < kLeastResiduals) return;
    std::vector<float> values(residuals.size());
    const auto median_of = [&values] {
      const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
      std::nth_element(values.begin(), middle, values.end());
      return *middle;
    };
    std::transform(residuals.begin(), residuals.end(), values.begin(),
                   [](const Residual& r) { return r.ratio; });
    const float global = std::clamp(median_of(), 1.0F / kLargestFactor, kLargestFactor);
    // Robust means around the global ratio: each residual counts less the farther it lies.
    std::vector<double> sum(field_.size());
    std::vector<double> weight(field_.size());
    for (const Residual& r : residuals) {
      const double gap = r.ratio - global;
      const double variance = r.noise + kCellSpread * kCellSpread;
      const double w = 1.0 / (variance * (1.0 + gap * gap / (9.0 * variance)));
      sum[static_cast<std::size_t>(r.cell)] += w * gap;
      weight[static_cast<std::size_t>(r.cell)] += w;
    }
    static constexpr std::array<double, 5> kFalloff = {0.135, 0.607, 1.0, 0.607, 0.135};
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        double s = 0.0;
        double w = kPriorWeight;
        for (int dy = -2; dy <= 2; ++dy) {
          const int cy = y + dy;
          if (cy < 0 || cy >= kHeight) continue;
          for (int dx = -2; dx <= 2; ++dx) {
            const auto k = static_cast<std::size_t>(cy * kWidth + (x + dx + kWidth) % kWidth);
            const double falloff = kFalloff[static_cast<std::size_t>(dx + 2)] *
                                   kFalloff[static_cast<std::size_t>(dy + 2)];
            s += falloff * sum[k];
            w += falloff * weight[k];
          }
        }
        field_[static_cast<std::size_t>(y * kWidth + x)] =
            std::clamp(global + static_cast<float>(s / w), 1.0F / kLargestFactor, kLargestFactor);
      }
    }
    // What is left over, robustly, less what noise explains.
    std::transform(residuals.begin(), residuals.end(), values.begin(), [this](const Residual& r) {
      return std::abs(r.ratio - field_[static_cast<std::size_t>(r.cell)]);
    });
    const float deviation = 1.4826F * median_of();
    std::transform(residuals.begin(), residuals.end(), values.begin(),
                   [](const Residual& r) { return r.noise; });
    excess_ = std::clamp(deviation * deviation - median_of(), 0.0F, kUnknownExcess);
    if (of == Ratio::kReferenceToSource) return;
    for (float& factor : field_) factor = 1.0F / factor;
  }

  // Factor that brings the source's radiance to the reference's, at a point in cells.
  float Factor(float x, float y) const {
    const float fx = x - 0.5F;
    const float fy = std::clamp(y - 0.5F, 0.0F, static_cast<float>(kHeight - 1));
    const int x0 = static_cast<int>(std::floor(fx));
    const int y0 = static_cast<int>(fy);
    const int y1 = std::min(y0 + 1, kHeight - 1);
    const float ax = fx - static_cast<float>(x0);
    const float ay = fy - static_cast<float>(y0);
    const auto at = [this](int cx, int cy) {
      return field_[static_cast<std::size_t>(cy * kWidth + (cx + kWidth) % kWidth)];
    };
    const float above = (1.0F - ax) * at(x0, y0) + ax * at(x0 + 1, y0);
    const float below = (1.0F - ax) * at(x0, y1) + ax * at(x0 + 1, y1);
    return (1.0F - ay) * above + ay * below;
  }
  // The same along a row, at points (k + 0.5)·step, y.
  void FactorsOfRow(float y, float step, int count, float* out) const {
    std::array<float, kWidth + 2> row{};  // a cell before the first and after the last
    const float fy = std::clamp(y - 0.5F, 0.0F, static_cast<float>(kHeight - 1));
    const int y0 = static_cast<int>(fy);
    const int y1 = std::min(y0 + 1, kHeight - 1);
    const float ay = fy - static_cast<float>(y0);
    const auto above = field_.begin() + static_cast<std::ptrdiff_t>(y0) * kWidth;
    const auto below = field_.begin() + static_cast<std::ptrdiff_t>(y1) * kWidth;
    for (std::size_t x = 0; x < kWidth; ++x) {
      row[x + 1] = (1.0F - ay) * above[static_cast<std::ptrdiff_t>(x)] +
                   ay * below[static_cast<std::ptrdiff_t>(x)];
    }
    row[0] = row[kWidth];
    row[kWidth + 1] = row[1];
    for (int k = 0; k < count; ++k) {
      const float fx = (static_cast<float>(k) + 0.5F) * step + 0.5F;
      const auto x0 = static_cast<int>(fx);
      const float ax = fx - static_cast<float>(x0);
      const auto i = static_cast<std::size_t>(x0);
      out[k] = (1.0F - ax) * row[i] + ax * row[i + 1];
    }
  }
  // Relative variance of the source's radiance beyond noise and misregistration.
  float excess() const { return excess_; }

 private:
  static constexpr std::size_t kLeastResiduals = 200;
  static constexpr float kLargestFactor = 2.0F;  // beyond a stop it is not drift but a mistake
  static constexpr double kCellSpread = 0.05;
  static constexpr double kPriorWeight =
      1000.0;  // of the global ratio, in units of residuals' weights
  static constexpr float kUnknownExcess = 0.04F;
  std::vector<float> field_;
  float excess_ = kUnknownExcess;
};

}  // namespace omnihdr
