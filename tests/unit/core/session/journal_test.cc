#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "core/session/session_reader.h"
#include "core/session/utc_text.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::journal_test {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::string Line(std::uint64_t frame, std::int64_t position) {
  return FormatFrameRecord(test::SampleRecord(frame, position)) + "\n";
}

std::vector<std::uint64_t> FrameNumbers(const std::vector<FrameRecord>& frames) {
  std::vector<std::uint64_t> numbers;
  for (const FrameRecord& frame : frames) numbers.push_back(Value(frame.frame));
  return numbers;
}

JournalContents Parse(const std::string& text) {
  Result<JournalContents> contents = ParseJournal(text, "frames.jsonl");
  if (!contents) {
    ADD_FAILURE() << contents.error().message;
    return {};
  }
  return std::move(*contents);
}

TEST(Journal, UtcAsTextReadsBackAndWhatIsNoTimeIsNone) {
  const UtcTime time = UtcTime::FromNanoseconds(1'767'225'600'250'000'000);
  EXPECT_EQ(UtcFromText("2026-01-01T00:00:00.25Z"), time);
  EXPECT_EQ(UtcFromText(IsoUtcNanoseconds(time)), time);
  EXPECT_TRUE(UtcFromText("2016-12-31T23:59:60Z")) << "a leap second";
  for (const char* text : {"", "now", "2026-02-30T00:00:00Z", "2026-01-01T25:00:00Z"}) {
    EXPECT_FALSE(UtcFromText(text)) << text;
  }
}

TEST(Journal, UtcStandsInALineForPeopleToTheNanosecond) {
  EXPECT_EQ(IsoUtcNanoseconds(UtcTime::FromNanoseconds(1'767'225'600'000'000'007)),
            "2026-01-01T00:00:00.000000007Z");
  EXPECT_EQ(IsoUtcNanoseconds(UtcTime::FromNanoseconds(-1)), "1969-12-31T23:59:59.999999999Z");
  FrameRecord record = test::SampleRecord(0, 0);
  record.utc = UtcTime::FromNanoseconds(1'767'225'600'250'000'000);
  record.utc_source = "system-free";
  EXPECT_NE(FormatFrameRecord(record).find(
                R"("utc": "2026-01-01T00:00:00.250000000Z", "utc_ns": 1767225600250000000, )"
                R"("utc_source": "system-free")"),
            std::string::npos)
      << FormatFrameRecord(record);
}

