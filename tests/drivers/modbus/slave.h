#pragma once

#include <modbus/modbus.h>
#include <pty.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>

#include "core/base/file.h"
#include "core/base/tcp.h"
#include "tests/support/eventually.h"

namespace omnihdr::testing_modbus {

using testing::Eventually;

// Both ends of a serial line: a program opens `name`, the other end is `master`.
struct SerialLine {
  SerialLine() {
    int master_fd = -1;
    int slave_fd = -1;
    std::array<char, 128> path{};
    if (openpty(&master_fd, &slave_fd, path.data(), nullptr, nullptr) != 0) return;
    master = Fd(master_fd);
    slave = Fd(slave_fd);  // kept open: the line does not hang up when the program closes its end
    termios raw{};
    tcgetattr(slave_fd, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave_fd, TCSANOW, &raw);
    name = path.data();
  }
  Fd master;
  Fd slave;
  std::string name;
};

// A vehicle's controller: libmodbus as a slave with 200 holding and 200 input registers.
class Slave {
 public:
  Slave() { mapping_ = modbus_mapping_new(8, 8, 200, 200); }
  ~Slave() {
    Stop();
    modbus_mapping_free(mapping_);
  }
  Slave(const Slave&) = delete;
  Slave& operator=(const Slave&) = delete;

  // Listens on a port of 127.0.0.1 (0 = any free one) and serves one client after the other.
  void StartTcp(int port = 0) {
    context_ = modbus_new_tcp("127.0.0.1", port);
    listener_ = modbus_tcp_listen(context_, 1);
    port_ = LocalPort(listener_);
    Prepare();
    thread_ = std::jthread([this](std::stop_token stop) {
      while (!stop.stop_requested()) {
        fd_set ready;
        FD_ZERO(&ready);
        FD_SET(listener_, &ready);
        timeval wait{0, 20'000};
        if (select(listener_ + 1, &ready, nullptr, nullptr, &wait) <= 0) continue;
        int listener = listener_;
        if (modbus_tcp_accept(context_, &listener) < 0) continue;
        ++accepted;
        Serve(stop);
        modbus_close(context_);
      }
    });
  }
  // Serves on the master's end of a serial line, as unit 1.
  void StartRtu(int master) {
    context_ = modbus_new_rtu("/dev/null", 19200, 'E', 8, 1);
    modbus_set_slave(context_, 1);
    modbus_set_socket(context_, master);
    Prepare();
    thread_ = std::jthread([this](std::stop_token stop) { Serve(stop); });
  }
  void Stop() {
    if (thread_.joinable()) {
      thread_.request_stop();
      thread_.join();
    }
    if (listener_ >= 0) ::close(listener_);
    listener_ = -1;
    if (context_ != nullptr) modbus_free(context_);
    context_ = nullptr;
  }
  int port() const { return port_; }

  void SetHolding(int address, std::uint16_t value) {
    std::lock_guard lock(mutex_);
    mapping_->tab_registers[address] = value;
  }
  void SetInput(int address, std::uint16_t value) {
    std::lock_guard lock(mutex_);
    mapping_->tab_input_registers[address] = value;
  }
  void SetHolding32(int address, std::uint32_t value) {
    std::lock_guard lock(mutex_);
    mapping_->tab_registers[address] = static_cast<std::uint16_t>(value >> 16);
    mapping_->tab_registers[address + 1] = static_cast<std::uint16_t>(value & 0xFFFF);
  }

  std::atomic<bool> silent = false;  // hears, but does not answer
  std::atomic<bool> hang_up = false;
  std::atomic<int> accepted = 0;
  std::atomic<int> requests = 0;

 private:
  void Prepare() const {
    modbus_set_indication_timeout(context_, 0, 20'000);
    modbus_set_byte_timeout(context_, 0, 100'000);
  }
  void Serve(const std::stop_token& stop) {
    std::array<std::uint8_t, MODBUS_MAX_ADU_LENGTH> request{};
    while (!stop.stop_requested() && !hang_up.exchange(false)) {
      const int length = modbus_receive(context_, request.data());
      if (length < 0) {
        if (errno == ECONNRESET || errno == EBADF) return;
        continue;
      }
      if (length == 0) continue;
      ++requests;
      if (silent) continue;
      std::lock_guard lock(mutex_);
      modbus_reply(context_, request.data(), length, mapping_);
    }
  }

  modbus_t* context_ = nullptr;
  modbus_mapping_t* mapping_ = nullptr;
  int listener_ = -1;
  int port_ = 0;
  std::mutex mutex_;
  std::jthread thread_;
};

}  // namespace omnihdr::testing_modbus
