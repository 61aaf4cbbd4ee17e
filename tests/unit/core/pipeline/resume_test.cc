#include <gtest/gtest.h>

#include <filesystem>

#include "core/image/image_io.h"
#include "core/pipeline/session_processor.h"
#include "core/pipeline/view_pipeline.h"
#include "core/session/view_writer.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::resume_test {
namespace {

namespace fs = std::filesystem;
using testing::ProcessAll;
using testing::Processed;
using testing::SameBytes;
using testing::TemporaryDirectory;
using testing::ViewBytes;

constexpr int kPositions = 14;
constexpr int kStateSpan = ViewPipeline::kWarmUpPositions + 1;  // a state helps views this far on

// Long enough that a late view can be made again from a saved state, with poses to be estimated, so
// that the state of every part matters.
testing::SessionPlan LongPlan() {
  testing::SessionPlan plan;
  plan.room.low = {-5.0, -3.0, -1.5};
  plan.room.high = {9.0, 4.0, 2.5};
  plan.room.detail_m = 0.5;
  plan.poses = testing::GentleBend(kPositions, 0.15);
  plan.projection = Projection::Equirectangular(320, 160);
  return plan;
}

class Resume : public ::testing::TestWithParam<int> {
 protected:
  static PipelineOptions Options() {
    PipelineOptions options = testing::QuickOptions();
    options.output_width = 128;
    options.neighbours = GetParam();
    return options;
  }
  // The whole session by the number of neighbours: made once, copied for every test.
  static const fs::path& Made() {
    static std::map<int, TemporaryDirectory> made;
    const auto [directory, fresh] = made.try_emplace(GetParam());
    const fs::path& session = directory->second.path();
    if (fresh) {
      static const std::vector<std::vector<std::byte>> frames = testing::RenderFrames(LongPlan());
      testing::WriteSession(session, LongPlan(), frames);
      EXPECT_EQ(ProcessAll(session, {}, Options()).counts.views_written, kPositions);
    }
    return session;
  }
  void SetUp() override {
    fs::copy(Made(), session_.path(), fs::copy_options::recursive);
    whole_ = ViewBytes(session_.path());
    for (int k = 0; k < kPositions; ++k) {
      const Result<ViewRecord> record = ReadViewRecord(session_.path() / "views", PositionId{k});
      ASSERT_TRUE(record) << record.error().message;
      EXPECT_FALSE(record->resume_json.empty());
      EXPECT_EQ(record->chain, 0) << "the drive should link from end to end";
    }
  }
  fs::path View(int position) const {
    return session_.path() / "views" / ViewDirectoryName(PositionId{position});
  }
  void Lose(int count) const {
    for (int k = kPositions - count; k < kPositions; ++k) fs::remove_all(View(k));
  }

  TemporaryDirectory session_;
  std::map<std::string, std::string> whole_;
};

TEST_P(Resume, GivesTheSameBytesHoweverManyOfTheLastViewsAreLost) {
  for (const int lost : {1, 3, 5}) {
    Lose(lost);
    const Processed resumed = ProcessAll(session_.path(), {}, Options());
    EXPECT_EQ(resumed.counts.views_written, lost);
    // From the latest state that is early enough, else from the beginning.
    const int state_after = kPositions - lost - kStateSpan;
    EXPECT_EQ(resumed.counts.positions_seen,
              state_after >= 2 ? kPositions - 1 - state_after : kPositions);
    EXPECT_TRUE(SameBytes(whole_, ViewBytes(session_.path()))) << "after losing " << lost;
  }
}

TEST_P(Resume, ASavedStateThatIsDamagedIsNotUsed) {
  for (int k = 0; k + 3 < kPositions; ++k) {
    Result<ViewRecord> record = ReadViewRecord(session_.path() / "views", PositionId{k});
    ASSERT_TRUE(record);
    record->resume_json = k % 2 == 0 ? "{\"after\": 1, \"poses\": {\"window\": 7}}" : "{}";
    testing::WriteText(View(k) / "view.json", FormatViewRecord(*record));
  }
  Lose(1);
  const Processed resumed = ProcessAll(session_.path(), {}, Options());
  EXPECT_EQ(resumed.counts.views_written, 1);
  EXPECT_EQ(resumed.counts.positions_seen, kPositions);
  const auto now = ViewBytes(session_.path());
  const std::string last = ViewDirectoryName(PositionId{kPositions - 1});
  for (const char* file : {"radiance.exr", "disparity.exr", "preview.jpg", "view.json"}) {
    const std::string name = fmt::format("{}/{}", last, file);
    EXPECT_TRUE(whole_.at(name) == now.at(name)) << name;
  }
}

// A drive that goes blind, is put back near its start, and knows the place again.
class ResumeLost : public ::testing::Test {
 protected:
  static constexpr int kBefore = 10;
  static constexpr int kBlind = 4;
  static constexpr int kAll = 26;

