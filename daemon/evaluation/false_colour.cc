#include "daemon/evaluation/false_colour.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "core/photometry/tonemap.h"

namespace omnihdr {
namespace {

using Rgb = std::array<std::uint8_t, 3>;

constexpr Rgb kPaper = {24, 24, 24};
constexpr Rgb kInk = {225, 225, 225};
constexpr Rgb kMagenta = {255, 0, 255};

std::vector<Rgb> MakeTurbo() {
  cv::Mat levels(1, 256, CV_8UC1);
  for (int i = 0; i < 256; ++i) levels.at<std::uint8_t>(0, i) = static_cast<std::uint8_t>(i);
  cv::Mat bgr;
  cv::applyColorMap(levels, bgr, cv::COLORMAP_TURBO);
  std::vector<Rgb> colours;
  for (int i = 0; i < 256; ++i) {
    const auto& c = bgr.at<cv::Vec3b>(0, i);
    colours.push_back({c[2], c[1], c[0]});
  }
  return colours;
}

Rgb TurboColour(double level) {
  static const std::vector<Rgb> turbo = MakeTurbo();
  return turbo[static_cast<std::size_t>(std::lround(255.0 * std::clamp(level, 0.0, 1.0)))];
}

// A hatch of two greys: recognised as no value at any zoom.
Rgb UnknownColour(int x, int y) {
  const std::uint8_t grey = (x + y) % 8 < 4 ? 88 : 136;
  return {grey, grey, grey};
}

Rgb SignedColour(double share) {
  const double s = std::clamp(share, -1.0, 1.0);
  const auto rest = static_cast<std::uint8_t>(std::lround(255.0 * (1.0 - std::abs(s))));
  return {s > 0.0 ? std::uint8_t{255} : rest, rest, s > 0.0 ? rest : std::uint8_t{255}};
}

void Put(const Rgb& colour, std::uint8_t* pixel) { std::copy_n(colour.data(), 3, pixel); }

cv::Mat Mat(Image<std::uint8_t>& image) {
  return {image.height(), image.width(), CV_8UC3, image.data()};
}

template <typename Level>
Image<float> MapValues(ImageView<const float> values, Level level) {
  Image<float> levels(values.width(), values.height(), 1);
  for (int y = 0; y < values.height(); ++y) {
    for (int x = 0; x < values.width(); ++x) levels.at(x, y) = level(values.at(x, y));
  }
  return levels;
}

// The values below which the shares lie; empty when none of `values` is wanted.
std::vector<double> Quantiles(ImageView<const float> values,
                              const std::function<bool(float)>& is_wanted,
                              const std::vector<double>& shares) {
  std::vector<float> wanted;
  for (int y = 0; y < values.height(); ++y) {
    for (int x = 0; x < values.width(); ++x) {
      if (is_wanted(values.at(x, y))) wanted.push_back(values.at(x, y));
    }
  }
  std::vector<double> quantiles;
  if (wanted.empty()) return quantiles;
  for (const double share : shares) {
    const auto nth = wanted.begin() +
                     static_cast<std::ptrdiff_t>(share * static_cast<double>(wanted.size() - 1));
    std::nth_element(wanted.begin(), nth, wanted.end());
    quantiles.push_back(static_cast<double>(*nth));
  }
  return quantiles;
}

// Text and bar grow with the picture.
struct StripLayout {
  explicit StripLayout(int width)
      : scale(std::clamp(width / 1400.0, 0.4, 3.0)),
        margin(static_cast<int>(16 * scale) + 4),
        text(static_cast<int>(24 * scale)),
        bar(static_cast<int>(18 * scale)) {}
  double scale;
  int margin;
  int text;
  int bar;
};

void Text(cv::Mat& canvas, const std::string& text, int x, int y, const StripLayout& layout) {
  cv::putText(canvas, text, {x, y}, cv::FONT_HERSHEY_SIMPLEX, 0.62 * layout.scale,
              cv::Scalar(kInk[0], kInk[1], kInk[2]), std::max(1, static_cast<int>(layout.scale)),
              cv::LINE_AA);
}

int TextWidth(const std::string& text, const StripLayout& layout) {
  int baseline = 0;
  return cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, 0.62 * layout.scale,
                         std::max(1, static_cast<int>(layout.scale)), &baseline)
      .width;
}

// The picture with `strip` empty rows below it.
Image<std::uint8_t> WithStrip(ImageView<const std::uint8_t> picture, int strip) {
  Image<std::uint8_t> out(picture.width(), picture.height() + strip, 3, kPaper[0]);
  for (int y = 0; y < picture.height(); ++y) {
    std::copy_n(picture.row(y), 3 * static_cast<std::ptrdiff_t>(picture.width()), out.row(y));
  }
  return out;
}

// Ticks stand at least about this far apart, in levels.
constexpr double kTickDistance = 0.09;

}  // namespace

