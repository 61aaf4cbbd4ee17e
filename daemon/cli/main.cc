// omnihdr, the command line tool. Exit codes are those of sysexits.h; each command says what else.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <array>
#include <cstdio>
#include <exception>

#include "core/base/heap.h"
#include "daemon/cli/command.h"

namespace omnihdr {
namespace {

// One a line, so that a new one is one line of a change.
// clang-format off
constexpr std::array kCommands = {
    AddControlCommands,
    AddProcessCommand,
    AddMergeCommand,
    AddCalibrateCommand,
    AddConvertCommand,
    AddReportCommand,
    AddVerifyCommand,
    AddRepairCommand,
    AddViewCommand,
    AddExportCommand,
    AddSimulateCommand,
    AddEvaluateCommand,
    AddContactSheetCommand,
    AddToneMapCommand,
    AddPictureCommand,
    AddCompareCommand,
    AddConfigCommand,
    AddRigCommand,
    AddStitchCommand,
    AddImportCommand,
    AddCameraCommand,
    AddBracketCommand,
    AddManualCommands,
    AddDoctorCommand,
    AddSupportBundleCommand,
};
// clang-format on

int Main(int argc, char** argv) {
  CLI::App app("omnihdr: HDR views from differently exposed panoramas");
  app.set_version_flag("--version", "omnihdr " OMNIHDR_VERSION);
  app.require_subcommand(1);
  CommandRun run;
  for (const AddCommand add : kCommands) add(app, run);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : ExitCode(ErrorKind::kUsage);
  }
  const Result<int> result = run();
  if (result) return *result;
  fmt::print(stderr, "omnihdr: {}\n", result.error().message);
  return ExitCode(result.error().kind);
}

}  // namespace
}  // namespace omnihdr

int main(int argc, char** argv) {
  omnihdr::LimitHeap();
  try {
    return omnihdr::Main(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "omnihdr: {}\n", error.what());
  }
  return omnihdr::ExitCode(omnihdr::ErrorKind::kSoftware);
}
