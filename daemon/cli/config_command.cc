#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>
#include <string>

#include "core/session/toml.h"
#include "daemon/cli/command.h"
#include "daemon/config.h"

namespace omnihdr {
namespace {

struct ConfigCommandOptions {
  std::string file{kDefaultConfigFile};
  bool json = false;
};

std::string ProblemsJson(const LoadedConfig& loaded) {
  std::string text = fmt::format("{{\"ok\": {}, \"problems\": [", loaded.ok());
  bool first = true;
  for (const ConfigProblem& problem : loaded.problems) {
    text += fmt::format("{}\n  {{\"file\": {}, \"line\": {}, \"key\": {}, \"message\": {}}}",
                        first ? "" : ",", TomlText(problem.file), problem.line,
                        TomlText(problem.key), TomlText(problem.message));
    first = false;
  }
  return text + "]}\n";
}

Result<int> Check(const ConfigCommandOptions& options) {
  LoadedConfig loaded = LoadConfig(options.file);
  if (options.json) {
    fmt::print("{}", ProblemsJson(loaded));
    return loaded.ok() ? 0 : ExitCode(ErrorKind::kConfig);
  }
  const std::size_t files = loaded.files.size();
  const std::size_t keys = loaded.sources.size();
  OMNIHDR_TRY(ConfigOrError(std::move(loaded)));
  fmt::print("{}: good ({} {}, {} keys set)\n", options.file, files, files == 1 ? "file" : "files",
             keys);
  return 0;
}

Result<int> Show(const ConfigCommandOptions& options, bool file_given) {
  LoadedConfig loaded = LoadConfig(options.file, file_given);
  if (loaded.ok()) {
    fmt::print("{}", options.json ? FormatConfigJson(loaded) : FormatConfig(loaded));
    return 0;
  }
  OMNIHDR_TRY(ConfigOrError(std::move(loaded)));
  return 0;
}

}  // namespace

void AddConfigCommand(CLI::App& app, CommandRun& run) {
  CLI::App* config = app.add_subcommand("config", "Check and show the configuration");
  config->require_subcommand(1);

  const auto check_options = std::make_shared<ConfigCommandOptions>();
  CLI::App* check = config->add_subcommand(
      "check", "Report everything that is wrong in FILE and in omnihdr.d/*.toml beside it");
  check->add_option("FILE", check_options->file, "Configuration file")->capture_default_str();
  check->add_flag("--json", check_options->json, "Print the problems as JSON");
  check->callback(
      [&run, check_options] { run = [check_options] { return Check(*check_options); }; });

  const auto show_options = std::make_shared<ConfigCommandOptions>();
  CLI::App* show =
      config->add_subcommand("show", "Print every value in force and where it comes from");
  CLI::Option* positional = show->add_option("FILE", show_options->file, "Configuration file");
  CLI::Option* named = show->add_option("--config,-c", show_options->file, "Configuration file");
  positional->excludes(named);
  positional->capture_default_str();
  show->add_flag("--json", show_options->json, "Print JSON");
  show->callback([&run, show_options, positional, named] {
    const bool file_given = positional->count() + named->count() > 0;
    run = [show_options, file_given] { return Show(*show_options, file_given); };
  });
}

}  // namespace omnihdr