Image<std::uint8_t> LevelColours(ImageView<const float> levels) {
  Image<std::uint8_t> colours(levels.width(), levels.height(), 3);
  for (int y = 0; y < levels.height(); ++y) {
    for (int x = 0; x < levels.width(); ++x) {
      const float level = levels.at(x, y);
      Put(std::isnan(level) ? UnknownColour(x, y) : TurboColour(static_cast<double>(level)),
          colours.pixel(x, y));
    }
  }
  return colours;
}

Image<float> DisparityLevels(ImageView<const float> disparity, double nearest) {
  return MapValues(disparity, [nearest](float d) {
    if (!std::isfinite(d)) return std::numeric_limits<float>::quiet_NaN();
    const double share = nearest > 0.0 ? static_cast<double>(d) / nearest : 0.0;
    return static_cast<float>(std::sqrt(std::clamp(share, 0.0, 1.0)));
  });
}

Image<std::uint8_t> DisparityColours(ImageView<const float> disparity, double nearest) {
  return LevelColours(DisparityLevels(disparity, nearest));
}

double NearDisparity(ImageView<const float> disparity) {
  const std::vector<double> near =
      Quantiles(disparity, [](float d) { return std::isfinite(d); }, {0.98});
  return near.empty() ? 0.0 : near.front();
}

Image<float> RadianceLevels(ImageView<const float> luminance, double low, double high) {
  assert(low > 0.0 && high > low);
  return MapValues(luminance, [low, decades = std::log10(high / low)](float l) {
    if (std::isnan(l)) return l;
    if (!(l > 0.0F)) return 0.0F;
    const double level = std::log10(static_cast<double>(l) / low) / decades;
    return static_cast<float>(std::clamp(level, 0.0, 1.0));
  });
}

LuminanceRange RangeOf(ImageView<const float> luminance) {
  const std::vector<double> ends =
      Quantiles(luminance, [](float l) { return l > 0.0F && std::isfinite(l); }, {0.005, 0.999});
  if (ends.empty()) return {};
  const double widen = std::max(std::sqrt(10.0 * ends[0] / ends[1]), 1.0);
  return {ends[0] / widen, ends[1] * widen};
}

Image<std::uint8_t> DifferenceColours(ImageView<const float> difference, double full) {
  Image<std::uint8_t> colours(difference.width(), difference.height(), 3, 96);
  for (int y = 0; y < difference.height(); ++y) {
    for (int x = 0; x < difference.width(); ++x) {
      const double d = static_cast<double>(difference.at(x, y));
      if (std::isfinite(d)) Put(SignedColour(d / full), colours.pixel(x, y));
    }
  }
  return colours;
}

Image<float> LogError(ImageView<const float> tested, ImageView<const float> truth) {
  Image<float> error(tested.width(), tested.height(), 1);
  for (int y = 0; y < tested.height(); ++y) {
    for (int x = 0; x < tested.width(); ++x) {
      error.at(x, y) = std::log10(Luminance(tested.pixel(x, y)) / Luminance(truth.pixel(x, y)));
    }
  }
  return error;
}

Image<std::uint8_t> ErrorColours(ImageView<const float> tested, ImageView<const float> truth,
                                 double full) {
  return DifferenceColours(LogError(tested, truth), full);
}

Image<std::uint8_t> KindColours(ImageView<const float> kinds, const std::vector<Kind>& legend) {
  Image<std::uint8_t> colours(kinds.width(), kinds.height(), 3);
  for (int y = 0; y < kinds.height(); ++y) {
    for (int x = 0; x < kinds.width(); ++x) {
      const auto kind = std::find_if(legend.begin(), legend.end(), [&](const Kind& k) {
        return std::abs(k.value - kinds.at(x, y)) < 0.25F;
      });
      Put(kind == legend.end() ? kMagenta : Rgb{kind->red, kind->green, kind->blue},
          colours.pixel(x, y));
    }
  }
  return colours;
}

