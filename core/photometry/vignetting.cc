#include "core/photometry/vignetting.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>

namespace omnihdr {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// ln value of a block or window. Unknown: its group's brightness, and the parameters named.
struct LogSample {
  int group = 0;
  int falloff = 0;  // which fall-off
  int gain = -1;    // which ln gain, −1 = none
  int tilt = -1;    // which pair of tilts, −1 = none
  double rho = 0.0;
  Eigen::Vector2d at = Eigen::Vector2d::Zero();  // place in half diagonals, for the tilt
  double value = 0.0;
};

struct Layout {
  int falloffs = 1;
  int gains = 0;
  int tilts = 0;
  int channels = 1;  // gains of a channel sum to zero: gain index = sensor · channels + channel
  int size() const { return 3 * falloffs + gains + 2 * tilts; }
  int gain_at(int gain) const { return 3 * falloffs + gain; }
  int tilt_at(int tilt) const { return 3 * falloffs + gains + 2 * tilt; }
};

struct Solution {
  Eigen::VectorXd parameters;
  Eigen::MatrixXd covariance;
  double residual = 0.0;  // rms about the fit, outliers bounded
  std::vector<double> residuals;
};

using Row = Eigen::Matrix<double, 6, 1>;
struct Jacobian {
  std::array<int, 6> index{};
  Row value = Row::Zero();
  int size = 0;
  void Add(int i, double v) {
    index[static_cast<std::size_t>(size)] = i;
    value[size] = v;
    ++size;
  }
};

Vignetting FalloffOf(const Eigen::VectorXd& parameters, int falloff) {
  return {{parameters[3 * falloff], parameters[3 * falloff + 1], parameters[3 * falloff + 2]}};
}

// Prediction of ln value less the group's brightness.
double Predict(const Layout& layout, const Eigen::VectorXd& p, const LogSample& s, Jacobian* j) {
  const double falloff = std::max(FalloffOf(p, s.falloff).At(s.rho), 0.02);
  double ln = std::log(falloff);
  const double s2 = s.rho * s.rho;
  *j = Jacobian{};
  j->Add(3 * s.falloff, s2 / falloff);
  j->Add(3 * s.falloff + 1, s2 * s2 / falloff);
  j->Add(3 * s.falloff + 2, s2 * s2 * s2 / falloff);
  if (s.gain >= 0) {
    ln -= p[layout.gain_at(s.gain)];
    j->Add(layout.gain_at(s.gain), -1.0);
  }
  if (s.tilt >= 0) {
    const int at = layout.tilt_at(s.tilt);
    ln += p[at] * s.at.x() + p[at + 1] * s.at.y();
    j->Add(at, s.at.x());
    j->Add(at + 1, s.at.y());
  }
  return ln;
}

double MedianOf(std::vector<double> values) {
  if (values.empty()) return kNaN;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Gauss-Newton with Huber weights; the groups' brightness is eliminated exactly: it is the weighted
// mean of the group, so normal equations lose the mean's outer product. Samples are in the order of
// their groups.
std::optional<Solution> Solve(const std::vector<LogSample>& samples, const Layout& layout) {
  const int n = layout.size();
  Solution out;
  out.parameters = Eigen::VectorXd::Zero(n);
  out.residuals.assign(samples.size(), 0.0);
  std::vector<double> weights(samples.size(), 1.0);
  std::vector<Jacobian> jacobians(samples.size());
  constexpr int kIterations = 40;
  Eigen::MatrixXd normal(n, n);
  double scale = 0.0;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    normal.setZero();
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(n);
    double groups = 0.0;
    double bounded = 0.0;
    std::vector<double> distances;
    distances.reserve(samples.size());
    for (std::size_t begin = 0; begin < samples.size();) {
      std::size_t end = begin;
      double sum = 0.0;
      double mean = 0.0;
      Eigen::VectorXd mean_jacobian = Eigen::VectorXd::Zero(n);
      while (end < samples.size() && samples[end].group == samples[begin].group) {
        const LogSample& s = samples[end];
        const double r = s.value - Predict(layout, out.parameters, s, &jacobians[end]);
        out.residuals[end] = r;
        sum += weights[end];
        mean += weights[end] * r;
        const Jacobian& j = jacobians[end];
        for (int a = 0; a < j.size; ++a) {
          mean_jacobian[j.index[static_cast<std::size_t>(a)]] += weights[end] * j.value[a];
        }
        ++end;
      }
      mean /= sum;
      mean_jacobian /= sum;
      for (std::size_t i = begin; i < end; ++i) {
        out.residuals[i] -= mean;
        distances.push_back(std::abs(out.residuals[i]));
        bounded += weights[i] * out.residuals[i] * out.residuals[i];
        const Jacobian& j = jacobians[i];
        for (int a = 0; a < j.size; ++a) {
          const int ia = j.index[static_cast<std::size_t>(a)];
          gradient[ia] += weights[i] * j.value[a] * out.residuals[i];
          for (int b = 0; b < j.size; ++b) {
            normal(ia, j.index[static_cast<std::size_t>(b)]) +=
                weights[i] * j.value[a] * j.value[b];
          }
        }
      }
      normal -= sum * mean_jacobian * mean_jacobian.transpose();
      groups += 1.0;
      begin = end;
    }
    // Only ratios of gains are seen: their logs sum to zero in each channel.
    for (int a = 0; a < layout.gains; ++a) {
      for (int b = 0; b < layout.gains; ++b) {
        if (a % layout.channels == b % layout.channels) {
          normal(layout.gain_at(a), layout.gain_at(b)) += 1.0;
        }
      }
    }
    const double freedom = static_cast<double>(samples.size()) - groups - n;
    if (freedom < 1.0) return std::nullopt;
    const Eigen::LDLT<Eigen::MatrixXd> ldlt(normal);
    if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return std::nullopt;
    Eigen::VectorXd step = ldlt.solve(gradient);
    if (!step.allFinite()) return std::nullopt;
    // A first step from far away must not make a fall-off negative.
    const double largest = step.cwiseAbs().maxCoeff();
    if (largest > 0.5) step *= 0.5 / largest;
    out.parameters += step;
    // Huber: residuals beyond 1.345 robust deviations weigh less.
    scale = std::max(1.4826 * MedianOf(distances), 1e-6);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const double r = std::abs(out.residuals[i]);
      weights[i] = r <= 1.345 * scale ? 1.0 : 1.345 * scale / r;
    }
    out.residual = std::sqrt(bounded / freedom);
    if (iteration > 3 && largest < 1e-9) break;
  }
  out.covariance =
      out.residual * out.residual * normal.ldlt().solve(Eigen::MatrixXd::Identity(n, n));
  if (!out.covariance.allFinite()) return std::nullopt;
  return out;
}

