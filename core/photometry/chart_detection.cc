#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include "core/photometry/color_chart.h"
#include "core/photometry/flat_patches.h"

namespace omnihdr {
namespace {

using Cell = std::pair<int, int>;
using Samples = std::array<std::array<double, 3>, kChartPatches>;  // NaN: not to be used

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr int kMostCells = 60;

// Correlation over the patches where both are known, NaN when these are fewer than `fewest`.
double Correlation(const std::array<double, kChartPatches>& a,
                   const std::array<double, kChartPatches>& b, int fewest) {
  double n = 0.0;
  double sa = 0.0;
  double sb = 0.0;
  for (std::size_t i = 0; i < kChartPatches; ++i) {
    if (!std::isfinite(a[i] + b[i])) continue;
    n += 1.0;
    sa += a[i];
    sb += b[i];
  }
  if (n < fewest) return kNaN;
  double aa = 0.0;
  double bb = 0.0;
  double ab = 0.0;
  for (std::size_t i = 0; i < kChartPatches; ++i) {
    if (!std::isfinite(a[i] + b[i])) continue;
    const double da = a[i] - sa / n;
    const double db = b[i] - sb / n;
    aa += da * da;
    bb += db * db;
    ab += da * db;
  }
  return aa > 0.0 && bb > 0.0 ? ab / std::sqrt(aa * bb) : kNaN;
}

struct Reference {
  std::array<std::array<double, kChartPatches>, 3> ln{};      // R, G, B
  std::array<std::array<double, kChartPatches>, 2> chroma{};  // ln R/G, ln B/G
};

const Reference& LnReference() {
  static const Reference reference = [] {
    Reference r;
    for (std::size_t patch = 0; patch < kChartPatches; ++patch) {
      const std::array<double, 3> rgb = ChartLinearLight(static_cast<int>(patch));
      // A sensor's primaries overlap more than sRGB's: no channel of a patch is nearly black.
      const double mean = (rgb[0] + rgb[1] + rgb[2]) / 3.0;
      std::array<double, 3> ln{};
      for (std::size_t c = 0; c < 3; ++c) ln[c] = std::log(0.8 * rgb[c] + 0.2 * mean);
      for (std::size_t c = 0; c < 3; ++c) r.ln[c][patch] = ln[c];
      r.chroma[0][patch] = ln[0] - ln[1];
      r.chroma[1][patch] = ln[2] - ln[1];
    }
    return r;
  }();
  return reference;
}

// How well samples agree with the chart: mean correlation of brightness and colour; -1 where the
// grey row is not grey or does not fall from white to black.
double Agreement(const Samples& samples, bool has_colour) {
  const Reference& reference = LnReference();
  std::array<std::array<double, kChartPatches>, 3> ln{};
  for (std::size_t patch = 0; patch < kChartPatches; ++patch) {
    for (std::size_t c = 0; c < 3; ++c) ln[c][patch] = std::log(samples[patch][c]);
  }
  double last = std::numeric_limits<double>::infinity();
  double first = kNaN;
  for (std::size_t patch = kChartFirstGrey; patch < kChartPatches; ++patch) {
    const double v = ln[1][patch];
    if (!std::isfinite(v)) continue;
    if (!(v < last - 0.02)) return -1.0;
    last = v;
    if (std::isnan(first)) first = v;
  }
  if (!(first - last > 0.35)) return -1.0;
  const double brightness = Correlation(ln[1], reference.ln[1], kChartPatches / 2);
  if (!std::isfinite(brightness)) return -1.0;
  if (!has_colour) {
    // Without colour only the order of brightness speaks, and that must be close.
    return brightness > 0.9 ? brightness : std::min(brightness, 0.5);
  }
  double sum = 0.0;
  for (std::size_t k = 0; k < 2; ++k) {
    std::array<double, kChartPatches> chroma{};
    double grey = 0.0;
    double grey2 = 0.0;
    double greys = 0.0;
    double other2 = 0.0;
    double others = 0.0;
    for (std::size_t patch = 0; patch < kChartPatches; ++patch) {
      chroma[patch] = ln[2 * k][patch] - ln[1][patch];
    }
    for (std::size_t patch = kChartFirstGrey; patch < kChartPatches; ++patch) {
      if (!std::isfinite(chroma[patch])) continue;
      grey += chroma[patch];
      grey2 += chroma[patch] * chroma[patch];
      greys += 1.0;
    }
    if (greys < 2.0) return -1.0;
    const double neutral = grey / greys;
    const double spread = std::sqrt(std::max(0.0, grey2 / greys - neutral * neutral));
    for (std::size_t patch = 0; patch < kChartFirstGrey; ++patch) {
      if (!std::isfinite(chroma[patch])) continue;
      other2 += (chroma[patch] - neutral) * (chroma[patch] - neutral);
      others += 1.0;
    }
    if (others < 6.0 || spread > 0.5 * std::sqrt(other2 / others)) return -1.0;
    const double correlation = Correlation(chroma, reference.chroma[k], kChartPatches / 2);
    if (!std::isfinite(correlation)) return -1.0;
    sum += correlation;
  }
  return (brightness + sum) / 3.0;
}

// A grid of flat patches, in steps from the patch it was grown from.
struct Grid {
  std::map<Cell, std::size_t> cells;  // index of the patch
};

class GridFinder {
 public:
  explicit GridFinder(const std::vector<FlatPatch>& patches) : patches_(patches) {
    order_.resize(patches.size());
    for (std::size_t i = 0; i < order_.size(); ++i) order_[i] = i;
    std::sort(order_.begin(), order_.end(), [this](std::size_t a, std::size_t b) {
      return patches_[a].centre.x() < patches_[b].centre.x();
    });
    for (const std::size_t i : order_) sorted_x_.push_back(patches_[i].centre.x());
  }

