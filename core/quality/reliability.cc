#include "core/quality/reliability.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

#include "core/quality/disparity_metrics.h"

namespace omnihdr {

void ReliabilityCurve::Add(ImageView<const float> tested, ImageView<const float> confidence,
                           ImageView<const float> truth, double baseline,
                           const ComparisonArea& area) {
  assert(tested.width() == truth.width() && tested.height() == truth.height());
  assert(confidence.width() == truth.width() && confidence.height() == truth.height());
  for (int y = 0; y < truth.height(); ++y) {
    const double weight = area.Weight(y);
    for (int x = 0; x < truth.width(); ++x) {
      const double want = truth.at(x, y);
      const double have = tested.at(x, y);
      const double called = confidence.at(x, y);
      if (!area.Has(x, y) || !std::isfinite(want) || !std::isfinite(have) ||
          !std::isfinite(called)) {
        continue;
      }
      const double clamped = std::clamp(called, 0.0, 1.0);
      Sums& bin = sums_[std::min(kBins - 1, static_cast<std::size_t>(clamped * kBins))];
      bin.weight += weight;
      bin.confidence += weight * clamped;
      if (std::abs(have - want) * baseline <= kOnePixelOfParallax) bin.right += weight;
    }
  }
}

void ReliabilityCurve::Add(const ReliabilityCurve& other) {
  for (std::size_t k = 0; k < kBins; ++k) {
    sums_[k].weight += other.sums_[k].weight;
    sums_[k].confidence += other.sums_[k].confidence;
    sums_[k].right += other.sums_[k].right;
  }
}

bool ReliabilityCurve::empty() const {
  return std::all_of(sums_.begin(), sums_.end(), [](const Sums& s) { return s.weight == 0.0; });
}

std::array<ReliabilityCurve::Bin, ReliabilityCurve::kBins> ReliabilityCurve::Bins() const {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  std::array<Bin, kBins> bins;
  for (std::size_t k = 0; k < kBins; ++k) {
    const Sums& s = sums_[k];
    const bool any = s.weight > 0.0;
    bins[k] = {s.weight, any ? s.confidence / s.weight : kNone, any ? s.right / s.weight : kNone};
  }
  return bins;
}

double ReliabilityCurve::CalibrationError() const {
  double error = 0.0;
  double weight = 0.0;
  for (const Sums& s : sums_) {
    error += std::abs(s.confidence - s.right);
    weight += s.weight;
  }
  return weight > 0.0 ? error / weight : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace omnihdr
