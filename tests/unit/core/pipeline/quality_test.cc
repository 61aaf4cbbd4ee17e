#include "core/pipeline/quality.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <vector>

#include "core/image/exr.h"
#include "core/pipeline/view_pipeline.h"
#include "core/session/journal.h"
#include "core/session/view_writer.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::quality_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::Gt;
using ::testing::HasSubstr;
using testing::ProcessAll;
using testing::Processed;
using testing::QuickOptions;
using testing::Said;
using testing::SameBytes;
using testing::SessionPlan;
using testing::TemporaryDirectory;
using testing::ViewBytes;

OverloadOptions Degrade(int limit) {
  return {.overload = Overload::kDegrade, .backlog_limit = limit};
}

ProcessorOptions Upgrade() {
  ProcessorOptions how;
  how.upgrade = true;
  return how;
}

// The levels a governor chooses for these backlogs, one after the other.
std::vector<int> Levels(const OverloadOptions& options, const std::vector<int>& backlogs) {
  QualityGovernor governor(options);
  std::vector<int> levels;
  for (const int backlog : backlogs) levels.push_back(governor.Next(backlog));
  return levels;
}

TEST(QualityGovernor, ABacklogBelowItsLimitCostsNoQuality) {
  EXPECT_THAT(Levels(Degrade(8), {0, 3, 7, 7, 7, 7, 7, 7}), ElementsAre(0, 0, 0, 0, 0, 0, 0, 0));
}

TEST(QualityGovernor, GoesUpAStepAtATimeAndWaitsForTheEffect) {
  EXPECT_THAT(Levels(Degrade(4), {4, 5, 6, 7, 8, 9, 10, 11, 12}),
              ElementsAre(1, 1, 1, 1, 2, 2, 2, 2, 3));
}

TEST(QualityGovernor, StaysWhereItIsWhileTheBacklogFalls) {
  EXPECT_THAT(Levels(Degrade(4), {20, 19, 18, 17, 16, 15, 14, 13, 12, 8, 6, 5}),
              ElementsAre(1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1));
}

TEST(QualityGovernor, ComesDownAtHalfTheLimitNotAtTheLimit) {
  EXPECT_THAT(Levels(Degrade(8), {8, 8, 8, 8, 8, 7, 6, 5, 4, 4, 4, 4, 4, 4}),
              ElementsAre(1, 1, 1, 1, 2, 2, 2, 2, 1, 1, 1, 1, 0, 0));
}

TEST(QualityGovernor, HasAHighestLevelAndABacklogThatGrowsOnStaysThere) {
  std::vector<int> backlogs;
  for (int k = 0; k < 60; ++k) backlogs.push_back(10 + k);
  EXPECT_EQ(Levels(Degrade(2), backlogs).back(), kMaxQualityLevel);
}

TEST(QualityGovernor, WhereTheBacklogMayGrowNothingIsEverReduced) {
  EXPECT_THAT(Levels({}, {1000, 2000, 3000}), ElementsAre(0, 0, 0));
}

TEST(Quality, EveryLevelCostsLessThanTheOneBeforeAndAllSayWhatTheyAre) {
  const PipelineOptions full;
  const auto cells = [](const PipelineOptions& options) {
    return 1.0 * options.stereo_width * options.stereo_width * options.labels * options.neighbours;
  };
  for (int level = 1; level <= kMaxQualityLevel; ++level) {
    const PipelineOptions reduced = AtQuality(full, level);
    EXPECT_TRUE(reduced.Validate()) << level;
    EXPECT_LT(cells(reduced), 0.7 * cells(AtQuality(full, level - 1))) << level;
    EXPECT_NE(DescribeQuality(level), DescribeQuality(level - 1));
  }
  EXPECT_EQ(DescribeQuality(0), "full");
}

TEST(Quality, OptionsAtTheirLeastStayAllowed) {
  PipelineOptions least;
  least.stereo_width = 128;
  least.labels = 16;
  least.neighbours = 1;
  const PipelineOptions reduced = AtQuality(least, kMaxQualityLevel);
  EXPECT_TRUE(reduced.Validate());
  EXPECT_EQ(reduced.stereo_width, 128);
  EXPECT_EQ(reduced.labels, 16);
}

TEST(Quality, ALimitOutOfRangeIsRefusedByName) {
  for (const int limit : {1, 10001}) {
    const Status status = Degrade(limit).Validate();
    ASSERT_FALSE(status);
    EXPECT_THAT(status.error().message, HasSubstr("pipeline.backlog_limit"));
  }
}

// A drive that is journaled before anybody looks: to a pipeline, it comes much too fast.
class Overloaded : public ::testing::Test {
 protected:
  static constexpr int kPositions = 14;

