#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/base/result.h"
#include "drivers/modbus/registers.h"

// libmodbus' own handle.
struct _modbus;  // NOLINT(bugprone-reserved-identifier)

namespace omnihdr::modbus {

enum class Connection { kOff, kTcp, kRtu };
std::string_view ToString(Connection connection);
enum class Parity { kNone, kEven, kOdd };
std::string_view ToString(Parity parity);

// Where the other side is. TCP: a numeric IPv4 or IPv6 address (looking up a name has no deadline).
struct Endpoint {
  Connection connection = Connection::kTcp;
  std::string address = "127.0.0.1";
  int port = 502;
  std::string device = "/dev/ttyUSB0";
  int baud = 19200;
  Parity parity = Parity::kEven;  // 8 data bits; 1 stop bit, 2 with parity "none"
  int unit = 1;                   // 1 to 247; TCP: 0 to 255
  Status Validate() const;
  std::string Name() const;  // "tcp 192.0.2.7:502 unit 1", for messages
};

// A serial device in raw mode that does not block, its input thrown away.
Result<Fd> OpenSerial(const Endpoint& endpoint);

// The client's end of a connection, over libmodbus. Every call ends within its deadline. Not
// thread-safe.
class Client {
 public:
  // `endpoint` must be valid.
  explicit Client(Endpoint endpoint) : endpoint_(std::move(endpoint)) {}
  ~Client() { Close(); }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  Status Open(Nanoseconds timeout);
  void Close();
  bool open() const { return context_ != nullptr; }
  // kProtocol: the device refused (an exception answer) and the connection is still good. Anything
  // else: the connection is in doubt and should be closed.
  Status Read(Table table, int address, std::span<std::uint16_t> registers);

 private:
  const Endpoint endpoint_;
  _modbus* context_ = nullptr;
};

}  // namespace omnihdr::modbus
