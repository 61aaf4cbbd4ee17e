#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "daemon/config.h"

namespace omnihdr::config_vehicle_test {
namespace {

using ::testing::HasSubstr;

// All problems of a text, a line each.
std::string Problems(const std::string& toml) {
  std::string all;
  for (const ConfigProblem& problem : ParseConfig(toml, "v.toml").problems) {
    all += problem.ToString() + "\n";
  }
  return all;
}

TEST(ConfigVehicle, AVehicleWithEverythingIsUnderstood) {
  const std::string toml = R"(
[trigger]
source = "distance"
odometer = "modbus"
[gpio.trigger]
chip = "pinctrl-bcm2711"
line = "GPIO17"
edge = "falling"
bias = "pull-up"
debounce_s = 0.02
[gpio.outputs]
chip = "gpiochip0"
ready = "23"
strobe = "24"
active_low = true
[modbus.client]
connection = "rtu"
device = "/dev/ttyS1"
baud = 9600
parity = "none"
[modbus.client.odometer]
table = "input"
register = 100
type = "u32"
word_order = "low-first"
scale = 0.01
[modbus.server]
connection = "tcp"
address = "0.0.0.0"
control = true
[gnss]
enabled = true
address = "::1"
)";
  ASSERT_EQ(Problems(toml), "");
  const DaemonConfig config = ParseConfig(toml, "v.toml").config;
  EXPECT_EQ(config.gpio.inputs.trigger.name.chip, "pinctrl-bcm2711");
  EXPECT_EQ(config.gpio.inputs.trigger.edge, gpio::Edge::kFalling);
  EXPECT_EQ(config.gpio.inputs.trigger.bias, gpio::Bias::kPullUp);
  EXPECT_TRUE(config.gpio.outputs.active_low);
  EXPECT_EQ(config.modbus.client.endpoint.baud, 9600);
  EXPECT_EQ(config.modbus.client.odometer.table, modbus::Table::kInput);
  EXPECT_EQ(config.modbus.client.odometer.word_order, modbus::WordOrder::kLowFirst);
  EXPECT_FALSE(config.modbus.client.speed.configured());
  EXPECT_TRUE(config.modbus.control);
  EXPECT_EQ(config.gnss.gpsd.address, "::1");
}

TEST(ConfigVehicle, ByDefaultNothingIsConnected) {
  const DaemonConfig config;
  EXPECT_EQ(config.modbus.client.endpoint.connection, modbus::Connection::kOff);
  EXPECT_EQ(config.modbus.server.endpoint.connection, modbus::Connection::kOff);
  EXPECT_EQ(config.modbus.server.endpoint.address, "127.0.0.1");
  EXPECT_FALSE(config.modbus.control);
  EXPECT_FALSE(config.gnss.enabled);
  EXPECT_FALSE(config.gpio.inputs.trigger.name.configured());
  EXPECT_FALSE(config.gpio.outputs.configured());
}

TEST(ConfigVehicle, WhatATriggerNeedsIsAskedFor) {
  EXPECT_THAT(Problems("trigger.source = 'gpio'"),
              HasSubstr("v.toml:1: gpio.trigger.line: \"\", expected a line"));
  EXPECT_THAT(Problems("trigger.odometer = 'wheel'"), HasSubstr("gpio.wheel.line: \"\", expected"));
  EXPECT_THAT(Problems("trigger.odometer = 'modbus'"),
              HasSubstr("modbus.client.odometer.register: -1, expected a register"));
  EXPECT_THAT(Problems("[gpio.trigger]\nline = '17'\n"), HasSubstr("chip: \"\": expected"));
  EXPECT_THAT(
      Problems("[trigger]\nodometer = 'wheel'\ndistance_m = 0.3\n[gpio.wheel]\nchip = 'c'\n"
               "line = '1'\npulses_per_metre = 2\n"),
      HasSubstr("trigger.distance_m: 0.3, expected at least one pulse of the wheel, 0.5 m"));
  EXPECT_THAT(Problems("[gpio.trigger]\nchip = 'c'\nline = '1'\n[gpio.wheel]\nchip = 'c'\n"
                       "line = '1'\n"),
              HasSubstr("gpio.wheel.line: \"1\", expected another line"));
  EXPECT_THAT(Problems("[gpio.outputs]\nchip = 'c'\nready = '1'\nbusy = '1'\n"),
              HasSubstr("line 1 twice"));
}

TEST(ConfigVehicle, ALineThatReleasesTheCameraFitsLinesCameraAndTriggers) {
  const std::string line = "[gpio.outputs]\nchip = 'c'\ncamera_trigger = '5'\n";
  EXPECT_EQ(Problems(line), "");
  EXPECT_EQ(Problems(line + "[camera]\ndriver = 'iidc'\niidc.rig = 'r.toml'\n"), "");
  EXPECT_EQ(ParseConfig(line, "v.toml").config.gpio.CameraTrigger().name.Text(), "c line 5");
  EXPECT_THAT(Problems("[gpio.outputs]\ncamera_trigger = '5'\n"), HasSubstr("outputs.chip: \"\""));
  EXPECT_THAT(
      Problems(line + "camera_trigger_s = 0.05\n"),
      HasSubstr("v.toml:3: gpio: outputs.camera_trigger_spacing_s: 0.02: expected more than "
                "the pulse, outputs.camera_trigger_s = 0.05"));
  EXPECT_THAT(Problems(line + "strobe = '5'\n"),
              HasSubstr("gpio.outputs.camera_trigger: \"5\", expected another line than "
                        "gpio.outputs.strobe"));
  EXPECT_THAT(Problems(line + "[gpio.trigger]\nchip = 'c'\nline = '5'\n"),
              HasSubstr("expected another line than gpio.trigger.line"));
  EXPECT_EQ(Problems(line + "[gpio.trigger]\nchip = 'd'\nline = '5'\n"), "");
  EXPECT_THAT(Problems(line + "[gpio.wheel]\nchip = 'c'\nline = '5'\n"),
              HasSubstr("expected another line than gpio.wheel.line"));
  EXPECT_THAT(Problems(line + "[camera]\ndriver = 'v4l2'\n"),
              HasSubstr("camera.driver: \"v4l2\", expected \"iidc\" or \"sim\""));
  EXPECT_THAT(Problems(line + "[camera]\ndriver = 'iidc'\niidc = {rig = 'r', trigger_mode = 15}\n"),
              HasSubstr("camera.iidc.trigger_mode: 15, expected 0 or 14"));
  EXPECT_THAT(Problems(line + "[trigger]\nsource = 'timer'\nwired = true\n"),
              HasSubstr("trigger.wired: true, expected false with gpio.outputs.camera_trigger"));
  EXPECT_THAT(Problems(line + "[trigger]\nsource = 'timer'\ninterval_s = 0.01\n"),
              HasSubstr("trigger.interval_s: 0.01, expected at least "
                        "gpio.outputs.camera_trigger_spacing_s, 0.02"));
}

TEST(ConfigVehicle, WrongValuesAreNamedWithWhatIsExpected) {
  EXPECT_THAT(Problems("gnss.address = 'localhost'"),
              HasSubstr("gnss.address: \"localhost\", expected a numeric IPv4 or IPv6 address"));
  EXPECT_THAT(Problems("modbus.client.odometer.register = 65536"),
              HasSubstr("65536, expected a register's address in [-1, 65535]"));
  EXPECT_THAT(Problems("[modbus.client]\nconnection = 'tcp'\n"), HasSubstr("no register of"));
  EXPECT_THAT(Problems("[modbus.client]\nconnection = 'rtu'\nbaud = 12345\n"
                       "odometer.register = 1\n"),
              HasSubstr("baud: 12345: expected one of 1200"));
  EXPECT_THAT(Problems("[modbus.client]\nconnection = 'tcp'\n"
                       "odometer = {register = 65535, type = 'u32'}\n"),
              HasSubstr("odometer: register: 65535: expected at most 65534"));
  EXPECT_THAT(Problems("gpio.wheel.edge = 'up'"),
              HasSubstr("\"up\", expected \"rising\", \"falling\" or \"both\""));
  EXPECT_THAT(Problems("gpio.trigger.chip = \"a\\nb\""), HasSubstr("gpio.trigger.chip"));
}

}  // namespace
}  // namespace omnihdr::config_vehicle_test