TEST(Journal, TheDocumentedExampleIsRead) {
  const JournalContents journal = Parse(
      R"({"frame": 4, "position": 4, "file": "raw/000004.png", "exposure_s": 0.004, "gain_db": 0.0, "trigger_ns": 5000000000, "timestamp_ns": 5002000000, "odometer_m": 1.21, "status": "ok"})"
      "\n");
  ASSERT_EQ(journal.frames.size(), 1U);
  EXPECT_THAT(journal.warnings, IsEmpty());
  const FrameRecord& frame = journal.frames[0];
  EXPECT_EQ(frame.frame, FrameId{4});
  EXPECT_EQ(frame.position, PositionId{4});
  EXPECT_EQ(frame.file, "raw/000004.png");
  EXPECT_EQ(frame.exposure.time.seconds(), 0.004);
  EXPECT_EQ(frame.trigger_time.ns(), 5'000'000'000);
  EXPECT_EQ(frame.timestamp.ns(), 5'002'000'000);
  EXPECT_EQ(frame.odometer_m, 1.21);
  EXPECT_EQ(frame.status, FrameStatus::kOk);
}

TEST(Journal, OptionalKeysMayBeMissingNullOrUnknown) {
  const JournalContents journal = Parse(
      "{\"frame\":0,\"position\":0,\"file\":\"a.png\",\"exposure_s\":1,\"status\":\"ok\","
      "\"odometer_m\":null,\"colour\":\"red\",\"trigger_ns\":5e9}\r\n");
  ASSERT_EQ(journal.frames.size(), 1U);
  EXPECT_EQ(journal.frames[0].exposure.gain.value, 0.0);
  EXPECT_EQ(journal.frames[0].trigger_time.ns(), 5'000'000'000);
  EXPECT_FALSE(journal.frames[0].odometer_m);
}

TEST(Journal, ATornLastLineIsDroppedWithAWarning) {
  const std::string good = Line(0, 0) + Line(1, 1);
  const JournalContents journal = Parse(good + "{\"frame\": 2, \"posi");
  EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(0, 1));
  EXPECT_EQ(journal.complete_bytes, good.size());
  EXPECT_THAT(journal.warnings,
              ElementsAre("frames.jsonl:3: torn last line of 18 bytes dropped: its writer was "
                          "interrupted"));
  EXPECT_THAT(journal.rejected, IsEmpty());
}

TEST(Journal, CutAtAnyByteItKeepsEveryCompleteLine) {
  std::vector<std::string> lines;
  std::string text;
  for (std::uint64_t i = 0; i < 5; ++i) {
    FrameRecord record = test::SampleRecord(i, static_cast<std::int64_t>(i));
    record.detail = "} {\"frame\": 7}\n\\ \xC3\xA9";
    record.truth_json = R"({"a": {"b": [1, 2, {}]}})";
    lines.push_back(FormatFrameRecord(record));
    text += lines.back() + "\n";
  }
  for (std::size_t length = 0; length <= text.size(); ++length) {
    const JournalContents journal = Parse(text.substr(0, length));
    std::size_t complete = 0;
    std::size_t bytes = 0;
    // A line counts from its closing brace on; its newline may be missing.
    while (complete < lines.size() && bytes + lines[complete].size() <= length) {
      bytes += lines[complete].size() + 1;
      ++complete;
    }
    EXPECT_EQ(journal.frames.size(), complete) << length;
    EXPECT_EQ(journal.complete_bytes, std::min(bytes, length)) << length;
    EXPECT_THAT(journal.rejected, IsEmpty()) << length;
    EXPECT_EQ(journal.warnings.size(), (complete == 0 ? 1U : 0U) + (bytes < length ? 1U : 0U))
        << length;
  }
}

TEST(Journal, ALastLineThatOnlyLacksItsNewlineCounts) {
  const std::string text = Line(0, 0) + Line(1, 1).substr(0, Line(1, 1).size() - 1);
  const JournalContents journal = Parse(text);
  EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(0, 1));
  EXPECT_EQ(journal.complete_bytes, text.size());
  EXPECT_THAT(journal.warnings, IsEmpty());
}

TEST(Journal, AnEmptyOneIsAnEmptySessionWithAWarning) {
  for (const std::string text : {"", "\n", "  \n\n", "{\"fra"}) {
    const Result<JournalContents> journal = ParseJournal(text, "frames.jsonl");
    ASSERT_TRUE(journal) << text;
    EXPECT_THAT(journal->frames, IsEmpty());
    EXPECT_EQ(journal->warnings.back(), "frames.jsonl: no frames: the session is empty");
  }
}

TEST(Journal, ABadLineCostsItsFrameAndNotTheOthers) {
  const JournalContents journal =
      Parse(Line(0, 0) + "not a line\n" + Line(2, 2) +
            "{\"frame\":3,\"position\":3,\"file\":\"x\",\"exposure_s\":0,"
            "\"status\":\"ok\"}\n\n" +
            Line(4, 4));
  EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(0, 2, 4));
  ASSERT_EQ(journal.rejected.size(), 2U);
  EXPECT_THAT(journal.rejected[0],
              AllOf(HasSubstr("frames.jsonl:2: not JSON: "), HasSubstr(": frame skipped")));
  EXPECT_EQ(journal.rejected[1],
            "frames.jsonl:4: exposure_s: 0, expected seconds in [1e-09, 100000]: frame skipped");
  EXPECT_EQ(journal.warnings, journal.rejected);
}

TEST(Journal, WithoutAUsableLineItIsAnError) {
  const Result<JournalContents> journal = ParseJournal("x\ny\n", "frames.jsonl");
  ASSERT_FALSE(journal);
  EXPECT_EQ(journal.error().kind, ErrorKind::kData);
  EXPECT_THAT(
      journal.error().message,
      HasSubstr("frames.jsonl: none of 2 lines is usable; the first: frames.jsonl:1: not JSON"));
}

