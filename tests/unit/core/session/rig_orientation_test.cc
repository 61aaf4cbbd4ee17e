// The target every stitcher should be shown once: letters, which tell a mirrored picture, a picture
// on its side and one upside down apart.

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "core/session/rig_file.h"

namespace omnihdr::rig_orientation_test {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kDegree = kPi / 180.0;
constexpr int kLetterColumns = 5;
constexpr int kLetterRows = 7;
constexpr double kCell = 3.0 * kDegree;

struct Letter {
  const char* name;
  Eigen::Vector3d towards;
  Eigen::Vector3d right;  // as a person in the middle sees it
  Eigen::Vector3d up;
  std::array<const char*, kLetterRows> rows;
};

const std::array<Letter, 5>& Letters() {
  static const std::array<Letter, 5> letters = {{
      {"forward",
       {1, 0, 0},
       {0, -1, 0},
       {0, 0, 1},
       {"#####", "#....", "#....", "####.", "#....", "#....", "#...."}},
      {"left",
       {0, 1, 0},
       {1, 0, 0},
       {0, 0, 1},
       {"#....", "#....", "#....", "#....", "#....", "#....", "#####"}},
      {"back",
       {-1, 0, 0},
       {0, 1, 0},
       {0, 0, 1},
       {"####.", "#...#", "#...#", "####.", "#...#", "#...#", "####."}},
      {"right",
       {0, -1, 0},
       {-1, 0, 0},
       {0, 0, 1},
       {"####.", "#...#", "#...#", "####.", "#.#..", "#..#.", "#...#"}},
      // Looking up with the back of the head to the back: what is ahead is below in the view.
      {"up",
       {0, 0, 1},
       {0, -1, 0},
       {-1, 0, 0},
       {"####.", "#...#", "#...#", "####.", "#....", "#....", "#...."}},
  }};
  return letters;
}

// What a point of the letter's plane shows: 1 ink, 0 paper.
int InkAt(const Letter& letter, double right, double up) {
  const int column = static_cast<int>(std::floor(right / std::tan(kCell) + 0.5 * kLetterColumns));
  const int row = static_cast<int>(std::floor(0.5 * kLetterRows - up / std::tan(kCell)));
  if (column < 0 || row < 0 || column >= kLetterColumns || row >= kLetterRows) return 0;
  return letter.rows[static_cast<std::size_t>(row)][column] == '#' ? 1 : 0;
}

int World(const Eigen::Vector3d& ray) {
  for (const Letter& letter : Letters()) {
    const double depth = ray.dot(letter.towards);
    if (depth < 0.8 * ray.norm()) continue;
    return InkAt(letter, ray.dot(letter.right) / depth, ray.dot(letter.up) / depth);
  }
  return 0;
}

// What the panorama shows in a direction: the pixel of `assumed`'s sensors that looks there, filled
// by what `truth`'s sensor sees through that very pixel. -1 = no sensor looks there.
using Panorama = std::function<int(double column_share, double row_share)>;

Panorama Stitch(const Rig& truth, const Rig& assumed, bool mirrored_pictures = false) {
  return [&truth, &assumed, mirrored_pictures](double x, double y) {
    // The contract's equirectangular picture: centre forward, right is -Y, top is up.
    const double azimuth = kPi - 2.0 * kPi * x;
    const double elevation = 0.5 * kPi - kPi * y;
    const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth),
                              std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
    for (std::size_t i = 0; i < assumed.sensors.size(); ++i) {
      auto pixel =
          SensorPixelFromRay(assumed.sensors[i], ray, std::numeric_limits<double>::infinity());
      if (!pixel) continue;
      const RigSensor& sensor = truth.sensors[i];
      if (mirrored_pictures) pixel->x() = sensor.lens.width() - pixel->x();
      const auto seen = sensor.lens.RayFromPixel(pixel->x(), pixel->y());
      if (!seen) continue;
      return World(sensor.camera_from_sensor.rotation * *seen);
    }
    return -1;
  };
}

// Cells of a letter that read as they should, of all; reads where the letter must stand in the
// panorama, by the picture's own directions.
double Legible(const Panorama& panorama, const Letter& letter) {
  int right = 0;
  for (int row = 0; row < kLetterRows; ++row) {
    for (int column = 0; column < kLetterColumns; ++column) {
      const double across = (column + 0.5 - 0.5 * kLetterColumns) * std::tan(kCell);
      const double down = (row + 0.5 - 0.5 * kLetterRows) * std::tan(kCell);
      const Eigen::Vector3d d = letter.towards + across * letter.right - down * letter.up;
      const double x = 0.5 - std::atan2(d.y(), d.x()) / (2.0 * kPi);
      const double y = std::acos(d.z() / d.norm()) / kPi;
      const int ink = letter.rows[static_cast<std::size_t>(row)][column] == '#' ? 1 : 0;
      right += panorama(x, y) == ink ? 1 : 0;
    }
  }
  return static_cast<double>(right) / (kLetterRows * kLetterColumns);
}