// The fit of one fall-off, or why it is none.
Result<VignettingFit> Judge(const Solution& solution, int falloff,
                            const std::vector<LogSample>& samples, double largest_rho,
                            const std::string& name, const VignettingOptions& options) {
  VignettingFit fit;
  fit.vignetting = FalloffOf(solution.parameters, falloff);
  fit.residual = solution.residual;
  fit.rho_min = std::numeric_limits<double>::infinity();
  // Radii must be covered without a hole: a polynomial bends freely in one.
  constexpr std::size_t kRings = 10;
  std::array<int, kRings> rings{};
  for (const LogSample& s : samples) {
    if (s.falloff != falloff) continue;
    ++fit.samples;
    fit.rho_min = std::min(fit.rho_min, s.rho);
    fit.rho_max = std::max(fit.rho_max, s.rho);
    const double ring = kRings * s.rho / largest_rho;
    ++rings[std::min(static_cast<std::size_t>(ring), kRings - 1)];
  }
  if (fit.samples == 0) return Fail(ErrorKind::kData, "{}: nothing usable to measure", name);
  if (fit.rho_max < options.least_reach * largest_rho) {
    return Fail(ErrorKind::kData,
                "{}: usable samples reach {:.2f} of the half diagonal, expected at least {:.2f} of "
                "the {:.2f} that the lens covers: the rest is clipped, dark, masked or not shared",
                name, fit.rho_max, options.least_reach * largest_rho, largest_rho);
  }
  // The innermost ring holds a hundredth of the area; the middle may lack that much.
  for (std::size_t ring = 1; ring + 2 < kRings; ++ring) {
    if (rings[ring] > 0 || (ring == 1 && rings[0] > 0)) continue;
    return Fail(ErrorKind::kData,
                "{}: no usable samples between {:.2f} and {:.2f} of the half diagonal: with a hole "
                "there the fall-off is not known",
                name, static_cast<double>(ring) / kRings * largest_rho,
                static_cast<double>(ring + 1) / kRings * largest_rho);
  }
  double lowest = 1.0;
  double lowest_rho = 0.0;
  constexpr int kSteps = 100;
  const Eigen::Matrix3d covariance = solution.covariance.block<3, 3>(3 * falloff, 3 * falloff);
  for (int i = 0; i <= kSteps; ++i) {
    const double rho = fit.rho_max * i / kSteps;
    const double at = fit.vignetting.At(rho);
    const double s = rho * rho;
    const Eigen::Vector3d j(s, s * s, s * s * s);
    fit.error = std::max(fit.error, std::sqrt(std::max(0.0, j.dot(covariance * j))));
    if (at > lowest + options.rise_tolerance) {
      return Fail(ErrorKind::kData,
                  "{}: the fall-off rises from {:.3f} at {:.2f} to {:.3f} at {:.2f} of the half "
                  "diagonal, expected falling outwards: the light is not even, or the response is "
                  "not the pictures' own",
                  name, lowest, lowest_rho, at, rho);
    }
    if (at < lowest) {
      lowest = at;
      lowest_rho = rho;
    }
  }
  fit.at_edge = fit.vignetting.At(fit.rho_max);
  if (!(fit.at_edge > 0.05)) {
    return Fail(ErrorKind::kData,
                "{}: a fall-off to {:.3f} at the edge, expected more than 0.05: the lens's image "
                "ends before; mask what it does not reach",
                name, fit.at_edge);
  }
  if (fit.residual > options.worst_residual) {
    return Fail(
        ErrorKind::kData,
        "{}: values scatter by {:.1f} % about the best fall-off, expected at most {:.1f} %: "
        "this is not an even field (or the sensors' pictures do not belong together)",
        name, 100.0 * fit.residual, 100.0 * options.worst_residual);
  }
  if (fit.error > options.worst_error) {
    return Fail(ErrorKind::kData,
                "{}: the fall-off is known to {:.1f} % only, expected {:.1f} %: too few samples at "
                "different radii; add pictures (of the head turned, for overlaps)",
                name, 100.0 * fit.error, 100.0 * options.worst_error);
  }
  return fit;
}

