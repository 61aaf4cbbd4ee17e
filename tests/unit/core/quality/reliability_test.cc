#include "core/quality/reliability.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "core/quality/disparity_metrics.h"

namespace omnihdr::reliability_test {
namespace {

constexpr double kBaseline = 0.3;

TEST(ReliabilityCurve, OfNothingIsEmptyAndHasNoError) {
  const ReliabilityCurve curve;
  EXPECT_TRUE(curve.empty());
  EXPECT_TRUE(std::isnan(curve.CalibrationError()));
  EXPECT_TRUE(std::isnan(curve.Bins()[3].right));
}

// A hundred pixels called right with `confidence`, of which `right` are.
ReliabilityCurve Curve(float confidence, int right) {
  const Image<float> truth(100, 1, 1, 0.5F);
  const Image<float> called(100, 1, 1, confidence);
  Image<float> tested(100, 1, 1, 0.5F);
  for (int x = right; x < 100; ++x) {
    tested.at(x, 0) += static_cast<float>(1.1 * kOnePixelOfParallax / kBaseline);
  }
  for (int x = 0; x < right; ++x) {
    tested.at(x, 0) -= static_cast<float>(0.9 * kOnePixelOfParallax / kBaseline);
  }
  ReliabilityCurve curve;
  curve.Add(tested, called, truth, kBaseline, {});
  return curve;
}

TEST(ReliabilityCurve, TellsWhatShareOfABinIsRight) {
  const ReliabilityCurve curve = Curve(0.93F, 75);
  EXPECT_NEAR(curve.Bins()[9].right, 0.75, 1e-9);
  EXPECT_NEAR(curve.Bins()[9].confidence, 0.93, 1e-6);
  EXPECT_EQ(curve.Bins()[9].weight, 100.0);
  EXPECT_EQ(curve.Bins()[8].weight, 0.0);
  EXPECT_NEAR(curve.CalibrationError(), 0.18, 1e-6);
}

TEST(ReliabilityCurve, AConfidenceThatKeepsItsWordHasNoError) {
  ReliabilityCurve curve = Curve(0.75F, 75);
  curve.Add(Curve(0.2F, 20));
  EXPECT_NEAR(curve.CalibrationError(), 0.0, 1e-6);
}

TEST(ReliabilityCurve, CertaintyAndItsOppositeAreInTheOutermostBins) {
  ReliabilityCurve curve = Curve(1.0F, 100);
  curve.Add(Curve(0.0F, 0));
  EXPECT_EQ(curve.Bins()[9].weight, 100.0);
  EXPECT_EQ(curve.Bins()[0].weight, 100.0);
}

TEST(ReliabilityCurve, UnknownAndExcludedPixelsDoNotCount) {
  constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();
  const Image<float> truth(4, 1, 1, 0.5F);
  Image<float> tested(4, 1, 1, 0.5F);
  Image<float> called(4, 1, 1, 0.5F);
  Image<std::uint8_t> mask(4, 1, 1, 255);
  tested.at(0, 0) = kUnknown;
  called.at(1, 0) = kUnknown;
  mask.at(2, 0) = 0;
  ComparisonArea area;
  area.mask = mask.view();
  area.row_weights = {0.25};
  ReliabilityCurve curve;
  curve.Add(tested, called, truth, kBaseline, area);
  EXPECT_EQ(curve.Bins()[5].weight, 0.25);
}

}  // namespace
}  // namespace omnihdr::reliability_test
