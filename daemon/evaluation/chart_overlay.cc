#include "daemon/evaluation/chart_overlay.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <string>

namespace omnihdr {
namespace {

constexpr int kLargest = 1600;
constexpr int kSmallest = 900;

// RGB of a place for looking at: Bayer tiles are averaged.
std::array<float, 3> ColourAt(const SensorPicture& picture, int x, int y) {
  const float* pixel = picture.values.pixel(x, y);
  if (picture.values.channels() == 3) return {pixel[0], pixel[1], pixel[2]};
  if (picture.bayer == BayerOrder::kNone) return {pixel[0], pixel[0], pixel[0]};
  std::array<float, 3> rgb{};
  const int x0 = std::min(x & ~1, picture.width() - 2);
  const int y0 = std::min(y & ~1, picture.height() - 2);
  for (int dy = 0; dy < 2; ++dy) {
    for (int dx = 0; dx < 2; ++dx) {
      const int c = BayerChannel(picture.bayer, x0 + dx, y0 + dy);
      rgb[static_cast<std::size_t>(c)] +=
          (c == 1 ? 0.5F : 1.0F) * picture.values.at(x0 + dx, y0 + dy);
    }
  }
  return rgb;
}

}  // namespace

Image<std::uint8_t> DrawChartOverlay(const SensorPicture& picture, const ChartDetection& chart,
                                     const ChartMeasurement& measurement,
                                     const ChartMeasureOptions& options) {
  const int largest = std::max(picture.width(), picture.height());
  const double scale = largest > kLargest    ? static_cast<double>(kLargest) / largest
                       : largest < kSmallest ? static_cast<double>(kSmallest) / largest
                                             : 1.0;
  Image<std::uint8_t> out(std::max(1, static_cast<int>(scale * picture.width())),
                          std::max(1, static_cast<int>(scale * picture.height())), 3);
  double white = 1.0;
  for (const PatchChannel& channel : measurement[kChartFirstGrey]) {
    white = std::max(white, channel.median);
  }
  std::array<std::uint8_t, 256> shown{};
  for (std::size_t i = 0; i < shown.size(); ++i) {
    const double v = std::min(1.0, static_cast<double>(i) / std::max(white, 32.0));
    shown[i] =
        static_cast<std::uint8_t>(std::lround(255.0 * std::pow(v, white < 128.0 ? 0.5 : 0.8)));
  }
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      const std::array<float, 3> rgb =
          ColourAt(picture, std::min(static_cast<int>((x + 0.5) / scale), picture.width() - 1),
                   std::min(static_cast<int>((y + 0.5) / scale), picture.height() - 1));
      for (int c = 0; c < 3; ++c) {
        const float v = std::clamp(rgb[static_cast<std::size_t>(c)], 0.0F, 255.0F);
        out.at(x, y, c) = shown[static_cast<std::size_t>(v)];
      }
    }
  }
  cv::Mat canvas(out.height(), out.width(), CV_8UC3, out.data());
  const auto point = [scale](const Eigen::Vector2d& p) {
    return cv::Point(static_cast<int>(std::lround(p.x() * scale)),
                     static_cast<int>(std::lround(p.y() * scale)));
  };
  const auto outline = [&](const std::array<Eigen::Vector2d, 4>& square, const cv::Scalar& colour) {
    for (std::size_t i = 0; i < 4; ++i) {
      cv::line(canvas, point(square[i]), point(square[(i + 1) % 4]), {0, 0, 0}, 3, cv::LINE_AA);
    }
    for (std::size_t i = 0; i < 4; ++i) {
      cv::line(canvas, point(square[i]), point(square[(i + 1) % 4]), colour, 1, cv::LINE_AA);
    }
  };
  const double text = std::clamp(chart.geometry.PatchStep() * scale / 110.0, 0.3, 1.0);
  for (int patch = 0; patch < kChartPatches; ++patch) {
    const auto& channels = measurement[static_cast<std::size_t>(patch)];
    bool clips = false;
    bool usable = true;
    for (const PatchChannel& channel : channels) {
      clips |= channel.clipped > 0.01;
      usable &= channel.usable;
    }
    outline(chart.geometry.PatchSquare(patch, options.inner), clips    ? cv::Scalar(255, 60, 60)
                                                              : usable ? cv::Scalar(60, 255, 60)
                                                                       : cv::Scalar(90, 140, 255));
    const std::string number = std::to_string(patch + 1);
    const cv::Point at = point(chart.geometry.PatchCentre(patch)) +
                         cv::Point(static_cast<int>(-8 * text * static_cast<double>(number.size())),
                                   static_cast<int>(8 * text));
    cv::putText(canvas, number, at, cv::FONT_HERSHEY_SIMPLEX, text, {0, 0, 0}, 3, cv::LINE_AA);
    cv::putText(canvas, number, at, cv::FONT_HERSHEY_SIMPLEX, text, {255, 255, 255}, 1,
                cv::LINE_AA);
  }
  return out;
}

}  // namespace omnihdr
