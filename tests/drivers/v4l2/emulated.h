#pragma once

#include <chrono>
#include <fstream>
#include <memory>
#include <thread>

#include "drivers/v4l2/v4l2_camera.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/v4l2_camera_model.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::testing {

// An emulated camera with a rig file of one sensor that fits it.
struct EmulatedV4l2 {
  explicit EmulatedV4l2(emulators::V4l2ModelOptions options = {},
                        BayerOrder bayer = BayerOrder::kNone)
      : model(std::make_shared<emulators::V4l2CameraModel>(options, clock)) {
    std::ofstream(rig()) << emulators::EmulatedRig(1, options.width, options.height, bayer);
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }
  v4l2::V4l2CameraOptions CameraOptions() const {
    v4l2::V4l2CameraOptions options;
    options.rig_file = rig();
    options.coding = v4l2::Coding::kGrey;
    options.frame_timeout_s = 0.3;
    return options;
  }
  std::unique_ptr<v4l2::V4l2Camera> MakeCamera(const v4l2::V4l2CameraOptions& options) {
    return std::make_unique<v4l2::V4l2Camera>(options, emulators::MakeEmulatedV4l2({model}));
  }

  const SystemClock clock;
  const TemporaryDirectory folder;
  std::shared_ptr<emulators::V4l2CameraModel> model;
};

// Takes one picture, waiting while the camera is busy.
inline Result<CameraFrame> TakePicture(Camera& camera, std::uint64_t number, double seconds,
                                       double gain_db = 0.0,
                                       Nanoseconds timeout = std::chrono::seconds(5)) {
  ExposureRequest request;
  request.trigger = TriggerId{number};
  request.exposure = {ExposureTime::Seconds(seconds), GainDb{gain_db}};
  const SystemClock clock;
  const HostTime deadline = clock.Now() + std::chrono::seconds(5);
  while (true) {
    request.trigger_time = clock.Now();
    Status status = camera.Trigger(request);
    if (status) break;
    if (status.error().kind != ErrorKind::kTemporary || clock.Now() > deadline) {
      return Forward(std::move(status).error());
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return camera.Receive(timeout);
}

}  // namespace omnihdr::testing