// Mean of each colour's linearised pixels in a rectangle; NaN where fewer than nine tenths of them
// are usable. `spread`: largest relative standard deviation of a colour's pixels.
std::array<double, 3> BlockMeans(const SensorPicture& picture, ImageView<const std::uint8_t> mask,
                                 int x0, int y0, int x1, int y1, const Response& response,
                                 const VignettingOptions& options, double* spread) {
  std::array<double, 3> sum{};
  std::array<double, 3> squares{};
  std::array<int, 3> usable{};
  std::array<int, 3> all{};
  const int channels = picture.values.channels();
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      const bool masked = !mask.empty() && mask.at(x, y) == 0;
      const float* pixel = picture.values.pixel(x, y);
      for (int c = 0; c < channels; ++c) {
        const bool bayer = channels == 1 && picture.bayer != BayerOrder::kNone;
        const auto k = static_cast<std::size_t>(bayer ? BayerChannel(picture.bayer, x, y) : c);
        ++all[k];
        const double v = pixel[c];
        if (masked || v < options.value_low || v > options.value_high) continue;
        const double e = response.ExposureFromValue(static_cast<int>(k), v);
        sum[k] += e;
        squares[k] += e * e;
        ++usable[k];
      }
    }
  }
  std::array<double, 3> mean = {kNaN, kNaN, kNaN};
  *spread = 0.0;
  for (std::size_t k = 0; k < 3; ++k) {
    if (usable[k] == 0 || 10 * usable[k] < 9 * all[k] || !(sum[k] > 0.0)) continue;
    mean[k] = sum[k] / usable[k];
    const double variance = std::max(0.0, squares[k] / usable[k] - mean[k] * mean[k]);
    *spread = std::max(*spread, std::sqrt(variance) / mean[k]);
  }
  return mean;
}