TEST(Journal, EveryMalformedValueIsRejectedByLineKeyAndValue) {
  struct Bad {
    std::string key;
    std::string value;  // "" = the key is left out
    std::string message;
  };
  const std::vector<Bad> cases = {
      {"frame", "-1", "frame: -1, expected a whole number in [0, 999999999999]"},
      {"frame", "1.5", "frame: 1.5, expected"},
      {"frame", "\"1\"", "frame: \"1\", expected"},
      {"frame", "18446744073709551616", "frame: 1.8446744073709552e+19, expected"},
      {"frame", "", "frame: missing, expected"},
      {"position", "-3", "position: -3, expected a whole number in [0, 999999999]"},
      {"position", "", "position: missing"},
      {"position", "[1]", "position: [1], expected"},
      {"file", "\"\"", "file: \"\", expected a relative path inside the session directory"},
      {"file", "\"../secret.png\"", "file: \"../secret.png\", expected a relative path"},
      {"file", "\"raw/../../secret.png\"", "file: \"raw/../../secret.png\", expected"},
      {"file", "\"/etc/passwd\"", "file: \"/etc/passwd\", expected"},
      {"file", "\"raw/\"", "file: \"raw/\", expected"},
      {"file", "\".\"", "file: \".\", expected"},
      {"file", "\"a\\u0000.png\"", "file: \"a\\u0000.png\", expected"},
      {"file", "7", "file: 7, expected a string"},
      {"file", "", "file: missing, expected"},
      {"exposure_s", "0", "exposure_s: 0, expected seconds in [1e-09, 100000]"},
      {"exposure_s", "0.0", "exposure_s: 0.0, expected seconds"},
      {"exposure_s", "-0.004", "exposure_s: -0.004, expected seconds"},
      {"exposure_s", "1e-300", "exposure_s: 1e-300, expected seconds"},
      {"exposure_s", "1e999", "exposure_s: 1e999, expected a finite number"},
      {"exposure_s", "NaN", "exposure_s: NaN, expected a finite number"},
      {"exposure_s", "-Infinity", "exposure_s: -Infinity, expected a finite number"},
      {"exposure_s", "null", "exposure_s: null, expected seconds"},
      {"exposure_s", "\"1/60\"", "exposure_s: \"1/60\", expected seconds"},
      {"exposure_s", "", "exposure_s: missing, expected seconds"},
      {"gain_db", "1000", "gain_db: 1000, expected decibels in [-200, 200]"},
      {"trigger_ns", "1.5", "trigger_ns: 1.5, expected whole nanoseconds"},
      {"timestamp_ns", "\"now\"", "timestamp_ns: \"now\", expected whole nanoseconds"},
      {"odometer_m", "\"far\"", "odometer_m: \"far\", expected metres"},
      {"status", "\"fine\"", "status: \"fine\", expected \"ok\", \"missed-trigger\""},
      {"status", "", "status: missing, expected"},
      {"crc32c", "4294967296", "crc32c: 4294967296, expected a whole number in [0, 4294967295]"},
      {"exposure_proof", "\"hope\"", "exposure_proof: \"hope\", expected \"none\""},
      {"gnss", "{\"lat\": 91, \"lon\": 0}", "gnss.lat: 91, expected degrees in [-90, 90]"},
      {"gnss", "{\"lat\": 9, \"lon\": 0, \"error_m\": -1}", "gnss.error_m: -1, expected a number"},
      {"gnss", "[]", "gnss: [], expected a JSON object"},
      {"heading_deg", "true", "heading_deg: true, expected degrees"},
      {"pose", "{\"q\": [2, 0, 0, 0], \"t\": [0, 0, 0]}", "pose.q: [2,0,0,0], expected a unit"},
      {"pose", "{\"q\": [1, 0, 0, 0], \"t\": [0, 0]}", "pose.t: [0,0], expected three finite"},
      {"pose", "{\"q\": [1, 0, 0, 0]}", "pose.t: missing, expected three finite"},
      {"temperature_c", "-300", "temperature_c: -300, expected degrees Celsius"},
      {"truth", "5", "truth: 5, expected a JSON object"},
  };
  for (const Bad& bad : cases) {
    std::string line = "{";
    const std::vector<std::pair<std::string, std::string>> good = {{"frame", "1"},
                                                                   {"position", "1"},
                                                                   {"file", "\"raw/1.png\""},
                                                                   {"exposure_s", "0.004"},
                                                                   {"status", "\"ok\""}};
    bool replaced = false;
    for (const auto& [key, value] : good) {
      const bool this_one = key == bad.key;
      replaced = replaced || this_one;
      if (this_one && bad.value.empty()) continue;
      line += fmt::format("\"{}\": {}, ", key, this_one ? bad.value : value);
    }
    if (!replaced) line += fmt::format("\"{}\": {}, ", bad.key, bad.value);
    line += "\"end\": 0}\n";
    const JournalContents journal = Parse(Line(0, 0) + line + Line(2, 2));
    EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(0, 2)) << line;
    ASSERT_EQ(journal.rejected.size(), 1U) << line;
    EXPECT_THAT(journal.rejected[0], HasSubstr("frames.jsonl:2: " + bad.message)) << line;
  }
}

