#include "core/photometry/response_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace omnihdr::response_fit {
namespace {

// The value's two nodes and their weights.
struct Nodes {
  int first = 0;  // and the next
  double weight_first = 1.0;
  double weight_next = 0.0;
};

Nodes NodesOf(float value, const Support& support) {
  Nodes nodes;
  nodes.first = std::clamp(static_cast<int>(value), support.low, support.high - 1);
  nodes.weight_next = static_cast<double>(value) - nodes.first;
  nodes.weight_first = 1.0 - nodes.weight_next;
  nodes.first -= support.low;
  return nodes;
}

// Standard deviation of ln E of one observation before anything is known.
constexpr double kFirstScatter = 0.1;

// Debevec and Malik's hat, eq. 4, in [0, 1].
double Hat(double value) { return std::max(0.0, std::min(value, 255.0 - value) / 127.5); }

double Median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Residuals for the scatter, from the plain mean of a spot's observations that count, made good for
// the share of each in that mean. Not from the weighted mean: weights that follow their own
// residuals end with all weight on a few values.
template <typename Residual>
void PlainResiduals(const ResponseSamples::Channel& channel, const std::vector<double>& weight,
                    const Residual& residual, std::vector<double>* out) {
  out->assign(weight.size(), 0.0);
  for (std::size_t i = 0; i < channel.size(); ++i) {
    double sum = 0.0;
    double n = 0.0;
    for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
      (*out)[k] = residual(channel.observations[k]);
      if (weight[k] <= 0.0) continue;
      sum += (*out)[k];
      n += 1.0;
    }
    const double mean = n > 0.0 ? sum / n : 0.0;
    const double correction = n > 1.0 ? std::sqrt(n / (n - 1.0)) : 1.0;
    for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
      (*out)[k] = ((*out)[k] - mean) * correction;
    }
  }
}

Scatter ScatterOf(const ResponseSamples::Channel& channel, const std::vector<double>& weight,
                  const std::vector<double>& residuals) {
  std::vector<float> values;
  std::vector<double> counted;
  for (std::size_t k = 0; k < weight.size(); ++k) {
    if (weight[k] <= 0.0) continue;
    values.push_back(channel.observations[k].value);
    counted.push_back(residuals[k]);
  }
  return {values, counted};
}

// Differences between neighbouring values, above 0.
Eigen::VectorXd Steps(const Eigen::VectorXd& g) {
  constexpr double kLeastStep = 1e-5;
  const Eigen::Index n = g.size();
  return (g.tail(n - 1) - g.head(n - 1)).cwiseMax(kLeastStep);
}

// Debevec and Malik's penalty on g'', for a start.
void AddCurvature(const Support& support, Eigen::MatrixXd* a) {
  constexpr double kCurvature = 4e-4;  // a film's at mid-range, ln E per squared value
  constexpr std::array<double, 3> kSecond = {1.0, -2.0, 1.0};
  for (int k = 0; k + 2 < support.size(); ++k) {
    const double hat = Hat(support.low + k + 1);
    const double weight = hat * hat / (kCurvature * kCurvature);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        (*a)(k + i, k + j) +=
            weight * kSecond[static_cast<std::size_t>(i)] * kSecond[static_cast<std::size_t>(j)];
      }
    }
  }
}

// The penalty on the second derivative of ln g' by ln Z, linearised at `steps` (Gauss-Newton):
// ln s' = ln s + (s' − s)/s of each step s.
void AddBend(const Support& support, const Eigen::VectorXd& steps, double bend, Eigen::MatrixXd* a,
             Eigen::VectorXd* b) {
  for (int k = 0; k + 3 < support.size(); ++k) {
    std::array<double, 3> u{};
    for (int i = 0; i < 3; ++i) {
      u[static_cast<std::size_t>(i)] = std::log(support.low + k + i + 0.5);
    }
    const double span = 0.5 * (u[2] - u[0]);
    const std::array<double, 3> second = {
        1.0 / ((u[1] - u[0]) * span), -1.0 / ((u[1] - u[0]) * span) - 1.0 / ((u[2] - u[1]) * span),
        1.0 / ((u[2] - u[1]) * span)};
    std::array<double, 4> row{};
    double target = 0.0;
    for (std::size_t i = 0; i < 3; ++i) {
      const double step = steps[k + static_cast<Eigen::Index>(i)];
      row[i] -= second[i] / step;
      row[i + 1] += second[i] / step;
      target -= second[i] * (std::log(step) - 1.0);
    }
    const double weight = span / (bend * bend);
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 4; ++j) {
        (*a)(k + i, k + j) +=
            weight * row[static_cast<std::size_t>(i)] * row[static_cast<std::size_t>(j)];
      }
      (*b)[k + i] += weight * row[static_cast<std::size_t>(i)] * target;
    }
  }
}