  static testing::SessionPlan Plan() {
    testing::SessionPlan plan = LongPlan();
    const std::vector<Pose> way = testing::GentleBend(kAll, 0.15);
    plan.poses.assign(way.begin(), way.begin() + kBefore + kBlind);
    for (int k = 0; k < kAll - kBefore - kBlind; ++k) {
      Pose pose = way[static_cast<std::size_t>(k)];
      pose.translation += Eigen::Vector3d(0.05, 0.04, 0.02);
      plan.poses.push_back(pose);
    }
    return plan;
  }
  static PipelineOptions Options() {
    PipelineOptions options = testing::QuickOptions();
    options.output_width = 128;
    return options;
  }
  // The whole session: made once, copied for every test.
  static void Make(const fs::path& session) {
    std::vector<std::vector<std::byte>> frames = testing::RenderFrames(Plan());
    const Image<std::uint8_t> grey(320, 160, 3, 90);
    for (int k = kBefore; k < kBefore + kBlind; ++k) {
      frames[static_cast<std::size_t>(k)] = *EncodePng(grey.view());
    }
    testing::WriteSession(session, Plan(), frames);
    EXPECT_EQ(ProcessAll(session, {}, Options()).counts.views_written, kAll);
  }
  void SetUp() override {
    static const TemporaryDirectory made;
    if (!fs::exists(made.path() / "views")) Make(made.path());
    fs::copy(made.path(), session_.path(), fs::copy_options::recursive);
    whole_ = ViewBytes(session_.path());
  }
  ViewRecord Record(int position) const {
    return *ReadViewRecord(session_.path() / "views", PositionId{position});
  }
  void Lose(int count) const {
    for (int k = kAll - count; k < kAll; ++k) {
      fs::remove_all(session_.path() / "views" / ViewDirectoryName(PositionId{k}));
    }
  }

  TemporaryDirectory session_;
  std::map<std::string, std::string> whole_;
};

TEST_F(ResumeLost, TheViewsSayWhereTheTrackWasLostAndWhatWasRecognised) {
  EXPECT_NE(Record(kBefore).chain, 0);
  EXPECT_NE(Record(kBefore).chain_reason, "");
  const ViewRecord back = Record(kBefore + kBlind);
  EXPECT_EQ(back.chain, 0);
  EXPECT_TRUE(back.metric_scale);
  ASSERT_TRUE(back.relocalised);
  EXPECT_LT(Value(back.relocalised->place), kBefore);
  EXPECT_EQ(back.relocalised->from_chain, Record(kBefore + kBlind - 1).chain);
  ASSERT_FALSE(back.warnings.empty());
  EXPECT_NE(back.warnings.back().find("was recognised from position"), std::string::npos);
  const Pose first = Plan().poses.front();
  for (int k = kBefore + kBlind; k < kAll; ++k) {
    const ViewRecord view = Record(k);
    EXPECT_EQ(view.chain, 0);
    EXPECT_TRUE(view.sigma) << k;
    const Pose truth = first.Inverse() * Plan().poses[static_cast<std::size_t>(k)];
    EXPECT_LT((view.pose.translation - truth.translation).norm(), 0.1) << k;
    EXPECT_LT(view.pose.rotation.angularDistance(truth.rotation), 0.02) << k;
  }
}

TEST_F(ResumeLost, ContinuedAfterwardsGivesTheSameBytes) {
  for (const int lost : {1, 7}) {
    Lose(lost);
    const Processed resumed = ProcessAll(session_.path(), {}, Options());
    EXPECT_EQ(resumed.counts.views_written, lost);
    EXPECT_LT(resumed.counts.positions_seen, kAll) << "from a saved state";
    EXPECT_TRUE(SameBytes(whole_, ViewBytes(session_.path()))) << "after losing " << lost;
  }
}

TEST_F(ResumeLost, WithoutWhatAPlaceIsRecognisedByItStartsAnewAndPutsItBack) {
  const fs::path keyframe =
      session_.path() / "views" / ViewDirectoryName(PositionId{2}) / "keyframe.bin";
  ASSERT_TRUE(fs::remove(keyframe));
  Lose(1);
  const Processed resumed = ProcessAll(session_.path(), {}, Options());
  EXPECT_TRUE(resumed.said.Warned("keyframe.bin"));
  EXPECT_EQ(resumed.counts.positions_seen, kAll);
  EXPECT_TRUE(SameBytes(whole_, ViewBytes(session_.path())));
}

INSTANTIATE_TEST_SUITE_P(Neighbours, Resume, ::testing::Values(1, 2));

}  // namespace
}  // namespace omnihdr::resume_test
