#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "daemon/api/client.h"
#include "daemon/api/status.h"
#include "daemon/api/token.h"
#include "daemon/cli/command.h"
#include "daemon/config.h"

namespace omnihdr {
namespace {

using Json = nlohmann::json;
using SteadyTime = std::chrono::steady_clock::time_point;

struct ControlArguments {
  std::string socket;
  std::string tcp;
  std::string token_file;
  bool json = false;
  bool until_done = false;
  bool leave_open = false;
  bool no_wait = false;
  double timeout_s = 0.0;  // 0 = none
};

std::string DefaultSocket() {
  const char* from_environment = std::getenv("OMNIHDR_SOCKET");
  return from_environment != nullptr && *from_environment != '\0' ? from_environment
                                                                  : DaemonConfig().api.socket;
}

// Where the daemon is asked: over TCP when that is given.
Result<ApiEndpoint> Endpoint(const ControlArguments& arguments) {
  ApiEndpoint endpoint;
  endpoint.socket = arguments.socket;
  if (arguments.tcp.empty()) return endpoint;
  const std::optional<TcpEndpoint> tcp = ParseTcpEndpoint(arguments.tcp);
  if (!tcp) {
    return Fail(ErrorKind::kUsage,
                "--tcp {}: expected a numeric address and a port, such as 127.0.0.1:8787",
                arguments.tcp);
  }
  endpoint.address = tcp->address;
  endpoint.port = tcp->port;
  OMNIHDR_ASSIGN(endpoint.token, FindToken(arguments.token_file));
  return endpoint;
}

void PrintLine(const std::string& text) {
  fmt::print("{}\n", text);
  std::fflush(stdout);
}

Result<int> ShowStatus(const ControlArguments& arguments) {
  OMNIHDR_ASSIGN(ApiEndpoint endpoint, Endpoint(arguments));
  ApiClient client(std::move(endpoint));
  OMNIHDR_ASSIGN(const Json status, client.Get("/v1/status"));
  if (arguments.json) {
    PrintLine(status.dump(2));
  } else {
    fmt::print("{}", StatusForPeople(status));
  }
  return 0;
}

// POSTs and prints the answer, or `text` made from it for people.
Result<int> Command(const ControlArguments& arguments, const std::string& route,
                    std::string (*text)(const Json& answer)) {
  OMNIHDR_ASSIGN(ApiEndpoint endpoint, Endpoint(arguments));
  ApiClient client(std::move(endpoint));
  OMNIHDR_ASSIGN(const Json answer, client.Post(route));
  PrintLine(arguments.json ? answer.dump() : text(answer));
  return 0;
}

std::string StateText(const Json& answer) { return answer.value("state", "done"); }

std::string TriggerText(const Json& answer) {
  return fmt::format("trigger {}: position {}, {:.6g} s", answer.value("trigger", 0),
                     answer.value("position", 0), answer.value("exposure_s", 0.0));
}

bool Expired(const ControlArguments& arguments, SteadyTime begin) {
  return arguments.timeout_s > 0.0 && std::chrono::steady_clock::now() - begin >
                                          std::chrono::duration<double>(arguments.timeout_s);
}

bool Done(const Json& status) { return status.at("session").at("ended").get<bool>(); }

// Shows progress in place on a terminal, else a line for every change.
class Progress {
 public:
  void Show(const std::string& text) {
    if (text == last_) return;
    if (terminal_) {
      fmt::print("\r{:<{}}", text, last_.size());
      std::fflush(stdout);
    } else {
      PrintLine(text);
    }
    last_ = text;
  }
  ~Progress() {
    if (terminal_ && !last_.empty()) fmt::print("\n");
  }