TEST(Journal, ATriggerWithoutPixelsStillHasItsLine) {
  const JournalContents journal =
      Parse("{\"frame\":0,\"position\":0,\"status\":\"missed-trigger\",\"detail\":\"busy\"}\n");
  ASSERT_EQ(journal.frames.size(), 1U);
  EXPECT_EQ(journal.frames[0].status, FrameStatus::kMissedTrigger);
  EXPECT_EQ(journal.frames[0].detail, "busy");
  EXPECT_TRUE(journal.frames[0].file.empty());
}

TEST(Journal, ADuplicateFrameNumberIsIgnoredWithAWarning) {
  const JournalContents journal = Parse(Line(0, 0) + Line(1, 1) + Line(0, 5) + Line(2, 2));
  EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(0, 1, 2));
  EXPECT_EQ(Value(journal.frames[0].position), 0);
  EXPECT_THAT(journal.rejected,
              ElementsAre("frames.jsonl:3: frame: 0, expected a number not used before: frame "
                          "skipped"));
}

TEST(Journal, FrameNumbersInAnyOrderAreRememberedOnceEach) {
  std::string text;
  for (const std::uint64_t frame : {5, 3, 4, 9, 8, 0, 1, 2, 7, 6, 5, 0, 9, 10, 10}) {
    text += Line(frame, 0);
  }
  const JournalContents journal = Parse(text);
  EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(5, 3, 4, 9, 8, 0, 1, 2, 7, 6, 10));
  EXPECT_EQ(journal.rejected.size(), 4U);
}

TEST(Journal, PositionsOutOfOrderKeepFileOrderAndWarn) {
  const JournalContents journal = Parse(Line(0, 3) + Line(1, 1) + Line(2, 1) + Line(3, 2));
  EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(0, 1, 2, 3));
  EXPECT_THAT(
      journal.warnings,
      ElementsAre("frames.jsonl:2: position: 1, expected 3 or more: positions out of order"));
}

TEST(Journal, WarningsAreCountedRatherThanKeptWithoutLimit) {
  std::string text = Line(0, 0);
  for (int i = 0; i < 1500; ++i) text += "?\n";
  const JournalContents journal = Parse(text);
  ASSERT_EQ(journal.warnings.size(), 1001U);
  EXPECT_EQ(journal.warnings.back(), "frames.jsonl: 500 more warnings");
}

TEST(Journal, AContinuationNumbersItsLines) {
  const Result<JournalContents> journal = ParseJournal(Line(7, 0) + "?\n", "frames.jsonl", 8);
  ASSERT_TRUE(journal);
  ASSERT_EQ(journal->rejected.size(), 1U);
  EXPECT_THAT(journal->rejected[0], HasSubstr("frames.jsonl:9: "));
}

TEST(Journal, ALineOfAMegabyteIsRejected) {
  const JournalContents journal =
      Parse(Line(0, 0) + "{\"x\": \"" + std::string(1U << 20U, 'a') + "\"}\n" + Line(1, 1));
  EXPECT_THAT(FrameNumbers(journal.frames), ElementsAre(0, 1));
  ASSERT_EQ(journal.rejected.size(), 1U);
  EXPECT_THAT(journal.rejected[0], HasSubstr("expected a line of at most 1048576"));
}

