#include "core/session/rig_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>

#include "core/session/response_json.h"

namespace omnihdr::rig_file_test {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr double kDegree = std::numbers::pi / 180.0;

constexpr std::string_view kSmall = R"(format = "omnihdr-rig"
version = 1
model = "small"
sphere_radius_m = 5.0

[[sensor]]
name = "0"
size = [1024, 768]
lens = "pinhole"
focal = [400.0, 410.0]
centre = [505.0, 390.0]
distortion = [-0.28, 0.09, 0.0012, -0.0008, -0.012]
fov_deg = 110.0
rotation = [0.5, -0.5, 0.5, -0.5]
translation = [0.04, 0.0, 0.0]
bayer = "BGGR"
gain = [1.5, 1.0, 1.25]
vignetting = [-0.2, 0.05, -0.01]
mask = "masks/0.png"
response = '{"model": "linear", "black": 4}'

[[sensor]]
name = "up"
size = [1600, 1088]
lens = "fisheye"
focal = [547.0, 547.0]
centre = [800.0, 544.0]
distortion = [-0.05, 0, 0, 0, 0]
fov_deg = 180
rotation = [1, 0, 0, 0]
translation = [0, 0, 0.06]
)";

std::string Replaced(std::string_view from, std::string_view to) {
  std::string text(kSmall);
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

std::string MessageOf(const std::string& text) {
  const Result<Rig> rig = ParseRig(text, "rig.toml");
  EXPECT_FALSE(rig) << text;
  if (rig) return {};
  EXPECT_EQ(rig.error().kind, ErrorKind::kData);
  return rig.error().message;
}

void ExpectSame(const Rig& a, const Rig& b) {
  EXPECT_EQ(a.model, b.model);
  EXPECT_EQ(a.serial, b.serial);
  EXPECT_EQ(a.sphere_radius_m, b.sphere_radius_m);
  EXPECT_EQ(a.blend_width_deg, b.blend_width_deg);
  ASSERT_EQ(a.sensors.size(), b.sensors.size());
  for (std::size_t i = 0; i < a.sensors.size(); ++i) {
    const RigSensor& x = a.sensors[i];
    const RigSensor& y = b.sensors[i];
    EXPECT_EQ(x.name, y.name);
    EXPECT_EQ(x.bayer, y.bayer);
    EXPECT_EQ(x.gain, y.gain);
    EXPECT_EQ(x.vignetting.coefficients, y.vignetting.coefficients);
    EXPECT_EQ(x.mask_file, y.mask_file);
    EXPECT_EQ(x.response_json, y.response_json);
    EXPECT_EQ(x.camera_from_sensor.rotation.coeffs(), y.camera_from_sensor.rotation.coeffs());
    EXPECT_EQ(x.camera_from_sensor.translation, y.camera_from_sensor.translation);
    EXPECT_EQ(x.lens.kind(), y.lens.kind());
    EXPECT_EQ(x.lens.width(), y.lens.width());
    EXPECT_EQ(x.lens.height(), y.lens.height());
    EXPECT_EQ(x.lens.focal(), y.lens.focal());
    EXPECT_EQ(x.lens.centre(), y.lens.centre());
    EXPECT_EQ(x.lens.distortion(), y.lens.distortion());
    EXPECT_NEAR(x.lens.max_angle(), y.lens.max_angle(), 1e-15);
    ASSERT_EQ(x.lens.raw_from_rectified() == nullptr, y.lens.raw_from_rectified() == nullptr);
    if (x.lens.raw_from_rectified() == nullptr) continue;
    for (const auto& [p, q] :
         {std::pair{x.lens.raw_from_rectified(), y.lens.raw_from_rectified()},
          std::pair{x.lens.rectified_from_raw(), y.lens.rectified_from_raw()}}) {
      EXPECT_EQ(p->columns, q->columns);
      EXPECT_EQ(p->rows, q->rows);
      EXPECT_EQ(p->step_x, q->step_x);
      EXPECT_EQ(p->step_y, q->step_y);
      ASSERT_EQ(p->points.size(), q->points.size());
      for (std::size_t k = 0; k < p->points.size(); ++k) {
        EXPECT_TRUE(p->points[k] == q->points[k] ||
                    (std::isnan(p->points[k].x()) && std::isnan(q->points[k].x())));
      }
    }
  }
}

// A grid that shifts by a third of a pixel, one corner empty.
Lens ShiftGrid() {
  LensGrid there;
  there.columns = 5;
  there.rows = 4;
  there.step_x = 16.0;
  there.step_y = 12.5;
  LensGrid back = there;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 5; ++j) {
      const Eigen::Vector2f p(16.0F * static_cast<float>(j), 12.5F * static_cast<float>(i));
      there.points.emplace_back(p + Eigen::Vector2f::Constant(1.0F / 3.0F));
      back.points.emplace_back(p - Eigen::Vector2f::Constant(1.0F / 3.0F));
    }
  }
  there.points[0].setConstant(std::nanf(""));
  return *Lens::Grid(64, 38, {40, 41}, {32, 19}, there, back);
}

