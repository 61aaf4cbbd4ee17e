#include "daemon/evaluation/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "core/base/file.h"
#include "core/image/image_io.h"

namespace omnihdr {
namespace {

using Colour = std::array<std::uint8_t, 3>;
constexpr Colour kInk = {40, 40, 40};
constexpr Colour kGrid = {222, 222, 222};
constexpr double kBandOpacity = 0.22;

struct Point {
  double x = 0.0;
  double y = 0.0;
};

enum class Align { kLeft, kMiddle, kRight };

// What both ways of drawing can do.
class Canvas {
 public:
  virtual ~Canvas() = default;
  virtual void Line(const std::vector<Point>& points, Colour colour, double width) = 0;
  virtual void Area(const std::vector<Point>& points, Colour colour, double opacity) = 0;
  virtual void Dot(Point centre, Colour colour) = 0;
  virtual void Text(Point at, const std::string& text, double size, Align align, bool upright) = 0;
};

class SvgCanvas final : public Canvas {
 public:
  void Line(const std::vector<Point>& points, Colour colour, double width) override {
    body += fmt::format(
        "<polyline fill=\"none\" stroke=\"{}\" stroke-width=\"{:.2f}\" points=\"{}\"/>\n",
        Name(colour), width, Places(points));
  }
  void Area(const std::vector<Point>& points, Colour colour, double opacity) override {
    body += fmt::format("<polygon fill=\"{}\" fill-opacity=\"{:.2f}\" points=\"{}\"/>\n",
                        Name(colour), opacity, Places(points));
  }
  void Dot(Point centre, Colour colour) override {
    body += fmt::format("<circle cx=\"{:.2f}\" cy=\"{:.2f}\" r=\"3\" fill=\"{}\"/>\n", centre.x,
                        centre.y, Name(colour));
  }
  void Text(Point at, const std::string& text, double size, Align align, bool upright) override {
    constexpr std::array<const char*, 3> kAnchor = {"start", "middle", "end"};
    body += fmt::format(
        "<text x=\"{:.2f}\" y=\"{:.2f}\" font-family=\"sans-serif\" font-size=\"{:.0f}\" "
        "fill=\"{}\" text-anchor=\"{}\"{}>{}</text>\n",
        at.x, at.y, size, Name(kInk), kAnchor[static_cast<std::size_t>(align)],
        upright ? fmt::format(" transform=\"rotate(-90 {:.2f} {:.2f})\"", at.x, at.y) : "",
        Escaped(text));
  }
  std::string body;

 private:
  static std::string Name(Colour c) { return fmt::format("#{:02x}{:02x}{:02x}", c[0], c[1], c[2]); }
  static std::string Places(const std::vector<Point>& points) {
    std::string text;
    for (const Point& p : points) text += fmt::format("{:.2f},{:.2f} ", p.x, p.y);
    return text;
  }
  static std::string Escaped(const std::string& text) {
    std::string out;
    for (const char c : text) {
      if (c == '&') {
        out += "&amp;";
      } else if (c == '<') {
        out += "&lt;";
      } else if (c == '>') {
        out += "&gt;";
      } else if (static_cast<unsigned char>(c) >= 0x20) {
        out += c;
      }
    }
    return out;
  }
};

class PictureCanvas final : public Canvas {
 public:
  PictureCanvas(int width, int height) : picture(height, width, CV_8UC3, {255, 255, 255}) {}
  void Line(const std::vector<Point>& points, Colour colour, double width) override {
    const std::vector<cv::Point> places = Places(points);
    cv::polylines(picture, places, false, Scalar(colour), std::max(1, cvRound(width)), cv::LINE_AA,
                  kShift);
  }
  void Area(const std::vector<Point>& points, Colour colour, double opacity) override {
    cv::Mat layer = picture.clone();
    const std::vector<std::vector<cv::Point>> areas = {Places(points)};
    cv::fillPoly(layer, areas, Scalar(colour), cv::LINE_AA, kShift);
    cv::addWeighted(layer, opacity, picture, 1.0 - opacity, 0.0, picture);
  }
  void Dot(Point centre, Colour colour) override {
    cv::circle(picture, Place(centre), 3 << kShift, Scalar(colour), cv::FILLED, cv::LINE_AA,
               kShift);
  }
  void Text(Point at, const std::string& text, double size, Align align, bool upright) override {
    const double scale = size / 26.0;
    int below = 0;
    const cv::Size extent = cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, scale, 1, &below);
    const int shift = align == Align::kLeft     ? 0
                      : align == Align::kMiddle ? extent.width / 2
                                                : extent.width;
    if (!upright) {
      cv::putText(picture, text, {cvRound(at.x) - shift, cvRound(at.y)}, cv::FONT_HERSHEY_SIMPLEX,
                  scale, Scalar(kInk), 1, cv::LINE_AA);
      return;
    }
    cv::Mat label(extent.height + below + 2, extent.width + 2, CV_8UC3, {255, 255, 255});
    cv::putText(label, text, {1, extent.height}, cv::FONT_HERSHEY_SIMPLEX, scale, Scalar(kInk), 1,
                cv::LINE_AA);
    cv::rotate(label, label, cv::ROTATE_90_COUNTERCLOCKWISE);
    const cv::Rect place(cvRound(at.x) - extent.height, cvRound(at.y) + shift - extent.width,
                         label.cols, label.rows);
    const cv::Rect inside = place & cv::Rect(0, 0, picture.cols, picture.rows);
    if (inside.empty()) return;
    label(inside - place.tl()).copyTo(picture(inside));
  }
  cv::Mat picture;

