#include "core/capture/storage_forecast.h"

namespace omnihdr {
namespace {

constexpr Nanoseconds kWindow = std::chrono::minutes(2);
constexpr Nanoseconds kShortest = std::chrono::seconds(5);
constexpr Nanoseconds kPause = std::chrono::seconds(30);  // nothing written for so long is a pause

}  // namespace

void StorageForecast::Add(HostTime time, std::uint64_t free_bytes) {
  if (!readings_.empty()) {
    const Reading last = readings_.back();
    if (time <= last.time) return;
    const bool shrank = free_bytes < last.free_bytes;
    // After a pause, or when something was deleted, the rate begins anew.
    if (shrank && time - shrank_ >= kPause) readings_ = {last};
    if (free_bytes > last.free_bytes) readings_.clear();
    if (shrank) shrank_ = time;
  } else {
    shrank_ = time;
  }
  readings_.push_back({time, free_bytes});
  while (readings_.size() > 2 && time - readings_.front().time > kWindow) readings_.pop_front();
  const Reading& first = readings_.front();
  const Nanoseconds passed = time - first.time;
  if (time - shrank_ >= kPause || passed < kShortest || first.free_bytes <= free_bytes) return;
  bytes_per_second_ = static_cast<double>(first.free_bytes - free_bytes) /
                      (static_cast<double>(passed.count()) * 1e-9);
}

std::optional<double> StorageForecast::MinutesLeft() const {
  if (readings_.empty() || !(bytes_per_second_ > 0.0)) return std::nullopt;
  return static_cast<double>(readings_.back().free_bytes) / bytes_per_second_ / 60.0;
}

}  // namespace omnihdr
