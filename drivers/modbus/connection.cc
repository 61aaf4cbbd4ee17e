#include "drivers/modbus/connection.h"

#include <fcntl.h>
#include <modbus/modbus.h>
#include <sys/select.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

#include "core/base/tcp.h"

namespace omnihdr::modbus {
namespace {

struct Baud {
  int rate;
  speed_t code;
};
constexpr std::array<Baud, 9> kBauds = {{{1200, B1200},
                                         {2400, B2400},
                                         {4800, B4800},
                                         {9600, B9600},
                                         {19200, B19200},
                                         {38400, B38400},
                                         {57600, B57600},
                                         {115200, B115200},
                                         {230400, B230400}}};

char ParityLetter(Parity parity) {
  if (parity == Parity::kNone) return 'N';
  return parity == Parity::kEven ? 'E' : 'O';
}

int StopBits(Parity parity) { return parity == Parity::kNone ? 2 : 1; }

struct SplitTime {
  std::uint32_t seconds;
  std::uint32_t micros;
};

SplitTime Split(Nanoseconds time) {
  const std::int64_t us = std::max<std::int64_t>(time.count() / 1000, 1);
  return {static_cast<std::uint32_t>(us / 1'000'000), static_cast<std::uint32_t>(us % 1'000'000)};
}

}  // namespace

std::string_view ToString(Connection connection) {
  switch (connection) {
    case Connection::kOff:
      return "off";
    case Connection::kTcp:
      return "tcp";
    case Connection::kRtu:
      return "rtu";
  }
  return "?";
}

std::string_view ToString(Parity parity) {
  switch (parity) {
    case Parity::kNone:
      return "none";
    case Parity::kEven:
      return "even";
    case Parity::kOdd:
      return "odd";
  }
  return "?";
}

std::string Endpoint::Name() const {
  return connection == Connection::kRtu ? fmt::format("rtu {} unit {}", device, unit)
                                        : fmt::format("tcp {}:{} unit {}", address, port, unit);
}

Status Endpoint::Validate() const {
  if (connection == Connection::kRtu) {
    if (std::none_of(kBauds.begin(), kBauds.end(), [&](const Baud& b) { return b.rate == baud; })) {
      std::string known;
      for (const Baud& b : kBauds) known += fmt::format("{}{}", known.empty() ? "" : ", ", b.rate);
      return Fail(ErrorKind::kConfig, "baud: {}: expected one of {}", baud, known);
    }
    if (unit < 1 || unit > 247) {
      return Fail(ErrorKind::kConfig, "unit: {}: expected 1 to 247 with connection \"rtu\"", unit);
    }
    return {};
  }
  if (!IsNumericAddress(address)) {
    return Fail(ErrorKind::kConfig, "address: \"{}\": expected a numeric IPv4 or IPv6 address",
                address);
  }
  if (port < 0 || port > 65535) {
    return Fail(ErrorKind::kConfig, "port: {}: expected 0 to 65535", port);
  }
  return {};
}

Result<Fd> OpenSerial(const Endpoint& endpoint) {
  Fd fd(::open(endpoint.device.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (!fd.valid()) {
    return FailErrno(errno == EACCES ? ErrorKind::kPermission : ErrorKind::kUnavailable,
                     fmt::format("open {}", endpoint.device), errno);
  }
  termios tty{};
  if (tcgetattr(fd.get(), &tty) != 0) {
    return FailErrno(ErrorKind::kUnavailable, fmt::format("{}: not a terminal", endpoint.device),
                     errno);
  }
  cfmakeraw(&tty);
  tty.c_cflag |= CLOCAL | CREAD;
  tty.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | PARENB | PARODD | CRTSCTS);
  if (StopBits(endpoint.parity) == 2) tty.c_cflag |= CSTOPB;
  if (endpoint.parity != Parity::kNone) tty.c_cflag |= PARENB;
  if (endpoint.parity == Parity::kOdd) tty.c_cflag |= PARODD;
  if (endpoint.parity != Parity::kNone) tty.c_iflag |= INPCK;
  for (const Baud& baud : kBauds) {
    if (baud.rate == endpoint.baud) cfsetspeed(&tty, baud.code);
  }
  if (tcsetattr(fd.get(), TCSANOW, &tty) != 0) {
    return FailErrno(ErrorKind::kUnavailable, fmt::format("{}: set speed", endpoint.device), errno);
  }
  tcflush(fd.get(), TCIOFLUSH);
  return fd;
}

Status Client::Open(Nanoseconds timeout) {
  Close();
  Fd socket;
  if (endpoint_.connection == Connection::kRtu) {
    // libmodbus puts the device into the mode it needs; whether it is there and may be opened is
    // found out here, with a message that says so.
    if (access(endpoint_.device.c_str(), R_OK | W_OK) != 0) {
      return FailErrno(errno == EACCES ? ErrorKind::kPermission : ErrorKind::kUnavailable,
                       fmt::format("open {}", endpoint_.device), errno);
    }
    context_ = modbus_new_rtu(endpoint_.device.c_str(), endpoint_.baud,
                              ParityLetter(endpoint_.parity), 8, StopBits(endpoint_.parity));
  } else {
    OMNIHDR_ASSIGN(socket, ConnectTcp(endpoint_.address, endpoint_.port, timeout));
    // The address is of no account: the connection is made already.
    context_ = modbus_new_tcp("127.0.0.1", endpoint_.port);
  }
  if (context_ == nullptr) return FailErrno(ErrorKind::kSystem, endpoint_.Name(), errno);
  const SplitTime split = Split(timeout);
  // Without a byte time-out the response time-out is for the whole answer.
  if (modbus_set_slave(context_, endpoint_.unit) != 0 ||
      modbus_set_response_timeout(context_, split.seconds, split.micros) != 0 ||
      modbus_set_byte_timeout(context_, 0, 0) != 0 ||
      modbus_set_error_recovery(context_, MODBUS_ERROR_RECOVERY_NONE) != 0) {
    const int error = errno;
    Close();
    return FailErrno(ErrorKind::kConfig, endpoint_.Name(), error);
  }
  if (endpoint_.connection == Connection::kTcp) {
    modbus_set_socket(context_, socket.Release());
  } else if (modbus_connect(context_) != 0) {
    const int error = errno;
    Close();
    return FailErrno(ErrorKind::kUnavailable, fmt::format("open {}", endpoint_.device), error);
  }
  // libmodbus waits with select(), which knows no higher descriptors.
  if (modbus_get_socket(context_) >= FD_SETSIZE) {
    Close();
    return Fail(ErrorKind::kSystem, "{}: more than {} descriptors are open", endpoint_.Name(),
                FD_SETSIZE);
  }
  modbus_flush(context_);
  return {};
}

void Client::Close() {
  if (context_ == nullptr) return;
  modbus_close(context_);
  modbus_free(context_);
  context_ = nullptr;
}

Status Client::Read(Table table, int address, std::span<std::uint16_t> registers) {
  if (context_ == nullptr) return Fail(ErrorKind::kUnavailable, "not connected");
  const int count = static_cast<int>(registers.size());
  const auto read = table == Table::kInput ? modbus_read_input_registers : modbus_read_registers;
  errno = 0;
  if (read(context_, address, count, registers.data()) == count) return {};
  const int error = errno;
  const bool refused = error > MODBUS_ENOBASE && error < EMBBADCRC;
  const ErrorKind kind = refused              ? ErrorKind::kProtocol
                         : error == ETIMEDOUT ? ErrorKind::kTemporary
                                              : ErrorKind::kUnavailable;
  return Fail(kind, "read {} {} register{} from {}: {}", count, ToString(table),
              count == 1 ? "" : "s", address, modbus_strerror(error));
}

}  // namespace omnihdr::modbus
