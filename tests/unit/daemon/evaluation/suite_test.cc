#include "daemon/evaluation/suite.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <set>

#include "core/session/view_writer.h"
#include "daemon/evaluation/rivals.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::suite_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

TEST(Suite, EveryCaseHasANameOfItsOwnAndIsAValidDrive) {
  for (const SuiteKind kind : {SuiteKind::kQuick, SuiteKind::kTargets}) {
    std::set<std::string> names;
    for (const SuiteCase& drive : SuiteCases(kind)) {
      EXPECT_TRUE(names.insert(drive.name).second) << drive.name;
      EXPECT_TRUE(drive.simulate.Validate()) << drive.name;
    }
  }
}

TEST(Suite, ACaseIsSimulatedProcessedAndJudgedAgainstItsRivals) {
  const testing::TemporaryDirectory directory;
  SuiteCase drive = SuiteCases(SuiteKind::kQuick).front();
  drive.simulate.simulation.width = 256;
  drive.simulate.positions = 3;
  PipelineOptions options;
  options.stereo_width = 256;
  options.labels = 32;
  const Result<SuiteScore> score = RunSuiteCase(drive, options, directory.path());
  ASSERT_TRUE(score) << score.error().message;
  ASSERT_TRUE(score->ours.mean && score->oracle.mean && score->unregistered.mean);
  EXPECT_EQ(score->ours.complete, 3);
  EXPECT_EQ(score->oracle.complete, 3);
  ASSERT_TRUE(score->thesis.mean);
  EXPECT_EQ(score->thesis.complete, 3);
  // True depth is known to the oracle alone, and blur is what no registration gives.
  EXPECT_LT(*score->oracle.mean->disparity_bad1, 0.02);
  EXPECT_GT(score->unregistered.mean->view_rmse, 1.3 * score->oracle.mean->view_rmse);
  EXPECT_LT(*score->oracle.mean->rotation_deg, 1e-4);
  EXPECT_GT(score->cpu_s, 0.0);
  EXPECT_TRUE(fs::exists(directory.path() / (drive.name + ".png")));
  EXPECT_GT(score->ours.mean->range_share, 0.8);
  EXPECT_LT(score->ours.mean->range_share, 1.2);
  EXPECT_THAT(FormatScoreJson(score->ours), HasSubstr("\"range_share\""));

  // The oracle is sure of its true depth, and right to be.
  EXPECT_LT(score->oracle.reliability.CalibrationError(), 0.03);
  EXPECT_FALSE(score->ours.reliability.empty());
  const std::string table = FormatSuiteTable({*score});
  EXPECT_THAT(table, HasSubstr(drive.name));
  EXPECT_THAT(table, HasSubstr("called right with"));
  EXPECT_THAT(FormatScoreJson(score->ours), HasSubstr("\"calibration_error\""));
  EXPECT_THAT(FormatSuiteMarkdown({*score}), HasSubstr("](" + drive.name + ".png)"));
  EXPECT_TRUE(nlohmann::json::accept(FormatSuiteJson({*score})));

  const Result<SuiteScore> again = RunSuiteCase(drive, options, directory.path());
  ASSERT_FALSE(again);
  EXPECT_THAT(again.error().message, HasSubstr("already there"));
}

TEST(Suite, WhatIsMissedIsSaidWithItsLimit) {
  SuiteScore score;
  score.drive.name = "here";
  score.checks = {{"error over oracle's", 1.3, 1.15, false}, {"lowest SSIM", 0.97, 0.95, true}};
  const std::string table = FormatSuiteTable({score});
  EXPECT_THAT(table, HasSubstr("here: error over oracle's 1.3 (must <= 1.15)"));
  EXPECT_THAT(table, Not(HasSubstr("lowest SSIM")));
  score.checks = {{"lowest SSIM", 0.97, 0.95, true}};
  EXPECT_THAT(FormatSuiteTable({score}), HasSubstr("Every target that must be reached is."));
}

TEST(Rivals, NeedASceneThatIsKnown) {
  const testing::TemporaryDirectory directory;
  testing::SessionPlan plan;
  plan.poses = testing::GentleBend(2, 0.2);
  testing::WriteSession(directory.path(), plan, testing::RenderFrames(plan));
  const Status written =
      WriteRivalViews(directory.path(), Rival::kOracle, {}, 0, directory.path() / "oracle");
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, HasSubstr("nothing is known of the scene"));
}

}  // namespace
}  // namespace omnihdr::suite_test
