#include "core/pipeline/made_with.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <set>

#include "core/session/rig_file.h"
#include "core/session/view_writer.h"
#include "tests/support/ring.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::made_with_test {
namespace {

namespace fs = std::filesystem;
using testing::ProcessAll;
using testing::Processed;
using testing::TemporaryDirectory;

std::string Of(const PipelineOptions& options, const fs::path& session) {
  const Result<std::string> made_with = MadeWith(options, session);
  EXPECT_TRUE(made_with) << made_with.error().message;
  return made_with ? *made_with : "";
}

TEST(MadeWith, AnyOptionGivesAnother) {
  const TemporaryDirectory session;
  std::vector<PipelineOptions> all(13);
  all[1].labels = 64;
  all[2].noise.gain = 0.03;
  all[3].preview.key = 0.2;
  all[4].chromaticities[7] = 0.33;
  all[5].white_balance[2] = 1.1;
  all[6].occlusion = false;
  all[7].cost = StereoCost::kCensus;
  all[8] = PipelineOptions::Thesis();
  all[9].keyframes = 32;
  all[10].heading_sigma_deg = 2.0;
  all[11].movers = MergeMovers::kRemove;
  all[12].mover_masks = "movers";
  std::set<std::string> seen;
  for (const PipelineOptions& options : all) {
    EXPECT_EQ(Of(options, session.path()), Of(options, session.path()));
    seen.insert(Of(options, session.path()));
  }
  EXPECT_EQ(seen.size(), all.size());
}

TEST(MadeWith, AMaskCountsByItsContentNotItsName) {
  const TemporaryDirectory session;
  const auto write = [&](const char* name, std::uint8_t value) {
    testing::WriteText(session.path() / name, std::string(10, static_cast<char>(value)));
    PipelineOptions options;
    options.mask_file = (session.path() / name).string();
    return Of(options, session.path());
  };
  const std::string one = write("a.png", 1);
  EXPECT_EQ(write("b.png", 1), one);
  EXPECT_NE(write("b.png", 2), one);
  EXPECT_NE(Of({}, session.path()), one);
}

TEST(MadeWith, AMaskThatIsNotThereIsNamed) {
  const TemporaryDirectory session;
  PipelineOptions options;
  options.mask_file = (session.path() / "none.png").string();
  const Result<std::string> made_with = MadeWith(options, session.path());
  ASSERT_FALSE(made_with);
  EXPECT_NE(made_with.error().message.find("none.png"), std::string::npos);
}

TEST(MadeWith, AnotherRigGivesAnother) {
  const TemporaryDirectory session;
  const std::string without = Of({}, session.path());
  Rig rig = testing::MakeRing();
  testing::WriteText(session.path() / "rig.toml", FormatRig(rig));
  const std::string with = Of({}, session.path());
  EXPECT_NE(with, without);
  rig.sphere_radius_m *= 1.01;
  testing::WriteText(session.path() / "rig.toml", FormatRig(rig));
  EXPECT_NE(Of({}, session.path()), with);
}

class OtherOptions : public ::testing::Test {
 protected:
  static constexpr int kPositions = 4;
  void SetUp() override {
    testing::SessionPlan plan;
    plan.poses = testing::GentleBend(kPositions, 0.2);
    plan.with_prior_poses = true;
    testing::WriteSession(session_.path(), plan, testing::RenderFrames(plan));
    options_ = testing::QuickOptions();
    options_.output_width = 128;
    ProcessAll(session_.path(), {}, options_);
  }
  TemporaryDirectory session_;
  PipelineOptions options_;
};

TEST_F(OtherOptions, OfAContinuedSessionAreSaidAndItsCompleteViewsStay) {
  const fs::path first = session_.path() / "views" / ViewDirectoryName(PositionId{0});
  const std::string before = testing::FileText(first / "view.json");
  fs::remove_all(session_.path() / "views" / ViewDirectoryName(PositionId{kPositions - 1}));
  options_.labels += 8;
  const Processed other = ProcessAll(session_.path(), {}, options_);
  EXPECT_EQ(other.counts.views_written, 1);
  EXPECT_TRUE(other.said.Warned("000000: made with other options, another mask or another rig"));
  EXPECT_EQ(testing::FileText(first / "view.json"), before);
}

TEST_F(OtherOptions, AreNotSaidWhenThereAreNone) {
  fs::remove_all(session_.path() / "views" / ViewDirectoryName(PositionId{kPositions - 1}));
  const Processed same = ProcessAll(session_.path(), {}, options_);
  EXPECT_EQ(same.counts.views_written, 1);
  EXPECT_FALSE(same.said.Warned("made with other"));
}

}  // namespace
}  // namespace omnihdr::made_with_test
