#include "core/quality/mover_metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

namespace omnihdr::mover_metrics_test {
namespace {

constexpr int kWidth = 20;
constexpr int kHeight = 10;

Image<float> Grey(float value) { return {kWidth, kHeight, 3, value}; }

double ShareOff(const Image<float>& tested, const std::vector<Instance>& instances) {
  return CompareInstances(tested.view(), 1.0, instances, 0.3, {}, false).share_off;
}

TEST(CompareInstances, ABlendOfTwoInstancesIsNeither) {
  const Image<float> mover = Grey(1.0F);
  const Image<float> background = Grey(100.0F);
  EXPECT_EQ(ShareOff(Grey(10.0F), {{mover.view(), {}}, {background.view(), {}}}), 1.0);
  EXPECT_EQ(ShareOff(Grey(1.9F), {{mover.view(), {}}, {background.view(), {}}}), 0.0);
  EXPECT_EQ(ShareOff(Grey(51.0F), {{mover.view(), {}}, {background.view(), {}}}), 0.0);
}

TEST(CompareInstances, AnInstanceIsAcceptedOnlyWhereItIsAllowed) {
  const Image<float> mover = Grey(1.0F);
  const Image<float> background = Grey(100.0F);
  Image<std::uint8_t> left(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth / 4; ++x) left.at(x, y) = 1;
  }
  EXPECT_DOUBLE_EQ(ShareOff(background, {{mover.view(), {}}, {background.view(), left.view()}}),
                   0.75);
}

TEST(CompareInstances, EveryPixelCountsByItsRowsWeightAndOnlyInTheArea) {
  Image<float> tested = Grey(1.0F);
  const Image<float> truth = Grey(1.0F);
  for (int x = 0; x < kWidth; ++x) tested.at(x, 3, 1) = 100.0F;
  ComparisonArea area;
  area.row_weights.assign(kHeight, 1.0);
  area.row_weights[3] = 3.0;
  const std::vector<Instance> instances = {{truth.view(), {}}};
  EXPECT_DOUBLE_EQ(CompareInstances(tested.view(), 1.0, instances, 0.3, area, false).share_off,
                   0.25);
  Image<std::uint8_t> mask(kWidth, kHeight, 1, 1);
  for (int x = 0; x < kWidth; ++x) mask.at(x, 3) = 0;
  area.mask = mask.view();
  const InstanceErrors errors = CompareInstances(tested.view(), 1.0, instances, 0.3, area, false);
  EXPECT_EQ(errors.share_off, 0.0);
  EXPECT_EQ(errors.pixels, static_cast<std::size_t>(kWidth * (kHeight - 1)));
}

TEST(CompareInstances, TheTestedMapIsScaledFirst) {
  const Image<float> truth = Grey(4.0F);
  const std::vector<Instance> instances = {{truth.view(), {}}};
  EXPECT_EQ(CompareInstances(Grey(1.0F).view(), 4.0, instances, 0.3, {}, false).share_off, 0.0);
  EXPECT_EQ(CompareInstances(Grey(1.0F).view(), 1.0, instances, 0.3, {}, false).share_off, 1.0);
}

TEST(CompareInstances, AHoleIsOffAndWhatIsNotKnownDoesNotCount) {
  Image<float> truth = Grey(1.0F);
  for (int x = 0; x < kWidth; ++x) {
    for (int c = 0; c < 3; ++c) truth.at(x, 0, c) = std::numeric_limits<float>::quiet_NaN();
  }
  const std::vector<Instance> instances = {{truth.view(), {}}};
  const InstanceErrors errors = CompareInstances(Grey(0.0F).view(), 1.0, instances, 0.3, {}, false);
  EXPECT_EQ(errors.share_off, 1.0);
  EXPECT_EQ(errors.pixels, static_cast<std::size_t>(kWidth * (kHeight - 1)));
  EXPECT_TRUE(std::isnan(
      CompareInstances(Grey(0.0F).view(), 1.0, std::vector<Instance>{}, 0.3, {}, false).share_off));
}

TEST(CompareInstances, AnEdgeMayLieAPixelAsideAndNoMore) {
  Image<float> truth = Grey(1.0F);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 10; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) truth.at(x, y, c) = 100.0F;
    }
  }
  const std::vector<Instance> instances = {{truth.view(), {}}};
  for (const int shift : {1, 2}) {
    Image<float> tested = Grey(1.0F);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 10 + shift; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) tested.at(x, y, c) = 100.0F;
      }
    }
    EXPECT_DOUBLE_EQ(CompareInstances(tested.view(), 1.0, instances, 0.3, {}, false).share_off,
                     shift == 1 ? 0.0 : 1.0 / kWidth);
  }
}

}  // namespace
}  // namespace omnihdr::mover_metrics_test
