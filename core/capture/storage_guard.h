#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "core/base/clock.h"
#include "core/capture/storage_forecast.h"

namespace omnihdr {

// When a storage is called low and when nothing more is put on it: by free space, and by minutes
// left at the rate at which it has been filled. 0 = that limit is off.
struct StorageLimits {
  double warn_free_mb = 1024.0;  // 10^6 bytes
  double warn_minutes = 30.0;
  double stop_free_mb = 256.0;
  double stop_minutes = 0.0;
};

// What is known about the storage. At most one of the texts is not empty: an unreadable storage is
// neither low nor full, it is unknown, which is an error of its own.
struct StorageReport {
  std::optional<std::uint64_t> free_bytes;
  std::optional<std::uint64_t> total_bytes;
  std::optional<double> minutes_left;
  std::string error;    // why it cannot be read
  std::string stop;     // which limit says that no more pictures may be stored
  std::string warning;  // which limit it has come under
};

// Watches a storage. Law: a limit that was reached is left only when there is a tenth more than it
// asks for, so that a state does not flicker at the limit. Not thread-safe.
class StorageGuard {
 public:
  void Add(HostTime time, std::uint64_t free_bytes, std::uint64_t total_bytes);
  void Unreadable(std::string why);
  StorageReport Judge(const StorageLimits& limits);

 private:
  StorageForecast forecast_;
  std::optional<std::uint64_t> free_bytes_;
  std::optional<std::uint64_t> total_bytes_;
  std::string error_;
  bool warned_ = false;
  bool stopped_ = false;
};

}  // namespace omnihdr
