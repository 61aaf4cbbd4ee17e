// A day of a survey in minutes: omnihdrd with the simulated vehicle, its time made faster, faults
// on the way; memory, descriptors and latency recorded, drawn and judged. scripts/soak runs it.

#include <fmt/format.h>
#include <signal.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <stdexcept>
#include <thread>

#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "tests/faults/storage_faults.h"
#include "tests/integration/programs.h"
#include "tests/soak/soak_judge.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::soak {
namespace {

namespace fs = std::filesystem;
using faults::Call;
using integration::Eventually;
using integration::Program;

constexpr double kNanosecondsPerHour = 3.6e12;

struct SoakOptions {
  double hours = 24.0;
  int speed = 144;
  double interval_s = 4.0;
  std::uint64_t seed = 1;
  std::string plot = "soak.png";
  std::string directory;
};

// The daemon's time: as fast_clock_library.cc makes it.
class FastClock {
 public:
  explicit FastClock(int speed)
      : speed_(speed), begin_(SystemClock().Now()), begin_utc_(SystemClock().NowUtc()) {}
  HostTime Now() const {
    return begin_ + (SystemClock().Now() - begin_) * static_cast<std::int64_t>(speed_);
  }
  double HoursSince(HostTime start) const {
    return static_cast<double>((Now() - start).count()) / kNanosecondsPerHour;
  }
  std::string Environment() const {
    return fmt::format("OMNIHDR_FAST_CLOCK={} {} {}", speed_, begin_.ns(), begin_utc_.ns());
  }

 private:
  const int speed_;
  const HostTime begin_;
  const UtcTime begin_utc_;
};

// With the end of the daemon's log.
[[noreturn]] void GiveUp(const std::string& message, const Program& daemon) {
  const std::string log = daemon.Log();
  fmt::print(stderr, "soak: {}:\n{}\n", message,
             log.substr(log.size() - std::min<std::size_t>(log.size(), 4000)));
  throw std::runtime_error(message);  // the daemon and its files go on the way out
}

Sample Look(pid_t pid, double hour) {
  Sample sample;
  sample.hour = hour;
  double total = 0.0;
  double resident = 0.0;
  std::ifstream(fmt::format("/proc/{}/statm", pid)) >> total >> resident;
  sample.memory_mb = resident * static_cast<double>(::sysconf(_SC_PAGESIZE)) / (1024.0 * 1024.0);
  const auto count = [](const std::string& directory) {
    std::error_code error;
    return static_cast<double>(
        std::distance(fs::directory_iterator(directory, error), fs::directory_iterator()));
  };
  sample.descriptors = count(fmt::format("/proc/{}/fd", pid));
  sample.threads = count(fmt::format("/proc/{}/task", pid));
  return sample;
}

// What becomes of the storage in the course of a day. Each trouble begins at its hour and lasts
// some minutes. (The camera's are chances by frame, in the configuration.)
class Troubles {
 public:
  Troubles(faults::StorageFaults& storage, std::uint64_t seed, double hours) : storage_(storage) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> when(0.1, 0.7);
    // Three an hour; the last one is over before the day is.
    const int count = static_cast<int>(std::floor(3.0 * hours));
    for (int i = 0; i < count; ++i) {
      events_.push_back({(i + when(random)) / 3.0, 0.02 + 0.08 * when(random)});
    }
  }

