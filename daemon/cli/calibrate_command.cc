#include "daemon/cli/calibrate_command.h"

#include <CLI/CLI.hpp>
#include <array>

namespace omnihdr {
namespace {

constexpr std::array<AddCommand, 4> kCalibrations = {AddCalibrateResponse, AddCalibrateWhiteBalance,
                                                     AddCalibrateSensors, AddCalibrateVignetting};

}  // namespace

void AddCalibrateCommand(CLI::App& app, CommandRun& run) {
  CLI::App* calibrate =
      app.add_subcommand("calibrate", "Measure what a camera does to the light from its pictures");
  calibrate->require_subcommand(1);
  for (const AddCommand add : kCalibrations) add(*calibrate, run);
}

}  // namespace omnihdr
