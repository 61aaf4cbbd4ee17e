// process, called as from the command line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/pipeline/session_processor.h"
#include "core/session/view_writer.h"
#include "daemon/cli/command.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::process_command_test {
namespace {

using ::testing::HasSubstr;

class ProcessCommand : public ::testing::Test {
 protected:
  std::string Path(const std::string& name) const { return (directory_.path() / name).string(); }

  Result<int> Run(std::vector<std::string> words) {
    return testing::RunCommand({AddProcessCommand}, std::move(words), &printed_);
  }

  testing::TemporaryDirectory directory_;
  std::string printed_;
};

TEST_F(ProcessCommand, WhiteBalanceMultipliesTheRadianceAsItsConfigurationKeyDoes) {
  testing::SessionPlan plan;
  plan.projection = Projection::Equirectangular(128, 64);
  plan.poses = testing::GentleBend(2, 0.3);
  plan.exposures_s = {0.5, 1.0};
  plan.with_prior_poses = true;
  testing::WriteSession(Path("session"), plan, testing::RenderFrames(plan));
  const std::string common = "[pipeline]\nmode = \"temporal\"\n[photometry]\nwhite_balance = ";
  ASSERT_TRUE(WriteFileAtomic(Path("key.toml"), common + "[1.5, 1.0, 2.0]\n"));
  ASSERT_TRUE(WriteFileAtomic(Path("other.toml"), common + "[3.0, 3.0, 3.0]\n"));
  const auto process = [&](const std::string& out, std::vector<std::string> more) {
    more.insert(more.begin(), {"process", Path("session"), "--out", Path(out), "--exr-type",
                               "float", "--quiet", "--mode", "temporal"});
    const Result<int> result = Run(std::move(more));
    ASSERT_TRUE(result) << result.error().message;
  };
  process("plain", {});
  process("option", {"--white-balance", "1.5,1,2"});
  process("key", {"--config", Path("key.toml")});
  process("both", {"--config", Path("other.toml"), "--white-balance", "1.5,1,2"});
  const std::map<std::string, std::string> option = testing::ViewBytes(Path("option"));
  ASSERT_FALSE(option.empty());
  EXPECT_TRUE(testing::ViewBytes(Path("key")) == option);
  EXPECT_TRUE(testing::ViewBytes(Path("both")) == option);  // the command line wins
  const auto radiance = [&](const std::string& out) {
    return ReadExr(std::filesystem::path(Path(out)) / "views" / ViewDirectoryName(PositionId{1}) /
                   "radiance.exr")
        .value();
  };
  const auto plain = radiance("plain");
  const auto balanced = radiance("option");
  for (const auto& [channel, gain] :
       {std::pair{"R", 1.5}, std::pair{"G", 1.0}, std::pair{"B", 2.0}}) {
    std::size_t right = 0;
    const std::span<const float> a = plain.channels.at(channel).values();
    const std::span<const float> b = balanced.channels.at(channel).values();
    for (std::size_t i = 0; i < a.size(); ++i) {
      right += std::abs(b[i] - gain * a[i]) <= 1e-4 * b[i] ? 1 : 0;
    }
    // Where a value clips, what counts as clipped in which channel decides, not the gain alone.
    EXPECT_GT(static_cast<double>(right), 0.9 * static_cast<double>(a.size())) << channel;
  }
}

TEST_F(ProcessCommand, UpgradeMakesReducedViewsAnewAndNothingElse) {
  testing::SessionPlan plan;
  plan.projection = Projection::Equirectangular(128, 64);
  plan.poses = testing::GentleBend(8, 0.1);
  plan.with_prior_poses = true;
  testing::WriteSession(Path("session"), plan, testing::RenderFrames(plan));
  ASSERT_TRUE(WriteFileAtomic(Path("c.toml"), std::string("[stereo]\nwidth = 128\nlabels = 24\n")));
  const std::vector<std::string> process = {"process", Path("session"), "--config", Path("c.toml")};
  const auto with = [&](const std::string& flag) {
    std::vector<std::string> words = process;
    words.push_back(flag);
    return words;
  };
  ASSERT_TRUE(Run(process));
  const auto full = testing::ViewBytes(Path("session"));
  ASSERT_TRUE(Run(with("--upgrade")));
  EXPECT_THAT(printed_, HasSubstr("all 8 views there are of full quality, nothing to do"));

  // As a daemon makes them that cannot keep up.
  std::filesystem::remove_all(Path("session/views"));
  PipelineOptions options;
  options.stereo_width = 128;
  options.labels = 24;
  ProcessorOptions how;
  how.overload = {.overload = Overload::kDegrade, .backlog_limit = 4};
  const auto processor = SessionProcessor::Open(Path("session"), {}, options, {}, how);
  ASSERT_TRUE(processor) << processor.error().message;
  ASSERT_TRUE((*processor)->Finish());
  const int reduced = (*processor)->counts().views_reduced;
  ASSERT_GT(reduced, 0);

  ASSERT_TRUE(Run(process));
  EXPECT_THAT(printed_, HasSubstr(fmt::format("{} of reduced quality (--upgrade", reduced)));
  const Result<int> other = Run({"process", Path("session"), "--upgrade"});
  ASSERT_FALSE(other) << "other options than the views were made with";
  EXPECT_EQ(other.error().kind, ErrorKind::kConfig);
  EXPECT_FALSE(Run({"process", Path("session"), "--upgrade", "--resume"}));
  ASSERT_TRUE(Run(with("--upgrade")));
  EXPECT_THAT(printed_, HasSubstr(fmt::format("{} views written, 8 complete", reduced)));
  EXPECT_TRUE(testing::ViewBytes(Path("session")) == full);
}

TEST_F(ProcessCommand, TheProfileSaysWhereTheTimeOfAViewGoes) {
  testing::SessionPlan plan;
  plan.projection = Projection::Equirectangular(256, 128);
  plan.poses = testing::GentleBend(4, 0.2);
  testing::WriteSession(Path("session"), plan, testing::RenderFrames(plan));
  ASSERT_TRUE(WriteFileAtomic(Path("c.toml"), std::string("[stereo]\nwidth = 128\nlabels = 24\n")));
  const std::vector<std::string> common = {"process",      Path("session"), "--config",
                                           Path("c.toml"), "--profile",     "--out"};
  const auto run = [&](std::vector<std::string> more) {
    more.insert(more.begin(), common.begin(), common.end());
    const Result<int> result = Run(std::move(more));
    EXPECT_TRUE(result) << result.error().message;
  };
  run({Path("a"), "--json"});
  const auto json = nlohmann::json::parse(printed_);
  EXPECT_EQ(json["written"], 4);
  EXPECT_EQ(json["reduced"], 0);
  const auto& profile = json["profile"];
  EXPECT_EQ(profile["views"], 4);
  std::map<std::string, nlohmann::json> parts;
  double wall_ms = 0.0;
  double cpu_ms = 0.0;
  for (const auto& part : profile["parts"]) {
    parts[part["part"]] = part;
    if (part["beside_others"]) continue;
    wall_ms += part["wall_ms"].get<double>();
    cpu_ms += part["cpu_ms"].get<double>();
  }
  for (const char* name :
       {"read", "decode", "measure", "features", "match and relative pose", "adjust",
        "stereo views", "sweep", "semi-global", "fuse", "filter and fill", "merge", "write"}) {
    EXPECT_TRUE(parts.contains(name)) << name;
  }
  for (const char* name : {"radiance.exr", "disparity.exr", "preview.jpg"}) {
    EXPECT_TRUE(parts[name]["beside_others"]) << name;
    EXPECT_EQ(parts[name]["calls"], 4) << name;
  }
  EXPECT_NEAR(wall_ms, profile["wall_ms"], 1e-6) << "the parts are the whole";
  EXPECT_NEAR(cpu_ms, profile["cpu_ms"], 1e-6);
  EXPECT_EQ(parts["decode"]["calls"], 4);

  run({Path("b")});
  for (const char* line :
       {"part (mean per view)", "semi-global", "  of it radiance.exr", "elsewhere", "100.0 %"}) {
    EXPECT_THAT(printed_, HasSubstr(line));
  }
  // Nothing of it is in the views.
  EXPECT_TRUE(testing::ViewBytes(Path("a")) == testing::ViewBytes(Path("b")));
}

TEST_F(ProcessCommand, GainsOutOfRangeAreRefusedBeforeAnythingIsRead) {
  for (const char* gains : {"0,1,1", "1,1,11", "nan,1,1", "-1,1,1"}) {
    const Result<int> result = Run({"process", Path("none"), "--white-balance", gains});
    ASSERT_FALSE(result) << gains;
    EXPECT_EQ(result.error().kind, ErrorKind::kUsage);
    EXPECT_THAT(result.error().message, HasSubstr("--white-balance")) << gains;
  }
  EXPECT_FALSE(Run({"process", Path("none"), "--white-balance", "1,1"}));
  EXPECT_FALSE(Run({"process", Path("none"), "--white-balance", "1,1,1,1"}));
}

}  // namespace
}  // namespace omnihdr::process_command_test
