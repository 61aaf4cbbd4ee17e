#include "core/quality/seam_metrics.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>
#include <optional>

#include "core/photometry/tonemap.h"

namespace omnihdr {
namespace {

constexpr int kDeep = 3;        // pixels of a side away from the border
constexpr int kReach = 2;       // and along it, each way
constexpr int kLeast = 9;       // pixels of a side
constexpr int kBeside = 4;      // distance of the place a border is compared with
constexpr float kLimit = 2.0F;  // of |e|: a wrong surface is not a seam

struct Side {
  double mean = 0.0;
  double squares = 0.0;  // sum of squared deviations
  int count = 0;
};

struct Step {
  double square = 0.0;        // of the difference, less what noise explains
  double square_noise = 0.0;  // the same in units of noise
};

class Seams {
 public:
  Seams(ImageView<const float> tested, ImageView<const float> truth,
        ImageView<const std::uint8_t> sources, const ComparisonArea& area, bool wraps)
      : error_(tested.width(), tested.height(), 1, kUnknown), sources_(sources), wraps_(wraps) {
    for (int y = 0; y < tested.height(); ++y) {
      for (int x = 0; x < tested.width(); ++x) {
        if (!area.Has(x, y)) continue;
        const float have = Luminance(tested.pixel(x, y));
        const float want = Luminance(truth.pixel(x, y));
        if (!(have > 0.0F) || !(want > 0.0F) || !std::isfinite(have) || !std::isfinite(want)) {
          continue;
        }
        const float e = std::log(have / want);
        if (std::abs(e) < kLimit) error_.at(x, y) = e;
      }
    }
  }

  // Between (x, y) and its neighbour to the right (`down`: below), each side with the sources of
  // its own pixel. Nothing when a side has too few pixels.
  std::optional<Step> At(int x, int y, bool down) const {
    const int nx = down ? x : x + 1;
    const int ny = down ? y + 1 : y;
    const std::optional<int> column = Column(nx);
    if (!column || ny >= error_.height()) return std::nullopt;
    const Side here = SideOf(x, y, down, -1, sources_.at(x, y));
    if (here.count < kLeast) return std::nullopt;
    const Side there = SideOf(nx, ny, down, 1, sources_.at(*column, ny));
    if (there.count < kLeast) return std::nullopt;
    const double variance = (here.squares + there.squares) / (here.count + there.count - 2);
    const double difference = there.mean - here.mean;
    const double chance = variance * (1.0 / here.count + 1.0 / there.count);
    Step step;
    step.square = difference * difference - chance;
    step.square_noise = step.square / std::max(variance, kLeastVariance);
    return step;
  }

  std::optional<int> Column(int x) const {
    if (x >= 0 && x < error_.width()) return x;
    if (!wraps_) return std::nullopt;
    return (x + error_.width()) % error_.width();
  }

 private:
  static constexpr float kUnknown = 1e9F;
  static constexpr double kLeastVariance = 1e-8;

  Side SideOf(int x, int y, bool down, int sign, std::uint8_t of) const {
    double sum = 0.0;
    double sum_squares = 0.0;
    Side side;
    for (int along = -kReach; along <= kReach; ++along) {
      for (int deep = 0; deep < kDeep; ++deep) {
        const int px = down ? x + along : x + sign * deep;
        const int py = down ? y + sign * deep : y + along;
        if (py < 0 || py >= error_.height()) continue;
        const std::optional<int> column = Column(px);
        if (!column || sources_.at(*column, py) != of) continue;
        const float e = error_.at(*column, py);
        if (e == kUnknown) continue;
        sum += static_cast<double>(e);
        sum_squares += static_cast<double>(e) * static_cast<double>(e);
        ++side.count;
      }
    }
    if (side.count == 0) return side;
    side.mean = sum / side.count;
    side.squares = std::max(0.0, sum_squares - sum * side.mean);
    return side;
  }

  Image<float> error_;
  ImageView<const std::uint8_t> sources_;
  bool wraps_;
};

struct Sums {
  double square = 0.0;
  double square_noise = 0.0;
  double visible = 0.0;
  double weight = 0.0;
  void Add(const Step& step, double w) {
    square += w * step.square;
    // One border with hardly any noise is not to outweigh all others.
    square_noise += w * std::min(step.square_noise, 100.0);
    visible += step.square_noise > 1.0 ? w : 0.0;
    weight += w;
  }
};

}  // namespace

SeamErrors FindSeams(ImageView<const float> tested, ImageView<const float> truth,
                     ImageView<const std::uint8_t> sources, const ComparisonArea& area,
                     bool wraps) {
  assert(tested.width() == truth.width() && tested.height() == truth.height());
  assert(tested.width() == sources.width() && tested.height() == sources.height());
  const Seams seams(tested, truth, sources, area, wraps);
  SeamErrors errors;
  Sums at;
  Sums beside;
  for (int y = 0; y < tested.height(); ++y) {
    for (int x = 0; x < tested.width(); ++x) {
      for (const bool down : {false, true}) {
        const std::optional<int> next = seams.Column(down ? x : x + 1);
        const int next_y = down ? y + 1 : y;
        if (!next || next_y >= tested.height() || sources.at(x, y) == sources.at(*next, next_y)) {
          continue;
        }
        const std::optional<Step> step = seams.At(x, y, down);
        if (!step) continue;
        ++errors.borders;
        at.Add(*step, area.Weight(y));
        for (const int sign : {-1, 1}) {
          const std::optional<int> bx = seams.Column(down ? x : x + sign * kBeside);
          const int by = down ? y + sign * kBeside : y;
          if (!bx || by < 0 || by + 1 >= tested.height()) continue;
          const std::optional<int> bn = seams.Column(down ? *bx : *bx + 1);
          if (!bn || sources.at(*bx, by) != sources.at(*bn, down ? by + 1 : by)) continue;
          if (const std::optional<Step> other = seams.At(*bx, by, down)) {
            beside.Add(*other, area.Weight(y));
          }
        }
      }
    }
  }
  if (!(at.weight > 0.0)) return errors;
  const auto excess = [&](double Sums::*sum) {
    const double elsewhere = beside.weight > 0.0 ? beside.*sum / beside.weight : 0.0;
    return std::max(0.0, at.*sum / at.weight - elsewhere);
  };
  errors.excess_noise = std::sqrt(excess(&Sums::square_noise));
  errors.excess_log10 = std::sqrt(excess(&Sums::square)) * std::numbers::log10e;
  errors.visible = excess(&Sums::visible);
  return errors;
}

}  // namespace omnihdr
