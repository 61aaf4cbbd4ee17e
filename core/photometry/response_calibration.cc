#include "core/photometry/response_calibration.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/photometry/response_fit.h"

namespace omnihdr {
namespace {

using response_fit::Curve;
using response_fit::Fitted;
using response_fit::Scatter;
using response_fit::Support;

constexpr std::size_t kHeldOut = 5;
// Values that must lie between the lowest and the highest measured.
constexpr int kLeastCoverage = 64;

struct Fit {
  Response response = *Response::Linear();
  std::array<std::array<double, 256>, 3> standard_error{};
};

Result<Fit> FitLinear(const ResponseSamples& samples, const ResponseCalibrationOptions& options) {
  const Fitted black = response_fit::FitBlack(samples, options.weight_turns);
  constexpr double kFarBelow = -8.0;
  if (black.value < kFarBelow) {
    return Fail(ErrorKind::kData,
                "a linear fit puts black at value {:.1f}, expected 0 or more: these values are not "
                "linear (debevec or loglinear may fit)",
                black.value);
  }
  Fit fit;
  OMNIHDR_ASSIGN(fit.response, Response::Linear(std::max(0.0, black.value)));
  const double b = fit.response.black();
  for (int z = 0; z < 256; ++z) {
    const double above = std::max(z - b, 0.5);
    const double error =
        black.standard_error * std::abs(1.0 / above - 1.0 / (response_fit::kReferenceValue - b));
    for (std::size_t c = 0; c < 3; ++c) fit.standard_error[c][static_cast<std::size_t>(z)] = error;
  }
  return fit;
}

Result<Fit> FitLogLinear(const ResponseSamples& samples,
                         const ResponseCalibrationOptions& options) {
  Fit fit;
  std::array<std::array<double, 2>, 3> a_b{};
  for (std::size_t c = 0; c < 3; ++c) {
    const Fitted slope =
        response_fit::FitLogSlope(samples.channels[c], samples.seconds, options.weight_turns);
    if (!(slope.value > 0.0)) {
      return Fail(
          ErrorKind::kData,
          "channel {}: a log-linear fit falls with exposure ({:.3g} values per unit of ln t)",
          "RGB"[c], slope.value);
    }
    const double a = 1.0 / slope.value;
    a_b[c] = {a, -a * response_fit::kReferenceValue};
    const double error = a * slope.standard_error / slope.value;
    for (int z = 0; z < 256; ++z) {
      fit.standard_error[c][static_cast<std::size_t>(z)] =
          error * std::abs(z - response_fit::kReferenceValue);
    }
  }
  OMNIHDR_ASSIGN(fit.response, Response::LogLinear(a_b));
  return fit;
}

Result<Fit> FitTable(const ResponseSamples& samples, const ResponseCalibrationOptions& options) {
  Fit fit;
  std::array<std::vector<double>, 3> table;
  for (std::size_t c = 0; c < 3; ++c) {
    const ResponseSamples::Channel& channel = samples.channels[c];
    const Curve curve =
        options.method == ResponseMethod::kDebevec
            ? response_fit::FitDebevec(channel, samples.seconds, options.bend, options.weight_turns)
            : response_fit::FitRobertson(channel, samples.seconds, options.bend,
                                         options.curve_turns);
    table[c].assign(curve.g.begin(), curve.g.end());
    fit.standard_error[c] = curve.standard_error;
  }
  OMNIHDR_ASSIGN(fit.response, Response::Table(table));
  return fit;
}

Result<Fit> FitAny(const ResponseSamples& samples, const ResponseCalibrationOptions& options) {
  switch (options.method) {
    case ResponseMethod::kDebevec:
    case ResponseMethod::kRobertson:
      return FitTable(samples, options);
    case ResponseMethod::kLinear:
      return FitLinear(samples, options);
    case ResponseMethod::kLogLinear:
      return FitLogLinear(samples, options);
  }
  return Fail(ErrorKind::kSoftware, "no such method");
}

// With two exposures a spot, Robertson's turns follow the pairs from value to value and find
// another fixed point for every start.
Status CheckMethod(const ResponseSamples& samples, ResponseMethod method) {
  if (method != ResponseMethod::kRobertson) return {};
  constexpr double kLeastPerSpot = 2.5;
  for (std::size_t c = 0; c < 3; ++c) {
    const ResponseSamples::Channel& channel = samples.channels[c];
    const double per_spot =
        static_cast<double>(channel.observations.size()) / static_cast<double>(channel.size());
    if (per_spot < kLeastPerSpot) {
      return Fail(ErrorKind::kData,
                  "channel {}: a spot is usable under {:.1f} exposures on average; robertson needs "
                  "{}, debevec does with two",
                  "RGB"[c], per_spot, kLeastPerSpot);
    }
  }
  return {};
}

// Every fifth spot, or the other four.
ResponseSamples Part(const ResponseSamples& samples, bool held_out) {
  ResponseSamples part;
  part.seconds = samples.seconds;
  part.names = samples.names;
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::size_t i = 0; i < samples.channels[c].size(); ++i) {
      if ((i % kHeldOut == kHeldOut - 1) == held_out) {
        part.channels[c].Add(samples.channels[c].spot(i));
      }
    }
  }
  return part;
}