TEST(RigFile, EveryKeyIsRead) {
  const Result<Rig> rig = ParseRig(kSmall, "rig.toml");
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_EQ(rig->model, "small");
  EXPECT_EQ(rig->sphere_radius_m, 5.0);
  EXPECT_EQ(rig->blend_width_deg, 5.0);  // the default
  ASSERT_EQ(rig->sensors.size(), 2U);
  const RigSensor& a = rig->sensors[0];
  EXPECT_EQ(a.name, "0");
  EXPECT_EQ(a.lens.kind(), LensKind::kPinhole);
  EXPECT_EQ(a.lens.width(), 1024);
  EXPECT_EQ(a.lens.height(), 768);
  EXPECT_EQ(a.lens.focal(), Eigen::Vector2d(400.0, 410.0));
  EXPECT_EQ(a.lens.centre(), Eigen::Vector2d(505.0, 390.0));
  EXPECT_EQ(a.lens.distortion(), (std::array{-0.28, 0.09, 0.0012, -0.0008, -0.012}));
  EXPECT_NEAR(a.lens.max_angle(), 55.0 * kDegree, 1e-15);
  EXPECT_EQ(a.camera_from_sensor.translation, Eigen::Vector3d(0.04, 0.0, 0.0));
  EXPECT_EQ(a.camera_from_sensor.rotation.coeffs(), Eigen::Vector4d(-0.5, 0.5, -0.5, 0.5));
  EXPECT_EQ(a.bayer, BayerOrder::kBggr);
  EXPECT_EQ(a.gain, (std::array{1.5, 1.0, 1.25}));
  EXPECT_EQ(a.vignetting.coefficients, (std::array{-0.2, 0.05, -0.01}));
  EXPECT_EQ(a.mask_file, "masks/0.png");
  EXPECT_EQ(ParseResponse(a.response_json, "r")->black(), 4.0);
  const RigSensor& b = rig->sensors[1];
  EXPECT_EQ(b.lens.kind(), LensKind::kFisheye);
  EXPECT_EQ(b.bayer, BayerOrder::kNone);
  EXPECT_EQ(b.gain, (std::array{1.0, 1.0, 1.0}));
  EXPECT_EQ(b.mask_file, "");
}

TEST(RigFile, WhatIsWrittenReadsBackTheSame) {
  Rig rig = *ParseRig(kSmall, "rig.toml");
  rig.serial = "\"7\"\n\xC3\xA4";
  rig.sphere_radius_m = std::numeric_limits<double>::infinity();
  rig.blend_width_deg = 1.0 / 3.0;
  RigSensor grid = rig.sensors[0];
  grid.name = "grid";
  grid.lens = ShiftGrid();
  rig.sensors.push_back(grid);
  const std::string text = FormatRig(rig, "two\nlines");
  EXPECT_THAT(text, StartsWith("# two\n# lines\nformat = \"omnihdr-rig\"\n"));
  EXPECT_THAT(text, HasSubstr("fov_deg = 110.0\n"));
  const Result<Rig> again = ParseRig(text, "again.toml");
  ASSERT_TRUE(again) << again.error().message << "\n" << text;
  ExpectSame(*again, rig);
  EXPECT_EQ(FormatRig(*again, "two\nlines"), text);
}

