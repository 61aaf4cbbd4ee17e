#include "core/capture/scene_look.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <vector>

namespace omnihdr::scene_look_test {
namespace {

using ::testing::Contains;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::Le;

// Pictures of a scene of two halves, of so many code values at one second, by a linear sensor.
class TwoHalves final : public Camera {
 public:
  TwoHalves(double dark, double bright) : dark_(dark), bright_(bright) {}
  Result<CameraInfo> Open() override {
    CameraInfo info;
    info.description.width = 8;
    info.description.height = 4;
    info.shortest = ExposureTime::Seconds(1e-5);
    info.longest = ExposureTime::Seconds(4.0);
    info.proof = ExposureProof::kEmbedded;
    return info;
  }
  void Close() override {}
  Status Start() override { return {}; }
  void Stop() override {}
  Status Trigger(const ExposureRequest& request) override {
    asked.push_back(request.exposure.time.seconds());
    EXPECT_GE(Value(request.trigger), Value(kFirstLookTrigger));
    if (stray) frames_.push_back(Frame({}));
    if (!silent) frames_.push_back(Frame(request));
    return {};
  }
  Result<CameraFrame> Receive(Nanoseconds) override {
    if (frames_.empty()) return Fail(ErrorKind::kTemporary, "no picture");
    CameraFrame frame = std::move(frames_.front());
    frames_.pop_front();
    return frame;
  }
  std::vector<double> asked;
  bool silent = false;
  bool stray = false;  // one of a trigger that was given up comes before every frame

 private:
  CameraFrame Frame(const ExposureRequest& request) const {
    CameraFrame frame;
    frame.trigger = request.trigger;
    frame.measured_exposure = request.exposure;
    frame.proof = ExposureProof::kEmbedded;
    Image<std::uint8_t> pixels(8, 4, 3, 0);
    for (int y = 0; y < 4; ++y) {
      for (int x = 0; x < 8; ++x) {
        const double value = (x < 4 ? dark_ : bright_) * request.exposure.time.seconds();
        for (int c = 0; c < 3; ++c) {
          pixels.at(x, y, c) = static_cast<std::uint8_t>(std::clamp(std::round(value), 0.0, 255.0));
        }
      }
    }
    frame.pixels = std::move(pixels);
    return frame;
  }
  const double dark_;
  const double bright_;
  std::deque<CameraFrame> frames_;
};

Result<SceneLook> Look(TwoHalves& camera, const SceneLookOptions& options = {}) {
  return LookAtScene(camera, *camera.Open(), options, [] { return true; });
}

TEST(SceneLook, TheBracketThatFollowsPutsBothHalvesOfTheSceneWhereTheyAreMeasuredWell) {
  TwoHalves camera(300.0, 2e6);
  camera.stray = true;
  const Result<SceneLook> look = Look(camera);
  ASSERT_TRUE(look) << look.error().message;
  EXPECT_EQ(look->pictures, static_cast<int>(camera.asked.size()));
  const auto proposal = look->scene.Propose({});
  ASSERT_TRUE(proposal);
  EXPECT_NEAR(proposal->RangeStops(), std::log2(2e6 / 300.0), 0.3);
  const auto allowed = AllowBracket(*proposal, {}, {});
  ASSERT_TRUE(allowed) << allowed.error().message;
  EXPECT_NEAR(allowed->exposures.front().seconds() * 2e6, 230.0, 30.0);
  EXPECT_NEAR(allowed->exposures.back().seconds() * 300.0, 24.0, 6.0);
  EXPECT_TRUE(allowed->notes.empty());
}

TEST(SceneLook, NoPictureIsLongerThanAllowedAndWhatStaysDarkIsSaid) {
  TwoHalves camera(1.0, 1e4);
  SceneLookOptions options;
  options.longest_s = 0.1;
  const Result<SceneLook> look = Look(camera, options);
  ASSERT_TRUE(look) << look.error().message;
  EXPECT_THAT(camera.asked, Each(Le(0.1)));
  EXPECT_THAT(camera.asked, Contains(0.1));
  const auto allowed = AllowBracket(*look->scene.Propose({}), {}, {});
  ASSERT_TRUE(allowed);
  EXPECT_THAT(allowed->notes, Contains(HasSubstr("dark in every picture")));
}

TEST(SceneLook, WhatTheConfigurationRefusesIsLeftOutAndSaid) {
  TwoHalves camera(300.0, 2e6);
  const Result<SceneLook> look = Look(camera);
  ASSERT_TRUE(look);
  const auto free = AllowBracket(*look->scene.Propose({}), {}, {});
  ASSERT_TRUE(free);
  BracketOptions options;
  options.max_blur_px = 1.0;
  options.speed_m_s = 5.0;
  options.near_m = 5.0;
  ExposureLimits limits;
  limits.pixel_rad = free->exposures.back().seconds() * 0.5;  // the longest one blurs by two pixels
  const auto allowed = AllowBracket(*look->scene.Propose({}), options, limits);
  ASSERT_TRUE(allowed);
  EXPECT_LT(allowed->exposures.size(), free->exposures.size());
  EXPECT_THAT(allowed->notes, Contains(HasSubstr("left out")));
}

TEST(SceneLook, ItEndsWhenNoPictureComesAndWhenItIsBrokenOff) {
  TwoHalves camera(300.0, 2e6);
  camera.silent = true;
  EXPECT_EQ(Look(camera).error().kind, ErrorKind::kTemporary);
  camera.silent = false;
  int asked = 0;
  EXPECT_FALSE(LookAtScene(camera, *camera.Open(), {}, [&] { return ++asked < 2; }));
}

}  // namespace
}  // namespace omnihdr::scene_look_test
