#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "core/session/session_reader.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::session_info_test {
namespace {

using ::testing::HasSubstr;

// The example of the format's description, with one part replaced.
std::string InfoText(const std::string& from = "", const std::string& to = "") {
  std::string text =
      R"({"format": "omnihdr-session", "version": 1, "created": "2026-01-01T00:00:00Z",
 "camera": {"model": "m", "serial": "s", "bits": 8,
            "layout": "panorama", "projection": "cylindrical", "width": 1536, "height": 1152, "z_min": -2.356, "z_max": 2.356},
 "response": {"model": "linear"},
 "bracket": {"order": "sawtooth", "exposures_s": [0.001, 0.004, 0.016]}})";
  if (!from.empty()) {
    const std::size_t at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    text.replace(at, from.size(), to);
  }
  return text;
}

std::string ErrorOf(const std::string& text) {
  const Result<SessionInfo> info = ParseSessionInfo(text, "s/session.json");
  EXPECT_FALSE(info) << text;
  if (info) return "";
  EXPECT_EQ(info.error().kind, ErrorKind::kData);
  return info.error().message;
}

TEST(SessionInfo, TheDocumentedExampleIsRead) {
  const Result<SessionInfo> info = ParseSessionInfo(InfoText(), "session.json");
  ASSERT_TRUE(info) << info.error().message;
  EXPECT_EQ(info->created, "2026-01-01T00:00:00Z");
  EXPECT_EQ(info->camera.model, "m");
  EXPECT_EQ(info->camera.layout, Layout::kPanorama);
  EXPECT_EQ(info->camera.PanoramaProjection(), Projection::Cylindrical(1536, 1152, -2.356, 2.356));
  EXPECT_EQ(info->response.model(), ResponseModel::kLinear);
  ASSERT_TRUE(info->bracket);
  EXPECT_EQ(info->bracket->exposures.size(), 3U);
  EXPECT_EQ(info->bracket->frames_per_position, 1);
  EXPECT_TRUE(info->extra_json.empty());
}

TEST(SessionInfo, UnknownKeysAreIgnoredAndThoseOfTheTopLevelPassThrough) {
  const std::string text = InfoText("\"version\": 1,",
                                    "\"version\": 1, \"simulation\": {\"a\": [1]}, "
                                    "\"later\": null, ");
  const Result<SessionInfo> info = ParseSessionInfo(text, "session.json");
  ASSERT_TRUE(info) << info.error().message;
  EXPECT_EQ(info->extra_json, R"({"later":null,"simulation":{"a":[1]}})");
  EXPECT_TRUE(ParseSessionInfo(InfoText("\"bits\": 8", "\"bits\": 8, \"colour\": {}"), "x"));
  const Result<SessionInfo> again = ParseSessionInfo(FormatSessionInfo(*info), "again");
  ASSERT_TRUE(again);
  EXPECT_EQ(again->extra_json, info->extra_json);
}

TEST(SessionInfo, LayoutsAndSizesFromOneToSixteenMegapixelsAreRead) {
  for (const auto& [width, height] : {std::pair{1448, 724}, {2048, 1024}, {5792, 2896}, {64, 64}}) {
    SessionInfo info = test::SampleInfo();
    info.camera.width = width;
    info.camera.height = height;
    const Result<SessionInfo> read = ParseSessionInfo(FormatSessionInfo(info), "x");
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->camera.width, width);
    EXPECT_EQ(read->camera.height, height);
  }
  SessionInfo rig = test::SampleInfo();
  rig.camera.layout = Layout::kRig;
  rig.camera.width = 1024;
  rig.camera.height = 4608;
  rig.camera.bayer = "GRBG";
  const Result<SessionInfo> rig_read = ParseSessionInfo(FormatSessionInfo(rig), "x");
  ASSERT_TRUE(rig_read) << rig_read.error().message;
  EXPECT_EQ(rig_read->camera.layout, Layout::kRig);
  EXPECT_EQ(rig_read->camera.bayer, "GRBG");

  SessionInfo pinhole = test::SampleInfo();
  pinhole.camera.layout = Layout::kPerspective;
  for (const PerspectiveIntrinsics intrinsics :
       {PerspectiveIntrinsics{}, PerspectiveIntrinsics{700.5, 701.5, 256.0, 384.0}}) {
    pinhole.camera.intrinsics = intrinsics;
    const Result<SessionInfo> read = ParseSessionInfo(FormatSessionInfo(pinhole), "x");
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->camera.layout, Layout::kPerspective);
    EXPECT_EQ(read->camera.intrinsics.fx, intrinsics.fx);
    EXPECT_EQ(read->camera.intrinsics.cy, intrinsics.cy);
  }
}

