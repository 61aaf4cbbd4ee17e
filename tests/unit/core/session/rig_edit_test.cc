#include "core/session/rig_edit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/session/response_json.h"
#include "core/session/rig_file.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::rig_edit_test {
namespace {

using ::testing::HasSubstr;

// As somebody keeps it by hand: comments everywhere, a key over several lines, a letter beyond
// ASCII before a value on its line.
constexpr std::string_view kKept = R"(# Head of the car, calibrated in München ~ by hand
format = "omnihdr-rig"
version = 1

[[sensor]]  # front
  name = "ä"
  size = [64, 48]
  lens = "pinhole"
  focal = [40, 40]   # from the sheet
  centre = [32, 24]
  distortion = [0, 0, 0, 0, 0]
  fov_deg = 60
  rotation = [1, 0, 0, 0]
  # gains of 2024-05-01
  "gain" = [ 1.50,   # red
           1,      # green
           1.25,   # blue ]
  ]
  translation = [0, 0, 0] # none

# The other one.
[[sensor]]
name = "up"
size = [64, 48]
lens = "pinhole"
focal = [40, 40]
centre = [32, 24]
distortion = [0, 0, 0, 0, 0]
fov_deg = 60
rotation = [1, 0, 0, 0]
response = '''{"model": "linear",
  "black": 4}'''   # measured
translation = [0, 0, 0]
# end)";

std::string Edited(std::string_view text, const RigEdit& edit) {
  const Result<std::string> edited = EditRig(text, "rig.toml", std::array{edit});
  EXPECT_TRUE(edited) << edited.error().message;
  return edited ? *edited : std::string();
}

std::string Replaced(std::string_view from, std::string_view to, std::string text) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

TEST(RigEdit, OnlyTheNumbersThatDifferChange) {
  const std::string text = Edited(kKept, {"ä", std::array{2.5, 1.0, 1.25}, {}, {}});
  EXPECT_EQ(text, Replaced("1.50,", "2.5,", std::string(kKept)));
}

TEST(RigEdit, WhatIsThereAlreadyLeavesEveryByte) {
  EXPECT_EQ(Edited(kKept, {"ä", std::array{1.5, 1.0, 1.25}, {}, {}}), kKept);
  EXPECT_EQ(Edited(kKept, {"up", {}, {}, {}}), kKept);
}

TEST(RigEdit, AZeroLosesItsSign) {
  const std::string text =
      Replaced("[0, 0, 0] # none", "[0, 0, 0]\n  vignetting = [0.5, -0.0, 0]", std::string(kKept));
  EXPECT_EQ(Edited(text, {"ä", {}, std::array{0.5, 0.0, 0.0}, {}}),
            Replaced("-0.0,", "0.0,", text));
}

TEST(RigEdit, AMissingKeyGetsItsOwnLineBehindTheSensorsOthers) {
  const std::string text = Edited(kKept, {"ä", {}, std::array{-0.2, 0.05, 0.0}, {}});
  EXPECT_EQ(text, Replaced("translation = [0, 0, 0] # none\n",
                           "translation = [0, 0, 0] # none\n  vignetting = [-0.2, 0.05, 0.0]\n",
                           std::string(kKept)));
}

TEST(RigEdit, AResponseOverSeveralLinesIsReplacedAndItsCommentStays) {
  const std::string text = Edited(kKept, {"up", {}, {}, Response::Linear(7.5).value()});
  EXPECT_EQ(text, Replaced("'''{\"model\": \"linear\",\n  \"black\": 4}'''",
                           R"("{\"model\": \"linear\", \"black\": 7.5}")", std::string(kKept)));
}

TEST(RigEdit, ATableOf768NumbersIsReadBackToTheBit) {
  std::array<std::vector<double>, 3> table;
  for (std::size_t c = 0; c < 3; ++c) {
    for (int z = 0; z < 256; ++z) table[c].push_back(std::log(z + 1.0 + 0.1 * c) - 4.8);
  }
  const Response response = Response::Table(table).value();
  const Result<Rig> rig = ParseRig(Edited(kKept, {"ä", {}, {}, response}), "rig.toml");
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_EQ(ParseResponse(rig->sensors[0].response_json, "response")->table(), table);
  EXPECT_THAT(rig->sensors[1].response_json, HasSubstr("\"black\": 4"));
}

TEST(RigEdit, LineEndsOfTheFileAreKept) {
  std::string text(kKept);
  for (std::size_t i = 0; (i = text.find('\n', i)) != std::string::npos; i += 2) {
    text.replace(i, 1, "\r\n");
  }
  const std::string edited = Edited(text, {"ä", {}, std::array{-0.2, 0.0, 0.0}, {}});
  EXPECT_THAT(edited, HasSubstr("# none\r\n  vignetting = [-0.2, 0.0, 0.0]\r\n\r\n"));
  EXPECT_EQ(edited.size(), text.size() + std::string("  vignetting = [-0.2, 0.0, 0.0]\r\n").size());
}

TEST(RigEdit, AFileWithoutALastLineEndAndWithAMarkAtItsStart) {
  std::string text = "\xEF\xBB\xBF" + std::string(kKept.substr(0, kKept.rfind("\n# end")));
  EXPECT_EQ(Edited(text, {"up", std::array{1.0, 1.0, 2.0}, {}, {}}),
            text + "\ngain = [1.0, 1.0, 2.0]");
}

TEST(RigEdit, TablesInBracesAreEditedInPlace) {
  const std::string text =
      "format = \"omnihdr-rig\"\nversion = 1\nsensor = [  # both\n"
      "  {name = \"a\", size = [64, 48], lens = \"pinhole\", focal = [40, 40], centre = [32, 24], "
      "distortion = [0, 0, 0, 0, 0], fov_deg = 60, rotation = [1, 0, 0, 0], "
      "translation = [0, 0, 0] },  # a's\n]\n";
  EXPECT_EQ(Edited(text, {"a", std::array{1.0, 1.0, 2.0}, {}, {}}),
            Replaced("translation = [0, 0, 0] }",
                     "translation = [0, 0, 0], gain = [1.0, 1.0, 2.0] }", text));
}

TEST(RigEdit, ALensGridsKeysAreNotTheSensors) {
  LensGrid grid;
  grid.columns = grid.rows = 2;
  grid.step_x = 63.0;
  grid.step_y = 47.0;
  for (const float y : {0.0F, 47.0F}) {
    for (const float x : {0.0F, 63.0F}) grid.points.emplace_back(x, y);
  }
  Rig rig;
  rig.sensors.resize(2);
  for (std::size_t s = 0; s < 2; ++s) {
    rig.sensors[s].name = std::to_string(s);
    rig.sensors[s].lens = Lens::Grid(64, 48, {40, 40}, {32, 24}, grid, grid).value();
  }
  const std::string text = FormatRig(rig, "a comment");
  const std::string edited = Edited(text, {"0", {}, {}, Response::Linear(3.0).value()});
  rig.sensors[0].response_json = FormatResponse(Response::Linear(3.0).value());
  EXPECT_EQ(edited, FormatRig(rig, "a comment"));
}

TEST(RigEdit, WhatCannotBeDoneIsSaidAndNothingIsWritten) {
  const testing::TemporaryDirectory directory;
  const std::filesystem::path path = directory.path() / "rig.toml";
  ASSERT_TRUE(WriteFileAtomic(path, kKept));
  const auto error_of = [&](const RigEdit& edit) {
    const Status status = EditRigFile(path, std::array{edit});
    EXPECT_FALSE(status);
    EXPECT_EQ(*ReadTextFile(path), kKept);
    return status ? Error{} : status.error();
  };
  const Error unknown = error_of({"down", std::array{1.0, 1.0, 1.0}, {}, {}});
  EXPECT_EQ(unknown.kind, ErrorKind::kUsage);
  EXPECT_THAT(unknown.message, HasSubstr("no sensor \"down\", expected one of ä, up"));
  const Error wrong = error_of({"up", std::array{0.0, 1.0, 1.0}, {}, {}});
  EXPECT_EQ(wrong.kind, ErrorKind::kData);
  EXPECT_THAT(wrong.message, HasSubstr("gain"));
  EXPECT_FALSE(EditRigFile(directory.path() / "none.toml", {}));
  EXPECT_FALSE(EditRig("format = 1", "rig.toml", std::array{RigEdit{"up", {}, {}, {}}}));
}

TEST(RigEdit, AFileGetsAllEditsInOneStep) {
  const testing::TemporaryDirectory directory;
  const std::filesystem::path path = directory.path() / "rig.toml";
  ASSERT_TRUE(WriteFileAtomic(path, kKept));
  const std::array<RigEdit, 2> edits = {
      RigEdit{"up", std::array{1.0, 2.0, 3.0}, std::array{-0.1, 0.0, 0.0}, {}},
      RigEdit{"ä", std::array{4.0, 5.0, 6.0}, {}, {}}};
  ASSERT_TRUE(EditRigFile(path, edits));
  const Result<Rig> rig = ReadRig(path);
  ASSERT_TRUE(rig) << rig.error().message;
  EXPECT_EQ(rig->sensors[1].gain, (std::array{1.0, 2.0, 3.0}));
  EXPECT_EQ(rig->sensors[1].vignetting.coefficients, (std::array{-0.1, 0.0, 0.0}));
  EXPECT_EQ(rig->sensors[0].gain, (std::array{4.0, 5.0, 6.0}));
}

}  // namespace
}  // namespace omnihdr::rig_edit_test
