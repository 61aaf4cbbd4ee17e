#pragma once

#include <functional>
#include <string>

#include "core/base/result.h"

namespace CLI {
class App;
}

namespace omnihdr {

// One sub-command of `omnihdr`: adds itself (name, options, help) to the application. When the user
// calls it, `run` ends up as what to do; its Result decides the exit code (sysexits.h), its value
// is the exit code of success (0, or a verdict such as "differences found"). Options are owned by
// the command.
using CommandRun = std::function<Result<int>()>;
using AddCommand = void (*)(CLI::App& app, CommandRun& run);

// The one visible list of commands, each in its own file of this folder.
void AddProcessCommand(CLI::App& app, CommandRun& run);
void AddMergeCommand(CLI::App& app, CommandRun& run);
void AddCalibrateCommand(CLI::App& app, CommandRun& run);  // response, white-balance, ...
void AddConvertCommand(CLI::App& app, CommandRun& run);
void AddViewCommand(CLI::App& app, CommandRun& run);
void AddReportCommand(CLI::App& app, CommandRun& run);
void AddSimulateCommand(CLI::App& app, CommandRun& run);
void AddEvaluateCommand(CLI::App& app, CommandRun& run);
void AddContactSheetCommand(CLI::App& app, CommandRun& run);
void AddToneMapCommand(CLI::App& app, CommandRun& run);
void AddPictureCommand(CLI::App& app, CommandRun& run);
void AddCompareCommand(CLI::App& app, CommandRun& run);
void AddConfigCommand(CLI::App& app, CommandRun& run);
void AddRigCommand(CLI::App& app, CommandRun& run);  // rig import, rig check
void AddStitchCommand(CLI::App& app, CommandRun& run);
void AddImportCommand(CLI::App& app, CommandRun& run);
void AddCameraCommand(CLI::App& app, CommandRun& run);   // camera list, info, grab, test
void AddBracketCommand(CLI::App& app, CommandRun& run);  // bracket propose
void AddVerifyCommand(CLI::App& app, CommandRun& run);
void AddRepairCommand(CLI::App& app, CommandRun& run);
void AddManualCommands(CLI::App& app, CommandRun& run);  // manual, completion
void AddDoctorCommand(CLI::App& app, CommandRun& run);
void AddSupportBundleCommand(CLI::App& app, CommandRun& run);
void AddExportCommand(CLI::App& app, CommandRun& run);  // to COLMAP, OpenSfM, TUM
void AddControlCommands(CLI::App& app,
                        CommandRun& run);  // status, arm, disarm, trigger, watch, stop

}  // namespace omnihdr
