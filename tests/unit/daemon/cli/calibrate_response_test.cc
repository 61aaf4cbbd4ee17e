// calibrate response into a rig's sensor, called as from the command line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/journal.h"
#include "core/session/response_json.h"
#include "core/session/rig_file.h"
#include "daemon/cli/calibrate_command.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::calibrate_response_test {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr int kWidth = 160;
constexpr int kHeight = 120;
const std::array<double, 4> kSeconds = {0.125, 0.25, 0.5, 1.0};
// Two sensors that differ in nothing but their black level.
const std::array<double, 2> kBlack = {3.0, 14.0};

class CalibrateResponseCommand : public ::testing::Test {
 protected:
  std::string Path(const std::string& name) const { return (directory_.path() / name).string(); }

  std::string RigText() const { return ReadTextFile(Path("rig.toml")).value(); }

  // A rig file with its owner's remarks.
  void WriteRig(BayerOrder bayer, const std::string& mask = "") const {
    std::string text = "# The head of May.\nformat = \"omnihdr-rig\"\nversion = 1\n";
    for (const char* name : {"left", "right"}) {
      text += fmt::format(
          "\n[[sensor]]  # {0}\nname = \"{0}\"\nsize = [{1}, {2}]\nbayer = \"{3}\"\n"
          "lens = \"pinhole\"\nfocal = [120, 120]\ncentre = [80, 60]  # by eye\n"
          "distortion = [0, 0, 0, 0, 0]\nfov_deg = 60\nrotation = [1, 0, 0, 0]\n"
          "translation = [0, 0, 0]\n{4}",
          name, kWidth, kHeight, ToString(bayer), mask);
    }
    ASSERT_TRUE(WriteFileAtomic(Path("rig.toml"), text));
  }

  double white_ = 255.0;  // value that the sensors clip at

  // What a sensor sees in `seconds`: patches of light over two decades, coloured.
  void Shoot(std::size_t sensor, double seconds, BayerOrder bayer, Image<std::uint8_t>* frame,
             int first_row) const {
    const Response response = Response::Linear(kBlack[sensor]).value();
    std::mt19937 random(static_cast<std::uint32_t>(seconds * 1000.0) + 17);
    std::normal_distribution<double> noise(0.0, 0.4);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const int patch = (x / 16) * 7 + (y / 12) * 11;
        for (int c = 0; c < frame->channels(); ++c) {
          const int colour = bayer == BayerOrder::kNone ? c : BayerChannel(bayer, x, y);
          const double light = 0.04 * std::pow(10.0, 0.02 * (patch % 100)) *
                               std::array{0.7, 1.0, 0.5}[static_cast<std::size_t>(colour)];
          const double z = response.ValueFromExposure(colour, light * seconds) + noise(random);
          frame->at(x, first_row + y, c) =
              static_cast<std::uint8_t>(std::clamp(std::round(z), 0.0, white_));
        }
      }
    }
  }

  // Frames of one sensor, or of both stacked, as the command takes them.
  std::vector<std::string> Bracket(std::vector<std::size_t> sensors, BayerOrder bayer,
                                   int channels) const {
    std::vector<std::string> words = {"response"};
    for (std::size_t k = 0; k < kSeconds.size(); ++k) {
      Image<std::uint8_t> frame(kWidth, kHeight * static_cast<int>(sensors.size()), channels);
      int row = 0;
      for (const std::size_t sensor : sensors) {
        Shoot(sensor, kSeconds[k], bayer, &frame, row);
        row += kHeight;
      }
      const std::string file = Path(fmt::format("frame{}.png", k));
      EXPECT_TRUE(WriteFileAtomic(file, EncodePng(frame.view()).value()));
      words.push_back(fmt::format("{}@{}", file, kSeconds[k]));
    }
    return words;
  }

  Result<int> Run(std::vector<std::string> words, const std::vector<std::string>& more) {
    words.insert(words.end(), more.begin(), more.end());
    return testing::RunCommand({AddCalibrateResponse}, std::move(words), &printed_);
  }

  // The black level that the rig file tells of a sensor; negative without a response.
  double BlackInRig(std::size_t sensor) const {
    const Result<Rig> rig = ReadRig(Path("rig.toml"));
    EXPECT_TRUE(rig) << rig.error().message;
    if (!rig || rig->sensors[sensor].response_json.empty()) return -1.0;
    return ParseResponse(rig->sensors[sensor].response_json, "rig")->black();
  }

  testing::TemporaryDirectory directory_;
  std::string printed_;
};