  void Turn(double hour, HostTime now) {
    if (ends_ && hour >= *ends_) {
      storage_.Clear();
      ends_.reset();
      made_.back().to = now;
    }
    if (ends_ || next_ >= events_.size() || hour < events_[next_].hour) return;
    ends_ = hour + events_[next_].hours;
    made_.push_back({now, HostTime::FromNanoseconds(INT64_MAX / 2)});
    switch (next_++ % 3) {
      case 0:
        ++counts_["disk full"];
        return storage_.Fail({Call::kWrite, Call::kMakeDirectory, Call::kAllocate}, ENOSPC);
      case 1:
        ++counts_["disk slow"];
        return storage_.Slow(20'000, 0);
      default:
        ++counts_["disk gone"];
        return storage_.Fail(
            {Call::kOpen, Call::kWrite, Call::kSync, Call::kSyncDirectory, Call::kRename,
             Call::kMakeDirectory, Call::kRemove, Call::kTruncate, Call::kAllocate},
            ENODEV);
    }
  }
  const std::map<std::string, int>& counts() const { return counts_; }
  const std::vector<Trouble>& made() const { return made_; }

 private:
  struct Event {
    double hour = 0.0;
    double hours = 0.0;
  };
  faults::StorageFaults& storage_;
  std::vector<Event> events_;
  std::size_t next_ = 0;
  std::optional<double> ends_;
  std::map<std::string, int> counts_;
  std::vector<Trouble> made_;
};

int Run(const SoakOptions& options) {
  // In memory where that is possible: a day's synchronisations would be the disk's, not the day's.
  fs::path parent = fs::temp_directory_path();
  if (::access("/dev/shm", W_OK) == 0) parent = "/dev/shm";
  if (!options.directory.empty()) parent = options.directory;
  const testing::TemporaryDirectory scratch(parent);
  const fs::path& directory = scratch.path();
  const FastClock clock(options.speed);
  const fs::path session = directory / "sessions" / "s";
  faults::StorageFaults storage(directory / "faults", session);
  // Deadlines of a minute are some tenths of a second here; what the computer itself takes is part
  // of them.
  std::ofstream(directory / "c.toml") << fmt::format(
      "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
      "[camera]\ndriver = \"sim\"\nreconnect_s = 5.0\nframe_timeout_s = 60.0\n"
      "[camera.sim]\nscene = \"tunnel\"\nwidth = 128\nspeed_m_s = 0.05\n"
      "lost_frame_probability = 0.003\ncorrupt_frame_probability = 0.003\n"
      "exposure_error_probability = 0.003\nvanish_probability = 0.002\naway_s = 60.0\n"
      "[bracket]\nexposures_s = [0.001, 0.004, 0.016]\n"
      "[trigger]\nsource = \"timer\"\ninterval_s = {}\narmed_at_start = true\n"
      "[stereo]\nwidth = 128\nlabels = 16\n",
      options.interval_s);
  Program daemon(
      "omnihdrd", {"--config", (directory / "c.toml").string()}, directory / "log",
      {"LD_PRELOAD=" OMNIHDR_FAST_CLOCK_LIBRARY ":" OMNIHDR_STORAGE_FAULTS,
       "OMNIHDR_STORAGE_FAULTS=" + (directory / "faults").string(), clock.Environment()});
  // Triggers have their lines before the camera is there; the day begins with the first frame.
  if (!Eventually([&] {
        std::error_code none;
        return fs::directory_iterator(session / "raw", none) != fs::directory_iterator();
      })) {
    GiveUp("omnihdrd takes no frames", daemon);
  }

  const HostTime start = clock.Now();
  const auto begin = std::chrono::steady_clock::now();
  Troubles troubles(storage, options.seed, options.hours);
  SoakResult result;
  result.interval_s = options.interval_s;
  constexpr int kSamples = 240;
  for (double hour = 0.0; hour < options.hours; hour = clock.HoursSince(start)) {
    if (!daemon.running()) GiveUp("omnihdrd has ended", daemon);
    troubles.Turn(hour, clock.Now());
    if (hour >= options.hours * static_cast<double>(result.samples.size()) / kSamples) {
      result.samples.push_back(Look(daemon.pid(), hour));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  storage.Clear();
  ApiClient client(directory / "api.sock");
  // Its answers have a deadline of two seconds, of which so many go by here in no time.
  const auto ask = [&](const std::function<bool(const nlohmann::json&)>& holds) {
    return Eventually([&] {
      const auto status = client.Get("/v1/status");
      return status && holds(*status);
    });
  };
  if (!Eventually([&] { return static_cast<bool>(client.Post("/v1/disarm")); }) ||
      !ask([&](const nlohmann::json& status) {
        result.unlisted = status["triggers"]["lost_unlisted"].get<std::uint64_t>() +
                          status["triggers"]["refused"].get<std::uint64_t>();
        return status["triggers"]["in_flight"] == 0;
      })) {
    GiveUp("the triggers of the day are not all answered", daemon);
  }
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  daemon.Signal(SIGTERM);
  const int code = daemon.Wait(std::chrono::seconds(120));
  auto contents = ReadSession(session);
  if (!contents) GiveUp(contents.error().message, daemon);
  result.journal = std::move(contents->journal.frames);
  result.troubles = troubles.made();
  result.latencies = LatenciesOf(result.journal, start, options.hours, options.speed, kSamples / 5);

  std::map<std::string, int> by_status;
  for (const FrameRecord& record : result.journal) {
    ++by_status[std::string(ToString(record.status))];
  }
  std::error_code error;
  const auto views =
      std::distance(fs::directory_iterator(session / "views", error), fs::directory_iterator());
  fmt::print("{} hours in {:.0f} s: {} triggers, {} views\n", options.hours, seconds,
             result.journal.size(), views);
  for (const auto& [status, count] : by_status) fmt::print("  {}: {}\n", status, count);
  for (const auto& [name, count] : troubles.counts()) fmt::print("  {}: {} times\n", name, count);
  const MissCauses causes = CausesOf(result);
  fmt::print(
      "missed because: storage that was disturbed {}, camera unplugged {}, this computer too slow "
      "for time {} times as fast {}, anything else {}\n",
      causes.storage, causes.unplugged, options.speed, causes.slow, causes.other.size());
  const Sample& first = result.samples[result.samples.size() / 4];
  const Sample& last = result.samples.back();
  fmt::print(
      "after a quarter: {:.1f} MB, {:.0f} descriptors, {:.0f} threads; at the end: {:.1f} MB, "
      "{:.0f} descriptors, {:.0f} threads\n",
      first.memory_mb, first.descriptors, first.threads, last.memory_mb, last.descriptors,
      last.threads);
  std::vector<std::string> problems = Judge(result);
  if (code != 0) problems.push_back(fmt::format("omnihdrd ended with {}", code));
  if (const Status drawn = Draw(result, options.plot); !drawn) {
    problems.push_back(drawn.error().message);
  }
  fmt::print("drawn in {}\n", options.plot);
  for (const std::string& problem : problems) fmt::print(stderr, "soak: {}\n", problem);
  return problems.empty() ? 0 : 1;
}

int Main(int argc, char** argv) {
  SoakOptions options;
  CLI::App app("A day of a survey in minutes, judged for growth");
  app.add_option("--hours", options.hours, "of the daemon's time")->check(CLI::Range(0.1, 1000.0));
  app.add_option("--speed", options.speed, "how much faster its time is")
      ->check(CLI::Range(1, 1000));
  app.add_option("--interval", options.interval_s, "seconds of its time between triggers")
      ->check(CLI::Range(0.1, 3600.0));
  app.add_option("--seed", options.seed, "of the faults");
  app.add_option("--plot", options.plot, "picture of memory, descriptors, latency; .png or .svg");
  app.add_option("--directory", options.directory, "where the session is written");
  CLI11_PARSE(app, argc, argv);
  try {
    return Run(options);
  } catch (const std::exception&) {
    return 1;  // told before
  }
}

}  // namespace
}  // namespace omnihdr::soak

int main(int argc, char** argv) { return omnihdr::soak::Main(argc, argv); }