 private:
  static constexpr int kShift = 4;  // fractional bits of a place
  static cv::Scalar Scalar(Colour c) {
    return {static_cast<double>(c[0]), static_cast<double>(c[1]), static_cast<double>(c[2])};
  }
  static cv::Point Place(Point p) {
    constexpr double kUnit = 1 << kShift;
    return {cvRound(p.x * kUnit), cvRound(p.y * kUnit)};
  }
  static std::vector<cv::Point> Places(const std::vector<Point>& points) {
    std::vector<cv::Point> places;
    for (const Point& p : points) places.push_back(Place(p));
    return places;
  }
};

// One axis: values to places, with ticks at round numbers.
class Axis {
 public:
  Axis(bool logarithmic, double low, double high) : logarithmic_(logarithmic) {
    if (!(low < high)) {
      const double middle = std::isfinite(low) ? low : (logarithmic ? 1.0 : 0.0);
      low = logarithmic ? middle / 10.0 : middle - 1.0;
      high = logarithmic ? middle * 10.0 : middle + 1.0;
    }
    low_ = Map(low);
    high_ = Map(high);
    const double margin = 0.03 * (high_ - low_);
    low_ -= margin;
    high_ += margin;
  }
  bool Shows(double value) const { return std::isfinite(value) && (!logarithmic_ || value > 0.0); }
  // 0 at the low end, 1 at the high one.
  double Share(double value) const {
    return std::clamp((Map(value) - low_) / (high_ - low_), 0.0, 1.0);
  }
  std::vector<std::pair<double, std::string>> Ticks() const {
    std::vector<std::pair<double, std::string>> ticks;
    if (logarithmic_) {
      const bool few = high_ - low_ < 2.5;
      for (int decade = static_cast<int>(std::floor(low_)); decade <= high_; ++decade) {
        for (const int digit : {1, 2, 5}) {
          if (digit > 1 && !few) continue;
          const double value = digit * std::pow(10.0, decade);
          if (Map(value) < low_ || Map(value) > high_) continue;
          ticks.emplace_back(value, fmt::format("{:g}", value));
        }
      }
      return ticks;
    }
    const double raw = (high_ - low_) / 6.0;
    const double decade = std::pow(10.0, std::floor(std::log10(raw)));
    const double step = decade * (raw / decade < 1.5 ? 1.0 : raw / decade < 3.5 ? 2.0 : 5.0);
    for (double k = std::ceil(low_ / step); k * step <= high_; k += 1.0) {
      ticks.emplace_back(k * step, fmt::format("{:g}", k == 0.0 ? 0.0 : k * step));
    }
    return ticks;
  }

 private:
  double Map(double value) const { return logarithmic_ ? std::log10(value) : value; }
  bool logarithmic_;
  double low_ = 0.0;
  double high_ = 1.0;
};

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  void Take(double value, bool logarithmic) {
    if (!std::isfinite(value) || (logarithmic && value <= 0.0)) return;
    low = std::min(low, value);
    high = std::max(high, value);
  }
};

