#include <malloc.h>

#include <cstdlib>
#include <ctime>
#include <fstream>
#include <string>

#include "tests/bench/bench.h"
#include "tests/bench/bench_session.h"

// What a long session costs: peak memory after N positions, and whether memory or time per position
// grow with their number. In a program of its own, whose memory is ours alone.
namespace omnihdr {
namespace {

constexpr double kMegabyte = 1e6;

double CpuSeconds() {
  timespec now{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// The largest resident set since the last reset, in bytes.
double PeakResident() {
  std::ifstream status("/proc/self/status");
  std::string line;
  while (std::getline(status, line)) {
    if (line.rfind("VmHWM:", 0) == 0) return 1024.0 * std::stod(line.substr(6));
  }
  std::abort();
}
void ResetPeak() {
  ::malloc_trim(0);
  std::ofstream("/proc/self/clear_refs") << "5";
}

// 24 positions of 2048×1024 with default options.
void PeakMemory(benchmark::State& state) {
  static const BenchDrive drive(2048, 7, 0.25, true);  // its PNG files count, some 20 MB
  double peak = 0.0;
  for (auto _ : state) {
    BenchSession session(drive);
    ResetPeak();
    for (int k = 0; k < 24; ++k) {
      session.RecordAndProcess(1);
      session.Forget();
    }
    peak = PeakResident();
  }
  state.counters["peak_mb"] = peak / kMegabyte;
}
OMNIHDR_BENCHMARK(PeakMemory, "Memory/omnihdr")->Iterations(1);

// 210 positions of small pictures. Ratios of the last fifty positions over the first fifty after
// the tenth: CPU time per position, and peak memory.
void Growth(benchmark::State& state) {
  static const BenchDrive drive(256, 9, 0.2, true);
  PipelineOptions options;
  options.stereo_width = 128;
  options.labels = 32;
  const auto spend = [](BenchSession& session, int positions) {
    ResetPeak();
    const double before = CpuSeconds();
    session.RecordAndProcess(positions);
    return CpuSeconds() - before;
  };
  double time_growth = 0.0;
  double memory_growth = 0.0;
  for (auto _ : state) {
    BenchSession session(drive, options);
    session.RecordAndProcess(10);
    const double early = spend(session, 50);
    const double early_peak = PeakResident();
    session.RecordAndProcess(100);
    const double late = spend(session, 50);
    time_growth = late / early;
    memory_growth = PeakResident() / early_peak;
  }
  state.counters["time_growth"] = time_growth;
  state.counters["memory_growth"] = memory_growth;
}
OMNIHDR_BENCHMARK(Growth, "TimeGrowth/omnihdr")->Iterations(1);
OMNIHDR_BENCHMARK(Growth, "MemoryGrowth/omnihdr")->Iterations(1);

}  // namespace
}  // namespace omnihdr