TEST(JournalFollower, SeesEachLineOnceAsItIsCompleted) {
  const test::TemporaryDirectory directory;
  const std::filesystem::path path = directory.path() / "frames.jsonl";
  JournalFollower follower(directory.path());
  ASSERT_FALSE(follower.ReadNew());

  const std::string text = Line(0, 0) + "bad\n" + Line(1, 1) + "\n" + Line(1, 1) + Line(2, 2);
  std::vector<FrameRecord> frames;
  for (std::size_t length = 0; length <= text.size(); ++length) {
    test::Spill(path, text.substr(0, length));
    Result<std::vector<FrameRecord>> more = follower.ReadNew();
    ASSERT_TRUE(more) << more.error().message;
    frames.insert(frames.end(), more->begin(), more->end());
  }
  EXPECT_THAT(FrameNumbers(frames), ElementsAre(0, 1, 2));
  EXPECT_EQ(follower.rejected(), 2U);
  ASSERT_EQ(follower.warnings().size(), 2U);
  EXPECT_THAT(follower.warnings()[0], HasSubstr("frames.jsonl:2: not JSON"));
  EXPECT_THAT(follower.warnings()[1], HasSubstr("frames.jsonl:5: frame: 1"));
  EXPECT_FALSE(follower.TornTail());
}

TEST(JournalFollower, WhatTheWriterMayTakeBackIsNotSeen) {
  const test::TemporaryDirectory directory;
  const std::filesystem::path path = directory.path() / "frames.jsonl";
  JournalFollower follower(directory.path());
  std::uint64_t durable = Line(0, 0).size();
  follower.ReadUpTo([&durable] { return durable; });
  const auto numbers = [&follower] {
    Result<std::vector<FrameRecord>> frames = follower.ReadNew();
    EXPECT_TRUE(frames) << frames.error().message;
    return frames ? FrameNumbers(*frames) : std::vector<std::uint64_t>{};
  };
  test::Spill(path, Line(0, 0) + Line(1, 1));
  EXPECT_THAT(numbers(), ElementsAre(0));
  EXPECT_THAT(numbers(), IsEmpty());
  // Taken back, and another line in its place.
  test::Spill(path, Line(0, 0));
  EXPECT_THAT(numbers(), IsEmpty());
  test::Spill(path, Line(0, 0) + Line(17, 17) + Line(18, 18));
  durable += Line(17, 17).size();
  EXPECT_THAT(numbers(), ElementsAre(17));
  EXPECT_EQ(follower.rejected(), 0U);
}

TEST(JournalFollower, APieceOfALineWaitsAndIsToldAsTornWhenTheWriterHasGone) {
  const test::TemporaryDirectory directory;
  test::Spill(directory.path() / "frames.jsonl", Line(0, 0) + "{\"frame\": 1");
  JournalFollower follower(directory.path());
  const Result<std::vector<FrameRecord>> frames = follower.ReadNew();
  ASSERT_TRUE(frames);
  EXPECT_THAT(FrameNumbers(*frames), ElementsAre(0));
  ASSERT_TRUE(follower.TornTail());
  EXPECT_THAT(*follower.TornTail(), HasSubstr("frames.jsonl:2: torn last line of 11 bytes"));
  EXPECT_THAT(follower.warnings(), IsEmpty());
}

TEST(JournalFollower, AJournalLongerThanOneReadIsReadWhole) {
  const test::TemporaryDirectory directory;
  std::string text;
  for (std::uint64_t i = 0; i < 5000; ++i) text += Line(i, static_cast<std::int64_t>(i));
  ASSERT_GT(text.size(), 600'000U);
  test::Spill(directory.path() / "frames.jsonl", text);
  JournalFollower follower(directory.path());
  const Result<std::vector<FrameRecord>> frames = follower.ReadNew();
  ASSERT_TRUE(frames);
  ASSERT_EQ(frames->size(), 5000U);
  EXPECT_EQ(Value(frames->back().frame), 4999U);
  EXPECT_TRUE(follower.ReadNew()->empty());
}

TEST(JournalFollower, AJournalThatShrinksIsAnError) {
  const test::TemporaryDirectory directory;
  test::Spill(directory.path() / "frames.jsonl", Line(0, 0) + Line(1, 1));
  JournalFollower follower(directory.path());
  ASSERT_TRUE(follower.ReadNew());
  test::Spill(directory.path() / "frames.jsonl", Line(0, 0));
  const Result<std::vector<FrameRecord>> frames = follower.ReadNew();
  ASSERT_FALSE(frames);
  EXPECT_THAT(frames.error().message, HasSubstr("expected at least the"));
}

}  // namespace
}  // namespace omnihdr::journal_test
