#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "core/base/clock.h"
#include "drivers/gpio/lines.h"

namespace omnihdr::gpio {

struct EdgeFilterOptions {
  Edge edge = Edge::kRising;
  // A contact bounces no longer than this: an edge within it after another one is none of its own.
  Nanoseconds debounce{0};
};

// From the kernel's edges to those that count. The first edge of a bouncing contact counts at once,
// what follows within the debounce time does not: a trigger must not wait for a contact to come to
// rest. (A kernel that debounces by itself delivers an edge when the line has been at rest so
// long.)
//
// With debouncing both edges must be asked of the kernel, else the bounces of a release would look
// like presses; RequestFor says which. Two equal edges at rest in a row then tell that one between
// them was lost. Not thread-safe.
class EdgeFilter {
 public:
  // `kernel_debounces`: as EdgeLine::debounced says.
  EdgeFilter(const EdgeFilterOptions& options, bool kernel_debounces);
  // The edges to ask of a kernel that cannot debounce.
  static Edge RequestFor(const EdgeFilterOptions& options);

  struct Counted {
    HostTime time;
    std::uint64_t lost_before = 0;  // edges that would have counted and are known to be lost
    // Edges before this one may be lost: the kernel's buffer was full and it does not count.
    bool doubtful = false;
  };
  std::optional<Counted> Take(const EdgeEvent& event);
  std::uint64_t bounces() const { return bounces_; }

 private:
  bool Wanted(bool rising) const;

  const EdgeFilterOptions options_;
  const bool filters_;  // by itself, on both edges
  std::optional<HostTime> last_time_;
  bool last_rising_ = false;
  std::uint64_t lost_ = 0;
  bool doubtful_ = false;
  std::uint64_t bounces_ = 0;
};

// How many pulses of an even train are missing before `time`, as far as the train before tells.
// For a kernel that drops pulses without counting them.
class PulseTrain {
 public:
  void Add(HostTime time);
  // 0 when the train is too short to tell, or stands.
  std::uint64_t MissingBefore(HostTime time) const;

 private:
  std::deque<HostTime> recent_;
};

}  // namespace omnihdr::gpio
