// process, called as from the command line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
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
