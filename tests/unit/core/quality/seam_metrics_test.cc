#include "core/quality/seam_metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>

namespace omnihdr::seam_metrics_test {
namespace {

constexpr int kWidth = 128;
constexpr int kHeight = 64;
constexpr float kNoise = 0.02F;  // relative

// A textured scene.
Image<float> Scene() {
  Image<float> scene(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) {
        scene.at(x, y, c) =
            2.0F + std::sin(0.7F * static_cast<float>(x)) * std::cos(0.4F * static_cast<float>(y));
      }
    }
  }
  return scene;
}

// The scene as a merge shows it, with noise and, right of the middle, brighter by a factor.
Image<float> Merged(float step, float noise = kNoise) {
  Image<float> merged = Scene();
  std::mt19937 random(7);
  std::normal_distribution<float> normal(0.0F, 1.0F);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const float factor = (x >= kWidth / 2 ? 1.0F + step : 1.0F) * (1.0F + noise * normal(random));
      for (int c = 0; c < 3; ++c) merged.at(x, y, c) *= factor;
    }
  }
  return merged;
}

// Left half from one set of views, right half from another.
Image<std::uint8_t> Halves() {
  Image<std::uint8_t> sources(kWidth, kHeight, 1, 1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = kWidth / 2; x < kWidth; ++x) sources.at(x, y) = 3;
  }
  return sources;
}

SeamErrors Find(const Image<float>& merged, const Image<std::uint8_t>& sources,
                bool wraps = false) {
  return FindSeams(merged.view(), Scene().view(), sources.view(), {}, wraps);
}

TEST(FindSeams, APlantedStepIsFoundWithItsSize) {
  for (const float step : {0.04F, 0.1F}) {
    const SeamErrors errors = Find(Merged(step), Halves());
    EXPECT_GT(errors.borders, 50U);
    EXPECT_LE(errors.borders, static_cast<std::size_t>(kHeight));
    EXPECT_NEAR(errors.excess_noise, static_cast<double>(step / kNoise),
                0.3 * static_cast<double>(step / kNoise));
    EXPECT_NEAR(errors.excess_log10, std::log10(1.0 + static_cast<double>(step)),
                0.15 * static_cast<double>(step));
    EXPECT_GT(errors.visible, 0.8);
  }
}

TEST(FindSeams, WhereOnlyNoiseChangesThereIsNone) {
  const SeamErrors errors = Find(Merged(0.0F), Halves());
  EXPECT_GT(errors.borders, 50U);
  EXPECT_LT(errors.excess_noise, 0.35);
  EXPECT_LT(errors.visible, 0.1);
  EXPECT_LT(errors.excess_log10, 0.003);
}

TEST(FindSeams, EdgesOfTheSceneAreNoSeams) {
  Image<float> merged = Merged(0.0F);
  Image<float> truth = Scene();
  for (Image<float>* picture : {&merged, &truth}) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = kWidth / 2; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) picture->at(x, y, c) *= 50.0F;
      }
    }
  }
  const SeamErrors errors =
      FindSeams(merged.view(), truth.view(), Halves().view(), {}, /*wraps=*/false);
  EXPECT_LT(errors.excess_noise, 0.35);
}

TEST(FindSeams, AStepInsideOneSetOfViewsIsOfAnotherCause) {
  const SeamErrors errors = Find(Merged(0.1F), Image<std::uint8_t>(kWidth, kHeight, 1, 5));
  EXPECT_EQ(errors.borders, 0U);
  EXPECT_TRUE(std::isnan(errors.excess_noise));
}

TEST(FindSeams, ASetThatChangesFromPixelToPixelHasNoBorders) {
  Image<std::uint8_t> sources(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) sources.at(x, y) = static_cast<std::uint8_t>((x + y) % 2);
  }
  EXPECT_EQ(Find(Merged(0.0F), sources).borders, 0U);
}

TEST(FindSeams, APanoramasEdgesAreNeighbours) {
  // The halves meet again where the panorama closes.
  const SeamErrors open = Find(Merged(0.1F), Halves(), false);
  const SeamErrors closed = Find(Merged(0.1F), Halves(), true);
  EXPECT_GE(closed.borders, open.borders + kHeight - 8);
}

TEST(FindSeams, UnknownPixelsDoNotCount) {
  Image<float> merged = Merged(0.1F);
  for (float& value : merged.values()) value = 0.0F;
  EXPECT_EQ(Find(merged, Halves()).borders, 0U);
}

}  // namespace
}  // namespace omnihdr::seam_metrics_test
