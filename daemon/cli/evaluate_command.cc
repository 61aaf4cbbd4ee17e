#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "core/base/file.h"
#include "daemon/cli/command.h"
#include "daemon/evaluation/evaluation.h"

namespace omnihdr {
namespace {

struct EvaluateArguments {
  std::string session;
  std::string views;
  std::string reference;
  std::string mask;
  std::string out;
  double ignore_bottom_percent = 0.0;
  bool require_complete = false;
  bool json = false;
};

Result<int> Evaluate(const EvaluateArguments& arguments) {
  EvaluationOptions options;
  options.views = arguments.views;
  options.photographs = arguments.reference;
  options.mask = {arguments.mask, arguments.ignore_bottom_percent / 100.0};
  const bool show_progress = isatty(STDERR_FILENO) != 0;
  OMNIHDR_ASSIGN(
      const SessionScore score, EvaluateSession(arguments.session, options, [&](int done, int of) {
        if (show_progress) {
          fmt::print(stderr, "\revaluating {}/{}{}", done, of, done == of ? "\r\033[K" : "");
        }
      }));
  if (!arguments.out.empty()) {
    OMNIHDR_TRY(WriteFileAtomic(arguments.out, FormatScoreJson(score)));
  }
  fmt::print("{}", arguments.json ? FormatScoreJson(score) : FormatScoreTable(score));
  return arguments.require_complete && score.complete < static_cast<int>(score.positions.size())
             ? 1
             : 0;
}

}  // namespace

void AddEvaluateCommand(CLI::App& app, CommandRun& run) {
  auto* command = app.add_subcommand("evaluate",
                                     "Compare a session's views with what is known of the scene: "
                                     "the simulator's truth or photographs");
  auto arguments = std::make_shared<EvaluateArguments>();
  command->add_option("SESSION", arguments->session, "Session directory")->required();
  command->add_option("--views", arguments->views, "Folder of the views [SESSION/views]");
  command->add_option("--reference", arguments->reference,
                      "Folder of photographs with how.json [SESSION/reference, when there is one]");
  command->add_option("--mask", arguments->mask,
                      "Picture the size of a frame: only its white part counts");
  command
      ->add_option("--ignore-bottom", arguments->ignore_bottom_percent,
                   "Percent of a frame's height, from the bottom, that does not count")
      ->check(CLI::Range(0.0, 90.0));
  command->add_flag("--require-complete", arguments->require_complete,
                    "Exit with 1 unless every position has its view");
  command->add_flag("--json", arguments->json, "Print one JSON object instead of a table");
  command->add_option("--out", arguments->out, "Write the JSON object to this file as well");
  command->callback([arguments, &run] { run = [arguments] { return Evaluate(*arguments); }; });
}

}  // namespace omnihdr
