#pragma once

#include <memory>

#include "tests/emulators/iidc_device.h"

namespace omnihdr::emulators {

// A device model as a USB device of the machine, by umockdev: the real libusb finds it in /sys and
// talks to it by ioctl. The program must have libumockdev-preload loaded (omnihdr_emulators links
// it). One at a time in a process; others see no real USB devices meanwhile.
class UmockdevUsb {
 public:
  explicit UmockdevUsb(std::shared_ptr<IidcDevice> device);
  ~UmockdevUsb();
  UmockdevUsb(const UmockdevUsb&) = delete;
  UmockdevUsb& operator=(const UmockdevUsb&) = delete;

  void Unplug();
  // At the same port, with another address.
  void PlugIn();
  // umockdev's own, for other devices beside this one: there is one for a process.
  void* testbed() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace omnihdr::emulators
