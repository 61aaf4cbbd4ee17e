#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/photometry/exposure_report.h"
#include "daemon/cli/command.h"
#include "tests/support/rig_session.h"
#include "tests/support/ring.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::report_test {
namespace {

class Report : public ::testing::Test {
 protected:
  // What it prints; the message when it fails.
  std::string Run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "report");
    std::string printed;
    const Result<int> result =
        testing::RunCommand({AddReportCommand}, std::move(arguments), &printed);
    return result ? printed : result.error().message;
  }
  std::string Session() const { return directory_.path().string(); }
  testing::TemporaryDirectory directory_;
};

testing::Room Hall() {
  testing::Room room;
  room.detail_m = 1.2;
  return room;
}

// Light from 0.1 % to 99.9 % of what a head in the middle of the room sees: not the floor below it.
double StopsOf(const testing::Room& room) {
  const testing::Truth truth = testing::Render(room, Projection::Equirectangular(256, 128), Pose{});
  Image<std::uint8_t> seen(256, 128);
  for (int y = 0; y < 96; ++y) {
    for (int x = 0; x < 256; ++x) seen.at(x, y) = 1;
  }
  return RangeOfRadiance(truth.radiance, seen).Stops();
}

// The sensors of this rig differ by a third in gain, darken towards their corners and have a Bayer
// pattern: counts taken for radiance would show more stops than the room has.
TEST_F(Report, RadianceOfARigIsThatOfItsStitchedPanorama) {
  testing::WriteRigSession(directory_.path(), testing::MakeRing({.sphere_radius_m = 4.0}), Hall(),
                           {Pose{}}, {0.05, 0.5, 5.0}, 3);
  const nlohmann::json report = nlohmann::json::parse(Run({Session(), "--json"}));
  ASSERT_EQ(report.size(), 1U);
  EXPECT_NEAR(report[0]["radiance"]["stops"], StopsOf(Hall()), 0.3);
  ASSERT_EQ(report[0]["exposures"].size(), 3U);
  // Counted at the mosaic: every value of the six sensors.
  EXPECT_EQ(report[0]["exposures"][0]["pixels"], 6 * 128 * 96);
  EXPECT_LT(report[0]["exposures"][0]["over_percent"], report[0]["exposures"][2]["over_percent"]);
  EXPECT_GT(report[0]["exposures"][0]["under_percent"], report[0]["exposures"][2]["under_percent"]);
}

TEST_F(Report, ADriveOfARigHasALineAPosition) {
  const std::vector<Pose> poses = {Pose{}, {Eigen::Quaterniond::Identity(), {0.2, 0.0, 0.0}}};
  testing::WriteRigSession(directory_.path(), testing::MakeRing({.sphere_radius_m = 4.0}), Hall(),
                           poses, {0.3, 1.8}, 1);
  const nlohmann::json report = nlohmann::json::parse(Run({Session(), "--json"}));
  ASSERT_EQ(report.size(), 1U);
  ASSERT_EQ(report[0]["exposures"].size(), 2U);
  for (const nlohmann::json& line : report[0]["exposures"]) {
    EXPECT_GT(line["radiance"]["stops"], 1.0);
    EXPECT_LT(line["radiance"]["stops"], StopsOf(Hall()) + 0.3);
  }
}

TEST_F(Report, AMaskOfNeitherTheFramesNorThePanoramasShapeIsRefused) {
  testing::WriteRigSession(directory_.path(), testing::MakeRing({.sphere_radius_m = 4.0}), Hall(),
                           {Pose{}}, {0.3}, 1);
  const std::string mask = (directory_.path() / "mask.png").string();
  ASSERT_TRUE(WriteFileAtomic(mask, *EncodePng(Image<std::uint8_t>(10, 10, 1, 255).view())));
  EXPECT_NE(
      Run({Session(), "--mask", mask}).find("10x10 pixels, expected the stacked frames' size"),
      std::string::npos);
}

}  // namespace
}  // namespace omnihdr::report_test
