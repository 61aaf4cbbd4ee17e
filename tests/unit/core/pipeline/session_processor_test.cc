#include "core/pipeline/session_processor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <numeric>

#include "core/base/parallel_for.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/session/view_writer.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::session_processor_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using testing::FileText;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::ProcessAll;
using testing::Processed;
using testing::QuickOptions;
using testing::Said;
using testing::SameBytes;
using testing::SessionPlan;
using testing::TemporaryDirectory;
using testing::ViewBytes;
using testing::WriteSession;

using Frames = std::vector<std::vector<std::byte>>;

// A drive whose poses the journal tells: quick, and every position links.
SessionPlan GuidedPlan(int positions) {
  SessionPlan plan;
  plan.room.balls.push_back({{2.5, 1.6, 0.0}, 0.6, 1.0F});
  plan.room.balls.push_back({{1.0, -1.6, -0.5}, 0.5, 1.5F});
  plan.poses = testing::GentleBend(positions, 0.2);
  plan.with_prior_poses = true;
  return plan;
}

const SessionPlan& SevenPlaces() {
  static const SessionPlan plan = GuidedPlan(7);
  return plan;
}
const Frames& SevenFrames() {
  static const Frames frames = testing::RenderFrames(SevenPlaces());
  return frames;
}

std::vector<std::int64_t> CompletePositions(const fs::path& output) {
  const Result<std::vector<PositionId>> views = CompleteViews(output / "views");
  EXPECT_TRUE(views) << views.error().message;
  std::vector<std::int64_t> positions;
  for (const PositionId p : *views) positions.push_back(Value(p));
  return positions;
}

TEST(SessionProcessor, EveryPositionGetsAWholeView) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames());
  const Processed done = ProcessAll(directory.path());
  EXPECT_THAT(done.said.Positions(), ElementsAre(0, 1, 2, 3, 4, 5, 6));
  EXPECT_THAT(done.said.warnings, IsEmpty());
  EXPECT_EQ(done.counts.positions_seen, 7);
  EXPECT_EQ(done.counts.views_written, 7);
  EXPECT_EQ(done.counts.views_complete, 7);
  EXPECT_EQ(done.counts.positions_without_pixels, 0);
  EXPECT_EQ(done.counts.backlog, 0);
  EXPECT_THAT(CompletePositions(directory.path()), ElementsAre(0, 1, 2, 3, 4, 5, 6));
  for (int k = 0; k < 7; ++k) {
    const fs::path view = directory.path() / "views" / ViewDirectoryName(PositionId{k});
    const Result<ExrImage> radiance = ReadExr(view / "radiance.exr");
    ASSERT_TRUE(radiance) << radiance.error().message;
    EXPECT_EQ(radiance->width, 256);
    EXPECT_EQ(radiance->height, 128);
    for (const char* name : {"R", "G", "B", "origin"}) {
      ASSERT_TRUE(radiance->channels.contains(name));
      for (const float v : radiance->channels.at(name).values()) ASSERT_TRUE(std::isfinite(v));
    }
    const Result<ExrImage> disparity = ReadExr(view / "disparity.exr");
    ASSERT_TRUE(disparity) << disparity.error().message;
    EXPECT_TRUE(disparity->channels.contains("disparity"));
    EXPECT_TRUE(disparity->channels.contains("confidence"));
    EXPECT_TRUE(ReadImage(view / "preview.jpg"));
  }
}

TEST(SessionProcessor, TheViewsRecordSaysWhereItStandsAndWhatItWasMadeOf) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames());
  ProcessAll(directory.path());
  const Result<ViewRecord> record = ReadViewRecord(directory.path() / "views", PositionId{3});
  ASSERT_TRUE(record) << record.error().message;
  EXPECT_EQ(record->position, PositionId{3});
  EXPECT_EQ(record->reference, 3U);
  EXPECT_THAT(record->frames, ElementsAre(1U, 2U, 3U, 4U, 5U));
  EXPECT_EQ(record->mode, "spatiotemporal");
  EXPECT_EQ(record->chain, 0);
  EXPECT_LT((record->pose.translation - SevenPlaces().poses[3].translation).norm(), 1e-6);
  EXPECT_GT(record->radiance_max, record->radiance_min);
  EXPECT_GT(record->valid_fraction, 0.9);
  EXPECT_LE(record->valid_fraction, 1.0);
}

