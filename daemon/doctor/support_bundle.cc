#include "daemon/doctor/support_bundle.h"

#include <fmt/chrono.h>
#include <link.h>
#include <sys/utsname.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <regex>
#include <set>
#include <sstream>
#include <system_error>
#include <utility>

#include "core/base/file.h"
#include "daemon/api/client.h"
#include "daemon/doctor/checks.h"

namespace omnihdr::doctor {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr std::size_t kMaxFile = std::size_t{1} << 20;
constexpr std::size_t kMaxAll = std::size_t{16} << 20;
constexpr std::size_t kJournalTail = std::size_t{256} << 10;
constexpr std::size_t kMaxLine = 4096;  // looked at for secrets; longer ones are cut
constexpr int kMaxSessions = 10;
constexpr std::size_t kMaxViews = 3;
constexpr std::chrono::seconds kPackTimeout(60);

// The last `bytes` of a file, from a line's begin.
Result<std::string> Tail(const fs::path& path, std::size_t bytes) {
  std::ifstream in(path, std::ios::binary | std::ios::ate);
  if (!in) return Fail(ErrorKind::kNoInput, "{}: cannot be read", path.string());
  const auto end = static_cast<std::size_t>(std::max<std::streamoff>(in.tellg(), 0));
  const std::size_t begin = end > bytes ? end - bytes : 0;
  in.seekg(static_cast<std::streamoff>(begin));
  std::string text(end - begin, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(std::max<std::streamsize>(in.gcount(), 0)));
  if (begin > 0) text.erase(0, text.find('\n') + 1);
  return text;
}

// The files of the shared libraries in this process, links resolved: a name such as
// libusb-1.0.so.0.3.0 tells the version.
std::set<std::string> LoadedLibraries() {
  std::set<std::string> files;
  const auto add = [](dl_phdr_info* info, std::size_t, void* found) {
    std::error_code error;
    const fs::path file = fs::canonical(info->dlpi_name, error);
    // The program itself and the kernel's part have no name of a file.
    if (!error && info->dlpi_name[0] == '/') {
      static_cast<std::set<std::string>*>(found)->insert(file.string());
    }
    return 0;
  };
  ::dl_iterate_phdr(add, &files);
  return files;
}

std::string Iso(UtcTime time) {
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}",
                     fmt::gmtime(static_cast<std::time_t>(time.ns() / 1'000'000'000)));
}

void RemovePlaces(Json& json) {
  if (!json.is_object() && !json.is_array()) return;
  if (json.is_object()) {
    for (const char* key : {"lat", "lon", "alt_m", "truth"}) json.erase(key);
  }
  for (Json& value : json) RemovePlaces(value);
}

std::string Dump(const Json& json, int indent = 1) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

// Journal lines without places; a line that is no JSON is told by its length.
std::string JournalWithoutPlaces(const std::string& text) {
  std::string out;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    Json json = Json::parse(line, nullptr, false);
    if (json.is_discarded()) {
      out += fmt::format("(no JSON: {} bytes)\n", line.size());
      continue;
    }
    RemovePlaces(json);
    out += Dump(json, -1) + "\n";
  }
  return out;
}

class Bundle {
 public:
  Bundle(const BundleOptions& options, const Machine& machine)
      : options_(options), machine_(machine) {}
  ~Bundle() {
    std::error_code ignored;
    if (!folder_.empty()) fs::remove_all(folder_, ignored);
  }
  Bundle(const Bundle&) = delete;
  Bundle& operator=(const Bundle&) = delete;

  Result<BundleReport> Write() {
    std::string pattern = (fs::temp_directory_path() / "omnihdr-support-XXXXXX").string();
    if (::mkdtemp(pattern.data()) == nullptr) {
      return FailErrno(ErrorKind::kCannotCreate, "support bundle", errno);
    }
    folder_ = pattern;
    loaded_ = LoadConfig(options_.doctor.config, options_.doctor.config_must_exist);
    AddVersions();
    AddDoctor();
    AddDaemon();
    AddConfig();
    AddSystem();
    AddSessions();
    Json manifest = {{"version", OMNIHDR_VERSION},
                     {"made", Iso(machine_.utc())},
                     {"left_out", "pixels, places (lat, lon, alt_m), values named like secrets"},
                     {"files", report_.files},
                     {"missing", report_.missing}};
    Add("manifest.json", Dump(manifest));
    if (failed_) return Forward(*failed_);
    OMNIHDR_TRY(Pack());
    return std::move(report_);
  }

