#include <gtest/gtest.h>

#include <filesystem>
#include <string>

#include "core/base/parallel_for.h"
#include "core/pipeline/session_processor.h"
#include "core/session/view_writer.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::methods_test {
namespace {

namespace fs = std::filesystem;
using testing::ProcessAll;
using testing::Processed;
using testing::SameBytes;
using testing::TemporaryDirectory;
using testing::ViewBytes;

testing::SessionPlan Plan(int positions) {
  testing::SessionPlan plan;
  plan.room.low = {-5.0, -3.0, -1.5};
  plan.room.high = {9.0, 4.0, 2.5};
  plan.room.detail_m = 0.5;
  plan.poses = testing::GentleBend(positions, 0.15);
  plan.projection = Projection::Equirectangular(320, 160);
  return plan;
}

PipelineOptions Quick(PipelineOptions options = {}) {
  const PipelineOptions quick = testing::QuickOptions();
  options.stereo_width = quick.stereo_width;
  options.labels = quick.labels;
  options.preview_quality = quick.preview_quality;
  options.output_width = 128;
  return options;
}

class Methods : public ::testing::Test {
 protected:
  static constexpr int kPositions = 4;
  void SetUp() override {
    testing::WriteSession(session_.path(), Plan(kPositions),
                          testing::RenderFrames(Plan(kPositions)));
  }
  std::map<std::string, std::string> Bytes(const PipelineOptions& options) {
    const TemporaryDirectory out;
    const Processed done = ProcessAll(session_.path(), out.path(), options);
    EXPECT_EQ(done.counts.views_written, kPositions);
    std::map<std::string, std::string> bytes = ViewBytes(out.path());
    // The records name the methods: they would differ in any case.
    std::erase_if(bytes, [](const auto& file) { return file.first.ends_with("view.json"); });
    return bytes;
  }
  TemporaryDirectory session_;
};

TEST_F(Methods, EveryOneGivesWholeViewsOfItsOwn) {
  const auto ours = Bytes(Quick());
  std::vector<PipelineOptions> all(11, Quick());
  all[0].cost = StereoCost::kRadiometric;
  all[1].cost = StereoCost::kCensus;
  all[2].cost = StereoCost::kMutualInformation;
  all[3].fusion = StereoFusion::kCrossCheck;
  all[4].fusion = StereoFusion::kStability;
  all[5].filter = StereoFilter::kNone;
  all[6].fill = StereoFill::kSuperpixels;
  all[7].merge_weights = MergeWeights::kHat;
  all[8].consistency = false;
  all[9].occlusion = false;
  all[10].search = StereoSearch::kFull;
  for (const PipelineOptions& options : all) {
    EXPECT_FALSE(SameBytes(Bytes(options), ours)) << DescribeMethods(options);
  }
}

TEST_F(Methods, ThoseOfTheThesisGiveTheSameBytesOnAnyNumberOfWorkers) {
  const PipelineOptions options = Quick(PipelineOptions::Thesis());
  SetWorkerCount(1);
  const auto one = Bytes(options);
  SetWorkerCount(2);
  const auto two = Bytes(options);
  SetWorkerCount(0);
  EXPECT_TRUE(SameBytes(one, two));
}

TEST_F(Methods, StandInTheViewsRecordUnlessTheyAreTheDefault) {
  PipelineOptions options = Quick();
  options.cost = StereoCost::kCensus;
  options.occlusion = false;
  const TemporaryDirectory out;
  ProcessAll(session_.path(), out.path(), options);
  const Result<ViewRecord> record = ReadViewRecord(out.path() / "views", PositionId{1});
  ASSERT_TRUE(record);
  EXPECT_NE(record->resume_json.find("stereo.cost = census, merge.occlusion = false"),
            std::string::npos);
  ProcessAll(session_.path(), {}, Quick());
  const Result<ViewRecord> plain = ReadViewRecord(session_.path() / "views", PositionId{1});
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain->resume_json.find("methods"), std::string::npos);
}

TEST(ResumedMethods, AStateOfOtherMethodsIsNotContinued) {
  constexpr int kPositions = 14;
  const TemporaryDirectory session;
  testing::WriteSession(session.path(), Plan(kPositions), testing::RenderFrames(Plan(kPositions)));
  const PipelineOptions census = [] {
    PipelineOptions options = Quick();
    options.cost = StereoCost::kCensus;
    return options;
  }();
  ProcessAll(session.path(), {}, Quick());
  fs::remove_all(session.path() / "views" / ViewDirectoryName(PositionId{kPositions - 1}));
  const Processed other = ProcessAll(session.path(), {}, census);
  EXPECT_EQ(other.counts.views_written, 1);
  EXPECT_TRUE(other.said.Warned("made with other options"));
}

TEST(DescribeMethods, NamesWhatIsNotTheDefault) {
  EXPECT_EQ(DescribeMethods(PipelineOptions{}), "");
  EXPECT_EQ(DescribeMethods(PipelineOptions::Thesis()),
            "stereo.cost = radiometric, stereo.search = full, stereo.fusion = stability, "
            "stereo.fill = superpixels, stereo.sky = true, merge.neighbours = 1, "
            "merge.weights = hat, merge.consistency = false, merge.occlusion = false");
}

TEST(PipelineOptions, TheThesisIsValidAndTooManyMergeNeighboursAreRefusedByName) {
  EXPECT_TRUE(PipelineOptions::Thesis().Validate());
  PipelineOptions options;
  options.merge_neighbours = 3;
  const Status status = options.Validate();
  ASSERT_FALSE(status);
  EXPECT_NE(status.error().message.find("merge.neighbours: 3, expected 1 to 2"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::methods_test