  // Grids grown from every patch, not one inside another.
  std::vector<Grid> Find(std::size_t least) const {
    std::vector<Grid> grids;
    std::vector<std::uint8_t> used(patches_.size(), 0);
    for (std::size_t seed = 0; seed < patches_.size(); ++seed) {
      if (used[seed] >= 3) continue;
      const std::vector<std::size_t> near = Neighbours(seed);
      for (const auto& [u, v] : Axes(seed, near)) {
        Grid grid = Grow(seed, u, v);
        if (grid.cells.size() < least) continue;
        for (const auto& [cell, index] : grid.cells) ++used[index];
        grids.push_back(std::move(grid));
      }
    }
    std::stable_sort(grids.begin(), grids.end(),
                     [](const Grid& a, const Grid& b) { return a.cells.size() > b.cells.size(); });
    return grids;
  }

 private:
  template <typename Visit>
  void VisitNear(const Eigen::Vector2d& at, double radius, const Visit& visit) const {
    const auto begin = std::lower_bound(sorted_x_.begin(), sorted_x_.end(), at.x() - radius);
    for (auto i = static_cast<std::size_t>(begin - sorted_x_.begin());
         i < sorted_x_.size() && sorted_x_[i] <= at.x() + radius; ++i) {
      if ((patches_[order_[i]].centre - at).squaredNorm() <= radius * radius) visit(order_[i]);
    }
  }

  static bool SimilarArea(double a, double b, double factor) {
    return a < factor * b && b < factor * a;
  }