  static PipelineOptions Options() {
    PipelineOptions options = QuickOptions();
    options.stereo_width = 256;  // so that the levels' widths differ
    return options;
  }
  static const SessionPlan& Plan() {
    static const SessionPlan plan = [] {
      SessionPlan p;
      p.room.balls.push_back({{2.5, 1.6, 0.0}, 0.6, 1.0F});
      p.room.balls.push_back({{1.0, -1.6, -0.5}, 0.5, 1.5F});
      p.poses = testing::GentleBend(kPositions, 0.1);
      p.with_prior_poses = true;
      return p;
    }();
    return plan;
  }
  static const std::vector<std::vector<std::byte>>& Frames() {
    static const std::vector<std::vector<std::byte>> frames = testing::RenderFrames(Plan());
    return frames;
  }
  // What a run gives that nothing pressed.
  static const std::map<std::string, std::string>& Undisturbed() {
    static const std::map<std::string, std::string> bytes = [] {
      const TemporaryDirectory directory;
      testing::WriteSession(directory.path(), Plan(), Frames());
      ProcessAll(directory.path(), {}, Options());
      return ViewBytes(directory.path());
    }();
    return bytes;
  }

  Overloaded() { testing::WriteSession(session(), Plan(), Frames()); }

  const fs::path& session() const { return directory_.path(); }

  std::unique_ptr<SessionProcessor> Open(const ProcessorOptions& how, Said* said,
                                         const PipelineOptions& options = Options()) {
    ProcessorCallbacks callbacks = testing::Into(said);
    callbacks.quality_changed = [this](int level, int backlog) {
      changes_.emplace_back(level, backlog);
    };
    auto opened = SessionProcessor::Open(session(), {}, options, std::move(callbacks), how);
    EXPECT_TRUE(opened) << opened.error().message;
    return opened ? std::move(*opened) : nullptr;
  }
  SessionProcessor::Counts Process(const ProcessorOptions& how) {
    Said said;
    const auto processor = Open(how, &said);
    EXPECT_TRUE(processor->Finish());
    EXPECT_THAT(said.warnings, ::testing::IsEmpty());
    return processor->counts();
  }
  // The session as an overloaded run leaves it: made once, copied for every test.
  SessionProcessor::Counts Degraded() {
    static const TemporaryDirectory made;
    static const SessionProcessor::Counts counts = [this] {
      const SessionProcessor::Counts c = Process({.overload = Degrade(6)});
      fs::copy(session(), made.path(), kWhole);
      degraded_changes_ = changes_;
      return c;
    }();
    fs::copy(made.path(), session(), kWhole);
    changes_ = degraded_changes_;
    return counts;
  }

  static int CountReduced(const std::vector<int>& levels) {
    return static_cast<int>(
        std::count_if(levels.begin(), levels.end(), [](int level) { return level > 0; }));
  }
  std::vector<int> LevelsOnDisk() const {
    std::vector<int> levels;
    for (int k = 0; k < kPositions; ++k) {
      const Result<ViewRecord> record = ReadViewRecord(session() / "views", PositionId{k});
      EXPECT_TRUE(record) << record.error().message;
      levels.push_back(record ? record->quality_level : -1);
    }
    return levels;
  }

  static constexpr auto kWhole = fs::copy_options::recursive | fs::copy_options::overwrite_existing;
  static inline std::vector<std::pair<int, int>> degraded_changes_;
  const TemporaryDirectory directory_;
  std::vector<std::pair<int, int>> changes_;
};

TEST_F(Overloaded, ByDefaultTheBacklogGrowsAndEveryViewIsMadeInFull) {
  Process({});
  EXPECT_TRUE(SameBytes(ViewBytes(session()), Undisturbed()));
  EXPECT_THAT(LevelsOnDisk(), ::testing::Each(0));
  EXPECT_TRUE(changes_.empty());
}

TEST_F(Overloaded, ViewsAreReducedWhilePositionsWaitAndSaySo) {
  const SessionProcessor::Counts counts = Degraded();
  const std::vector<int> levels = LevelsOnDisk();
  EXPECT_THAT(levels, ::testing::Contains(Gt(0)));
  EXPECT_EQ(counts.views_reduced, CountReduced(levels));
  // Thirteen wait at first; the level comes down when at most three are left.
  ASSERT_FALSE(changes_.empty());
  EXPECT_EQ(changes_.front(), (std::pair{1, kPositions - 1}));
  EXPECT_LE(changes_.back().second, 3);
  EXPECT_EQ(levels.front(), 1);
  for (int k = 0; k < kPositions; ++k) {
    const ViewRecord record = ReadViewRecord(session() / "views", PositionId{k}).value();
    EXPECT_EQ(record.quality, DescribeQuality(record.quality_level));
  }
}