TEST(RigFile, EveryErrorNamesTheFileTheLineTheKeyAndWhatWasExpected) {
  const struct {
    const char* from;
    const char* to;
    const char* message;
  } cases[] = {
      {"format = \"omnihdr-rig\"", "format = \"other\"",
       "rig.toml:1: format: \"other\", expected \"omnihdr-rig\""},
      {"version = 1", "version = 2", "rig.toml:2: version: 2, expected 1"},
      {"sphere_radius_m = 5.0", "sphere_radius_m = 0",
       "rig.toml:4: sphere_radius_m: 0, expected metres, at least 0.001; inf = directions alone"},
      {"sphere_radius_m = 5.0", "sphere_radius_m = nan", "rig.toml:4: sphere_radius_m: nan"},
      {"sphere_radius_m = 5.0", "blend = 3", "rig.toml:4: blend: 3, expected one of format"},
      {"name = \"0\"", "name = \"\"", "rig.toml:7: sensor[0].name: \"\", expected a name"},
      {"name = \"up\"", "name = \"0\"",
       "rig.toml:23: sensor[1].name: \"0\", expected another name than before"},
      {"size = [1024, 768]", "size = [1024, 768.5]",
       "rig.toml:8: sensor[0].size: [1024, 768.5], expected [columns, rows], 1 to 65536"},
      {"size = [1024, 768]", "", "rig.toml:6: sensor[0].size: missing, expected [columns, rows]"},
      {"size = [1024, 768]", "size = [1023, 768]",
       "rig.toml:8: sensor[0].size: 1023x768, expected even sides"},
      {"lens = \"pinhole\"", "lens = \"Pinhole\"",
       "rig.toml:9: sensor[0].lens: \"Pinhole\", expected \"pinhole\", \"fisheye\" or \"grid\""},
      {"lens = \"pinhole\"", "lens = \"grid\"",
       "rig.toml:6: sensor[0].raw_from_rectified: missing, expected a table"},
      {"focal = [400.0, 410.0]", "focal = [400.0, -1]",
       "rig.toml:10: sensor[0].focal [400, -1], expected positive pixels"},
      {"focal = [400.0, 410.0]", "focal = 400",
       "rig.toml:10: sensor[0].focal: 400, expected [x, y], positive pixels"},
      {"distortion = [-0.28", "distortion = [-0.9", "rig.toml:12: sensor[0].distortion folds back"},
      {"-0.0008, -0.012]", "-0.0008]", "rig.toml:12: sensor[0].distortion: "},
      {"-0.0008, -0.012]", "nan, -0.012]", "rig.toml:12: sensor[0].distortion: "},
      {"fov_deg = 110.0", "fov_deg = 180", "rig.toml:13: sensor[0].fov_deg: "},
      {"fov_deg = 110.0", "fov_deg = 361",
       "rig.toml:13: sensor[0].fov_deg: 361, expected the full field of view in degrees"},
      {"rotation = [0.5, -0.5, 0.5, -0.5]", "rotation = [0.5, -0.5, 0.5, -0.6]",
       "rig.toml:14: sensor[0].rotation: [0.5, -0.5, 0.5, -0.6], expected [w, x, y, z]"},
      {"translation = [0.04, 0.0, 0.0]", "translation = [0.04, 0.0]",
       "rig.toml:15: sensor[0].translation: [0.04, 0.0], expected [x, y, z] in metres"},
      {"bayer = \"BGGR\"", "bayer = \"bggr\"", "rig.toml:16: sensor[0].bayer: \"bggr\", expected"},
      {"gain = [1.5, 1.0, 1.25]", "gain = [1.5, 0, 1.25]",
       "rig.toml:17: sensor[0].gain: 0, expected 1e-6 to 1e6"},
      {"vignetting = [-0.2, 0.05, -0.01]", "vignetting = [-2, 0.05, -0.01]",
       "rig.toml:18: sensor[0].vignetting: sensitivity"},
      {"mask = \"masks/0.png\"", "mask = \"../0.png\"",
       "rig.toml:19: sensor[0].mask: \"../0.png\", expected a picture's file below"},
      {"mask = \"masks/0.png\"", "mask = \"/0.png\"", "rig.toml:19: sensor[0].mask: \"/0.png\""},
      {"\"black\": 4", "\"black\": 400", "rig.toml:20: sensor[0].response:1: black: 400"},
      {"response = ", "responce = ", "rig.toml:20: sensor[0].responce: "},
      {"[[sensor]]\nname = \"up\"", "[sensor2]\nname = \"up\"", "rig.toml:22: sensor2: a section"},
  };
  for (const auto& c : cases) {
    EXPECT_THAT(MessageOf(Replaced(c.from, c.to)), StartsWith(c.message)) << c.to;
  }
}

