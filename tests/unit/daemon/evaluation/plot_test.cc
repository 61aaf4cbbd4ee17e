#include "daemon/evaluation/plot.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>

namespace omnihdr::plot_test {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

Plot Line() {
  Plot plot;
  plot.title = "a < b & c";
  plot.x_label = "x";
  plot.y_label = "y";
  PlotSeries series;
  series.name = "one";
  series.colour = {255, 0, 0};
  series.x = {0.0, 50.0, 100.0};
  series.y = {0.0, 5.0, 10.0};
  plot.series = {series};
  return plot;
}

int Count(const std::string& text, const std::string& part) {
  int count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) {
    ++count;
  }
  return count;
}

TEST(Plot, TextIsEscapedAndEveryTickIsLabelled) {
  const std::string svg = PlotsAsSvg({Line()}, 400, 300);
  EXPECT_THAT(svg, HasSubstr(">a &lt; b &amp; c</text>"));
  for (const char* label : {">0<", ">20<", ">100<", ">10<", ">one<"}) {
    EXPECT_THAT(svg, HasSubstr(label));
  }
}

TEST(Plot, ABreakInTheDataBreaksTheLine) {
  Plot plot = Line();
  plot.series[0].x = {0, 1, 2, 3, 4};
  plot.series[0].y = {0, 1, std::numeric_limits<double>::quiet_NaN(), 3, 4};
  // Two pieces and the legend's.
  EXPECT_EQ(Count(PlotsAsSvg({plot}, 400, 300), "stroke=\"#ff0000\""), 3);
}

TEST(Plot, ALogarithmicAxisLeavesOutWhatIsNotPositive) {
  Plot plot = Line();
  plot.log_y = true;
  plot.series[0].dots = true;
  plot.series[0].name.clear();
  const std::string svg = PlotsAsSvg({plot}, 400, 300);
  EXPECT_EQ(Count(svg, "<circle"), 2);
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  EXPECT_THAT(svg, Not(HasSubstr("inf")));
}

TEST(Plot, HeadroomKeepsCurvesBelowTheLegend) {
  Plot plot = Line();
  const Image<std::uint8_t> without = PlotsAsPicture({plot}, 400, 300);
  plot.headroom = 0.5;
  const Image<std::uint8_t> with = PlotsAsPicture({plot}, 400, 300);
  // The curve's upper end, far right of the legend.
  const auto highest = [](const Image<std::uint8_t>& picture) {
    for (int y = 0; y < picture.height(); ++y) {
      for (int x = 300; x < picture.width(); ++x) {
        const std::uint8_t* rgb = picture.pixel(x, y);
        if (rgb[0] > 200 && rgb[1] < 80) return y;
      }
    }
    return picture.height();
  };
  EXPECT_LT(highest(without), 70);
  EXPECT_GT(highest(with), 130);
}

TEST(Plot, NothingToShowIsEmptyAxesAndNotACrash) {
  for (const bool logarithmic : {false, true}) {
    Plot plot;
    plot.log_x = plot.log_y = logarithmic;
    EXPECT_THAT(PlotsAsSvg({plot}, 400, 300), Not(HasSubstr("nan")));
    EXPECT_EQ(PlotsAsPicture({plot, plot}, 400, 300).width(), 800);
  }
}

TEST(Plot, ThePictureShowsTheLineInItsColour) {
  const Image<std::uint8_t> picture = PlotsAsPicture({Line()}, 400, 300);
  int red = 0;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      const std::uint8_t* p = picture.pixel(x, y);
      red += p[0] > 240 && p[1] < 60 && p[2] < 60 ? 1 : 0;
    }
  }
  EXPECT_GT(red, 250);
  EXPECT_LT(red, 1500);
}

TEST(Plot, AnUnknownEndingIsAUsageError) {
  const Status refused = WritePlots("curve.gif", {Line()});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kUsage);
}

}  // namespace
}  // namespace omnihdr::plot_test
