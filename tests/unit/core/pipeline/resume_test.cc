#include <gtest/gtest.h>

#include <filesystem>

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
  void SetUp() override {
    static const std::vector<std::vector<std::byte>> frames = testing::RenderFrames(LongPlan());
    testing::WriteSession(session_.path(), LongPlan(), frames);
    const Processed done = ProcessAll(session_.path(), {}, Options());
    ASSERT_EQ(done.counts.views_written, kPositions);
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

INSTANTIATE_TEST_SUITE_P(Neighbours, Resume, ::testing::Values(1, 2));

}  // namespace
}  // namespace omnihdr::resume_test