// ln values weigh by their scatter: nothing about two samples' brightness that is not in it.
double RootMedianSquare(const std::vector<double>& values) {
  std::vector<double> magnitudes;
  magnitudes.reserve(values.size());
  for (const double v : values) magnitudes.push_back(std::abs(v));
  return 1.4826 * MedianOf(std::move(magnitudes));
}

}  // namespace

Result<VignettingFit> FitFlatFields(std::span<const FlatField> fields,
                                    const Eigen::Vector2d& centre, double largest_rho,
                                    const Response& response, const VignettingOptions& options) {
  std::vector<LogSample> samples;
  Layout layout;
  layout.tilts = static_cast<int>(fields.size());
  int blocks = 0;
  for (std::size_t k = 0; k < fields.size(); ++k) {
    const SensorPicture& picture = *fields[k].picture;
    const double half_diagonal = 0.5 * std::hypot(picture.width(), picture.height());
    // Some thousand blocks, each an even number of pixels so that it holds whole Bayer tiles.
    const int size = std::max(4, 2 * (std::max(picture.width(), picture.height()) / 128));
    std::array<std::vector<LogSample>, 3> channels;
    for (int y = 0; y + size <= picture.height(); y += size) {
      for (int x = 0; x + size <= picture.width(); x += size) {
        double spread = 0.0;
        const std::array<double, 3> mean = BlockMeans(picture, fields[k].mask, x, y, x + size,
                                                      y + size, response, options, &spread);
        ++blocks;
        for (std::size_t c = 0; c < 3; ++c) {
          if (std::isnan(mean[c])) continue;
          LogSample sample;
          sample.group = static_cast<int>(3 * k + c);
          sample.tilt = static_cast<int>(k);
          sample.at = (Eigen::Vector2d(x + 0.5 * size, y + 0.5 * size) - centre) / half_diagonal;
          sample.rho = sample.at.norm();
          sample.value = std::log(mean[c]);
          channels[c].push_back(sample);
        }
      }
    }
    for (const std::vector<LogSample>& channel : channels) {
      samples.insert(samples.end(), channel.begin(), channel.end());
    }
  }
  constexpr std::size_t kFewest = 100;
  if (samples.size() < kFewest) {
    return Fail(ErrorKind::kData,
                "flat field: {} of {} blocks usable (values from {:g} to {:g}), expected at least "
                "{}: the picture is clipped, dark or masked",
                samples.size(), blocks, options.value_low, options.value_high, kFewest);
  }
  const std::optional<Solution> solution = Solve(samples, layout);
  if (!solution) return Fail(ErrorKind::kData, "flat field: no fall-off fits the values");
  return Judge(*solution, 0, samples, largest_rho, "flat field", options);
}