TEST_F(Overloaded, AReducedViewKeepsItsPoseItsFramesAndItsSize) {
  Degraded();
  const fs::path views = session() / "views";
  const ViewRecord reduced = ReadViewRecord(views, PositionId{4}).value();
  const ExrImage pixels = ReadExr(views / "000004" / "radiance.exr").value();
  ASSERT_GT(reduced.quality_level, 0);
  Process(Upgrade());
  const ViewRecord full = ReadViewRecord(views, PositionId{4}).value();
  EXPECT_EQ(full.pose.translation, reduced.pose.translation);
  EXPECT_EQ(full.pose.rotation.coeffs(), reduced.pose.rotation.coeffs());
  EXPECT_EQ(full.frames, reduced.frames);
  EXPECT_EQ(full.made_with, reduced.made_with);
  EXPECT_EQ(full.resume_json, reduced.resume_json);
  EXPECT_EQ(pixels.width, ReadExr(views / "000004" / "radiance.exr")->width);
}

TEST_F(Overloaded, WhatIsNotReducedHasTheBytesOfAnUndisturbedRun) {
  Degraded();
  const auto bytes = ViewBytes(session());
  const std::vector<int> levels = LevelsOnDisk();
  int same = 0;
  int reduced = 0;
  int different = 0;
  for (const auto& [name, content] : bytes) {
    const bool is_full = levels[static_cast<std::size_t>(std::stoi(name.substr(0, 6)))] == 0;
    if (is_full) {
      EXPECT_TRUE(content == Undisturbed().at(name)) << name;
      ++same;
    } else if (name.ends_with("disparity.exr")) {
      ++reduced;
      different += content == Undisturbed().at(name) ? 0 : 1;
    }
  }
  // A view after the level has fallen counts as reduced, since what guided its search and the maps
  // it was compared with were; it may all the same come out as if they had not been.
  EXPECT_GE(different, reduced - 1);
  EXPECT_GT(different, 0);
  EXPECT_GT(same, 0) << "no view was made in full: nothing is shown";
}

TEST_F(Overloaded, AnUpgradeGivesTheBytesOfAnUndisturbedRunAndTouchesNoOtherView) {
  Degraded();
  const std::vector<int> levels = LevelsOnDisk();
  std::map<std::string, fs::file_time_type> times;
  for (int k = 0; k < kPositions; ++k) {
    if (levels[static_cast<std::size_t>(k)] > 0) continue;
    const fs::path file = session() / "views" / ViewDirectoryName(PositionId{k}) / "radiance.exr";
    times[file.string()] = fs::last_write_time(file);
  }
  const SessionProcessor::Counts counts = Process(Upgrade());
  EXPECT_EQ(counts.views_reduced, 0);
  EXPECT_EQ(counts.views_written, kPositions - static_cast<int>(times.size()));
  EXPECT_TRUE(SameBytes(ViewBytes(session()), Undisturbed()));
  for (const auto& [file, time] : times) EXPECT_EQ(fs::last_write_time(file), time) << file;
}

TEST_F(Overloaded, AnUpgradeEndedMidwayLosesNothingAndGoesOn) {
  Degraded();
  const int reduced = CountReduced(LevelsOnDisk());
  {
    Said said;
    const auto processor = Open(Upgrade(), &said);
    while (processor->counts().views_written < 2) ASSERT_TRUE(processor->Step());
  }                                                 // killed here
  const std::vector<int> between = LevelsOnDisk();  // every view is there
  EXPECT_EQ(CountReduced(between), reduced - 2);
  Process(Upgrade());
  EXPECT_TRUE(SameBytes(ViewBytes(session()), Undisturbed()));
}

TEST_F(Overloaded, AResumedRunReducesTooAndIsUpgradedToTheSameBytes) {
  {
    Said said;
    const auto processor = Open({.overload = Degrade(3)}, &said);
    while (processor->counts().views_written < 5) ASSERT_TRUE(processor->Step());
  }
  Process({.overload = Degrade(3)});
  EXPECT_THAT(LevelsOnDisk(), ::testing::Contains(Gt(0)));
  Process(Upgrade());
  EXPECT_TRUE(SameBytes(ViewBytes(session()), Undisturbed()));
}

TEST_F(Overloaded, UpgradedViewsDoNotLookForeignAndOthersOptionsAreRefused) {
  Degraded();
  PipelineOptions other = Options();
  other.labels = 32;
  const auto refused = SessionProcessor::Open(session(), {}, other, {}, Upgrade());
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(refused.error().message, HasSubstr("made with other options"));
  Process(Upgrade());
  Said said;
  Open({}, &said);
  EXPECT_THAT(said.warnings, ::testing::IsEmpty());
}

