#include "drivers/all_drivers.h"

#include <fmt/format.h>

#include <string>
#include <utility>

#include "drivers/firewire/recording.h"
#include "drivers/iidc/firewire_link.h"
#include "drivers/iidc/settings.h"
#include "drivers/iidc/usb_link.h"
#include "drivers/usb/recording.h"
#include "drivers/v4l2/kernel_device.h"
#include "drivers/v4l2/recording.h"
#include "drivers/v4l2/rig_camera.h"
#include "drivers/v4l2/settings.h"

namespace omnihdr {

const std::vector<CameraDriverEntry>& CameraDrivers() {
  static const std::vector<CameraDriverEntry> drivers{
      {"sim", "a simulated camera in a rendered HDR world"},
      {"replay", "a recorded session as a camera"},
      {"iidc", "an IIDC camera on USB or FireWire (Point Grey, FLIR)"},
      {"v4l2", "a camera of the kernel's (UVC, raw sensors), or several as a rig"},
  };
  return drivers;
}

Result<CameraOptions> DefaultCameraOptions(std::string_view driver) {
  if (driver == "sim") return CameraOptions(sim::SimCameraOptions{});
  if (driver == "replay") return CameraOptions(ReplayOptions{});
  if (driver == "iidc") return CameraOptions(iidc::IidcCameraOptions{});
  if (driver == "v4l2") return CameraOptions(v4l2::V4l2CameraOptions{});
  std::string known;
  for (const CameraDriverEntry& each : CameraDrivers()) {
    known += fmt::format("{}{}", known.empty() ? "" : ", ", each.name);
  }
  return Fail(ErrorKind::kConfig, "camera driver: {}: expected one of {}", driver, known);
}

Result<std::unique_ptr<Camera>> MakeCamera(const CameraOptions& options) {
  if (const auto* sim_options = std::get_if<sim::SimCameraOptions>(&options)) {
    OMNIHDR_TRY(sim_options->Validate().Context("camera sim"));
    return std::unique_ptr<Camera>(std::make_unique<sim::SimCamera>(*sim_options));
  }
  if (const auto* iidc_options = std::get_if<iidc::IidcCameraOptions>(&options)) {
    OMNIHDR_TRY(iidc_options->Validate().Context("camera iidc"));
    return iidc::MakeIidcCamera(*iidc_options);
  }
  if (const auto* v4l2_options = std::get_if<v4l2::V4l2CameraOptions>(&options)) {
    OMNIHDR_TRY(v4l2_options->Validate().Context("camera v4l2"));
    return v4l2::MakeKernelV4l2Camera(*v4l2_options);
  }
  const auto& replay_options = std::get<ReplayOptions>(options);
  OMNIHDR_TRY(replay_options.Validate().Context("camera replay"));
  return std::unique_ptr<Camera>(std::make_unique<ReplayCamera>(replay_options));
}

Result<std::vector<std::unique_ptr<CameraSettings>>> OpenCameraSettings(
    const CameraOptions& options) {
  if (const auto* iidc_options = std::get_if<iidc::IidcCameraOptions>(&options)) {
    iidc::IidcCameraOptions unrecorded = *iidc_options;
    unrecorded.usb_recording.clear();
    const auto finder = iidc::MakeFinder(unrecorded);
    std::vector<std::unique_ptr<CameraSettings>> settings;
    OMNIHDR_ASSIGN(auto made, iidc::OpenSettings(*finder, iidc_options->id));
    settings.push_back(std::move(made));
    return settings;
  }
  if (const auto* v4l2_options = std::get_if<v4l2::V4l2CameraOptions>(&options)) {
    OMNIHDR_TRY(v4l2::CheckDevices(*v4l2_options).Context("camera v4l2"));
    return v4l2::OpenSettings(*v4l2::MakeKernelSystem(), *v4l2_options);
  }
  return Fail(ErrorKind::kUsage,
              "camera.driver: \"{}\": expected \"iidc\" or \"v4l2\", whose "
              "cameras have settings",
              CameraDrivers()[options.index()].name);
}

namespace {

// IIDC and V4L2 cameras.
Status CheckRecordable(const CameraOptions& options) {
  if (std::holds_alternative<iidc::IidcCameraOptions>(options) ||
      std::holds_alternative<v4l2::V4l2CameraOptions>(options)) {
    return {};
  }
  return Fail(ErrorKind::kUsage,
              "camera.driver: \"{}\": expected \"iidc\" or \"v4l2\": the traffic of others "
              "cannot be recorded",
              CameraDrivers()[options.index()].name);
}

}  // namespace

Status RecordTransport(CameraOptions& options, const std::filesystem::path& file) {
  OMNIHDR_TRY(CheckRecordable(options));
  if (auto* iidc_options = std::get_if<iidc::IidcCameraOptions>(&options)) {
    iidc_options->usb_recording = file.string();
  } else {
    std::get<v4l2::V4l2CameraOptions>(options).recording = file.string();
  }
  return {};
}

Result<std::unique_ptr<Camera>> MakeReplayedCamera(const CameraOptions& options,
                                                   const std::filesystem::path& file) {
  OMNIHDR_TRY(CheckRecordable(options));
  if (const auto* v4l2_options = std::get_if<v4l2::V4l2CameraOptions>(&options)) {
    OMNIHDR_TRY(v4l2_options->Validate().Context("camera v4l2"));
    return v4l2::MakeReplayedCamera(*v4l2_options, file);
  }
  const auto& iidc_options = std::get<iidc::IidcCameraOptions>(options);
  OMNIHDR_TRY(iidc_options.Validate().Context("camera iidc"));
  if (iidc_options.bus == iidc::CameraBus::kFirewire) {
    OMNIHDR_ASSIGN(std::unique_ptr<firewire::Bus> bus, firewire::MakeReplayingBus(file));
    return std::unique_ptr<Camera>(
        std::make_unique<iidc::IidcCamera>(iidc_options, iidc::MakeFirewireFinder(std::move(bus))));
  }
  OMNIHDR_ASSIGN(std::unique_ptr<usb::Bus> bus, usb::MakeReplayingBus(file));
  return std::unique_ptr<Camera>(
      std::make_unique<iidc::IidcCamera>(iidc_options, iidc::MakeUsbFinder(std::move(bus))));
}

}  // namespace omnihdr
