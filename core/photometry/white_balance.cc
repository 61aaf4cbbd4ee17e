#include "core/photometry/white_balance.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace omnihdr {
namespace {

constexpr double kChartError = 0.005;  // a real chart's grey patches are neutral to about that
constexpr double kBlackError = 0.25;   // code values

double RelativeVariance(const PatchChannel& patch) {
  const double noise = patch.exposure_error / patch.exposure;
  const double black = kBlackError / std::max(patch.mean, 1.0);
  return noise * noise + black * black;
}

struct WeightedMean {
  double mean = 0.0;
  double error = 0.0;
};

// The error is that of the weights, or of the values' own scatter when that is larger.
WeightedMean Mean(const std::vector<double>& values, const std::vector<double>& variances) {
  double weights = 0.0;
  double sum = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    weights += 1.0 / variances[i];
    sum += values[i] / variances[i];
  }
  WeightedMean mean{sum / weights, 0.0};
  double chi2 = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    chi2 += (values[i] - mean.mean) * (values[i] - mean.mean) / variances[i];
  }
  const double scatter = chi2 / static_cast<double>(values.size() - 1);
  mean.error = std::sqrt(std::max(1.0, scatter) / weights);
  return mean;
}

}  // namespace

Result<WhiteBalance> SolveWhiteBalance(std::span<const ChartMeasurement> charts) {
  WhiteBalance balance;
  std::vector<double> red;
  std::vector<double> blue;
  std::vector<double> red_variance;
  std::vector<double> blue_variance;
  int clipped = 0;
  int dark = 0;
  for (std::size_t k = 0; k < charts.size(); ++k) {
    for (int p = kChartFirstGrey; p < kChartPatches; ++p) {
      const std::array<PatchChannel, 3>& patch = charts[k][static_cast<std::size_t>(p)];
      GreyPatchBalance grey;
      grey.picture = static_cast<int>(k);
      grey.patch = p;
      grey.used = patch[0].usable && patch[1].usable && patch[2].usable;
      if (!grey.used) {
        const bool bright = std::any_of(patch.begin(), patch.end(),
                                        [](const PatchChannel& c) { return c.clipped > 0.01; });
        grey.excluded = bright ? "clipped" : "dark";
        ++(bright ? clipped : dark);
      } else {
        const double chart = 2.0 * kChartError * kChartError;
        red.push_back(std::log(patch[1].exposure / patch[0].exposure));
        blue.push_back(std::log(patch[1].exposure / patch[2].exposure));
        red_variance.push_back(chart + RelativeVariance(patch[0]) + RelativeVariance(patch[1]));
        blue_variance.push_back(chart + RelativeVariance(patch[2]) + RelativeVariance(patch[1]));
      }
      balance.patches.push_back(grey);
    }
  }
  if (red.size() < 2) {
    return Fail(ErrorKind::kData,
                "white balance: {} of {} grey patches can be used ({} clipped, {} dark), expected "
                "at least 2: take a picture {}",
                red.size(), balance.patches.size(), clipped, dark,
                clipped > dark ? "with a shorter exposure" : "with a longer exposure");
  }
  const WeightedMean mean_red = Mean(red, red_variance);
  const WeightedMean mean_blue = Mean(blue, blue_variance);
  balance.red = std::exp(mean_red.mean);
  balance.blue = std::exp(mean_blue.mean);
  balance.red_error = mean_red.error;
  balance.blue_error = mean_blue.error;
  std::size_t used = 0;
  for (GreyPatchBalance& grey : balance.patches) {
    if (!grey.used) continue;
    grey.red_residual = std::exp(mean_red.mean - red[used]) - 1.0;
    grey.blue_residual = std::exp(mean_blue.mean - blue[used]) - 1.0;
    ++used;
    balance.worst_residual = std::max(
        {balance.worst_residual, std::abs(grey.red_residual), std::abs(grey.blue_residual)});
  }
  if (balance.worst_residual > 0.05) {
    balance.warnings.push_back(fmt::format(
        "the grey patches disagree by up to {:.1f} %: light of two colours on the chart, a black "
        "level that is not subtracted, or a response that is not the pictures' own",
        100.0 * balance.worst_residual));
  }
  return balance;
}

}  // namespace omnihdr
