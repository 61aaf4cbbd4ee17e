#include "drivers/modbus/connection.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <modbus/modbus.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <utility>

namespace omnihdr::modbus {
namespace {

struct SocketAddress {
  sockaddr_storage storage{};
  socklen_t length = 0;
  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
};

std::optional<SocketAddress> Parse(const std::string& address, int port) {
  SocketAddress result;
  sockaddr_in v4{};
  sockaddr_in6 v6{};
  if (inet_pton(AF_INET, address.c_str(), &v4.sin_addr) == 1) {
    v4.sin_family = AF_INET;
    v4.sin_port = htons(static_cast<std::uint16_t>(port));
    std::memcpy(&result.storage, &v4, sizeof v4);
    result.length = sizeof v4;
    return result;
  }
  if (inet_pton(AF_INET6, address.c_str(), &v6.sin6_addr) == 1) {
    v6.sin6_family = AF_INET6;
    v6.sin6_port = htons(static_cast<std::uint16_t>(port));
    std::memcpy(&result.storage, &v6, sizeof v6);
    result.length = sizeof v6;
    return result;
  }
  return std::nullopt;
}

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
  if (!Parse(address, port)) {
    return Fail(ErrorKind::kConfig, "address: \"{}\": expected a numeric IPv4 or IPv6 address",
                address);
  }
  if (port < 0 || port > 65535) {
    return Fail(ErrorKind::kConfig, "port: {}: expected 0 to 65535", port);
  }
  return {};
}

Result<Fd> ConnectTcp(const std::string& address, int port, Nanoseconds timeout) {
  const auto where = [&] { return fmt::format("connect to {}:{}", address, port); };
  const std::optional<SocketAddress> to = Parse(address, port);
  if (!to) return Fail(ErrorKind::kConfig, "address: \"{}\": expected a numeric address", address);
  Fd fd(socket(to->storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, where(), errno);
  if (connect(fd.get(), to->get(), to->length) != 0) {
    if (errno != EINPROGRESS) return FailErrno(ErrorKind::kUnavailable, where(), errno);
    pollfd ready{fd.get(), POLLOUT, 0};
    const int got = poll(&ready, 1, static_cast<int>(timeout.count() / 1'000'000));
    if (got == 0) {
      return Fail(ErrorKind::kTemporary, "{}: no answer within {} ms", where(),
                  timeout.count() / 1'000'000);
    }
    if (got < 0) return FailErrno(ErrorKind::kTemporary, where(), errno);
    int error = 0;
    socklen_t length = sizeof error;
    getsockopt(fd.get(), SOL_SOCKET, SO_ERROR, &error, &length);
    if (error != 0) return FailErrno(ErrorKind::kUnavailable, where(), error);
  }
  const int on = 1;
  setsockopt(fd.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  return fd;
}

Result<Fd> ListenTcp(const std::string& address, int port) {
  const auto where = [&] { return fmt::format("listen on {}:{}", address, port); };
  const std::optional<SocketAddress> at = Parse(address, port);
  if (!at) return Fail(ErrorKind::kConfig, "address: \"{}\": expected a numeric address", address);
  Fd fd(socket(at->storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, where(), errno);
  const int on = 1;
  setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (bind(fd.get(), at->get(), at->length) != 0 || listen(fd.get(), 64) != 0) {
    return FailErrno(errno == EACCES ? ErrorKind::kPermission : ErrorKind::kUnavailable, where(),
                     errno);
  }
  return fd;
}

int LocalPort(int fd) {
  sockaddr_storage address{};
  socklen_t length = sizeof address;
  if (getsockname(fd, reinterpret_cast<sockaddr*>(&address), &length) != 0) return 0;
  if (address.ss_family == AF_INET) {
    return ntohs(reinterpret_cast<const sockaddr_in*>(&address)->sin_port);
  }
  return address.ss_family == AF_INET6
             ? ntohs(reinterpret_cast<const sockaddr_in6*>(&address)->sin6_port)
             : 0;
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
