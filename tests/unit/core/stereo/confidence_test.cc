#include "core/stereo/confidence.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace omnihdr::confidence_test {
namespace {

constexpr int kWidth = 64;
constexpr int kHeight = 32;

// A view of even grey that saw nothing from row `first_unseen` of its map on.
StereoView View(int first_unseen) {
  StereoView view;
  view.width = 2 * kWidth;
  view.height = 2 * kHeight;
  view.texels.assign(
      static_cast<std::size_t>(view.height + 1) * static_cast<std::size_t>(view.width + 1),
      0x8080808080808080ULL);
  for (std::size_t i =
           static_cast<std::size_t>(2 * first_unseen) * static_cast<std::size_t>(view.width + 1);
       i < view.texels.size(); ++i) {
    view.texels[i] = 0x00FF00FF00FF00FFULL;
  }
  return view;
}

DisparityMap Map(float confidence) {
  DisparityMap map;
  map.disparity = Image<float>(kWidth, kHeight, 1, 0.5F);
  map.confidence = Image<float>(kWidth, kHeight, 1, confidence);
  return map;
}

TEST(ProbabilityRight, RisesWithTheScoreAndStaysAProbability) {
  float last = 0.0F;
  for (float score = 0.03F; score <= 1.2F; score += 0.01F) {
    const float p = ProbabilityRight(score);
    EXPECT_GE(p, last);
    EXPECT_LT(p, 1.0F);
    last = p;
  }
  EXPECT_GT(last, 0.9F);
}

TEST(ProbabilityRight, OfAFilledDisparityIsNeitherSureNorNothing) {
  EXPECT_GT(ProbabilityRight(0.0F), 0.3F);
  EXPECT_LT(ProbabilityRight(0.0F), 0.6F);
  EXPECT_EQ(ProbabilityRight(std::numeric_limits<float>::quiet_NaN()), ProbabilityRight(0.0F));
}

TEST(CalibrateConfidence, WhatIsNotKnownHasNone) {
  Image<float> disparity(2, 1, 1, 0.5F);
  disparity.at(1, 0) = std::numeric_limits<float>::quiet_NaN();
  Image<float> confidence(2, 1, 1, 0.7F);
  const DisparityPrecision fine{1536.0, 0.0, 0.3};
  CalibrateConfidence(disparity, fine, &confidence);
  EXPECT_EQ(confidence.at(0, 0), ProbabilityRight(0.7F));
  EXPECT_EQ(confidence.at(1, 0), 0.0F);
}

TEST(CalibrateConfidence, TakesThePrecisionOfEveryDisparityIntoAccount) {
  const DisparityPrecision head{512.0, 0.044, 0.3};
  Image<float> disparity(500, 1);
  for (int x = 0; x < 500; ++x) disparity.at(x, 0) = 0.008F * static_cast<float>(x);
  disparity.at(0, 0) = std::numeric_limits<float>::infinity();
  Image<float> confidence(500, 1, 1, 0.9F);
  CalibrateConfidence(disparity, head, &confidence);
  for (int x = 0; x < 500; ++x) {
    if (x == 0) continue;
    EXPECT_NEAR(confidence.at(x, 0), ProbabilityRight(0.9F) * head.Within(disparity.at(x, 0)),
                1e-3F);
  }
  EXPECT_LE(confidence.at(0, 0), confidence.at(499, 0));
}

TEST(DisparityPrecision, APanoramaAsFineAsThoseMeasuredTakesNothingAwayAndACoarseOneMore) {
  EXPECT_EQ((DisparityPrecision{1024.0, 0.0, 0.3}.Within(0.5F)), 1.0F);
  float last = 1.0F;
  for (const double columns : {512.0, 256.0, 128.0}) {
    const float share = DisparityPrecision{columns, 0.0, 0.3}.Within(0.5F);
    EXPECT_LT(share, last) << columns;
    last = share;
  }
  // A normal error of 2.04 of the pixels that count.
  EXPECT_NEAR(last, 0.376F, 0.01F);
}

TEST(DisparityPrecision, AHeadsSizeTellsAgainstWhatIsNearAndOnlyWithABaseline) {
  const DisparityPrecision head{1024.0, 0.044, 0.3};
  EXPECT_GT(head.Within(0.1F), 0.99F);
  EXPECT_GT(head.Within(0.3F), head.Within(0.7F));
  // At 1 m the parallax of 73 pixels is off by 3.2.
  EXPECT_NEAR(head.Within(1.0F), 0.24F, 0.02F);
  EXPECT_EQ((DisparityPrecision{1024.0, 0.044, 0.0}.Within(1.0F)), 1.0F);
}

// Errors drawn as a head of sensors makes them are as often within a pixel as is said.
TEST(DisparityPrecision, SaysTheShareThatIsRight) {
  const DisparityPrecision precision{600.0, 0.05, 0.25};
  const double pixel = 2.0 * std::numbers::pi / 1536.0;
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  for (const double d : {0.1, 0.5, 0.9}) {
    int right = 0;
    constexpr int kTrials = 20'000;
    for (int i = 0; i < kTrials; ++i) {
      const double match = 0.17 * 1536.0 / 600.0 * normal(random);
      const double head = (1.0 / (1.0 / d + 0.05 * normal(random)) - d) * 0.25 / pixel;
      right += std::fabs(match + head) <= 1.0 ? 1 : 0;
    }
    EXPECT_NEAR(static_cast<double>(precision.Within(static_cast<float>(d))),
                static_cast<double>(right) / kTrials, 0.02)
        << d;
  }
}

SweepNeighbour Beside(const StereoView& view, float y) {
  return {&view, Eigen::Vector3f(0.0F, y, 0.0F)};
}

TEST(ForgetUnseen, LeavesAloneWhatTheReferenceSaw) {
  DisparityMap map = Map(0.0F);
  ForgetUnseen(View(kHeight), {}, &map);
  for (const float d : map.disparity.values()) EXPECT_EQ(d, 0.5F);
}

TEST(ForgetUnseen, KeepsAnAreaThatOthersAgreeOn) {
  DisparityMap map = Map(0.8F);
  const StereoView whole = View(kHeight + 1);
  ForgetUnseen(View(16), {Beside(whole, -0.1F), Beside(whole, 0.1F)}, &map);
  for (const float d : map.disparity.values()) EXPECT_EQ(d, 0.5F);
}

TEST(ForgetUnseen, DropsAnAreaThatNotTwoOthersCanHaveSeen) {
  const StereoView whole = View(kHeight + 1);
  const StereoView blind = View(16);
  for (const bool one_sees : {false, true}) {
    DisparityMap map = Map(0.8F);
    ForgetUnseen(blind, {Beside(blind, -0.1F), Beside(one_sees ? whole : blind, 0.1F)}, &map);
    for (int y = 0; y < kHeight; ++y) {
      EXPECT_EQ(std::isnan(map.disparity.at(3, y)), y >= 16) << y;
      EXPECT_EQ(map.confidence.at(3, y) == 0.0F, y >= 16) << y;
    }
  }
}

TEST(ForgetUnseen, DropsSinglePixelsWhereTheReferenceSawNothing) {
  DisparityMap map = Map(0.1F);
  for (int y = 0; y < kHeight; y += 3) {
    for (int x = 0; x < kWidth; x += 3) map.confidence.at(x, y) = 0.8F;
  }
  const StereoView whole = View(kHeight + 1);
  ForgetUnseen(View(16), {Beside(whole, -0.1F), Beside(whole, 0.1F)}, &map);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      EXPECT_EQ(std::isnan(map.disparity.at(x, y)), y >= 16) << x << ", " << y;
    }
  }
}

}  // namespace
}  // namespace omnihdr::confidence_test