TEST_F(CalibrateResponseCommand, TheNamedSensorOfTheRigGetsItAndNothingElseChanges) {
  WriteRig(BayerOrder::kNone);
  const std::string before = RigText();
  const Result<int> result =
      Run(Bracket({1}, BayerOrder::kNone, 3),
          {"--method", "linear", "--rig", Path("rig.toml"), "--sensor", "right"});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_THAT(printed_, HasSubstr("rig.toml: response of sensor right set"));
  EXPECT_NEAR(BlackInRig(1), kBlack[1], 0.5);
  EXPECT_LT(BlackInRig(0), 0.0);
  // One line more, the last.
  const std::string after = RigText();
  EXPECT_THAT(after, StartsWith(before + "response = \"{\\\"model\\\": \\\"linear\\\""));
  EXPECT_EQ(std::count(after.begin(), after.end(), '\n'),
            std::count(before.begin(), before.end(), '\n') + 1);
}

TEST_F(CalibrateResponseCommand, OfStackedMosaicsTheSensorsOwnRowsCount) {
  WriteRig(BayerOrder::kGrbg);
  const std::vector<std::string> words = Bracket({0, 1}, BayerOrder::kGrbg, 1);
  for (const char* sensor : {"0", "1"}) {
    const Result<int> result =
        Run(words, {"--method", "linear", "--rig", Path("rig.toml"), "--sensor", sensor});
    ASSERT_TRUE(result) << result.error().message;
  }
  EXPECT_NEAR(BlackInRig(0), kBlack[0], 0.5);
  EXPECT_NEAR(BlackInRig(1), kBlack[1], 0.5);
  EXPECT_THAT(RigText(), StartsWith("# The head of May.\n"));
  EXPECT_THAT(RigText(), HasSubstr("centre = [80, 60]  # by eye\n"));
}

TEST_F(CalibrateResponseCommand, AWhiteLevelBelowTheLargestValueIsMeasuredAndKeptOutOfTheCurve) {
  white_ = 160.0;  // reached in two of the exposures
  WriteRig(BayerOrder::kNone);
  const Result<int> result =
      Run(Bracket({1}, BayerOrder::kNone, 3),
          {"--method", "linear", "--rig", Path("rig.toml"), "--sensor", "right"});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_THAT(printed_, HasSubstr("clips at value 1"));
  EXPECT_NEAR(BlackInRig(1), kBlack[1], 0.5);
  const Rig rig = ReadRig(Path("rig.toml")).value();
  // A surface that is nearly as bright may lower it a little: on the safe side.
  EXPECT_NEAR(ParseResponse(rig.sensors[1].response_json, "rig")->white(), 159.0, 1.5);
}

TEST_F(CalibrateResponseCommand, TheRigsOwnMaskHides) {
  WriteRig(BayerOrder::kNone, "mask = \"mask.png\"\n");
  Image<std::uint8_t> mask(kWidth, kHeight, 1, 0);
  ASSERT_TRUE(WriteFileAtomic(Path("mask.png"), EncodePng(mask.view()).value()));
  const std::vector<std::string> words = Bracket({1}, BayerOrder::kNone, 3);
  const Result<int> hidden = Run(words, {"--rig", Path("rig.toml"), "--sensor", "right"});
  ASSERT_FALSE(hidden);
  EXPECT_THAT(hidden.error().message, HasSubstr("mask"));
  for (int y = 0; y < kHeight; ++y) std::fill_n(mask.row(y), kWidth / 2, std::uint8_t{255});
  ASSERT_TRUE(WriteFileAtomic(Path("mask.png"), EncodePng(mask.view()).value()));
  const Result<int> half = Run(words, {"--rig", Path("rig.toml"), "--sensor", "right"});
  EXPECT_TRUE(half) << half.error().message;
}

