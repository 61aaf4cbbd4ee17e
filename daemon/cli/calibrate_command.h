#pragma once

#include "daemon/cli/command.h"

namespace omnihdr {

// The sub-commands of `omnihdr calibrate`, each in its own file: each adds itself to the calibrate
// application.
void AddCalibrateResponse(CLI::App& calibrate, CommandRun& run);
void AddCalibrateWhiteBalance(CLI::App& calibrate, CommandRun& run);
void AddCalibrateSensors(CLI::App& calibrate, CommandRun& run);
void AddCalibrateVignetting(CLI::App& calibrate, CommandRun& run);
void AddCalibrateNoise(CLI::App& calibrate, CommandRun& run);
void AddCalibrateVerify(CLI::App& calibrate, CommandRun& run);

}  // namespace omnihdr