 private:
  void Add(const std::string& name, std::string text) {
    // The end of a log is what matters.
    if (text.size() > kMaxFile) text.erase(0, text.size() - kMaxFile);
    if (bytes_ + text.size() > kMaxAll) {
      report_.missing.push_back(fmt::format("{}: the bundle is full", name));
      return;
    }
    const fs::path file = folder_ / "omnihdr-support" / name;
    std::error_code error;
    fs::create_directories(file.parent_path(), error);
    if (const Status written = WriteFileAtomic(file, text); !written) {
      if (!failed_) failed_ = written.error();
      return;
    }
    bytes_ += text.size();
    report_.files.push_back(name);
  }
  void Add(const std::string& name, const Result<std::string>& text) {
    if (text) {
      Add(name, WithoutSecrets(*text));
    } else {
      report_.missing.push_back(fmt::format("{}: {}", name, text.error().message));
    }
  }
  void AddFile(const std::string& name, const fs::path& path) { Add(name, Tail(path, kMaxFile)); }

  void AddVersions() {
    utsname kernel{};
    ::uname(&kernel);
    std::string text = fmt::format("omnihdr {}\n{} {} {} {}\n", OMNIHDR_VERSION, kernel.sysname,
                                   kernel.release, kernel.version, kernel.machine);
    text += machine_.Text("/etc/os-release") + "\n";
    const std::set<std::string> libraries = LoadedLibraries();
    text += fmt::format("--- packages\n{}--- loaded\n", Packages(libraries));
    for (const std::string& library : libraries) text += library + "\n";
    Add("versions.txt", text);
  }

  // Ours, those of the libraries that this program has loaded (the daemon's but for libgpiod), and
  // what the daemon talks to.
  std::string Packages(const std::set<std::string>& libraries) const {
    std::set<std::string> files = libraries;
    for (const std::string& library : libraries) {
      // A package may give the path without it.
      if (library.starts_with("/usr/")) files.insert(library.substr(4));
    }
    std::set<std::string> names = {"gpsd", "libgpiod*", "omnihdr", "systemd", "udev"};
    std::vector<std::string> search = {"dpkg-query", "--search"};
    search.insert(search.end(), files.begin(), files.end());
    // "package: path" or "package, package: path" a line; files of no package are told of as well.
    const Result<std::string> owners = machine_.run(search);
    std::istringstream found(owners ? *owners : "");
    for (std::string line; std::getline(found, line);) {
      const std::size_t end = line.rfind(": ");
      if (end == std::string::npos || !files.contains(line.substr(end + 2))) continue;
      std::istringstream packages(line.substr(0, end));
      for (std::string name; std::getline(packages >> std::ws, name, ',');) names.insert(name);
    }
    std::vector<std::string> versions = {"dpkg-query", "-W"};
    versions.insert(versions.end(), names.begin(), names.end());
    const Result<std::string> packages = machine_.run(versions);
    return packages ? *packages : packages.error().message + "\n";
  }

  void AddDoctor() {
    std::string text;
    Json checks = Json::array();
    for (const Diagnosis& d : Examine(options_.doctor, machine_)) {
      checks.push_back({{"check", d.check},
                        {"verdict", ToString(d.verdict)},
                        {"found", d.found},
                        {"remedy", d.remedy}});
    }
    Add("doctor.json", WithoutSecrets(Dump(checks)));
  }

