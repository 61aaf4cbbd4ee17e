#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "daemon/cli/command.h"
#include "daemon/evaluation/evaluation.h"
#include "daemon/evaluation/experiments.h"
#include "daemon/evaluation/suite.h"

namespace omnihdr {
namespace {

struct EvaluateArguments {
  std::string session;
  std::string views;
  std::string reference;
  std::string mask;
  std::string out;
  double ignore_bottom_percent = 0.0;
  std::string suite;
  std::string only;
  std::vector<std::string> experiments;
  std::string matrix;
  int width = ExperimentOptions{}.width;
  bool list = false;
  bool require_complete = false;
  bool require_must = false;
  bool json = false;
};

// Simulated drives instead of a session.
Result<int> EvaluateSuite(const EvaluateArguments& arguments) {
  std::vector<SuiteCase> cases =
      SuiteCases(arguments.suite == "quick" ? SuiteKind::kQuick : SuiteKind::kTargets);
  std::erase_if(cases, [&](const SuiteCase& drive) {
    return drive.name.find(arguments.only) == std::string::npos;
  });
  if (cases.empty()) {
    return Fail(ErrorKind::kUsage, "--only: {}: no such case, see --suite {} --list",
                arguments.only, arguments.suite);
  }
  if (arguments.list) {
    for (const SuiteCase& drive : cases) fmt::print("{}\n", drive.name);
    return 0;
  }
  if (arguments.out.empty()) {
    return Fail(ErrorKind::kUsage, "--out: missing, expected a folder for the suite's files");
  }
  const std::filesystem::path folder = arguments.out;
  std::vector<SuiteScore> scores;
  for (const SuiteCase& drive : cases) {
    fmt::print(stderr, "{} ({} of {})\n", drive.name, scores.size() + 1, cases.size());
    OMNIHDR_ASSIGN(SuiteScore score,
                   RunSuiteCase(drive, PipelineOptions{}, folder).Context(drive.name));
    scores.push_back(std::move(score));
    // After each: an hour's work is not lost with the last case.
    OMNIHDR_TRY(WriteFileAtomic(folder / "report.md", FormatSuiteMarkdown(scores)));
    OMNIHDR_TRY(WriteFileAtomic(folder / "report.json", FormatSuiteJson(scores)));
    OMNIHDR_TRY(WritePlots((folder / "reliability.png").string(),
                           {ReliabilityPlot(ReliabilityOf(scores))}));
  }
  fmt::print("{}", arguments.json ? FormatSuiteJson(scores) : FormatSuiteTable(scores));
  bool met = true;
  for (const SuiteScore& score : scores) {
    for (const SuiteCheck& check : score.checks) met = met && check.met();
  }
  return arguments.require_must && !met ? 1 : 0;
}

// The thesis's experiments on data matrices.
Result<int> EvaluateExperiments(const EvaluateArguments& arguments) {
  if (arguments.list) {
    for (const std::string& name : ExperimentNames()) fmt::print("{}\n", name);
    return 0;
  }
  if (arguments.out.empty()) {
    return Fail(ErrorKind::kUsage, "--out: missing, expected a folder for the experiments' files");
  }
  ExperimentOptions options;
  options.matrix = arguments.matrix;
  options.width = arguments.width;
  if (arguments.experiments != std::vector<std::string>{"all"}) {
    options.names = arguments.experiments;
  }
  options.pipeline.mask_file = arguments.mask;
  OMNIHDR_ASSIGN(const ExperimentReport report,
                 RunExperiments(options, arguments.out,
                                [](const std::string& what) { fmt::print(stderr, "{}\n", what); }));
  fmt::print("{}", arguments.json ? report.json : report.summary);
  return 0;
}

Result<int> Evaluate(const EvaluateArguments& arguments) {
  if (!arguments.suite.empty()) return EvaluateSuite(arguments);
  if (!arguments.experiments.empty()) return EvaluateExperiments(arguments);
  if (arguments.list) {
    return Fail(ErrorKind::kUsage, "--list: expected --suite or --experiments beside it");
  }
  if (arguments.session.empty()) {
    return Fail(ErrorKind::kUsage,
                "SESSION: missing, expected a session directory, --suite or --experiments");
  }
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
                                     "the simulator's truth or photographs; or reproduce the "
                                     "thesis's experiments");
  auto arguments = std::make_shared<EvaluateArguments>();
  CLI::Option* session = command->add_option("SESSION", arguments->session, "Session directory");
  CLI::Option* suite =
      command
          ->add_option(
              "--suite", arguments->suite,
              "Simulated drives instead of a session, processed and compared with the true "
              "depth's merge, the own frames and no registration: quick (minutes) or "
              "targets (an hour)")
          ->check(CLI::IsMember({"quick", "targets"}))
          ->excludes(session);
  CLI::Option* experiments =
      command
          ->add_option(
              "--experiments", arguments->experiments,
              "The experiments of the thesis instead of a session, all or NAME,NAME: warp, step "
              "size, baseline, order, outdoor, ranges and counts, on simulated data matrices (the "
              "same exposures at every position), with the thesis's numbers beside (minutes)")
          ->delimiter(',')
          ->excludes(session)
          ->excludes(suite);
  command
      ->add_option("--matrix", arguments->matrix,
                   "Run them on this session instead, which has several exposures at every "
                   "position; what it does not allow is said in the report")
      ->needs(experiments);
  command
      ->add_option("--width", arguments->width, "Of the simulated matrices' panoramas, in pixels")
      ->check(CLI::Range(128, 8192))
      ->capture_default_str()
      ->needs(experiments);
  command->add_option("--only", arguments->only, "Of the suite the cases with this in their name")
      ->needs(suite);
  command->add_flag("--list", arguments->list,
                    "Print the names of the suite's cases, or of the experiments");
  command
      ->add_flag("--require-must", arguments->require_must,
                 "Exit with 1 when a target that must be reached is missed")
      ->needs(suite);
  command->add_option("--views", arguments->views, "Folder of the views [SESSION/views]")
      ->excludes(suite)
      ->excludes(experiments);
  command
      ->add_option("--reference", arguments->reference,
                   "Folder of photographs with how.json [SESSION/reference, when there is one]")
      ->excludes(suite)
      ->excludes(experiments);
  command
      ->add_option("--mask", arguments->mask,
                   "Picture the size of a frame: only its white part counts")
      ->excludes(suite);
  command
      ->add_option("--ignore-bottom", arguments->ignore_bottom_percent,
                   "Percent of a frame's height, from the bottom, that does not count")
      ->check(CLI::Range(0.0, 90.0))
      ->excludes(suite)
      ->excludes(experiments);
  command
      ->add_flag("--require-complete", arguments->require_complete,
                 "Exit with 1 unless every position has its view")
      ->excludes(suite)
      ->excludes(experiments);
  command->add_flag("--json", arguments->json, "Print one JSON object instead of a table");
  command->add_option(
      "--out", arguments->out,
      "Write the JSON object to this file as well; of a suite the new folder for its "
      "sessions, views, pictures and report.md; of experiments that for experiments.md, "
      "experiments.json, their pictures and the simulated matrices");
  command->callback([arguments, &run] { run = [arguments] { return Evaluate(*arguments); }; });
}

}  // namespace omnihdr
