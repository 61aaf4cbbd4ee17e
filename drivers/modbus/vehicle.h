#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/stage.h"
#include "core/capture/appliance.h"
#include "core/capture/motion_track.h"
#include "core/ports/trigger.h"
#include "drivers/modbus/connection.h"
#include "drivers/modbus/registers.h"

namespace omnihdr::modbus {

struct VehicleOptions {
  Endpoint endpoint;
  double poll_s = 0.05;         // between readings, 0.005 to 60
  double timeout_s = 0.2;       // of one answer, and of connecting, 0.01 to 10
  double stale_s = 1.0;         // after which a reading does not count any more, 0.05 to 3600
  double reconnect_s = 5.0;     // longest pause between attempts, 0.1 to 3600
  double max_speed_m_s = 60.0;  // faster steps of the odometer are no way, 0.1 to 1000
  NumberSpec odometer;          // metres
  double odometer_wrap = 0.0;   // counts; 0 = the range of its type
  NumberSpec speed;             // metres per second
  NumberSpec heading;           // degrees clockwise from north
  // A number that the vehicle changes all the time; when it stands still, all that it tells is
  // stale.
  NumberSpec heartbeat;
  std::optional<double> not_below_m;  // see OdometerCounterOptions
  Status Validate() const;            // kConfig naming key, value and range
};

// The vehicle's own odometer, speed and heading, read from its registers by a thread of its own.
//
// A reading belongs to the middle of the exchange that brought it; between readings the way goes on
// in a straight line. Stale, and then not told any more, is what is older than stale_s, what comes
// with a heartbeat that has stood still for so long, and an odometer that has stood still for so
// long while the speed is more than 0.5 m/s.
class Vehicle final : public Odometer, public PlaceSource, public VehicleLink {
 public:
  // Options must be valid; `clock` must outlive the vehicle.
  Vehicle(const VehicleOptions& options, const Clock& clock);
  ~Vehicle() override;

  std::string_view name() const override { return "modbus vehicle"; }
  Status Start() override;
  LinkReport report() const override;

  std::optional<double> OdometerMetres(HostTime at) const override;
  std::optional<HostTime> TimeAt(double odometer_m) const override;
  void Listen(std::function<void()> listener) override;
  std::uint64_t lost() const override;
  std::optional<double> HeadingDeg(HostTime at) const override;
  std::optional<double> SpeedMetresPerSecond(HostTime at) const;

 private:
  // Registers that are read in one request, and which numbers they hold.
  struct Block {
    Table table = Table::kHolding;
    int address = 0;
    std::vector<std::uint16_t> registers;
  };
  struct Number {
    NumberSpec spec;
    const char* name = "";
    std::size_t block = 0;
    std::size_t offset = 0;
    double raw = 0.0;  // of the last poll
  };

  Status Run(std::stop_token stop, Stage& self);
  Status Poll();
  Status Take(HostTime time);
  double Value(const Number& number) const;

  const VehicleOptions options_;
  const Clock& clock_;
  // The thread's own.
  Client client_;
  std::vector<Block> blocks_;
  Number odometer_, speed_, heading_, heartbeat_;
  OdometerCounter counter_;
  std::optional<double> last_heartbeat_;
  HostTime heartbeat_since_;
  std::optional<double> last_raw_;
  HostTime moved_at_;

  mutable std::mutex mutex_;  // of what follows, up to the blank line
  MotionTrack track_;
  std::optional<double> speed_m_s_;
  std::optional<double> heading_deg_;
  HostTime newest_;
  LinkReport report_;
  std::uint64_t resets_ = 0;

  std::mutex listener_mutex_;
  std::function<void()> listener_;
  std::unique_ptr<Stage> stage_;  // last: uses everything
};

}  // namespace omnihdr::modbus
