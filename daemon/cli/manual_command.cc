#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <string>
#include <string_view>
#include <vector>

#include "daemon/cli/command.h"

// `omnihdr manual` and `omnihdr completion`: both are made from the commands' own descriptions, so
// that an option cannot be missing in them.
namespace omnihdr {
namespace {

std::vector<const CLI::App*> CommandsOf(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App* command) { return !command->get_name().empty(); });
}

std::vector<const CLI::Option*> OptionsOf(const CLI::App& app, bool positional) {
  return app.get_options([positional](const CLI::Option* option) {
    return !option->get_group().empty() &&
           (positional ? option->get_positional() : option->nonpositional());
  });
}

// "calibrate response", without the program's own name.
std::string PathOf(const CLI::App& app) {
  if (app.get_parent() == nullptr) return "";
  const std::string parent = PathOf(*app.get_parent());
  return parent.empty() ? app.get_name() : parent + " " + app.get_name();
}

// What a value must be, as CLI11 writes it behind the kind of value: "TEXT:{auto,temporal}",
// "INT:INT in [1 - 256]".
struct ValueKind {
  std::string name;  // "TEXT"; empty = a flag
  std::vector<std::string> choices;
  std::string range;  // "1 - 256"; empty = any
};

ValueKind KindOf(const CLI::Option& option) {
  ValueKind kind;
  if (option.get_type_size_max() == 0 || option.get_items_expected_max() == 0) return kind;
  const std::string type = option.get_type_name();
  const std::size_t colon = type.find(':');
  kind.name = type.substr(0, colon);
  if (colon == std::string::npos) return kind;
  const std::string_view rule = std::string_view(type).substr(colon + 1);
  const std::size_t brace = rule.find('{');
  const std::size_t bracket = rule.find('[');
  if (brace != std::string_view::npos && rule.find('}', brace) != std::string_view::npos) {
    const std::size_t end = rule.find('}', brace);
    for (const std::string& choice :
         CLI::detail::split(std::string(rule.substr(brace + 1, end - brace - 1)), ',')) {
      kind.choices.push_back(choice.substr(0, choice.find("->")));
    }
  } else if (bracket != std::string_view::npos && rule.back() == ']') {
    kind.range = rule.substr(bracket + 1, rule.size() - bracket - 2);
  } else if (rule == "NONNEGATIVE") {
    kind.range = "not negative";
  } else if (rule == "POSITIVE") {
    kind.range = "above 0";
  }
  return kind;
}

// ---- manual page

// Text as roff takes it literally.
std::string Roff(std::string_view text) {
  std::string out;
  if (!text.empty() && (text.front() == '.' || text.front() == '\'')) out += "\\&";
  for (const char c : text) {
    if (c == '\\') {
      out += "\\e";
    } else if (c == '-') {
      out += "\\-";
    } else if (c == '\n') {
      out += "\n.br\n";
    } else {
      out += c;
    }
  }
  return out;
}

// As a sentence: its first letter large, a full stop.
std::string Sentence(std::string text) {
  if (text.empty()) return text;
  const bool abbreviation = text.size() > 1 && (std::isupper(text[1]) != 0);
  if (!abbreviation) {
    text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  }
  if (text.back() != '.') text += '.';
  return text;
}

// "--mode TEXT", in bold and italics.
std::string RoffHead(const CLI::Option& option, const ValueKind& kind) {
  std::vector<std::string> names;
  if (!option.nonpositional()) {
    names.push_back(fmt::format("\\fI{}\\fR", Roff(option.get_name(true))));
    return fmt::format("{}{}", names[0], option.get_items_expected_max() > 1 ? "..." : "");
  }
  for (const std::string& name : option.get_snames()) names.push_back("\\fB\\-" + name + "\\fR");
  for (const std::string& name : option.get_lnames()) {
    names.push_back("\\fB" + Roff("--" + name) + "\\fR");
  }
  std::string head = fmt::format("{}", fmt::join(names, ", "));
  if (!kind.name.empty()) head += " \\fI" + Roff(kind.name) + "\\fR";
  return head;
}