// ln E of every observation and its spot's mean.
struct Disagreement {
  std::vector<float> values;
  std::vector<double> residuals;  // ln E less the spot's mean
  std::vector<double> mean;       // of the spot, one an observation
  std::vector<std::uint32_t> exposure;
  std::vector<std::size_t> spot_size;
  std::vector<bool> outlier;
};

Disagreement DisagreementOf(const Response& response, const ResponseSamples& samples, int channel) {
  Disagreement all;
  const ResponseSamples::Channel& data = samples.channels[static_cast<std::size_t>(channel)];
  std::vector<double> ln;
  for (std::size_t i = 0; i < data.size(); ++i) {
    ln.clear();
    double mean = 0.0;
    const std::size_t first = all.values.size();
    for (const ResponseObservation& o : data.spot(i)) {
      const double exposure = response.ExposureFromValue(channel, static_cast<double>(o.value));
      if (exposure <= 0.0) continue;
      ln.push_back(std::log(exposure) - std::log(samples.seconds[o.exposure]));
      mean += ln.back();
      all.values.push_back(o.value);
      all.exposure.push_back(o.exposure);
    }
    if (ln.size() < 2) {
      all.values.resize(first);
      all.exposure.resize(first);
      continue;
    }
    mean /= static_cast<double>(ln.size());
    for (const double value : ln) {
      all.residuals.push_back(value - mean);
      all.mean.push_back(mean);
      all.spot_size.push_back(ln.size());
    }
  }
  return all;
}

// Observations far from their spot's median, by the scatter of their value; the means are then
// those of the others. Returns the scatter.
Scatter MarkOutliers(Disagreement* all) {
  const std::size_t count = all->values.size();
  std::vector<double> single(count);
  std::vector<double> sorted;
  for (std::size_t k = 0; k < count; k += all->spot_size[k]) {
    const std::size_t n = all->spot_size[k];
    sorted.assign(all->residuals.begin() + static_cast<std::ptrdiff_t>(k),
                  all->residuals.begin() + static_cast<std::ptrdiff_t>(k + n));
    std::sort(sorted.begin(), sorted.end());
    const double median = 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]);
    const double own = std::sqrt(static_cast<double>(n) / static_cast<double>(n - 1));
    for (std::size_t i = k; i < k + n; ++i) single[i] = (all->residuals[i] - median) * own;
  }
  const Scatter scatter(all->values, single);
  all->outlier.resize(count);
  for (std::size_t k = 0; k < count; ++k) {
    all->outlier[k] = response_fit::Tukey(single[k] / scatter.At(all->values[k])) == 0.0;
  }
  for (std::size_t k = 0; k < count; k += all->spot_size[k]) {
    double shift = 0.0;
    double kept = 0.0;
    for (std::size_t i = k; i < k + all->spot_size[k]; ++i) {
      if (all->outlier[i]) continue;
      shift += all->residuals[i];
      kept += 1.0;
    }
    if (kept == 0.0) continue;
    for (std::size_t i = k; i < k + all->spot_size[k]; ++i) {
      all->residuals[i] -= shift / kept;
      all->mean[i] += shift / kept;
    }
  }
  return scatter;
}

struct Bias {
  double sum = 0.0;
  std::size_t count = 0;
};

ResponseCurve Describe(const Fit& fit, const ResponseSamples& samples, int channel,
                       std::vector<Bias>* bias) {
  const auto c = static_cast<std::size_t>(channel);
  ResponseCurve curve;
  const double reference = fit.response.ExposureFromValue(channel, response_fit::kReferenceValue);
  for (int z = 0; z < 256; ++z) {
    const double exposure = fit.response.ExposureFromValue(channel, z);
    // Nothing at the black level and below: a step of the value, as small as the range has any.
    const double least = 1e-3 * fit.response.Slope(channel, response_fit::kReferenceValue);
    curve.ln_exposure[static_cast<std::size_t>(z)] =
        std::log(std::max(exposure, least) / reference);
  }
  curve.standard_error = fit.standard_error[c];
  const Support support = response_fit::SupportOf(samples.channels[c]);
  curve.measured_low = support.low;
  curve.measured_high = support.high;
  curve.spots = samples.channels[c].size();
  curve.observations = samples.channels[c].observations.size();

  Disagreement all = DisagreementOf(fit.response, samples, channel);
  const Scatter scatter = MarkOutliers(&all);
  for (std::size_t z = 0; z < 256; ++z) curve.spread[z] = scatter.At(static_cast<float>(z));
  double mean_value = 0.0;
  for (const float z : all.values) mean_value += static_cast<double>(z);
  mean_value /= static_cast<double>(std::max<std::size_t>(1, all.values.size()));
  double unexplained = 0.0;
  double total = 0.0;
  double squares = 0.0;
  for (std::size_t k = 0; k < all.values.size(); ++k) {
    if (all.outlier[k]) {
      ++curve.outliers;
      continue;
    }
    const auto z = static_cast<double>(all.values[k]);
    const double predicted = fit.response.ValueFromExposure(
        channel, std::exp(all.mean[k]) * samples.seconds[all.exposure[k]]);
    unexplained += (z - predicted) * (z - predicted);
    total += (z - mean_value) * (z - mean_value);
    squares += all.residuals[k] * all.residuals[k];
    const double stops = all.residuals[k] / std::numbers::ln2;
    (*bias)[all.exposure[k]].sum += stops;
    ++(*bias)[all.exposure[k]].count;
  }
  const auto kept =
      static_cast<double>(std::max<std::size_t>(1, all.values.size() - curve.outliers));
  curve.r_squared = total > 0.0 ? 1.0 - unexplained / total : 0.0;
  curve.residual_stops = std::sqrt(squares / kept) / std::numbers::ln2;
  return curve;
}

}  // namespace

