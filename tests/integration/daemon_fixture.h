#pragma once

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "drivers/sim/simulation.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

// The real daemon in a directory of its own.
namespace omnihdr::integration {

namespace fs = std::filesystem;

// Small pictures and a coarse search: the whole chain in a fraction of a second a view.
inline constexpr const char* kSmallPipeline = "[stereo]\nwidth = 256\nlabels = 32\n";

// Tests run where there is room, and whoever else fills the disk must not change the state.
inline constexpr const char* kAnyStorage =
    "[storage]\nallow_root = true\nwarn_free_mb = 0\nstop_free_mb = 0\nwarn_minutes = 0\n";

class DaemonFixture : public ::testing::Test {
 protected:
  fs::path directory() const { return directory_.path(); }
  fs::path session() const { return directory() / "sessions" / "s"; }

  // A configuration with the simulated camera, software triggers, and `more` behind it.
  void WriteConfig(const std::string& camera_and_trigger, const std::string& more = "") {
    std::ofstream(directory() / "c.toml") << fmt::format(
        "[session]\ndirectory = \"sessions\"\nname = \"s\"\n"
        "[api]\nsocket = \"api.sock\"\n{}\n{}\n{}\n{}\n",
        camera_and_trigger, kSmallPipeline, kAnyStorage, more);
  }
  static std::string SimCamera(int width = 256) {
    return fmt::format(
        "[camera]\ndriver = \"sim\"\n[camera.sim]\nscene = \"tunnel\"\nwidth = {}\n"
        "[bracket]\nstart_s = 0.004\nstep_stops = 1.6\ncount = 3\n"
        "[trigger]\nsource = \"software\"\narmed_at_start = true\n",
        width);
  }
  std::string ReplayCamera(const std::string& source) const {
    return fmt::format(
        "[camera]\ndriver = \"replay\"\nreconnect_s = 0.2\n[camera.replay]\nsession = \"{}\"\n"
        "[trigger]\nsource = \"{}\"\narmed_at_start = true\n",
        (directory() / "source").string(), source);
  }
  // A recorded session in directory()/source.
  void RecordSource(int positions, bool odometer = false) {
    sim::SimulateOptions options;
    options.simulation.scene = sim::SceneKind::kTunnel;
    options.simulation.width = 256;
    options.bracket.start = ExposureTime::Seconds(0.004);
    options.bracket.step = Stops{1.6};
    options.positions = positions;
    // A trigger by command knows no place: only the replay trigger hands the recorded one on.
    options.write_odometer = odometer;
    options.created = "2026-01-01T00:00:00Z";
    const Status written = sim::WriteSimulatedSession(directory() / "source", options, {});
    ASSERT_TRUE(written) << written.error().message;
  }
  // The views of `omnihdr process` of the source: what every other way must give, byte for byte.
  std::map<std::string, std::string> ProcessedSource() {
    const auto [code, output] =
        RunOmnihdr({"process", (directory() / "source").string(), "--out",
                    (directory() / "reference").string(), "--config", Config(), "--quiet"},
                   directory());
    EXPECT_EQ(code, 0) << output;
    return FilesBelow(directory() / "reference" / "views");
  }

  std::string Config() const { return (directory() / "c.toml").string(); }
  std::unique_ptr<Program> Start(const std::vector<std::string>& more = {},
                                 const std::vector<std::string>& environment = {}) {
    std::vector<std::string> arguments = {"--config", Config()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return std::make_unique<Program>("omnihdrd", arguments, directory() / "log", environment);
  }
  ApiClient Client() const { return ApiClient(directory() / "api.sock"); }
  nlohmann::json StatusNow() const {
    auto status = Client().Get("/v1/status");
    return status ? *status : nlohmann::json();
  }
  bool StatusHolds(const std::function<bool(const nlohmann::json&)>& holds) const {
    return Eventually([&] {
      const nlohmann::json status = StatusNow();
      return status.is_object() && holds(status);
    });
  }
  bool Armed() const {
    return StatusHolds([](const auto& s) { return s["state"] == "armed"; });
  }
  // Triggers by command until one is accepted; false when none was within the time.
  bool Trigger() const {
    return Eventually([&] { return static_cast<bool>(Client().Post("/v1/trigger")); });
  }
  std::vector<FrameRecord> Journal() const {
    auto contents = ReadSession(session());
    EXPECT_TRUE(contents) << (contents ? "" : contents.error().message);
    return contents ? contents->journal.frames : std::vector<FrameRecord>{};
  }

 private:
  testing::TemporaryDirectory directory_;
};

}  // namespace omnihdr::integration
