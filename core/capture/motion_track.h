#pragma once

#include <cstddef>
#include <deque>
#include <limits>
#include <optional>

#include "core/base/clock.h"

namespace omnihdr {

struct MotionTrackOptions {
  std::size_t capacity = 512;  // readings kept
  // How long after the newest reading it still counts.
  Nanoseconds valid{std::numeric_limits<Nanoseconds::rep>::max()};
  // Whether the way is taken to go on at the present speed between readings; otherwise it stays
  // where the newest reading is (a counter that tells only changes).
  bool extrapolate = true;
  // How long after the newest reading it goes on: when the next one does not come, it stays there.
  Nanoseconds ahead{std::numeric_limits<Nanoseconds::rep>::max()};
};

// The recent readings of an odometer, in order of time, and what follows from them for the moments
// between: straight lines. Law: At(TimeAt(x)) = x to rounding for every x between two readings of a
// way without standing or reversing. Not thread-safe.
class MotionTrack {
 public:
  explicit MotionTrack(const MotionTrackOptions& options = {}) : options_(options) {}

  // A reading; one that is not after the newest is ignored. `speed_m_s` when it is told, else it
  // follows from the readings of the last half second.
  void Add(HostTime time, double metres, std::optional<double> speed_m_s = std::nullopt);
  void Clear();

  // Nothing before the oldest reading kept and from `valid` after the newest.
  std::optional<double> At(HostTime time) const;
  // When a reading was last passed going up; ahead, when it will be. Nothing when that is not
  // known. All readings at or above it: the time of the oldest.
  std::optional<HostTime> TimeAt(double metres) const;
  double speed_m_s() const { return speed_m_s_; }
  std::optional<HostTime> newest() const;

 private:
  struct Reading {
    HostTime time;
    double metres = 0.0;
  };
  void UpdateSpeed(std::optional<double> told);

  MotionTrackOptions options_;
  std::deque<Reading> readings_;
  double speed_m_s_ = 0.0;
};

}  // namespace omnihdr
