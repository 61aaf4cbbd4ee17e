#include "core/photometry/exposure_refine.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "core/photometry/noise_estimate.h"

namespace omnihdr {
namespace {

constexpr std::size_t kMostSamples = 60000;  // pixels looked at in a pair of frames
constexpr double kDarkestShort = 12.0;       // below, an error of black is a large share of a value
constexpr double kMargin = 8.0;              // of values to the ends of the usable range
constexpr double kModelError = 0.02;         // relative spread besides noise: response, sharpness
constexpr double kLeastAgreeing = 0.5;       // share of the samples that must agree on a ratio

// E·t and its relative variance by value, for one bit depth.
struct Curve {
  double value_scale = 1.0;
  std::array<std::vector<double>, 3> exposure;
  std::array<std::vector<double>, 3> relative_variance;
};

Curve MakeCurve(const Response& response, int bits, const NoiseModel& noise) {
  Curve curve;
  const std::size_t values = std::size_t{1} << bits;
  curve.value_scale = 255.0 / static_cast<double>(values - 1);
  for (int c = 0; c < 3; ++c) {
    std::vector<double>& exposure = curve.exposure[static_cast<std::size_t>(c)];
    std::vector<double>& variance = curve.relative_variance[static_cast<std::size_t>(c)];
    exposure.resize(values);
    variance.resize(values);
    for (std::size_t z = 0; z < values; ++z) {
      const double value = static_cast<double>(z) * curve.value_scale;
      exposure[z] = response.ExposureFromValue(c, value);
      const double slope = response.Slope(c, value) / std::max(exposure[z], 1e-300);
      variance[z] = noise.VarianceOfValue(value - response.black()) * slope * slope;
    }
  }
  return curve;
}

std::uint32_t ValueAt(const DecodedImage& image, int x, int y, int channel) {
  return std::visit(
      [&](const auto& pixels) -> std::uint32_t {
        return pixels.pixel(x, y)[pixels.channels() == 3 ? channel : 0];
      },
      image.pixels);
}

struct Ratio {
  double value = 1.0;     // light per labelled second of the shorter frame over the longer's
  double variance = 0.0;  // relative, from noise
};

class PairComparison {
 public:
  PairComparison(const Curve& shorter_curve, const Curve& longer_curve,
                 const RefineOptions& options)
      : shorter_curve_(shorter_curve), longer_curve_(longer_curve), options_(options) {}

  std::vector<Ratio> Sample(const ExposedFrame& shorter, const ExposedFrame& longer,
                            ImageView<const std::uint8_t> mask) const {
    const int width = longer.image->width();
    const int height = longer.image->height();
    const double pixels = static_cast<double>(width) * height;
    const int step =
        std::max(1, static_cast<int>(std::sqrt(pixels / static_cast<double>(kMostSamples))));
    const int channels = longer.image->channels() == 3 && shorter.image->channels() == 3 ? 3 : 1;
    const double time_ratio =
        shorter.exposure.EffectiveSeconds() / longer.exposure.EffectiveSeconds();
    std::vector<Ratio> ratios;
    for (int y = step / 2; y < height; y += step) {
      for (int x = step / 2; x < width; x += step) {
        if (!mask.empty() && mask.at(x, y) < 128) continue;
        if (IsSaturated(*shorter.image, shorter_curve_, x, y) ||
            IsSaturated(*longer.image, longer_curve_, x, y)) {
          continue;
        }
        for (int c = 0; c < channels; ++c) {
          const int channel = channels == 3 ? c : 1;
          if (const auto ratio = Compare(ValueAt(*shorter.image, x, y, channel),
                                         ValueAt(*longer.image, x, y, channel),
                                         static_cast<std::size_t>(channel), time_ratio)) {
            ratios.push_back(*ratio);
          }
        }
      }
    }
    return ratios;
  }

 private:
  bool IsSaturated(const DecodedImage& image, const Curve& curve, int x, int y) const {
    for (int c = 0; c < image.channels(); ++c) {
      if (ValueAt(image, x, y, c) * curve.value_scale > options_.value_high) return true;
    }
    return false;
  }