TEST(RigFile, WhatIsNoRigAtAllIsRefused) {
  EXPECT_THAT(MessageOf(""), StartsWith("rig.toml:1: format: missing"));
  EXPECT_THAT(MessageOf("= 3"), StartsWith("rig.toml:1: "));
  EXPECT_THAT(MessageOf("format = \"omnihdr-rig\"\nversion = 1\n"),
              StartsWith("rig.toml:1: sensor: missing, expected a table [[sensor]]"));
  EXPECT_THAT(MessageOf("format = \"omnihdr-rig\"\nversion = 1\nsensor = 3\n"),
              StartsWith("rig.toml:3: sensor: 3, expected a table [[sensor]]"));
  std::string many(kSmall.substr(0, kSmall.find("[[sensor]]")));
  for (int i = 0; i < 65; ++i) many += "[[sensor]]\n";
  EXPECT_THAT(MessageOf(many), HasSubstr("65 sensors, expected at most 64"));
  EXPECT_THAT(MessageOf(std::string(kMaxRigBytes + 1, '#')), HasSubstr("expected at most"));
}

TEST(RigFile, AGridsErrorsNameTheNode) {
  Rig rig = *ParseRig(kSmall, "rig.toml");
  rig.sensors.resize(1);
  rig.sensors[0].lens = ShiftGrid();
  const std::string good = FormatRig(rig);
  const auto changed = [&](std::string_view from, std::string_view to) {
    std::string text = good;
    return text.replace(text.find(from), from.size(), to);
  };
  ASSERT_TRUE(ParseRig(good, "rig.toml"));
  EXPECT_THAT(MessageOf(changed("columns = 5", "columns = 6")),
              HasSubstr("points: 40 values, expected 48 numbers or nan: x, y of 6x4 nodes"));
  EXPECT_THAT(MessageOf(changed("columns = 5", "columns = 5000")),
              HasSubstr("columns: 5000, expected 2 to 4096 columns"));
  EXPECT_THAT(MessageOf(changed("nan, nan", "1, true")), HasSubstr("points: node 0: [1, true]"));
  EXPECT_THAT(MessageOf(changed("step = [16.0, 12.5]", "step = [-1, 12.5]")), HasSubstr("step"));
  EXPECT_THAT(MessageOf(changed("nan, nan", "9, 9")), HasSubstr("do not undo each other"));
}

TEST(RigFile, TheRigsThatComeWithTheProgramAreValidAndReadBack) {
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(
           std::filesystem::path(OMNIHDR_SOURCE_DIR) / "config" / "rigs")) {
    ++files;
    const Result<Rig> rig = ReadRig(entry.path());
    ASSERT_TRUE(rig) << rig.error().message;
    const Result<Rig> again = ParseRig(FormatRig(*rig), "again");
    ASSERT_TRUE(again) << again.error().message;
    ExpectSame(*again, *rig);
  }
  EXPECT_GE(files, 3);
}

TEST(RigFile, AMissingFileIsNamed) {
  const Result<Rig> rig = ReadRig("/nowhere/rig.toml");
  ASSERT_FALSE(rig);
  EXPECT_EQ(rig.error().kind, ErrorKind::kNoInput);
  EXPECT_THAT(rig.error().message, StartsWith("/nowhere/rig.toml: "));
}

}  // namespace
}  // namespace omnihdr::rig_file_test