std::string RoffOption(const CLI::Option& option) {
  const ValueKind kind = KindOf(option);
  std::string text =
      fmt::format(".TP\n{}\n{}", RoffHead(option, kind), Roff(Sentence(option.get_description())));
  if (option.get_required()) text += " Required.";
  if (!kind.choices.empty()) {
    text += fmt::format("\nOne of {}.", Roff(fmt::format("{}", fmt::join(kind.choices, ", "))));
  }
  if (!kind.range.empty()) text += fmt::format("\nRange: {}.", Roff(kind.range));
  if (!kind.name.empty() && !option.get_default_str().empty()) {
    text += fmt::format("\nDefault: {}.", Roff(option.get_default_str()));
  }
  std::vector<std::string> excluded;
  for (const CLI::Option* other : option.get_excludes()) excluded.push_back(other->get_name());
  std::sort(excluded.begin(), excluded.end());
  if (!excluded.empty()) {
    text +=
        fmt::format("\nNot together with {}.", Roff(fmt::format("{}", fmt::join(excluded, ", "))));
  }
  return text + "\n";
}

std::string RoffOptions(const CLI::App& app) {
  std::string text;
  for (const bool positional : {true, false}) {
    for (const CLI::Option* option : OptionsOf(app, positional)) {
      if (option != app.get_help_ptr() || app.get_parent() == nullptr) text += RoffOption(*option);
    }
  }
  return text;
}

std::string RoffCommand(const CLI::App& app) {
  const std::vector<const CLI::App*> commands = CommandsOf(app);
  std::string text;
  if (commands.empty()) {
    text = fmt::format(".SS \"{}", Roff("omnihdr " + PathOf(app)));
    if (!OptionsOf(app, false).empty()) text += " [OPTION...]";
    for (const CLI::Option* option : OptionsOf(app, true)) {
      const std::string shown =
          Roff(option->get_name(true)) + (option->get_items_expected_max() > 1 ? "..." : "");
      text += option->get_required() ? " " + shown : " [" + shown + "]";
    }
    text += fmt::format("\"\n{}\n{}", Roff(Sentence(app.get_description())), RoffOptions(app));
  }
  for (const CLI::App* command : commands) text += RoffCommand(*command);
  return text;
}

std::string ManualPage(const CLI::App& app) {
  std::string text = fmt::format(
      ".\\\" Made by \"omnihdr manual\" from the commands' own descriptions.\n"
      ".TH OMNIHDR 1 \"\" \"omnihdr {}\" \"User Commands\"\n"
      ".SH NAME\nomnihdr \\- HDR views from differently exposed panoramas\n"
      ".SH SYNOPSIS\n.B omnihdr\n\\fICOMMAND\\fR [\\fIOPTION\\fR...]\n"
      ".SH DESCRIPTION\n"
      "Controls the capture daemon\n.BR omnihdrd (8),\n"
      "makes radiance and disparity maps of recorded sessions, merges single pictures,\n"
      "calibrates, simulates, evaluates, and looks at the results.\n"
      ".SH OPTIONS\n{}"
      ".PP\nEvery command answers to \\fB\\-\\-help\\fR.\n.SH COMMANDS\n",
      OMNIHDR_VERSION, RoffOptions(app));
  text += RoffCommand(app);
  text +=
      ".SH EXIT STATUS\n0 for success; some commands have a verdict of their own, which their\n"
      "description names. Failures are those of\n.IR sysexits.h :\n"
      "64 the command line, 65 the content of a file, 66 a missing file, 69 a device or service\n"
      "that is not there, 70 a fault of the program, 71 the operating system, 73 a file that "
      "cannot\n"
      "be made, 74 reading or writing, 75 try again, 76 a protocol, 77 permission, 78 the\n"
      "configuration.\n"
      ".SH ENVIRONMENT\n.TP\n.B OMNIHDR_SOCKET\nThe daemon's socket, when \\fB\\-\\-socket\\fR is "
      "not "
      "given.\n"
      ".SH FILES\n.TP\n.I /etc/omnihdr/omnihdr.toml\nThe configuration:\n.BR omnihdr.toml (5).\n"
      ".TP\n.I /run/omnihdr/api.sock\nThe daemon's socket. Members of the group omnihdr may use "
      "it.\n"
      ".SH SEE ALSO\n.BR omnihdrd (8),\n.BR omnihdr.toml (5),\n.BR omnihdr\\-session (5)\n";
  return text;
}

