#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/session/session.h"

namespace omnihdr {

// Something happened that asks for a picture.
struct TriggerEvent {
  HostTime time;                     // when, on the machine's monotonic clock
  std::optional<double> odometer_m;  // where, when the source knows
  std::uint64_t lost_before = 0;     // events of this source known to be lost since the last one
  std::string lost_reason;           // how they were lost; empty = not known
  // The vehicle has not come here but stands here since its way is counted: a picture of it may be
  // taken later as well, while it stands.
  bool standing = false;
};

// Events of a source that are known to be lost, and how; an empty reason = not known.
struct LostEvents {
  std::uint64_t count = 0;
  std::string reason;
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
  // Whether its events can only come of a camera that is there (a recording's, a simulation's):
  // such a source is not started before the camera is ready. All others are started when armed, so
  // that what comes without a camera is accounted for.
  virtual bool needs_camera() const { return false; }
  // Events known to be lost that no delivered event has told of, taken out of the source: what it
  // owes when it is about to be stopped.
  virtual LostEvents TakeLost() { return {}; }
};

// How far the vehicle has come. Any thread.
class PositionSource {
 public:
  virtual ~PositionSource() = default;
  virtual std::optional<double> OdometerMetres(HostTime at) const = 0;
};

// A PositionSource that tells of its news, so that marks on the way can trigger. Any thread.
class Odometer : public PositionSource {
 public:
  // When a reading was reached; for a reading ahead, when it will be at the present speed. Nothing
  // when that is not known: no reading yet, standing, or too far ahead to tell.
  virtual std::optional<HostTime> TimeAt(double odometer_m) const = 0;
  // Called after every new reading, from the odometer's own thread; must not block, nor call the
  // odometer. Empty = nobody listens; on return the old listener is not running any more.
  virtual void Listen(std::function<void()> listener) = 0;
  // Readings known to be missing or wrong so far, such as pulses that were lost.
  virtual std::uint64_t lost() const { return 0; }
};

// How good the machine's UTC is.
struct UtcQuality {
  bool synchronised = false;        // by NTP, PTP or PPS, as the kernel was told
  std::optional<double> error_s;    // bound of the error, when synchronised
  std::optional<int> tai_offset_s;  // TAI − UTC, when the kernel was told
};

// Any thread.
class UtcReference {
 public:
  virtual ~UtcReference() = default;
  virtual UtcQuality Quality() const = 0;
};

// Where the vehicle is and which way it looks, told by others than its odometer. Any thread.
class PlaceSource {
 public:
  virtual ~PlaceSource() = default;
  // The newest fix that was known at that time; nothing when there was none or it was too old.
  virtual std::optional<GnssFix> Fix(HostTime) const { return std::nullopt; }
  // Whether fixes are to be expected at all: a frame without one is then marked.
  virtual bool has_receiver() const { return false; }
  // Clockwise from north, degrees in [0, 360).
  virtual std::optional<double> HeadingDeg(HostTime) const { return std::nullopt; }
};

}  // namespace omnihdr
