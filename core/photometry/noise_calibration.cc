#include "core/photometry/noise_calibration.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <variant>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

constexpr int kTile = 24;  // pixels of one colour on a side
constexpr double kPairLevels = 0.02;
constexpr double kLeastRange = 2.5;  // of the brightest level to the darkest
constexpr double kMostPattern = 0.1;
constexpr std::size_t kLeastTiles = 20;

struct TileNoise {
  double mean = 0.0;
  double temporal = 0.0;
  double pattern = 0.0;
  bool clipped = false;
};

// Pixels of one colour and tile; `at(i, j)` gives both values in 8-bit units.
template <typename At>
TileNoise Measure(const At& at, double black) {
  constexpr double kLow = 0.5;
  constexpr double kHigh = 254.5;
  TileNoise tile;
  constexpr int n = kTile * kTile;
  double sum = 0.0;
  double difference = 0.0;
  // The mean picture less a plane: uneven light is not the sensor's.
  double sx = 0.0;
  double sy = 0.0;
  double sxx = 0.0;
  for (int j = 0; j < kTile; ++j) {
    for (int i = 0; i < kTile; ++i) {
      const auto [a, b] = at(i, j);
      if (a < kLow || b < kLow || a > kHigh || b > kHigh) tile.clipped = true;
      const double mean = 0.5 * (a + b);
      const double x = i - 0.5 * (kTile - 1);
      const double y = j - 0.5 * (kTile - 1);
      sum += mean;
      difference += a - b;
      sx += x * mean;
      sy += y * mean;
      sxx += x * x;
    }
  }
  if (tile.clipped) return tile;
  const double mean = sum / n;
  const double drift = difference / n;
  double temporal = 0.0;
  double spatial = 0.0;
  for (int j = 0; j < kTile; ++j) {
    for (int i = 0; i < kTile; ++i) {
      const auto [a, b] = at(i, j);
      const double x = i - 0.5 * (kTile - 1);
      const double y = j - 0.5 * (kTile - 1);
      const double flat = 0.5 * (a + b) - mean - (sx * x + sy * y) / sxx;
      temporal += (a - b - drift) * (a - b - drift);
      spatial += flat * flat;
    }
  }
  tile.mean = mean - black;
  tile.temporal = temporal / (2.0 * (n - 1));
  tile.pattern = spatial / (n - 3) - 0.5 * tile.temporal;
  return tile;
}

template <typename T>
void MeasureTiles(const Image<T>& a, const Image<T>& b, double scale,
                  const NoiseCalibrationOptions& options, std::vector<TileNoise>* tiles) {
  const int step = options.mosaic ? 2 : 1;
  const int phases = step * step;
  const int side = kTile * step;
  const int columns = a.width() / side;
  const int rows = a.height() / side;
  const std::size_t per_tile =
      static_cast<std::size_t>(phases) * static_cast<std::size_t>(a.channels());
  const std::size_t first = tiles->size();
  tiles->resize(first +
                static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows) * per_tile);
  ParallelFor(rows, 1, [&](int begin, int end) {
    for (int row = begin; row < end; ++row) {
      for (int column = 0; column < columns; ++column) {
        std::size_t out =
            first + (static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) +
                     static_cast<std::size_t>(column)) *
                        per_tile;
        for (int phase = 0; phase < phases; ++phase) {
          const int x0 = column * side + phase % step;
          const int y0 = row * side + phase / step;
          for (int c = 0; c < a.channels(); ++c) {
            (*tiles)[out++] = Measure(
                [&](int i, int j) {
                  const int x = x0 + i * step;
                  const int y = y0 + j * step;
                  return std::array<double, 2>{a.pixel(x, y)[c] * scale, b.pixel(x, y)[c] * scale};
                },
                options.black);
          }
        }
      }
    }
  });
}

double Level(const DecodedImage& image) {
  return std::visit(
      [](const auto& pixels) {
        double sum = 0.0;
        for (const auto value : pixels.values()) sum += static_cast<double>(value);
        return sum / static_cast<double>(std::max<std::size_t>(1, pixels.size()));
      },
      image.pixels);
}

Status CheckPair(const FlatPair& pair, double scale, double black) {
  const DecodedImage& a = *pair.first;
  const DecodedImage& b = *pair.second;
  if (a.width() != b.width() || a.height() != b.height() || a.channels() != b.channels() ||
      a.is_16_bit() != b.is_16_bit()) {
    return Fail(ErrorKind::kData,
                "{}: {}x{} with {} channels and {}x{} with {}, expected two equal pictures",
                pair.name, a.width(), a.height(), a.channels(), b.width(), b.height(),
                b.channels());
  }
  const double level_a = Level(a) * scale - black;
  const double level_b = Level(b) * scale - black;
  constexpr double kLeastLevel = 0.5;  // of a difference that matters, code values
  if (std::abs(level_a - level_b) >
      std::max(kLeastLevel, kPairLevels * std::max(level_a, level_b))) {
    return Fail(ErrorKind::kData,
                "{}: levels of {:.2f} and {:.2f}: not two pictures of one light and exposure",
                pair.name, level_a, level_b);
  }
  return {};
}

