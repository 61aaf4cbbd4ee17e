#pragma once

#include <memory>

#include "tests/emulators/usb_function.h"

namespace omnihdr::emulators {

// A device model as a USB device of the running kernel: behind vhci_hcd, the host controller of
// USB/IP, with one end of a socket pair in the kernel and the other served here. The kernel
// enumerates it as any device, and every program of the machine can use it. Needs the module
// vhci-hcd and root.
class VhciUsb {
 public:
  // Plugged in, to a port of high speed: 0 to 7. Without vhci_hcd the program ends.
  explicit VhciUsb(std::shared_ptr<UsbFunction> function, int port = 0);
  ~VhciUsb();
  VhciUsb(const VhciUsb&) = delete;
  VhciUsb& operator=(const VhciUsb&) = delete;

  // On return the kernel has begun to find out.
  void Unplug();
  // At the same port. On return the kernel has begun to enumerate.
  void PlugIn();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace omnihdr::emulators