// d ln E / d ln Z at one end of the measured curve.
double EndPower(const Eigen::VectorXd& g, const Support& support, bool at_low_end) {
  const int span = std::min(12, support.size() - 1);
  const int from = at_low_end ? 0 : support.size() - 1 - span;
  const int to = from + span;
  const double z_from = std::max(support.low + from, 1);
  return (g[to] - g[from]) / std::log((support.low + to) / z_from);
}

}  // namespace

Support SupportOf(const ResponseSamples::Channel& channel) {
  constexpr double kFew = 4.0;
  std::array<double, 256> count{};
  for (const ResponseObservation& o : channel.observations) {
    ++count[static_cast<std::size_t>(std::clamp(o.value, 0.0F, 255.0F))];
  }
  Support support;
  double sum = 0.0;
  while (support.low < 254 && (sum += count[static_cast<std::size_t>(support.low)]) < kFew) {
    ++support.low;
  }
  sum = 0.0;
  while (support.high > support.low + 1 &&
         (sum += count[static_cast<std::size_t>(support.high)]) < kFew) {
    --support.high;
  }
  return support;
}

Scatter::Scatter(std::span<const float> values, std::span<const double> residuals) {
  constexpr std::size_t kEnough = 20;
  std::array<std::vector<double>, kBins> bins;
  std::vector<double> all;
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double size = std::abs(residuals[k]);
    bins[static_cast<std::size_t>(std::clamp(values[k], 0.0F, 255.0F) * (kBins / 256.0F))]
        .push_back(size);
    all.push_back(size);
  }
  constexpr double kOfMedian = 1.4826;
  constexpr double kLeast = 1e-4;
  const double overall = all.empty() ? 1.0 : std::max(kLeast, kOfMedian * Median(all));
  for (std::size_t k = 0; k < kBins; ++k) {
    sigma_[k] = bins[k].size() < kEnough ? overall : std::max(kLeast, kOfMedian * Median(bins[k]));
  }
}

double Scatter::At(float value) const {
  const double position =
      std::clamp(static_cast<double>(value) * kBins / 256.0 - 0.5, 0.0, kBins - 1.0);
  const auto first = static_cast<std::size_t>(std::min(position, kBins - 2.0));
  const double f = position - static_cast<double>(first);
  return sigma_[first] * (1.0 - f) + sigma_[first + 1] * f;
}

double Tukey(double normalised) {
  constexpr double kCut = 4.685;
  const double r = normalised / kCut;
  if (std::abs(r) >= 1.0) return 0.0;
  const double s = 1.0 - r * r;
  return s * s;
}

