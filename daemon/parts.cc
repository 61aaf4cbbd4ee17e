#include "daemon/parts.h"

#include <algorithm>
#include <utility>

#include "daemon/camera_parts.h"
#include "daemon/vehicle_parts.h"
#include "drivers/all_drivers.h"
#include "drivers/sim/sim_vehicle.h"
#include "drivers/trigger/software_trigger.h"
#include "drivers/trigger/timer_trigger.h"

namespace omnihdr {
namespace {

const Clock& WallClock() {
  static const SystemClock clock;
  return clock;
}

sim::VehicleOptions MakeVehicleOptions(const DaemonConfig& config, std::uint64_t first_trigger) {
  sim::VehicleOptions options;
  options.speed_m_s = config.camera.sim.speed_m_s;
  options.max_distance_m = config.camera.sim.max_distance_m;
  // The simulated vehicle waits where it was when the daemon went away.
  options.start_odometer_m = static_cast<double>(first_trigger) * config.trigger.distance_m;
  return options;
}

}  // namespace

Status CheckParts(const DaemonConfig& config) {
  PartsContext context;
  OMNIHDR_TRY(MakeConfiguredParts(config, context));
  OMNIHDR_TRY(config.pipeline.options.Validate());
  // Limits of the camera are not known yet: what no camera could do is refused here.
  OMNIHDR_TRY(BracketPlan::Make(MakeBracketOptions(config.bracket, config.trigger.burst), {}));
  return {};
}

Result<AppParts> MakeConfiguredParts(const DaemonConfig& config, const PartsContext& context) {
  AppParts parts;
  const std::shared_ptr<gpio::CameraTrigger> release = MakeCameraTrigger(config);
  if (release) {
    OMNIHDR_TRY(config.gpio.CameraTrigger().Validate().Context("gpio"));
    parts.links.push_back(release);
  }
  OMNIHDR_ASSIGN(parts.camera,
                 MakeCamera(MakeCameraOptions(config, config.trigger.wired, release)));
  switch (config.trigger.source) {
    case TriggerKind::kSoftware:
      parts.triggers = std::make_unique<SoftwareTrigger>();
      break;
    case TriggerKind::kTimer: {
      TimerTriggerOptions options;
      options.interval_s = config.trigger.interval_s;
      OMNIHDR_TRY(options.Validate().Context("trigger timer"));
      const auto timer = std::make_shared<TimerTrigger>(options);
      parts.triggers = timer;
      parts.retune = [timer](const TriggerConfig& to) { return timer->SetInterval(to.interval_s); };
      break;
    }
    case TriggerKind::kGpio:
      break;  // by AddVehicleParts
    case TriggerKind::kDistance: {
      if (config.trigger.odometer != OdometerKind::kSim) break;  // by AddVehicleParts
      const sim::VehicleOptions vehicle_options = MakeVehicleOptions(config, context.first_trigger);
      OMNIHDR_TRY(vehicle_options.Validate().Context("camera sim"));
      sim::DistanceTriggerOptions options;
      options.distance_m = config.trigger.distance_m;
      OMNIHDR_TRY(options.Validate().Context("trigger distance"));
      auto vehicle = std::make_shared<sim::SimVehicle>(vehicle_options, WallClock());
      parts.positions = vehicle;
      const auto marks =
          std::make_shared<sim::DistanceTrigger>(options, std::move(vehicle), WallClock());
      parts.triggers = marks;
      parts.retune = [marks](const TriggerConfig& to) { return marks->SetDistance(to.distance_m); };
      break;
    }
    case TriggerKind::kReplay: {
      auto camera = std::dynamic_pointer_cast<const ReplayCamera>(parts.camera);
      if (!camera) {
        return Fail(ErrorKind::kConfig,
                    "trigger.source: \"replay\": expected camera.driver = \"replay\" with it");
      }
      ReplayTriggerOptions options;
      options.first = context.first_trigger;
      options.room = context.room;
      parts.triggers = std::make_unique<ReplayTrigger>(std::move(camera), options);
      break;
    }
  }
  OMNIHDR_TRY(AddVehicleParts(config, context, parts));
  if (config.pipeline.enabled) {
    ProcessorOptions how;
    how.overload = config.pipeline.overload;
    parts.open_pipeline = [options = config.pipeline.options, how](
                              const std::filesystem::path& session, ProcessorCallbacks callbacks) {
      return SessionProcessor::Open(session, {}, options, std::move(callbacks), how);
    };
  }
  return parts;
}

}  // namespace omnihdr
