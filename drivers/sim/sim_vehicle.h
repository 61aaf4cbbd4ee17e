#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>

#include "core/base/clock.h"
#include "core/ports/trigger.h"

namespace omnihdr::sim {

struct VehicleOptions {
  double speed_m_s = 1.0;         // 0.001 to 100
  double start_odometer_m = 0.0;  // reading before it first drives
  double max_distance_m = 0.0;    // odometer reading at which it stops for good; 0 = never
  Status Validate() const;        // kConfig error naming the option and its range
};

// A vehicle that drives at a constant speed while told to, with an odometer. Any thread.
class SimVehicle final : public PositionSource {
 public:
  // Options must be valid; `clock` must outlive the vehicle.
  SimVehicle(const VehicleOptions& options, const Clock& clock);

  void Drive();  // idempotent
  void Halt();   // idempotent; the odometer stays
  std::optional<double> OdometerMetres(HostTime at) const override;
  // When a reading is reached at the present speed: nothing while halted, behind, or beyond the
  // end.
  std::optional<HostTime> TimeAt(double odometer_m) const;
  const VehicleOptions& options() const { return options_; }

 private:
  const VehicleOptions options_;
  const Clock& clock_;
  mutable std::mutex mutex_;
  double odometer_m_;  // when it last started or halted
  std::optional<HostTime> driving_since_;
};

struct DistanceTriggerOptions {
  double distance_m = 0.3;  // 0.001 to 1000
  std::uint64_t limit = 0;  // events before it is exhausted; 0 = none
  Status Validate() const;
};

// Wheel pulses: an event at every multiple of the distance that the odometer reaches, the starting
// place included. The vehicle drives while the trigger is started. Events carry the time and place
// at which the mark was passed, however late they are polled; none is lost.
class DistanceTrigger final : public TriggerSource {
 public:
  DistanceTrigger(const DistanceTriggerOptions& options, std::shared_ptr<SimVehicle> vehicle,
                  const Clock& clock);
  std::string_view kind() const override { return "distance"; }
  Status Start() override;
  void Stop() override;
  Result<std::optional<TriggerEvent>> Poll() override;
  // The distance between marks, counted from where the vehicle is.
  Status SetDistance(double distance_m);
  std::optional<HostTime> NextDeadline() const override;
  bool exhausted() const override;
  // The vehicle of a simulation does not drive off before its camera has been rendered.
  bool needs_camera() const override { return true; }

 private:
  double NextMark() const { return static_cast<double>(next_) * options_.distance_m; }

  DistanceTriggerOptions options_;
  const std::shared_ptr<SimVehicle> vehicle_;
  const Clock& clock_;
  bool started_ = false;
  std::uint64_t next_ = 0;  // number of the next mark
  std::uint64_t events_ = 0;
};

}  // namespace omnihdr::sim
