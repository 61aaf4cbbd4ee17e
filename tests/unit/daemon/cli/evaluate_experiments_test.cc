#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "daemon/cli/command.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::evaluate_experiments_test {
namespace {

using ::testing::HasSubstr;

// What it prints; the message when it fails.
std::string Evaluate(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), "evaluate");
  std::string printed;
  const Result<int> result =
      testing::RunCommand({AddEvaluateCommand}, std::move(arguments), &printed);
  return result ? printed : result.error().message;
}

TEST(EvaluateExperiments, AreListedByName) {
  EXPECT_EQ(Evaluate({"--experiments", "all", "--list"}),
            "counts\nfeatures\ntemporal-range\nwarp\nstep\nrange\nbaseline\norder\noutdoor\n");
}

TEST(EvaluateExperiments, NeedAFolderAndKnowTheirNames) {
  EXPECT_THAT(Evaluate({"--experiments", "step,warp"}), HasSubstr("--out: missing"));
  const testing::TemporaryDirectory out;
  EXPECT_THAT(Evaluate({"--experiments", "step,wrap", "--out", out.path().string()}),
              HasSubstr("wrap: no such experiment"));
}

TEST(EvaluateExperiments, ExcludeASessionAndWhatOnlyASessionHas) {
  EXPECT_THAT(Evaluate({"HERE", "--experiments", "all"}), HasSubstr("excludes"));
  EXPECT_THAT(Evaluate({"--experiments", "all", "--require-complete"}), HasSubstr("excludes"));
  EXPECT_THAT(Evaluate({"--matrix", "HERE"}), HasSubstr("requires"));
}

}  // namespace
}  // namespace omnihdr::evaluate_experiments_test
