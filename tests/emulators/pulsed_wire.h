#pragma once

#include <atomic>
#include <functional>
#include <string>
#include <utility>

#include "core/ports/camera_release.h"

namespace omnihdr::emulators {

// A wire to an emulated camera: what it does there at a pulse. Any thread.
class PulsedWire final : public CameraRelease {
 public:
  explicit PulsedWire(std::function<void()> pulse, Nanoseconds spacing = Nanoseconds(0))
      : pulse_(std::move(pulse)), spacing_(spacing) {}

  Result<Moment> Release(Nanoseconds /*patience*/) override {
    if (cut_) return Fail(ErrorKind::kUnavailable, "camera trigger: the wire is cut");
    Moment moment;
    moment.before = clock_.Now();
    pulse_();
    moment.after = clock_.Now();
    ++pulses_;
    return moment;
  }
  Nanoseconds spacing() const override { return spacing_; }

  void Cut(bool cut) { cut_ = cut; }
  int pulses() const { return pulses_; }

 private:
  const std::function<void()> pulse_;
  const Nanoseconds spacing_;
  const SystemClock clock_;
  std::atomic<bool> cut_{false};
  std::atomic<int> pulses_{0};
};

}  // namespace omnihdr::emulators