// ---- completion

std::string OptionWords(const CLI::App& app) {
  std::vector<std::string> words;
  for (const CLI::Option* option : OptionsOf(app, false)) {
    for (const std::string& name : option->get_snames()) words.push_back("-" + name);
    for (const std::string& name : option->get_lnames()) words.push_back("--" + name);
  }
  return fmt::format("{}", fmt::join(words, " "));
}

struct CompletionCases {
  std::string steps;   // from one command to a command below it
  std::string values;  // what an option can be
  std::string words;   // what may stand at the cursor
};

void AddCases(const CLI::App& app, CompletionCases& cases) {
  const std::string path = PathOf(app);
  std::vector<std::string> names;
  for (const CLI::App* command : CommandsOf(app)) {
    names.push_back(command->get_name());
    cases.steps +=
        fmt::format("      '{}:{}') path='{}' ;;\n", path, command->get_name(), PathOf(*command));
  }
  for (const CLI::Option* option : OptionsOf(app, false)) {
    const ValueKind kind = KindOf(*option);
    if (kind.name.empty()) continue;
    for (const std::string& name : option->get_lnames()) {
      cases.values +=
          fmt::format("    '{}:--{}') values='{}' ;;\n", path, name, fmt::join(kind.choices, " "));
    }
    for (const std::string& name : option->get_snames()) {
      cases.values +=
          fmt::format("    '{}:-{}') values='{}' ;;\n", path, name, fmt::join(kind.choices, " "));
    }
  }
  cases.words += fmt::format("    '{}') commands='{}' options='{}' ;;\n", path,
                             fmt::join(names, " "), OptionWords(app));
  for (const CLI::App* command : CommandsOf(app)) AddCases(*command, cases);
}

// Files are completed by the shell where a function has nothing to say.
std::string BashCompletion(const CLI::App& app) {
  CompletionCases cases;
  AddCases(app, cases);
  return fmt::format(R"(# bash completion for omnihdr, made by "omnihdr completion"
_omnihdr() {{
  local path='' commands='' options='' values='-' i
  local current="${{COMP_WORDS[COMP_CWORD]}}"
  for ((i = 1; i < COMP_CWORD; ++i)); do
    case "$path:${{COMP_WORDS[i]}}" in
{}    esac
  done
  COMPREPLY=()
  case "$path:${{COMP_WORDS[COMP_CWORD - 1]}}" in
{}  esac
  if [[ "$values" != '-' ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$values" -- "$current")
    return
  fi
  case "$path" in
{}  esac
  if [[ "$current" == -* ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$options" -- "$current")
  elif [[ -n "$commands" ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$commands" -- "$current")
  fi
}}
complete -o default -F _omnihdr omnihdr
)",
                     cases.steps, cases.values, cases.words);
}

}  // namespace

void AddManualCommands(CLI::App& app, CommandRun& run) {
  CLI::App* manual = app.add_subcommand(
      "manual", "Print the manual page of all commands, as in omnihdr manual | man -l -");
  manual->callback([&app, &run] {
    run = [&app]() -> Result<int> {
      fmt::print("{}", ManualPage(app));
      return 0;
    };
  });
  CLI::App* completion = app.add_subcommand(
      "completion",
      "Print completion of commands and options for bash, as in eval \"$(omnihdr completion)\"");
  completion->callback([&app, &run] {
    run = [&app]() -> Result<int> {
      fmt::print("{}", BashCompletion(app));
      return 0;
    };
  });
}

}  // namespace omnihdr
