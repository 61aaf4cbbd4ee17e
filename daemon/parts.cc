#include "daemon/parts.h"

#include <algorithm>
#include <utility>

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

sim::SceneKind Scene(SimScene scene) {
  switch (scene) {
    case SimScene::kHall:
      return sim::SceneKind::kHall;
    case SimScene::kYard:
      return sim::SceneKind::kYard;
    case SimScene::kTunnel:
      return sim::SceneKind::kTunnel;
    case SimScene::kStreet:
      return sim::SceneKind::kStreet;
  }
  return sim::SceneKind::kHall;
}

CameraOptions MakeIidcOptions(const CameraConfig& config) {
  const IidcCameraConfig& from = config.iidc;
  iidc::IidcCameraOptions options;
  options.id = from.id;
  options.rig_file = from.rig;
  options.format =
      from.format == IidcFormat::kJpeg ? iidc::PictureFormat::kJpeg : iidc::PictureFormat::kRaw;
  options.jpeg_quality = from.jpeg_quality;
  options.mode = from.mode;
  options.coding = from.coding == IidcCoding::kMono8 ? iidc::Coding::kMono8 : iidc::Coding::kRaw8;
  options.left = from.left;
  options.top = from.top;
  options.packet_bytes = from.packet_bytes;
  options.trigger_mode = from.trigger_mode;
  options.settle_frames = from.settle_frames;
  options.white_balance_blue = from.white_balance_blue;
  options.white_balance_red = from.white_balance_red;
  options.usb_recording = from.usb_recording;
  options.frame_timeout_s = config.frame_timeout_s;
  return options;
}

CameraOptions MakeCameraOptions(const DaemonConfig& config) {
  if (config.camera.driver == CameraDriver::kReplay) {
    ReplayOptions replay;
    replay.session = config.camera.replay.session;
    return replay;
  }
  if (config.camera.driver == CameraDriver::kIidc) return MakeIidcOptions(config.camera);
  if (config.camera.driver == CameraDriver::kV4l2) {
    v4l2::V4l2CameraOptions v4l2 = config.camera.v4l2;
    v4l2.frame_timeout_s = config.camera.frame_timeout_s;
    return v4l2;
  }
  const SimCameraConfig& from = config.camera.sim;
  sim::SimCameraOptions options;
  options.simulation.scene = Scene(from.scene);
  options.simulation.seed = from.seed;
  options.simulation.layout = from.layout == SimLayout::kRig ? Layout::kRig : Layout::kPanorama;
  options.simulation.rig_file = from.rig;
  options.simulation.sensor_width = from.sensor_width;
  options.simulation.projection = from.projection;
  options.simulation.width = from.width;
  options.simulation.motion.yaw_deg_per_m = from.yaw_deg_per_m;
  options.simulation.motion.sway_deg = from.sway_deg;
  options.simulation.movers.count = from.movers;
  options.simulation.movers.speed = std::min(from.mover_speed_m_s / from.speed_m_s, 100.0);
  options.simulation.sensor.full_well_e = from.photons_full_well;
  options.simulation.sensor.read_noise = from.read_noise;
  options.simulation.sensor.seed = from.seed;
  options.latency_s = from.latency_s;
  options.faults.lost_probability = from.lost_frame_probability;
  options.faults.torn_probability = from.corrupt_frame_probability;
  options.faults.exposure_probability = from.exposure_error_probability;
  // A timer knows no place: the vehicle then is where its speed has taken it.
  options.interval_m = config.trigger.source == TriggerKind::kTimer
                           ? config.trigger.interval_s * from.speed_m_s
                           : config.trigger.distance_m;
  return options;
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
  OMNIHDR_TRY(BracketPlan::Make(MakeBracketOptions(config.bracket), {}));
  return {};
}

Result<AppParts> MakeConfiguredParts(const DaemonConfig& config, const PartsContext& context) {
  AppParts parts;
  OMNIHDR_ASSIGN(parts.camera, MakeCamera(MakeCameraOptions(config)));
  switch (config.trigger.source) {
    case TriggerKind::kSoftware:
      parts.triggers = std::make_unique<SoftwareTrigger>();
      break;
    case TriggerKind::kTimer: {
      TimerTriggerOptions options;
      options.interval_s = config.trigger.interval_s;
      OMNIHDR_TRY(options.Validate().Context("trigger timer"));
      parts.triggers = std::make_unique<TimerTrigger>(options);
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
      parts.triggers =
          std::make_unique<sim::DistanceTrigger>(options, std::move(vehicle), WallClock());
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