TEST_F(CalibrateResponseCommand, ASessionOfTheRigBringsIt) {
  WriteRig(BayerOrder::kRggb);
  SessionInfo info;
  info.created = "2026-01-01T00:00:00Z";
  info.camera.layout = Layout::kRig;
  info.camera.width = kWidth;
  info.camera.height = 2 * kHeight;
  info.camera.bayer = "RGGB";
  info.files = {{"rig.toml", RigText()}};
  const std::filesystem::path session = directory_.path() / "session";
  SessionWriter writer = SessionWriter::Create(session, info).value();
  for (std::size_t k = 0; k < kSeconds.size(); ++k) {
    Image<std::uint8_t> frame(kWidth, 2 * kHeight);
    Shoot(0, kSeconds[k], BayerOrder::kRggb, &frame, 0);
    Shoot(1, kSeconds[k], BayerOrder::kRggb, &frame, kHeight);
    FrameRecord record;
    record.frame = FrameId{k};
    record.position = PositionId{0};
    record.file = fmt::format("raw/{}.png", k);
    record.exposure.time = ExposureTime::Seconds(kSeconds[k]);
    ASSERT_TRUE(writer.Append(record, EncodePng(frame.view()).value()));
  }
  const Result<int> result =
      Run({"response", session.string()}, {"--method", "linear", "--sensor", "left"});
  ASSERT_TRUE(result) << result.error().message;
  const Result<Rig> rig = ReadRig(session / "rig.toml");
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_NEAR(ParseResponse(rig->sensors[0].response_json, "rig")->black(), kBlack[0], 0.5);
  EXPECT_EQ(rig->sensors[1].response_json, "");
  EXPECT_LT(BlackInRig(0), 0.0);  // not the file that it was copied from
}

TEST_F(CalibrateResponseCommand, WhatIsWrongIsNamedAndTheRigIsLeftAlone) {
  WriteRig(BayerOrder::kNone);
  const std::string before = RigText();
  const std::vector<std::string> good = Bracket({1}, BayerOrder::kNone, 3);
  const std::string rig = Path("rig.toml");
  const auto refused = [&](const std::vector<std::string>& words,
                           const std::vector<std::string>& more, ErrorKind kind,
                           const std::string& text) {
    const Result<int> result = Run(words, more);
    ASSERT_FALSE(result) << text;
    EXPECT_EQ(result.error().kind, kind) << result.error().message;
    EXPECT_THAT(result.error().message, HasSubstr(text));
    EXPECT_EQ(RigText(), before);
  };
  refused(good, {"--rig", rig}, ErrorKind::kUsage, "--sensor is missing");
  refused(good, {"--rig", rig, "--sensor", "up"}, ErrorKind::kUsage, "has left, right (0 to 1)");
  refused(good, {"--rig", rig, "--sensor", "2"}, ErrorKind::kUsage, "--sensor 2");
  refused(good, {"--rig", rig, "--sensor", "-1"}, ErrorKind::kUsage, "--sensor -1");
  refused(good, {"--sensor", "left"}, ErrorKind::kUsage, "Name it with --rig");
  refused(good, {"--rig", Path("no.toml"), "--sensor", "left"}, ErrorKind::kNoInput, "no.toml");
  // Not the rig's pictures.
  std::vector<std::string> small = {"response"};
  Image<std::uint8_t> other(64, 64, 3);
  ASSERT_TRUE(WriteFileAtomic(Path("small.png"), EncodePng(other.view()).value()));
  small.push_back(Path("small.png") + "@1");
  small.push_back(Path("small.png") + "@2");
  refused(small, {"--rig", rig, "--sensor", "left"}, ErrorKind::kData,
          "64x64, expected 160x120 as sensor left");
  // Equal exposures: what calibration itself refuses.
  std::vector<std::string> equal = good;
  for (std::size_t k = 1; k < equal.size(); ++k) {
    equal[k] = equal[k].substr(0, equal[k].rfind('@')) + "@0.5";
  }
  refused(equal, {"--rig", rig, "--sensor", "left"}, ErrorKind::kData, "expos");
}

}  // namespace
}  // namespace omnihdr::calibrate_response_test
