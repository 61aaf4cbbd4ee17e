#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "drivers/v4l2/exposure_control.h"

namespace omnihdr::v4l2 {

// `b` comes after `a`, numbers wrapping at 32 bits.
inline std::int32_t SequenceDistance(std::uint32_t from, std::uint32_t to) {
  return static_cast<std::int32_t>(to - from);
}

// Which exposure was in force for a frame: settings act some frames after they are written. Law: an
// answer is given only when it is certain; between the first frame that a write may act on and the
// one from which it acts for sure, and before what the log remembers, there is none.
class ExposureLog {
 public:
  static constexpr std::size_t kMemory = 16;

  // `latency`: frames from a write to the first one it acts on for sure; `least`: to the first one
  // it may act on. Both at least 1 = the next one.
  void Reset(int latency, int least = 1) {
    latency_ = latency;
    least_ = least;
    entries_.clear();
  }
  int latency() const { return latency_; }
  int least() const { return least_; }
  // Written when `after` was the newest frame that had been completed.
  void Wrote(std::uint32_t after, const SetExposure& exposure) {
    if (entries_.size() == kMemory) entries_.pop_front();
    entries_.push_back({after, exposure});
  }
  std::optional<SetExposure> InForce(std::uint32_t frame) const {
    for (auto entry = entries_.rbegin(); entry != entries_.rend(); ++entry) {
      const std::int32_t since = SequenceDistance(entry->after, frame);
      if (since >= latency_) return entry->exposure;
      if (since >= least_) return std::nullopt;
    }
    return std::nullopt;
  }

 private:
  struct Entry {
    std::uint32_t after = 0;
    SetExposure exposure;
  };
  int latency_ = 1;
  int least_ = 1;
  std::deque<Entry> entries_;
};

}  // namespace omnihdr::v4l2