 private:
  const bool terminal_ = ::isatty(STDOUT_FILENO) == 1;
  std::string last_;
};

Result<int> WatchEvents(const ControlArguments& arguments) {
  const SteadyTime begin = std::chrono::steady_clock::now();
  bool done = false;
  bool expired = false;
  OMNIHDR_ASSIGN(ApiEndpoint endpoint, Endpoint(arguments));
  ApiClient client(std::move(endpoint));
  OMNIHDR_TRY(client.Events([&](const std::string& line) {
    const Json event = Json::parse(line, nullptr, false);
    const std::string kind = event.is_object() ? event.value("event", "") : "";
    if (kind != "alive") PrintLine(line);
    done = (kind == "status" && Done(event)) ||
           (kind == "session" && event.value("what", "") == "ended");
    expired = Expired(arguments, begin);
    return !(arguments.until_done && done) && !expired;
  }));
  if (expired) {
    return Fail(ErrorKind::kTemporary, "the session has not ended within {:g} s",
                arguments.timeout_s);
  }
  if (arguments.until_done && !done) {
    return Fail(ErrorKind::kUnavailable, "the daemon has gone before the session's end");
  }
  return 0;
}

Result<int> Watch(const ControlArguments& arguments) {
  if (arguments.json) return WatchEvents(arguments);
  const SteadyTime begin = std::chrono::steady_clock::now();
  Progress progress;
  OMNIHDR_ASSIGN(ApiEndpoint endpoint, Endpoint(arguments));
  ApiClient client(std::move(endpoint));
  bool seen = false;
  while (true) {
    Result<Json> status = client.Get("/v1/status");
    if (!status) {
      // The daemon's end is the end of watching; its absence from the start, or before what was
      // waited for, is not.
      if (seen && !arguments.until_done && status.error().kind == ErrorKind::kUnavailable) return 0;
      if (status.error().kind != ErrorKind::kTemporary) return Forward(status.error());
    } else {
      seen = true;
      progress.Show(ProgressLine(*status));
      if (arguments.until_done && Done(*status)) return 0;
    }
    if (Expired(arguments, begin)) {
      return Fail(ErrorKind::kTemporary, "the session has not ended within {:g} s",
                  arguments.timeout_s);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(250));
  }
}

std::string ReloadText(const Json& answer) {
  std::string text;
  for (const Json& change : answer.value("changes", Json::array())) {
    text += fmt::format("{}: {} -> {} ({})\n", change.value("key", ""), change.value("old", ""),
                        change.value("new", ""), change.value("applies", ""));
  }
  if (text.empty()) return "nothing has changed";
  text.pop_back();
  return text;
}

Result<int> Stop(const ControlArguments& arguments) {
  const SteadyTime begin = std::chrono::steady_clock::now();
  OMNIHDR_ASSIGN(ApiEndpoint endpoint, Endpoint(arguments));
  ApiClient client(std::move(endpoint));
  OMNIHDR_ASSIGN(const Json answer,
                 client.Post("/v1/stop", {{"leave_open", arguments.leave_open}}));
  Progress progress;
  while (!arguments.no_wait) {
    const Result<Json> status = client.Get("/v1/status");
    if (!status && status.error().kind == ErrorKind::kUnavailable) break;
    if (status && !arguments.json) progress.Show(ProgressLine(*status));
    if (Expired(arguments, begin)) {
      return Fail(ErrorKind::kTemporary, "the daemon has not stopped within {:g} s",
                  arguments.timeout_s);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  if (arguments.json) PrintLine(answer.dump());
  return 0;
}

}  // namespace

void AddControlCommands(CLI::App& app, CommandRun& run) {
  auto arguments = std::make_shared<ControlArguments>();
  arguments->socket = DefaultSocket();
  const auto add = [&](const char* name, const char* help,
                       Result<int> (*function)(const ControlArguments&)) {
    CLI::App* command = app.add_subcommand(name, help);
    command
        ->add_option("--socket", arguments->socket,
                     "the daemon's socket (also from the environment: OMNIHDR_SOCKET)")
        ->capture_default_str();
    command->add_option("--tcp", arguments->tcp,
                        "ask over TCP instead: the daemon's api.tcp, with its token");
    command->add_option("--token-file", arguments->token_file,
                        "file with the token for --tcp, readable by its owner alone");
    command->add_flag("--json", arguments->json, "answer in JSON");
    command->callback([arguments, function, &run] {
      run = [arguments, function] { return function(*arguments); };
    });
    return command;
  };
  const auto add_timeout = [&](CLI::App* command) {
    command
        ->add_option("--timeout", arguments->timeout_s,
                     "give up after this many seconds, exit code 75; 0 = never")
        ->check(CLI::NonNegativeNumber)
        ->capture_default_str();
  };

  add("status", "Show what the daemon is doing", ShowStatus);
  add("arm", "From now on every trigger takes a picture",
      [](const ControlArguments& a) { return Command(a, "/v1/arm", StateText); });
  add("disarm", "Ignore triggers from now on",
      [](const ControlArguments& a) { return Command(a, "/v1/disarm", StateText); });
  add("trigger", "Take a picture now",
      [](const ControlArguments& a) { return Command(a, "/v1/trigger", TriggerText); });
  CLI::App* watch = add("watch", "Follow the progress, with --json as a stream of events", Watch);
  watch->add_flag("--until-done", arguments->until_done,
                  "end when the session has ended and all its views are finished");
  add_timeout(watch);
  add("finish", "End the session and finish its views; the daemon keeps running",
      [](const ControlArguments& a) {
        return Command(a, "/v1/finish", [](const Json&) { return std::string("ending"); });
      });
  add("reload", "Read the configuration again; what is wrong with it is refused whole",
      [](const ControlArguments& a) { return Command(a, "/v1/reload", ReloadText); });
  CLI::App* stop = add("stop", "End the session, finish its views, and stop the daemon", Stop);
  stop->add_flag("--leave-open", arguments->leave_open,
                 "stop at once and leave the session open: the next start goes on with it");
  stop->add_flag("--no-wait", arguments->no_wait, "do not wait until the daemon has gone");
  add_timeout(stop);
}

}  // namespace omnihdr