Curve SolveCurve(const CurveSystem& system, double bend, const Curve* start) {
  const Support& support = system.support;
  const int n = support.size();
  const double unit = std::max(system.a.trace() / n, 1e-12);
  Eigen::MatrixXd data = system.a;
  // A constant on g is free: fixed where it will be 0. The rest keeps empty nodes solvable.
  const int anchor = std::clamp(kReferenceValue, support.low, support.high) - support.low;
  data(anchor, anchor) += 1e6 * unit;
  data.diagonal().array() += 1e-9 * unit;

  Eigen::VectorXd g(n);
  if (start != nullptr) {
    for (int k = 0; k < n; ++k) g[k] = start->g[static_cast<std::size_t>(support.low + k)];
  } else {
    Eigen::MatrixXd a = data;
    AddCurvature(support, &a);
    g = a.llt().solve(system.b);
  }
  Eigen::LLT<Eigen::MatrixXd> solver;
  const int turns = start != nullptr ? 3 : 10;
  for (int turn = 0; turn < turns; ++turn) {
    Eigen::VectorXd steps = Steps(g);
    Eigen::MatrixXd a = data;
    Eigen::VectorXd b = system.b;
    AddBend(support, steps, bend, &a, &b);
    solver.compute(a);
    const Eigen::VectorXd next = solver.solve(b);
    // A step may shrink or grow to what its logarithm still describes, never to nothing.
    for (int k = 0; k + 1 < n; ++k) {
      steps[k] = std::clamp(next[k + 1] - next[k], 0.3 * steps[k], 3.0 * steps[k]);
    }
    g[anchor] = 0.0;
    for (int k = anchor; k + 1 < n; ++k) g[k + 1] = g[k] + steps[k];
    for (int k = anchor; k > 0; --k) g[k - 1] = g[k] - steps[k - 1];
  }
  Curve curve;
  const Eigen::VectorXd variance =
      solver.solve(Eigen::MatrixXd::Identity(n, n)).diagonal().cwiseMax(0.0);

  const double low_power = EndPower(g, support, true);
  const double high_power = EndPower(g, support, false);
  for (int z = 0; z < 256; ++z) {
    const auto k = static_cast<std::size_t>(z);
    // A value of 0 stands for light between nothing and half a step.
    const double value = z == 0 ? 0.5 : z;
    if (z < support.low) {
      curve.g[k] = g[0] + low_power * std::log(value / support.low);
    } else if (z > support.high) {
      curve.g[k] = g[n - 1] + high_power * std::log(value / support.high);
    } else {
      curve.g[k] = g[z - support.low];
    }
    // Beyond what was measured, as uncertain as the distance is long.
    const int inside = std::clamp(z, support.low, support.high);
    const double away = std::abs(std::log(value / std::max(inside, 1)));
    curve.standard_error[k] = std::sqrt(variance[inside - support.low] + 0.04 * away * away);
  }
  const double zero = curve.g[kReferenceValue];
  for (double& value : curve.g) value -= zero;
  return curve;
}

double Interpolate(const std::array<double, 256>& g, float value) {
  const Nodes nodes = NodesOf(value, {0, 255});
  const auto k = static_cast<std::size_t>(nodes.first);
  return g[k] * nodes.weight_first + g[k + 1] * nodes.weight_next;
}

Curve FitDebevec(const ResponseSamples::Channel& channel, std::span<const double> seconds,
                 double bend, int turns) {
  const Support support = SupportOf(channel);
  std::vector<double> weight(channel.observations.size());
  for (std::size_t k = 0; k < weight.size(); ++k) {
    const double hat = Hat(static_cast<double>(channel.observations[k].value));
    weight[k] = support.Contains(channel.observations[k].value)
                    ? hat * hat / (kFirstScatter * kFirstScatter)
                    : 0.0;
  }
  Curve curve;
  std::vector<Nodes> nodes;
  std::vector<double> residuals;
  for (int turn = 0; turn < turns; ++turn) {
    CurveSystem system(support);
    for (std::size_t i = 0; i < channel.size(); ++i) {
      // ln E of the spot is the weighted mean of g(Z) − ln t: put in, it leaves a rank-one term.
      double sum = 0.0;
      double sum_ln = 0.0;
      for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
        sum += weight[k];
        sum_ln += weight[k] * std::log(seconds[channel.observations[k].exposure]);
      }
      if (sum <= 0.0) continue;
      nodes.clear();
      for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
        nodes.push_back(NodesOf(channel.observations[k].value, support));
      }
      for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
        if (weight[k] == 0.0) continue;
        const Nodes& p = nodes[k - channel.begin[i]];
        const double ln_t = std::log(seconds[channel.observations[k].exposure]);
        const double right = weight[k] * (ln_t - sum_ln / sum);
        system.b[p.first] += p.weight_first * right;
        system.b[p.first + 1] += p.weight_next * right;
        for (std::size_t l = channel.begin[i]; l < channel.begin[i + 1]; ++l) {
          const double w = (k == l ? weight[k] : 0.0) - weight[k] * weight[l] / sum;
          const Nodes& q = nodes[l - channel.begin[i]];
          system.a(p.first, q.first) += w * p.weight_first * q.weight_first;
          system.a(p.first, q.first + 1) += w * p.weight_first * q.weight_next;
          system.a(p.first + 1, q.first) += w * p.weight_next * q.weight_first;
          system.a(p.first + 1, q.first + 1) += w * p.weight_next * q.weight_next;
        }
      }
    }
    curve = SolveCurve(system, bend, turn == 0 ? nullptr : &curve);

    PlainResiduals(
        channel, weight,
        [&](const ResponseObservation& o) {
          return Interpolate(curve.g, o.value) - std::log(seconds[o.exposure]);
        },
        &residuals);
    const Scatter scatter = ScatterOf(channel, weight, residuals);
    for (std::size_t k = 0; k < weight.size(); ++k) {
      const float value = channel.observations[k].value;
      if (!support.Contains(value)) continue;
      const double sigma = scatter.At(value);
      weight[k] = Tukey(residuals[k] / sigma) / (sigma * sigma);
    }
  }
  return curve;
}