std::string_view ToString(ResponseMethod method) {
  switch (method) {
    case ResponseMethod::kDebevec:
      return "debevec";
    case ResponseMethod::kRobertson:
      return "robertson";
    case ResponseMethod::kLinear:
      return "linear";
    case ResponseMethod::kLogLinear:
      return "loglinear";
  }
  return "?";
}

std::optional<ResponseMethod> ResponseMethodFromString(std::string_view name) {
  for (const ResponseMethod method : {ResponseMethod::kDebevec, ResponseMethod::kRobertson,
                                      ResponseMethod::kLinear, ResponseMethod::kLogLinear}) {
    if (name == ToString(method)) return method;
  }
  return std::nullopt;
}

Status ResponseCalibrationOptions::Validate() const {
  if (!(bend >= 0.001 && bend <= 1000.0)) {
    return Fail(ErrorKind::kConfig, "bend {}, expected 0.001 to 1000", bend);
  }
  if (weight_turns < 1 || weight_turns > 100 || curve_turns < 1 || curve_turns > 10000) {
    return Fail(ErrorKind::kConfig, "{} and {} turns, expected 1 to 100 and 1 to 10000",
                weight_turns, curve_turns);
  }
  return {};
}

Result<ResponseCalibration> CalibrateResponse(const ResponseSamples& samples,
                                              const ResponseCalibrationOptions& options) {
  OMNIHDR_TRY(options.Validate());
  OMNIHDR_TRY(CheckSamples(samples));
  for (std::size_t c = 0; c < 3; ++c) {
    const Support support = response_fit::SupportOf(samples.channels[c]);
    if (support.high - support.low < kLeastCoverage) {
      return Fail(ErrorKind::kData,
                  "channel {}: values from {} to {} only, expected a range of at least {}: take "
                  "pictures of more contrast or at more exposures",
                  "RGB"[c], support.low, support.high, kLeastCoverage);
    }
  }
  OMNIHDR_TRY(CheckMethod(samples, options.method));
  OMNIHDR_ASSIGN(const Fit trial, FitAny(Part(samples, false), options));
  OMNIHDR_ASSIGN(const Fit fit, FitAny(samples, options));
  ResponseCalibration calibration;
  calibration.response = fit.response;
  calibration.held_out_stops = ResidualStops(trial.response, Part(samples, true));
  calibration.all_stops = ResidualStops(fit.response, samples);
  std::vector<Bias> bias(samples.seconds.size());
  double squares = 0.0;
  double kept = 0.0;
  for (int c = 0; c < 3; ++c) {
    ResponseCurve& curve = calibration.curves[static_cast<std::size_t>(c)];
    curve = Describe(fit, samples, c, &bias);
    // Worse than one value for all: what was fitted is not how these values came about.
    if (curve.r_squared < 0.0) {
      return Fail(ErrorKind::kData,
                  "channel {}: a {} fit explains nothing of the values (R squared {:.2f}, expected "
                  "above 0), residual {:.2f} stops: these values are not {}",
                  "RGB"[c], ToString(options.method), curve.r_squared, curve.residual_stops,
                  options.method == ResponseMethod::kLinear ? "linear" : "of this form");
    }
    const auto used = static_cast<double>(curve.observations - curve.outliers);
    squares += used * curve.residual_stops * curve.residual_stops;
    kept += used;
  }
  calibration.residual_stops = std::sqrt(squares / std::max(1.0, kept));
  for (const Bias& b : bias) {
    calibration.exposure_bias_stops.push_back(b.count == 0 ? 0.0
                                                           : b.sum / static_cast<double>(b.count));
  }
  return calibration;
}

double ResidualStops(const Response& response, const ResponseSamples& samples, int channel) {
  double squares = 0.0;
  std::size_t count = 0;
  for (int c = 0; c < 3; ++c) {
    if (channel >= 0 && c != channel) continue;
    const Disagreement all = DisagreementOf(response, samples, c);
    for (const double r : all.residuals) squares += r * r;
    count += all.residuals.size();
  }
  return count == 0 ? 0.0 : std::sqrt(squares / static_cast<double>(count)) / std::numbers::ln2;
}

}  // namespace omnihdr
