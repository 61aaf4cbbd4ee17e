#include "core/photometry/green_guide.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

// A row of the mosaic and those around it, mirrored at the sensor's border, which keeps the
// colours.
struct Rows {
  std::array<const float*, 5> value{};         // y − 2 … y + 2
  std::array<const std::uint8_t*, 5> state{};  // the same
};

float Blend(float across, float along, float change_across, float change_along) {
  const float a = change_along * change_along;
  const float b = change_across * change_across;
  const float sum = a + b;
  return sum > 0.0F ? (a * across + b * along) / sum : 0.5F * (across + along);
}

// Green of every second pixel, none of whose values is saturated. `scale`: of the colour there to
// green.
OMNIHDR_SIMD_CLONES void GuideRow(const float* __restrict up2, const float* __restrict up,
                                  const float* __restrict row, const float* __restrict down,
                                  const float* __restrict down2, int first, int end, float scale,
                                  float* __restrict out) {
  for (int x = first; x < end; x += 2) {
    const float left = row[x - 1];
    const float right = row[x + 1];
    const float above = up[x];
    const float below = down[x];
    const float centre = 2.0F * row[x];
    const float bend_h = scale * (centre - row[x - 2] - row[x + 2]);
    const float bend_v = scale * (centre - up2[x] - down2[x]);
    const float change_h = std::fabs(left - right) + std::fabs(bend_h);
    const float change_v = std::fabs(above - below) + std::fabs(bend_v);
    const float h = 0.5F * (left + right) + 0.25F * bend_h;
    const float v = 0.5F * (above + below) + 0.25F * bend_v;
    const float wh = change_v * change_v + 1e-30F;
    const float wv = change_h * change_h + 1e-30F;
    const float green = (wh * h + wv * v) / (wh + wv);
    const float ab_low = above < below ? above : below;
    const float ab_high = above < below ? below : above;
    const float lr_low = left < right ? left : right;
    const float lr_high = left < right ? right : left;
    const float low = ab_low < lr_low ? ab_low : lr_low;
    const float high = ab_high > lr_high ? ab_high : lr_high;
    const float raised = green > low ? green : low;
    out[x] = raised < high ? raised : high;
  }
}

// One pixel, with care: at the border, or where something is saturated.
float GuideAt(const Rows& rows, int x, int width, float scale) {
  const auto mirrored = [width](int i) {
    if (i < 0) return -i;
    return i < width ? i : 2 * (width - 1) - i;
  };
  struct Value {
    float value;
    bool clipped;
  };
  const auto at = [&](int dx, int dy) {
    const int i = mirrored(x + dx);
    const auto j = static_cast<std::size_t>(dy + 2);
    return Value{rows.value[j][i], rows.state[j][i] == kMosaicSaturated};
  };
  const Value centre = at(0, 0);
  float low = 0.0F;
  float high = 0.0F;
  int open = 0;
  std::array<float, 2> estimate{};
  std::array<float, 2> change{};
  std::array<bool, 2> known{};
  float sum = 0.0F;
  float sum_of_all = 0.0F;
  for (std::size_t d = 0; d < 2; ++d) {
    const int dx = d == 0 ? 1 : 0;
    const int dy = 1 - dx;
    const Value a = at(-dx, -dy);
    const Value b = at(dx, dy);
    const Value a2 = at(-2 * dx, -2 * dy);
    const Value b2 = at(2 * dx, 2 * dy);
    for (const Value& v : {a, b}) {
      sum_of_all += v.value;
      if (v.clipped) continue;
      low = open == 0 ? v.value : std::min(low, v.value);
      high = open == 0 ? v.value : std::max(high, v.value);
      sum += v.value;
      ++open;
    }
    known[d] = !a.clipped && !b.clipped;
    if (!known[d]) continue;
    const bool bends = !centre.clipped && !a2.clipped && !b2.clipped;
    const float bend = bends ? scale * (2.0F * centre.value - a2.value - b2.value) : 0.0F;
    estimate[d] = 0.5F * (a.value + b.value) + 0.25F * bend;
    change[d] = std::fabs(a.value - b.value) + std::fabs(bend);
  }
  if (open == 0) return 0.25F * sum_of_all;
  float green = sum / static_cast<float>(open);
  if (known[0] && known[1]) {
    green = Blend(estimate[0], estimate[1], change[0], change[1]);
  } else if (known[0] || known[1]) {
    green = estimate[known[0] ? 0 : 1];
  }
  return std::min(std::max(low, green), high);  // low where it is not a number
}

bool AnySaturated(const std::uint8_t* state, int begin, int end) {
  return std::find(state + begin, state + end, std::uint8_t{kMosaicSaturated}) != state + end;
}

void GuideRowOfSensor(const RigSensor& sensor, const Rows& rows, int y, int width, float* out) {
  std::copy_n(rows.value[2], width, out);
  if (sensor.bayer == BayerOrder::kNone || width < 3) return;
  const int first = BayerChannel(sensor.bayer, 0, y) == 1 ? 1 : 0;
  const auto colour = static_cast<std::size_t>(BayerChannel(sensor.bayer, first, y));
  const auto scale = static_cast<float>(sensor.gain[colour] / sensor.gain[1]);
  // In pieces, so that one lamp does not slow down a row.
  constexpr int kPiece = 64;
  for (int begin = first; begin < width; begin += kPiece) {
    const int end = std::min(begin + kPiece, width);
    const int from = std::max(begin - 2, 0);
    const int to = std::min(end + 2, width);
    bool careful = from == 0 || to == width;
    for (std::size_t j = 0; j < 5 && !careful; ++j) {
      careful = AnySaturated(rows.state[j], from, to);
    }
    if (careful) {
      for (int x = begin; x < end; x += 2) out[x] = GuideAt(rows, x, width, scale);
    } else {
      GuideRow(rows.value[0], rows.value[1], rows.value[2], rows.value[3], rows.value[4], begin,
               end, scale, out);
    }
  }
}

}  // namespace

void GreenGuide(const RadianceMosaic& mosaic, const Rig& rig, const std::vector<int>& rows,
                Image<float>* guide) {
  const int width = mosaic.radiance.width();
  const int height = mosaic.radiance.height();
  if (guide->width() != width || guide->height() != height) {
    *guide = Image<float>::Uninitialized(width, height);
  }
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const auto s = static_cast<std::size_t>(std::upper_bound(rows.begin(), rows.end(), y) -
                                              rows.begin() - 1);
      const int count = rows[s + 1] - rows[s];
      Rows around;
      for (int dy = -2; dy <= 2; ++dy) {
        int at = y - rows[s] + dy;
        if (at < 0) at = -at;
        if (at >= count) at = 2 * (count - 1) - at;
        at = rows[s] + std::clamp(at, 0, count - 1);
        around.value[static_cast<std::size_t>(dy + 2)] = mosaic.radiance.row(at);
        around.state[static_cast<std::size_t>(dy + 2)] = mosaic.state.row(at);
      }
      GuideRowOfSensor(rig.sensors[s], around, y - rows[s], width, guide->row(y));
    }
  });
}

}  // namespace omnihdr
