#include "drivers/modbus/server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <random>

#include "core/base/tcp.h"
#include "tests/drivers/modbus/slave.h"

namespace omnihdr::server_test {
namespace {

using ::testing::ElementsAre;
using testing_modbus::Eventually;
using testing_modbus::SerialLine;

class ModbusServer : public ::testing::Test {
 protected:
  void Start(modbus::ServerOptions options = {}) {
    options.endpoint.port = 0;
    server = std::make_unique<modbus::StatusServer>(
        options,
        [this](ApplianceCommand command) -> Status {
          std::lock_guard lock(mutex);
          commands.push_back(command);
          return answer;
        },
        clock);
    ASSERT_TRUE(server->Start());
    ASSERT_TRUE(Eventually([&] { return server->report().up; })) << server->report().problem;
  }
  // A master by libmodbus, connected.
  modbus_t* Master() {
    modbus_t* master = modbus_new_tcp("127.0.0.1", server->port());
    modbus_set_response_timeout(master, 2, 0);
    modbus_set_slave(master, 1);
    if (modbus_connect(master) != 0) ADD_FAILURE() << modbus_strerror(errno);
    return master;
  }
  static void Close(modbus_t* master) {
    modbus_close(master);
    modbus_free(master);
  }
  Fd Raw() const {
    Result<Fd> fd = ConnectTcp("127.0.0.1", server->port(), std::chrono::seconds(2));
    return fd ? std::move(*fd) : Fd();
  }
  // Whether the server has hung up, within its patience.
  static bool HungUp(const Fd& fd) {
    return Eventually([&] {
      std::array<char, 256> sink{};
      const ssize_t got = recv(fd.get(), sink.data(), sink.size(), MSG_DONTWAIT);
      return got == 0 || (got < 0 && errno != EAGAIN);
    });
  }
  // That a master is served; one that comes while all places are taken tries again.
  void ExpectServes() {
    EXPECT_TRUE(Eventually([&] {
      modbus_t* master = modbus_new_tcp("127.0.0.1", server->port());
      modbus_set_response_timeout(master, 2, 0);
      std::array<std::uint16_t, 4> registers{};
      const bool served = modbus_connect(master) == 0 &&
                          modbus_read_registers(master, 0, 4, registers.data()) == 4 &&
                          registers[0] == modbus::kMapVersion;
      Close(master);
      return served;
    }));
  }

