#pragma once

#include <sys/types.h>

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <nlohmann/json.hpp>

#include "core/session/session.h"
#include "daemon/api/client.h"
#include "tests/emulators/iidc_device.h"
#include "tests/emulators/umockdev_gpio.h"
#include "tests/emulators/umockdev_usb.h"
#include "tests/faults/storage_faults.h"
#include "tests/integration/programs.h"

namespace omnihdr::bench {

// Memory of a process, looked at five times a second.
class MemoryWatch {
 public:
  explicit MemoryWatch(pid_t pid);
  ~MemoryWatch();
  double peak_mb() const;
  // The peak of the second half of the time over that of the first: 1 when it does not grow.
  double growth() const;

 private:
  mutable std::mutex mutex_;
  std::vector<double> samples_;
  std::jthread thread_;
};

// Processes that do nothing but compute, at usual priority.
class CpuHogs {
 public:
  explicit CpuHogs(int count);
  ~CpuHogs();

 private:
  std::vector<pid_t> pids_;
};

struct HeadSize {
  int width = 1024;
  int rows = 768;  // of each of six sensors
};

// omnihdrd with an emulated six-sensor head on USB and a trigger line, in a directory of its own.
// Everything stops by GiveUp when it does not work at all.
class MeasuredDaemon {
 public:
  // `more` goes behind the configuration.
  MeasuredDaemon(const std::filesystem::path& directory, const HeadSize& size,
                 const std::string& more);

  // Edges in steady rhythm. How many the kernel would have lost.
  std::uint64_t Edges(double per_second, double seconds);
  std::uint64_t edges() const { return edges_; }
  // Until every trigger that was accepted has its line; seconds it took.
  double WaitUntilAnswered(double timeout_s = 300.0) const;
  // Ends the session, waits for all views; seconds it took.
  double FinishViews(double timeout_s) const;
  nlohmann::json Status() const;
  std::vector<FrameRecord> Journal() const;
  pid_t pid() const { return daemon_->pid(); }
  void Stop();
  // Milliseconds from an edge's own time to the command on the bus, of all frames that were taken.
  std::vector<double> CommandLatencies() const;
  faults::StorageFaults& storage() { return storage_; }
  std::filesystem::path session() const { return directory_ / "sessions" / "s"; }

 private:
  const std::filesystem::path directory_;
  const SystemClock clock_;
  std::shared_ptr<emulators::IidcDevice> device_;
  emulators::UmockdevUsb plug_;
  emulators::UmockdevGpio chip_;
  faults::StorageFaults storage_;
  std::unique_ptr<integration::Program> daemon_;
  std::uint64_t edges_ = 0;
};

// Starts one of our programs at the service's own priority, where that is allowed.
std::unique_ptr<integration::Program> StartAsService(const std::string& name,
                                                     const std::vector<std::string>& arguments,
                                                     const std::filesystem::path& log,
                                                     const std::vector<std::string>& environment);

// The share-th value of those sorted; NaN without any.
double Quantile(std::vector<double> values, double share);

// Ends the measurement: an exception that main tells of, so that the daemon and its files go.
[[noreturn]] void GiveUp(const std::string& message);

}  // namespace omnihdr::bench
