#pragma once

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr {

// A wire by which a camera is made to expose: every pulse on it is one exposure, with what the
// camera has been set to before. Any thread.
class CameraRelease {
 public:
  virtual ~CameraRelease() = default;

  // The wire became active between the two.
  struct Moment {
    HostTime before;
    HostTime after;
  };
  // Begins a pulse; its end comes by itself. While the pulse before lasts, or began less than
  // spacing() ago, it waits for that, `patience` at most. kTemporary: that takes longer;
  // kUnavailable: there is no such wire (yet), and no pulse was given.
  virtual Result<Moment> Release(Nanoseconds patience) = 0;
  // Least time from the begin of a pulse to the begin of the next.
  virtual Nanoseconds spacing() const = 0;
};

}  // namespace omnihdr
