// Measures capture by omnihdrd, as a process of its own, on an emulated bus; prints one JSON
// object. scripts/bench capture runs it and holds the numbers against tests/bench/targets.json.

#include <fmt/format.h>
#include <malloc.h>
#include <sched.h>
#include <signal.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <thread>

#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "tests/bench/capture/measured_daemon.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::bench {
namespace {

namespace fs = std::filesystem;
using integration::Eventually;
using nlohmann::json;

struct MeterOptions {
  double seconds = 60.0;
  double rate = 10.0;
  std::vector<std::string> only;
  std::string directory;
  bool Wants(const std::string& phase) const {
    return only.empty() || std::find(only.begin(), only.end(), phase) != only.end();
  }
};

// How many lines ended how, and that each that was lost says why.
json Account(const std::vector<FrameRecord>& journal) {
  std::map<std::string, std::uint64_t> by_status;
  std::map<std::string, std::uint64_t> by_reason;
  std::uint64_t without_reason = 0;
  std::uint64_t unproved = 0;
  for (const FrameRecord& record : journal) {
    ++by_status[std::string(ToString(record.status))];
    if (record.status != FrameStatus::kOk) ++by_reason[record.detail];
    if (record.status != FrameStatus::kOk && record.detail.empty()) ++without_reason;
    if (record.status == FrameStatus::kOk && record.proof == ExposureProof::kNone) ++unproved;
  }
  return {{"lines", journal.size()},
          {"by_status", by_status},
          {"by_reason", by_reason},
          {"lost_without_reason", without_reason},
          {"ok_without_proof", unproved}};
}

std::uint64_t CountOk(const std::vector<FrameRecord>& journal) {
  return static_cast<std::uint64_t>(
      std::count_if(journal.begin(), journal.end(),
                    [](const FrameRecord& record) { return record.status == FrameStatus::kOk; }));
}

// Edges that neither have a line nor are known to be lost: none may be.
std::int64_t Unaccounted(const MeasuredDaemon& daemon, const std::vector<FrameRecord>& journal) {
  const json triggers = daemon.Status()["triggers"];
  const std::uint64_t known = journal.size() + triggers["refused"].get<std::uint64_t>() +
                              triggers["lost_unlisted"].get<std::uint64_t>() +
                              triggers["ignored"].get<std::uint64_t>();
  return static_cast<std::int64_t>(daemon.edges()) - static_cast<std::int64_t>(known);
}

// Raw frames of a Ladybug2's size in steady rhythm while the views keep the processors busy.
json MeasureRate(const fs::path& directory, const MeterOptions& options) {
  MeasuredDaemon daemon(directory, {}, "");
  const MemoryWatch memory(daemon.pid());
  const std::size_t before = daemon.Journal().size();
  const std::uint64_t lost_in_kernel = daemon.Edges(options.rate, options.seconds);
  const double drain_s = daemon.WaitUntilAnswered();
  std::vector<FrameRecord> journal = daemon.Journal();
  const json account = Account(journal);
  const std::int64_t unaccounted = Unaccounted(daemon, journal);
  journal.erase(journal.begin(), journal.begin() + static_cast<std::ptrdiff_t>(before));
  std::vector<double> latencies = daemon.CommandLatencies();
  latencies.erase(latencies.begin(), latencies.begin() + static_cast<std::ptrdiff_t>(
                                                             std::min(before, latencies.size())));
  std::uintmax_t bytes = 0;
  for (const FrameRecord& record : journal) {
    std::error_code error;
    if (!record.file.empty()) bytes += fs::file_size(daemon.session() / record.file, error);
  }
  const std::uint64_t ok = CountOk(journal);
  const json views = daemon.Status()["views"];
  const json result = {
      {"edges_per_second", options.rate},
      {"seconds", options.seconds},
      {"edges", daemon.edges() - before},
      {"lost_in_kernel", lost_in_kernel},
      {"frames_ok", ok},
      {"frames_per_second", static_cast<double>(ok) / (options.seconds + drain_s)},
      {"frames_lost", journal.size() - ok},
      {"unaccounted", unaccounted},
      {"drain_s", drain_s},
      {"megabytes_per_frame",
       static_cast<double>(bytes) / static_cast<double>(std::max<std::uint64_t>(ok, 1)) / 1e6},
      {"command_latency_ms",
       {{"frames", latencies.size()},
        {"p50", Quantile(latencies, 0.5)},
        {"p99", Quantile(latencies, 0.99)},
        {"most", Quantile(latencies, 1.0)}}},
      {"views_finished", views["finished"]},
      {"views_backlog", views["backlog"]},
      {"peak_mb", memory.peak_mb()},
      {"memory_growth", memory.growth()},
      {"account", account}};
  daemon.Stop();
  return result;
}

// Edges far faster than the camera can.
json MeasureOverload(const fs::path& directory, const MeterOptions& options) {
  constexpr double kOverload = 8.0;
  MeasuredDaemon daemon(directory, {}, "[pipeline]\nenabled = false\n");
  const double seconds = std::min(options.seconds, 20.0);
  const std::uint64_t lost_in_kernel = daemon.Edges(kOverload * options.rate, seconds);
  const double drain_s = daemon.WaitUntilAnswered();
  const std::vector<FrameRecord> journal = daemon.Journal();
  const std::uint64_t ok = CountOk(journal);
  const json result = {
      {"edges_per_second", kOverload * options.rate},
      {"achieved_per_second", static_cast<double>(ok) / (seconds + drain_s)},
      {"edges", daemon.edges()},
      {"edges_over_frames", static_cast<double>(daemon.edges()) / static_cast<double>(ok)},
      {"lost_in_kernel", lost_in_kernel},
      {"unaccounted", Unaccounted(daemon, journal)},
      {"account", Account(journal)}};
  daemon.Stop();
  return result;
}

// A disk that takes a quarter of a second to synchronise and programs that take the processors;
// then both end, and the views must catch up.
json MeasureStress(const fs::path& directory, const MeterOptions& options) {
  MeasuredDaemon daemon(directory, {256, 192},
                        "[stereo]\nwidth = 256\nlabels = 32\n[recorder]\nqueue_frames = 4\n");
  const MemoryWatch memory(daemon.pid());
  const double seconds = std::min(options.seconds, 20.0);
  const std::size_t before = daemon.Journal().size();
  double drain_s = 0.0;
  std::vector<double> latencies;
  std::uint64_t lost_in_kernel = 0;
  {
    const CpuHogs hogs(4);
    daemon.storage().Slow(250'000, 0);
    lost_in_kernel = daemon.Edges(8.0, seconds);
    latencies = daemon.CommandLatencies();
    daemon.storage().Slow(0, 0);
    drain_s = daemon.WaitUntilAnswered();
  }
  // Capture is whole again.
  const std::size_t stressed = daemon.Journal().size();
  daemon.Edges(2.0, 5.0);
  daemon.WaitUntilAnswered();
  const std::vector<FrameRecord> journal = daemon.Journal();
  std::uint64_t lost_after = 0;
  for (std::size_t i = stressed; i < journal.size(); ++i) {
    if (journal[i].status != FrameStatus::kOk) ++lost_after;
  }
  const std::int64_t unaccounted = Unaccounted(daemon, journal);
  const std::int64_t backlog = daemon.Status()["views"]["backlog"].get<std::int64_t>();
  const double catch_up_s = daemon.FinishViews(600.0);
  const json result = {{"edges", daemon.edges()},
                       {"lost_in_kernel", lost_in_kernel},
                       {"frames_ok_meanwhile", CountOk(journal) - lost_after - before},
                       {"drain_s", drain_s},
                       {"lost_afterwards", lost_after},
                       {"unaccounted", unaccounted},
                       {"command_latency_ms",
                        {{"p50", Quantile(latencies, 0.5)}, {"p99", Quantile(latencies, 0.99)}}},
                       {"views_backlog", backlog},
                       {"catch_up_s", catch_up_s},
                       {"caught_up", std::isfinite(catch_up_s)},
                       {"peak_mb", memory.peak_mb()},
                       {"account", Account(journal)}};
  daemon.Stop();
  return result;
}

// From the trigger of the last position that a view needs, two on, to the view, of a vehicle that
// drives at a pace the device keeps up with: pictures of 2048 × 1024 as recorded, so that the views
// have something to match.
json MeasureViews(const fs::path& directory, const MeterOptions& options) {
  constexpr int kNeighbours = 2;  // on each side: stereo.neighbours
  const int positions = static_cast<int>(std::clamp(options.seconds / 2.0, 5.0, 30.0));
  const auto [code, output] = integration::RunOmnihdr(
      {"simulate", (directory / "source").string(), "--scene", "tunnel", "--width", "2048",
       "--positions", std::to_string(positions), "--samples", "1"},
      directory);
  if (code != 0) GiveUp("omnihdr simulate: " + output);
  std::ofstream(directory / "c.toml")
      << "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
         "[camera]\ndriver = \"replay\"\n[camera.replay]\nsession = \"source\"\n"
         "[trigger]\nsource = \"software\"\narmed_at_start = true\n";
  const auto daemon = StartAsService("omnihdrd", {"--config", (directory / "c.toml").string()},
                                     directory / "log", {});
  ApiClient client(directory / "api.sock");
  const fs::path views = directory / "sessions" / "s" / "views";
  std::vector<double> seconds;
  for (int i = 0; i < positions; ++i) {
    if (!Eventually([&] { return static_cast<bool>(client.Post("/v1/trigger")); })) {
      GiveUp("no trigger is accepted:\n" + daemon->Log());
    }
    const auto triggered = std::chrono::steady_clock::now();
    if (i < kNeighbours) continue;
    const fs::path view = views / ViewDirectoryName(PositionId{i - kNeighbours}) / "radiance.exr";
    if (!Eventually([&] { return fs::exists(view); }, std::chrono::seconds(60))) {
      GiveUp(view.string() + ": does not come");
    }
    seconds.push_back(
        std::chrono::duration<double>(std::chrono::steady_clock::now() - triggered).count());
  }
  daemon->Signal(SIGTERM);
  daemon->Wait(std::chrono::seconds(60));
  return {{"views", seconds.size()},
          {"p50_s", Quantile(seconds, 0.5)},
          {"p95_s", Quantile(seconds, 0.95)},
          {"most_s", Quantile(seconds, 1.0)}};
}

int Main(int argc, char** argv) {
  MeterOptions options;
  CLI::App app("Measures capture by omnihdrd on an emulated bus");
  app.add_option("--seconds", options.seconds, "of frames in steady rhythm")
      ->check(CLI::Range(1.0, 86400.0));
  app.add_option("--rate", options.rate, "frames a second")->check(CLI::Range(0.1, 1000.0));
  app.add_option("--only", options.only, "phases: rate, overload, stress, views");
  app.add_option("--directory", options.directory, "where the sessions are written");
  CLI11_PARSE(app, argc, argv);

  // This process is the camera, the vehicle and the bus, which need no processor of the
  // appliance's: before all of its threads. Refused without privilege: then as we are.
  constexpr int kHardwareNice = -15;
  ::setpriority(PRIO_PROCESS, 0, kHardwareNice);
  sched_param hardware{};
  hardware.sched_priority = 30;
  ::sched_setscheduler(0, SCHED_FIFO, &hardware);
  // Memory that it has touched once it keeps: a virtual machine's host may take tens of
  // milliseconds to give a frame's worth of fresh pages, in which the emulated camera would not
  // answer.
  ::mallopt(M_MMAP_THRESHOLD, 1 << 30);
  ::mallopt(M_TRIM_THRESHOLD, 1 << 30);
  const fs::path parent =
      options.directory.empty() ? fs::temp_directory_path() : fs::path(options.directory);
  // Six megabytes a frame and more for views, at most.
  const double needed = options.Wants("rate") ? options.seconds * options.rate * 6e6 + 2e9 : 2e9;
  std::error_code error;
  const auto space = fs::space(parent, error);
  if (error || static_cast<double>(space.available) < needed) {
    GiveUp(fmt::format("{}: {:.0f} GB are needed", parent.string(), needed / 1e9));
  }
  json report;
  const auto measure = [&](const char* phase,
                           json (*function)(const fs::path&, const MeterOptions&)) {
    if (!options.Wants(phase)) return;
    const testing::TemporaryDirectory directory(parent);
    fmt::print(stderr, "capture_meter: {}\n", phase);
    report[phase] = function(directory.path(), options);
  };
  measure("rate", MeasureRate);
  measure("overload", MeasureOverload);
  measure("stress", MeasureStress);
  measure("views", MeasureViews);
  std::cout << report.dump(1) << "\n";
  // What holds on any machine, however slow.
  std::int64_t wrong = 0;
  for (const auto& [phase, result] : report.items()) {
    if (!result.contains("account")) continue;
    wrong += std::abs(result["unaccounted"].get<std::int64_t>());
    wrong += result["account"]["lost_without_reason"].get<std::int64_t>();
    wrong += result["account"]["ok_without_proof"].get<std::int64_t>();
  }
  if (report.contains("stress") && report["stress"]["caught_up"] != true) ++wrong;
  if (wrong > 0) fmt::print(stderr, "capture_meter: not everything is accounted for\n");
  return wrong > 0 ? 1 : 0;
}

}  // namespace
}  // namespace omnihdr::bench

int main(int argc, char** argv) {
  try {
    return omnihdr::bench::Main(argc, argv);
  } catch (const std::exception& e) {
    fmt::print(stderr, "capture_meter: {}\n", e.what());
    return 1;
  }
}
