#include <gtest/gtest.h>

#include <filesystem>
#include <numbers>
#include <vector>

#include "core/image/exr.h"
#include "core/photometry/measure.h"
#include "core/pipeline/session_processor.h"
#include "core/quality/disparity_metrics.h"
#include "core/quality/pose_metrics.h"
#include "core/quality/radiance_metrics.h"
#include "core/session/view_writer.h"
#include "core/stereo/view_merge.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::chain_test {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 512;
constexpr int kHeight = kWidth / 2;
constexpr int kPositions = 7;
constexpr double kStep = 0.2;

// A drive through a room lit over two decades, each frame with one exposure of a saw-tooth: from
// session directory to views, measured against the truth instead of compared with stored pictures,
// so that a better chain passes and a worse one does not.
testing::SessionPlan Drive() {
  testing::SessionPlan plan;
  plan.room.detail_m = 0.45;
  plan.room.range_decades = 2.5F;
  plan.room.balls.push_back({{2.5, 1.8, 0.0}, 0.6, 1.5F});
  plan.room.balls.push_back({{0.8, -1.7, -0.4}, 0.5, 0.7F});
  plan.room.balls.push_back({{-1.5, 1.5, 0.3}, 0.4, 1.0F});
  plan.poses = testing::GentleBend(kPositions, kStep);
  plan.projection = Projection::Equirectangular(kWidth, kHeight);
  plan.exposures_s = {0.15, 0.6, 2.4};
  plan.noise = {.read = 1.0, .gain = 0.05, .prnu = 0.003};
  return plan;
}

struct Scores {
  double merged = 0.0;    // log10 RMSE of luminance, no scale fitted
  double own = 0.0;       // of the own frame alone
  double bad1 = 0.0;      // share of disparities off by more than a pixel of 1536
  double relative = 0.0;  // median relative disparity error
  double rotation_deg = 0.0;
  double translation_percent = 0.0;
};

Image<float> Interleaved(const ExrImage& exr) {
  Image<float> rgb(exr.width, exr.height, 3);
  const std::array<const Image<float>*, 3> planes = {&exr.channels.at("R"), &exr.channels.at("G"),
                                                     &exr.channels.at("B")};
  for (int y = 0; y < exr.height; ++y) {
    for (int x = 0; x < exr.width; ++x) {
      for (int c = 0; c < 3; ++c) rgb.at(x, y, c) = planes[static_cast<std::size_t>(c)]->at(x, y);
    }
  }
  return rgb;
}

std::vector<Scores> ProcessAndScore() {
  const testing::SessionPlan plan = Drive();
  const testing::TemporaryDirectory session;
  testing::WriteSession(session.path(), plan, testing::RenderFrames(plan));
  PipelineOptions options;
  options.stereo_width = kWidth;
  options.labels = 64;
  options.noise = plan.noise;
  options.orientation = OutputOrientation::kCamera;
  Result<std::unique_ptr<SessionProcessor>> processor =
      SessionProcessor::Open(session.path(), {}, options, {});
  EXPECT_TRUE(processor) << processor.error().message;
  if (!processor) return {};
  const Status finished = (*processor)->Finish();
  EXPECT_TRUE(finished) << finished.error().message;

  std::vector<Pose> poses;
  std::vector<Scores> scores;
  const ComparisonArea area = SphereArea(plan.projection);
  for (int k = 0; k < kPositions; ++k) {
    const auto index = static_cast<std::size_t>(k);
    const fs::path view = session.path() / "views" / ViewDirectoryName(PositionId{k});
    const Result<ViewRecord> record = ReadViewRecord(session.path() / "views", PositionId{k});
    const Result<ExrImage> radiance = ReadExr(view / "radiance.exr");
    const Result<ExrImage> disparity = ReadExr(view / "disparity.exr");
    EXPECT_TRUE(record && radiance && disparity);
    if (!record || !radiance || !disparity) return {};
    EXPECT_EQ(record->chain, 0);
    poses.push_back(record->pose);

    const testing::Truth truth = Render(plan.room, plan.projection, plan.poses[index]);
    Image<float> true_disparity(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        true_disparity.at(x, y) = 1.0F / truth.distance.at(x, y);
      }
    }
    // What the own frame alone says, on the same pixels.
    const double seconds = plan.exposures_s[index % plan.exposures_s.size()];
    const Result<DecodedImage> frame = ReadImage(session.path() / RecordOf(plan, index).file);
    EXPECT_TRUE(frame);
    const std::vector<ExposedFrame> frames = {{&*frame, {ExposureTime::Seconds(seconds), {}}}};
    MeasureOptions measure;
    measure.noise = plan.noise;
    const Result<Measurement> own =
        Measure(frames, plan.projection, *Response::Linear(), 8, {}, measure);
    EXPECT_TRUE(own);

    Scores s;
    s.merged = CompareRadiance(Interleaved(*radiance), truth.radiance, area).log10_rmse_unscaled;
    s.own = CompareRadiance(own->radiance, truth.radiance, area).log10_rmse_unscaled;
    const DisparityErrors errors =
        CompareDisparity(disparity->channels.at("disparity"), true_disparity, kStep, area);
    s.bad1 = errors.bad1;
    s.relative = errors.median_relative;
    scores.push_back(s);
  }
  const ChainErrors chain = ComparePoses(poses, plan.poses, false);
  for (std::size_t k = 0; k < scores.size(); ++k) {
    scores[k].rotation_deg = chain.positions[k].rotation_deg;
    scores[k].translation_percent = chain.positions[k].translation_percent;
  }
  return scores;
}

TEST(Chain, FromFramesToViewsItIsAsGoodAsItWas) {
  const std::vector<Scores> scores = ProcessAndScore();
  ASSERT_EQ(scores.size(), static_cast<std::size_t>(kPositions));
  std::string table;
  double merged = 0.0;
  double own = 0.0;
  for (const Scores& s : scores) {
    table += fmt::format(
        "radiance {:.4f} (own frame {:.4f}), disparity bad1 {:.3f} median {:.4f}, rotation {:.3f} "
        "deg, "
        "translation {:.2f} %\n",
        s.merged, s.own, s.bad1, s.relative, s.rotation_deg, s.translation_percent);
    merged += s.merged / kPositions;
    own += s.own / kPositions;
  }
  SCOPED_TRACE(table);
  RecordProperty("table", table);
  EXPECT_LT(merged, 0.045);
  EXPECT_LT(merged, 0.4 * own);
  for (std::size_t k = 0; k < scores.size(); ++k) {
    const Scores& s = scores[k];
    // At either end a view has neighbours on one side only.
    const bool is_inner = k >= 2 && k + 2 < scores.size();
    EXPECT_LT(s.merged, is_inner ? 0.035 : 0.08) << "position " << k;
    EXPECT_LT(s.merged, s.own) << "position " << k;
    EXPECT_LT(s.bad1, is_inner ? 0.2 : 0.45) << "position " << k;
    EXPECT_LT(s.relative, is_inner ? 0.03 : 0.06) << "position " << k;
    EXPECT_LT(s.rotation_deg, 0.15) << "position " << k;
    EXPECT_LT(s.translation_percent, 3.0) << "position " << k;
  }
}

}  // namespace
}  // namespace omnihdr::chain_test
