#include "daemon/doctor/doctor.h"

#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <algorithm>
#include <cerrno>
#include <map>
#include <sstream>
#include <system_error>

#include "core/base/file.h"
#include "daemon/api/client.h"
#include "daemon/doctor/checks.h"

namespace omnihdr::doctor {
namespace {

namespace fs = std::filesystem;

constexpr const char* kServiceUser = "omnihdr";
// 2024-01-01: no clock that was ever set is before it.
constexpr std::int64_t kLongAgoNs = 1'704'067'200'000'000'000;

void CheckConfig(Examination& e, const LoadedConfig& loaded) {
  if (loaded.ok()) {
    e.Good("config", loaded.files.empty() ? fmt::format("{} is not there: built-in defaults",
                                                        e.options.config.string())
                                          : fmt::format("{} keys set in {}", loaded.sources.size(),
                                                        fmt::join(loaded.files, ", ")));
  }
  for (const ConfigProblem& problem : loaded.problems) {
    const bool is_missing = problem.key.empty() && problem.line == 0;
    e.Problem("config", problem.ToString(),
              is_missing ? fmt::format("omnihdr config show > {}   # every key with its default",
                                       problem.file)
                         : fmt::format("edit {}, then: omnihdr config check {}", problem.file,
                                       e.options.config.string()));
  }
}

void CheckAccount(Examination& e) {
  const auto use = [&e](const std::string& name) {
    const Result<Account> account = e.machine.FindAccount(name);
    if (account) e.account = *account;
    return account.has_value();
  };
  if (!e.options.user.empty()) {
    if (!use(e.options.user)) {
      e.Problem("user", fmt::format("no user \"{}\" on this machine", e.options.user),
                "sudo systemd-sysusers   # makes the service's user, or name another with --user");
    }
    return;
  }
  // Root may open everything, the service may not.
  if (e.account.uid == 0) use(kServiceUser);
}

// Whether somebody accepts at a Unix socket, whatever they say then.
bool SomebodyListens(const fs::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string& text = path.native();
  if (text.size() >= sizeof address.sun_path) return false;
  std::copy(text.begin(), text.end(), address.sun_path);
  const Fd fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  const auto length = static_cast<socklen_t>(sizeof address);
  // EAGAIN: its queue is full, for it takes nobody in.
  return fd.valid() &&
         (::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), length) == 0 ||
          errno == EAGAIN);
}

// What the daemon found out about the order and rotations of a head's sensors.
void CheckOrientation(Examination& e, const nlohmann::json& status) {
  const nlohmann::json orientation = status.value("orientation", nlohmann::json::object());
  const std::string what = orientation.value("what", "off");
  const std::string text = orientation.value("text", "");
  if (what == "contradicted") {
    e.Problem("orientation", text,
              "omnihdr calibrate verify --session SESSION   # then correct the order and the "
              "rotations of the sensors in the rig file");
  } else if (what == "agrees") {
    e.Good("orientation", text);
  } else if (what != "off") {
    e.Add("orientation", Verdict::kSkipped, fmt::format("{}: {}", what, text));
  }
}

void CheckDaemon(Examination& e) {
  const fs::path socket = e.config.api.socket;
  ApiClient client(socket, e.options.timeout);
  const Result<nlohmann::json> status = client.Get("/v1/status");
  if (status && status->is_object()) {
    e.daemon_answers = true;
    const std::string state = status->value("state", "?");
    const std::string text = fmt::format("omnihdrd {} answers on {}: {}",
                                         status->value("version", "?"), socket.string(), state);
    const std::string reason = status->value("reason", "");
    const std::string remedy = status->value("remedy", "");
    if (state == "waiting-for-camera" || state == "degraded" || state == "storage-full" ||
        state == "fault") {
      e.Warning("daemon", fmt::format("{}: {}", text, reason),
                remedy.empty() ? "omnihdr status; omnihdr watch" : remedy);
    } else {
      e.Good("daemon", reason.empty() ? text : fmt::format("{}: {}", text, reason));
    }
    CheckOrientation(e, *status);
    return;
  }
  const std::vector<pid_t> running = e.machine.Processes("omnihdrd");
  const Result<FileNode> node = e.machine.node(socket);
  if (status || SomebodyListens(socket)) {
    e.Problem("daemon",
              fmt::format("{}: no good answer: {}", socket.string(),
                          status ? "not a status" : status.error().message),
              "journalctl -u omnihdrd -b -n 50; sudo systemctl restart omnihdrd");
  } else if (node && !MayOpen(CallingAccount(), *node)) {
    e.Problem("daemon",
              fmt::format("{} is {}: {} may not connect", socket.string(),
                          DescribeNode(e.machine, *node), CallingAccount().name),
              fmt::format("sudo usermod -aG {} {}   # then log in again",
                          e.machine.GroupName(node->gid), CallingAccount().name));
  } else if (const Result<FileNode> folder = e.machine.node(socket.parent_path());
             !node && node.error().kind == ErrorKind::kPermission && folder) {
    e.Problem("daemon",
              fmt::format("{} is {}: {} may not look into it", socket.parent_path().string(),
                          DescribeNode(e.machine, *folder), CallingAccount().name),
              fmt::format("sudo usermod -aG {} {}   # then log in again",
                          e.machine.GroupName(folder->gid), CallingAccount().name));
  } else if (!running.empty()) {
    e.Problem("daemon",
              fmt::format("an omnihdrd (process {}) runs and does not answer on {}: it has another "
                          "configuration and may hold the camera",
                          fmt::join(running, ", "), socket.string()),
              fmt::format("ps -o args= -p {}   # then omnihdr doctor --config with its file",
                          fmt::join(running, ",")));
  } else if (node) {
    e.Add("daemon", Verdict::kSkipped,
          fmt::format("not running; {} is left from an earlier run and does no harm",
                      socket.string()));
  } else {
    e.Add("daemon", Verdict::kSkipped, fmt::format("not running (nothing at {})", socket.string()));
  }
}