  std::optional<Ratio> Compare(std::uint32_t short_value, std::uint32_t long_value, std::size_t c,
                               double time_ratio) const {
    const std::vector<double>& short_exposure = shorter_curve_.exposure[c];
    const std::vector<double>& long_exposure = longer_curve_.exposure[c];
    if (short_value >= short_exposure.size() || long_value >= long_exposure.size()) return {};
    const double long_code = long_value * longer_curve_.value_scale;
    if (long_code < options_.value_low + kMargin || long_code > options_.value_high - kMargin) {
      return {};
    }
    // Where the shorter frame should be by the longer one: its own value must not choose.
    const double expected = long_exposure[long_value] * time_ratio;
    const auto at = std::lower_bound(short_exposure.begin(), short_exposure.end(), expected);
    if (at == short_exposure.end()) return {};
    const auto expected_value = static_cast<std::size_t>(at - short_exposure.begin());
    const double short_code = static_cast<double>(expected_value) * shorter_curve_.value_scale;
    if (short_code < kDarkestShort || short_code > options_.value_high - kMargin) return {};
    return Ratio{short_exposure[short_value] / expected,
                 shorter_curve_.relative_variance[c][expected_value] +
                     longer_curve_.relative_variance[c][long_value]};
  }

  const Curve& shorter_curve_;
  const Curve& longer_curve_;
  const RefineOptions& options_;
};

// The median, then the mean of what lies within three standard deviations of it: unlike the median
// alone, not bound to the lattice of ratios of small whole numbers.
std::optional<double> RobustMean(std::vector<Ratio> ratios, std::size_t least) {
  if (ratios.size() < std::max<std::size_t>(least, 1)) return {};
  const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
  std::nth_element(ratios.begin(), middle, ratios.end(),
                   [](const Ratio& a, const Ratio& b) { return a.value < b.value; });
  double mean = middle->value;
  for (int round = 0; round < 4; ++round) {
    double sum = 0.0;
    double weight_sum = 0.0;
    std::size_t agreeing = 0;
    for (const Ratio& r : ratios) {
      const double variance = r.variance + kModelError * kModelError;
      const double gap = r.value - mean;
      if (gap * gap > 9.0 * variance * mean * mean) continue;
      ++agreeing;
      sum += r.value / variance;
      weight_sum += 1.0 / variance;
    }
    if (static_cast<double>(agreeing) < kLeastAgreeing * static_cast<double>(ratios.size())) {
      return {};
    }
    mean = sum / weight_sum;
  }
  if (!(mean > 0.0) || !std::isfinite(mean)) return {};
  return mean;
}

}  // namespace

Result<std::vector<RefinedExposure>> RefineExposures(std::span<const ExposedFrame> frames,
                                                     const Response& response, int bits,
                                                     ImageView<const std::uint8_t> mask,
                                                     const RefineOptions& options) {
  OMNIHDR_TRY(CheckFrames(frames, mask));
  std::vector<RefinedExposure> refined(frames.size());
  if (frames.size() < 2) return refined;
  RefineOptions usable = options;
  usable.value_high = response.HighestUsable(options.value_high);
  NoiseModel noise = options.noise;
  if (noise.read <= 0.0) noise.read = kTypicalReadNoise;
  const Curve narrow = MakeCurve(response, 8, noise);
  const bool any_wide = std::any_of(frames.begin(), frames.end(),
                                    [](const ExposedFrame& f) { return f.image->is_16_bit(); });
  const Curve wide = any_wide ? MakeCurve(response, std::clamp(bits, 8, 16), noise) : Curve{};
  const auto curve_of = [&](const ExposedFrame& f) -> const Curve& {
    return f.image->is_16_bit() ? wide : narrow;
  };

  std::vector<std::size_t> order(frames.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return frames[a].exposure.EffectiveSeconds() < frames[b].exposure.EffectiveSeconds();
  });
  // ln of exposure over label along the chain; a link that cannot be measured begins a new one.
  std::vector<double> ln(frames.size(), 0.0);
  std::vector<std::size_t> begins = {0};
  for (std::size_t k = 1; k < order.size(); ++k) {
    const ExposedFrame& shorter = frames[order[k - 1]];
    const ExposedFrame& longer = frames[order[k]];
    std::vector<Ratio> ratios =
        PairComparison(curve_of(shorter), curve_of(longer), usable).Sample(shorter, longer, mask);
    const std::size_t count = ratios.size();
    const std::optional<double> ratio = RobustMean(std::move(ratios), options.samples);
    if (!ratio) {
      begins.push_back(k);
      continue;
    }
    refined[order[k - 1]].samples += count;
    refined[order[k]].samples += count;
    ln[k] = ln[k - 1] - std::log(*ratio);
  }
  begins.push_back(order.size());
  bool is_consistent = true;
  for (std::size_t b = 0; b + 1 < begins.size(); ++b) {
    const std::size_t first = begins[b];
    const std::size_t count = begins[b + 1] - first;
    if (count < 2) {
      refined[order[first]].verdict = RefineVerdict::kNoOverlap;
      continue;
    }
    std::vector<double> sorted(ln.begin() + static_cast<std::ptrdiff_t>(first),
                               ln.begin() + static_cast<std::ptrdiff_t>(first + count));
    std::sort(sorted.begin(), sorted.end());
    const double anchor = count == 2 ? ln[first + 1] : sorted[count / 2];
    const double limit = std::log1p(options.limit);
    for (std::size_t k = first; k < first + count; ++k) {
      RefinedExposure& r = refined[order[k]];
      r.measured = std::exp(ln[k] - anchor);
      const double change = std::abs(ln[k] - anchor);
      if (change <= std::log1p(options.least)) continue;
      r.verdict = change > limit ? RefineVerdict::kBeyondLimit : RefineVerdict::kRefined;
      // Small steps that add up to a large one.
      const double before = k > first ? std::abs(ln[k] - ln[k - 1]) : 0.0;
      const double after = k + 1 < first + count ? std::abs(ln[k + 1] - ln[k]) : 0.0;
      is_consistent = is_consistent && (change <= limit || std::max(before, after) > limit);
    }
  }
  const auto beyond = static_cast<std::size_t>(std::count_if(
      refined.begin(), refined.end(),
      [](const RefinedExposure& r) { return r.verdict == RefineVerdict::kBeyondLimit; }));
  if (!is_consistent || (beyond > 1 && 4 * beyond > frames.size())) {
    // Correcting a part of the bracket would only move the step.
    for (RefinedExposure& r : refined) {
      if (r.verdict == RefineVerdict::kRefined || r.verdict == RefineVerdict::kBeyondLimit) {
        r.verdict = RefineVerdict::kInconsistent;
      }
    }
  }
  for (RefinedExposure& r : refined) {
    if (r.verdict == RefineVerdict::kRefined) r.scale = r.measured;
  }
  return refined;
}