void Draw(const Plot& plot, double left, int width, int height, Canvas* canvas) {
  Range x_range;
  Range y_range;
  for (const PlotSeries& s : plot.series) {
    for (const double v : s.x) x_range.Take(v, plot.log_x);
    for (const double v : s.y) y_range.Take(v, plot.log_y);
  }
  if (plot.headroom > 0.0 && y_range.low < y_range.high) {
    const double above = plot.headroom / (1.0 - plot.headroom);
    y_range.high = plot.log_y ? y_range.high * std::pow(y_range.high / y_range.low, above)
                              : y_range.high + above * (y_range.high - y_range.low);
  }
  const Axis x_axis(plot.log_x, x_range.low, x_range.high);
  const Axis y_axis(plot.log_y, y_range.low, y_range.high);
  const double x0 = left + 78.0;
  const double x1 = left + width - 18.0;
  const double y0 = height - 56.0;
  const double y1 = 42.0;
  const auto place = [&](double x, double y) {
    return Point{x0 + x_axis.Share(x) * (x1 - x0), y0 + y_axis.Share(y) * (y1 - y0)};
  };
  for (const auto& [value, label] : x_axis.Ticks()) {
    const double x = x0 + x_axis.Share(value) * (x1 - x0);
    canvas->Line({{x, y0}, {x, y1}}, kGrid, 1.0);
    canvas->Text({x, y0 + 20.0}, label, 13.0, Align::kMiddle, false);
  }
  for (const auto& [value, label] : y_axis.Ticks()) {
    const double y = y0 + y_axis.Share(value) * (y1 - y0);
    canvas->Line({{x0, y}, {x1, y}}, kGrid, 1.0);
    canvas->Text({x0 - 8.0, y + 5.0}, label, 13.0, Align::kRight, false);
  }
  canvas->Line({{x0, y1}, {x0, y0}, {x1, y0}, {x1, y1}, {x0, y1}}, kInk, 1.0);
  canvas->Text({0.5 * (x0 + x1), 26.0}, plot.title, 16.0, Align::kMiddle, false);
  canvas->Text({0.5 * (x0 + x1), height - 12.0}, plot.x_label, 14.0, Align::kMiddle, false);
  canvas->Text({left + 22.0, 0.5 * (y0 + y1)}, plot.y_label, 14.0, Align::kMiddle, true);

  for (const PlotSeries& s : plot.series) {
    std::vector<Point> upper;
    std::vector<Point> lower;
    for (std::size_t k = 0; k < std::min(s.low.size(), s.high.size()); ++k) {
      if (!x_axis.Shows(s.x[k]) || !y_axis.Shows(s.low[k]) || !y_axis.Shows(s.high[k])) continue;
      upper.push_back(place(s.x[k], s.high[k]));
      lower.push_back(place(s.x[k], s.low[k]));
    }
    upper.insert(upper.end(), lower.rbegin(), lower.rend());
    if (upper.size() > 3) canvas->Area(upper, s.colour, kBandOpacity);
  }
  double legend_y = y1 + 20.0;
  for (const PlotSeries& s : plot.series) {
    std::vector<Point> line;
    for (std::size_t k = 0; k <= s.x.size(); ++k) {
      const bool shown = k < s.x.size() && x_axis.Shows(s.x[k]) && y_axis.Shows(s.y[k]);
      if (shown && s.dots) {
        canvas->Dot(place(s.x[k], s.y[k]), s.colour);
      } else if (shown) {
        line.push_back(place(s.x[k], s.y[k]));
      } else {
        if (line.size() > 1) canvas->Line(line, s.colour, 2.0);
        line.clear();
      }
    }
    if (s.name.empty()) continue;
    if (s.dots) {
      canvas->Dot({x0 + 24.0, legend_y - 5.0}, s.colour);
    } else {
      canvas->Line({{x0 + 12.0, legend_y - 5.0}, {x0 + 36.0, legend_y - 5.0}}, s.colour, 2.0);
    }
    canvas->Text({x0 + 44.0, legend_y}, s.name, 13.0, Align::kLeft, false);
    legend_y += 20.0;
  }
}

}  // namespace

std::string PlotsAsSvg(const std::vector<Plot>& plots, int width, int height) {
  SvgCanvas canvas;
  const int total = width * static_cast<int>(plots.size());
  for (std::size_t k = 0; k < plots.size(); ++k) {
    Draw(plots[k], static_cast<double>(k) * width, width, height, &canvas);
  }
  return fmt::format(
      "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" "
      "width=\"{0}\" height=\"{1}\" viewBox=\"0 0 {0} {1}\">\n<rect width=\"{0}\" height=\"{1}\" "
      "fill=\"#ffffff\"/>\n{2}</svg>\n",
      total, height, canvas.body);
}

Image<std::uint8_t> PlotsAsPicture(const std::vector<Plot>& plots, int width, int height) {
  const int total = width * static_cast<int>(plots.size());
  PictureCanvas canvas(total, height);
  for (std::size_t k = 0; k < plots.size(); ++k) {
    Draw(plots[k], static_cast<double>(k) * width, width, height, &canvas);
  }
  Image<std::uint8_t> picture(total, height, 3);
  for (int y = 0; y < height; ++y) {
    std::copy_n(canvas.picture.ptr<std::uint8_t>(y), 3 * static_cast<std::size_t>(total),
                picture.row(y));
  }
  return picture;
}

Status WritePlots(const std::string& file, const std::vector<Plot>& plots) {
  constexpr int kWidth = 620;
  constexpr int kHeight = 480;
  const std::string ending = std::filesystem::path(file).extension().string();
  if (ending == ".svg") return WriteFileAtomic(file, PlotsAsSvg(plots, kWidth, kHeight));
  if (ending == ".png") {
    OMNIHDR_ASSIGN(const std::vector<std::byte> png,
                   EncodePng(PlotsAsPicture(plots, kWidth, kHeight).view(), 6));
    return WriteFileAtomic(file, png);
  }
  return Fail(ErrorKind::kUsage, "{}: expected a file ending in .png or .svg", file);
}

}  // namespace omnihdr
