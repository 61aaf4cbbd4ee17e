#pragma once

#include <mutex>
#include <optional>

#include "core/base/clock.h"
#include "core/ports/trigger.h"

namespace omnihdr {

// How good CLOCK_REALTIME is, as the kernel was told by whoever keeps it (adjtimex(2)): chrony,
// ntpd, systemd-timesyncd, ptp4l. Asked once a second at most. Any thread.
class SystemUtc final : public UtcReference {
 public:
  UtcQuality Quality() const override;

 private:
  const SystemClock clock_{};
  mutable std::mutex mutex_;
  mutable std::optional<HostTime> asked_;
  mutable UtcQuality quality_;
};

// From the state that adjtimex returns, its status bits, its bound of the error in microseconds,
// and its TAI offset in seconds (0 = nobody told it).
UtcQuality InterpretAdjtimex(int state, int status, long max_error_us, int tai_s);

}  // namespace omnihdr
