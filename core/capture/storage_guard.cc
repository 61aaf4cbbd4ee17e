#include "core/capture/storage_guard.h"

#include <fmt/format.h>

#include <utility>

namespace omnihdr {
namespace {

constexpr double kToLeave = 1.1;

// Which of two limits is not kept, with both values; empty when both are.
std::string Under(std::uint64_t free_bytes, const std::optional<double>& minutes_left,
                  double free_mb, double minutes, const char* name, bool before) {
  const double factor = before ? kToLeave : 1.0;
  const double free = static_cast<double>(free_bytes) / 1e6;
  if (free < free_mb * factor) {
    return fmt::format("{:.0f} MB are free, storage.{}_free_mb is {:g}", free, name, free_mb);
  }
  if (minutes_left && *minutes_left < minutes * factor) {
    return fmt::format("{:.1f} minutes are left at the present rate, storage.{}_minutes is {:g}",
                       *minutes_left, name, minutes);
  }
  return {};
}

}  // namespace

void StorageGuard::Add(HostTime time, std::uint64_t free_bytes, std::uint64_t total_bytes) {
  error_.clear();
  free_bytes_ = free_bytes;
  total_bytes_ = total_bytes;
  forecast_.Add(time, free_bytes);
}

void StorageGuard::Unreadable(std::string why) {
  error_ = std::move(why);
  free_bytes_.reset();
  total_bytes_.reset();
  forecast_.Unreadable();
}

StorageReport StorageGuard::Judge(const StorageLimits& limits) {
  StorageReport report;
  report.error = error_;
  if (!free_bytes_) return report;
  report.free_bytes = free_bytes_;
  report.total_bytes = total_bytes_;
  report.minutes_left = forecast_.MinutesLeft();
  report.stop = Under(*free_bytes_, report.minutes_left, limits.stop_free_mb, limits.stop_minutes,
                      "stop", stopped_);
  stopped_ = !report.stop.empty();
  const std::string warning = Under(*free_bytes_, report.minutes_left, limits.warn_free_mb,
                                    limits.warn_minutes, "warn", warned_);
  warned_ = !warning.empty();
  if (!stopped_) report.warning = warning;
  return report;
}

}  // namespace omnihdr
