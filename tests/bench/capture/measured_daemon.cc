#include "tests/bench/capture/measured_daemon.h"

#include <fmt/format.h>
#include <sched.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <utility>

#include "core/session/session_reader.h"
#include "tests/emulators/iidc_link.h"

namespace omnihdr::bench {
namespace {

using integration::Eventually;
using integration::Program;

// Nice= of systemd/omnihdrd.service.
constexpr int kServiceNice = -5;
constexpr double kMegabyte = 1024.0 * 1024.0;

void UsualScheduling() {
  const sched_param none{};
  ::sched_setscheduler(0, SCHED_OTHER, &none);
}

emulators::IidcDeviceOptions Head(const HeadSize& size) {
  emulators::IidcDeviceOptions options;
  options.max_width = size.width;
  options.max_height = 6 * size.rows;
  options.rows_per_sensor = size.rows;
  options.readout_s = 0.005;
  options.grain = 3;
  return options;
}

}  // namespace

void GiveUp(const std::string& message) { throw std::runtime_error(message); }

MemoryWatch::MemoryWatch(pid_t pid)
    : thread_([this, pid](std::stop_token stop) {
        const double page = static_cast<double>(::sysconf(_SC_PAGESIZE));
        while (!stop.stop_requested()) {
          double total = 0.0;
          double resident = 0.0;
          std::ifstream(fmt::format("/proc/{}/statm", pid)) >> total >> resident;
          if (resident > 0.0) {
            std::lock_guard lock(mutex_);
            samples_.push_back(resident * page / kMegabyte);
          }
          std::this_thread::sleep_for(std::chrono::milliseconds(200));
        }
      }) {}

MemoryWatch::~MemoryWatch() = default;

double MemoryWatch::peak_mb() const {
  std::lock_guard lock(mutex_);
  return samples_.empty() ? 0.0 : *std::max_element(samples_.begin(), samples_.end());
}

double MemoryWatch::growth() const {
  std::lock_guard lock(mutex_);
  if (samples_.size() < 4) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = samples_.begin() + static_cast<std::ptrdiff_t>(samples_.size() / 2);
  return *std::max_element(middle, samples_.end()) / *std::max_element(samples_.begin(), middle);
}

CpuHogs::CpuHogs(int count) {
  for (int i = 0; i < count; ++i) {
    const pid_t pid = ::fork();
    if (pid == 0) {
      UsualScheduling();
      ::setpriority(PRIO_PROCESS, 0, 0);
      for (volatile bool on = true; on;) {
      }
      ::_exit(0);
    }
    pids_.push_back(pid);
  }
}

CpuHogs::~CpuHogs() {
  for (const pid_t pid : pids_) {
    ::kill(pid, SIGKILL);
    ::waitpid(pid, nullptr, 0);
  }
}

std::unique_ptr<Program> StartAsService(const std::string& name,
                                        const std::vector<std::string>& arguments,
                                        const std::filesystem::path& log,
                                        const std::vector<std::string>& environment) {
  const int before = ::getpriority(PRIO_PROCESS, 0);
  const int policy = ::sched_getscheduler(0);
  sched_param parameters{};
  ::sched_getparam(0, &parameters);
  UsualScheduling();
  ::setpriority(PRIO_PROCESS, 0, kServiceNice);  // refused without privilege: then as we are
  auto program = std::make_unique<Program>(name, arguments, log, environment);
  ::setpriority(PRIO_PROCESS, 0, before);
  ::sched_setscheduler(0, policy, &parameters);
  return program;
}

MeasuredDaemon::MeasuredDaemon(const std::filesystem::path& directory, const HeadSize& size,
                               const std::string& more)
    : directory_(directory),
      device_(std::make_shared<emulators::IidcDevice>(Head(size), clock_)),
      plug_(device_),
      chip_(plug_.testbed()),
      storage_(directory / "faults", session()) {
  std::ofstream(directory / "head.toml")
      << emulators::EmulatedRig(6, size.width, size.rows, device_->options().bayer);
  std::ofstream(directory / "c.toml")
      << "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
         "[storage]\nallow_root = true\n"
         "[camera]\ndriver = \"iidc\"\nreconnect_s = 0.2\n[camera.iidc]\nrig = \"head.toml\"\n"
         "[bracket]\nexposures_s = [0.001, 0.004, 0.016]\n"
         "[trigger]\nsource = \"gpio\"\narmed_at_start = true\n"
         "[gpio.trigger]\nchip = \"emulated\"\nline = \"trigger-in\"\n"
      << more;
  daemon_ =
      StartAsService("omnihdrd", {"--config", (directory / "c.toml").string()}, directory / "log",
                     {"LD_PRELOAD=" OMNIHDR_STORAGE_FAULTS ":" OMNIHDR_UMOCKDEV_PRELOAD,
                      "OMNIHDR_STORAGE_FAULTS=" + (directory / "faults").string()});
  const bool armed = Eventually([&] {
    const nlohmann::json status = Status();
    if (!status.is_object() || status["state"] != "armed") return false;
    return std::all_of(status["links"].begin(), status["links"].end(),
                       [](const auto& link) { return link["up"].template get<bool>(); });
  });
  if (!armed) GiveUp("omnihdrd does not become ready:\n" + daemon_->Log());
  // The camera keeps each picture it has made: the first of every exposure takes it longer.
  Edges(2.0, 3.0);
  WaitUntilAnswered();
}

std::uint64_t MeasuredDaemon::Edges(double per_second, double seconds) {
  std::uint64_t lost = 0;
  const auto count = static_cast<std::uint64_t>(std::llround(per_second * seconds));
  const auto start = std::chrono::steady_clock::now();
  for (std::uint64_t i = 0; i < count; ++i) {
    std::this_thread::sleep_until(
        start + std::chrono::duration_cast<std::chrono::nanoseconds>(
                    std::chrono::duration<double>(static_cast<double>(i) / per_second)));
    if (chip_.Edge()) {
      ++edges_;
    } else {
      ++lost;
    }
  }
  return lost;
}

nlohmann::json MeasuredDaemon::Status() const {
  auto status = ApiClient(directory_ / "api.sock").Get("/v1/status");
  return status ? *status : nlohmann::json();
}

double MeasuredDaemon::WaitUntilAnswered(double timeout_s) const {
  const HostTime start = clock_.Now();
  const bool answered = Eventually(
      [&] {
        const nlohmann::json status = Status();
        return status.is_object() && status["triggers"]["in_flight"] == 0 &&
               status["triggers"]["accepted"].get<std::uint64_t>() +
                       status["triggers"]["refused"].get<std::uint64_t>() >=
                   edges_;
      },
      std::chrono::seconds(static_cast<int>(timeout_s)));
  if (!answered) {
    GiveUp(fmt::format("{} edges are not all answered: {}", edges_, Status()["triggers"].dump()));
  }
  return static_cast<double>((clock_.Now() - start).count()) * 1e-9;
}

double MeasuredDaemon::FinishViews(double timeout_s) const {
  const HostTime start = clock_.Now();
  if (!ApiClient(directory_ / "api.sock").Post("/v1/finish")) GiveUp("finish is refused");
  const bool ended = Eventually(
      [&] {
        const nlohmann::json status = Status();
        return status.is_object() && status["session"]["ended"] == true;
      },
      std::chrono::seconds(static_cast<int>(timeout_s)));
  if (!ended) return std::numeric_limits<double>::infinity();
  return static_cast<double>((clock_.Now() - start).count()) * 1e-9;
}

std::vector<FrameRecord> MeasuredDaemon::Journal() const {
  auto contents = ReadSession(session());
  if (!contents) GiveUp(contents.error().message);
  return std::move(contents->journal.frames);
}

std::vector<double> MeasuredDaemon::CommandLatencies() const {
  const std::vector<HostTime> commands = device_->trigger_times();
  std::vector<double> latencies;
  auto command = commands.begin();
  for (const FrameRecord& record : Journal()) {
    if (record.status != FrameStatus::kOk) continue;
    // One picture at a time: the first command after the edge is its own.
    command = std::find_if(command, commands.end(),
                           [&](HostTime at) { return at >= record.trigger_time; });
    if (command == commands.end()) break;
    latencies.push_back(static_cast<double>((*command - record.trigger_time).count()) * 1e-6);
    ++command;
  }
  return latencies;
}

void MeasuredDaemon::Stop() {
  daemon_->Signal(SIGTERM);
  daemon_->Wait(std::chrono::seconds(60));
}

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(values.begin(), values.end());
  const auto last = static_cast<double>(values.size() - 1);
  return values[static_cast<std::size_t>(std::llround(share * last))];
}

}  // namespace omnihdr::bench
