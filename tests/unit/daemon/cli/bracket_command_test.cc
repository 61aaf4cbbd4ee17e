// omnihdr bracket propose, called as from the command line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "daemon/config.h"
#include "drivers/sim/simulation.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::bracket_command_test {
namespace {

using ::testing::HasSubstr;

class BracketCommand : public ::testing::Test {
 protected:
  void Configure(const std::string& more) {
    ASSERT_TRUE(WriteFileAtomic(directory_.path() / "c.toml",
                                "[camera]\ndriver = \"sim\"\nframe_timeout_s = 10.0\n"
                                "[camera.sim]\nscene = \"tunnel\"\nwidth = 128\n" +
                                    more));
  }
  Result<int> Run(std::vector<std::string> words) {
    words.insert(words.begin(), {"bracket", "propose"});
    words.insert(words.end(), {"--config", (directory_.path() / "c.toml").string()});
    return testing::RunCommand({AddBracketCommand}, std::move(words), &printed_);
  }
  nlohmann::json Printed() const { return nlohmann::json::parse(printed_); }

  testing::TemporaryDirectory directory_;
  std::string printed_;
};

TEST_F(BracketCommand, WhatIsPrintedIsAConfigurationWhoseBracketCoversTheScene) {
  Configure("");
  Result<int> code = Run({});
  ASSERT_TRUE(code) << code.error().message;
  const LoadedConfig loaded = ParseConfig(printed_, "proposed.toml");
  EXPECT_TRUE(loaded.ok()) << printed_;
  EXPECT_GT(loaded.config.bracket.exposures_s.size(), 1U) << printed_;
  EXPECT_THAT(printed_, HasSubstr("stops\n"));
}

TEST_F(BracketCommand, TheConfigurationsLimitsAreKeptAndWhatTheyCostIsSaid) {
  Configure("");
  ASSERT_TRUE(Run({"--json"}));
  const auto free = Printed();
  ASSERT_GT(free["exposures_s"].size(), 1U);
  // A bound that the longest of the exposures breaks: a pixel is 49 mrad, 2 rad/s.
  const double longest = free["exposures_s"].back();
  Configure("[bracket]\nmax_blur_px = " + std::to_string(longest * 2.0 / 0.0491 * 0.7) +
            "\nspeed_m_s = 10.0\nnear_m = 5.0\n");
  ASSERT_TRUE(Run({"--json"}));
  EXPECT_LT(Printed()["exposures_s"].size(), free["exposures_s"].size());
  EXPECT_THAT(Printed()["notes"].back().get<std::string>(),
              HasSubstr("left out: bracket: exposure"));
}

TEST_F(BracketCommand, ARecordedSessionDoesAsWell) {
  Configure("");
  sim::SimulateOptions options;
  options.simulation.scene = sim::SceneKind::kTunnel;
  options.simulation.width = 128;
  options.bracket.start = ExposureTime::Seconds(0.00006);
  options.bracket.step = Stops{3.0};
  options.positions = 6;
  options.created = "2026-01-01T00:00:00Z";
  ASSERT_TRUE(sim::WriteSimulatedSession(directory_.path() / "s", options, {}));
  ASSERT_TRUE(Run({"--json"}));
  const double by_camera = Printed()["exposures_s"].front();
  const Result<int> code = Run({(directory_.path() / "s").string(), "--json"});
  ASSERT_TRUE(code) << code.error().message;
  EXPECT_EQ(Printed()["pictures"], 6);
  EXPECT_EQ(Printed()["bright_reached"], true);
  EXPECT_NEAR(std::log2(Printed()["exposures_s"].front().get<double>() / by_camera), 0.0, 1.0);
}

TEST_F(BracketCommand, AReplayedCameraIsRefusedByName) {
  ASSERT_TRUE(WriteFileAtomic(directory_.path() / "c.toml",
                              "[camera]\ndriver = \"replay\"\n[camera.replay]\nsession = \"s\"\n"));
  EXPECT_FALSE(Run({}));
}

}  // namespace
}  // namespace omnihdr::bracket_command_test
