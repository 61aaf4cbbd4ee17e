#include "daemon/evaluation/mover_score.h"

#include <gtest/gtest.h>

#include <cstdint>

namespace omnihdr::mover_score_test {
namespace {

constexpr int kWidth = 32;
constexpr int kHeight = 16;
const MeasurableRange kBracket = {0.1F, 1000.0F};

// A mover of radiance `now` before a background, seen by the own frame; the view shows `shown`.
struct Case {
  float now = 1.0F;
  float background = 100.0F;
  float shown = 1.0F;
  std::uint8_t witnesses = 4;
  MeasurableRange own = kBracket;
  bool removes = false;
};

MoverScore Score(const Case& c) {
  const Image<float> view(kWidth, kHeight, 3, c.shown);
  const Image<float> own(kWidth, kHeight, 3, c.now);
  const Image<float> truth(kWidth, kHeight, 3, c.now);
  Reference::Movers movers;
  movers.background = Image<float>(kWidth, kHeight, 3, c.background);
  movers.here = Image<std::uint8_t>(kWidth, kHeight);
  movers.in_sight = Image<std::uint8_t>(kWidth, kHeight);
  movers.witnesses = Image<std::uint8_t>(kWidth, kHeight, 1, c.witnesses);
  movers.here.at(10, 8) = 1;
  movers.in_sight.at(0, 8) = 1;
  return ScoreMovers({.view = view,
                      .own_frame = own,
                      .truth = truth,
                      .movers = movers,
                      .bracket = kBracket,
                      .own = c.own,
                      .removes = c.removes},
                     {});
}

double Off(const Case& c) { return Score(c).view.share_off; }

TEST(ScoreMovers, TheAreaIsWhereMoversAreOrWereInSightAndThePixelsBesideThem) {
  EXPECT_EQ(Score({}).view.pixels, 18U);
}

TEST(ScoreMovers, KeptMoversAreThoseOfTheOwnInstant) {
  EXPECT_EQ(Off({.shown = 1.0F}), 0.0);
  EXPECT_EQ(Off({.shown = 100.0F}), 1.0);
  EXPECT_EQ(Off({.shown = 10.0F}), 1.0);
}

TEST(ScoreMovers, WhereTheOwnFrameClippedTheBackgroundIsAcceptedIfItMeetsTheBound) {
  const MeasurableRange short_of_both = {0.01F, 0.8F};
  EXPECT_EQ(Off({.shown = 100.0F, .own = short_of_both}), 0.0);
  EXPECT_EQ(Off({.shown = 10.0F, .own = short_of_both}), 1.0);
  // The mover clipped, the background is too dark to be what the own frame saw.
  EXPECT_EQ(Off({.now = 100.0F, .background = 1.0F, .shown = 1.0F, .own = {0.01F, 50.0F}}), 1.0);
}

TEST(ScoreMovers, WhereTheOwnFrameWasDarkTheBackgroundIsAcceptedIfItIsAsDark) {
  EXPECT_EQ(Off({.background = 4.0F, .shown = 4.0F, .own = {5.0F, 500.0F}}), 0.0);
  EXPECT_EQ(Off({.background = 100.0F, .shown = 100.0F, .own = {5.0F, 500.0F}}), 1.0);
}

TEST(ScoreMovers, RemovedMoversLeaveTheBackgroundWhereTwoOthersSawIt) {
  EXPECT_EQ(Off({.shown = 100.0F, .removes = true}), 0.0);
  EXPECT_EQ(Off({.shown = 1.0F, .removes = true}), 1.0);
  EXPECT_EQ(Off({.shown = 1.0F, .witnesses = 1, .removes = true}), 0.0);
  EXPECT_EQ(Off({.shown = 10.0F, .witnesses = 1, .removes = true}), 1.0);
}

TEST(ScoreMovers, WhatTheBracketCannotMeasureIsNotCompared) {
  EXPECT_EQ(Score({.now = 5000.0F}).view.pixels, 0U);
  EXPECT_EQ(Score({.background = 0.01F, .removes = true}).view.pixels, 0U);
}

}  // namespace
}  // namespace omnihdr::mover_score_test
