// The golden rig: six sensors that see a world of known texture, and its twins with the mistakes
// that heads and their calibrations have had.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <string>
#include <variant>
#include <vector>

#include "core/photometry/rig_orientation.h"
#include "tests/support/ring.h"

namespace omnihdr::rig_orientation_check_test {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

using Stack = Image<std::uint8_t>;
using Radiance = std::function<double(const Eigen::Vector3d&)>;

constexpr double kPi = std::numbers::pi;
constexpr int kWidth = 256;
constexpr int kHeight = 192;
constexpr int kSensors = 6;

Eigen::Quaterniond Turn(double degrees, const Eigen::Vector3d& axis) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(degrees * kPi / 180.0, axis));
}

// Five sensors in a ring of 72 degrees, on their side, and one up.
Rig GoldenRig() {
  testing::RingOptions options;
  options.width = kWidth;
  options.height = kHeight;
  return testing::MakeRing(options);
}

// Cells of 4 degrees, each of its own brightness: no symmetry, no direction in which it repeats.
double Mosaic(const Eigen::Vector3d& ray) {
  const auto cell = [](double value) {
    return static_cast<std::uint32_t>(static_cast<int>(std::floor(value * 14.0)) + 1000);
  };
  std::uint32_t mixed =
      cell(ray.x()) * 73856093U ^ cell(ray.y()) * 19349663U ^ cell(ray.z()) * 83492791U;
  mixed = (mixed ^ mixed >> 15) * 2246822519U;
  mixed ^= mixed >> 13;
  return 30.0 + 120.0 * static_cast<double>(mixed % 1024) / 1023.0;
}

Stack Show(const Rig& rig, const Radiance& world) {
  const auto scene = [&](const Eigen::Vector3d& point) -> Eigen::Vector3d {
    return Eigen::Vector3d::Constant(world(point.normalized()) / 128.0);
  };
  return std::get<Stack>(testing::ShootRing(rig, scene, 10.0, 1.0).pixels).Clone();
}

// The same pictures in another order, mirrored.
Stack Restored(const Stack& stack, const std::vector<int>& order, bool flip_x, bool flip_y) {
  Stack out(stack.width(), stack.height());
  for (int i = 0; i < kSensors; ++i) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        out.at(x, i * kHeight + y) =
            stack.at(flip_x ? kWidth - 1 - x : x,
                     order[static_cast<std::size_t>(i)] * kHeight + (flip_y ? kHeight - 1 - y : y));
      }
    }
  }
  return out;
}

OrientationReport Examine(const Rig& rig, const Stack& stack) {
  auto check = OrientationCheck::Create(rig);
  EXPECT_TRUE(check) << check.error().message;
  EXPECT_TRUE(check->Add(stack.view()));
  return check->Report();
}

std::string Named(const OrientationReport& report) {
  std::string all;
  for (const OrientationAlternative& each : report.best) all += each.what + "\n";
  return all;
}

const std::vector<int> kInOrder = {0, 1, 2, 3, 4, 5};

class GoldenHead : public ::testing::Test {
 protected:
  void ExpectNamed(const Rig& rig, const Stack& stack, const std::string& what) {
    const OrientationReport report = Examine(rig, stack);
    EXPECT_EQ(report.verdict, OrientationVerdict::kContradicted) << what << "\n" << report.Text();
    EXPECT_THAT(Named(report), HasSubstr(what)) << report.Text();
    EXPECT_THAT(report.Text(), HasSubstr("they would agree if"));
  }
  const Rig rig_ = GoldenRig();
  const Stack stack_ = Show(rig_, Mosaic);
};

TEST_F(GoldenHead, AgreesWithItsOwnCalibration) {
  const OrientationReport report = Examine(rig_, stack_);
  EXPECT_EQ(report.verdict, OrientationVerdict::kAgrees) << report.Text();
  EXPECT_GT(report.configured.agreement, 0.8);
  EXPECT_THAT(report.best, IsEmpty());
}

TEST_F(GoldenHead, AgreesWhateverGainsAndResponseItsSensorsHave) {
  Stack stack = stack_.Clone();
  for (int i = 0; i < kSensors; ++i) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        std::uint8_t& value = stack.at(x, i * kHeight + y);
        value = static_cast<std::uint8_t>(
            std::lround(240.0 * std::pow(value / 255.0 * (1.0 - 0.08 * i), 0.7)));
      }
    }
  }
  EXPECT_EQ(Examine(rig_, stack).verdict, OrientationVerdict::kAgrees);
}

TEST_F(GoldenHead, MirroredPicturesAreNamed) {
  ExpectNamed(rig_, Restored(stack_, kInOrder, true, false), "mirrored, left for right");
  ExpectNamed(rig_, Restored(stack_, kInOrder, false, true), "mirrored, top for bottom");
}

TEST_F(GoldenHead, PicturesUpsideDownAreNamed) {
  ExpectNamed(rig_, Restored(stack_, kInOrder, true, true), "the pictures are stored upside down");
}