TEST_F(Overloaded, ATemporalMergeIsNeverReduced) {
  PipelineOptions options = Options();
  options.mode = ProcessMode::kTemporal;
  Said said;
  const auto processor = Open({.overload = Degrade(2)}, &said, options);
  ASSERT_TRUE(processor->Finish());
  EXPECT_THAT(LevelsOnDisk(), ::testing::Each(0));
}

TEST(GrowingBacklog, GoesThroughEveryLevelAndUpgradesToTheBytesOfAnUndisturbedRun) {
  SessionPlan plan;
  plan.projection = Projection::Equirectangular(128, 64);
  plan.room.balls.push_back({{2.5, 1.6, 0.0}, 0.6, 1.0F});
  plan.poses = testing::GentleBend(40, 0.05);
  plan.with_prior_poses = true;
  const auto frames = testing::RenderFrames(plan);
  PipelineOptions options = QuickOptions();
  options.stereo_width = 192;
  const TemporaryDirectory undisturbed;
  testing::WriteSession(undisturbed.path(), plan, frames);
  ProcessAll(undisturbed.path(), {}, options);

  // At first all is well; then two positions come while one view is made.
  const TemporaryDirectory live;
  Result<SessionWriter> writer = SessionWriter::Create(live.path(), InfoOf(plan));
  ASSERT_TRUE(writer);
  Said said;
  auto opened = SessionProcessor::Open(live.path(), {}, options, testing::Into(&said),
                                       {.overload = Degrade(2)});
  ASSERT_TRUE(opened) << opened.error().message;
  std::set<int> levels;
  for (std::size_t k = 0; k < frames.size(); ++k) {
    ASSERT_TRUE(writer->Append(RecordOf(plan, k), frames[k]));
    if (k < 6 || k % 2 == 0) {
      ASSERT_TRUE((*opened)->Step());
    }
    levels.insert((*opened)->counts().quality_level);
  }
  ASSERT_TRUE((*opened)->Finish());
  EXPECT_THAT(levels, ElementsAre(0, 1, 2, 3, 4));
  EXPECT_EQ((*opened)->counts().quality_level, 0) << "the backlog is gone";
  std::set<int> made;
  for (const ViewDone& view : said.views) made.insert(view.quality_level);
  EXPECT_THAT(made, ElementsAre(0, 1, 2, 3, 4));

  const auto reduced = ViewBytes(live.path());
  const auto full = ViewBytes(undisturbed.path());
  for (const ViewDone& view : said.views) {
    const std::string name = ViewDirectoryName(view.position) + "/disparity.exr";
    EXPECT_EQ(reduced.at(name) == full.at(name), view.quality_level == 0) << name;
  }
  const auto upgrade =
      SessionProcessor::Open(live.path(), {}, options, testing::Into(&said), Upgrade());
  ASSERT_TRUE(upgrade);
  ASSERT_TRUE((*upgrade)->Finish());
  EXPECT_TRUE(SameBytes(ViewBytes(live.path()), full));
}

TEST(LongUpgrade, GoesOnFromASavedStateRatherThanThroughTheWholeSession) {
  // A small session of many places of which three, far apart, are of reduced quality.
  SessionPlan plan;
  plan.projection = Projection::Equirectangular(128, 64);
  plan.poses = testing::GentleBend(50, 0.05);
  plan.with_prior_poses = true;
  PipelineOptions options = QuickOptions();
  options.labels = 16;
  const TemporaryDirectory directory;
  testing::WriteSession(directory.path(), plan, testing::RenderFrames(plan));
  ProcessAll(directory.path(), {}, options);
  const auto whole = ViewBytes(directory.path());
  for (const int k : {2, 3, 44}) {
    const fs::path view = directory.path() / "views" / ViewDirectoryName(PositionId{k});
    ViewRecord record = ReadViewRecord(directory.path() / "views", PositionId{k}).value();
    record.quality_level = 2;
    testing::WriteText(view / "view.json", FormatViewRecord(record));
    testing::WriteText(view / "disparity.exr", "made with less work");
  }
  Said said;
  const auto upgrade =
      SessionProcessor::Open(directory.path(), {}, options, testing::Into(&said), Upgrade());
  ASSERT_TRUE(upgrade) << upgrade.error().message;
  ASSERT_TRUE((*upgrade)->Finish());
  EXPECT_EQ((*upgrade)->counts().views_written, 3);
  EXPECT_LT((*upgrade)->counts().positions_seen, 30) << "all of the session was read";
  EXPECT_TRUE(SameBytes(ViewBytes(directory.path()), whole));
}

}  // namespace
}  // namespace omnihdr::quality_test