Image<std::uint8_t> WithScaleBar(ImageView<const std::uint8_t> picture, const ScaleBar& bar) {
  const StripLayout layout(picture.width());
  const int width = picture.width();
  const int top = picture.height() + layout.text + layout.margin / 2;
  Image<std::uint8_t> out = WithStrip(picture, 2 * layout.text + layout.bar + 2 * layout.margin);
  cv::Mat canvas = Mat(out);
  const int left = layout.margin;
  const int length = std::max(width - 2 * layout.margin, 1);
  for (int x = 0; x < length && left + x < width; ++x) {
    const double level = length > 1 ? static_cast<double>(x) / (length - 1) : 0.0;
    const Rgb colour = bar.is_signed ? SignedColour(2.0 * level - 1.0) : TurboColour(level);
    for (int y = 0; y < layout.bar; ++y) Put(colour, out.pixel(left + x, top + y));
  }
  Text(canvas, bar.title, left, top - layout.margin / 2, layout);
  std::vector<std::pair<int, int>> taken;  // columns of the labels drawn
  for (const ScaleBar::Tick& tick : bar.ticks) {
    const int x = left + static_cast<int>(std::lround(tick.level * (length - 1)));
    cv::line(canvas, {x, top + layout.bar}, {x, top + layout.bar + layout.margin / 3},
             cv::Scalar(kInk[0], kInk[1], kInk[2]), std::max(1, static_cast<int>(layout.scale)));
    const int text_width = TextWidth(tick.label, layout);
    const int begin = std::clamp(x - text_width / 2, 2, std::max(width - text_width - 2, 2));
    const int end = begin + text_width + layout.margin / 2;
    const bool is_free = std::all_of(taken.begin(), taken.end(), [begin, end](const auto& other) {
      return end <= other.first || begin >= other.second;
    });
    if (!is_free) continue;
    taken.emplace_back(begin, end);
    Text(canvas, tick.label, begin, top + layout.bar + layout.margin / 3 + layout.text, layout);
  }
  if (bar.has_unknown) {
    const std::string label = bar.is_signed ? "grey: unknown" : "hatched: unknown";
    Text(canvas, label, std::max(width - layout.margin - TextWidth(label, layout), 2),
         top - layout.margin / 2, layout);
  }
  return out;
}

Image<std::uint8_t> WithLegend(ImageView<const std::uint8_t> picture, const std::string& title,
                               const std::vector<Kind>& legend) {
  const StripLayout layout(picture.width());
  Image<std::uint8_t> out = WithStrip(picture, layout.text + 2 * layout.margin);
  cv::Mat canvas = Mat(out);
  const int baseline = picture.height() + layout.text + layout.margin / 2;
  int x = layout.margin;
  Text(canvas, title, x, baseline, layout);
  x += TextWidth(title, layout) + 2 * layout.margin;
  for (const Kind& kind : legend) {
    cv::rectangle(canvas, {x, baseline - layout.bar}, {x + layout.bar, baseline},
                  cv::Scalar(kind.red, kind.green, kind.blue), cv::FILLED);
    cv::rectangle(canvas, {x, baseline - layout.bar}, {x + layout.bar, baseline},
                  cv::Scalar(kInk[0], kInk[1], kInk[2]), 1);
    x += layout.bar + layout.margin / 2;
    Text(canvas, kind.name, x, baseline, layout);
    x += TextWidth(kind.name, layout) + 2 * layout.margin;
  }
  return out;
}

namespace {

// {1, 2, 5}·10^k from `low` to `high`, ascending.
std::vector<double> RoundNumbers(double low, double high) {
  std::vector<double> numbers;
  const int last = static_cast<int>(std::ceil(std::log10(high)));
  for (int k = static_cast<int>(std::floor(std::log10(low))); k <= last; ++k) {
    for (const double step : {1.0, 2.0, 5.0}) {
      const double number = step * std::pow(10.0, k);
      if (number >= low * (1.0 - 1e-9) && number <= high * (1.0 + 1e-9)) numbers.push_back(number);
    }
  }
  return numbers;
}

}  // namespace

std::vector<ScaleBar::Tick> DisparityTicks(double nearest, const std::string& unit) {
  std::vector<ScaleBar::Tick> ticks = {{0.0, "0 = inf"}};
  if (!(nearest > 0.0) || !std::isfinite(nearest)) return ticks;
  std::vector<double> numbers = RoundNumbers(nearest * 1e-3, nearest);
  for (auto number = numbers.rbegin(); number != numbers.rend(); ++number) {  // near ones first
    const double level = std::sqrt(*number / nearest);
    const bool is_free = std::all_of(ticks.begin(), ticks.end(), [level](const auto& tick) {
      return std::abs(tick.level - level) >= 1.3 * kTickDistance;
    });
    if (is_free) {
      ticks.push_back(
          {level, fmt::format("{:.3g}/{} = {:.3g} {}", *number, unit, 1.0 / *number, unit)});
    }
  }
  return ticks;
}

std::vector<ScaleBar::Tick> RadianceTicks(double low, double high) {
  const double decades = std::log10(high / low);
  std::vector<ScaleBar::Tick> ticks;
  // Powers of ten have the first choice, so that a bar of many decades has nothing else.
  for (const bool power_of_ten : {true, false}) {
    for (const double number : RoundNumbers(low, high)) {
      const double power = std::log10(number);
      if ((std::abs(power - std::round(power)) < 1e-6) != power_of_ten) continue;
      const double level = std::log10(number / low) / decades;
      const bool is_free = std::all_of(ticks.begin(), ticks.end(), [level](const auto& tick) {
        return std::abs(tick.level - level) >= 0.8 * kTickDistance;
      });
      if (is_free) ticks.push_back({level, fmt::format("{:.4g}", number)});
    }
  }
  return ticks;
}

}  // namespace omnihdr
