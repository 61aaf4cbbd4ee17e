#pragma once

#include <cmath>
#include <compare>
#include <cstdint>
#include <numbers>

namespace omnihdr {

// log2 ratio of exposures; +1 stop doubles the light.
struct Stops {
  double value = 0.0;
  auto operator<=>(const Stops&) const = default;
};

// Time the sensor collects light, in seconds. Positive and finite when IsValid().
class ExposureTime {
 public:
  constexpr ExposureTime() = default;
  static constexpr ExposureTime Seconds(double seconds) { return ExposureTime(seconds); }
  constexpr double seconds() const { return seconds_; }
  bool IsValid() const { return std::isfinite(seconds_) && seconds_ > 0.0; }
  ExposureTime operator+(Stops stops) const { return Seconds(seconds_ * std::exp2(stops.value)); }
  // Stops from `other` to this: positive when this one is longer.
  Stops operator-(ExposureTime other) const { return Stops{std::log2(seconds_ / other.seconds_)}; }
  constexpr auto operator<=>(const ExposureTime&) const = default;

 private:
  explicit constexpr ExposureTime(double seconds) : seconds_(seconds) {}
  double seconds_ = 0.0;
};

// Sensor gain in dB of amplitude: 20 dB is a factor of ten.
struct GainDb {
  double value = 0.0;
  double Factor() const { return std::pow(10.0, value / 20.0); }
  auto operator<=>(const GainDb&) const = default;
};

// What decides how bright a pixel of given radiance becomes: time and gain.
struct Exposure {
  ExposureTime time;
  GainDb gain;
  // t·10^(dB/20): seconds at 0 dB that would give the same pixel value.
  double EffectiveSeconds() const { return time.seconds() * gain.Factor(); }
  bool IsValid() const { return time.IsValid() && std::isfinite(gain.value); }
  auto operator<=>(const Exposure&) const = default;
};

// Angle in radians; degrees appear only in configuration files and on screens.
class Radians {
 public:
  constexpr Radians() = default;
  explicit constexpr Radians(double value) : value_(value) {}
  static constexpr Radians FromDegrees(double degrees) {
    return Radians(degrees * std::numbers::pi / 180.0);
  }
  constexpr double value() const { return value_; }
  constexpr double degrees() const { return value_ * 180.0 / std::numbers::pi; }
  constexpr auto operator<=>(const Radians&) const = default;

 private:
  double value_ = 0.0;
};

// Number of a frame in its session's journal, from 0, in capture order.
enum class FrameId : std::uint64_t {};
// Number of a trigger since the session began, from 0; also counts triggers that gave no frame.
enum class TriggerId : std::uint64_t {};
// Number of a place at which one or more frames were taken.
enum class PositionId : std::int64_t {};

constexpr std::uint64_t Value(FrameId id) { return static_cast<std::uint64_t>(id); }
constexpr std::uint64_t Value(TriggerId id) { return static_cast<std::uint64_t>(id); }
constexpr std::int64_t Value(PositionId id) { return static_cast<std::int64_t>(id); }

}  // namespace omnihdr
