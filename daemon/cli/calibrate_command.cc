#include "daemon/cli/calibrate_command.h"

#include <CLI/CLI.hpp>
#include <array>

namespace omnihdr {
namespace {

// One a line, so that a new one is one line of a change.
// clang-format off
constexpr std::array kCalibrations = {
    AddCalibrateResponse,
    AddCalibrateNoise,
    AddCalibrateWhiteBalance,
    AddCalibrateSensors,
    AddCalibrateVignetting,
    AddCalibrateVerify,
};
// clang-format on

}  // namespace

void AddCalibrateCommand(CLI::App& app, CommandRun& run) {
  CLI::App* calibrate =
      app.add_subcommand("calibrate", "Measure what a camera does to the light from its pictures");
  calibrate->require_subcommand(1);
  for (const AddCommand add : kCalibrations) add(*calibrate, run);
}

}  // namespace omnihdr