TEST(SessionProcessor, TheRecordHoldsNothingThatDiffersFromRunToRun) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames(), 3);
  ProcessAll(directory.path());
  for (int k = 0; k < 3; ++k) {
    const nlohmann::json view = nlohmann::json::parse(
        FileText(directory.path() / "views" / ViewDirectoryName(PositionId{k}) / "view.json"));
    EXPECT_FALSE(view.contains("seconds"));
    EXPECT_EQ(view.dump().find("seconds"), std::string::npos);
  }
  EXPECT_NE(FileText(directory.path() / "timings.jsonl").find("\"seconds\""), std::string::npos);
}

TEST(SessionProcessor, AViewIsCompleteAtMostTwoPositionsLater) {
  const TemporaryDirectory directory;
  Result<SessionWriter> writer = SessionWriter::Create(directory.path(), InfoOf(SevenPlaces()));
  ASSERT_TRUE(writer);
  Said said;
  const auto processor = testing::OpenProcessor(directory.path(), &said);
  ASSERT_NE(processor, nullptr);
  ASSERT_EQ(processor->Step().value(), SessionProcessor::Progress::kNothingNew);
  for (int k = 0; k < 7; ++k) {
    const auto index = static_cast<std::size_t>(k);
    ASSERT_TRUE(writer->Append(RecordOf(SevenPlaces(), index), SevenFrames()[index]));
    ASSERT_EQ(processor->Step().value(), SessionProcessor::Progress::kWorked);
    ASSERT_EQ(processor->Step().value(), SessionProcessor::Progress::kNothingNew);
    std::vector<std::int64_t> expected(static_cast<std::size_t>(std::max(0, k - 1)));
    std::iota(expected.begin(), expected.end(), 0);
    EXPECT_EQ(CompletePositions(directory.path()), expected) << "after position " << k;
  }
  ASSERT_TRUE(processor->Finish());
  EXPECT_EQ(CompletePositions(directory.path()).size(), 7U);
}

TEST(SessionProcessor, FollowingTheCaptureGivesTheBytesOfProcessingLater) {
  const TemporaryDirectory live;
  Result<SessionWriter> writer = SessionWriter::Create(live.path(), InfoOf(SevenPlaces()));
  ASSERT_TRUE(writer);
  Said said;
  const auto processor = testing::OpenProcessor(live.path(), &said);
  ASSERT_NE(processor, nullptr);
  for (std::size_t k = 0; k < 7; ++k) {
    ASSERT_TRUE(writer->Append(RecordOf(SevenPlaces(), k), SevenFrames()[k]));
    ASSERT_TRUE(processor->Step());
  }
  ASSERT_TRUE(processor->Finish());

  const TemporaryDirectory later;
  WriteSession(later.path(), SevenPlaces(), SevenFrames());
  ProcessAll(later.path());
  EXPECT_TRUE(SameBytes(ViewBytes(live.path()), ViewBytes(later.path())));
}

TEST(SessionProcessor, TwoRunsGiveTheSameBytesOnAnyNumberOfWorkers) {
  const TemporaryDirectory session;
  WriteSession(session.path(), SevenPlaces(), SevenFrames());
  const TemporaryDirectory a;
  const TemporaryDirectory b;
  SetWorkerCount(1);
  ProcessAll(session.path(), a.path());
  SetWorkerCount(2);
  ProcessAll(session.path(), b.path());
  SetWorkerCount(0);
  // Four files a view, and keyframe.bin of all but the last two.
  EXPECT_EQ(ViewBytes(a.path()).size(), 33U);
  EXPECT_TRUE(SameBytes(ViewBytes(a.path()), ViewBytes(b.path())));
}

TEST(SessionProcessor, AnotherOutputDirectoryLeavesTheSessionAlone) {
  const TemporaryDirectory session;
  const TemporaryDirectory output;
  WriteSession(session.path(), SevenPlaces(), SevenFrames(), 3);
  ProcessAll(session.path(), output.path() / "deep" / "er");
  EXPECT_FALSE(fs::exists(session.path() / "views"));
  EXPECT_FALSE(fs::exists(session.path() / "timings.jsonl"));
  EXPECT_EQ(CompletePositions(output.path() / "deep" / "er").size(), 3U);
}

TEST(SessionProcessor, ACompleteSessionIsLeftAsItIsAndSaysSo) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames());
  ProcessAll(directory.path());
  std::map<std::string, fs::file_time_type> times;
  for (const auto& entry : fs::recursive_directory_iterator(directory.path())) {
    times[entry.path().string()] = fs::last_write_time(entry.path());
  }
  const Processed again = ProcessAll(directory.path());
  EXPECT_EQ(again.counts.views_written, 0);
  EXPECT_EQ(again.counts.views_complete, 7);
  EXPECT_EQ(again.said.Positions().size(), 7U);
  for (const ViewDone& view : again.said.views) EXPECT_TRUE(view.already_complete);
  for (const auto& [path, time] : times) {
    // Opening may look for what an interrupted writer left in views/.
    EXPECT_EQ(fs::last_write_time(path), time) << path;
  }
}

