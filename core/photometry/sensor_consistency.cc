#include "core/photometry/sensor_consistency.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <set>

namespace omnihdr {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

struct Point {
  double seconds;
  double value;
};

ExposureLine FitLine(const std::vector<Point>& points) {
  ExposureLine line;
  line.points = static_cast<int>(points.size());
  const double n = static_cast<double>(points.size());
  double mean_t = 0.0;
  double mean_v = 0.0;
  double largest = 0.0;
  for (const Point& p : points) {
    mean_t += p.seconds / n;
    mean_v += p.value / n;
    largest = std::max(largest, p.value);
  }
  double tt = 0.0;
  double tv = 0.0;
  double vv = 0.0;
  std::set<double> different;
  for (const Point& p : points) {
    tt += (p.seconds - mean_t) * (p.seconds - mean_t);
    tv += (p.seconds - mean_t) * (p.value - mean_v);
    vv += (p.value - mean_v) * (p.value - mean_v);
    different.insert(p.seconds);
  }
  if (different.size() < 3 || !(vv > 0.0)) return line;
  line.fitted = true;
  line.slope = tv / tt;
  const double offset = mean_v - line.slope * mean_t;
  line.offset = offset / largest;
  double residual = 0.0;
  for (const Point& p : points) {
    const double r = p.value - offset - line.slope * p.seconds;
    residual += r * r;
    line.deviation = std::max(line.deviation, std::abs(r) / largest);
  }
  line.r_squared = 1.0 - residual / vv;
  return line;
}

void FitLines(std::span<const SensorChart> charts, int sensor, SensorReport* report) {
  std::set<double> exposures;
  for (const SensorChart& chart : charts) {
    if (chart.sensor != sensor) continue;
    ++report->pictures;
    exposures.insert(chart.seconds);
  }
  report->exposures = static_cast<int>(exposures.size());
  for (std::size_t c = 0; c < 3; ++c) {
    double least = std::numeric_limits<double>::infinity();
    double sum = 0.0;
    double worst = 0.0;
    int fitted = 0;
    for (std::size_t p = 0; p < kChartPatches; ++p) {
      std::vector<Point> points;
      for (const SensorChart& chart : charts) {
        if (chart.sensor != sensor || !chart.chart[p][c].usable) continue;
        points.push_back({chart.seconds, chart.chart[p][c].exposure});
      }
      ExposureLine& line = report->lines[p][c];
      line = FitLine(points);
      if (!line.fitted) continue;
      ++fitted;
      least = std::min(least, line.r_squared);
      sum += line.r_squared;
      worst = std::max(worst, line.deviation);
    }
    report->least_r_squared[c] = fitted > 0 ? least : kNaN;
    report->mean_r_squared[c] = fitted > 0 ? sum / fitted : kNaN;
    report->worst_deviation[c] = fitted > 0 ? worst : kNaN;
  }
}

constexpr std::size_t kGreys = kChartPatches - kChartFirstGrey;

// ln E of a grey patch, and the variance of it; NaN where no picture shows it usable.
struct GreyLight {
  double ln = kNaN;
  double variance = 0.0;
};
using GreyRow = std::array<std::array<GreyLight, 3>, kGreys>;

GreyRow GreyRowOf(std::span<const SensorChart> charts, int sensor) {
  GreyRow row;
  for (std::size_t g = 0; g < kGreys; ++g) {
    for (std::size_t c = 0; c < 3; ++c) {
      double weights = 0.0;
      double sum = 0.0;
      for (const SensorChart& chart : charts) {
        const PatchChannel& patch = chart.chart[kChartFirstGrey + g][c];
        if (chart.sensor != sensor || !patch.usable) continue;
        const double noise = patch.exposure_error / patch.exposure;
        const double black = 0.25 / std::max(patch.mean, 1.0);
        const double weight = 1.0 / (noise * noise + black * black + 1e-6);
        weights += weight;
        sum += weight * std::log(patch.exposure / chart.seconds);
      }
      if (weights > 0.0) row[g][c] = {sum / weights, 1.0 / weights + 2.5e-5};
    }
  }
  return row;
}

struct TwoWay {
  std::array<double, kGreys> patch{};  // NaN where no sensor sees it
  std::array<double, kGreys> patch_variance{};
  std::vector<double> sensor;
};

// ln E = patch − sensor's ln gain; alternating weighted means, which converge to least squares.
TwoWay SolveTwoWay(const std::vector<GreyRow>& rows, std::size_t c) {
  TwoWay model;
  model.sensor.assign(rows.size(), 0.0);
  for (int iteration = 0; iteration < 200; ++iteration) {
    for (std::size_t g = 0; g < kGreys; ++g) {
      double weights = 0.0;
      double sum = 0.0;
      for (std::size_t s = 0; s < rows.size(); ++s) {
        const GreyLight& light = rows[s][g][c];
        if (std::isnan(light.ln)) continue;
        weights += 1.0 / light.variance;
        sum += (light.ln + model.sensor[s]) / light.variance;
      }
      model.patch[g] = weights > 0.0 ? sum / weights : kNaN;
      model.patch_variance[g] = 1.0 / weights;
    }
    double change = 0.0;
    double mean = 0.0;
    for (std::size_t s = 0; s < rows.size(); ++s) {
      double weights = 0.0;
      double sum = 0.0;
      for (std::size_t g = 0; g < kGreys; ++g) {
        const GreyLight& light = rows[s][g][c];
        if (std::isnan(light.ln)) continue;
        weights += 1.0 / light.variance;
        sum += (model.patch[g] - light.ln) / light.variance;
      }
      const double next = sum / weights;
      change = std::max(change, std::abs(next - model.sensor[s]));
      model.sensor[s] = next;
      mean += next / static_cast<double>(rows.size());
    }
    for (double& gain : model.sensor) gain -= mean;
    for (double& patch : model.patch) patch -= mean;
    if (change < 1e-12) break;
  }
  return model;
}

void AddDifferences(const std::vector<GreyRow>& rows,
                    const std::vector<std::array<double, 3>>& gain, bool after,
                    SensorConsistency* out) {
  for (std::size_t c = 0; c < 3; ++c) {
    double& worst = (after ? out->worst_difference_after : out->worst_difference)[c];
    worst = rows.size() > 1 ? 0.0 : kNaN;
    for (std::size_t g = 0; g < kGreys; ++g) {
      double mean = 0.0;
      int seen = 0;
      for (std::size_t s = 0; s < rows.size(); ++s) {
        if (std::isnan(rows[s][g][c].ln)) continue;
        mean += std::exp(rows[s][g][c].ln) * gain[s][c];
        ++seen;
      }
      for (std::size_t s = 0; s < rows.size(); ++s) {
        double difference = kNaN;
        if (seen > 1 && !std::isnan(rows[s][g][c].ln)) {
          difference = std::exp(rows[s][g][c].ln) * gain[s][c] / (mean / seen) - 1.0;
          worst = std::max(worst, std::abs(difference));
        }
        SensorReport& report = out->sensors[s];
        (after ? report.difference_after : report.difference)[kChartFirstGrey + g][c] = difference;
      }
    }
  }
}

}  // namespace