TEST(SessionInfo, EveryResponseModelIsReadAndWritten) {
  std::array<std::vector<double>, 3> table;
  for (std::size_t c = 0; c < 3; ++c) {
    for (int z = 0; z < 256; ++z)
      table[c].push_back(-5.0 + 0.03 * z + 0.1 * static_cast<double>(c));
  }
  for (const Result<Response>& response :
       {Response::Linear(), Response::Linear(16.25),
        Response::LogLinear({{{0.0202, -2.6}, {0.0203, -2.7}, {0.0204, -2.8}}}),
        Response::Table(table)}) {
    ASSERT_TRUE(response) << response.error().message;
    SessionInfo info = test::SampleInfo();
    info.response = *response;
    const Result<SessionInfo> read = ParseSessionInfo(FormatSessionInfo(info), "x");
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->response.model(), response->model());
    EXPECT_EQ(read->response.black(), response->black());
    EXPECT_EQ(read->response.loglinear(), response->loglinear());
    EXPECT_EQ(read->response.table(), response->table());
  }
}

TEST(SessionInfo, AnErrorNamesFileLineKeyValueAndExpectation) {
  EXPECT_EQ(ErrorOf(InfoText("\"width\": 1536", "\"width\": -5")),
            "s/session.json:3: camera.width: -5, expected pixels in [64, 65536]");
  EXPECT_EQ(ErrorOf(InfoText("\"width\": 1536, ", "")),
            "s/session.json:2: camera.width: missing, expected pixels in [64, 65536]");
}

struct BadInfo {
  std::string from;
  std::string to;
  std::string message;
};

TEST(SessionInfo, EveryMalformedValueIsRefused) {
  const std::vector<BadInfo> cases = {
      {"omnihdr-session", "other", "format: \"other\", expected \"omnihdr-session\""},
      {"\"version\": 1", "\"version\": 2", "version: 2, expected 1"},
      {"\"version\": 1", "\"version\": \"1\"", "version: \"1\", expected 1"},
      {"\"version\": 1,", "", "version: missing"},
      {"\"created\": \"2026-01-01T00:00:00Z\"", "\"created\": 5", "created: 5, expected a string"},
      {"\"bits\": 8", "\"bits\": 7", "camera.bits: 7, expected a whole number in [8, 16]"},
      {"\"bits\": 8", "\"bits\": 8.5", "camera.bits: 8.5"},
      {"\"model\": \"m\"", "\"model\": []", "camera.model: [], expected a string"},
      {"panorama", "sphere", "camera.layout: \"sphere\", expected \"panorama\", \"rig\""},
      {"cylindrical", "conical", "camera.projection: \"conical\", expected \"cylindrical\""},
      {"\"projection\": \"cylindrical\", ", "", "camera.projection: missing"},
      {"\"width\": 1536", "\"width\": 63", "camera.width: 63"},
      {"\"width\": 1536", "\"width\": 1e300", "camera.width: 1e+300"},
      {"\"width\": 1536", "\"width\": \"1536\"", "camera.width: \"1536\""},
      {"\"height\": 1152", "\"height\": 0", "camera.height: 0"},
      {"\"width\": 1536, \"height\": 1152", "\"width\": 65536, \"height\": 65536",
       "camera.height: 65536, expected at most 268435456 pixels"},
      {"\"z_min\": -2.356", "\"z_min\": 2.356", "camera.z_max: 2.356, expected more than z_min"},
      {"\"z_min\": -2.356", "\"z_min\": null", "camera.z_min: null"},
      {"\"z_max\": 2.356", "\"z_max\": 1e400", "z_max: 1e400, expected a finite number"},
      {"\"z_max\": 2.356", "\"z_max\": NaN", "z_max: NaN, expected a finite number"},
      {"{\"model\": \"linear\"}", "{\"model\": \"cubic\"}", "response.model: \"cubic\""},
      {"{\"model\": \"linear\"}", "{\"model\": \"linear\", \"black\": 128}", "response.black: 128"},
      {"{\"model\": \"linear\"}", "{\"model\": \"linear\", \"black\": -1}", "response.black: -1"},
      {"{\"model\": \"linear\"}", "{\"model\": \"loglinear\", \"r\": [1, 2]}",
       "response.g: missing"},
      {"{\"model\": \"linear\"}", "{\"model\": \"loglinear\", \"r\": [-1, 2]}",
       "response.r: [-1,2]"},
      {"{\"model\": \"linear\"}", "{\"model\": \"table\", \"ln_exposure\": [[1], [2], [3]]}",
       "response.ln_exposure: [[1],[2],[3]], expected three arrays of 256"},
      {"\"response\": {\"model\": \"linear\"},", "", "response: missing"},
      {"sawtooth", "random", "bracket.order: \"random\""},
      {"[0.001, 0.004, 0.016]", "[]", "bracket.exposures_s: []"},
      {"[0.001, 0.004, 0.016]", "[0.001, 0]", "bracket.exposures_s: [0.001,0]"},
      {"[0.001, 0.004, 0.016]", "0.001", "bracket.exposures_s: 0.001"},
      {"[0.001, 0.004, 0.016]", "[1], \"frames_per_position\": 0",
       "bracket.frames_per_position: 0"},
      {"\"version\": 1,", "\"version\": 1,,", "not JSON"},
  };
  for (const BadInfo& bad : cases) {
    EXPECT_THAT(ErrorOf(InfoText(bad.from, bad.to)), HasSubstr(bad.message)) << bad.to;
  }
}