// Weighted straight line y = offset + slope·x with its covariance.
struct Line {
  double offset = 0.0;
  double slope = 0.0;
  double offset_variance = 0.0;
  double slope_variance = 0.0;
};

struct Moments {
  double w = 0.0;
  double x = 0.0;
  double y = 0.0;
  double xx = 0.0;
  double xy = 0.0;
  void Add(double weight, double px, double py) {
    w += weight;
    x += weight * px;
    y += weight * py;
    xx += weight * px * px;
    xy += weight * px * py;
  }
  Line Solve() const {
    Line line;
    const double determinant = w * xx - x * x;
    if (determinant <= 0.0) return line;
    line.slope = (w * xy - x * y) / determinant;
    line.offset = (xx * y - x * xy) / determinant;
    line.offset_variance = xx / determinant;
    line.slope_variance = w / determinant;
    return line;
  }
};

// A sample variance's own relative variance.
constexpr double kVarianceOfVariance = 2.0 / (kTile * kTile - 1);

Line FitTemporal(const std::vector<TileNoise>& tiles, double quantisation) {
  Line line;
  constexpr int kTurns = 4;
  for (int turn = 0; turn < kTurns; ++turn) {
    Moments moments;
    for (const TileNoise& tile : tiles) {
      // Weights from the line, not from the tile's own value, which would favour low ones.
      const double expected =
          turn == 0 ? 1.0 + 0.02 * std::max(0.0, tile.mean)
                    : std::max(line.offset + line.slope * tile.mean + quantisation, quantisation);
      moments.Add(1.0 / (kVarianceOfVariance * expected * expected), tile.mean,
                  tile.temporal - quantisation);
    }
    line = moments.Solve();
  }
  return line;
}

// prnu² and its variance, by weighted least squares of the pattern on mean².
Line FitPattern(const std::vector<TileNoise>& tiles, const Line& temporal, double quantisation) {
  Line fit;
  constexpr int kTurns = 4;
  for (int turn = 0; turn < kTurns; ++turn) {
    double w_sum = 0.0;
    double wy = 0.0;
    for (const TileNoise& tile : tiles) {
      const double mean = std::max(tile.mean, 0.1);
      const double noise =
          std::max(temporal.offset + temporal.slope * mean + quantisation, quantisation);
      const double half = 0.5 * noise;
      const double total = half + std::max(0.0, fit.slope) * mean * mean;
      const double variance = kVarianceOfVariance * (total * total + half * half);
      const double x = mean * mean;
      w_sum += x * x / variance;
      wy += x * tile.pattern / variance;
    }
    fit.slope = wy / w_sum;
    fit.slope_variance = 1.0 / w_sum;
  }
  return fit;
}

// Tiles of like level together, at equal steps of the logarithm.
std::vector<TransferPoint> Points(const std::vector<TileNoise>& tiles) {
  constexpr int kBins = 24;
  const double least = std::log(0.5);
  const double step = (std::log(256.0) - least) / kBins;
  std::array<TransferPoint, kBins> bins{};
  for (const TileNoise& tile : tiles) {
    if (tile.mean <= 0.5) continue;
    const auto k = static_cast<std::size_t>(
        std::clamp(static_cast<int>((std::log(tile.mean) - least) / step), 0, kBins - 1));
    bins[k].mean += tile.mean;
    bins[k].temporal += tile.temporal;
    bins[k].pattern += tile.pattern;
    ++bins[k].tiles;
  }
  std::vector<TransferPoint> points;
  for (TransferPoint point : bins) {
    if (point.tiles == 0) continue;
    const auto n = static_cast<double>(point.tiles);
    point.mean /= n;
    point.temporal /= n;
    point.pattern /= n;
    point.temporal_error = point.temporal * std::sqrt(kVarianceOfVariance / n);
    points.push_back(point);
  }
  return points;
}

}  // namespace

Status NoiseCalibrationOptions::Validate() const {
  if (!(black >= 0.0 && black < 128.0)) {
    return Fail(ErrorKind::kConfig, "black level {}, expected 0 <= black < 128", black);
  }
  if (bits < 8 || bits > 16) return Fail(ErrorKind::kConfig, "{} bits, expected 8 to 16", bits);
  return {};
}

