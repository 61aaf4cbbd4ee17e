#pragma once

#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>

#include "core/base/clock.h"
#include "core/capture/motion_track.h"
#include "core/ports/trigger.h"

namespace omnihdr::gpio {

// The way by the pulses of a wheel. It has no direction: a vehicle that reverses adds to its way.
// Between two pulses the way is a straight line; after the newest it stays where it is.
class WheelOdometer final : public Odometer {
 public:
  WheelOdometer(double pulses_per_metre, double start_m);

  // A pulse, `lost_before` others before it that were not seen and, if `estimated`, are only
  // inferred from the train's rate: all count as way.
  void Pulse(HostTime time, std::uint64_t lost_before, bool estimated);
  // The line works from now on: the first reading, or one more of the same place.
  void Begin(HostTime time);

  std::optional<double> OdometerMetres(HostTime at) const override;
  std::optional<HostTime> TimeAt(double odometer_m) const override;
  void Listen(std::function<void()> listener) override;
  std::uint64_t lost() const override;

  std::uint64_t pulses() const;
  std::uint64_t estimated() const;  // of lost(), those whose number is inferred

 private:
  double Metres() const;
  void Tell();  // not with mutex_ held

  const double pulses_per_metre_;
  const double start_m_;
  mutable std::mutex mutex_;
  MotionTrack track_;
  std::uint64_t pulses_ = 0;
  std::uint64_t lost_ = 0;
  std::uint64_t estimated_ = 0;
  std::mutex listener_mutex_;
  std::function<void()> listener_;
};

}  // namespace omnihdr::gpio