std::vector<std::string> RefinementNotes(std::span<const RefinedExposure> refined,
                                         std::span<const ExposedFrame> labelled,
                                         std::span<const std::string> names, double limit) {
  std::vector<std::string> notes;
  std::size_t inconsistent = 0;
  for (std::size_t k = 0; k < refined.size(); ++k) {
    const RefinedExposure& r = refined[k];
    const double percent = 100.0 * (r.measured - 1.0);
    const std::string what =
        fmt::format("{}: exposure {:.6g} s", names[k], labelled[k].exposure.time.seconds());
    switch (r.verdict) {
      case RefineVerdict::kLabelRight:
        break;
      case RefineVerdict::kRefined:
        notes.push_back(
            fmt::format("{}: {:+.1f} % by its overlap with the others: corrected", what, percent));
        break;
      case RefineVerdict::kBeyondLimit:
        notes.push_back(fmt::format(
            "{}: {:+.1f} % by its overlap with the others, beyond the limit of {:.0f} %: kept as "
            "labelled",
            what, percent, 100.0 * limit));
        break;
      case RefineVerdict::kNoOverlap:
        if (refined.size() > 1) {
          notes.push_back(fmt::format(
              "{}: shares too little with the others to be tested: kept as labelled", what));
        }
        break;
      case RefineVerdict::kInconsistent:
        ++inconsistent;
        break;
    }
  }
  if (inconsistent > 0) {
    notes.push_back(fmt::format(
        "{} of {} exposures disagree with their neighbours, some beyond {:.0f} %: the response or "
        "the alignment of the pictures, not the labels: all kept as labelled",
        inconsistent, refined.size(), 100.0 * limit));
  }
  return notes;
}

}  // namespace omnihdr
