#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "core/base/clock.h"
#include "core/session/session_check.h"
#include "core/session/session_repair.h"
#include "daemon/cli/command.h"

namespace omnihdr {
namespace {

using OrderedJson = nlohmann::ordered_json;

struct VerifyArguments {
  std::string session;
  std::string views;
  bool quick = false;
  bool strict = false;
  bool apply = false;
  bool json = false;
};

SessionCheckOptions CheckOptionsOf(const VerifyArguments& arguments) {
  SessionCheckOptions options;
  options.views = arguments.views;
  options.quick = arguments.quick;
  // Hours of pictures take minutes to read.
  if (!arguments.json && ::isatty(STDERR_FILENO) == 1) {
    options.progress = [](std::size_t done, std::size_t total) {
      fmt::print(stderr, "\r{} of {} files and views{}", done, total, done == total ? "\n" : "");
    };
  }
  return options;
}

OrderedJson JsonOf(const SessionFinding& finding) {
  OrderedJson json = {
      {"kind", ToString(finding.kind)}, {"code", finding.code}, {"file", finding.file}};
  if (finding.line > 0) json["line"] = finding.line;
  json["message"] = finding.message;
  return json;
}

std::string Dumped(const OrderedJson& json) {
  return json.dump(1, ' ', false, OrderedJson::error_handler_t::replace);
}

void PrintFinding(const SessionFinding& finding) {
  fmt::print("{:<9} {}{}: {}\n", ToString(finding.kind), finding.file,
             finding.line > 0 ? fmt::format(":{}", finding.line) : "", finding.message);
}

std::string Counted(std::size_t number, std::string_view one, std::string_view many) {
  return fmt::format("{} {}", number, number == 1 ? one : many);
}

void PrintReport(const std::string& session, const SessionReport& report, bool quick) {
  for (const SessionFinding& finding : report.findings) PrintFinding(finding);
  const std::size_t all = report.damage + report.leftovers + report.notes;
  if (all > report.findings.size()) {
    fmt::print("... and {} more\n", all - report.findings.size());
  }
  fmt::print(
      "{}: {}, {} ({:.1f} MB), {}", session, Counted(report.lines, "journal line", "journal lines"),
      Counted(report.pictures, "picture", "pictures"),
      static_cast<double>(report.picture_bytes) / 1e6, Counted(report.views, "view", "views"));
  if (report.is_being_written) fmt::print(", being written");
  if (report.is_ended) fmt::print(", ended");
  fmt::print("\n");
  if (report.pictures_without_checksum > 0) {
    fmt::print("{} without checksum in the journal: only read\n",
               Counted(report.pictures_without_checksum, "picture", "pictures"));
  }
  if (report.damage > 0) {
    fmt::print("{} damaged", Counted(report.damage, "thing is", "things are"));
  } else {
    fmt::print("nothing damaged{}", quick ? " as far as names and sizes tell" : "");
  }
  if (report.leftovers > 0) {
    fmt::print(", {} of an interrupted program (omnihdr repair)",
               Counted(report.leftovers, "leftover", "leftovers"));
  }
  fmt::print("\n");
}

Result<int> Verify(const VerifyArguments& arguments) {
  OMNIHDR_ASSIGN(const SessionReport report,
                 CheckSession(arguments.session, CheckOptionsOf(arguments)));
  const bool good = report.damage == 0 && (!arguments.strict || report.leftovers == 0);
  if (arguments.json) {
    OrderedJson findings = OrderedJson::array();
    for (const SessionFinding& finding : report.findings) findings.push_back(JsonOf(finding));
    fmt::print("{}\n", Dumped({{"session", arguments.session},
                               {"good", good},
                               {"damage", report.damage},
                               {"leftovers", report.leftovers},
                               {"notes", report.notes},
                               {"being_written", report.is_being_written},
                               {"ended", report.is_ended},
                               {"lines", report.lines},
                               {"lines_with_checksum", report.lines_sealed},
                               {"pictures", report.pictures},
                               {"picture_bytes", report.picture_bytes},
                               {"pictures_without_checksum", report.pictures_without_checksum},
                               {"positions", report.positions},
                               {"views", report.views},
                               {"quick", arguments.quick},
                               {"findings", findings}}));
  } else {
    PrintReport(arguments.session, report, arguments.quick);
  }
  return good ? 0 : ExitCode(ErrorKind::kData);
}

std::string WhatIsDone(const RepairAction& action, bool applied) {
  switch (action.kind) {
    case RepairKind::kPutLineAside:
    case RepairKind::kPutFileAside:
    case RepairKind::kPutViewAside:
      return applied ? "put aside as " + action.put_to : "to be put aside into lost+found";
    case RepairKind::kEndLine:
      return applied ? "newline added" : "to get its newline";
    case RepairKind::kRemoveView:
      return applied ? "removed, to be made again" : "to be removed and made again";
  }
  return "?";
}

Result<int> Repair(const VerifyArguments& arguments) {
  RepairOptions options;
  options.apply = arguments.apply;
  options.check = CheckOptionsOf(arguments);
  OMNIHDR_ASSIGN(const RepairReport report,
                 RepairSession(arguments.session, SystemClock().NowUtc(), options));
  if (arguments.json) {
    OrderedJson actions = OrderedJson::array();
    for (const RepairAction& action : report.actions) {
      OrderedJson json = {
          {"action", ToString(action.kind)}, {"file", action.file}, {"why", action.why}};
      if (!action.put_to.empty()) json["put_to"] = action.put_to;
      actions.push_back(std::move(json));
    }
    OrderedJson remaining = OrderedJson::array();
    for (const SessionFinding& finding : report.remaining) remaining.push_back(JsonOf(finding));
    fmt::print("{}\n", Dumped({{"session", arguments.session},
                               {"applied", arguments.apply},
                               {"being_written", report.found.is_being_written},
                               {"actions", actions},
                               {"remaining", remaining}}));
  } else {
    for (const RepairAction& action : report.actions) {
      fmt::print("{}: {}: {}\n", action.file, action.why, WhatIsDone(action, arguments.apply));
    }
    for (const SessionFinding& finding : report.remaining) PrintFinding(finding);
    if (report.actions.empty()) {
      fmt::print("{}: nothing to mend\n", arguments.session);
    } else if (!arguments.apply) {
      fmt::print("{}: nothing was changed; --apply does it\n", arguments.session);
    }
    if (report.found.is_being_written) {
      fmt::print("{}: another process is writing it\n", arguments.session);
    }
    if (!report.remaining.empty()) {
      fmt::print("{} lost: no repair brings that back\n",
                 Counted(report.remaining.size(), "thing is", "things are"));
    }
  }
  if (!report.remaining.empty()) return ExitCode(ErrorKind::kData);
  return arguments.apply || report.actions.empty() ? 0 : 1;
}

}  // namespace

void AddVerifyCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "verify",
      "Whether a session holds what it says: journal lines, checksums and sizes of pictures, "
      "missing and extra files, views; exit code 65 when something is damaged");
  auto arguments = std::make_shared<VerifyArguments>();
  command->add_option("session", arguments->session, "session directory")->required();
  command->add_option("--views", arguments->views, "its views (default: SESSION/views)");
  command->add_flag("--quick", arguments->quick,
                    "names and sizes only: no checksums, no pixels are read");
  command->add_flag("--strict", arguments->strict,
                    "65 for what an interrupted program left behind, too");
  command->add_flag("--json", arguments->json, "one JSON object instead of lines for people");
  command->callback([arguments, &run] { run = [arguments] { return Verify(*arguments); }; });
}

void AddRepairCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "repair",
      "Mend what an interrupted program left in a session, without altering anything captured: "
      "tells what is to be done, and does it with --apply. Exit code 0 when there is nothing to "
      "do or it is done, 1 when there is something to do, 65 when something is lost for good");
  auto arguments = std::make_shared<VerifyArguments>();
  command->add_option("session", arguments->session, "session directory")->required();
  command->add_option("--views", arguments->views, "its views (default: SESSION/views)");
  command->add_flag("--quick", arguments->quick,
                    "looks at names and sizes only: views that cannot be read stay");
  command->add_flag("--apply", arguments->apply, "do it; without, nothing is written");
  command->add_flag("--json", arguments->json, "one JSON object instead of lines for people");
  command->callback([arguments, &run] { run = [arguments] { return Repair(*arguments); }; });
}

}  // namespace omnihdr
