#include "core/capture/bracket_proposal.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace omnihdr::bracket_proposal_test {
namespace {

// A linear camera's picture of a scene whose radiance rises by even stops from `dark` to `bright`.
DecodedImage Picture(double dark, double bright, double seconds) {
  constexpr int kSide = 256;
  Image<std::uint8_t> pixels(kSide, kSide, 1);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const double part = (y * kSide + x) / (kSide * kSide - 1.0);
      const double radiance = dark * std::pow(bright / dark, part);
      pixels.at(x, y) =
          static_cast<std::uint8_t>(std::clamp(std::round(128.0 * radiance * seconds), 0.0, 255.0));
    }
  }
  DecodedImage image;
  image.pixels = std::move(pixels);
  return image;
}

Exposure Seconds(double seconds) { return {ExposureTime::Seconds(seconds), GainDb{}}; }

TEST(BracketProposal, TheBracketSpansTheScenesRangeFromItsBrightestToItsDarkestPixels) {
  const double dark = 10.0;
  const double bright = 10000.0;
  SceneRange scene(*Response::Linear(), 8);
  for (const double seconds : {1e-4, 1e-3, 1e-2, 0.1}) {
    scene.Add(Picture(dark, bright, seconds), Seconds(seconds));
  }
  const ProposalOptions options;
  const BracketProposal proposal = scene.Propose(options).value();
  EXPECT_TRUE(proposal.bright_reached);
  EXPECT_TRUE(proposal.dark_reached);
  EXPECT_NEAR(std::log2(proposal.bright / bright), 0.0, 0.1);
  EXPECT_NEAR(std::log2(proposal.dark / dark), 0.0, 0.25);
  EXPECT_NEAR(proposal.shortest.seconds() * bright * 128.0, options.bright_value, 20.0);
  const double longest =
      (proposal.shortest + Stops{proposal.step.value * (proposal.count - 1)}).seconds();
  EXPECT_NEAR(longest * dark * 128.0, options.dark_value, 6.0);
  EXPECT_LE(proposal.step.value, options.most_stops + 1e-9);
  // Not one more than is needed.
  EXPECT_GT(std::log2(longest / proposal.shortest.seconds()) / options.most_stops,
            proposal.count - 2);
}

TEST(BracketProposal, ARangeThatThePicturesDoNotReachIsSaid) {
  SceneRange scene(*Response::Linear(), 8);
  EXPECT_FALSE(scene.Propose({}));
  scene.Add(Picture(10.0, 10000.0, 1e-3), Seconds(1e-3));
  const BracketProposal proposal = scene.Propose({}).value();
  EXPECT_FALSE(proposal.bright_reached);
  EXPECT_FALSE(proposal.dark_reached);
  EXPECT_GT(scene.ClippedShare(Seconds(1e-3), 245.0), 0.2);
  EXPECT_GT(scene.DarkShare(Seconds(1e-3), 10.0), 0.2);
}

TEST(BracketProposal, AFlatSceneNeedsOneExposure) {
  SceneRange scene(*Response::Linear(), 8);
  scene.Add(Picture(90.0, 110.0, 0.01), Seconds(0.01));
  const BracketProposal proposal = scene.Propose({}).value();
  EXPECT_EQ(proposal.count, 1);
  EXPECT_NEAR(proposal.shortest.seconds() * 110.0 * 128.0, 230.0, 10.0);
}

TEST(BracketProposal, DeepPicturesCountByTheirUpperBits) {
  SceneRange scene(*Response::Linear(), 12);
  DecodedImage image;
  image.pixels = Image<std::uint16_t>(16, 16, 1, 128 << 4);
  scene.Add(image, Seconds(1.0));
  EXPECT_NEAR(scene.Propose({})->bright, 1.0, 0.02);
}

TEST(BracketProposal, OptionsOutOfRangeAreNamed) {
  ProposalOptions options;
  options.most_stops = 0.0;
  EXPECT_EQ(options.Validate().error().message, "most_stops: 0: expected 0.1 to 10");
}

}  // namespace
}  // namespace omnihdr::bracket_proposal_test