  // Patches one step away: in coordinates in which the patch is a square of side √12, a step is a
  // little more than a side.
  std::vector<std::size_t> Neighbours(std::size_t seed) const {
    const FlatPatch& patch = patches_[seed];
    const Eigen::Matrix2d inverse = patch.covariance.inverse();
    std::vector<std::size_t> near;
    VisitNear(patch.centre, 6.0 * std::sqrt(patch.covariance.trace()), [&](std::size_t i) {
      const Eigen::Vector2d d = patches_[i].centre - patch.centre;
      const double distance = std::sqrt(d.dot(inverse * d));
      if (distance > 2.9 && distance < 6.2 && SimilarArea(patches_[i].area, patch.area, 2.5)) {
        near.push_back(i);
      }
    });
    return near;
  }

  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> Axes(
      std::size_t seed, const std::vector<std::size_t>& near) const {
    const FlatPatch& patch = patches_[seed];
    const Eigen::Matrix2d inverse = patch.covariance.inverse();
    std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> axes;
    for (const std::size_t a : near) {
      for (const std::size_t b : near) {
        const Eigen::Vector2d u = patches_[a].centre - patch.centre;
        const Eigen::Vector2d v = patches_[b].centre - patch.centre;
        const double uu = u.dot(inverse * u);
        const double vv = v.dot(inverse * v);
        const double uv = u.dot(inverse * v);
        // One turn only, and about as long and at right angles: the chart's patches are squares.
        if (u.x() * v.y() - u.y() * v.x() <= 0.0) continue;
        if (uv * uv > 0.16 * uu * vv || uu > 2.0 * vv || vv > 2.0 * uu) continue;
        axes.emplace_back(u, v);
        if (axes.size() == 6) return axes;
      }
    }
    return axes;
  }

  // Cell by cell with the local steps, so that perspective and distortion may bend the grid.
  Grid Grow(std::size_t seed, const Eigen::Vector2d& u, const Eigen::Vector2d& v) const {
    struct Placed {
      Cell cell;
      std::size_t patch;
      Eigen::Vector2d u;
      Eigen::Vector2d v;
    };
    Grid grid;
    std::vector<Placed> queue = {{{0, 0}, seed, u, v}};
    grid.cells[{0, 0}] = seed;
    std::map<std::size_t, Cell> taken = {{seed, {0, 0}}};
    for (std::size_t k = 0; k < queue.size() && grid.cells.size() < kMostCells; ++k) {
      const Placed here = queue[k];
      const FlatPatch& patch = patches_[here.patch];
      static constexpr std::array<Cell, 4> kSteps = {Cell{1, 0}, Cell{0, 1}, Cell{-1, 0},
                                                     Cell{0, -1}};
      for (const Cell& step : kSteps) {
        const Cell cell(here.cell.first + step.first, here.cell.second + step.second);
        if (std::abs(cell.first) > 6 || std::abs(cell.second) > 6) continue;
        if (grid.cells.count(cell) != 0) continue;
        const Eigen::Vector2d move = step.first * here.u + step.second * here.v;
        const Eigen::Vector2d expected = patch.centre + move;
        const double tolerance = 0.25 * move.norm();
        double nearest = tolerance;
        std::size_t found = patches_.size();
        VisitNear(expected, tolerance, [&](std::size_t i) {
          const double distance = (patches_[i].centre - expected).norm();
          if (distance < nearest && SimilarArea(patches_[i].area, patch.area, 2.2) &&
              taken.count(i) == 0) {
            nearest = distance;
            found = i;
          }
        });
        if (found == patches_.size()) continue;
        Placed next{cell, found, here.u, here.v};
        const Eigen::Vector2d moved = patches_[found].centre - patch.centre;
        (step.first != 0 ? next.u : next.v) = (step.first + step.second) * moved;
        grid.cells[cell] = found;
        taken[found] = cell;
        queue.push_back(next);
      }
    }
    return grid;
  }