TEST(SessionInfo, TextThatIsNoSessionIsRefusedAndNothingWorse) {
  EXPECT_THAT(ErrorOf(""), HasSubstr("s/session.json:1: not JSON"));
  EXPECT_THAT(ErrorOf("[]"), HasSubstr("s/session.json:1: [], expected a JSON object"));
  EXPECT_THAT(ErrorOf("{\"format\": \"omnihdr-session\"\n\n, \"version\": 1 \n x}"),
              HasSubstr("s/session.json:4: not JSON"));
  EXPECT_THAT(ErrorOf(std::string(100000, '[')),
              HasSubstr("nested 100000 deep, expected at most 64"));
  EXPECT_THAT(ErrorOf("{\"format\": \"\xFF\"}"), HasSubstr("not JSON"));
  EXPECT_THAT(ErrorOf(std::string(5U << 20U, ' ')), HasSubstr("expected at most 4194304"));
  const std::string whole = InfoText();
  for (std::size_t length = 0; length < whole.size(); ++length) {
    EXPECT_FALSE(ParseSessionInfo(whole.substr(0, length), "x")) << length;
  }
}

TEST(SessionReader, AMissingFileIsNamed) {
  const test::TemporaryDirectory directory;
  Result<SessionContents> session = ReadSession(directory.path());
  ASSERT_FALSE(session);
  EXPECT_EQ(session.error().kind, ErrorKind::kNoInput);
  EXPECT_THAT(session.error().message, HasSubstr("session.json: No such file"));
  test::Spill(directory.path() / "session.json", FormatSessionInfo(test::SampleInfo()));
  session = ReadSession(directory.path());
  ASSERT_FALSE(session);
  EXPECT_THAT(session.error().message, HasSubstr("frames.jsonl: No such file"));
  test::Spill(directory.path() / "frames.jsonl", "");
  session = ReadSession(directory.path());
  ASSERT_TRUE(session);
  EXPECT_TRUE(session->journal.frames.empty());
  ASSERT_EQ(session->journal.warnings.size(), 1U);
  EXPECT_THAT(session->journal.warnings[0], HasSubstr("the session is empty"));
}

}  // namespace
}  // namespace omnihdr::session_info_test
