#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr {

// Something happened that asks for a picture.
struct TriggerEvent {
  HostTime time;                     // when, on the machine's monotonic clock
  std::optional<double> odometer_m;  // where, when the source knows
  std::uint64_t lost_before = 0;     // events of this source known to be lost since the last one
};

// Where triggers come from: GPIO edge, wheel distance, timer, software. Poll from one thread; the
// event loop waits on fd() (readable = Poll has something) or until NextDeadline().
class TriggerSource {
 public:
  virtual ~TriggerSource() = default;
  virtual std::string_view kind() const = 0;
  virtual Status Start() = 0;
  virtual void Stop() = 0;
  // The next event not yet delivered, or nothing. Never blocks. A source that has come to its end
  // (a replayed session, a count limit) answers nothing from then on and says so in exhausted().
  virtual Result<std::optional<TriggerEvent>> Poll() = 0;
  // File descriptor to watch, -1 for none.
  virtual int fd() const { return -1; }
  // When to Poll again at the latest; nothing = only when fd() is readable.
  virtual std::optional<HostTime> NextDeadline() const { return std::nullopt; }
  virtual bool exhausted() const { return false; }
};

// How far the vehicle has come. Any thread.
class PositionSource {
 public:
  virtual ~PositionSource() = default;
  virtual std::optional<double> OdometerMetres(HostTime at) const = 0;
};

}  // namespace omnihdr
