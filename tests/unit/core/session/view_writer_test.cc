#include "core/session/view_writer.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/session/session_reader.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::view_writer_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<std::string> Names(const fs::path& directory) {
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(directory)) {
    names.push_back(entry.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

// Fills a view with view.json and one more file that says `mark`.
std::function<Status(const fs::path&)> Fill(std::int64_t position, const std::string& mark) {
  return [=](const fs::path& directory) -> Status {
    test::Spill(directory / "view.json", FormatViewRecord(test::SampleView(position)));
    test::Spill(directory / "extra" / "mark.txt", mark);
    return {};
  };
}

TEST(ViewRecord, TheDocumentedExampleIsRead) {
  const Result<ViewRecord> view = ParseViewRecord(
      R"({"position": 3, "pose": {"q": [1,0,0,0], "t": [0.9,0.0,0.0]}, "scale": "metric", "orientation": [1,0,0,0],
 "frames": [2, 3, 4], "reference": 3, "mode": "spatiotemporal",
 "radiance": {"min": 0.01, "max": 812.0, "valid_fraction": 0.998}, "warnings": [], "seconds": {"pose": 0.1, "stereo": 0.4, "merge": 0.1, "write": 0.1}})",
      "view.json");
  ASSERT_TRUE(view) << view.error().message;
  EXPECT_EQ(view->position, PositionId{3});
  EXPECT_EQ(view->pose.translation.x(), 0.9);
  EXPECT_TRUE(view->metric_scale);
  EXPECT_THAT(view->frames, ElementsAre(2, 3, 4));
  EXPECT_EQ(view->reference, 3U);
  EXPECT_EQ(view->radiance_max, 812.0);
}

TEST(ViewRecord, WhatIsSaidOfAPoseIsReadAndWhatCannotBeIsRefused) {
  const auto with = [](const std::string& sigma, const std::string& more) {
    return R"({"position": 3, "pose": {"q": [1,0,0,0], "t": [0.9,0,0], )" + sigma +
           R"(}, "scale": "metric",
 "chain": 0, )" +
           more +
           R"( "orientation": [1,0,0,0], "frames": [3], "reference": 3, "mode": "spatiotemporal",
 "radiance": {"min": 0.01, "max": 812.0, "valid_fraction": 0.998}})";
  };
  const std::string sigma =
      R"("sigma_rotation_deg": [0.01, 0.02, 0.03], "sigma_t": [0.001, 0.002, 0.003])";
  const std::string relocalised =
      R"("relocalised": {"place": 1, "seen_from": 4, "from_chain": 2, "matches": 57},)";
  const std::string loop =
      R"("loop": {"place": 1, "seen_from": 3, "matches": 90, "drift_rotation_deg": 0.6,
 "drift_translation": 0.2, "drift_scale": 1.0, "corrected": true},)";
  const Result<ViewRecord> view = ParseViewRecord(with(sigma, relocalised + loop), "view.json");
  ASSERT_TRUE(view) << view.error().message;
  ASSERT_TRUE(view->sigma && view->relocalised && view->loop);
  EXPECT_EQ(view->sigma->rotation_deg.y(), 0.02);
  EXPECT_EQ(view->sigma->translation.z(), 0.003);
  EXPECT_EQ(view->relocalised->place, PositionId{1});
  EXPECT_EQ(view->relocalised->from_chain, 2);
  EXPECT_EQ(view->loop->drift_rotation_deg, 0.6);
  EXPECT_TRUE(view->loop->corrected);
  for (const auto& [text, message] : {
           std::pair(with(R"("sigma_rotation_deg": [0.01, 0.02, 0.03])", ""),
                     "pose.sigma_t: missing"),
           std::pair(with(R"("sigma_rotation_deg": [1, 2], "sigma_t": [1, 2, 3])", ""),
                     "pose.sigma_rotation_deg: [1,2], expected three numbers of at least 0"),
           std::pair(with(R"("sigma_rotation_deg": [1, 2, 3], "sigma_t": [1, -2, 3])", ""),
                     "pose.sigma_t: [1,-2,3], expected three numbers of at least 0"),
           std::pair(with(sigma, R"("relocalised": {"place": -1},)"), "relocalised.place: -1"),
           std::pair(with(sigma, R"("scale_source": "hope",)"),
                     "scale_source: \"hope\", expected \"odometer\", \"gnss\""),
           std::pair(with(sigma, R"("gnss_scale": {"metres_per_unit": -1},)"),
                     "gnss_scale.metres_per_unit: -1"),
           std::pair(with(sigma, R"("loop": {"place": 1, "seen_from": 3, "matches": 9},)"),
                     "loop.drift_rotation_deg: missing"),
       }) {
    const Result<ViewRecord> refused = ParseViewRecord(text, "v");
    ASSERT_FALSE(refused) << message;
    EXPECT_THAT(refused.error().message, HasSubstr(message));
  }
}

