// Plugs an emulated camera into the machine's USB and keeps it there until it is killed.
//
//   plugged_camera RIG    writes the rig file of the camera's head to RIG first

#include <fmt/format.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <memory>

#include "core/base/clock.h"
#include "tests/emulators/iidc_device.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/iidc_usb_function.h"
#include "tests/emulators/vhci_usb.h"

int main(int argc, char** argv) {
  using namespace omnihdr;
  if (argc != 2) {
    fmt::print(stderr, "usage: plugged_camera RIG\n");
    return 64;
  }
  const SystemClock clock;
  const emulators::IidcDeviceOptions options;
  std::ofstream rig(argv[1]);
  rig << emulators::EmulatedRig(options.max_height / options.rows_per_sensor, options.max_width,
                                options.rows_per_sensor, options.bayer)
      << std::flush;
  if (!rig) {
    fmt::print(stderr, "plugged_camera: cannot write {}\n", argv[1]);
    return 73;
  }
  const emulators::VhciUsb plug(std::make_shared<emulators::IidcUsbFunction>(
      std::make_shared<emulators::IidcDevice>(options, clock)));
  while (true) ::pause();
}