Result<OverlapFit> FitOverlaps(std::span<const OverlapSample> input,
                               const std::vector<std::string>& names,
                               const std::vector<double>& largest_rho,
                               const OverlapOptions& options) {
  const std::size_t sensors = names.size();
  std::vector<std::size_t> order(input.size());
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(), [&input](std::size_t a, std::size_t b) {
    return input[a].direction < input[b].direction;
  });
  Layout layout;
  layout.channels = 3;
  layout.gains = static_cast<int>(3 * sensors);
  layout.falloffs = options.shared ? 1 : static_cast<int>(sensors);
  OverlapFit fit;
  std::vector<LogSample> samples;
  std::vector<std::size_t> linked(sensors);  // sensors that common directions bring together
  std::iota(linked.begin(), linked.end(), 0U);
  int group = 0;
  for (std::size_t begin = 0; begin < order.size();) {
    std::size_t end = begin;
    while (end < order.size() && input[order[end]].direction == input[order[begin]].direction)
      ++end;
    bool counted = false;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t first = samples.size();
      for (std::size_t i = begin; i < end; ++i) {
        const OverlapSample& s = input[order[i]];
        if (!(s.exposure[c] > 0.0)) continue;
        LogSample sample;
        sample.group = group;
        sample.falloff = options.shared ? 0 : s.sensor;
        sample.gain = 3 * s.sensor + static_cast<int>(c);
        sample.rho = s.rho;
        sample.value = std::log(s.exposure[c]);
        samples.push_back(sample);
      }
      if (samples.size() - first < 2) {
        samples.resize(first);
        continue;
      }
      ++group;
      counted = true;
      for (std::size_t i = first + 1; i < samples.size(); ++i) {
        const std::size_t a = linked[static_cast<std::size_t>(samples[first].gain / 3)];
        const std::size_t b = linked[static_cast<std::size_t>(samples[i].gain / 3)];
        for (std::size_t& l : linked) l = l == a ? b : l;
      }
    }
    fit.directions += counted ? 1 : 0;
    begin = end;
  }
  for (std::size_t s = 1; s < sensors; ++s) {
    if (linked[s] == linked[0]) continue;
    return Fail(
        ErrorKind::kData,
        "overlaps: sensor {} shares no usable direction with sensor {}, directly or through "
        "others: gains cannot be compared",
        names[s], names[0]);
  }
  constexpr int kFewest = 200;
  if (fit.directions < kFewest) {
    return Fail(ErrorKind::kData,
                "overlaps: {} directions seen twice, expected at least {}: the fields hardly "
                "overlap, or are clipped or dark there",
                fit.directions, kFewest);
  }
  const std::optional<Solution> solution = Solve(samples, layout);
  if (!solution) {
    return Fail(
        ErrorKind::kData,
        "overlaps: the pictures do not determine the fall-off: the same directions are seen "
        "at the same radii; add pictures of the head turned");
  }
  std::vector<double> before;
  for (std::size_t begin = 0; begin < samples.size();) {
    std::size_t end = begin;
    double mean = 0.0;
    while (end < samples.size() && samples[end].group == samples[begin].group) {
      mean += samples[end++].value;
    }
    mean /= static_cast<double>(end - begin);
    for (std::size_t i = begin; i < end; ++i) before.push_back(samples[i].value - mean);
    begin = end;
  }
  fit.difference_before = RootMedianSquare(before);
  fit.difference_after = RootMedianSquare(solution->residuals);
  VignettingOptions judge = options.vignetting;
  // Parallax and texture scatter; the error of the fall-off is what counts.
  judge.worst_residual = std::numeric_limits<double>::infinity();
  for (std::size_t s = 0; s < sensors; ++s) {
    const double reach =
        options.shared ? *std::max_element(largest_rho.begin(), largest_rho.end()) : largest_rho[s];
    OMNIHDR_ASSIGN(VignettingFit one,
                   Judge(*solution, options.shared ? 0 : static_cast<int>(s), samples, reach,
                         options.shared ? "overlaps" : "overlaps: sensor " + names[s], judge));
    fit.sensors.push_back(one);
    std::array<double, 3> gain{};
    std::array<double, 3> error{};
    for (std::size_t c = 0; c < 3; ++c) {
      const int at = layout.gain_at(static_cast<int>(3 * s + c));
      gain[c] = std::exp(solution->parameters[at]);
      error[c] = std::sqrt(std::max(0.0, solution->covariance(at, at)));
    }
    fit.gain.push_back(gain);
    fit.gain_error.push_back(error);
  }
  return fit;
}