Curve FitRobertson(const ResponseSamples::Channel& channel, std::span<const double> seconds,
                   double bend, int turns) {
  const Support support = SupportOf(channel);
  const auto n = static_cast<std::size_t>(support.size());
  // Their weight: a bell over the range, nothing at its ends.
  const auto bell = [](double z) {
    const double x = (z - 127.5) / 127.5;
    return (std::exp(-4.0 * x * x) - std::exp(-4.0)) / (1.0 - std::exp(-4.0));
  };
  std::vector<double> x(n);
  for (std::size_t k = 0; k < n; ++k) {
    x[k] = std::max(0.5, support.low + static_cast<double>(k)) / kReferenceValue;
  }
  const auto anchor = static_cast<std::size_t>(
      std::clamp(kReferenceValue, support.low, support.high) - support.low);
  std::vector<double> sum(n);
  std::vector<double> count(n);
  std::vector<double> squares(n);
  for (int turn = 0; turn < turns; ++turn) {
    std::fill(sum.begin(), sum.end(), 0.0);
    std::fill(count.begin(), count.end(), 0.0);
    std::fill(squares.begin(), squares.end(), 0.0);
    for (std::size_t i = 0; i < channel.size(); ++i) {
      double light = 0.0;
      double time = 0.0;
      for (const ResponseObservation& o : channel.spot(i)) {
        if (!support.Contains(o.value)) continue;
        const Nodes p = NodesOf(o.value, support);
        const auto k = static_cast<std::size_t>(p.first);
        const double t = seconds[o.exposure];
        const double w = bell(static_cast<double>(o.value));
        light += w * t * (x[k] * p.weight_first + x[k + 1] * p.weight_next);
        time += w * t * t;
      }
      if (time <= 0.0) continue;
      for (const ResponseObservation& o : channel.spot(i)) {
        if (!support.Contains(o.value)) continue;
        const Nodes p = NodesOf(o.value, support);
        const auto k = static_cast<std::size_t>(p.first);
        const double exposure = seconds[o.exposure] * light / time;
        // The part of the exposure that is this node's, were the curve as it is.
        const double own = x[k] * p.weight_first + x[k + 1] * p.weight_next;
        const double ratio = exposure / own;
        sum[k] += p.weight_first * x[k] * ratio;
        count[k] += p.weight_first;
        sum[k + 1] += p.weight_next * x[k + 1] * ratio;
        count[k + 1] += p.weight_next;
        const double r = std::log(ratio);
        squares[k] += p.weight_first * r * r;
        squares[k + 1] += p.weight_next * r * r;
      }
    }
    double change = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      if (count[k] <= 0.0) continue;
      const double next = sum[k] / count[k];
      change = std::max(change, std::abs(next / x[k] - 1.0));
      x[k] = next;
    }
    const double scale = x[anchor];
    for (double& value : x) value /= scale;
    if (change < 1e-6) break;
  }
  CurveSystem system(support);
  for (std::size_t k = 0; k < n; ++k) {
    if (count[k] <= 0.0) continue;
    const double weight = count[k] / std::max(squares[k] / count[k], 1e-8);
    const auto i = static_cast<Eigen::Index>(k);
    system.a(i, i) = weight;
    system.b[i] = weight * std::log(x[k]);
  }
  return SolveCurve(system, bend, nullptr);
}

