#include "core/stereo/pairwise_costs.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>

#include "core/base/parallel_for.h"
#include "core/stereo/sgm.h"
#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::pairwise_costs_test {
namespace {

using testing::Drive;

constexpr std::size_t kCentre = 2;
constexpr int kLabels = 64;
constexpr double kMaxDisparity = 0.8;
constexpr auto kAllCosts = {StereoCost::kRadiometric, StereoCost::kCensus,
                            StereoCost::kMutualInformation};

const Drive& TheDrive() {
  static const Drive drive = Drive::Through(testing::FurnishedRoom(), testing::FivePlaces());
  return drive;
}

using ToneCurve = std::function<float(float)>;

// Views of the middle place and its two neighbours, these as if `curve` were the camera's unknown
// response.
struct Triple {
  std::vector<StereoView> views;
  std::vector<SweepNeighbour> neighbours;
  SweepOptions options;

  DisparityMap Map(StereoCost cost) const {
    return OptimiseSemiGlobal(MatchingCosts(cost, views[0], neighbours, options), views[0], {});
  }
};
std::unique_ptr<Triple> Expose(const ToneCurve& curve) {
  const Drive& drive = TheDrive();
  auto triple = std::make_unique<Triple>();
  const LogScale scale = LogScale::For(1e-3F, 20.0F);
  for (const std::size_t place : {kCentre, kCentre - 1, kCentre + 1}) {
    Image<float> radiance = drive.truths[place].radiance.Clone();
    if (place != kCentre) {
      for (float& e : radiance.values()) e = curve(e);
    }
    triple->views.push_back(MakeStereoView(testing::Perfect(radiance, drive.projection),
                                           Eigen::Quaterniond::Identity(), 2 * testing::kMapWidth,
                                           scale));
  }
  for (const std::size_t k : {1U, 2U}) {
    triple->neighbours.push_back(
        {&triple->views[k], drive.Offset(kCentre, k == 1 ? kCentre - 1 : kCentre + 1)});
  }
  triple->options.labels = kLabels;
  triple->options.max_disparity = kMaxDisparity;
  return triple;
}

double ShareRight(const DisparityMap& map) {
  static const DisparityMap truth = TheDrive().TrueDisparity(kCentre);
  const Projection grid = Projection::Equirectangular(testing::kMapWidth, testing::kMapWidth / 2);
  return testing::Share(
      map.disparity.width(), map.disparity.height(),
      [&](int x, int y) {
        const Eigen::Vector3d ray = grid.RayFromPixel(x + 0.5, y + 0.5);
        return std::hypot(ray.y(), ray.z()) > 0.5;  // along the drive nothing tells the distance
      },
      [&](int x, int y) {
        const float d = truth.disparity.at(x, y);
        return std::abs(map.disparity.at(x, y) - d) <= 0.05F * d + 0.01F;
      });
}

TEST(MatchingCosts, EachFindsTheRoomWhenNothingIsInTheWay) {
  const auto triple = Expose([](float e) { return e; });
  for (const StereoCost cost : kAllCosts) {
    const double right = ShareRight(triple->Map(cost));
    RecordProperty(std::string(ToString(cost)), fmt::format("{:.3f}", right));
    EXPECT_GT(right, 0.8) << ToString(cost);
  }
}

TEST(MatchingCosts, IntervalIsTheSweepOfAllPairs) {
  const auto triple = Expose([](float e) { return e; });
  EXPECT_EQ(
      MatchingCosts(StereoCost::kInterval, triple->views[0], triple->neighbours, triple->options)
          .cost,
      SweepCosts(triple->views[0], triple->neighbours, triple->options).cost);
}

TEST(MatchingCosts, AnUnknownExposureIsNothingToThoseThatDoNotNeedIt) {
  const auto plain = Expose([](float e) { return e; });
  const auto gained = Expose([](float e) { return 2.0F * e; });
  for (const StereoCost cost : kAllCosts) {
    EXPECT_GT(ShareRight(gained->Map(cost)), ShareRight(plain->Map(cost)) - 0.04) << ToString(cost);
  }
}

TEST(MatchingCosts, MutualInformationLearnsAnUnknownToneCurveWherePlainDifferenceFails) {
  // Contrast turned down and bent: bright is still brighter.
  const auto triple = Expose([](float e) { return 8.0F * std::pow(e, 0.4F); });
  triple->neighbours.resize(1);  // or the neighbours, of one curve, would match each other
  const double information = ShareRight(triple->Map(StereoCost::kMutualInformation));
  triple->options.gradient_truncation = 0;  // values alone: gradients survive such a curve
  const double difference = ShareRight(triple->Map(StereoCost::kInterval));
  RecordProperty("mutual_information", fmt::format("{:.3f}", information));
  RecordProperty("difference", fmt::format("{:.3f}", difference));
  EXPECT_GT(information, 0.65);
  EXPECT_LT(difference, 0.1);
}

TEST(MatchingCosts, MutualInformationLearnsEvenThatBrightIsDark) {
  const auto triple = Expose([](float e) { return 1.0F / (e + 0.1F); });
  EXPECT_GT(ShareRight(triple->Map(StereoCost::kMutualInformation)), 0.7);
  EXPECT_LT(ShareRight(triple->Map(StereoCost::kCensus)), 0.5);
}

TEST(CensusCosts, HardlyNoticeAGain) {
  const auto plain = Expose([](float e) { return e; });
  const auto gained = Expose([](float e) { return 1.7F * e; });
  const CostVolume a = CensusCosts(plain->views[0], plain->neighbours, plain->options);
  const CostVolume b = CensusCosts(gained->views[0], gained->neighbours, gained->options);
  double difference = 0.0;
  double level = 0.0;
  for (std::size_t k = 0; k < a.cost.size(); ++k) {
    difference += std::abs(a.cost[k] - b.cost[k]);
    level += a.cost[k];
  }
  // Not nothing: codes are whole numbers, and the floor under the logarithm does not scale.
  EXPECT_LT(difference, 0.06 * level);
}

TEST(CensusCosts, OfAViewWithItselfAreZeroAtInfinity) {
  const auto triple = Expose([](float e) { return e; });
  const CostVolume volume = CensusCosts(
      triple->views[0], {{&triple->views[0], Eigen::Vector3f(0.3F, 0.0F, 0.0F)}}, triple->options);
  for (int y = 0; y < volume.height; ++y) {
    for (int x = 0; x < volume.width; ++x) ASSERT_EQ(volume.at(x, y)[0], 0);
  }
}

TEST(MatchingCosts, WhatSaysNothingCostsTheSameWhateverTheDistance) {
  const Drive& drive = TheDrive();
  Measurement m = testing::Perfect(drive.truths[0].radiance, drive.projection);
  for (std::uint8_t& f : m.flags.values()) f = kMasked;
  const StereoView view = MakeStereoView(m, Eigen::Quaterniond::Identity(), 2 * testing::kMapWidth,
                                         LogScale::For(1e-3F, 20.0F));
  SweepOptions options;
  options.labels = 16;
  for (const StereoCost cost : kAllCosts) {
    const CostVolume volume =
        MatchingCosts(cost, view, {{&view, Eigen::Vector3f(0.1F, 0.0F, 0.0F)}}, options);
    for (const std::uint8_t c : volume.cost) ASSERT_EQ(c, options.unknown_cost) << ToString(cost);
  }
}

TEST(MatchingCosts, AreTheSameBytesOnOneAndOnTwoWorkers) {
  const auto triple = Expose([](float e) { return 1.3F * e; });
  for (const StereoCost cost : kAllCosts) {
    SetWorkerCount(1);
    const CostVolume one =
        MatchingCosts(cost, triple->views[0], triple->neighbours, triple->options);
    SetWorkerCount(2);
    const CostVolume two =
        MatchingCosts(cost, triple->views[0], triple->neighbours, triple->options);
    SetWorkerCount(0);
    EXPECT_EQ(one.cost, two.cost) << ToString(cost);
  }
}

}  // namespace
}  // namespace omnihdr::pairwise_costs_test
