#include "core/pipeline/response_session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <random>
#include <vector>

#include "core/image/image_io.h"
#include "core/photometry/response_calibration.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::response_session_test {
namespace {

using ::testing::HasSubstr;
using testing::TemporaryDirectory;

// A camera that develops its pictures: E·t proportional to (Z + 4)^1.8, another contrast in blue.
Response Developed() {
  std::array<std::vector<double>, 3> ln;
  for (std::size_t c = 0; c < 3; ++c) {
    const double gamma = c == 2 ? 1.5 : 1.8;
    for (int z = 0; z < 256; ++z) ln[c].push_back(gamma * std::log((z + 4.0) / 132.0));
  }
  return Response::Table(ln).value();
}

testing::SessionPlan Drive(int positions) {
  testing::SessionPlan plan;
  plan.poses = testing::GentleBend(positions, 0.15);
  plan.projection = Projection::Equirectangular(512, 256);
  plan.exposures_s = {0.25, 0.5, 1.0};
  plan.room.detail_m = 0.8;
  plan.room.range_decades = 1.0F;
  plan.room.balls.push_back({{2.5, 1.6, 0.0}, 0.6, 1.0F});
  return plan;
}

// The plan's frames through a response, one exposure a position.
std::vector<std::vector<std::byte>> Frames(const testing::SessionPlan& plan,
                                           const Response& response, double noise_rms) {
  std::vector<std::vector<std::byte>> frames;
  for (std::size_t k = 0; k < plan.poses.size(); ++k) {
    const testing::Truth truth = Render(plan.room, plan.projection, plan.poses[k]);
    const double seconds = plan.exposures_s[k % plan.exposures_s.size()];
    std::mt19937 random(static_cast<std::uint32_t>(k) + 1);
    std::normal_distribution<double> noise(0.0, noise_rms);
    Image<std::uint8_t> frame(truth.radiance.width(), truth.radiance.height(), 3);
    for (std::size_t i = 0; i < frame.size(); ++i) {
      const double z =
          response.ValueFromExposure(static_cast<int>(i % 3), truth.radiance.values()[i] * seconds);
      frame.values()[i] =
          static_cast<std::uint8_t>(std::clamp(std::round(z + noise(random)), 0.0, 255.0));
    }
    frames.push_back(EncodePng(frame.view()).value());
  }
  return frames;
}

// Largest |ln error| of a channel's curve where there was data, its level left free.
double WorstError(const ResponseCurve& curve, const Response& truth, int channel) {
  std::vector<double> errors;
  for (int z = curve.measured_low; z <= curve.measured_high; ++z) {
    errors.push_back(curve.ln_exposure[static_cast<std::size_t>(z)] -
                     std::log(truth.ExposureFromValue(channel, z)));
  }
  const auto [low, high] = std::minmax_element(errors.begin(), errors.end());
  return 0.5 * (*high - *low);
}

TEST(ResponseSession, AMovingCamerasResponseIsRecoveredFromWhatItPasses) {
  const TemporaryDirectory directory;
  const testing::SessionPlan plan = Drive(9);
  const Response truth = Developed();
  testing::WriteSession(directory.path(), plan, Frames(plan, truth, 0.7));
  const SessionContents contents = ReadSession(directory.path()).value();
  ASSERT_EQ(contents.info.response.model(), ResponseModel::kLinear);  // what nobody has measured
  const Result<SessionSamples> source = SamplesFromSession(directory.path(), contents, {}, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_TRUE(source->moving);
  EXPECT_EQ(source->frames, 9);
  EXPECT_GE(source->links, 8);
  ASSERT_EQ(source->samples.seconds.size(), 3U);
  const Result<ResponseCalibration> found = CalibrateResponse(source->samples, {});
  ASSERT_TRUE(found) << found.error().message;
  for (int c = 0; c < 3; ++c) {
    const ResponseCurve& curve = found->curves[static_cast<std::size_t>(c)];
    EXPECT_LT(curve.measured_low, 40) << c;
    EXPECT_GT(curve.measured_high, 200) << c;
    EXPECT_LT(WorstError(curve, truth, c), 0.03) << c;  // of ln: 3 %
    // A linear camera's curve would be off by far: the test can tell.
    EXPECT_GT(WorstError(curve, Response::Linear().value(), c), 0.3) << c;
  }
}

TEST(ResponseSession, WhatTheMaskHidesSaysNothing) {
  const TemporaryDirectory directory;
  const testing::SessionPlan plan = Drive(4);
  testing::WriteSession(directory.path(), plan, Frames(plan, Developed(), 0.7));
  const SessionContents contents = ReadSession(directory.path()).value();
  const auto observations = [&](int rows_used) {
    Image<std::uint8_t> mask(512, 256, 1, 0);
    for (int y = 0; y < rows_used; ++y) std::fill_n(mask.row(y), 512, std::uint8_t{255});
    const Result<SessionSamples> source =
        SamplesFromSession(directory.path(), contents, mask.view(), {});
    return source ? source->samples.channels[1].size() : 0;
  };
  const std::size_t all = observations(256);
  const std::size_t half = observations(128);
  EXPECT_GT(half, all / 4);
  EXPECT_LT(half, all * 3 / 4);
  EXPECT_EQ(observations(0), 0U);
}

TEST(ResponseSession, ASessionThatSaysNothingAboutTheResponseIsRefusedWithTheReason) {
  const auto message = [](testing::SessionPlan plan, Layout layout) {
    const TemporaryDirectory directory;
    plan.projection = Projection::Equirectangular(128, 64);
    testing::WriteSession(directory.path(), plan, testing::RenderFrames(plan));
    SessionContents contents = ReadSession(directory.path()).value();
    contents.info.camera.layout = layout;
    const Result<SessionSamples> source = SamplesFromSession(directory.path(), contents, {}, {});
    EXPECT_FALSE(source);
    return source ? std::string() : source.error().message;
  };
  testing::SessionPlan equal = Drive(4);
  equal.exposures_s = {0.5};
  EXPECT_THAT(message(equal, Layout::kPanorama),
              HasSubstr("all 4 frames have one exposure, 0.5 s"));
  EXPECT_THAT(message(Drive(1), Layout::kPanorama), HasSubstr("1 usable frames"));
  EXPECT_THAT(message(Drive(4), Layout::kPerspective), HasSubstr("layout \"perspective\""));
  testing::SessionPlan bare = Drive(4);
  bare.room.textured = false;
  bare.room.balls.clear();
  EXPECT_THAT(message(bare, Layout::kPanorama), HasSubstr("could be matched"));
}

TEST(ResponseSession, GreyFramesOfARigAreNoMosaics) {
  const TemporaryDirectory directory;
  testing::SessionPlan plan = Drive(3);
  plan.poses.assign(3, Pose{});  // a tripod
  std::vector<std::vector<std::byte>> frames = Frames(plan, Developed(), 0.7);
  for (std::vector<std::byte>& png : frames) {
    const DecodedImage image = DecodeImage(png, "frame").value();
    const auto& colour = std::get<Image<std::uint8_t>>(image.pixels);
    Image<std::uint8_t> grey(colour.width(), colour.height());
    for (int y = 0; y < grey.height(); ++y) {
      for (int x = 0; x < grey.width(); ++x) grey.at(x, y) = colour.at(x, y, 1);
    }
    png = EncodePng(grey.view()).value();
  }
  testing::WriteSession(directory.path(), plan, frames);
  SessionContents contents = ReadSession(directory.path()).value();
  contents.info.camera.layout = Layout::kRig;
  contents.info.camera.bayer = "none";
  for (FrameRecord& record : contents.journal.frames) record.position = PositionId{0};
  const Image<std::uint8_t> mask(512, 256, 1, 255);  // of the frames' size
  const Result<SessionSamples> source =
      SamplesFromSession(directory.path(), contents, mask.view(), {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_FALSE(source->moving);
  const Result<ResponseCalibration> found = CalibrateResponse(source->samples, {});
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_LT(WorstError(found->curves[1], Developed(), 1), 0.03);
}

TEST(ResponseSession, AMosaicIsReadAsColourOfHalfItsSize) {
  Image<std::uint16_t> mosaic(4, 2);
  const std::array<std::uint16_t, 8> values = {100, 2000, 101, 2001, 2003, 65535, 2004, 60000};
  std::copy(values.begin(), values.end(), mosaic.values().begin());
  const DecodedImage colour = HalfSizeColour(DecodedImage{std::move(mosaic)}, BayerOrder::kBggr);
  const auto& pixels = std::get<Image<std::uint16_t>>(colour.pixels);
  ASSERT_EQ(pixels.width(), 2);
  ASSERT_EQ(pixels.height(), 1);
  EXPECT_EQ((std::array{pixels.at(0, 0, 0), pixels.at(0, 0, 1), pixels.at(0, 0, 2)}),
            (std::array<std::uint16_t, 3>{65535, 2002, 100}));
  EXPECT_EQ((std::array{pixels.at(1, 0, 0), pixels.at(1, 0, 1), pixels.at(1, 0, 2)}),
            (std::array<std::uint16_t, 3>{60000, 2003, 101}));
  Image<std::uint8_t> mask(4, 2, 1, 255);
  mask.at(1, 1) = 0;
  EXPECT_THAT(HalfSizeMask(mask.view()).values(), ::testing::ElementsAre(0, 255));
}

}  // namespace
}  // namespace omnihdr::response_session_test