TEST(SessionProcessor, HalfWrittenViewsAreRemovedAndMadeAgain) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames(), 4);
  ProcessAll(directory.path());
  const auto whole = ViewBytes(directory.path());
  // No view.json: not complete.
  fs::remove(directory.path() / "views" / "000002" / "view.json");
  ProcessAll(directory.path());
  EXPECT_TRUE(SameBytes(whole, ViewBytes(directory.path())));
}

TEST(SessionProcessor, ResumedAfterLosingTheLastViewsItGivesTheSameBytes) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames());
  ProcessAll(directory.path());
  const auto whole = ViewBytes(directory.path());
  for (const int lost : {2, 4}) {
    for (int k = 7 - lost; k < 7; ++k) {
      fs::remove_all(directory.path() / "views" / ViewDirectoryName(PositionId{k}));
    }
    const Processed resumed = ProcessAll(directory.path());
    EXPECT_EQ(resumed.counts.views_written, lost);
    EXPECT_TRUE(SameBytes(whole, ViewBytes(directory.path()))) << "after losing the last " << lost;
  }
}

TEST(SessionProcessor, AViewMissingInTheMiddleIsMadeAgain) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames());
  ProcessAll(directory.path());
  const auto whole = ViewBytes(directory.path());
  fs::remove_all(directory.path() / "views" / "000001");
  fs::remove_all(directory.path() / "views" / "000004");
  const Processed resumed = ProcessAll(directory.path());
  EXPECT_EQ(resumed.counts.views_written, 2);
  EXPECT_TRUE(SameBytes(whole, ViewBytes(directory.path())));
}

TEST(SessionProcessor, AFreshProcessorTakesOverMidWay) {
  const TemporaryDirectory uninterrupted;
  WriteSession(uninterrupted.path(), SevenPlaces(), SevenFrames());
  ProcessAll(uninterrupted.path());

  const TemporaryDirectory directory;
  Result<SessionWriter> writer = SessionWriter::Create(directory.path(), InfoOf(SevenPlaces()));
  ASSERT_TRUE(writer);
  std::size_t next = 0;
  for (const std::size_t until : {2U, 5U, 7U}) {
    Said said;
    const auto processor = testing::OpenProcessor(directory.path(), &said);
    ASSERT_NE(processor, nullptr);
    for (; next < until; ++next) {
      ASSERT_TRUE(writer->Append(RecordOf(SevenPlaces(), next), SevenFrames()[next]));
      while (processor->Step().value() == SessionProcessor::Progress::kWorked) {
      }
    }
    if (until == 7U) {
      ASSERT_TRUE(processor->Finish());
    }  // otherwise it is killed here
  }
  EXPECT_TRUE(SameBytes(ViewBytes(uninterrupted.path()), ViewBytes(directory.path())));
}

TEST(SessionProcessor, PosesAreFoundWhenNobodyTellsThem) {
  SessionPlan plan = GuidedPlan(4);
  plan.with_prior_poses = false;
  plan.projection = Projection::Equirectangular(512, 256);
  const TemporaryDirectory directory;
  WriteSession(directory.path(), plan, testing::RenderFrames(plan));
  const Processed done = ProcessAll(directory.path());
  EXPECT_EQ(done.counts.views_written, 4);
  for (int k = 0; k < 4; ++k) {
    const Result<ViewRecord> record = ReadViewRecord(directory.path() / "views", PositionId{k});
    ASSERT_TRUE(record);
    EXPECT_EQ(record->chain, 0);
    EXPECT_TRUE(record->metric_scale) << "position " << k;
    EXPECT_LT(
        (record->pose.translation - plan.poses[static_cast<std::size_t>(k)].translation).norm(),
        0.05)
        << "position " << k;
  }
}

