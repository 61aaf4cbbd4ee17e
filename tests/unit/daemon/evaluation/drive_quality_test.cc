// What whole drives through simulated scenes have to reach, as `omnihdr evaluate` measures it.

#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "core/pipeline/session_processor.h"
#include "daemon/evaluation/evaluation.h"
#include "drivers/sim/simulation.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::drive_quality_test {
namespace {

namespace fs = std::filesystem;

sim::SimulateOptions SmallDrive(sim::SceneKind scene, double start_s) {
  sim::SimulateOptions options;
  options.simulation.scene = scene;
  options.simulation.width = 384;
  options.simulation.samples = 1;
  options.positions = 5;
  options.bracket.start = ExposureTime::Seconds(start_s);
  options.bracket.step = Stops{1.6};
  options.bracket.count = 3;
  return options;
}

PipelineOptions SmallPipeline() {
  PipelineOptions options;
  options.stereo_width = 384;
  options.labels = 64;
  return options;
}

SessionScore Judge(const fs::path& session, const fs::path& output,
                   const PipelineOptions& options) {
  auto processor = SessionProcessor::Open(session, output, options, {});
  EXPECT_TRUE(processor) << processor.error().message;
  while (true) {
    const auto progress = (*processor)->Step();
    EXPECT_TRUE(progress) << progress.error().message;
    if (!progress || *progress == SessionProcessor::Progress::kNothingNew) break;
  }
  EXPECT_TRUE((*processor)->Finish());
  EvaluationOptions evaluation;
  evaluation.views = output / "views";
  Result<SessionScore> score = EvaluateSession(session, evaluation, {});
  EXPECT_TRUE(score) << score.error().message;
  return std::move(*score);
}

TEST(DriveQuality, WhereTheViewsMergedChangeNoSeamStandsOutOfTheNoise) {
  for (const auto& [scene, start_s] :
       {std::pair(sim::SceneKind::kHall, 0.0008), std::pair(sim::SceneKind::kYard, 0.0002)}) {
    const testing::TemporaryDirectory directory;
    const fs::path session = directory.path() / "s";
    ASSERT_TRUE(WriteSimulatedSession(session, SmallDrive(scene, start_s), {}));
    const SessionScore score = Judge(session, directory.path(), SmallPipeline());
    ASSERT_TRUE(score.mean && score.mean->seam_noise);
    RecordProperty(std::string(sim::ToString(scene)) + "_seam_noise",
                   std::to_string(*score.mean->seam_noise));
    EXPECT_LT(*score.mean->seam_noise, 1.0) << sim::ToString(scene);
    // As a change of radiance: 7 %.
    EXPECT_LT(*score.mean->seam_log10, 0.03) << sim::ToString(scene);
    double visible = 0.0;
    double borders = 0.0;
    for (const PositionScore& position : score.positions) {
      ASSERT_TRUE(position.seams);
      const auto count = static_cast<double>(position.seams->borders);
      visible += count * position.seams->visible;
      borders += count;
      // A few dozen are one line, along which the share is all or nothing.
      constexpr double kEnough = 200.0;
      if (count >= kEnough) {
        EXPECT_LT(position.seams->visible, 0.25) << sim::ToString(scene);
      }
    }
    EXPECT_LT(visible, 0.1 * borders) << sim::ToString(scene);
  }
}

TEST(DriveQuality, OfWhatAHeadOfCoarseSensorsCallsRightAsMuchIsRight) {
  // One short drive's poses are off together, and all its distances with them: what a confidence
  // says holds of several.
  ReliabilityCurve reliability;
  for (const std::uint64_t seed : {1, 2, 3}) {
    const testing::TemporaryDirectory directory;
    const fs::path session = directory.path() / "s";
    sim::SimulateOptions drive = SmallDrive(sim::SceneKind::kHall, 0.0008);
    drive.simulation.layout = Layout::kRig;
    drive.simulation.sensor_width = 192;
    drive.simulation.seed = seed;
    ASSERT_TRUE(WriteSimulatedSession(session, drive, {}));
    PipelineOptions options = SmallPipeline();
    options.stereo_width = 512;
    options.labels = PipelineOptions{}.labels;
    const SessionScore score = Judge(session, directory.path(), options);
    ASSERT_FALSE(score.reliability.empty());
    RecordProperty("gap_" + std::to_string(seed),
                   std::to_string(score.reliability.CalibrationError()));
    reliability.Add(score.reliability);
  }
  RecordProperty("bins", FormatReliability(reliability));
  EXPECT_LT(reliability.CalibrationError(), 0.1) << FormatReliability(reliability);
  double weight = 0.0;
  for (const ReliabilityCurve::Bin& bin : reliability.Bins()) weight += bin.weight;
  for (const ReliabilityCurve::Bin& bin : reliability.Bins()) {
    if (bin.weight < 0.05 * weight || bin.confidence < 0.6) continue;
    EXPECT_GT(bin.right, bin.confidence - 0.12) << FormatReliability(reliability);
  }
}

TEST(DriveQuality, MoversAreTakenAwayWithoutMasksWhereEnoughViewsSeePast) {
  const testing::TemporaryDirectory directory;
  const fs::path session = directory.path() / "s";
  sim::SimulateOptions drive = SmallDrive(sim::SceneKind::kYard, 0.001);
  drive.simulation.width = 512;
  drive.bracket.step = Stops{1.0};
  drive.simulation.movers.count = 3;
  drive.simulation.movers.speed = 1.5 / drive.spacing_m;
  ASSERT_TRUE(WriteSimulatedSession(session, drive, {}));
  PipelineOptions options = SmallPipeline();
  options.stereo_width = 512;
  const SessionScore kept = Judge(session, directory.path() / "keep", options);
  options.movers = MergeMovers::kRemove;
  const SessionScore removed = Judge(session, directory.path() / "remove", options);
  ASSERT_TRUE(kept.mean && kept.mean->movers_off && removed.mean && removed.mean->movers_off);
  RecordProperty("keep", std::to_string(*kept.mean->movers_off));
  RecordProperty("remove", std::to_string(*removed.mean->movers_off));
  RecordProperty("left_in", std::to_string(*removed.mean->movers_own_off));
  EXPECT_LT(*kept.mean->movers_off, 0.005);
  // Of what is in the way when they are left in, more than half is gone.
  EXPECT_LT(*removed.mean->movers_off, 0.5 * *removed.mean->movers_own_off);
}

}  // namespace
}  // namespace omnihdr::drive_quality_test
