#include "drivers/modbus/vehicle.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <limits>

#include "drivers/trigger/odometer_trigger.h"
#include "tests/drivers/modbus/slave.h"

namespace omnihdr::vehicle_test {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;
using testing_modbus::Eventually;
using testing_modbus::SerialLine;
using testing_modbus::Slave;

modbus::VehicleOptions Options(int port) {
  modbus::VehicleOptions options;
  options.endpoint.port = port;
  options.poll_s = 0.01;
  options.stale_s = 0.3;
  options.timeout_s = 0.5;
  options.reconnect_s = 0.1;
  options.odometer.address = 10;
  options.odometer.type = modbus::NumberType::kU32;
  options.odometer.scale = 0.001;
  return options;
}

class ModbusVehicle : public ::testing::Test {
 protected:
  std::optional<double> Now(const modbus::Vehicle& vehicle) const {
    return vehicle.OdometerMetres(clock.Now());
  }
  bool Reads(const modbus::Vehicle& vehicle, double metres) const {
    return Eventually([&] {
      const auto reading = Now(vehicle);
      return reading && std::abs(*reading - metres) < 1e-6;
    });
  }
  const SystemClock clock{};
  Slave slave;
};

TEST_F(ModbusVehicle, OdometerSpeedAndHeadingAreReadOverTcp) {
  slave.SetHolding32(10, 12'345'678);
  slave.SetInput(5, 250);
  slave.SetInput(6, static_cast<std::uint16_t>(-450));
  slave.StartTcp();
  modbus::VehicleOptions options = Options(slave.port());
  options.speed.table = modbus::Table::kInput;
  options.speed.address = 5;
  options.speed.scale = 0.001;
  options.heading = options.speed;
  options.heading.address = 6;
  options.heading.type = modbus::NumberType::kI16;
  options.heading.scale = 0.1;
  modbus::Vehicle vehicle(options, clock);
  EXPECT_FALSE(Now(vehicle));
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Eventually([&] { return Now(vehicle).has_value(); }));
  EXPECT_NEAR(*Now(vehicle), 12345.678, 0.2);
  EXPECT_NEAR(*vehicle.SpeedMetresPerSecond(clock.Now()), 0.25, 1e-9);
  EXPECT_NEAR(*vehicle.HeadingDeg(clock.Now()), 315.0, 1e-9);
  EXPECT_TRUE(vehicle.report().up);
  EXPECT_EQ(vehicle.report().problem, "");
}

TEST_F(ModbusVehicle, RegistersSideBySideAreReadInOneRequest) {
  slave.StartTcp();
  modbus::VehicleOptions options = Options(slave.port());
  options.poll_s = 0.05;
  options.speed.address = 12;
  options.heartbeat.address = 13;
  options.stale_s = 60.0;
  modbus::Vehicle vehicle(options, clock);
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Eventually([&] { return vehicle.report().messages >= 4; }));
  EXPECT_LE(slave.requests, static_cast<int>(vehicle.report().messages) + 1);
}

