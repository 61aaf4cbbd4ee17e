// Modbus RTU over two serial ports of the machine (16550A, /dev/ttyS1 and /dev/ttyS2) that are
// wired to each other, with the kernel's driver.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <mutex>
#include <vector>

#include "drivers/modbus/server.h"
#include "drivers/modbus/vehicle.h"
#include "tests/drivers/modbus/hostile_frames.h"
#include "tests/integration/programs.h"
#include "tests/kernel/serial_ports.h"

namespace omnihdr::serial_test {
namespace {

using integration::Eventually;
using kernel::kOneEnd;
using kernel::kOtherEnd;
using kernel::SerialEndpoint;

class SerialPort : public ::testing::Test {
 protected:
  void StartServer() {
    modbus::ServerOptions options;
    options.endpoint = SerialEndpoint(kOneEnd);
    server_ = std::make_unique<modbus::StatusServer>(
        options,
        [this](ApplianceCommand command) -> Status {
          std::lock_guard lock(mutex_);
          commands_.push_back(command);
          return {};
        },
        clock_);
    ASSERT_TRUE(server_->Start());
    ASSERT_TRUE(Eventually([&] { return server_->report().up; })) << server_->report().problem;
  }

  const SystemClock clock_;
  std::mutex mutex_;
  std::vector<ApplianceCommand> commands_;
  std::unique_ptr<modbus::StatusServer> server_;
};

TEST_F(SerialPort, OneAppliancesOdometerIsAnothers) {
  ASSERT_NO_FATAL_FAILURE(StartServer());
  ApplianceStatus status;
  status.odometer_m = 12.345;
  server_->Show(status);
  modbus::VehicleOptions options;
  options.endpoint = SerialEndpoint(kOtherEnd);
  options.timeout_s = 5.0;
  options.stale_s = 20.0;
  options.odometer.address = 16;
  options.odometer.type = modbus::NumberType::kI32;
  options.odometer.scale = 0.001;
  modbus::Vehicle vehicle(options, clock_);
  ASSERT_TRUE(vehicle.Start());
  EXPECT_TRUE(Eventually([&] {
    const auto metres = vehicle.OdometerMetres(clock_.Now());
    return metres && std::abs(*metres - 12.345) < 1e-6;
  })) << vehicle.report().problem;
}

TEST_F(SerialPort, WhateverComesTheNextGoodRequestIsAnsweredAndNothingIsCommanded) {
  ASSERT_NO_FATAL_FAILURE(StartServer());
  const Result<Fd> line = modbus::OpenSerial(SerialEndpoint(kOtherEnd));
  ASSERT_TRUE(line) << line.error().message;
  testing_modbus::ExpectServesBetweenHostileRequests(line->get());
  std::lock_guard lock(mutex_);
  EXPECT_TRUE(commands_.empty());
}

}  // namespace
}  // namespace omnihdr::serial_test