Result<NoiseCalibration> CalibrateNoise(std::span<const FlatPair> pairs,
                                        const NoiseCalibrationOptions& options) {
  OMNIHDR_TRY(options.Validate());
  if (pairs.empty()) {
    return Fail(ErrorKind::kData, "no pairs: expected two pictures of one exposure, or more pairs");
  }
  NoiseCalibration result;
  std::vector<TileNoise> tiles;
  double quantisation = 1.0 / 12.0;
  for (const FlatPair& pair : pairs) {
    const double scale = pair.first->is_16_bit() ? 255.0 / (std::exp2(options.bits) - 1.0) : 1.0;
    OMNIHDR_TRY(CheckPair(pair, scale, options.black));
    quantisation = scale * scale / 12.0;
    std::visit(
        [&](const auto& first) {
          using Pixels = std::decay_t<decltype(first)>;
          MeasureTiles(first, std::get<Pixels>(pair.second->pixels), scale, options, &tiles);
        },
        pair.first->pixels);
  }
  const std::size_t all = tiles.size();
  tiles.erase(
      std::remove_if(tiles.begin(), tiles.end(), [](const TileNoise& t) { return t.clipped; }),
      tiles.end());
  result.clipped = all - tiles.size();
  result.tiles = tiles.size();
  if (tiles.size() < kLeastTiles) {
    return Fail(ErrorKind::kData,
                "{} of {} tiles of {}x{} pixels have values at an end of the range, {} are left, "
                "expected at least {}: clipped, too dark or too small",
                result.clipped, all, kTile, kTile, tiles.size(), kLeastTiles);
  }
  // Levels: the 2nd and 98th percentile, so that a few tiles do not make a range.
  std::vector<double> levels;
  for (const TileNoise& tile : tiles) levels.push_back(tile.mean);
  std::sort(levels.begin(), levels.end());
  const double low = levels[levels.size() / 50];
  const double high = levels[levels.size() - 1 - levels.size() / 50];
  if (!(high > kLeastRange * std::max(low, 0.5))) {
    return Fail(ErrorKind::kData,
                "levels from {:.1f} to {:.1f} above black, expected a ratio of at least {}: take "
                "pairs at several exposures",
                low, high, kLeastRange);
  }
  const Line line = FitTemporal(tiles, quantisation);
  if (!(line.slope > 3.0 * std::sqrt(line.slope_variance))) {
    return Fail(ErrorKind::kData,
                "variance does not grow with the signal ({:.3g} ± {:.3g} per code value): not raw "
                "pictures of light",
                line.slope, std::sqrt(line.slope_variance));
  }
  const Line pattern = FitPattern(tiles, line, quantisation);
  const double prnu = std::sqrt(std::max(0.0, pattern.slope));
  if (prnu > kMostPattern) {
    return Fail(ErrorKind::kData,
                "not flat: values within tiles of {}x{} pixels vary by {:.1f} %, expected at most "
                "{:.0f} %: a surface with texture or an edge",
                kTile, kTile, 100.0 * prnu, 100.0 * kMostPattern);
  }
  result.gain = {line.slope, std::sqrt(line.slope_variance)};
  // Near 0 the error of the square is what can be said.
  const auto root = [](double square, double variance) {
    const double value = std::sqrt(std::max(0.0, square));
    const double error = std::sqrt(variance);
    return Estimate{value, value * value > error ? error / (2.0 * value) : std::sqrt(error)};
  };
  result.read = root(line.offset, line.offset_variance);
  result.prnu = root(pattern.slope, pattern.slope_variance);
  const double full = 255.0 - options.black;
  result.full_well_e = {full / line.slope,
                        full / line.slope * result.gain.standard_error / line.slope};
  result.read_e = {result.read.value / line.slope,
                   std::hypot(result.read.standard_error,
                              result.read.value * result.gain.standard_error / line.slope) /
                       line.slope};
  result.model = {.read = result.read.value, .gain = line.slope, .prnu = prnu};
  result.points = Points(tiles);
  double unexplained = 0.0;
  double total = 0.0;
  double mean_temporal = 0.0;
  for (const TransferPoint& p : result.points) mean_temporal += p.temporal;
  mean_temporal /= static_cast<double>(std::max<std::size_t>(1, result.points.size()));
  for (const TransferPoint& p : result.points) {
    const double predicted = line.offset + line.slope * p.mean + quantisation;
    unexplained += (p.temporal - predicted) * (p.temporal - predicted);
    total += (p.temporal - mean_temporal) * (p.temporal - mean_temporal);
  }
  result.r_squared = total > 0.0 ? 1.0 - unexplained / total : 0.0;
  return result;
}

}  // namespace omnihdr
