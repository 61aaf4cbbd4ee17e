#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <array>
#include <cmath>
#include <thread>

#include "core/base/tcp.h"
#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "daemon/logging.h"
#include "daemon/parts.h"
#include "tests/drivers/modbus/slave.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::app_vehicle_test {
namespace {

using ::testing::HasSubstr;
using testing_modbus::Eventually;
using testing_modbus::Slave;

int FreePort() {
  const Result<Fd> listener = ListenTcp("127.0.0.1", 0);
  return listener ? LocalPort(listener->get()) : 0;
}

// Says the same fix ten times a second to one client.
class FakeGpsd {
 public:
  FakeGpsd() : listener_(std::move(*ListenTcp("127.0.0.1", 0))), port_(LocalPort(listener_.get())) {
    thread_ = std::jthread([this](std::stop_token stop) {
      Fd client;
      const std::string line =
          "{\"class\":\"TPV\",\"mode\":3,\"status\":3,\"time\":\"2026-01-01T12:00:13.250Z\","
          "\"lat\":52.5,\"lon\":13.4,\"altMSL\":40.0,\"track\":90.0,\"speed\":5.0}\r\n";
      while (!stop.stop_requested()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
        if (!client.valid()) client = Fd(accept(listener_.get(), nullptr, nullptr));
        if (client.valid() && send(client.get(), line.data(), line.size(), MSG_NOSIGNAL) < 0)
          return;
      }
    });
  }
  int port() const { return port_; }