TEST(ViewRecord, SaysNothingThatDiffersBetweenRuns) {
  const std::string text = FormatViewRecord(test::SampleView(3));
  EXPECT_EQ(text.find("seconds"), std::string::npos);
  EXPECT_EQ(text, FormatViewRecord(test::SampleView(3)));
}

TEST(ViewRecord, TellsItsQualityAndOneThatDoesNotIsFull) {
  ViewRecord reduced = test::SampleView(3);
  EXPECT_NE(FormatViewRecord(reduced).find("\"quality_level\": 0"), std::string::npos);
  reduced.quality_level = 2;
  reduced.quality = "less of it";
  const Result<ViewRecord> view = ParseViewRecord(FormatViewRecord(reduced), "view.json");
  ASSERT_TRUE(view) << view.error().message;
  EXPECT_EQ(view->quality_level, 2);
  EXPECT_EQ(view->quality, "less of it");
  std::string old = FormatViewRecord(test::SampleView(3));
  const std::string key = ",\n \"quality_level\": 0";
  ASSERT_NE(old.find(key), std::string::npos) << old;
  old.erase(old.find(key), key.size());
  // As written by a version that knew nothing of it.
  ASSERT_TRUE(ParseViewRecord(old, "view.json"));
  EXPECT_EQ(ParseViewRecord(old, "view.json")->quality_level, 0);
}

TEST(ViewRecord, ARoundedQuaternionIsNormalised) {
  std::string text = FormatViewRecord(test::SampleView(3));
  const std::string unit = "\"orientation\": [1.0,0.0,0.0,0.0]";
  ASSERT_NE(text.find(unit), std::string::npos);
  text.replace(text.find(unit), unit.size(), "\"orientation\": [0.7071, 0.7071, 0, 0]");
  const Result<ViewRecord> view = ParseViewRecord(text, "view.json");
  ASSERT_TRUE(view);
  EXPECT_NEAR(view->orientation.norm(), 1.0, 1e-15);
}

TEST(ViewRecord, EveryMalformedValueIsRefused) {
  struct Bad {
    std::string from;
    std::string to;
    std::string message;
  };
  const std::vector<Bad> cases = {
      {"\"position\": 3", "\"position\": -1", "v:2: position: -1, expected a whole number"},
      {"\"relative\"", "\"furlong\"", "scale: \"furlong\", expected \"metric\" or \"relative\""},
      {"[0,1,2]", "[0,-1]", "frames: [0,-1], expected an array of frame numbers"},
      {"[0,1,2]", "3", "frames: 3, expected an array of frame numbers"},
      {"\"reference\": 1", "\"reference\": \"x\"", "reference: \"x\", expected a whole number"},
      {"\"chain\": 0", "\"chain\": -1", "chain: -1, expected"},
      {"\"quality_level\": 0", "\"quality_level\": -1", "quality_level: -1, expected a whole"},
      {"\"warnings\": []", "\"warnings\": [1]", "warnings: [1], expected an array of strings"},
      {"\"max\": 812.0", "\"max\": \"812\"", "radiance.max: \"812\", expected a number"},
      {"\"max\": 812.0, ", "", "radiance.max: missing, expected a number"},
      {"\"max\": 812.0", "\"max\": Infinity", "max: Infinity, expected a finite number"},
      {"\"t\": [0.0,0.0,0.0]", "\"t\": [0.0,0.0]", "pose.t: [0.0,0.0], expected three finite"},
  };
  const std::string good = FormatViewRecord(test::SampleView(3));
  for (const Bad& bad : cases) {
    std::string text = good;
    ASSERT_NE(text.find(bad.from), std::string::npos) << bad.from << " in " << good;
    text.replace(text.find(bad.from), bad.from.size(), bad.to);
    const Result<ViewRecord> view = ParseViewRecord(text, "v");
    ASSERT_FALSE(view) << bad.to;
    EXPECT_THAT(view.error().message, HasSubstr(bad.message));
  }
  for (std::size_t length = 0; length + 1 < good.size(); ++length) {
    EXPECT_FALSE(ParseViewRecord(good.substr(0, length), "v")) << length;
  }
}

