#include "core/photometry/color_chart.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

namespace omnihdr {
namespace {

constexpr std::array<ChartPatchReference, kChartPatches> kReference = {{
    {"dark skin", {115, 82, 68}},     {"light skin", {194, 150, 130}},
    {"blue sky", {98, 122, 157}},     {"foliage", {87, 108, 67}},
    {"blue flower", {133, 128, 177}}, {"bluish green", {103, 189, 170}},
    {"orange", {214, 126, 44}},       {"purplish blue", {80, 91, 166}},
    {"moderate red", {193, 90, 99}},  {"purple", {94, 60, 108}},
    {"yellow green", {157, 188, 64}}, {"orange yellow", {224, 163, 46}},
    {"blue", {56, 61, 150}},          {"green", {70, 148, 73}},
    {"red", {175, 54, 60}},           {"yellow", {231, 199, 31}},
    {"magenta", {187, 86, 149}},      {"cyan", {8, 133, 161}},
    {"white", {243, 243, 242}},       {"neutral 8", {200, 200, 200}},
    {"neutral 6.5", {160, 160, 160}}, {"neutral 5", {122, 122, 121}},
    {"neutral 3.5", {85, 85, 85}},    {"black", {52, 52, 52}},
}};

double LinearFromSrgb(int value) {
  const double v = value / 255.0;
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

// The middle of the chart is the origin of the fit, for conditioning.
const Eigen::Vector2d kMiddle(0.5 * kChartColumns, 0.5 * kChartRows);

// Undistorted to distorted radius factor of the division model.
double DistortFactor(double lambda, double r2) {
  const double root = 1.0 - 4.0 * lambda * r2;
  if (root < 0.0) return std::numeric_limits<double>::quiet_NaN();
  return 2.0 / (1.0 + std::sqrt(root));
}

using Parameters = Eigen::Matrix<double, 9, 1>;

Eigen::Vector2d Apply(const Parameters& p, const Eigen::Vector2d& chart) {
  const Eigen::Vector2d c = chart - kMiddle;
  const double w = p[6] * c.x() + p[7] * c.y() + 1.0;
  if (w <= 1e-6) return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  const Eigen::Vector2d q((p[0] * c.x() + p[1] * c.y() + p[2]) / w,
                          (p[3] * c.x() + p[4] * c.y() + p[5]) / w);
  return DistortFactor(p[8], q.squaredNorm()) * q;
}

// Direct linear transform with h33 = 1: the chart's middle is in front of the camera.
std::optional<Parameters> LinearFit(const std::vector<Eigen::Vector2d>& chart,
                                    const std::vector<Eigen::Vector2d>& points) {
  Eigen::MatrixXd a(2 * static_cast<Eigen::Index>(chart.size()), 8);
  Eigen::VectorXd b(a.rows());
  for (std::size_t i = 0; i < chart.size(); ++i) {
    const Eigen::Vector2d c = chart[i] - kMiddle;
    const Eigen::Vector2d& p = points[i];
    const auto row = 2 * static_cast<Eigen::Index>(i);
    a.row(row) << c.x(), c.y(), 1.0, 0.0, 0.0, 0.0, -p.x() * c.x(), -p.x() * c.y();
    a.row(row + 1) << 0.0, 0.0, 0.0, c.x(), c.y(), 1.0, -p.y() * c.x(), -p.y() * c.y();
    b[row] = p.x();
    b[row + 1] = p.y();
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(a);
  if (qr.rank() < 8) return std::nullopt;
  Parameters parameters;
  parameters << qr.solve(b), 0.0;
  if (!parameters.allFinite()) return std::nullopt;
  return parameters;
}

// Levenberg-Marquardt on the distance in the picture. The prior keeps λ at zero where the points
// do not tell it.
double Cost(const Parameters& p, const std::vector<Eigen::Vector2d>& chart,
            const std::vector<Eigen::Vector2d>& points, double prior) {
  double sum = prior * prior * p[8] * p[8];
  for (std::size_t i = 0; i < chart.size(); ++i) {
    sum += (Apply(p, chart[i]) - points[i]).squaredNorm();
  }
  return std::isfinite(sum) ? sum : std::numeric_limits<double>::infinity();
}

Parameters Refine(Parameters p, const std::vector<Eigen::Vector2d>& chart,
                  const std::vector<Eigen::Vector2d>& points, bool with_distortion, double prior) {
  const int unknowns = with_distortion ? 9 : 8;
  double damping = 1e-3;
  double cost = Cost(p, chart, points, prior);
  for (int iteration = 0; iteration < 30 && damping < 1e6; ++iteration) {
    Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
    Parameters gradient = Parameters::Zero();
    for (std::size_t i = 0; i < chart.size(); ++i) {
      const Eigen::Vector2d at = Apply(p, chart[i]);
      const Eigen::Vector2d residual = at - points[i];
      Eigen::Matrix<double, 2, 9> jacobian = Eigen::Matrix<double, 2, 9>::Zero();
      for (int k = 0; k < unknowns; ++k) {
        const double step = 1e-6 * std::max(1.0, std::abs(p[k]));
        Parameters moved = p;
        moved[k] += step;
        jacobian.col(k) = (Apply(moved, chart[i]) - at) / step;
      }
      normal += jacobian.transpose() * jacobian;
      gradient += jacobian.transpose() * residual;
    }
    normal(8, 8) += prior * prior;
    gradient[8] += prior * prior * p[8];
    if (!with_distortion) normal(8, 8) = 1.0;
    if (!normal.allFinite()) break;
    Eigen::Matrix<double, 9, 9> damped = normal;
    damped.diagonal() *= 1.0 + damping;
    Parameters step = damped.ldlt().solve(gradient);
    if (!with_distortion) step[8] = 0.0;
    const Parameters next = p - step;
    const double next_cost = Cost(next, chart, points, prior);
    if (next_cost < cost) {
      const bool converged = cost - next_cost < 1e-12 * cost;
      p = next;
      cost = next_cost;
      damping = std::max(damping * 0.2, 1e-9);
      if (converged) break;
    } else {
      damping *= 10.0;
    }
  }
  return p;
}

double Median(std::vector<float>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

PatchChannel Statistics(std::vector<float> values, int channel, const Response& response,
                        const ChartMeasureOptions& options) {
  PatchChannel patch;
  patch.pixels = static_cast<int>(values.size());
  const double n = static_cast<double>(values.size());
  double squares = 0.0;
  for (const float v : values) {
    patch.mean += v;
    patch.clipped += v > options.value_high ? 1.0 : 0.0;
    patch.dark += v < options.value_low ? 1.0 : 0.0;
    const double e = response.ExposureFromValue(channel, v);
    patch.exposure += e;
    squares += e * e;
  }
  patch.mean /= n;
  patch.clipped /= n;
  patch.dark /= n;
  patch.exposure /= n;
  const double variance = std::max(0.0, squares / n - patch.exposure * patch.exposure);
  // Quantisation is the least noise there is, and equal values do not make it vanish.
  const double quantum = response.Slope(channel, patch.mean) / std::sqrt(12.0);
  patch.exposure_error = std::sqrt(variance / n + quantum * quantum / n);
  patch.median = Median(values);
  std::vector<float> distances = values;
  for (float& d : distances) d = std::abs(d - static_cast<float>(patch.median));
  // Whole numbers make the median distance jump: it only bounds what counts as noise.
  const double limit = 4.0 * std::max(1.4826 * Median(distances), 1.0);
  double sum = 0.0;
  double sum2 = 0.0;
  double inside = 0.0;
  for (const float v : values) {
    const double d = v - patch.median;
    if (std::abs(d) > limit) continue;
    sum += d;
    sum2 += d * d;
    inside += 1.0;
  }
  patch.noise = std::sqrt(std::max(0.0, sum2 / inside - (sum / inside) * (sum / inside)));
  patch.usable = patch.clipped <= 0.01 && patch.median >= options.value_low && patch.exposure > 0.0;
  return patch;
}

}  // namespace

const std::array<ChartPatchReference, kChartPatches>& ChartReference() { return kReference; }

std::array<double, 3> ChartLinearLight(int patch) {
  const std::array<std::uint8_t, 3>& srgb = kReference[static_cast<std::size_t>(patch)].srgb;
  return {LinearFromSrgb(srgb[0]), LinearFromSrgb(srgb[1]), LinearFromSrgb(srgb[2])};
}

ChartGeometry::ChartGeometry(const Eigen::Matrix3d& homography, double lambda, int width,
                             int height)
    : homography_(homography),
      lambda_(lambda),
      centre_(0.5 * width, 0.5 * height),
      half_diagonal_(0.5 * std::hypot(width, height)) {}

std::optional<ChartGeometry> ChartGeometry::Fit(const std::vector<Eigen::Vector2d>& chart,
                                                const std::vector<Eigen::Vector2d>& pixels,
                                                int width, int height, bool with_distortion) {
  if (chart.size() != pixels.size() || chart.size() < 4) return std::nullopt;
  const ChartGeometry frame(Eigen::Matrix3d::Identity(), 0.0, width, height);
  std::vector<Eigen::Vector2d> points;
  points.reserve(pixels.size());
  for (const Eigen::Vector2d& p : pixels) {
    points.emplace_back((p - frame.centre_) / frame.half_diagonal_);
  }
  std::optional<Parameters> start = LinearFit(chart, points);
  if (!start) return std::nullopt;
  const bool distort = with_distortion && chart.size() >= 12;
  // A hundredth of a patch for λ = 1.
  const double step = std::abs((*start)[0] * (*start)[4] - (*start)[1] * (*start)[3]);
  const double prior = 0.01 * std::sqrt(step);
  Parameters p = *start;
  if (chart.size() > 4) p = Refine(p, chart, points, false, 0.0);
  if (distort) p = Refine(p, chart, points, true, prior);
  Eigen::Matrix3d h;
  h << p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], 1.0;
  Eigen::Matrix3d middle = Eigen::Matrix3d::Identity();
  middle(0, 2) = -kMiddle.x();
  middle(1, 2) = -kMiddle.y();
  const ChartGeometry geometry(h * middle, p[8], width, height);
  for (int patch = 0; patch < kChartPatches; ++patch) {
    if (!geometry.PatchCentre(patch).allFinite()) return std::nullopt;
  }
  return geometry;
}

Eigen::Vector2d ChartGeometry::PixelFromChart(const Eigen::Vector2d& chart) const {
  const Eigen::Vector3d h = homography_ * chart.homogeneous();
  if (!(h.z() > 1e-9)) {
    return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  const Eigen::Vector2d q = h.head<2>() / h.z();
  return centre_ + half_diagonal_ * DistortFactor(lambda_, q.squaredNorm()) * q;
}

Eigen::Vector2d ChartGeometry::PatchCentre(int patch) const {
  return PixelFromChart(PatchInChart(patch));
}

std::array<Eigen::Vector2d, 4> ChartGeometry::PatchSquare(int patch, double half) const {
  const Eigen::Vector2d centre = PatchInChart(patch);
  const double u = centre.x();
  const double v = centre.y();
  return {PixelFromChart({u - half, v - half}), PixelFromChart({u + half, v - half}),
          PixelFromChart({u + half, v + half}), PixelFromChart({u - half, v + half})};
}

double ChartGeometry::PatchStep() const {
  double sum = 0.0;
  int steps = 0;
  for (int row = 0; row < kChartRows; ++row) {
    for (int column = 0; column < kChartColumns; ++column) {
      const int patch = row * kChartColumns + column;
      if (column + 1 < kChartColumns) {
        sum += (PatchCentre(patch + 1) - PatchCentre(patch)).norm();
        ++steps;
      }
      if (row + 1 < kChartRows) {
        sum += (PatchCentre(patch + kChartColumns) - PatchCentre(patch)).norm();
        ++steps;
      }
    }
  }
  return sum / steps;
}

Result<ChartMeasurement> MeasureChart(const SensorPicture& picture, const ChartGeometry& geometry,
                                      const Response& response,
                                      const ChartMeasureOptions& options) {
  ChartMeasurement measurement;
  for (int patch = 0; patch < kChartPatches; ++patch) {
    const std::array<Eigen::Vector2d, 4> square = geometry.PatchSquare(patch, options.inner);
    Eigen::Vector2d low = square[0];
    Eigen::Vector2d high = square[0];
    for (const Eigen::Vector2d& corner : square) {
      low = low.cwiseMin(corner);
      high = high.cwiseMax(corner);
    }
    const std::string_view name = kReference[static_cast<std::size_t>(patch)].name;
    if (!low.allFinite() || !high.allFinite() || low.x() < 0.0 || low.y() < 0.0 ||
        high.x() > picture.width() || high.y() > picture.height()) {
      return Fail(ErrorKind::kData, "patch {} ({}) lies outside the picture", patch + 1, name);
    }
    // Either way round: a mirrored chart's corners run clockwise instead.
    const auto inside = [&square](double x, double y) {
      int left = 0;
      for (std::size_t i = 0; i < 4; ++i) {
        const Eigen::Vector2d edge = square[(i + 1) % 4] - square[i];
        left += edge.x() * (y - square[i].y()) - edge.y() * (x - square[i].x()) >= 0.0 ? 1 : 0;
      }
      return left == 0 || left == 4;
    };
    std::array<std::vector<float>, 3> values;
    for (int y = static_cast<int>(low.y()); y < static_cast<int>(std::ceil(high.y())); ++y) {
      for (int x = static_cast<int>(low.x()); x < static_cast<int>(std::ceil(high.x())); ++x) {
        if (!inside(x + 0.5, y + 0.5)) continue;
        const float* pixel = picture.values.pixel(x, y);
        if (picture.values.channels() == 3) {
          for (std::size_t c = 0; c < 3; ++c) values[c].push_back(pixel[c]);
        } else if (picture.bayer != BayerOrder::kNone) {
          values[static_cast<std::size_t>(BayerChannel(picture.bayer, x, y))].push_back(pixel[0]);
        } else {
          for (std::vector<float>& channel : values) channel.push_back(pixel[0]);
        }
      }
    }
    for (std::size_t c = 0; c < 3; ++c) {
      if (values[c].size() < 8) {
        return Fail(ErrorKind::kData,
                    "patch {} ({}) has {} pixels of one colour to measure, expected at least 8: "
                    "the chart is too small in the picture",
                    patch + 1, name, values[c].size());
      }
      measurement[static_cast<std::size_t>(patch)][c] =
          Statistics(std::move(values[c]), static_cast<int>(c), response, options);
    }
  }
  return measurement;
}

}  // namespace omnihdr
