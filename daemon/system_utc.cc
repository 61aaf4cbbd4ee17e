#include "daemon/system_utc.h"

#include <sys/timex.h>

namespace omnihdr {

UtcQuality InterpretAdjtimex(int state, int status, long max_error_us, int tai_s) {
  UtcQuality quality;
  quality.synchronised = state >= 0 && state != TIME_ERROR && (status & STA_UNSYNC) == 0;
  if (quality.synchronised) quality.error_s = static_cast<double>(max_error_us) * 1e-6;
  if (state >= 0 && tai_s != 0) quality.tai_offset_s = tai_s;
  return quality;
}

UtcQuality SystemUtc::Quality() const {
  std::lock_guard lock(mutex_);
  const HostTime now = clock_.Now();
  if (!asked_ || now - *asked_ >= std::chrono::seconds(1)) {
    timex query{};  // no modes: nothing is changed, no privilege needed
    const int state = adjtimex(&query);
    quality_ = InterpretAdjtimex(state, query.status, query.maxerror, query.tai);
    asked_ = now;
  }
  return quality_;
}

}  // namespace omnihdr