Result<SensorConsistency> CompareSensors(std::span<const SensorChart> charts,
                                         const std::vector<std::string>& names) {
  if (charts.empty() || names.empty()) {
    return Fail(ErrorKind::kData, "sensors: no chart was measured");
  }
  for (const SensorChart& chart : charts) {
    if (!(chart.seconds > 0.0) || !std::isfinite(chart.seconds)) {
      return Fail(ErrorKind::kData, "sensors: exposure {:g} s, expected more than 0",
                  chart.seconds);
    }
  }
  SensorConsistency out;
  out.sensors.resize(names.size());
  std::vector<GreyRow> rows;
  for (std::size_t s = 0; s < names.size(); ++s) {
    SensorReport& report = out.sensors[s];
    FitLines(charts, static_cast<int>(s), &report);
    for (auto& patch : report.difference) patch.fill(kNaN);
    for (auto& patch : report.difference_after) patch.fill(kNaN);
    rows.push_back(GreyRowOf(charts, static_cast<int>(s)));
    for (std::size_t c = 0; c < 3; ++c) {
      const auto usable = std::count_if(rows[s].begin(), rows[s].end(),
                                        [c](const auto& grey) { return !std::isnan(grey[c].ln); });
      if (usable >= 2) continue;
      static constexpr std::array<std::string_view, 3> kChannels = {"red", "green", "blue"};
      return Fail(ErrorKind::kData,
                  "sensor {}: {} grey patches usable in {} over {} pictures, expected at least 2: "
                  "the others are clipped or dark",
                  names[s], usable, kChannels[c], report.pictures);
    }
  }
  std::array<TwoWay, 3> models;
  for (std::size_t c = 0; c < 3; ++c) models[c] = SolveTwoWay(rows, c);
  std::vector<std::array<double, 3>> gains(rows.size());
  for (std::size_t c = 0; c < 3; ++c) {
    // The grey row is grey: what is left between a channel and green is the white balance.
    double balance = 0.0;
    double both = 0.0;
    for (std::size_t g = 0; g < kGreys; ++g) {
      const double d = models[1].patch[g] - models[c].patch[g];
      if (std::isnan(d)) continue;
      const double weight = 1.0 / (models[1].patch_variance[g] + models[c].patch_variance[g]);
      balance += weight * d;
      both += weight;
    }
    if (both > 0.0) balance /= both;
    for (std::size_t s = 0; s < rows.size(); ++s) {
      gains[s][c] = std::exp(models[c].sensor[s] + balance);
      out.sensors[s].gain[c] = gains[s][c];
      double weights = 0.0;
      double chi2 = 0.0;
      int n = 0;
      for (std::size_t g = 0; g < kGreys; ++g) {
        const GreyLight& light = rows[s][g][c];
        if (std::isnan(light.ln)) continue;
        const double r = light.ln + models[c].sensor[s] - models[c].patch[g];
        weights += 1.0 / light.variance;
        chi2 += r * r / light.variance;
        ++n;
      }
      out.sensors[s].gain_error[c] = std::sqrt(std::max(1.0, chi2 / (n - 1)) / weights);
    }
  }
  AddDifferences(rows, std::vector<std::array<double, 3>>(rows.size(), {1.0, 1.0, 1.0}), false,
                 &out);
  AddDifferences(rows, gains, true, &out);
  for (std::size_t c = 0; c < 3; ++c) {
    if (out.worst_difference_after[c] > 0.05) {
      out.warnings.push_back(fmt::format(
          "after the gains the sensors still differ by {:.1f} % in {}: the light on the chart "
          "changed, or falls unevenly, or one of the sensors is not linear",
          100.0 * out.worst_difference_after[c], c == 0 ? "red" : (c == 1 ? "green" : "blue")));
    }
  }
  return out;
}

}  // namespace omnihdr
