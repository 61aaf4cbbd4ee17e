#include "core/quality/disparity_metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace omnihdr::disparity_metrics_test {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

TEST(CompareDisparity, AnErrorOfLessThanAPixelOfParallaxIsGood) {
  const Image<float> truth(10, 1, 1, 0.5F);
  const double baseline = 0.3;
  Image<float> tested(10, 1, 1, 0.5F);
  tested.at(0, 0) += static_cast<float>(0.9 * kOnePixelOfParallax / baseline);
  tested.at(1, 0) -= static_cast<float>(1.1 * kOnePixelOfParallax / baseline);
  const DisparityErrors errors = CompareDisparity(tested, truth, baseline, {});
  EXPECT_NEAR(errors.bad1, 0.1, 1e-12);
  EXPECT_EQ(errors.unknown, 0.0);
}

TEST(CompareDisparity, ALongerBaselineMakesTheSameErrorWorse) {
  const Image<float> truth(4, 4, 1, 0.5F);
  const Image<float> tested(4, 4, 1, 0.51F);
  EXPECT_EQ(CompareDisparity(tested, truth, 0.3, {}).bad1, 0.0);
  EXPECT_EQ(CompareDisparity(tested, truth, 1.0, {}).bad1, 1.0);
}

TEST(CompareDisparity, UnknownIsBadOnTheWholeSphereButNotAmongTheKnown) {
  const Image<float> truth(10, 1, 1, 0.5F);
  Image<float> tested(10, 1, 1, 0.5F);
  tested.at(0, 0) = kNaN;
  tested.at(1, 0) = kNaN;
  tested.at(2, 0) = 5.0F;
  const DisparityErrors errors = CompareDisparity(tested, truth, 0.3, {});
  EXPECT_NEAR(errors.bad1, 0.3, 1e-12);
  EXPECT_NEAR(errors.bad1_of_known, 1.0 / 8.0, 1e-12);
  EXPECT_NEAR(errors.unknown, 0.2, 1e-12);
}

TEST(CompareDisparity, PixelsWithoutTruthDoNotCount) {
  Image<float> truth(4, 1, 1, 0.5F);
  truth.at(0, 0) = kNaN;
  Image<float> tested(4, 1, 1, 0.5F);
  tested.at(0, 0) = 9.0F;
  EXPECT_EQ(CompareDisparity(tested, truth, 0.3, {}).bad1, 0.0);
}

TEST(CompareDisparity, TheRelativeErrorIsTheMedianWhereTruthIsNotInfinitelyFar) {
  Image<float> truth(5, 1, 1, 1.0F);
  truth.at(4, 0) = 0.0F;
  Image<float> tested(5, 1, 1, 1.1F);
  tested.at(3, 0) = 1.5F;
  EXPECT_NEAR(CompareDisparity(tested, truth, 0.001, {}).median_relative, 0.1, 1e-6);
}

TEST(CompareDisparity, WithoutTruthEverythingReadsNaN) {
  const Image<float> truth(4, 4, 1, kNaN);
  const Image<float> tested(4, 4, 1, 1.0F);
  EXPECT_TRUE(std::isnan(CompareDisparity(tested, truth, 0.3, {}).bad1));
}

}  // namespace
}  // namespace omnihdr::disparity_metrics_test
