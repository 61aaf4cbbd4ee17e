#pragma once

#include <memory>

#include "core/base/clock.h"

namespace omnihdr::emulators {

// A GPIO chip "emulated" with one input line "trigger-in", by umockdev, for one program that is
// started after it was made: a line's edges come through a descriptor, which the program inherits
// from this one, so a line can be requested once. Edges have the kernel's form and the time at
// which they were made.
class UmockdevGpio {
 public:
  // `testbed` is that of UmockdevUsb, which must live longer.
  explicit UmockdevGpio(void* testbed);
  ~UmockdevGpio();
  UmockdevGpio(const UmockdevGpio&) = delete;
  UmockdevGpio& operator=(const UmockdevGpio&) = delete;

  // A rising edge now; false when 16 wait to be read: so many the kernel keeps, and
  // the next one is lost.
  bool Edge();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace omnihdr::emulators