  void AddDaemon() {
    ApiClient client(loaded_.config.api.socket, options_.doctor.timeout);
    const Result<nlohmann::json> status = client.Get("/v1/status");
    if (status) {
      Json json =
          Json::parse(status->dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
      RemovePlaces(json);
      Add("status.json", Dump(json));
      Add("metrics.txt", client.GetText("/metrics"));
    } else {
      report_.missing.push_back(fmt::format("status.json: {}", status.error().message));
    }
    Add("log.txt", machine_.run({"journalctl", "-u", "omnihdrd", "-b", "-n", "2000", "--no-pager",
                                 "-o", "short-iso-precise"}));
    Add("service.txt", machine_.run({"systemctl", "show", "omnihdrd.service", "--no-pager"}));
  }

  void AddConfig() {
    for (const std::string& file : loaded_.files) {
      AddFile("config/" + fs::path(file).filename().string(), file);
    }
    if (loaded_.ok()) Add("config/in-force.toml", WithoutSecrets(FormatConfig(loaded_)));
  }

  void AddSystem() {
    std::string usb;
    const fs::path devices = "/sys/bus/usb/devices";
    std::error_code error;
    std::vector<std::string> ports;
    for (fs::directory_iterator it(machine_.At(devices), error), end; !error && it != end;
         it.increment(error)) {
      ports.push_back(it->path().filename().string());
    }
    std::sort(ports.begin(), ports.end());
    for (const std::string& port : ports) {
      const auto text = [&](const char* file) { return machine_.Text(devices / port / file); };
      if (text("idVendor").empty()) continue;
      usb += fmt::format("{:<12} {}:{} {} | {} | serial {} | {} Mbit/s, {}, power {}\n", port,
                         text("idVendor"), text("idProduct"), text("manufacturer"), text("product"),
                         text("serial"), text("speed"), text("version"), text("power/control"));
    }
    usb += fmt::format("usbfs_memory_mb {}\n",
                       machine_.Text("/sys/module/usbcore/parameters/usbfs_memory_mb"));
    Add("usb.txt", usb);
    std::string nodes;
    for (const char* pattern : {"video", "v4l-subdev", "gpiochip", "ttyUSB", "ttyACM"}) {
      std::vector<std::string> names;
      for (fs::directory_iterator it(machine_.At("/dev"), error), end; !error && it != end;
           it.increment(error)) {
        const std::string name = it->path().filename().string();
        if (name.starts_with(pattern)) names.push_back(name);
      }
      std::sort(names.begin(), names.end());
      for (const std::string& name : names) {
        const auto node = machine_.node(machine_.At(fs::path("/dev") / name));
        nodes += fmt::format("{} /dev/{}\n", node ? DescribeNode(machine_, *node) : "?", name);
      }
    }
    Add("devices.txt", nodes);
    std::string system;
    for (const char* file : {"/proc/cmdline", "/proc/uptime", "/proc/loadavg", "/proc/meminfo",
                             "/proc/self/mounts", "/proc/cpuinfo"}) {
      system += fmt::format("--- {}\n{}\n", file, machine_.Text(file));
    }
    Add("system.txt", WithoutSecrets(system));
    Add("modules.txt", machine_.Text("/proc/modules"));
    Add("disks.txt", machine_.run({"df", "-h", "-T"}));
    Add("kernel-log.txt", machine_.run({"dmesg", "--time-format", "iso"}));
  }

  void AddSessions() {
    const fs::path directory = loaded_.config.session.directory;
    std::vector<std::pair<std::string, fs::path>> sessions;  // by session.json's date
    std::error_code error;
    for (fs::directory_iterator it(directory, error), end; !error && it != end;
         it.increment(error)) {
      std::error_code ignored;
      if (!fs::exists(it->path() / "session.json", ignored)) continue;
      const auto info = Tail(it->path() / "session.json", kMaxFile);
      const Json json = info ? Json::parse(*info, nullptr, false) : Json();
      sessions.emplace_back(json.is_object() ? json.value("created", "") : "", it->path());
    }
    std::sort(sessions.begin(), sessions.end(), std::greater<>());
    if (!options_.session.empty()) {
      sessions.insert(sessions.begin(), {"", options_.session});
    }
    if (sessions.empty()) {
      report_.missing.push_back(fmt::format("sessions: none in {}", directory.string()));
      return;
    }
    for (std::size_t k = 0; k < std::min<std::size_t>(sessions.size(), kMaxSessions); ++k) {
      AddSession(sessions[k].second, k == 0);
    }
  }

  void AddSession(const fs::path& session, bool in_full) {
    const std::string name =
        "sessions/" +
        (session.has_filename() ? session : session.parent_path()).filename().string();
    AddFile(name + "/session.json", session / "session.json");
    if (!in_full) return;
    std::error_code error;
    for (const char* file : {"ended.json", "rig.toml"}) {
      if (fs::exists(session / file, error)) AddFile(name + "/" + file, session / file);
    }
    if (const auto tail = Tail(session / "frames.jsonl", kJournalTail); tail) {
      Add(name + "/frames-tail.jsonl", JournalWithoutPlaces(*tail));
    } else {
      report_.missing.push_back(fmt::format("{}/frames.jsonl: {}", name, tail.error().message));
    }
    if (const auto tail = Tail(session / "timings.jsonl", kJournalTail); tail) {
      Add(name + "/timings-tail.jsonl", *tail);
    }
    std::vector<std::string> views;
    for (fs::directory_iterator it(session / "views", error), end; !error && it != end;
         it.increment(error)) {
      views.push_back(it->path().filename().string());
    }
    std::sort(views.begin(), views.end(), std::greater<>());
    for (std::size_t k = 0; k < std::min(views.size(), kMaxViews); ++k) {
      const auto text = Tail(session / "views" / views[k] / "view.json", kMaxFile);
      Json json = text ? Json::parse(*text, nullptr, false) : Json();
      if (!json.is_object()) continue;
      json.erase("resume");
      Add(fmt::format("{}/views/{}.json", name, views[k]), Dump(json));
    }
  }

  // The folder as a whole file, by a rename.
  Status Pack() {
    fs::path temporary = options_.out;
    temporary += ".tmp";
    const Result<std::string> said =
        RunProgram({"tar", "-czf", temporary.string(), "-C", folder_.string(), "--owner=0",
                    "--group=0", "omnihdr-support"},
                   kPackTimeout);
    std::error_code error;
    const std::uintmax_t size = said ? fs::file_size(temporary, error) : 0;
    if (!said || error || !said->empty()) {
      std::error_code ignored;
      fs::remove(temporary, ignored);
      return Fail(ErrorKind::kCannotCreate, "{}: tar: {}", options_.out.string(),
                  !said           ? said.error().message
                  : said->empty() ? error.message()
                                  : *said);
    }
    fs::rename(temporary, options_.out, error);
    if (error) {
      return Fail(ErrorKind::kCannotCreate, "{}: {}", options_.out.string(), error.message());
    }
    report_.bytes = size;
    return {};
  }

  const BundleOptions& options_;
  const Machine& machine_;
  fs::path folder_;
  LoadedConfig loaded_;
  BundleReport report_;
  std::size_t bytes_ = 0;
  std::optional<Error> failed_;
};

}  // namespace

std::string WithoutSecrets(const std::string& text) {
  static const std::regex named(
      R"(((?:password|passwd|passphrase|secret|token|credential|private|(?:api|access|auth|psk|wpa)[_-]?key)[A-Za-z0-9_.-]*"?\s*[=:]\s*)("""[\s\S]*?"""|'[^']*'|"(?:\\.|[^"\\])*"|[^\s,;}]+))",
      std::regex::icase);
  static const std::regex in_url(R"((://)[^/\s:@"']+:[^/\s@"']+@)");
  std::string out;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.size() > kMaxLine) line = line.substr(0, kMaxLine) + "...";
    line = std::regex_replace(line, named, "$1\"(removed)\"");
    out += std::regex_replace(line, in_url, "$1(removed)@") + "\n";
  }
  return out;
}

Result<BundleReport> WriteSupportBundle(const BundleOptions& options, const Machine& machine) {
  return Bundle(options, machine).Write();
}

}  // namespace omnihdr::doctor