  const SystemClock clock{};
  std::mutex mutex;
  std::vector<ApplianceCommand> commands;
  Status answer;
  std::unique_ptr<modbus::StatusServer> server;
};

TEST_F(ModbusServer, AMasterReadsTheStatusAndGivesCommandsOverTcp) {
  Start();
  ApplianceStatus status;
  status.state = CaptureState::kArmed;
  status.frames_recorded = 70'000;
  server->Show(status);
  modbus_t* master = Master();
  std::array<std::uint16_t, 8> registers{};
  ASSERT_EQ(modbus_read_input_registers(master, 0, 8, registers.data()), 8);
  EXPECT_EQ(registers[1], 3);
  EXPECT_EQ(registers[6] << 16 | registers[7], 70'000);
  EXPECT_EQ(modbus_write_bit(master, 0, 1), 1);
  EXPECT_EQ(modbus_write_register(master, 100, 3), 1);
  {
    std::lock_guard lock(mutex);
    EXPECT_THAT(commands, ElementsAre(ApplianceCommand::kArm, ApplianceCommand::kTrigger));
    answer = Fail(ErrorKind::kUnavailable, "the session has ended");
  }
  EXPECT_EQ(modbus_write_bit(master, 1, 1), -1);
  EXPECT_EQ(errno, EMBXSFAIL);
  EXPECT_EQ(modbus_read_registers(master, 64, 1, registers.data()), -1);
  EXPECT_EQ(errno, EMBXILADD);
  modbus_set_slave(master, 9);
  EXPECT_EQ(modbus_read_registers(master, 0, 1, registers.data()), -1);
  EXPECT_EQ(errno, EMBXGTAR);
  Close(master);
}

TEST_F(ModbusServer, AMasterReadsAndCommandsOverASerialLine) {
  SerialLine line;
  modbus::ServerOptions options;
  options.endpoint.connection = modbus::Connection::kRtu;
  options.endpoint.device = line.name;
  Start(options);
  modbus_t* master = modbus_new_rtu("/dev/null", 19200, 'E', 8, 1);
  modbus_set_slave(master, 1);
  modbus_set_response_timeout(master, 2, 0);
  modbus_set_socket(master, line.master.get());
  std::array<std::uint16_t, 64> registers{};
  EXPECT_EQ(modbus_read_registers(master, 0, 64, registers.data()), 64) << modbus_strerror(errno);
  EXPECT_EQ(registers[0], modbus::kMapVersion);
  EXPECT_EQ(modbus_write_bit(master, 0, 1), 1) << modbus_strerror(errno);
  // Noise, a frame cut short, and another unit's traffic, then silence: the next request is heard.
  const std::array<std::uint8_t, 9> noise = {1, 3, 0, 0, 0xFF, 2, 3, 0, 1};
  ASSERT_EQ(write(line.master.get(), noise.data(), noise.size()), 9);
  EXPECT_TRUE(Eventually([&] { return server->report().errors > 0; }));
  EXPECT_EQ(modbus_read_registers(master, 0, 2, registers.data()), 2) << modbus_strerror(errno);
  // A broadcast is done and not answered.
  modbus_set_slave(master, 0);
  modbus_set_response_timeout(master, 0, 50'000);
  EXPECT_EQ(modbus_write_register(master, 100, 2), -1);
  EXPECT_TRUE(Eventually([&] {
    std::lock_guard lock(mutex);
    return commands.size() == 2 && commands[1] == ApplianceCommand::kDisarm;
  }));
  modbus_free(master);
}

TEST_F(ModbusServer, ASerialDeviceThatIsNotThereIsWaitedFor) {
  modbus::ServerOptions options;
  options.endpoint.connection = modbus::Connection::kRtu;
  options.endpoint.device = "/dev/there-is-no-such-line";
  server = std::make_unique<modbus::StatusServer>(options, CommandHandler{}, clock);
  ASSERT_TRUE(server->Start());
  EXPECT_TRUE(Eventually([&] { return server->report().errors > 0; }));
  EXPECT_THAT(server->report().problem, ::testing::HasSubstr("/dev/there-is-no-such-line"));
}

TEST_F(ModbusServer, WhatIsNoModbusIsHungUpOn) {
  Start();
  const Fd fd = Raw();
  ASSERT_EQ(send(fd.get(), "GET / HTTP/1.1\r\n\r\n", 18, MSG_NOSIGNAL), 18);
  EXPECT_TRUE(HungUp(fd));
  ExpectServes();
}

TEST_F(ModbusServer, AClientThatSendsHalfARequestDoesNotKeepOthersWaiting) {
  Start();
  const Fd half = Raw();
  const std::array<std::uint8_t, 9> begun = {0, 1, 0, 0, 0, 6, 1, 3, 0};
  ASSERT_EQ(send(half.get(), begun.data(), begun.size(), MSG_NOSIGNAL), 9);
  ExpectServes();
}

TEST_F(ModbusServer, ASilentClientIsLetGo) {
  modbus::ServerOptions options;
  options.idle = std::chrono::milliseconds(50);
  Start(options);
  const Fd fd = Raw();
  EXPECT_TRUE(HungUp(fd));
}

TEST_F(ModbusServer, MoreClientsThanItHasRoomForAreTurnedAwayAndPlacesBecomeFree) {
  modbus::ServerOptions options;
  options.clients = 2;
  Start(options);
  Fd first = Raw();
  const Fd second = Raw();
  ASSERT_TRUE(Eventually([&] {
    const Fd third = Raw();
    return third.valid() && HungUp(third);
  }));
  first.Close();
  EXPECT_TRUE(Eventually([&] {
    modbus_t* master = modbus_new_tcp("127.0.0.1", server->port());
    modbus_set_response_timeout(master, 0, 200'000);
    std::uint16_t value = 0;
    const bool served =
        modbus_connect(master) == 0 && modbus_read_registers(master, 0, 1, &value) == 1;
    Close(master);
    return served;
  }));
}

TEST_F(ModbusServer, AClientThatAsksWithoutReadingDoesNotKeepOthersWaiting) {
  Start();
  const Fd fd = Raw();
  const std::array<std::uint8_t, 12> request = {0, 1, 0, 0, 0, 6, 1, 3, 0, 0, 0, 64};
  // Until the line is full.
  while (send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL | MSG_DONTWAIT) == 12) {
  }
  ExpectServes();
}

TEST_F(ModbusServer, NoBytesWhateverTheyAreStopItsService) {
  Start();
  std::mt19937 random(20260101);
  for (int round = 0; round < 40; ++round) {
    const Fd fd = Raw();
    std::vector<std::uint8_t> bytes(random() % 600);
    for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random());
    // Half of them look like requests.
    for (std::size_t at = 0; round % 2 == 0 && at + 8 < bytes.size(); at += 12) {
      bytes[at + 2] = bytes[at + 3] = bytes[at + 4] = 0;
      bytes[at + 5] = 6;
      bytes[at + 6] = 1;
      bytes[at + 7] = static_cast<std::uint8_t>(random() % 24);
    }
    [[maybe_unused]] const ssize_t sent =
        send(fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  }
  ExpectServes();
}

TEST_F(ModbusServer, APortThatIsTakenIsToldAndTriedAgain) {
  Result<Fd> taken = ListenTcp("127.0.0.1", 0);
  ASSERT_TRUE(taken);
  modbus::ServerOptions options;
  options.endpoint.port = LocalPort(taken->get());
  server = std::make_unique<modbus::StatusServer>(options, CommandHandler{}, clock);
  ASSERT_TRUE(server->Start());
  EXPECT_TRUE(Eventually([&] { return server->report().errors > 0; }));
  EXPECT_THAT(server->report().problem, ::testing::HasSubstr("Address already in use"));
  taken->Close();
  EXPECT_TRUE(Eventually([&] { return server->report().up; }));
}

}  // namespace
}  // namespace omnihdr::server_test
