#include "core/stereo/view_synthesis.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "tests/support/room.h"

namespace omnihdr::view_synthesis_test {
namespace {

using ::testing::HasSubstr;

constexpr int kWidth = 384;
constexpr int kHeight = kWidth / 2;

testing::Room Hall() {
  testing::Room room;
  room.detail_m = 1.0;
  room.balls.push_back({{2.0, 1.2, 0.0}, 0.5, 1.5F});
  return room;
}

Pose At(double x, double y = 0.0, double yaw_deg = 0.0) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(yaw_deg * M_PI / 180.0, Eigen::Vector3d::UnitZ())),
          {x, y, 0.0}};
}

SynthesisSource SourceAt(const testing::Room& room, const Pose& pose) {
  testing::Truth truth = Render(room, Projection::Equirectangular(kWidth, kHeight), pose);
  SynthesisSource source;
  source.radiance = std::move(truth.radiance);
  source.disparity = std::move(truth.distance);
  for (float& v : source.disparity.values()) v = 1.0F / v;
  source.world_from_output = pose;
  return source;
}

struct Errors {
  double log10_median = 0.0;
  double off = 0.0;        // share of the known pixels off by more than 25 %
  double disparity = 0.0;  // share off by more than 5 %
};
Errors Compare(const SynthesizedView& view, const testing::Room& room, const Pose& pose) {
  const testing::Truth truth = Render(
      room, Projection::Equirectangular(view.radiance.width(), view.radiance.height()), pose);
  std::vector<double> errors;
  Errors result;
  double known = 0.0;
  for (int y = 0; y < view.radiance.height(); ++y) {
    for (int x = 0; x < view.radiance.width(); ++x) {
      const float got = view.radiance.at(x, y, 1);
      if (!std::isfinite(got)) continue;
      known += 1.0;
      const double e = std::abs(std::log10(got / truth.radiance.at(x, y, 1)));
      errors.push_back(e);
      result.off += e > 0.1 ? 1.0 : 0.0;
      const double d = static_cast<double>(view.disparity.at(x, y) * truth.distance.at(x, y));
      result.disparity += std::abs(d - 1.0) > 0.05 ? 1.0 : 0.0;
    }
  }
  if (errors.empty()) return {1.0, 1.0, 1.0};
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  result.log10_median = *middle;
  result.off /= known;
  result.disparity /= known;
  return result;
}

TEST(ViewSynthesis, AViewBetweenTwoOthersShowsWhatIsThere) {
  const testing::Room room = Hall();
  std::vector<SynthesisSource> sources;
  sources.push_back(SourceAt(room, At(0.0, 0.0, 20.0)));
  sources.push_back(SourceAt(room, At(0.5, 0.1, -35.0)));
  const Pose target = At(0.25, 0.0, 5.0);
  const SynthesizedView view = SynthesizeView(sources, target, kWidth, {}).value();
  EXPECT_LT(view.holes, 0.01);
  const Errors errors = Compare(view, room, target);
  EXPECT_LT(errors.log10_median, 0.01);
  EXPECT_LT(errors.off, 0.03);
  EXPECT_LT(errors.disparity, 0.03);
}

TEST(ViewSynthesis, AtASourcesPlaceItIsThatSource) {
  const testing::Room room = Hall();
  std::vector<SynthesisSource> sources;
  sources.push_back(SourceAt(room, At(0.0)));
  sources.push_back(SourceAt(room, At(0.6)));
  const SynthesizedView view = SynthesizeView(sources, At(0.0), kWidth, {}).value();
  EXPECT_LT(view.holes, 1e-4);  // a lone far pixel among near ones is taken for a crack
  int same = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      same += std::abs(view.radiance.at(x, y, 1) / sources[0].radiance.at(x, y, 1) - 1.0F) < 0.01F;
    }
  }
  EXPECT_GT(same, 0.98 * kWidth * kHeight);
}

// A ball hides a part of the wall from one source; from the new place it is seen.
TEST(ViewSynthesis, WhatOneSourceCannotSeeComesFromTheOther) {
  testing::Room room = Hall();
  room.balls = {{{1.0, 0.0, 0.0}, 0.3, 0.2F}};
  std::vector<SynthesisSource> sources;
  sources.push_back(SourceAt(room, At(0.0, 0.0)));
  const Pose target = At(0.0, 0.6);
  const SynthesizedView alone = SynthesizeView(sources, target, kWidth, {}).value();
  EXPECT_GT(alone.holes, 0.005);
  sources.push_back(SourceAt(room, At(0.0, 0.9)));
  const SynthesizedView both = SynthesizeView(sources, target, kWidth, {}).value();
  EXPECT_LT(both.holes, 0.3 * alone.holes);
  EXPECT_GT(both.occluded, 0.005);
  EXPECT_LT(Compare(both, room, target).off, 0.03);
}

TEST(ViewSynthesis, WhatNoSourceKnowsIsAHole) {
  const testing::Room room = Hall();
  std::vector<SynthesisSource> sources;
  sources.push_back(SourceAt(room, At(0.0)));
  for (int y = 0; y < kHeight / 4; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      sources[0].disparity.at(x, y) = std::numeric_limits<float>::quiet_NaN();
    }
  }
  const SynthesizedView view = SynthesizeView(sources, At(0.05), kWidth, {}).value();
  // The cap from the pole to 45 degrees.
  EXPECT_NEAR(view.holes, 0.5 * (1.0 - std::cos(M_PI / 4.0)), 0.02);
  EXPECT_TRUE(std::isnan(view.radiance.at(10, 2, 0)));
  EXPECT_TRUE(std::isnan(view.disparity.at(10, 2)));
}

TEST(ViewSynthesis, WhatIsInfinitelyFarTurnsWithTheAxesAlone) {
  std::vector<SynthesisSource> sources(1);
  sources[0].radiance = Image<float>(kWidth, kHeight, 3, 1.0F);
  sources[0].disparity = Image<float>(kWidth, kHeight, 1, 0.0F);
  for (int y = 80; y < 100; ++y) sources[0].radiance.at(100, y, 1) = 5.0F;
  const double step_deg = 360.0 / kWidth;
  const SynthesizedView view =
      SynthesizeView(sources, At(30.0, 20.0, 10.0 * step_deg), kWidth, {}).value();
  EXPECT_EQ(view.holes, 0.0);
  float most = 0.0F;
  int where = 0;
  for (int x = 0; x < kWidth; ++x) {
    if (view.radiance.at(x, 90, 1) > most) {
      most = view.radiance.at(x, 90, 1);
      where = x;
    }
  }
  EXPECT_NEAR(most, 5.0F, 0.1F);
  EXPECT_EQ(std::abs(where - 100), 10);
}

TEST(ViewSynthesis, BadInputIsRefusedWithTheReason) {
  const testing::Room room = Hall();
  std::vector<SynthesisSource> sources;
  EXPECT_THAT(SynthesizeView(sources, Pose{}, kWidth, {}).error().message, HasSubstr("no view"));
  sources.push_back(SourceAt(room, At(0.0)));
  EXPECT_THAT(SynthesizeView(sources, Pose{}, 33, {}).error().message, HasSubstr("33 pixels"));
  Pose nowhere;
  nowhere.translation.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(SynthesizeView(sources, nowhere, kWidth, {}).error().message,
              HasSubstr("not finite"));
  sources[0].disparity = Image<float>(8, 4);
  EXPECT_THAT(SynthesizeView(sources, Pose{}, kWidth, {}).error().message,
              HasSubstr("disparity of 8x4, expected lat-long"));
}

}  // namespace
}  // namespace omnihdr::view_synthesis_test