Rig RigOf(const char* name) {
  const Result<Rig> rig =
      ReadRig(std::filesystem::path(OMNIHDR_SOURCE_DIR) / "config" / "rigs" / name);
  EXPECT_TRUE(rig) << rig.error().message;
  return rig ? *rig : Rig{};
}

class RigOrientation : public ::testing::TestWithParam<const char*> {};

TEST_P(RigOrientation, LettersAllAroundReadAsTheyShould) {
  const Rig rig = RigOf(GetParam());
  for (const Letter& letter : Letters()) {
    EXPECT_EQ(Legible(Stitch(rig, rig), letter), 1.0) << letter.name;
  }
}

// By hand, without any rig: the forward letter's stem is left of the centre, its top bar above.
TEST_P(RigOrientation, TheForwardLetterStandsInTheMiddleUprightAndNotMirrored) {
  const Rig rig = RigOf(GetParam());
  const Panorama panorama = Stitch(rig, rig);
  const double cell_x = 3.0 / 360.0;
  const double cell_y = 3.0 / 180.0;
  EXPECT_EQ(panorama(0.5 - 2.0 * cell_x, 0.5 + 2.0 * cell_y), 1);  // stem, below the middle
  EXPECT_EQ(panorama(0.5 + 2.0 * cell_x, 0.5 + 2.0 * cell_y), 0);
  EXPECT_EQ(panorama(0.5 + 2.0 * cell_x, 0.5 - 3.0 * cell_y), 1);  // end of the top bar
  EXPECT_EQ(panorama(0.5 + 2.0 * cell_x, 0.5 + 3.0 * cell_y), 0);
}

TEST_P(RigOrientation, AMirroredOrTurnedTwinFails) {
  const Rig truth = RigOf(GetParam());
  const auto worst = [&](const Rig& twin, bool mirrored) {
    double least = 1.0;
    for (const Letter& letter : Letters()) {
      least = std::min(least, Legible(Stitch(truth, twin, mirrored), letter));
    }
    return least;
  };
  EXPECT_LT(worst(truth, true), 0.9) << "mirrored pictures";
  Rig twin = truth;
  for (RigSensor& sensor : twin.sensors) {
    sensor.camera_from_sensor.rotation *= Eigen::Quaterniond(0, 0, 0, 1);
  }
  EXPECT_LT(worst(twin, false), 0.9) << "pictures upside down";
  twin = truth;
  for (RigSensor& sensor : twin.sensors) {
    sensor.camera_from_sensor.rotation *=
        Eigen::Quaterniond(Eigen::AngleAxisd(0.5 * kPi, Eigen::Vector3d::UnitZ()));
  }
  EXPECT_LT(worst(twin, false), 0.9) << "pictures on their side";
  twin = truth;
  for (RigSensor& sensor : twin.sensors) {
    // Left for right: the mirrored axis, the picture turned along with it.
    Eigen::Quaterniond& q = sensor.camera_from_sensor.rotation;
    const Eigen::Vector3d axis = q * Eigen::Vector3d::UnitZ();
    const double azimuth = std::atan2(axis.y(), axis.x());
    q = Eigen::Quaterniond(Eigen::AngleAxisd(-2.0 * azimuth, Eigen::Vector3d::UnitZ())) * q;
  }
  EXPECT_LT(worst(twin, false), 0.9) << "sensors in the other sense of rotation";
  twin = truth;
  for (RigSensor& sensor : twin.sensors) {
    sensor.camera_from_sensor.rotation = sensor.camera_from_sensor.rotation.conjugate();
  }
  EXPECT_LT(worst(twin, false), 0.9) << "inverse rotations";
}

INSTANTIATE_TEST_SUITE_P(Rigs, RigOrientation,
                         ::testing::Values("ladybug2.toml", "ladybug5plus.toml", "vuze.toml"),
                         [](const auto& rig) {
                           return std::string(rig.param).substr(0,
                                                                std::string(rig.param).find('.'));
                         });

}  // namespace
}  // namespace omnihdr::rig_orientation_test
