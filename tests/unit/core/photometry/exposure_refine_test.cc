#include "core/photometry/exposure_refine.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/support/room.h"

namespace omnihdr::exposure_refine_test {
namespace {

constexpr NoiseModel kNoise{.read = 0.5, .gain = 0.0255, .prnu = 0.0};

// Radiance spread evenly in the logarithm over three decades, smooth in places and rough in others.
const Image<float>& Scene() {
  static const Image<float> scene = [] {
    Image<float> truth(300, 200, 3);
    std::mt19937 generator(11);
    std::uniform_real_distribution<double> ln(std::log(0.02), std::log(20.0));
    for (int y = 0; y < 200; ++y) {
      for (int x = 0; x < 300; ++x) {
        const double e = std::exp(ln(generator));
        for (int c = 0; c < 3; ++c) truth.at(x, y, c) = static_cast<float>(e * (1.0 - 0.15 * c));
      }
    }
    return truth;
  }();
  return scene;
}

struct Bracket {
  std::vector<DecodedImage> images;
  std::vector<ExposedFrame> frames;
};

// Pictures taken for `seconds`, labelled seconds / errors.
Bracket Take(const std::vector<double>& seconds, const std::vector<double>& errors) {
  Bracket bracket;
  for (std::size_t k = 0; k < seconds.size(); ++k) {
    bracket.images.push_back(
        testing::Expose(Scene(), seconds[k], 20 + static_cast<unsigned>(k), kNoise));
  }
  for (std::size_t k = 0; k < seconds.size(); ++k) {
    bracket.frames.push_back(
        {&bracket.images[k], {ExposureTime::Seconds(seconds[k] / errors[k]), GainDb{}}});
  }
  return bracket;
}

std::vector<RefinedExposure> Refine(const Bracket& bracket, RefineOptions options = {}) {
  options.noise = kNoise;
  Result<std::vector<RefinedExposure>> refined =
      RefineExposures(bracket.frames, *Response::Linear(), 8, {}, options);
  EXPECT_TRUE(refined) << refined.error().message;
  return refined ? *refined : std::vector<RefinedExposure>(bracket.frames.size());
}

std::vector<std::string> Notes(const Bracket& bracket,
                               const std::vector<RefinedExposure>& refined) {
  std::vector<std::string> names;
  for (std::size_t k = 0; k < refined.size(); ++k) names.push_back(fmt::format("frame {}", k));
  return RefinementNotes(refined, bracket.frames, names, 0.2);
}

const std::vector<double> kTimes = {1.0 / 32.0, 0.25, 2.0};

TEST(ExposureRefinement, RightLabelsStayAndReadRight) {
  for (const RefinedExposure& r : Refine(Take(kTimes, {1.0, 1.0, 1.0}))) {
    EXPECT_EQ(r.verdict, RefineVerdict::kLabelRight);
    EXPECT_EQ(r.scale, 1.0);
    EXPECT_NEAR(r.measured, 1.0, 0.002);
    EXPECT_GT(r.samples, 1000U);
  }
}

TEST(ExposureRefinement, AWrongLabelIsFoundToBetterThanAPercentWhicheverFrameHasIt) {
  for (const double error : {1.05, 1.15, 0.95, 1.0 / 1.15}) {
    for (std::size_t wrong = 0; wrong < 3; ++wrong) {
      std::vector<double> errors(3, 1.0);
      errors[wrong] = error;
      const Bracket bracket = Take(kTimes, errors);
      const std::vector<RefinedExposure> refined = Refine(bracket);
      for (std::size_t k = 0; k < 3; ++k) {
        EXPECT_NEAR(refined[k].scale / errors[k], 1.0, 0.01)
            << "error " << error << " in frame " << wrong << ", frame " << k;
      }
      EXPECT_EQ(refined[wrong].verdict, RefineVerdict::kRefined);
      const std::vector<std::string> notes = Notes(bracket, refined);
      ASSERT_EQ(notes.size(), 1U);
      EXPECT_EQ(notes[0].find(fmt::format("frame {}: exposure ", wrong)), 0U) << notes[0];
      EXPECT_NE(notes[0].find("corrected"), std::string::npos) << notes[0];
    }
  }
}

TEST(ExposureRefinement, TheOrderOfTheFramesDoesNotMatter) {
  Bracket bracket = Take(kTimes, {1.0, 1.15, 1.0});
  const std::vector<RefinedExposure> a = Refine(bracket);
  std::swap(bracket.frames[0], bracket.frames[2]);
  const std::vector<RefinedExposure> b = Refine(bracket);
  EXPECT_EQ(a[0].scale, b[2].scale);
  EXPECT_EQ(a[1].scale, b[1].scale);
  EXPECT_EQ(a[2].scale, b[0].scale);
}

TEST(ExposureRefinement, AnErrorBeyondTheLimitIsRefusedAndTold) {
  for (std::size_t wrong = 0; wrong < 3; ++wrong) {
    std::vector<double> errors(3, 1.0);
    errors[wrong] = 1.4;
    const Bracket bracket = Take(kTimes, errors);
    const std::vector<RefinedExposure> refined = Refine(bracket);
    for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(refined[k].scale, 1.0);
    EXPECT_EQ(refined[wrong].verdict, RefineVerdict::kBeyondLimit);
    EXPECT_NEAR(refined[wrong].measured, 1.4, 0.02);
    const std::vector<std::string> notes = Notes(bracket, refined);
    ASSERT_EQ(notes.size(), 1U);
    EXPECT_NE(notes[0].find("kept as labelled"), std::string::npos) << notes[0];
  }
}

TEST(ExposureRefinement, SmallStepsThatAddUpAreTheResponseAndMoveNoLabel) {
  const std::vector<double> times = {0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28, 2.56};
  std::vector<double> errors;
  for (std::size_t k = 0; k < times.size(); ++k) errors.push_back(std::pow(1.1, k));
  const Bracket bracket = Take(times, errors);
  const std::vector<RefinedExposure> refined = Refine(bracket);
  for (const RefinedExposure& r : refined) EXPECT_EQ(r.scale, 1.0);
  const std::vector<std::string> notes = Notes(bracket, refined);
  ASSERT_EQ(notes.size(), 1U);
  EXPECT_NE(notes[0].find("the response"), std::string::npos) << notes[0];
}

TEST(ExposureRefinement, WhereOverlapsAreTooSmallNothingIsRefined) {
  const std::vector<RefinedExposure> far_apart = Refine(Take({1e-4, 1.0}, {1.0, 1.1}));
  for (const RefinedExposure& r : far_apart) {
    EXPECT_EQ(r.verdict, RefineVerdict::kNoOverlap);
    EXPECT_EQ(r.scale, 1.0);
  }
  RefineOptions greedy;
  greedy.samples = 1'000'000;
  for (const RefinedExposure& r : Refine(Take(kTimes, {1.0, 1.1, 1.0}), greedy)) {
    EXPECT_EQ(r.verdict, RefineVerdict::kNoOverlap);
    EXPECT_EQ(r.scale, 1.0);
  }
}

TEST(ExposureRefinement, PicturesOfDifferentThingsDoNotTestEachOther) {
  Bracket bracket = Take(kTimes, {1.0, 1.0, 1.0});
  auto& pixels = std::get<Image<std::uint8_t>>(bracket.images[1].pixels);
  std::mt19937 generator(5);
  std::shuffle(pixels.values().begin(), pixels.values().end(), generator);
  for (const RefinedExposure& r : Refine(bracket)) EXPECT_EQ(r.scale, 1.0);
}

TEST(ExposureRefinement, MaskedPixelsDoNotCount) {
  Bracket bracket = Take(kTimes, {1.0, 1.0, 1.0});
  const Image<std::uint8_t> mask(300, 200, 1, 0);
  RefineOptions options;
  options.noise = kNoise;
  const auto refined =
      RefineExposures(bracket.frames, *Response::Linear(), 8, mask.view(), options);
  ASSERT_TRUE(refined);
  for (const RefinedExposure& r : *refined) {
    EXPECT_EQ(r.samples, 0U);
    EXPECT_EQ(r.verdict, RefineVerdict::kNoOverlap);
  }
}

TEST(ExposureRefinement, OneFrameHasNothingToBeTestedBy) {
  const std::vector<RefinedExposure> refined = Refine(Take({0.5}, {1.2}));
  ASSERT_EQ(refined.size(), 1U);
  EXPECT_EQ(refined[0].scale, 1.0);
  EXPECT_EQ(refined[0].verdict, RefineVerdict::kLabelRight);
}

}  // namespace
}  // namespace omnihdr::exposure_refine_test