std::vector<OverlapSample> CollectOverlapSamples(const Rig& rig,
                                                 std::span<const RigPictures> stands,
                                                 std::span<const Response> responses,
                                                 double step_deg,
                                                 const VignettingOptions& options) {
  constexpr double kRadians = 0.017453292519943295;
  constexpr double kPi = 3.14159265358979324;
  constexpr double kMostTexture = 0.25;
  std::vector<OverlapSample> samples;
  const double step = step_deg * kRadians;
  int direction = 0;
  const auto visit = [&](const RigPictures& stand, const Eigen::Vector3d& ray) {
    for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
      const RigSensor& sensor = rig.sensors[s];
      const SensorPicture* picture = s < stand.sensors.size() ? stand.sensors[s] : nullptr;
      if (picture == nullptr) continue;
      const std::optional<Eigen::Vector2d> pixel =
          SensorPixelFromRay(sensor, ray, rig.sphere_radius_m);
      if (!pixel) continue;
      // A quarter of the step, whole Bayer tiles.
      const double focal = sensor.lens.focal().minCoeff();
      const int half = std::clamp(static_cast<int>(0.25 * step * focal), 2, 32);
      const int x0 = 2 * (static_cast<int>(pixel->x() - half) / 2);
      const int y0 = 2 * (static_cast<int>(pixel->y() - half) / 2);
      if (pixel->x() < half || pixel->y() < half || x0 + 2 * half > picture->width() ||
          y0 + 2 * half > picture->height()) {
        continue;
      }
      const ImageView<const std::uint8_t> mask =
          s < stand.masks.size() ? stand.masks[s] : ImageView<const std::uint8_t>();
      double spread = 0.0;
      std::array<double, 3> mean = BlockMeans(*picture, mask, x0, y0, x0 + 2 * half, y0 + 2 * half,
                                              responses[s], options, &spread);
      if (spread > kMostTexture) continue;
      for (double& e : mean) e /= stand.seconds[s];
      const double half_diagonal = 0.5 * std::hypot(picture->width(), picture->height());
      samples.push_back({direction, static_cast<int>(s),
                         (*pixel - sensor.lens.centre()).norm() / half_diagonal, mean});
    }
  };
  std::vector<const RigPictures*> turned;
  for (const RigPictures& stand : stands) {
    if (stand.world_from_rig) turned.push_back(&stand);
  }
  const int rows = std::max(2, static_cast<int>(std::lround(kPi / step)));
  for (int i = 0; i < rows; ++i) {
    const double phi = kPi * (i + 0.5) / rows;
    const int columns =
        std::max(1, static_cast<int>(std::lround(2.0 * kPi * std::sin(phi) / step)));
    for (int j = 0; j < columns; ++j) {
      const double theta = 2.0 * kPi * (j + 0.5) / columns;
      const Eigen::Vector3d ray(std::sin(phi) * std::cos(theta), std::sin(phi) * std::sin(theta),
                                std::cos(phi));
      for (const RigPictures* stand : turned)
        visit(*stand, stand->world_from_rig->transpose() * ray);
      ++direction;
      for (const RigPictures& stand : stands) {
        if (stand.world_from_rig) continue;
        visit(stand, ray);
        ++direction;
      }
    }
  }
  return samples;
}

double LargestRho(const RigSensor& sensor) {
  const Lens& lens = sensor.lens;
  const double half_diagonal = 0.5 * std::hypot(lens.width(), lens.height());
  double largest = 0.0;
  constexpr int kSteps = 32;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; j <= kSteps; ++j) {
      const double x =
          std::clamp(lens.width() * static_cast<double>(j) / kSteps, 0.5, lens.width() - 0.5);
      const double y =
          std::clamp(lens.height() * static_cast<double>(i) / kSteps, 0.5, lens.height() - 0.5);
      if (!lens.RayFromPixel(x, y)) continue;
      largest = std::max(largest, (Eigen::Vector2d(x, y) - lens.centre()).norm() / half_diagonal);
    }
  }
  return largest > 0.0 ? largest : 1.0;
}

}  // namespace omnihdr
