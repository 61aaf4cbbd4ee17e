#include "core/session/rig_import.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "core/sphere/rig_report.h"

namespace omnihdr::rig_import_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::StartsWith;

const fs::path kCorpus = fs::path(OMNIHDR_SOURCE_DIR) / "tests" / "fuzz" / "corpus" / "rig_import";
const fs::path kData = fs::path(OMNIHDR_SOURCE_DIR) / ".." / "shared" / "data";

std::string Slurp(const fs::path& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

// A seed of the fuzzer, less its first byte, which chooses the kind.
std::string Sample(const char* name) { return Slurp(kCorpus / name).substr(1); }

std::vector<RigText> CsvSample() {
  const std::string both = Sample("csv");
  const std::size_t at = both.find("\n====\n");
  return {{"iop.csv", both.substr(0, at + 1)}, {"eop.csv", both.substr(at + 6)}};
}

std::string Replaced(std::string text, std::string_view from, std::string_view to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

std::string MessageOf(const std::vector<RigText>& files, const RigImportOptions& options = {}) {
  const Result<Rig> rig = ImportRig(files, options);
  EXPECT_FALSE(rig);
  return rig ? std::string() : rig.error().message;
}

RigImportOptions WithSize() {
  RigImportOptions options;
  options.width = 2448;
  options.height = 2048;
  return options;
}

TEST(RigImport, TheCsvTablesGiveAPinholeRigWithPixelMiddlesAtAHalf) {
  const Result<Rig> rig = ImportRig(CsvSample(), {});
  ASSERT_TRUE(rig) << rig.error().message;
  ASSERT_EQ(rig->sensors.size(), 6U);
  EXPECT_EQ(rig->sensors[2].name, "2");
  EXPECT_EQ(rig->sensors[2].lens.width(), 4928);
  EXPECT_EQ(rig->sensors[2].lens.height(), 4096);
  EXPECT_EQ(rig->sensors[2].lens.focal(), Eigen::Vector2d(900.5, 900.5));
  EXPECT_EQ(rig->sensors[2].lens.centre(), Eigen::Vector2d(2424.75, 2003.0));
  EXPECT_EQ(rig->sensors[2].camera_from_sensor.translation, Eigen::Vector3d(0.06, 0.0, -0.0002));
  // By hand: Rz·Ry·Rx of the lens's axis.
  const double rx = -2.7;
  const double ry = 1.567;
  const double rz = -1.1;
  const Eigen::Vector3d axis(
      std::cos(rz) * std::sin(ry) * std::cos(rx) + std::sin(rz) * std::sin(rx),
      std::sin(rz) * std::sin(ry) * std::cos(rx) - std::cos(rz) * std::sin(rx),
      std::cos(ry) * std::cos(rx));
  EXPECT_LT((rig->sensors[2].camera_from_sensor.rotation * Eigen::Vector3d::UnitZ() - axis).norm(),
            1e-12);
  std::vector<RigText> other_order = CsvSample();
  std::swap(other_order[0], other_order[1]);
  EXPECT_TRUE(ImportRig(other_order, {}));
}

TEST(RigImport, WhatIsWrongInATableIsNamedWithItsLine) {
  const std::vector<RigText> good = CsvSample();
  const auto with = [&](int file, std::string_view from, std::string_view to) {
    std::vector<RigText> files = good;
    std::string& text = files[static_cast<std::size_t>(file)].text;
    text = Replaced(text, from, to);
    return MessageOf(files);
  };
  EXPECT_THAT(with(0, "\n3\t", "\n2\t"), StartsWith("iop.csv:5: Cam_id: 2 twice"));
  EXPECT_THAT(with(0, "\n3\t", "\n6\t"), StartsWith("iop.csv:5: Cam_id: 6, expected 0 to 5"));
  EXPECT_THAT(with(0, "\n3\t900.5", "\n3\tnan"),
              StartsWith("iop.csv:5: column 2: nan, expected a"));
  EXPECT_THAT(with(0, "\n3\t900.5", "\n3\t-1"), StartsWith("iop.csv: sensor 3: focal [-1, -1]"));
  EXPECT_THAT(with(1, "\n3\t-2.7", "\n3"), StartsWith("eop.csv:5: 6 columns, expected 7"));
  EXPECT_THAT(MessageOf({good[0]}), HasSubstr("expected two files"));
  EXPECT_THAT(MessageOf({good[0], good[0]}), HasSubstr("expected two files"));
  EXPECT_THAT(MessageOf({good[0], {"x.csv", "Cam_id\tA\n"}}), StartsWith("x.csv:1: Cam_id?A"));
}

TEST(RigImport, TheCalibrationTextGivesTheSameAsTheTables) {
  const Result<Rig> rig = ImportRig({{"head.txt", Sample("text")}}, WithSize());
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_EQ(rig->model, "Six");
  EXPECT_EQ(rig->serial, "123");
  EXPECT_EQ(rig->sensors[1].lens.centre(), Eigen::Vector2d(1235.3, 1016.7));
  EXPECT_EQ(rig->sensors[1].lens.width(), 2448);
  EXPECT_EQ(rig->sensors[1].camera_from_sensor.translation, Eigen::Vector3d(0.06, 0.0, 0.0));
  const std::string text = Sample("text");
  const auto with = [&](std::string_view from, std::string_view to) {
    return MessageOf({{"head.txt", Replaced(text, from, to)}}, WithSize());
  };
  EXPECT_THAT(with("camera3_rotY=1.56", "camera3_rotY=x"),
              HasSubstr("camera3_rotY: x, expected a"));
  EXPECT_THAT(with("camera3_rotY=1.56\n", ""), HasSubstr("camera3_rotY: missing"));
  EXPECT_THAT(with("camera3_rotY", "camera2_rotY"), HasSubstr("camera2_rotY: twice"));
  EXPECT_THAT(with("camera3_rotY", "camera6_rotY"), HasSubstr("camera6_rotY: not a key"));
  EXPECT_THAT(with("camera3_rotY=1.56", "grid"), HasSubstr("grid, expected key=value"));
  EXPECT_THAT(MessageOf({{"head.txt", text}}), HasSubstr("does not tell the size"));
}

TEST(RigImport, OtherFactoryTextsAreRefusedWithWhatIsKnown) {
  EXPECT_THAT(MessageOf({{"head.cal", "LADYBUG CALIBRATION\n1 2 3\n"}}),
              StartsWith("head.cal: not a calibration that can be imported, expected the two CSV"));
  EXPECT_THAT(MessageOf({{"big", std::string((1 << 20) + 1, 'x')}}), HasSubstr("expected at most"));
  EXPECT_FALSE(ImportRig({}, {}));
}

TEST(RigImport, AVuzeLensTakesItsDirectionFromItsRotation) {
  const Result<Rig> rig = ImportRig({{"v.yml", Sample("vuze")}}, {});
  ASSERT_TRUE(rig) << rig.error().message;
  ASSERT_EQ(rig->sensors.size(), 2U);
  const RigSensor& front = rig->sensors[0];
  EXPECT_EQ(front.name, "1");
  EXPECT_EQ(front.lens.width(), 1600);
  EXPECT_EQ(front.lens.height(), 1088);
  EXPECT_EQ(front.lens.centre(), Eigen::Vector2d(800.5, 1088.0 - 550.5));
  EXPECT_EQ(front.lens.distortion(), (std::array{-0.05, 0.0, 0.0, 0.0, 0.0}));
  EXPECT_LT(
      (front.camera_from_sensor.rotation * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitX())
          .norm(),
      1e-12);
  // The sky is to the right of a stored picture.
  EXPECT_LT(
      (front.camera_from_sensor.rotation * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitZ())
          .norm(),
      1e-12);
  // Millimetres of (left, up, forward).
  EXPECT_LT(
      (front.camera_from_sensor.translation - Eigen::Vector3d(0.056, 0.0295, -0.00025)).norm(),
      1e-12);
  EXPECT_LT((rig->sensors[1].camera_from_sensor.rotation * Eigen::Vector3d::UnitZ() +
             Eigen::Vector3d::UnitY())
                .norm(),
            1e-9);
}

TEST(RigImport, AVuzeFileThatIsNotOfTheKnownModelIsRefused) {
  const std::string text = Sample("vuze");
  const auto with = [&](std::string_view from, std::string_view to) {
    return MessageOf({{"v.yml", Replaced(text, from, to)}});
  };
  EXPECT_THAT(with("VERSION: 3", "VERSION: 4"),
              StartsWith("v.yml:5: CamModel_V2_Set.CAM_0.VERSION: 4, expected 3"));
  EXPECT_THAT(with("DistortionCoeffs_0: 1.", "DistortionCoeffs_0: 2."), HasSubstr("2, expected 1"));
  EXPECT_THAT(with("DistortionCoeffs_3: 0.", "DistortionCoeffs_3: 0.1"),
              HasSubstr("0.1, expected 0"));
  EXPECT_THAT(with("DistortionCoeffs_2: -0.05", "DistortionCoeffs_2: -0.06"),
              HasSubstr("ImageCircleRadius: "));
  EXPECT_THAT(with("[ 1.000000000000000,", "[ 0.5,"), HasSubstr("R.data: expected a rotation"));
  EXPECT_THAT(with("540., 0., 550.", "540., 1., 550."), HasSubstr("K.data: expected [f, 0, cx"));
  EXPECT_THAT(with("StraightSrcImageSize: [ 1088, 1600 ]", "StraightSrcImageSize: [ 1088 ]"),
              HasSubstr("1 numbers, expected 2"));
  EXPECT_THAT(with("CamCenter", "Centre"), HasSubstr("CamCenter.data: missing"));
  EXPECT_THAT(with("[ 29.5,", "[ 29.5x,"), HasSubstr("29.5x, expected numbers"));
  EXPECT_THAT(MessageOf({{"v.yml", "CamModel_V2_Set:\n"}}), HasSubstr("CAM_0: missing"));
  EXPECT_THAT(MessageOf({{"v.yml", "CamModel_V2_Set:\n   K: [ 1,\n"}}),
              HasSubstr("without an end"));
}

// The published numbers of a real head: the ring must come out at steps of 72 degrees.
TEST(RigImport, TheRealSixSensorHeadLooksForwardAroundAndUp) {
  const fs::path folder = kData / "ladybug5plus";
  if (!fs::exists(folder)) GTEST_SKIP() << "SKIPPED: no head's tables at " << folder;
  const Result<Rig> rig = ImportRig({{"iop", Slurp(folder / "IOP_Ladybug5_plus.csv")},
                                     {"eop", Slurp(folder / "Ladybug5_plus_EOP.csv")}},
                                    {});
  ASSERT_TRUE(rig) << rig.error().message;
  const RigReport report = ExamineRig(*rig);
  EXPECT_TRUE(report.warnings.empty());
  for (int i = 0; i < 5; ++i) {
    const SensorOptics& sensor = report.sensors[static_cast<std::size_t>(i)];
    const double off = std::remainder(sensor.azimuth_deg + 72.0 * i, 360.0);
    EXPECT_LT(std::abs(off), 1.0) << i;  // the head's own tolerance
    EXPECT_LT(std::abs(sensor.elevation_deg), 0.5) << i;
    EXPECT_NEAR(sensor.roll_deg, 90.0, 0.5) << i;
    EXPECT_NEAR(sensor.outward_m, 0.0607, 0.001) << i;
  }
  EXPECT_GT(report.sensors[5].elevation_deg, 89.5);
  EXPECT_EQ(report.directions[0], 0);
  EXPECT_EQ(report.directions[4], 5);
}

}  // namespace
}  // namespace omnihdr::rig_import_test
