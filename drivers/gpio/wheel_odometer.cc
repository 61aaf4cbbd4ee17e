#include "drivers/gpio/wheel_odometer.h"

#include <utility>

namespace omnihdr::gpio {
namespace {

// A second of a fast vehicle with a fine wheel.
constexpr std::size_t kPulsesKept = 4096;

MotionTrackOptions TrackOptions() {
  MotionTrackOptions options;
  options.capacity = kPulsesKept;
  options.extrapolate = false;
  return options;
}

}  // namespace

WheelOdometer::WheelOdometer(double pulses_per_metre, double start_m)
    : pulses_per_metre_(pulses_per_metre), start_m_(start_m), track_(TrackOptions()) {}

double WheelOdometer::Metres() const {
  return start_m_ + static_cast<double>(pulses_) / pulses_per_metre_;
}

void WheelOdometer::Begin(HostTime time) {
  {
    std::lock_guard lock(mutex_);
    track_.Add(time, Metres());
  }
  Tell();
}

void WheelOdometer::Pulse(HostTime time, std::uint64_t lost_before, bool estimated) {
  {
    std::lock_guard lock(mutex_);
    pulses_ += 1 + lost_before;
    lost_ += lost_before;
    if (estimated) estimated_ += lost_before;
    track_.Add(time, Metres());
  }
  Tell();
}

void WheelOdometer::Tell() {
  std::lock_guard lock(listener_mutex_);
  if (listener_) listener_();
}

std::optional<double> WheelOdometer::OdometerMetres(HostTime at) const {
  std::lock_guard lock(mutex_);
  return track_.At(at);
}

std::optional<HostTime> WheelOdometer::TimeAt(double odometer_m) const {
  std::lock_guard lock(mutex_);
  return track_.TimeAt(odometer_m);
}

void WheelOdometer::Listen(std::function<void()> listener) {
  std::lock_guard lock(listener_mutex_);
  listener_ = std::move(listener);
}

std::uint64_t WheelOdometer::lost() const {
  std::lock_guard lock(mutex_);
  return lost_;
}

std::uint64_t WheelOdometer::pulses() const {
  std::lock_guard lock(mutex_);
  return pulses_;
}

std::uint64_t WheelOdometer::estimated() const {
  std::lock_guard lock(mutex_);
  return estimated_;
}

}  // namespace omnihdr::gpio
