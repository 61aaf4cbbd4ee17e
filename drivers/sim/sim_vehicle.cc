#include "drivers/sim/sim_vehicle.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace omnihdr::sim {
namespace {

Status CheckRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

}  // namespace

Status VehicleOptions::Validate() const {
  OMNIHDR_TRY(CheckRange("speed_m_s", speed_m_s, 0.001, 100.0));
  OMNIHDR_TRY(CheckRange("start_odometer_m", start_odometer_m, 0.0, 1e6));
  return CheckRange("max_distance_m", max_distance_m, 0.0, 1e6);
}

Status DistanceTriggerOptions::Validate() const {
  return CheckRange("distance_m", distance_m, 0.001, 1000.0);
}

SimVehicle::SimVehicle(const VehicleOptions& options, const Clock& clock)
    : options_(options), clock_(clock), odometer_m_(options.start_odometer_m) {}

void SimVehicle::Drive() {
  std::lock_guard lock(mutex_);
  if (!driving_since_) driving_since_ = clock_.Now();
}

void SimVehicle::Halt() {
  const HostTime now = clock_.Now();
  const double odometer = OdometerMetres(now).value_or(0.0);
  std::lock_guard lock(mutex_);
  if (!driving_since_) return;
  odometer_m_ = odometer;
  driving_since_.reset();
}

std::optional<double> SimVehicle::OdometerMetres(HostTime at) const {
  std::lock_guard lock(mutex_);
  double reading = odometer_m_;
  if (driving_since_ && at > *driving_since_) {
    reading += static_cast<double>((at - *driving_since_).count()) * 1e-9 * options_.speed_m_s;
  }
  if (options_.max_distance_m > 0.0) reading = std::min(reading, options_.max_distance_m);
  return reading;
}

std::optional<HostTime> SimVehicle::TimeAt(double odometer_m) const {
  std::lock_guard lock(mutex_);
  if (!driving_since_ || odometer_m < odometer_m_) return std::nullopt;
  if (options_.max_distance_m > 0.0 && odometer_m > options_.max_distance_m) return std::nullopt;
  const double seconds = (odometer_m - odometer_m_) / options_.speed_m_s;
  // Further than the clock reaches is never.
  if (seconds > 1e9) return std::nullopt;
  return *driving_since_ + Nanoseconds(static_cast<std::int64_t>(std::ceil(seconds * 1e9)));
}

DistanceTrigger::DistanceTrigger(const DistanceTriggerOptions& options,
                                 std::shared_ptr<SimVehicle> vehicle, const Clock& clock)
    : options_(options), vehicle_(std::move(vehicle)), clock_(clock) {}

Status DistanceTrigger::Start() {
  OMNIHDR_TRY(options_.Validate());
  if (started_) return {};
  const double odometer = vehicle_->OdometerMetres(clock_.Now()).value_or(0.0);
  // A mark stood on counts once: not again after a stop in front of it.
  const auto mark = static_cast<std::uint64_t>(std::ceil(odometer / options_.distance_m - 1e-9));
  next_ = std::max(next_, mark);
  started_ = true;
  vehicle_->Drive();
  return {};
}

Status DistanceTrigger::SetDistance(double distance_m) {
  DistanceTriggerOptions options = options_;
  options.distance_m = distance_m;
  OMNIHDR_TRY(options.Validate());
  const double odometer = vehicle_->OdometerMetres(clock_.Now()).value_or(0.0);
  options_ = options;
  next_ = static_cast<std::uint64_t>(std::ceil(odometer / distance_m - 1e-9));
  return {};
}

void DistanceTrigger::Stop() {
  if (!started_) return;
  started_ = false;
  vehicle_->Halt();
}

Result<std::optional<TriggerEvent>> DistanceTrigger::Poll() {
  if (!started_ || exhausted()) return std::nullopt;
  const std::optional<HostTime> due = vehicle_->TimeAt(NextMark());
  if (!due || *due > clock_.Now()) return std::nullopt;
  TriggerEvent event;
  event.time = *due;
  event.odometer_m = NextMark();
  ++next_;
  ++events_;
  return event;
}

std::optional<HostTime> DistanceTrigger::NextDeadline() const {
  if (!started_ || exhausted()) return std::nullopt;
  return vehicle_->TimeAt(NextMark());
}

bool DistanceTrigger::exhausted() const {
  if (options_.limit > 0 && events_ >= options_.limit) return true;
  const double end = vehicle_->options().max_distance_m;
  return end > 0.0 && NextMark() > end;
}

}  // namespace omnihdr::sim