Fitted FitBlack(const ResponseSamples& samples, int turns) {
  std::array<std::vector<double>, 3> weight;
  for (std::size_t c = 0; c < 3; ++c) {
    weight[c].assign(samples.channels[c].observations.size(), 1.0);
  }
  Fitted fitted;
  std::vector<double> residuals;
  for (int turn = 0; turn < turns; ++turn) {
    double left = 0.0;
    double right = 0.0;
    for (std::size_t c = 0; c < 3; ++c) {
      const ResponseSamples::Channel& channel = samples.channels[c];
      for (std::size_t i = 0; i < channel.size(); ++i) {
        double w = 0.0;
        double wt = 0.0;
        double wtt = 0.0;
        double wz = 0.0;
        double wtz = 0.0;
        for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
          const double t = samples.seconds[channel.observations[k].exposure];
          const auto z = static_cast<double>(channel.observations[k].value);
          w += weight[c][k];
          wt += weight[c][k] * t;
          wtt += weight[c][k] * t * t;
          wz += weight[c][k] * z;
          wtz += weight[c][k] * t * z;
        }
        if (wtt <= 0.0) continue;
        left += w - wt * wt / wtt;
        right += wz - wt * wtz / wtt;
      }
    }
    if (left <= 0.0) break;
    fitted.value = right / left;
    fitted.standard_error = 1.0 / std::sqrt(left);
    for (std::size_t c = 0; c < 3; ++c) {
      const ResponseSamples::Channel& channel = samples.channels[c];
      const auto light = [&](const ResponseObservation& o) {
        return std::max(static_cast<double>(o.value) - fitted.value, 0.5);
      };
      PlainResiduals(
          channel, weight[c],
          [&](const ResponseObservation& o) {
            return std::log(light(o) / samples.seconds[o.exposure]);
          },
          &residuals);
      const Scatter scatter = ScatterOf(channel, weight[c], residuals);
      for (std::size_t k = 0; k < weight[c].size(); ++k) {
        const ResponseObservation& o = channel.observations[k];
        const double relative = scatter.At(o.value);
        const double sigma = relative * light(o);
        weight[c][k] = Tukey(residuals[k] / relative) / (sigma * sigma);
      }
    }
  }
  return fitted;
}

Fitted FitLogSlope(const ResponseSamples::Channel& channel, std::span<const double> seconds,
                   int turns) {
  std::vector<double> weight(channel.observations.size(), 1.0);
  Fitted fitted;
  std::vector<double> residuals;
  for (int turn = 0; turn < turns; ++turn) {
    double left = 0.0;
    double right = 0.0;
    for (std::size_t i = 0; i < channel.size(); ++i) {
      double w = 0.0;
      double wx = 0.0;
      double wz = 0.0;
      for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
        w += weight[k];
        wx += weight[k] * std::log(seconds[channel.observations[k].exposure]);
        wz += weight[k] * static_cast<double>(channel.observations[k].value);
      }
      if (w <= 0.0) continue;
      for (std::size_t k = channel.begin[i]; k < channel.begin[i + 1]; ++k) {
        const double x = std::log(seconds[channel.observations[k].exposure]) - wx / w;
        left += weight[k] * x * x;
        right += weight[k] * x * (static_cast<double>(channel.observations[k].value) - wz / w);
      }
    }
    if (left <= 0.0) break;
    fitted.value = right / left;
    fitted.standard_error = 1.0 / std::sqrt(left);
    PlainResiduals(
        channel, weight,
        [&](const ResponseObservation& o) {
          return static_cast<double>(o.value) - fitted.value * std::log(seconds[o.exposure]);
        },
        &residuals);
    const Scatter scatter = ScatterOf(channel, weight, residuals);
    for (std::size_t k = 0; k < weight.size(); ++k) {
      const double sigma = scatter.At(channel.observations[k].value);
      weight[k] = Tukey(residuals[k] / sigma) / (sigma * sigma);
    }
  }
  return fitted;
}

}  // namespace omnihdr::response_fit
