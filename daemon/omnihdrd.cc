// omnihdrd, the capture daemon: reads the configuration and runs the App until it is told to stop.
// Exit codes are those of sysexits.h: 64 command line, 73 session or socket cannot be made, 75
// another daemon has it, 78 configuration.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <string>

#include "core/base/heap.h"
#include "daemon/app.h"
#include "daemon/config.h"
#include "daemon/event_loop.h"
#include "daemon/logging.h"
#include "daemon/parts.h"
#include "daemon/session_choice.h"
#include "daemon/survey_volume.h"

namespace omnihdr {
namespace {

struct Arguments {
  std::string config{kDefaultConfigFile};
  bool config_given = false;
  std::string session;
  bool check = false;
};

Status Main(const Arguments& arguments) {
  // First of all: a signal during the start must end in an orderly stop too.
  if (!arguments.check) OMNIHDR_TRY(BlockSignals());
  OMNIHDR_ASSIGN(DaemonConfig config,
                 ConfigOrError(LoadConfig(arguments.config, arguments.config_given)));
  OMNIHDR_TRY(CheckParts(config));
  if (arguments.check) {
    fmt::print("{}: good\n", arguments.config);
    return {};
  }
  InitLogging(config.log.level);
  OMNIHDR_ASSIGN(SessionChoice choice,
                 ChooseSession(config.session, arguments.session, SystemClock().NowUtc()));
  OMNIHDR_TRY(CheckSurveyVolume(choice.directory, config.MayLieOnRoot()));
  App app(
      config, std::move(choice),
      [&config](const PartsContext& context) { return MakeConfiguredParts(config, context); },
      [&arguments]() -> Result<DaemonConfig> {
        OMNIHDR_ASSIGN(DaemonConfig again,
                       ConfigOrError(LoadConfig(arguments.config, arguments.config_given)));
        OMNIHDR_TRY(CheckParts(again));
        return again;
      });
  return app.Run();
}

}  // namespace
}  // namespace omnihdr

int main(int argc, char** argv) {
  omnihdr::LimitHeap();
  omnihdr::Arguments arguments;
  CLI::App app("omnihdrd: takes differently exposed panoramas and turns them into HDR views");
  app.set_version_flag("--version", "omnihdrd " OMNIHDR_VERSION);
  CLI::Option* config =
      app.add_option("-c,--config", arguments.config, "configuration file")->capture_default_str();
  app.add_option(
      "--session", arguments.session,
      "session to write: a name in session.directory, or a directory when it holds a '/'");
  app.add_flag("--check", arguments.check, "check the configuration and leave");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : omnihdr::ExitCode(omnihdr::ErrorKind::kUsage);
  }
  arguments.config_given = config->count() > 0;
  const omnihdr::Status status = omnihdr::Main(arguments);
  if (status) return 0;
  fmt::print(stderr, "omnihdrd: {}\n", status.error().message);
  return omnihdr::ExitCode(status.error().kind);
}