 private:
  Fd listener_;
  int port_;
  std::jthread thread_;
};

// The daemon as configured, with the simulated camera, a controller by libmodbus, a gpsd, and a
// master that commands: everything but the hardware.
TEST(AppVehicle, ADriveByTheVehiclesOdometerIsCommandedByModbusAndJournaledWithItsPlace) {
  InitLogging(LogLevel::kError);
  const testing::TemporaryDirectory directory;
  Slave controller;
  controller.SetHolding32(100, 1'000'000);  // millimetres
  controller.SetInput(7, 3599);             // tenths of a degree
  controller.StartTcp();
  const FakeGpsd gpsd;
  const int server_port = FreePort();

  DaemonConfig config;
  config.session.directory = directory.path().string();
  config.session.name = "s";
  config.storage.allow_root = true;
  config.storage.limits = {0.0, 0.0, 0.0, 0.0};
  config.api.socket = (directory.path() / "api.sock").string();
  config.camera.sim.width = 128;
  config.pipeline.enabled = false;
  config.trigger.source = TriggerKind::kDistance;
  config.trigger.odometer = OdometerKind::kModbus;
  config.trigger.distance_m = 1.0;
  config.modbus.client.endpoint.connection = modbus::Connection::kTcp;
  config.modbus.client.endpoint.port = controller.port();
  config.modbus.client.poll_s = 0.01;
  config.modbus.client.odometer.address = 100;
  config.modbus.client.odometer.type = modbus::NumberType::kU32;
  config.modbus.client.odometer.scale = 0.001;
  config.modbus.client.heading.table = modbus::Table::kInput;
  config.modbus.client.heading.address = 7;
  config.modbus.client.heading.scale = 0.1;
  config.modbus.server.endpoint.connection = modbus::Connection::kTcp;
  config.modbus.server.endpoint.port = server_port;
  config.modbus.control = true;
  config.gnss.enabled = true;
  config.gnss.gpsd.port = gpsd.port();
  ASSERT_TRUE(CheckParts(config)) << CheckParts(config).error().message;

  auto choice = ChooseSession(config.session, "", SystemClock().NowUtc());
  ASSERT_TRUE(choice);
  App app(config, *choice,
          [&](const PartsContext& context) { return MakeConfiguredParts(config, context); });
  Status outcome;
  std::thread daemon([&] {
    EXPECT_TRUE(BlockSignals());
    outcome = app.Run();
  });
  ApiClient client(config.api.socket);
  const auto status_holds = [&](const std::function<bool(const nlohmann::json&)>& holds) {
    return Eventually([&] {
      const auto status = client.Get("/v1/status");
      return status && holds(*status);
    });
  };
  // The camera renders a picture before it is there, on a busy machine for long.
  const auto ready = [](const nlohmann::json& s) {
    return s["state"] == "idle" && s["odometer_m"].is_number() && s["gnss"].is_object();
  };
  bool became_ready = false;
  for (int i = 0; i < 6 && !became_ready; ++i) became_ready = status_holds(ready);
  EXPECT_TRUE(became_ready);

  modbus_t* master = modbus_new_tcp("127.0.0.1", server_port);
  modbus_set_response_timeout(master, 2, 0);
  EXPECT_TRUE(Eventually([&] { return modbus_connect(master) == 0; }));
  EXPECT_EQ(modbus_write_bit(master, 1, 1), -1) << "disarmed: no trigger";
  EXPECT_EQ(modbus_write_bit(master, 0, 1), 1) << modbus_strerror(errno);
  // The starting place is a mark; then three and a half metres at two metres a second.
  EXPECT_TRUE(status_holds([](const auto& s) { return s["frames_recorded"] == 1; }));
  for (std::uint32_t mm = 0; mm <= 3500; mm += 20) {
    controller.SetHolding32(100, 1'000'000 + mm);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_TRUE(status_holds([](const auto& s) { return s["triggers"]["accepted"] == 4; }));
  EXPECT_TRUE(status_holds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
  std::array<std::uint16_t, 20> registers{};
  EXPECT_TRUE(Eventually([&] {
    return modbus_read_input_registers(master, 0, 20, registers.data()) == 20 &&
           registers[4] * 65536 + registers[5] == 4 &&
           std::abs(registers[16] * 65536.0 + registers[17] - 1'003'500.0) < 100.0;
  }));
  EXPECT_TRUE(registers[1] == 3 || registers[1] == 8) << "armed or capturing: " << registers[1];
  EXPECT_EQ(registers[2] & 0b1100011, 0b1100011) << "ready, armed, odometer and GNSS known";

  // The controller falls silent: the appliance says so, and works on without what was read last.
  controller.silent = true;
  EXPECT_TRUE(status_holds([](const auto& s) {
    return s["state"] == "degraded" && s["odometer_m"].is_null() &&
           s["reason"].template get<std::string>().find("modbus vehicle") != std::string::npos;
  }));
  EXPECT_EQ(modbus_write_register(master, 100, 3), 1) << modbus_strerror(errno);
  modbus_close(master);
  modbus_free(master);
  EXPECT_TRUE(status_holds([](const auto& s) {
    return s["triggers"]["accepted"] == 5 && s["triggers"]["in_flight"] == 0;
  }));
  EXPECT_TRUE(client.Post("/v1/stop", {{"leave_open", true}}));
  daemon.join();
  EXPECT_TRUE(outcome) << outcome.error().message;

  const auto contents = ReadSession(directory.path() / "s");
  ASSERT_TRUE(contents);
  const auto& frames = contents->journal.frames;
  ASSERT_EQ(frames.size(), 5U);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(frames[i].status, FrameStatus::kOk) << frames[i].detail;
    EXPECT_NEAR(frames[i].odometer_m.value_or(0.0), 1000.0 + static_cast<double>(i), 1e-9);
    EXPECT_NEAR(frames[i].heading_deg.value_or(0.0), 359.9, 1e-9);
    ASSERT_TRUE(frames[i].gnss);
    EXPECT_EQ(frames[i].gnss->lat_deg, 52.5);
    EXPECT_EQ(frames[i].gnss->fix, 4);
    EXPECT_EQ(frames[i].gnss->time, "2026-01-01T12:00:13.250Z");
    EXPECT_LT(frames[i].gnss->age_s.value_or(99.0), 2.0);
  }
  EXPECT_FALSE(frames[4].odometer_m) << "stale readings are not journaled";
  EXPECT_FALSE(frames[4].heading_deg);
}

TEST(AppVehicle, WhatIsNotConfiguredIsRefusedBeforeAnythingStarts) {
  DaemonConfig config;
  config.trigger.source = TriggerKind::kGpio;
  Status checked = CheckParts(config);
  ASSERT_FALSE(checked);
  EXPECT_EQ(checked.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(checked.error().message, HasSubstr("expected gpio.trigger.line"));
  config.gpio.inputs.trigger.name = {"no-such-chip", "17"};
  EXPECT_TRUE(CheckParts(config)) << "whether the chip is there shows only when it is opened";
  config.trigger.odometer = OdometerKind::kWheel;
  EXPECT_THAT(CheckParts(config).error().message, HasSubstr("expected gpio.wheel.line"));
  config.trigger.odometer = OdometerKind::kModbus;
  EXPECT_THAT(CheckParts(config).error().message,
              HasSubstr("expected modbus.client.odometer.register"));
}

}  // namespace
}  // namespace omnihdr::app_vehicle_test