TEST(SessionProcessor, ACompassCarriesAPoseOverAPictureThatShowsNothingAndTheViewSaysSo) {
  const TemporaryDirectory directory;
  SessionPlan plan;
  plan.room.low = {-5.0, -3.0, -1.5};
  plan.room.detail_m = 0.5;
  plan.poses = testing::GentleBend(8, 0.15);
  plan.projection = Projection::Equirectangular(320, 160);
  plan.with_heading = true;
  Frames frames = testing::RenderFrames(plan);
  const Image<std::uint8_t> grey(320, 160, 3, 90);
  frames[4] = *EncodePng(grey.view());
  WriteSession(directory.path(), plan, frames);
  for (const double sigma_deg : {0.0, 2.0}) {
    PipelineOptions options = QuickOptions();
    options.heading_sigma_deg = sigma_deg;
    const fs::path out = directory.path() / fmt::format("out{}", sigma_deg);
    ProcessAll(directory.path(), out, options);
    const Result<ViewRecord> view = ReadViewRecord(out / "views", PositionId{4});
    ASSERT_TRUE(view) << view.error().message;
    EXPECT_EQ(view->dead_reckoned.empty(), sigma_deg == 0.0);
    EXPECT_EQ(view->chain == 0, sigma_deg > 0.0);
    if (sigma_deg == 0.0) continue;
    EXPECT_THAT(view->dead_reckoned, HasSubstr("position 4 shows 0 usable features"));
    EXPECT_THAT(view->warnings.back(), HasSubstr("pose by heading and odometer alone"));
    const Pose truth = plan.poses[0].Inverse() * plan.poses[4];
    EXPECT_LT((view->pose.translation - truth.translation).norm(), 0.05);
    EXPECT_LT(view->pose.rotation.angularDistance(truth.rotation), 0.03);
    ASSERT_TRUE(view->sigma);
    EXPECT_NEAR(view->sigma->rotation_deg.z(), 2.83, 0.01);
    // It shows nothing and borrows nothing.
    EXPECT_THAT(view->frames, ElementsAre(4U));
    const Result<ViewRecord> next = ReadViewRecord(out / "views", PositionId{5});
    ASSERT_TRUE(next);
    EXPECT_EQ(next->chain, 0);
    EXPECT_EQ(next->dead_reckoned, "");
    EXPECT_THAT(next->frames, ElementsAre(3U, 5U, 6U, 7U));
  }
}

TEST(SessionProcessor, TheOutputKeepsTheCamerasAxesWhenAsked) {
  PipelineOptions options = QuickOptions();
  options.orientation = OutputOrientation::kCamera;
  options.output_width = 128;
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames(), 4);
  ProcessAll(directory.path(), {}, options);
  Result<ViewRecord> record = ReadViewRecord(directory.path() / "views", PositionId{3});
  ASSERT_TRUE(record);
  EXPECT_LT(record->orientation.angularDistance(Eigen::Quaterniond::Identity()), 1e-9);
  EXPECT_EQ(ReadExr(directory.path() / "views" / "000003" / "radiance.exr")->width, 128);

  const TemporaryDirectory aligned;
  ProcessAll(directory.path(), aligned.path());
  record = ReadViewRecord(aligned.path() / "views", PositionId{3});
  ASSERT_TRUE(record);
  EXPECT_LT(record->orientation.angularDistance(SevenPlaces().poses[3].rotation.conjugate()), 1e-6);
}

TEST(SessionProcessor, AMaskIsUsed) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames(), 3);
  Image<std::uint8_t> mask(256, 128, 1, 255);
  for (int y = 100; y < 128; ++y) std::fill_n(mask.row(y), 256, std::uint8_t{0});
  const std::vector<std::byte> png = EncodePng(mask.view()).value();
  testing::WriteText(directory.path() / "mask.png",
                     {reinterpret_cast<const char*>(png.data()), png.size()});
  PipelineOptions options = QuickOptions();
  options.mask_file = (directory.path() / "mask.png").string();
  ProcessAll(directory.path(), {}, options);
  const Result<ExrImage> view = ReadExr(directory.path() / "views" / "000001" / "radiance.exr");
  ASSERT_TRUE(view);
  for (int x = 0; x < 256; ++x) {
    EXPECT_EQ(view->channels.at("origin").at(x, 124), 0.0F);
    EXPECT_EQ(view->channels.at("G").at(x, 124), 0.0F);
    EXPECT_NE(view->channels.at("origin").at(x, 60), 0.0F);
  }
}

TEST(SessionProcessor, OptionsOutOfRangeAreRefusedByName) {
  const TemporaryDirectory directory;
  WriteSession(directory.path(), SevenPlaces(), SevenFrames(), 1);
  PipelineOptions options = QuickOptions();
  options.labels = 3;
  const auto processor = SessionProcessor::Open(directory.path(), {}, options, {});
  ASSERT_FALSE(processor);
  EXPECT_EQ(processor.error().kind, ErrorKind::kConfig);
  EXPECT_NE(processor.error().message.find("stereo.labels"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::session_processor_test
