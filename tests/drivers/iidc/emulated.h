#pragma once

#include <chrono>
#include <fstream>
#include <memory>
#include <thread>

#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/registers.h"
#include "tests/emulators/iidc_link.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::testing {

// An emulated device, in process, with a rig file that fits it.
struct EmulatedIidc {
  explicit EmulatedIidc(emulators::IidcDeviceOptions options = {})
      : device(std::make_shared<emulators::IidcDevice>(options, clock)) {
    std::ofstream(rig()) << emulators::EmulatedRig(options.max_height / options.rows_per_sensor,
                                                   options.max_width, options.rows_per_sensor,
                                                   options.bayer);
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }

  iidc::IidcCameraOptions CameraOptions() const {
    iidc::IidcCameraOptions options;
    options.rig_file = rig();
    options.frame_timeout_s = 4.0;  // the machine may be busy
    return options;
  }
  static iidc::RegisterTimeouts Timeouts() {
    iidc::RegisterTimeouts timeouts;
    timeouts.access = std::chrono::milliseconds(20);
    timeouts.settle = std::chrono::seconds(1);
    return timeouts;
  }
  std::unique_ptr<iidc::IidcCamera> MakeCamera(const iidc::IidcCameraOptions& options) {
    return std::make_unique<iidc::IidcCamera>(options, emulators::MakeEmulatedFinder({device}),
                                              Timeouts());
  }
  std::unique_ptr<iidc::IidcCamera> MakeCamera() { return MakeCamera(CameraOptions()); }

  const SystemClock clock;
  const TemporaryDirectory folder;
  std::shared_ptr<emulators::IidcDevice> device;
};

// A link and the command registers behind it.
struct EmulatedRegisters {
  explicit EmulatedRegisters(emulators::IidcDeviceOptions options = {})
      : emulated(options),
        link(emulators::MakeEmulatedLink(emulated.device)),
        registers(*link, emulators::IidcDevice::kBase, EmulatedIidc::Timeouts()) {}
  EmulatedIidc emulated;
  std::unique_ptr<iidc::Link> link;
  iidc::Registers registers;
};

// Takes one picture, waiting while the camera is busy.
inline Result<CameraFrame> Take(Camera& camera, std::uint64_t number, double seconds,
                                double gain_db = 0.0) {
  ExposureRequest request;
  request.trigger = TriggerId{number};
  request.exposure = {ExposureTime::Seconds(seconds), GainDb{gain_db}};
  const SystemClock clock;
  request.trigger_time = clock.Now();
  const HostTime deadline = clock.Now() + std::chrono::seconds(5);
  while (true) {
    Status status = camera.Trigger(request);
    if (status) break;
    if (status.error().kind != ErrorKind::kTemporary || clock.Now() > deadline) {
      return Forward(std::move(status).error());
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return camera.Receive(std::chrono::seconds(5));
}

}  // namespace omnihdr::testing
