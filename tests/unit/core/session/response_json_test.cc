#include "core/session/response_json.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "core/session/session_reader.h"

namespace omnihdr::response_json_test {
namespace {

using ::testing::HasSubstr;

// Odd on purpose: unknown members, "response" as a value and in a nested object, odd spaces.
constexpr const char* kSession =
    "{\n \"note\": \"response\", \"format\" : \"omnihdr-session\",\n\t\"version\": 1,\n"
    " \"camera\": {\"layout\": \"panorama\", \"projection\": \"equirectangular\", \"width\": 2048, "
    "\"height\": 1024, \"response\": {\"model\": \"none, \\\"of ours\\\"}\"}, \"lens\": 7.50},\n"
    " \"response\" : {\"model\": \"linear\"}  ,\n \"operator\": \"A\"}\n\n";

Response Table() {
  std::array<std::vector<double>, 3> ln;
  for (std::size_t c = 0; c < 3; ++c) {
    for (int z = 0; z < 256; ++z) ln[c].push_back(std::sqrt(z + 0.1 * static_cast<double>(c)));
  }
  return *Response::Table(ln);
}

TEST(ResponseJson, EveryModelReadsBackExactly) {
  const Response linear = *Response::Linear(16.1);
  const Result<Response> linear_again = ParseResponse(FormatResponse(linear), "r");
  ASSERT_TRUE(linear_again) << linear_again.error().message;
  EXPECT_EQ(linear_again->black(), 16.1);
  const Response loglinear = *Response::LogLinear({{{0.01, -1.0}, {0.02, 1.0 / 3.0}, {0.03, 0.0}}});
  const Result<Response> loglinear_again = ParseResponse(FormatResponse(loglinear), "r");
  ASSERT_TRUE(loglinear_again) << loglinear_again.error().message;
  EXPECT_EQ(loglinear_again->loglinear(), loglinear.loglinear());
  const Result<Response> table_again = ParseResponse(FormatResponse(Table()), "r");
  ASSERT_TRUE(table_again) << table_again.error().message;
  EXPECT_EQ(table_again->table(), Table().table());
  EXPECT_EQ(table_again->white(), 255.0);
  const Response early = Table().WithWhite(238.25).value();
  const Result<Response> early_again = ParseResponse(FormatResponse(early), "r");
  ASSERT_TRUE(early_again) << early_again.error().message;
  EXPECT_EQ(early_again->white(), 238.25);
}

TEST(ResponseJson, AWrongFileIsRefusedWithItsLineAndKey) {
  const Result<Response> wrong = ParseResponse("{\"model\":\n \"cubic\"}", "curve.json");
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().kind, ErrorKind::kData);
  EXPECT_THAT(wrong.error().message, HasSubstr("curve.json:1: model: \"cubic\""));
  EXPECT_FALSE(ParseResponse("", "curve.json"));
  const Result<Response> bright =
      ParseResponse("{\"model\": \"linear\", \"white\": 300}", "r.json");
  ASSERT_FALSE(bright);
  EXPECT_THAT(bright.error().message, HasSubstr("white: 300"));
  EXPECT_FALSE(ParseResponse("[1]", "curve.json"));
}

TEST(ResponseJson, NothingButTheResponseOfASessionIsReplaced) {
  const Result<std::string> replaced = ReplaceSessionResponse(kSession, "s", *Response::Linear(3));
  ASSERT_TRUE(replaced) << replaced.error().message;
  std::string expected = kSession;
  const std::string old = "\"response\" : {\"model\": \"linear\"}";
  const std::string text = FormatResponse(*Response::Linear(3));
  expected.replace(expected.find(old), old.size(), "\"response\" : " + text);
  EXPECT_EQ(*replaced, expected);
}

TEST(ResponseJson, TheLastOfTwoResponsesIsReplacedAsItIsTheOneThatCounts) {
  std::string twice = kSession;
  twice.replace(twice.find(" \"operator\""), 0,
                "\"response\": {\"model\": \"linear\", \"black\": 9},");
  const Result<std::string> replaced = ReplaceSessionResponse(twice, "s", *Response::Linear(3));
  ASSERT_TRUE(replaced) << replaced.error().message;
  const Result<SessionInfo> info = ParseSessionInfo(*replaced, "s");
  ASSERT_TRUE(info) << info.error().message;
  EXPECT_EQ(info->response.black(), 3.0);
}

TEST(ResponseJson, WhatIsNoSessionIsLeftAlone) {
  const Result<std::string> refused =
      ReplaceSessionResponse("{\"response\": {\"model\": \"linear\"}}", "s", *Response::Linear());
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("format"));
}

}  // namespace
}  // namespace omnihdr::response_json_test