  const std::vector<FlatPatch>& patches_;
  std::vector<std::size_t> order_;
  std::vector<double> sorted_x_;
};

// One of the eight ways a chart's columns and rows can lie in a grid's.
Cell Turned(const Cell& cell, int way) {
  const auto [i, j] = cell;
  switch (way) {
    case 0:
      return {i, j};
    case 1:
      return {-j, i};
    case 2:
      return {-i, -j};
    case 3:
      return {j, -i};
    case 4:
      return {-i, j};
    case 5:
      return {j, i};
    case 6:
      return {i, -j};
    default:
      return {-j, -i};
  }
}

struct Hypothesis {
  double agreement = -1.0;
  ChartGeometry geometry;
  int patches = 0;
};

// Mean values at one place of a level, NaN where the sensor clips or sees nothing.
bool SampleAt(const PatchLevel& level, const Eigen::Vector2d& at, int half, bool has_colour,
              std::array<double, 3>* sample) {
  const int x0 = static_cast<int>(std::floor(at.x()));
  const int y0 = static_cast<int>(std::floor(at.y()));
  if (!at.allFinite() || x0 - half < 0 || y0 - half < 0 || x0 + half >= level.linear.width() ||
      y0 + half >= level.linear.height()) {
    return false;
  }
  for (int c = 0; c < 3; ++c) {
    double sum = 0.0;
    for (int y = y0 - half; y <= y0 + half; ++y) {
      for (int x = x0 - half; x <= x0 + half; ++x) {
        sum += level.linear.at(x, y, has_colour ? c : 0);
      }
    }
    const double mean = sum / ((2 * half + 1) * (2 * half + 1));
    (*sample)[static_cast<std::size_t>(c)] = mean > 251.0 || mean < 0.3 ? kNaN : mean;
  }
  return true;
}

// The same round every patch's centre; nothing when one is outside.
bool SamplePatches(const PatchLevel& level, const ChartGeometry& geometry, bool has_colour,
                   Samples* samples) {
  const double step = geometry.PatchStep() / level.factor;
  const int half = std::clamp(static_cast<int>(0.15 * step), 0, 8);
  for (int patch = 0; patch < kChartPatches; ++patch) {
    if (!SampleAt(level, geometry.PatchCentre(patch) / level.factor, half, has_colour,
                  &(*samples)[static_cast<std::size_t>(patch)])) {
      return false;
    }
  }
  return true;
}

// Whether the cells' own colours could be the chart's, before anything is fitted: on a grid of
// bricks thousands of placements are possible.
bool MayBeChart(const Samples& samples, bool has_colour) {
  const Reference& reference = LnReference();
  std::array<double, kChartPatches> brightness{};
  for (std::size_t patch = 0; patch < kChartPatches; ++patch) {
    brightness[patch] = std::log(samples[patch][1]);
  }
  constexpr double kLeast = 0.5;
  constexpr int kFewest = 6;
  if (!(Correlation(brightness, reference.ln[1], kFewest) > kLeast)) return false;
  for (std::size_t k = 0; k < 2 && has_colour; ++k) {
    std::array<double, kChartPatches> chroma{};
    for (std::size_t patch = 0; patch < kChartPatches; ++patch) {
      chroma[patch] = std::log(samples[patch][2 * k] / samples[patch][1]);
    }
    if (!(Correlation(chroma, reference.chroma[k], kFewest) > kLeast)) return false;
  }
  return true;
}

// Tries every placement of the chart on a grid.
Hypothesis BestPlacement(const Grid& grid, const std::vector<FlatPatch>& patches,
                         const PatchLevel& level, const SensorPicture& picture, int least) {
  const bool has_colour = picture.has_colour();
  std::map<Cell, std::array<double, 3>> colours;
  for (const auto& [cell, index] : grid.cells) {
    const int half =
        std::clamp(static_cast<int>(0.15 * std::sqrt(patches[index].area) / level.factor), 0, 8);
    std::array<double, 3> colour = {kNaN, kNaN, kNaN};
    SampleAt(level, patches[index].centre / level.factor, half, has_colour, &colour);
    colours[cell] = colour;
  }
  Hypothesis best;
  for (int way = 0; way < 8; ++way) {
    std::vector<std::pair<Cell, Cell>> cells;  // turned, of the grid
    Cell low(1000, 1000);
    Cell high(-1000, -1000);
    for (const auto& [cell, index] : grid.cells) {
      const Cell turned = Turned(cell, way);
      cells.emplace_back(turned, cell);
      low = {std::min(low.first, turned.first), std::min(low.second, turned.second)};
      high = {std::max(high.first, turned.first), std::max(high.second, turned.second)};
    }
    for (int row = low.second - kChartRows + 1; row <= high.second; ++row) {
      for (int column = low.first - kChartColumns + 1; column <= high.first; ++column) {
        Samples samples;
        for (std::array<double, 3>& sample : samples) sample.fill(kNaN);
        std::vector<Eigen::Vector2d> chart;
        std::vector<Eigen::Vector2d> pixels;
        for (const auto& [turned, cell] : cells) {
          const int c = turned.first - column;
          const int r = turned.second - row;
          if (c < 0 || c >= kChartColumns || r < 0 || r >= kChartRows) continue;
          samples[static_cast<std::size_t>(r * kChartColumns + c)] = colours[cell];
          chart.emplace_back(c + 0.5, r + 0.5);
          pixels.push_back(patches[grid.cells.at(cell)].centre);
        }
        const int inside = static_cast<int>(chart.size());
        if (inside < least || !MayBeChart(samples, has_colour)) continue;
        const std::optional<ChartGeometry> geometry =
            ChartGeometry::Fit(chart, pixels, picture.width(), picture.height(), false);
        if (!geometry || !SamplePatches(level, *geometry, has_colour, &samples)) continue;
        const double agreement = Agreement(samples, has_colour);
        if (agreement > best.agreement) best = {agreement, *geometry, inside};
      }
    }
  }
  return best;
}

// Takes every patch near where the geometry expects it and fits again, with lens distortion; what
// lies far off the fit (a patch that ran into its neighbourhood) is left out.
void RefineWithPatches(const std::vector<FlatPatch>& patches, const SensorPicture& picture,
                       ChartDetection* detection) {
  for (int round = 0; round < 4; ++round) {
    std::vector<Eigen::Vector2d> chart;
    std::vector<Eigen::Vector2d> pixels;
    std::vector<double> distances;
    for (int patch = 0; patch < kChartPatches; ++patch) {
      const Eigen::Vector2d at = detection->geometry.PatchCentre(patch);
      const std::array<Eigen::Vector2d, 4> square = detection->geometry.PatchSquare(patch, 0.5);
      const Eigen::Vector2d u = square[1] - square[0];
      const Eigen::Vector2d v = square[3] - square[0];
      const double area = std::abs(u.x() * v.y() - u.y() * v.x());
      double nearest = (round == 0 ? 0.3 : 0.2) * std::sqrt(area);
      const FlatPatch* found = nullptr;
      for (const FlatPatch& candidate : patches) {
        const double distance = (candidate.centre - at).norm();
        if (distance < nearest && candidate.area > 0.35 * area && candidate.area < 1.3 * area) {
          nearest = distance;
          found = &candidate;
        }
      }
      if (found == nullptr) continue;
      chart.push_back(PatchInChart(patch));
      pixels.push_back(found->centre);
      distances.push_back(nearest);
    }
    if (chart.size() < 8) return;
    if (round > 0) {
      std::vector<double> sorted = distances;
      std::sort(sorted.begin(), sorted.end());
      const double limit =
          std::max(3.0 * sorted[sorted.size() / 2], 0.01 * detection->geometry.PatchStep());
      std::size_t kept = 0;
      for (std::size_t i = 0; i < chart.size(); ++i) {
        if (distances[i] > limit) continue;
        chart[kept] = chart[i];
        pixels[kept] = pixels[i];
        ++kept;
      }
      if (kept >= 8) {
        chart.resize(kept);
        pixels.resize(kept);
      }
    }
    const std::optional<ChartGeometry> fitted =
        ChartGeometry::Fit(chart, pixels, picture.width(), picture.height(), true);
    if (!fitted) return;
    double squares = 0.0;
    for (std::size_t i = 0; i < chart.size(); ++i) {
      squares += (fitted->PixelFromChart(chart[i]) - pixels[i]).squaredNorm();
    }
    detection->geometry = *fitted;
    detection->patches_seen = static_cast<int>(chart.size());
    detection->residual =
        std::sqrt(squares / static_cast<double>(chart.size())) / fitted->PatchStep();
  }
}

// Refines at every level at which a patch is wide enough to have edges, and keeps the best.
void RefineAtLevels(const std::vector<PatchLevel>& levels,
                    const std::vector<std::vector<FlatPatch>>& patches,
                    const SensorPicture& picture, ChartDetection* detection) {
  const ChartDetection start = *detection;
  const double step = start.geometry.PatchStep();
  double best = -1.0;
  for (std::size_t l = 0; l < levels.size() && l < patches.size(); ++l) {
    if (step < 7.0 * levels[l].factor) break;
    ChartDetection refined = start;
    refined.patches_seen = 0;
    RefineWithPatches(patches[l], picture, &refined);
    // A hundredth of a step weighs as much as a patch.
    const double merit = refined.patches_seen - 100.0 * refined.residual;
    if (refined.patches_seen > 0 && merit > best) {
      best = merit;
      *detection = refined;
    }
  }
}

void Orient(ChartDetection* detection) {
  const ChartGeometry& g = detection->geometry;
  const Eigen::Vector2d middle = g.PixelFromChart({0.5 * kChartColumns, 0.5 * kChartRows});
  const Eigen::Vector2d right =
      g.PixelFromChart({0.5 * kChartColumns + 1.0, 0.5 * kChartRows}) - middle;
  const Eigen::Vector2d down =
      g.PixelFromChart({0.5 * kChartColumns, 0.5 * kChartRows + 1.0}) - middle;
  detection->mirrored = right.x() * down.y() - right.y() * down.x() < 0.0;
  constexpr double kDegrees = 57.29577951308232;
  const double angle = std::atan2(-down.x(), down.y()) * kDegrees;
  detection->rotation_deg = angle < 0.0 ? angle + 360.0 : angle;
}

constexpr char kWhatHelps[] =
    "the chart should fill a fifth of the picture or more, its white patch below and its dark "
    "patches above the limits of the sensor; or give its corners (--corners: centres of dark skin, "
    "bluish green, black, white)";

}  // namespace

Result<ChartDetection> DetectColorChart(const SensorPicture& picture,
                                        const ChartDetectOptions& options) {
  const std::vector<PatchLevel> levels = MakePatchLevels(picture);
  Hypothesis best;
  std::size_t best_level = 0;
  std::vector<std::vector<FlatPatch>> patches;
  std::size_t largest_grid = 0;
  std::size_t most_patches = 0;
  for (std::size_t l = 0; l < levels.size(); ++l) {
    patches.push_back(FindFlatPatches(levels[l]));
    most_patches = std::max(most_patches, patches[l].size());
    const std::vector<Grid> grids =
        GridFinder(patches[l])
            .Find(static_cast<std::size_t>(std::max(6, options.least_patches - 3)));
    constexpr std::size_t kMostGrids = 200;
    for (std::size_t k = 0; k < std::min(grids.size(), kMostGrids); ++k) {
      largest_grid = std::max(largest_grid, grids[k].cells.size());
      const Hypothesis hypothesis = BestPlacement(grids[k], patches[l], levels[l], picture,
                                                  std::max(6, options.least_patches - 3));
      if (hypothesis.agreement > best.agreement) {
        best = hypothesis;
        best_level = l;
      }
    }
  }
  ChartDetection detection;
  if (best.agreement >= options.least_agreement) {
    detection.geometry = best.geometry;
    detection.patches_seen = best.patches;
    RefineAtLevels(levels, patches, picture, &detection);
    Samples samples;
    if (SamplePatches(levels[best_level], detection.geometry, picture.has_colour(), &samples)) {
      detection.agreement = Agreement(samples, picture.has_colour());
    }
    Orient(&detection);
    if (detection.agreement >= options.least_agreement &&
        detection.patches_seen >= options.least_patches && detection.residual < 0.1) {
      return detection;
    }
  }
  if (largest_grid == 0) {
    return Fail(ErrorKind::kData,
                "no ColorChecker found: {} even areas, none of which form a grid of {} or more; {}",
                most_patches, std::max(6, options.least_patches - 3), kWhatHelps);
  }
  return Fail(ErrorKind::kData,
              "no ColorChecker found: {} even areas, the largest grid of them has {} cells, its "
              "colours agree with a chart's to {:.2f} (needs {:.2f}); {}",
              most_patches, largest_grid, std::max(best.agreement, 0.0), options.least_agreement,
              kWhatHelps);
}

Result<ChartDetection> ColorChartAtCorners(const SensorPicture& picture,
                                           const std::array<Eigen::Vector2d, 4>& corners,
                                           const ChartDetectOptions& options) {
  for (const Eigen::Vector2d& corner : corners) {
    if (!corner.allFinite() || corner.x() < 0.0 || corner.y() < 0.0 ||
        corner.x() > picture.width() || corner.y() > picture.height()) {
      return Fail(ErrorKind::kUsage, "corner {:g},{:g}: outside the picture of {}x{}", corner.x(),
                  corner.y(), picture.width(), picture.height());
    }
  }
  int left = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    const Eigen::Vector2d a = corners[(i + 1) % 4] - corners[i];
    const Eigen::Vector2d b = corners[(i + 2) % 4] - corners[(i + 1) % 4];
    left += a.x() * b.y() - a.y() * b.x() > 0.0 ? 1 : 0;
  }
  const std::optional<ChartGeometry> geometry =
      left == 0 || left == 4 ? ChartGeometry::Fit({{0.5, 0.5}, {5.5, 0.5}, {5.5, 3.5}, {0.5, 3.5}},
                                                  {corners.begin(), corners.end()}, picture.width(),
                                                  picture.height(), false)
                             : std::nullopt;
  if (!geometry) {
    return Fail(ErrorKind::kUsage,
                "the corners are not a convex quadrilateral; expected the centres of dark skin, "
                "bluish green, black and white in this order");
  }
  ChartDetection detection;
  detection.geometry = *geometry;
  detection.from_corners = true;
  const std::vector<PatchLevel> levels = MakePatchLevels(picture);
  if (levels.empty()) {
    return Fail(ErrorKind::kData, "picture of {}x{}: too small for a chart", picture.width(),
                picture.height());
  }
  std::vector<std::vector<FlatPatch>> patches;
  std::size_t l = 0;
  for (std::size_t i = 0; i < levels.size(); ++i) {
    const double step = geometry->PatchStep() / levels[i].factor;
    // Finer than 60 pixels a patch shows noise rather than edges.
    patches.push_back(step < 60.0 ? FindFlatPatches(levels[i]) : std::vector<FlatPatch>{});
    if (step >= 12.0) l = i;
  }
  RefineAtLevels(levels, patches, picture, &detection);
  Samples samples;
  if (!SamplePatches(levels[l], detection.geometry, picture.has_colour(), &samples)) {
    return Fail(ErrorKind::kUsage, "the corners place patches outside the picture");
  }
  detection.agreement = Agreement(samples, picture.has_colour());
  Orient(&detection);
  // A person has pointed at it: only what cannot be a chart is refused.
  if (detection.agreement < 0.5 * options.least_agreement) {
    return Fail(
        ErrorKind::kData,
        "the patches between the corners do not have a ColorChecker's colours in that order "
        "(agreement {:.2f}); expected the centres of dark skin, bluish green, black and "
        "white in this order",
        std::max(detection.agreement, 0.0));
  }
  return detection;
}

}  // namespace omnihdr