TEST_F(ModbusVehicle, ItReadsOverASerialLine) {
  SerialLine line;
  slave.SetHolding32(10, 7'000);
  slave.StartRtu(line.master.get());
  modbus::VehicleOptions options = Options(0);
  options.endpoint.connection = modbus::Connection::kRtu;
  options.endpoint.device = line.name;
  modbus::Vehicle vehicle(options, clock);
  ASSERT_TRUE(vehicle.Start());
  EXPECT_TRUE(Reads(vehicle, 7.0));
  slave.SetHolding32(10, 7'500);
  EXPECT_TRUE(Reads(vehicle, 7.5));
  slave.Stop();  // before its line goes
}

TEST_F(ModbusVehicle, AVehicleThatFallsSilentIsStaleWithItsReasonAndComesBack) {
  slave.SetHolding32(10, 1'000);
  slave.StartTcp();
  modbus::VehicleOptions options = Options(slave.port());
  options.timeout_s = 0.05;
  modbus::Vehicle vehicle(options, clock);
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Reads(vehicle, 1.0));
  slave.silent = true;
  ASSERT_TRUE(Eventually([&] { return !Now(vehicle); }));
  EXPECT_THAT(vehicle.report().problem, HasSubstr("read 2 holding registers from 10"));
  EXPECT_THAT(vehicle.report().problem, HasSubstr("timed out"));
  EXPECT_FALSE(vehicle.report().up);
  slave.silent = false;
  slave.SetHolding32(10, 2'000);
  EXPECT_TRUE(Reads(vehicle, 2.0));
  EXPECT_GE(slave.accepted, 2);
  EXPECT_EQ(vehicle.report().opened, 2U);
}

TEST_F(ModbusVehicle, AControllerThatIsStartedLaterOrStartedAgainIsFound) {
  Slave first;
  first.StartTcp();
  const int port = first.port();
  first.Stop();
  modbus::Vehicle vehicle(Options(port), clock);
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Eventually([&] { return vehicle.report().errors > 0; }));
  EXPECT_THAT(vehicle.report().problem, HasSubstr("Connection refused"));
  slave.SetHolding32(10, 3'000);
  slave.StartTcp(port);
  EXPECT_TRUE(Reads(vehicle, 3.0));
  slave.hang_up = true;
  slave.SetHolding32(10, 3'100);
  EXPECT_TRUE(Reads(vehicle, 3.1));
}

TEST_F(ModbusVehicle, ARegisterThatDoesNotExistIsNamedAndTheConnectionKept) {
  slave.StartTcp();
  modbus::VehicleOptions options = Options(slave.port());
  options.odometer.address = 5000;
  modbus::Vehicle vehicle(options, clock);
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Eventually([&] { return vehicle.report().errors > 3; }));
  EXPECT_THAT(vehicle.report().problem, HasSubstr("registers from 5000: Illegal data address"));
  EXPECT_EQ(slave.accepted, 1);
}

TEST_F(ModbusVehicle, AHeartbeatThatStandsStillMakesTheDataStale) {
  slave.SetHolding32(10, 1'000);
  slave.StartTcp();
  modbus::VehicleOptions options = Options(slave.port());
  options.heartbeat.address = 20;
  modbus::Vehicle vehicle(options, clock);
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Reads(vehicle, 1.0));
  ASSERT_TRUE(Eventually([&] { return !Now(vehicle); }));
  EXPECT_THAT(vehicle.report().problem, HasSubstr("heartbeat in holding register 20"));
  slave.SetHolding(20, 1);
  EXPECT_TRUE(Reads(vehicle, 1.0));
}

TEST_F(ModbusVehicle, AnOdometerThatStandsStillAtSpeedIsStale) {
  slave.SetHolding32(10, 1'000);
  slave.SetHolding(12, 10);
  slave.StartTcp();
  modbus::VehicleOptions options = Options(slave.port());
  options.speed.address = 12;
  modbus::Vehicle vehicle(options, clock);
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Eventually([&] { return vehicle.report().errors > 0; }));
  EXPECT_THAT(vehicle.report().problem, HasSubstr("at a speed of 10.0 m/s: it is stale"));
  ASSERT_TRUE(Eventually([&] { return !Now(vehicle); }));
  slave.SetHolding(12, 0);
  EXPECT_TRUE(Reads(vehicle, 1.0));
}

TEST_F(ModbusVehicle, ANumberThatIsNoneIsNotTaken) {
  const auto bits = std::bit_cast<std::uint32_t>(std::numeric_limits<float>::quiet_NaN());
  slave.SetHolding32(10, bits);
  slave.StartTcp();
  modbus::VehicleOptions options = Options(slave.port());
  options.odometer.type = modbus::NumberType::kF32;
  modbus::Vehicle vehicle(options, clock);
  ASSERT_TRUE(vehicle.Start());
  ASSERT_TRUE(Eventually([&] { return vehicle.report().errors > 0; }));
  EXPECT_THAT(vehicle.report().problem, HasSubstr("expected a finite number"));
  EXPECT_FALSE(Now(vehicle));
}

TEST_F(ModbusVehicle, ItsMarksTriggerWhileItDrives) {
  slave.SetHolding32(10, 0);
  slave.StartTcp();
  const auto vehicle = std::make_shared<modbus::Vehicle>(Options(slave.port()), clock);
  ASSERT_TRUE(vehicle->Start());
  ASSERT_TRUE(Reads(*vehicle, 0.0));
  OdometerTriggerOptions marks;
  marks.distance_m = 0.3;
  OdometerTrigger trigger(marks, vehicle, clock);
  ASSERT_TRUE(trigger.Start());
  std::vector<double> places;
  std::uint64_t lost = 0;
  ASSERT_TRUE(Eventually([&] {
    // One metre a second by the registers.
    static const HostTime begin = clock.Now();
    slave.SetHolding32(10, static_cast<std::uint32_t>((clock.Now() - begin).count() / 1'000'000));
    while (const auto event = *trigger.Poll()) {
      places.push_back(*event->odometer_m);
      lost += event->lost_before;
    }
    return places.size() + lost >= 4;
  }));
  EXPECT_NEAR(places.back(), 0.3 * static_cast<double>(places.size() + lost - 1), 1e-9);
}

TEST_F(ModbusVehicle, ADestroyedOneEndsAtOnceWhateverItWaitsFor) {
  slave.silent = true;
  slave.StartTcp();
  const HostTime begin = clock.Now();
  {
    modbus::VehicleOptions options = Options(slave.port());
    options.reconnect_s = 3600.0;
    modbus::Vehicle vehicle(options, clock);
    ASSERT_TRUE(vehicle.Start());
    ASSERT_TRUE(Eventually([&] { return slave.requests > 0; }));
  }
  EXPECT_LT((clock.Now() - begin).count(), 5'000'000'000);
}

TEST(ModbusVehicleOptions, EveryValueOutOfRangeIsNamed) {
  const auto message = [](const auto& change) {
    modbus::VehicleOptions options;
    options.odometer.address = 1;
    change(options);
    const Status valid = options.Validate();
    return valid ? std::string() : valid.error().message;
  };
  EXPECT_EQ(message([](auto&) {}), "");
  EXPECT_THAT(message([](auto& o) { o.odometer.address = -1; }), HasSubstr("no register"));
  EXPECT_THAT(message([](auto& o) { o.endpoint.address = "plc.local"; }),
              HasSubstr("address: \"plc.local\": expected a numeric"));
  EXPECT_THAT(message([](auto& o) { o.poll_s = 0.0; }), HasSubstr("poll_s: 0: expected"));
  EXPECT_THAT(message([](auto& o) {
                o.endpoint.connection = modbus::Connection::kRtu;
                o.endpoint.baud = 12345;
              }),
              HasSubstr("baud: 12345: expected one of"));
  EXPECT_THAT(message([](auto& o) {
                o.endpoint.connection = modbus::Connection::kRtu;
                o.endpoint.unit = 0;
              }),
              HasSubstr("unit: 0: expected 1 to 247"));
}

}  // namespace
}  // namespace omnihdr::vehicle_test