TEST(ViewWriter, AViewAppearsWholeUnderItsNumber) {
  const test::TemporaryDirectory directory;
  const fs::path views = directory.path() / "out" / "views";
  ASSERT_TRUE(WriteView(views, PositionId{3}, false, [&](const fs::path& temporary) -> Status {
    EXPECT_FALSE(fs::exists(views / "000003"));
    EXPECT_THAT(*CompleteViews(views), IsEmpty());
    return Fill(3, "one")(temporary);
  }));
  EXPECT_THAT(Names(views), ElementsAre("000003"));
  EXPECT_THAT(Names(views / "000003"), ElementsAre("extra", "view.json"));
  EXPECT_THAT(*CompleteViews(views), ElementsAre(PositionId{3}));
  EXPECT_EQ(ReadViewRecord(views, PositionId{3})->reference, 1U);
}

TEST(ViewWriter, AFailedFillLeavesNothingBehind) {
  const test::TemporaryDirectory directory;
  const Status status =
      WriteView(directory.path(), PositionId{3}, false, [](const fs::path& temporary) -> Status {
        test::Spill(temporary / "radiance.exr", "half");
        return Fail(ErrorKind::kIo, "no more room");
      });
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().message, "write view 000003: no more room");
  EXPECT_EQ(status.error().kind, ErrorKind::kIo);
  EXPECT_THAT(Names(directory.path()), IsEmpty());
}

TEST(ViewWriter, AViewThatCouldNotBeFoundAgainIsRefused) {
  const test::TemporaryDirectory directory;
  const auto nothing = [](const fs::path&) -> Status { return {}; };
  EXPECT_THAT(WriteView(directory.path(), PositionId{3}, false, nothing).error().message,
              HasSubstr("view.json: No such file"));
  EXPECT_THAT(WriteView(directory.path(), PositionId{3}, false, Fill(4, "x")).error().message,
              HasSubstr("position: 4, expected 3"));
  EXPECT_FALSE(WriteView(directory.path(), PositionId{-1}, false, Fill(-1, "x")));
  EXPECT_THAT(Names(directory.path()), IsEmpty());
}

TEST(ViewWriter, AnExistingViewIsReplacedOnlyWhenAsked) {
  const test::TemporaryDirectory directory;
  ASSERT_TRUE(WriteView(directory.path(), PositionId{3}, false, Fill(3, "one")));
  bool filled = false;
  const Status refused =
      WriteView(directory.path(), PositionId{3}, false, [&filled](const fs::path&) -> Status {
        filled = true;
        return {};
      });
  ASSERT_FALSE(refused);
  EXPECT_FALSE(filled);
  EXPECT_THAT(refused.error().message, HasSubstr("000003: already exists"));
  EXPECT_EQ(test::Slurp(directory.path() / "000003/extra/mark.txt"), "one");

  const Status failed =
      WriteView(directory.path(), PositionId{3}, true,
                [](const fs::path&) -> Status { return Fail(ErrorKind::kIo, "no"); });
  ASSERT_FALSE(failed);
  EXPECT_EQ(test::Slurp(directory.path() / "000003/extra/mark.txt"), "one");

  ASSERT_TRUE(WriteView(directory.path(), PositionId{3}, true, Fill(3, "two")));
  EXPECT_EQ(test::Slurp(directory.path() / "000003/extra/mark.txt"), "two");
  EXPECT_THAT(Names(directory.path()), ElementsAre("000003"));
}

