#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "drivers/modbus/server.h"
#include "drivers/modbus/vehicle.h"
#include "tests/drivers/modbus/hostile_frames.h"
#include "tests/support/eventually.h"

namespace omnihdr::testing_modbus {

// An appliance at one end of a serial line, which notes what it is commanded, and what another one
// at the other end makes of its odometer. For pseudo-terminals and for serial ports.
class SerialAppliance : public ::testing::Test {
 protected:
  static constexpr std::chrono::seconds kPatience{60};

  static modbus::Endpoint At(const std::string& device, int baud = modbus::Endpoint{}.baud) {
    modbus::Endpoint endpoint;
    endpoint.connection = modbus::Connection::kRtu;
    endpoint.device = device;
    endpoint.baud = baud;
    return endpoint;
  }
  void StartServer(const modbus::ServerOptions& options) {
    server_ = std::make_unique<modbus::StatusServer>(
        options,
        [this](ApplianceCommand command) -> Status {
          std::lock_guard lock(mutex_);
          commands_.push_back(command);
          return {};
        },
        clock_);
    ASSERT_TRUE(server_->Start());
    ASSERT_TRUE(testing::Eventually([&] { return server_->report().up; }, kPatience))
        << server_->report().problem;
  }
  void ShowOdometer(double metres) const {
    ApplianceStatus status;
    status.odometer_m = metres;
    server_->Show(status);
  }
  // Who reads it at the other end.
  static modbus::VehicleOptions OdometerAt(const modbus::Endpoint& endpoint) {
    modbus::VehicleOptions options;
    options.endpoint = endpoint;
    options.odometer.address = 16;
    options.odometer.type = modbus::NumberType::kI32;
    options.odometer.scale = 0.001;
    return options;
  }
  bool Reads(const modbus::Vehicle& vehicle, double metres) const {
    return testing::Eventually(
        [&] {
          const auto reading = vehicle.OdometerMetres(clock_.Now());
          return reading && std::abs(*reading - metres) < 1e-6;
        },
        kPatience);
  }
  void ExpectServesBetweenHostileRequestsAndIsCommandedNothing(int line) {
    ExpectServesBetweenHostileRequests(line);
    std::lock_guard lock(mutex_);
    EXPECT_TRUE(commands_.empty());
  }

  const SystemClock clock_{};
  std::unique_ptr<modbus::StatusServer> server_;

 private:
  std::mutex mutex_;
  std::vector<ApplianceCommand> commands_;
};

}  // namespace omnihdr::testing_modbus
