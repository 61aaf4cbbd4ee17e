// Modbus RTU over two serial ports of the machine (16550A, /dev/ttyS1 and /dev/ttyS2) that are
// wired to each other, with the kernel's driver.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/drivers/modbus/serial_appliance.h"
#include "tests/kernel/serial_ports.h"

namespace omnihdr::serial_test {
namespace {

using kernel::kOneEnd;
using kernel::kOtherEnd;
using kernel::kSerialBaud;

class SerialPort : public testing_modbus::SerialAppliance {
 protected:
  void SetUp() override {
    modbus::ServerOptions options;
    options.endpoint = At(kOneEnd, kSerialBaud);
    ASSERT_NO_FATAL_FAILURE(StartServer(options));
  }
};

TEST_F(SerialPort, OneAppliancesOdometerIsAnothers) {
  ShowOdometer(12.345);
  modbus::VehicleOptions options = OdometerAt(At(kOtherEnd, kSerialBaud));
  options.timeout_s = 5.0;
  options.stale_s = 20.0;
  modbus::Vehicle vehicle(options, clock_);
  ASSERT_TRUE(vehicle.Start());
  EXPECT_TRUE(Reads(vehicle, 12.345)) << vehicle.report().problem;
}

TEST_F(SerialPort, WhateverComesTheNextGoodRequestIsAnsweredAndNothingIsCommanded) {
  const Result<Fd> line = modbus::OpenSerial(At(kOtherEnd, kSerialBaud));
  ASSERT_TRUE(line) << line.error().message;
  ExpectServesBetweenHostileRequestsAndIsCommandedNothing(line->get());
}

}  // namespace
}  // namespace omnihdr::serial_test
