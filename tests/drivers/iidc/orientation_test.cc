// A target with a text through the whole way of a picture: emulated head, driver, frame.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <memory>
#include <string>
#include <variant>

#include "core/photometry/rig_orientation.h"
#include "core/session/rig_file.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/support/ring.h"

namespace omnihdr::orientation_test {
namespace {

using testing::EmulatedIidc;
using ::testing::HasSubstr;
using testing::Take;

using Stack = Image<std::uint8_t>;

constexpr int kWidth = 256;
constexpr int kHeight = 192;
constexpr int kSensors = 6;
constexpr double kExposure = 0.01;
constexpr std::array<const char*, 7> kLetter = {"#####", "#....", "#....", "####.",
                                                "#....", "#....", "#...."};
constexpr double kCell = 0.06;  // of the letter's plane, at distance 1

// Ahead stands an F, black on white; all around it are cells that do not repeat.
double World(const Eigen::Vector3d& ray) {
  if (ray.x() > 0.8) {
    const int column = static_cast<int>(std::floor(-ray.y() / ray.x() / kCell + 2.5));
    const int row = static_cast<int>(std::floor(3.5 - ray.z() / ray.x() / kCell));
    const bool on_letter = column >= 0 && column < 5 && row >= 0 && row < 7;
    return on_letter && kLetter[static_cast<std::size_t>(row)][column] == '#' ? 30.0 : 150.0;
  }
  std::uint32_t mixed = 0;
  for (const double value : {ray.x(), ray.y(), ray.z()}) {
    mixed = (mixed ^ static_cast<std::uint32_t>(1000 + static_cast<int>(std::floor(value * 14)))) *
            73856093U;
    mixed ^= mixed >> 13;
  }
  return 30.0 + 120.0 * static_cast<double>(mixed % 1024) / 1023.0;
}

enum class Mistake { kNone, kMirrored, kUpsideDown, kExchanged };

class OrientationThroughTheDriver : public ::testing::Test {
 protected:
  // A frame of a head that looks at the world, and makes a mistake in how it stores its pictures.
  Stack FrameOf(Mistake mistake) {
    testing::RingOptions ring;
    ring.width = kWidth;
    ring.height = kHeight;
    ring.vignetting = {};
    ring.equal_gains = true;
    rig_ = testing::MakeRing(ring);
    const auto scene = [](const Eigen::Vector3d& point) -> Eigen::Vector3d {
      return Eigen::Vector3d::Constant(World(point.normalized()) / 128.0);
    };
    const auto seen = std::make_shared<Stack>(
        std::get<Stack>(testing::ShootRing(rig_, scene, 10.0, 1.0).pixels).Clone());
    emulators::IidcDeviceOptions options;
    options.max_width = kWidth;
    options.max_height = kHeight * kSensors;
    options.rows_per_sensor = kHeight;
    options.bayer = rig_.sensors.front().bayer;
    options.scene = [seen, mistake](int x, int y) {
      int sensor = y / kHeight;
      int row = y % kHeight;
      if (mistake == Mistake::kExchanged && (sensor == 1 || sensor == 2)) sensor = 3 - sensor;
      if (mistake == Mistake::kMirrored || mistake == Mistake::kUpsideDown) x = kWidth - 1 - x;
      if (mistake == Mistake::kUpsideDown) row = kHeight - 1 - row;
      return seen->at(x, sensor * kHeight + row) / kExposure;
    };
    EmulatedIidc emulated(options);
    iidc::IidcCameraOptions camera_options = emulated.CameraOptions();
    camera_options.rig_file = emulated.folder.path() / "ring.toml";
    std::ofstream(camera_options.rig_file) << FormatRig(rig_);
    const auto camera = emulated.MakeCamera(camera_options);
    const auto info = camera->Open();
    EXPECT_TRUE(info) << info.error().message;
    EXPECT_TRUE(camera->Start());
    Result<CameraFrame> frame = Take(*camera, 0, kExposure);
    EXPECT_TRUE(frame) << frame.error().message;
    if (!frame) return {};
    EXPECT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
    return std::get<Stack>(std::move(frame->pixels));
  }
  // Cells of the letter that read as they should, of all.
  double Legible(const Stack& frame) const {
    int right = 0;
    for (int row = 0; row < 7; ++row) {
      for (int column = 0; column < 5; ++column) {
        const Eigen::Vector3d ray(1.0, (2.0 - column) * kCell, (3.0 - row) * kCell);
        const bool ink = kLetter[static_cast<std::size_t>(row)][column] == '#';
        for (int sensor = 0; sensor < kSensors; ++sensor) {
          const auto pixel = SensorPixelFromRay(rig_.sensors[static_cast<std::size_t>(sensor)], ray,
                                                std::numeric_limits<double>::infinity());
          if (!pixel) continue;
          const int value = frame.at(static_cast<int>(pixel->x()),
                                     sensor * kHeight + static_cast<int>(pixel->y()));
          right += (value < 90) == ink ? 1 : 0;
          break;
        }
      }
    }
    return right / 35.0;
  }
  OrientationReport Examine(const Stack& frame) const {
    auto check = OrientationCheck::Create(rig_);
    EXPECT_TRUE(check) << check.error().message;
    EXPECT_TRUE(check->Add(frame.view()).value());
    return check->Report();
  }
  Rig rig_;
};

TEST_F(OrientationThroughTheDriver, TheTextIsLegibleAndTheSensorsAgree) {
  const Stack frame = FrameOf(Mistake::kNone);
  ASSERT_FALSE(frame.empty());
  EXPECT_GT(Legible(frame), 0.95);
  const OrientationReport report = Examine(frame);
  EXPECT_EQ(report.verdict, OrientationVerdict::kAgrees) << report.Text();
}

TEST_F(OrientationThroughTheDriver, AHeadThatStoresItsPicturesOtherwiseIsFoundOutAndNamed) {
  const std::pair<Mistake, const char*> twins[] = {{Mistake::kMirrored, "mirrored, left for right"},
                                                   {Mistake::kUpsideDown, "stored upside down"},
                                                   {Mistake::kExchanged, "are exchanged"}};
  for (const auto& [mistake, what] : twins) {
    const Stack frame = FrameOf(mistake);
    ASSERT_FALSE(frame.empty());
    const OrientationReport report = Examine(frame);
    EXPECT_EQ(report.verdict, OrientationVerdict::kContradicted) << what << report.Text();
    EXPECT_THAT(report.Text(), HasSubstr(what));
    if (mistake != Mistake::kExchanged) {
      EXPECT_LT(Legible(frame), 0.9) << what;
    }
  }
}

}  // namespace
}  // namespace omnihdr::orientation_test
