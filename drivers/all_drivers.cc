#include "drivers/all_drivers.h"

#include <fmt/format.h>

#include <string>
#include <utility>

#include "drivers/v4l2/rig_camera.h"

namespace omnihdr {

const std::vector<CameraDriverEntry>& CameraDrivers() {
  static const std::vector<CameraDriverEntry> drivers{
      {"sim", "a simulated camera in a rendered HDR world"},
      {"replay", "a recorded session as a camera"},
      {"iidc", "an IIDC camera on USB (Point Grey, FLIR)"},
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
    return iidc::MakeUsbIidcCamera(*iidc_options);
  }
  if (const auto* v4l2_options = std::get_if<v4l2::V4l2CameraOptions>(&options)) {
    OMNIHDR_TRY(v4l2_options->Validate().Context("camera v4l2"));
    return v4l2::MakeKernelV4l2Camera(*v4l2_options);
  }
  const auto& replay_options = std::get<ReplayOptions>(options);
  OMNIHDR_TRY(replay_options.Validate().Context("camera replay"));
  return std::unique_ptr<Camera>(std::make_unique<ReplayCamera>(replay_options));
}

}  // namespace omnihdr
