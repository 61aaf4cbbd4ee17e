#include "daemon/camera_parts.h"

#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

namespace omnihdr {
namespace {

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

iidc::Coding Coding(IidcCoding coding) {
  switch (coding) {
    case IidcCoding::kRaw8:
      return iidc::Coding::kRaw8;
    case IidcCoding::kMono8:
      return iidc::Coding::kMono8;
    case IidcCoding::kRaw16:
      return iidc::Coding::kRaw16;
    case IidcCoding::kMono16:
      return iidc::Coding::kMono16;
  }
  return iidc::Coding::kRaw8;
}

iidc::CycleUse CycleUse(IidcCycle use) {
  switch (use) {
    case IidcCycle::kAuto:
      return iidc::CycleUse::kAuto;
    case IidcCycle::kOff:
      return iidc::CycleUse::kOff;
    case IidcCycle::kOn:
      return iidc::CycleUse::kOn;
  }
  return iidc::CycleUse::kAuto;
}

CameraOptions MakeIidcOptions(const CameraConfig& config, bool wired,
                              std::shared_ptr<CameraRelease> release) {
  const IidcCameraConfig& from = config.iidc;
  iidc::IidcCameraOptions options;
  options.id = from.id;
  options.bus = from.bus == IidcBus::kFirewire ? iidc::CameraBus::kFirewire : iidc::CameraBus::kUsb;
  options.rig_file = from.rig;
  options.format =
      from.format == IidcFormat::kJpeg ? iidc::PictureFormat::kJpeg : iidc::PictureFormat::kRaw;
  options.jpeg_quality = from.jpeg_quality;
  options.mode = from.mode;
  options.coding = Coding(from.coding);
  options.left = from.left;
  options.top = from.top;
  options.packet_bytes = from.packet_bytes;
  options.trigger_mode = from.trigger_mode;
  options.wired = wired;
  options.release = std::move(release);
  options.trigger_input = from.trigger_input;
  options.trigger_active_low = from.trigger_active_low;
  options.settle_frames = from.settle_frames;
  options.exposure_cycle = CycleUse(from.exposure_cycle);
  options.white_balance_blue = from.white_balance_blue;
  options.white_balance_red = from.white_balance_red;
  options.usb_recording = from.usb_recording;
  options.frame_timeout_s = config.frame_timeout_s;
  return options;
}

}  // namespace

CameraOptions MakeCameraOptions(const DaemonConfig& config, bool wired,
                                std::shared_ptr<CameraRelease> release) {
  if (config.camera.driver == CameraDriver::kReplay) {
    ReplayOptions replay;
    replay.session = config.camera.replay.session;
    return replay;
  }
  if (config.camera.driver == CameraDriver::kIidc) {
    return MakeIidcOptions(config.camera, wired, std::move(release));
  }
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
  options.wired = wired;
  options.release = std::move(release);
  options.faults.lost_probability = from.lost_frame_probability;
  options.faults.torn_probability = from.corrupt_frame_probability;
  options.faults.exposure_probability = from.exposure_error_probability;
  options.faults.vanish_probability = from.vanish_probability;
  options.faults.away_s = from.away_s;
  // A timer knows no place: the vehicle then is where its speed has taken it.
  options.interval_m = config.trigger.source == TriggerKind::kTimer
                           ? config.trigger.interval_s * from.speed_m_s
                           : config.trigger.distance_m;
  return options;
}

std::shared_ptr<gpio::CameraTrigger> MakeCameraTrigger(const DaemonConfig& config) {
  if (!config.gpio.camera_trigger.configured()) return nullptr;
  static const SystemClock clock;
  return std::make_shared<gpio::CameraTrigger>(config.gpio.CameraTrigger(), gpio::MakeLines(),
                                               clock);
}

std::shared_ptr<CameraRelease> MakeReplayedCameraTrigger(const DaemonConfig& config) {
  class Replayed final : public CameraRelease {
   public:
    Result<Moment> Release(Nanoseconds /*patience*/) override {
      const HostTime now = clock_.Now();
      return Moment{now, now};
    }
    Nanoseconds spacing() const override { return Nanoseconds(0); }

   private:
    SystemClock clock_;
  };
  if (!config.gpio.camera_trigger.configured()) return nullptr;
  return std::make_shared<Replayed>();
}

Result<std::shared_ptr<CameraRelease>> OpenCameraTrigger(const DaemonConfig& config) {
  constexpr auto kLook = std::chrono::milliseconds(5);
  constexpr int kLooks = 200;
  const std::shared_ptr<gpio::CameraTrigger> line = MakeCameraTrigger(config);
  if (!line) return std::shared_ptr<CameraRelease>();
  OMNIHDR_TRY(line->Start());
  for (int i = 0; i < kLooks; ++i) {
    const LinkReport report = line->report();
    if (report.up) return std::shared_ptr<CameraRelease>(line);
    if (report.errors > 0) break;
    std::this_thread::sleep_for(kLook);
  }
  return Fail(ErrorKind::kUnavailable, "gpio.outputs.camera_trigger: {}", line->report().problem);
}

}  // namespace omnihdr
