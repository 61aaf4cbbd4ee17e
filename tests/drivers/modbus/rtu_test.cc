// Modbus RTU over pseudo-terminals, which are real ttys: our client and our server at two ends of
// one line, and what neither must take.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <thread>

#include "tests/drivers/modbus/serial_appliance.h"
#include "tests/drivers/modbus/slave.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::rtu_test {
namespace {

using testing_modbus::Bytes;
using testing_modbus::Eventually;
using testing_modbus::HostileAnswers;
using testing_modbus::SerialLine;
using testing_modbus::WithCrc;
using testing_modbus::WriteAll;

// Two pseudo-terminals with a wire between them. The programs open names that stay when an adapter
// is taken out and put in again.
class Cable {
 public:
  Cable() { PlugIn(); }
  ~Cable() { Unplug(); }
  Cable(const Cable&) = delete;
  Cable& operator=(const Cable&) = delete;

  std::string end(int which) const { return (folder_.path() / (which == 0 ? "a" : "b")).string(); }
  void PlugIn() {
    ends_[0] = std::make_unique<SerialLine>();
    ends_[1] = std::make_unique<SerialLine>();
    for (int i = 0; i < 2; ++i) std::filesystem::create_symlink(ends_[i]->name, end(i));
    wire_ = std::jthread([this](std::stop_token stop) { Carry(stop); });
  }
  void Unplug() {
    if (wire_.joinable()) {
      wire_.request_stop();
      wire_.join();
    }
    for (int i = 0; i < 2; ++i) {
      ends_[i].reset();
      std::filesystem::remove(end(i));
    }
  }

 private:
  void Carry(const std::stop_token& stop) const {
    while (!stop.stop_requested()) {
      std::array<pollfd, 2> ready = {
          {{ends_[0]->master.get(), POLLIN, 0}, {ends_[1]->master.get(), POLLIN, 0}}};
      if (poll(ready.data(), ready.size(), 10) <= 0) continue;
      for (std::size_t i = 0; i < 2; ++i) {
        std::array<std::uint8_t, 256> some{};
        if ((ready[i].revents & POLLIN) == 0) continue;
        const ssize_t got = read(ready[i].fd, some.data(), some.size());
        if (got > 0) WriteAll(ready[1 - i].fd, {some.data(), static_cast<std::size_t>(got)});
      }
    }
  }

  const testing::TemporaryDirectory folder_;
  std::array<std::unique_ptr<SerialLine>, 2> ends_;
  std::jthread wire_;
};

class ModbusRtu : public testing_modbus::SerialAppliance {
 protected:
  void StartServerAt(const std::string& device) {
    modbus::ServerOptions options;
    options.endpoint = At(device);
    options.longest_pause = std::chrono::milliseconds(500);
    StartServer(options);
  }
  static modbus::VehicleOptions VehicleAt(const std::string& device) {
    modbus::VehicleOptions options = OdometerAt(At(device));
    options.poll_s = 0.01;
    options.timeout_s = 0.4;
    options.stale_s = 1.5;
    options.reconnect_s = 0.1;
    return options;
  }
};

TEST_F(ModbusRtu, OneAppliancesOdometerIsAnothersOverALineThatIsTakenOutAndPutIn) {
  Cable cable;
  ASSERT_NO_FATAL_FAILURE(StartServerAt(cable.end(0)));
  ShowOdometer(12.345);
  modbus::Vehicle vehicle(VehicleAt(cable.end(1)), clock_);
  ASSERT_TRUE(vehicle.Start());
  EXPECT_TRUE(Reads(vehicle, 12.345)) << vehicle.report().problem;
  cable.Unplug();
  EXPECT_TRUE(Eventually([&] { return !server_->report().up && !vehicle.report().up; }));
  EXPECT_TRUE(Eventually([&] { return !vehicle.OdometerMetres(clock_.Now()); }));
  cable.PlugIn();
  ShowOdometer(12.5);
  EXPECT_TRUE(Reads(vehicle, 12.5)) << vehicle.report().problem << server_->report().problem;
}

TEST_F(ModbusRtu, WhateverComesTheNextGoodRequestIsAnsweredAndNothingIsCommanded) {
  SerialLine line;
  ASSERT_NO_FATAL_FAILURE(StartServerAt(line.name));
  ExpectServesBetweenHostileRequestsAndIsCommandedNothing(line.master.get());
}

TEST_F(ModbusRtu, NoHostileAnswerIsTakenForANumberAndGoodOnesAreReadAfterwards) {
  SerialLine line;
  const std::vector<Bytes> answers = HostileAnswers();
  std::atomic<std::size_t> given = 0;
  std::jthread slave([&](std::stop_token stop) {
    while (!stop.stop_requested()) {
      const Bytes request = testing_modbus::ReadUntilSilent(
          line.master.get(), std::chrono::milliseconds(20), std::chrono::milliseconds(5));
      if (request.size() < 8) continue;
      const Bytes good = WithCrc({1, 3, 4, 0, 0, 0x1B, 0x58});
      WriteAll(line.master.get(), given < answers.size() ? answers[given] : good);
      ++given;
    }
  });
  modbus::Vehicle vehicle(VehicleAt(line.name), clock_);
  ASSERT_TRUE(vehicle.Start());
  while (given < answers.size()) {
    EXPECT_FALSE(vehicle.OdometerMetres(clock_.Now())) << given;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_GE(vehicle.report().errors + 1, answers.size());
  EXPECT_TRUE(Reads(vehicle, 7.0)) << vehicle.report().problem;
}

}  // namespace
}  // namespace omnihdr::rtu_test