TEST_F(GoldenHead, RotationsThatAreAQuarterTurnOffAreNamedWithTheirSense) {
  for (const int degrees : {90, 270}) {
    Rig wrong = rig_;
    for (RigSensor& sensor : wrong.sensors) {
      sensor.camera_from_sensor.rotation =
          sensor.camera_from_sensor.rotation * Turn(degrees, Eigen::Vector3d::UnitZ());
    }
    // What is right is the rest of a whole turn away.
    ExpectNamed(wrong, stack_,
                "the rotations are " + std::to_string(360 - degrees) + " degrees off");
  }
}

TEST_F(GoldenHead, SensorsInAnotherOrderAreNamed) {
  ExpectNamed(rig_, Restored(stack_, {0, 2, 1, 3, 4, 5}, false, false),
              "sensors \"sensor1\" and \"sensor2\" are exchanged");
  ExpectNamed(rig_, Restored(stack_, {5, 1, 2, 3, 4, 0}, false, false),
              "sensors \"sensor0\" and \"sensor5\" are exchanged");
  ExpectNamed(rig_, Restored(stack_, {5, 4, 3, 2, 1, 0}, false, false),
              "counted from the other end");
  ExpectNamed(rig_, Restored(stack_, {0, 4, 3, 2, 1, 5}, false, false),
              "counted the other way round");
  ExpectNamed(rig_, Restored(stack_, {1, 2, 3, 4, 0, 5}, false, false),
              "the ring is counted from another sensor on");
}

TEST_F(GoldenHead, ASingleSensorUpsideDownIsNamed) {
  Stack stack = stack_.Clone();
  const Stack turned = Restored(stack_, kInOrder, true, true);
  for (int y = 3 * kHeight; y < 4 * kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) stack.at(x, y) = turned.at(x, y);
  }
  ExpectNamed(rig_, stack, "the picture of sensor \"sensor3\" is stored upside down");
}

TEST_F(GoldenHead, PlainScenesAndPicturesOfNothingAreUndecided) {
  const auto undecided = [&](const Stack& stack, const char* what) {
    auto check = OrientationCheck::Create(rig_);
    ASSERT_TRUE(check);
    const auto says = check->Add(stack.view());
    ASSERT_TRUE(says) << says.error().message;
    const OrientationReport report = check->Report();
    EXPECT_EQ(report.verdict, OrientationVerdict::kUndecided) << what << ": " << report.Text();
  };
  undecided(Show(rig_, [](const Eigen::Vector3d&) { return 120.0; }), "uniform");
  undecided(Show(rig_, [](const Eigen::Vector3d& ray) { return 100.0 + 90.0 * ray.z(); }), "sky");
  undecided(Show(rig_, [](const Eigen::Vector3d&) { return 255.0; }), "clipped");
  undecided(Show(rig_, [](const Eigen::Vector3d&) { return 1.0; }), "dark");
  // Pictures that have nothing in common.
  Stack noise(kWidth, kHeight * kSensors);
  std::uint32_t state = 7;
  for (int y = 0; y < noise.height(); y += 8) {
    for (int x = 0; x < kWidth; x += 8) {
      state = state * 1664525U + 1013904223U;
      for (int dy = 0; dy < 8; ++dy) {
        for (int dx = 0; dx < 8; ++dx) {
          noise.at(x + dx, y + dy) = static_cast<std::uint8_t>(40 + (state >> 24) % 180);
        }
      }
    }
  }
  undecided(noise, "noise");
}

TEST_F(GoldenHead, FramesAddUpInAnyOrderAndThoseThatSayNothingDoNotCount) {
  const Stack plain = Show(rig_, [](const Eigen::Vector3d&) { return 120.0; });
  const Stack mirrored = Restored(stack_, kInOrder, true, false);
  auto forth = OrientationCheck::Create(rig_);
  auto back = OrientationCheck::Create(rig_);
  EXPECT_EQ(forth->Add(plain.view()).value(), false);
  EXPECT_EQ(forth->Add(stack_.view()).value(), true);
  EXPECT_EQ(forth->Add(mirrored.view()).value(), true);
  EXPECT_EQ(back->Add(mirrored.view()).value(), true);
  EXPECT_EQ(back->Add(stack_.view()).value(), true);
  EXPECT_EQ(forth->Report().frames, 2);
  EXPECT_NEAR(forth->Report().configured.agreement, back->Report().configured.agreement, 1e-12);
}

TEST_F(GoldenHead, FramesOfAnotherSizeAndHeadsWithoutOverlapAreRefused) {
  auto check = OrientationCheck::Create(rig_);
  EXPECT_THAT(check->Add(Stack(kWidth, kHeight).view()).error().message,
              HasSubstr("frame of 256x192: expected 256x1152"));
  Rig one = rig_;
  one.sensors.resize(1);
  EXPECT_THAT(OrientationCheck::Create(one).error().message, HasSubstr("expected overlaps"));
}

}  // namespace
}  // namespace omnihdr::rig_orientation_check_test