void CheckService(Examination& e) {
  std::error_code error;
  if (!fs::exists(e.machine.At("/run/systemd/system"), error)) {
    e.Add("service", Verdict::kSkipped, "systemd does not run here");
    return;
  }
  const Result<std::string> text =
      e.machine.run({"systemctl", "show", "omnihdrd.service", "--no-pager", "--property",
                     "LoadState,ActiveState,SubState,UnitFileState,Result,NRestarts"});
  if (!text) {
    e.Add("service", Verdict::kSkipped, text.error().message);
    return;
  }
  std::map<std::string, std::string> values;
  std::istringstream lines(*text);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t equals = line.find('=');
    if (equals != std::string::npos) values[line.substr(0, equals)] = line.substr(equals + 1);
  }
  const std::string state = values["ActiveState"];
  const std::string enabled = values["UnitFileState"];
  if (values["LoadState"] == "not-found") {
    e.Add("service", Verdict::kSkipped, "omnihdrd.service is not installed");
  } else if (state == "failed") {
    e.Problem("service",
              fmt::format("omnihdrd.service failed: {}, restarted {} times", values["Result"],
                          values["NRestarts"]),
              "journalctl -u omnihdrd -b -n 50; sudo systemctl reset-failed omnihdrd; sudo "
              "systemctl start omnihdrd");
  } else if (values["LoadState"] == "masked" || enabled == "disabled") {
    e.Warning("service",
              fmt::format("omnihdrd.service is {}, {}: it does not start with the machine", state,
                          enabled),
              values["LoadState"] == "masked" ? "sudo systemctl unmask omnihdrd"
                                              : "sudo systemctl enable --now omnihdrd");
  } else if (state != "active" && state != "activating") {
    e.Warning("service", fmt::format("omnihdrd.service is {}, {}", state, enabled),
              "sudo systemctl start omnihdrd");
  } else {
    e.Good("service",
           fmt::format("omnihdrd.service is {} ({}), {}", state, values["SubState"], enabled));
  }
}

void CheckClock(Examination& e) {
  constexpr const char* kRemedy =
      "sudo timedatectl set-ntp true; without network: chrony with the receiver's time (gpsd)";
  if (e.machine.utc().ns() < kLongAgoNs) {
    e.Problem("clock", "the clock is before 2024: it was never set, and frames get wrong times",
              kRemedy);
    return;
  }
  const Result<bool> synchronised = e.machine.clock_is_synchronised();
  if (!synchronised) {
    e.Add("clock", Verdict::kSkipped, synchronised.error().message);
  } else if (!*synchronised) {
    e.Warning("clock", "nothing keeps the clock: utc_ns of the frames may be off by any amount",
              kRemedy);
  } else {
    e.Good("clock", "synchronised");
  }
}

}  // namespace

std::string_view ToString(Verdict verdict) {
  switch (verdict) {
    case Verdict::kGood:
      return "good";
    case Verdict::kSkipped:
      return "skipped";
    case Verdict::kWarning:
      return "warning";
    case Verdict::kProblem:
      return "problem";
  }
  return "?";
}

std::vector<Diagnosis> Examine(const DoctorOptions& options, const Machine& machine) {
  const LoadedConfig loaded = LoadConfig(options.config, options.config_must_exist);
  Examination e{options, machine, loaded.config, CallingAccount(), false, {}};
  CheckConfig(e, loaded);
  CheckAccount(e);
  CheckDaemon(e);
  CheckService(e);
  CheckCamera(e);
  CheckGpio(e);
  CheckStorage(e);
  CheckLinks(e);
  CheckClock(e);
  return std::move(e.found);
}

}  // namespace omnihdr::doctor
