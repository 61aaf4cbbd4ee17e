#include "daemon/vehicle_parts.h"

#include <memory>
#include <utility>

#include "drivers/gnss/gpsd_client.h"
#include "drivers/gpio/inputs.h"
#include "drivers/gpio/outputs.h"
#include "drivers/modbus/server.h"
#include "drivers/modbus/vehicle.h"
#include "drivers/trigger/odometer_trigger.h"

namespace omnihdr {
namespace {

const Clock& VehicleClock() {
  static const SystemClock clock;
  return clock;
}

// The place by GNSS, the heading by the vehicle, or by GNSS where the vehicle tells none.
class VehiclePlace final : public PlaceSource {
 public:
  VehiclePlace(std::shared_ptr<const PlaceSource> vehicle, std::shared_ptr<const PlaceSource> gnss)
      : vehicle_(std::move(vehicle)), gnss_(std::move(gnss)) {}
  std::optional<GnssFix> Fix(HostTime at) const override {
    return gnss_ ? gnss_->Fix(at) : std::nullopt;
  }
  bool has_receiver() const override { return gnss_ != nullptr; }
  std::optional<double> HeadingDeg(HostTime at) const override {
    std::optional<double> heading;
    if (vehicle_) heading = vehicle_->HeadingDeg(at);
    if (!heading && gnss_) heading = gnss_->HeadingDeg(at);
    return heading;
  }

 private:
  const std::shared_ptr<const PlaceSource> vehicle_;
  const std::shared_ptr<const PlaceSource> gnss_;
};

}  // namespace

Status AddVehicleParts(const DaemonConfig& config, const PartsContext& context, AppParts& parts) {
  std::shared_ptr<gpio::Inputs> inputs;
  gpio::InputsOptions lines = config.gpio.inputs;
  if (lines.trigger.name.configured() || lines.wheel.name.configured()) {
    OMNIHDR_TRY(lines.Validate().Context("gpio"));
    lines.start_m = context.last_odometer_m.value_or(0.0);
    inputs = std::make_shared<gpio::Inputs>(lines, gpio::MakeLines(), VehicleClock());
    parts.links.push_back(inputs);
  }
  if (config.gpio.outputs.configured()) {
    OMNIHDR_TRY(config.gpio.outputs.Validate().Context("gpio"));
    const auto outputs =
        std::make_shared<gpio::Outputs>(config.gpio.outputs, gpio::MakeLines(), VehicleClock());
    parts.links.push_back(outputs);
    parts.outputs.push_back(outputs);
    parts.strobe = outputs;
  }
  std::shared_ptr<modbus::Vehicle> vehicle;
  if (config.modbus.client.endpoint.connection != modbus::Connection::kOff) {
    modbus::VehicleOptions options = config.modbus.client;
    OMNIHDR_TRY(options.Validate().Context("modbus.client"));
    options.not_below_m = context.last_odometer_m;
    vehicle = std::make_shared<modbus::Vehicle>(options, VehicleClock());
    parts.links.push_back(vehicle);
  }
  if (config.modbus.server.endpoint.connection != modbus::Connection::kOff) {
    OMNIHDR_TRY(config.modbus.server.Validate().Context("modbus.server"));
    const auto server = std::make_shared<modbus::StatusServer>(
        config.modbus.server, config.modbus.control ? context.command : CommandHandler{},
        VehicleClock());
    parts.links.push_back(server);
    parts.outputs.push_back(server);
  }
  std::shared_ptr<gnss::GpsdClient> gnss;
  if (config.gnss.enabled) {
    OMNIHDR_TRY(config.gnss.gpsd.Validate().Context("gnss"));
    gnss = std::make_shared<gnss::GpsdClient>(config.gnss.gpsd, VehicleClock());
    parts.links.push_back(gnss);
  }
  if (vehicle || gnss) parts.place = std::make_shared<VehiclePlace>(vehicle, gnss);

  std::shared_ptr<Odometer> odometer;
  if (config.trigger.odometer == OdometerKind::kWheel) {
    odometer = inputs ? inputs->wheel() : nullptr;
    if (!odometer) {
      return Fail(ErrorKind::kConfig, "trigger.odometer: \"wheel\": expected gpio.wheel.line");
    }
  } else if (config.trigger.odometer == OdometerKind::kModbus) {
    if (!vehicle || !config.modbus.client.odometer.configured()) {
      return Fail(ErrorKind::kConfig,
                  "trigger.odometer: \"modbus\": expected modbus.client.odometer.register");
    }
    odometer = vehicle;
  }
  if (odometer) parts.positions = odometer;
  if (config.trigger.source == TriggerKind::kGpio) {
    if (!inputs || !inputs->trigger()) {
      return Fail(ErrorKind::kConfig, "trigger.source: \"gpio\": expected gpio.trigger.line");
    }
    parts.triggers = inputs->trigger();
  }
  if (config.trigger.source == TriggerKind::kDistance && odometer) {
    OdometerTriggerOptions options;
    options.distance_m = config.trigger.distance_m;
    OMNIHDR_TRY(options.Validate().Context("trigger distance"));
    const auto marks =
        std::make_shared<OdometerTrigger>(options, std::move(odometer), VehicleClock());
    parts.triggers = marks;
    parts.retune = [marks](const TriggerConfig& to) { return marks->SetDistance(to.distance_m); };
  }
  return {};
}

}  // namespace omnihdr
