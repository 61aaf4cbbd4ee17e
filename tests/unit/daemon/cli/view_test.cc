#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "core/image/exr.h"
#include "core/pipeline/session_processor.h"
#include "daemon/cli/command.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::view_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

testing::SessionPlan DriveThroughARoom() {
  testing::SessionPlan plan;
  plan.room.detail_m = 1.0;
  plan.room.balls.push_back({{2.0, 1.6, 0.0}, 0.5, 1.5F});
  plan.poses = testing::GentleBend(5, 0.2);
  plan.with_prior_poses = true;
  plan.exposures_s = {0.1, 0.4, 1.6};
  return plan;
}

// A processed drive of five positions 0.2 m apart with known poses.
class ViewCommand : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    directory_ = new testing::TemporaryDirectory();
    const testing::SessionPlan plan = DriveThroughARoom();
    testing::WriteSession(directory_->path(), plan, testing::RenderFrames(plan));
    PipelineOptions options;
    options.stereo_width = 256;
    options.labels = 48;
    const auto processor =
        SessionProcessor::Open(directory_->path(), {}, options, ProcessorCallbacks{}).value();
    ASSERT_TRUE(processor->Finish());
  }
  static void TearDownTestSuite() {
    delete directory_;
    directory_ = nullptr;
  }
  // What it printed, or its message.
  static std::string Run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"view", directory_->path().string()});
    std::string printed;
    const Result<int> result =
        testing::RunCommand({AddViewCommand}, std::move(arguments), &printed);
    return result ? printed : result.error().message;
  }
  static std::string Out() { return (directory_->path() / "new.exr").string(); }
  static testing::TemporaryDirectory* directory_;
};
testing::TemporaryDirectory* ViewCommand::directory_ = nullptr;

// Median and 90th percentile of |log10| of green against what a camera there would see.
std::pair<double, double> ErrorsAt(const fs::path& file, const Pose& place) {
  const ExrImage exr = ReadExr(file).value();
  const testing::Truth truth = testing::Render(
      DriveThroughARoom().room, Projection::Equirectangular(exr.width, exr.height), place);
  std::vector<double> errors;
  for (int y = 0; y < exr.height; ++y) {
    for (int x = 0; x < exr.width; ++x) {
      if (exr.channels.at("origin").at(x, y) == 0.0F) continue;
      errors.push_back(
          std::abs(std::log10(exr.channels.at("G").at(x, y) / truth.radiance.at(x, y, 1))));
    }
  }
  std::sort(errors.begin(), errors.end());
  return {errors[errors.size() / 2], errors[errors.size() * 9 / 10]};
}

TEST_F(ViewCommand, APlaceBetweenPositionsIsSeenAsACameraThereWould) {
  const std::string printed = Run({"--between", "2,3", "--out", Out()});
  EXPECT_THAT(printed, HasSubstr("positions 2, 3,"));
  Pose middle;
  middle.translation =
      0.5 * (DriveThroughARoom().poses[2].translation + DriveThroughARoom().poses[3].translation);
  const auto [median, p90] = ErrorsAt(Out(), middle);
  EXPECT_LT(median, 0.02);
  EXPECT_LT(p90, 0.12);
}

TEST_F(ViewCommand, APositionsPlaceCanBeShownByTheOthersAlone) {
  EXPECT_THAT(Run({"--place-of", "2", "--sources", "2", "--out", Out()}),
              HasSubstr("positions 1, 3"));
  const auto [median, p90] =
      ErrorsAt(Out(), {Eigen::Quaterniond::Identity(), DriveThroughARoom().poses[2].translation});
  EXPECT_LT(median, 0.02);
  EXPECT_LT(p90, 0.12);
}

TEST_F(ViewCommand, WhatCannotBeShownIsSaid) {
  EXPECT_THAT(Run({"--out", Out()}), HasSubstr("expected one of --at, --between and --place-of"));
  EXPECT_THAT(Run({"--at", "0,0,0", "--fraction", "0.3", "--out", Out()}),
              HasSubstr("--fraction requires --between"));
  EXPECT_THAT(Run({"--between", "2,9", "--out", Out()}),
              HasSubstr("--between: 9, expected a position with a view, 0 to 4"));
  EXPECT_THAT(Run({"--at", "0,0,0", "--chain", "7", "--out", Out()}),
              HasSubstr("chain 7: no other view"));
  EXPECT_THAT(Run({"--at", "0,0,0", "--views", "/nonexistent", "--out", Out()}),
              HasSubstr("/nonexistent"));
}

}  // namespace
}  // namespace omnihdr::view_test