TEST(ViewWriter, WhatIsNoCompleteViewIsReplacedUnasked) {
  const test::TemporaryDirectory directory;
  test::Spill(directory.path() / "000003" / "view.json", "{}");
  EXPECT_THAT(*CompleteViews(directory.path()), IsEmpty());
  ASSERT_TRUE(WriteView(directory.path(), PositionId{3}, false, Fill(3, "one")));
  EXPECT_THAT(*CompleteViews(directory.path()), ElementsAre(PositionId{3}));
  EXPECT_THAT(Names(directory.path()), ElementsAre("000003"));
}

TEST(ViewWriter, AnInterruptedViewIsInvisibleAndIsCleanedUp) {
  const test::TemporaryDirectory directory;
  // What a process leaves that is killed while filling.
  ASSERT_TRUE(Fill(5, "half")(directory.path() / ".000005.tmp"));
  ASSERT_TRUE(Fill(6, "half")(directory.path() / ".000006.tmp"));
  test::Spill(directory.path() / ".notes.tmp", "somebody's");
  EXPECT_THAT(*CompleteViews(directory.path()), IsEmpty());
  ASSERT_TRUE(WriteView(directory.path(), PositionId{5}, false, Fill(5, "whole")));
  EXPECT_EQ(test::Slurp(directory.path() / "000005/extra/mark.txt"), "whole");
  EXPECT_EQ(*RemoveTemporaryViews(directory.path()), 1);
  EXPECT_THAT(Names(directory.path()), ElementsAre(".notes.tmp", "000005"));
  EXPECT_EQ(*RemoveTemporaryViews(directory.path() / "none"), 0);
}

TEST(ViewWriter, AViewSomebodyIsFillingIsLeftAlone) {
  const test::TemporaryDirectory directory;
  const Status outer =
      WriteView(directory.path(), PositionId{5}, false, [&](const fs::path& temporary) -> Status {
        EXPECT_EQ(*RemoveTemporaryViews(directory.path()), 0);
        const Status inner = WriteView(directory.path(), PositionId{5}, false, Fill(5, "inner"));
        EXPECT_FALSE(inner);
        EXPECT_EQ(inner.error().kind, ErrorKind::kTemporary);
        return Fill(5, "outer")(temporary);
      });
  ASSERT_TRUE(outer) << outer.error().message;
  EXPECT_EQ(test::Slurp(directory.path() / "000005/extra/mark.txt"), "outer");
}

TEST(ViewWriter, CompleteViewsAreThoseWithAReadableRecordInAscendingOrder) {
  const test::TemporaryDirectory directory;
  for (const std::int64_t position : {12, 3, 1'000'000}) {
    ASSERT_TRUE(WriteView(directory.path(), PositionId{position}, false, Fill(position, "")));
  }
  fs::create_directory(directory.path() / "000007");                   // empty
  test::Spill(directory.path() / "000008" / "view.json", "{\"posit");  // torn
  test::Spill(directory.path() / "000009", "a file");
  ASSERT_TRUE(Fill(4, "")(directory.path() / "4"));  // not a view's name
  ASSERT_TRUE(Fill(4, "")(directory.path() / "0000004"));
  EXPECT_THAT(*CompleteViews(directory.path()),
              ElementsAre(PositionId{3}, PositionId{12}, PositionId{1'000'000}));
  EXPECT_THAT(*CompleteViews(directory.path() / "none"), IsEmpty());
}

}  // namespace
}  // namespace omnihdr::view_writer_test
