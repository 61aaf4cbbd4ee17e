#include "core/quality/radiance_metrics.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <vector>

#include "core/quality/comparison_area.h"

namespace omnihdr::radiance_metrics_test {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// Grey radiance with a value of its own per pixel.
Image<float> Ramp(int width, int height, float factor = 1.0F) {
  Image<float> image(width, height, 3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) {
        image.at(x, y, c) = factor * (0.01F + static_cast<float>(x + width * y));
      }
    }
  }
  return image;
}

TEST(WeightedQuantile, IsTheSmallestValueThatReachesTheShare) {
  std::vector<WeightedValue> values = {{3.0F, 1.0F}, {1.0F, 1.0F}, {2.0F, 2.0F}};
  EXPECT_EQ(WeightedQuantile(values, 0.0), 1.0);
  EXPECT_EQ(WeightedQuantile(values, 0.25), 1.0);
  EXPECT_EQ(WeightedQuantile(values, 0.26), 2.0);
  EXPECT_EQ(WeightedQuantile(values, 0.75), 2.0);
  EXPECT_EQ(WeightedQuantile(values, 1.0), 3.0);
}

TEST(WeightedQuantile, AValueWithoutWeightIsNeverTheAnswer) {
  std::vector<WeightedValue> values = {{0.0F, 0.0F}, {5.0F, 1.0F}};
  EXPECT_EQ(WeightedQuantile(values, 0.0), 5.0);
}

TEST(WeightedQuantile, OfNothingIsNaN) {
  std::vector<WeightedValue> none;
  EXPECT_TRUE(std::isnan(WeightedQuantile(none, 0.5)));
}

TEST(SphereArea, WeightsOfALatLongPictureAddUpToTheWholeSphere) {
  const ComparisonArea area = SphereArea(Projection::Equirectangular(64, 32));
  double sum = 0.0;
  for (const double weight : area.row_weights) sum += 64.0 * weight;
  EXPECT_NEAR(sum, 4.0 * std::numbers::pi, 1e-6);
}

TEST(CompareRadiance, OneFactorOverTheWholePictureIsNoErrorAfterScaling) {
  const RadianceErrors errors = CompareRadiance(Ramp(8, 8, 4.0F), Ramp(8, 8), {});
  EXPECT_NEAR(errors.scale, 0.25, 1e-6);
  EXPECT_NEAR(errors.log10_rmse, 0.0, 1e-6);
  EXPECT_NEAR(errors.log10_p95, 0.0, 1e-6);
  EXPECT_NEAR(errors.log10_rmse_unscaled, std::log10(4.0), 1e-6);
  EXPECT_EQ(errors.compared, 1.0);
}

TEST(CompareRadiance, AQuarterOfThePixelsOffByAFactorOfTen) {
  const Image<float> truth = Ramp(8, 8);
  Image<float> tested = Ramp(8, 8);
  for (int y = 0; y < 2; ++y) {
    for (int x = 0; x < 8; ++x) {
      for (int c = 0; c < 3; ++c) tested.at(x, y, c) *= 10.0F;
    }
  }
  const RadianceErrors errors = CompareRadiance(tested, truth, {});
  EXPECT_NEAR(errors.scale, 1.0, 1e-6);
  EXPECT_NEAR(errors.log10_rmse, 0.5, 1e-6);
  EXPECT_NEAR(errors.log10_p95, 1.0, 1e-6);
}

TEST(CompareRadiance, UnknownPixelsAreCountedAsMissingNotAsErrors) {
  const Image<float> truth = Ramp(4, 4);
  Image<float> tested = Ramp(4, 4);
  for (int c = 0; c < 3; ++c) tested.at(1, 1, c) = kNaN;
  tested.at(2, 2, 0) = tested.at(2, 2, 1) = tested.at(2, 2, 2) = 0.0F;
  const RadianceErrors errors = CompareRadiance(tested, truth, {});
  EXPECT_NEAR(errors.compared, 14.0 / 16.0, 1e-12);
  EXPECT_NEAR(errors.log10_rmse, 0.0, 1e-6);
}

TEST(CompareRadiance, OnlyTheMaskedInPixelsCount) {
  const Image<float> truth = Ramp(4, 4);
  Image<float> tested = Ramp(4, 4);
  for (int c = 0; c < 3; ++c) tested.at(3, 3, c) *= 100.0F;
  Image<std::uint8_t> mask(4, 4, 1, 255);
  mask.at(3, 3) = 0;
  ComparisonArea area;
  area.mask = mask.view();
  EXPECT_NEAR(CompareRadiance(tested, truth, area).log10_rmse_unscaled, 0.0, 1e-6);
  EXPECT_GT(CompareRadiance(tested, truth, {}).log10_rmse_unscaled, 0.1);
}

TEST(CompareRadiance, RowsCountByTheirSolidAngle) {
  // The top row is wrong: on a lat-long picture it is far less than an eighth of the sphere.
  const Projection sphere = Projection::Equirectangular(16, 8);
  const Image<float> truth = Ramp(16, 8);
  Image<float> tested = Ramp(16, 8);
  for (int x = 0; x < 16; ++x) {
    for (int c = 0; c < 3; ++c) tested.at(x, 0, c) *= 10.0F;
  }
  const double share = 16.0 * sphere.PixelSolidAngle(0) / (4.0 * std::numbers::pi);
  EXPECT_LT(share, 0.05);
  EXPECT_NEAR(CompareRadiance(tested, truth, SphereArea(sphere)).log10_rmse, std::sqrt(share),
              1e-5);
}

TEST(CompareRadiance, NothingInCommonReadsNaN) {
  const Image<float> truth = Ramp(4, 4);
  const Image<float> unknown(4, 4, 3, kNaN);
  const RadianceErrors errors = CompareRadiance(unknown, truth, {});
  EXPECT_TRUE(std::isnan(errors.log10_rmse));
  EXPECT_TRUE(std::isnan(errors.scale));
  EXPECT_EQ(errors.compared, 0.0);
}

}  // namespace
}  // namespace omnihdr::radiance_metrics_test
