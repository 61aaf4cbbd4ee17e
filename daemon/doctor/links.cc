// gpsd and Modbus: whether somebody answers, and what.
#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <nlohmann/json.hpp>
#include <vector>

#include "core/base/tcp.h"
#include "daemon/doctor/checks.h"
#include "drivers/modbus/connection.h"

namespace omnihdr::doctor {
namespace {

constexpr std::string_view kWatch = "?WATCH={\"enable\":true,\"json\":true};\n";
constexpr std::size_t kMaxGreeting = std::size_t{64} << 10;

// What gpsd says until it has listed its receivers, or the time is over.
std::string HearGpsd(int fd, Nanoseconds timeout) {
  std::string text;
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  bool asked = false;
  while (text.size() < kMaxGreeting && text.find("\"DEVICES\"") == std::string::npos) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(
        deadline - std::chrono::steady_clock::now());
    pollfd ready{fd, POLLIN, 0};
    if (left.count() <= 0 || ::poll(&ready, 1, static_cast<int>(left.count())) <= 0) break;
    std::array<char, 4096> piece{};
    const ssize_t n = ::recv(fd, piece.data(), piece.size(), 0);
    if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) break;
    if (n > 0) text.append(piece.data(), static_cast<std::size_t>(n));
    if (!asked && text.find("\"VERSION\"") != std::string::npos) {
      asked = true;
      if (::send(fd, kWatch.data(), kWatch.size(), MSG_NOSIGNAL) < 0) break;
    }
  }
  return text;
}

void CheckGpsd(Examination& e) {
  if (!e.config.gnss.enabled) return;
  const std::string& address = e.config.gnss.gpsd.address;
  const int port = e.config.gnss.gpsd.port;
  const Result<Fd> socket = ConnectTcp(address, port, e.options.timeout);
  if (!socket) {
    e.Problem("gnss", fmt::format("gpsd: {}", socket.error().message),
              "sudo apt install gpsd; sudo systemctl enable --now gpsd.socket; gpspipe -w -n 3");
    return;
  }
  const std::string text = HearGpsd(socket->get(), e.options.timeout);
  if (text.find("\"VERSION\"") == std::string::npos) {
    e.Problem("gnss", fmt::format("{}:{} answers, and is no gpsd", address, port),
              "set gnss.address and gnss.port to gpsd's (2947)");
    return;
  }
  std::size_t devices = 0;
  std::string line;
  for (std::size_t begin = 0; begin < text.size(); begin += line.size() + 1) {
    line = text.substr(begin, text.find('\n', begin) - begin);
    const auto json = nlohmann::json::parse(line, nullptr, false);
    if (json.is_object() && json.value("class", "") == "DEVICES" && json.contains("devices")) {
      devices = json["devices"].size();
    }
  }
  if (devices == 0) {
    e.Warning("gnss", fmt::format("gpsd at {}:{} has no receiver", address, port),
              "ls /dev/ttyACM* /dev/ttyUSB*; sudo gpsdctl add /dev/ttyACM0; for good: DEVICES in "
              "/etc/default/gpsd");
    return;
  }
  e.Good("gnss", fmt::format("gpsd at {}:{} has {} receiver{}", address, port, devices,
                             devices == 1 ? "" : "s"));
}

void CheckModbusClient(Examination& e) {
  const modbus::VehicleOptions& options = e.config.modbus.client;
  const modbus::Endpoint& endpoint = options.endpoint;
  if (endpoint.connection == modbus::Connection::kOff) return;
  if (endpoint.connection == modbus::Connection::kRtu) {
    if (!CheckNode(e, "modbus-device", endpoint.device, "dialout",
                   "ls /dev/ttyUSB* /dev/ttyACM*; sudo dmesg | tail   # adapter plugged in? "
                   "sudo modprobe ftdi_sio, cp210x or ch341")) {
      return;
    }
    if (e.daemon_answers) {
      e.Add("modbus-vehicle", Verdict::kSkipped,
            "the daemon uses the serial line: omnihdr status tells of it");
      return;
    }
  }
  modbus::Client client(endpoint);
  const std::string name = endpoint.Name();
  const std::string where =
      endpoint.connection == modbus::Connection::kTcp
          ? fmt::format("ping -c 3 {}; check modbus.client.address and port", endpoint.address)
          : "check wiring (A, B, ground), baud, parity and unit";
  if (const Status opened = client.Open(e.options.timeout); !opened) {
    e.Problem("modbus-vehicle", fmt::format("{}: {}", name, opened.error().message), where);
    return;
  }
  const std::array<std::pair<const char*, const modbus::NumberSpec*>, 4> numbers = {{
      {"odometer", &options.odometer},
      {"speed", &options.speed},
      {"heading", &options.heading},
      {"heartbeat", &options.heartbeat},
  }};
  int read = 0;
  for (const auto& [what, spec] : numbers) {
    if (!spec->configured()) continue;
    std::vector<std::uint16_t> registers(
        static_cast<std::size_t>(modbus::RegisterCount(spec->type)));
    const Status answer = client.Read(spec->table, spec->address, registers);
    if (answer) {
      ++read;
    } else if (answer.error().kind == ErrorKind::kProtocol) {
      e.Problem("modbus-vehicle",
                fmt::format("{}: refuses {} at register {}: {}", name, what, spec->address,
                            answer.error().message),
                fmt::format("check modbus.client.{}.register and table against the vehicle's list "
                            "(addresses on the wire begin at 0)",
                            what));
      return;
    } else {
      e.Problem("modbus-vehicle", fmt::format("{}: {}", name, answer.error().message),
                where + fmt::format("; unit {} right?", endpoint.unit));
      return;
    }
  }
  e.Good("modbus-vehicle", fmt::format("{} answers, {} numbers read", name, read));
}

void CheckModbusServer(Examination& e) {
  const modbus::Endpoint& endpoint = e.config.modbus.server.endpoint;
  if (endpoint.connection == modbus::Connection::kOff) return;
  if (endpoint.connection == modbus::Connection::kRtu) {
    CheckNode(e, "modbus-server", endpoint.device, "dialout",
              "ls /dev/ttyUSB* /dev/ttyACM*; sudo dmesg | tail");
    return;
  }
  if (e.daemon_answers) {
    e.Add("modbus-server", Verdict::kSkipped,
          "the daemon has the port: omnihdr status tells of it");
    return;
  }
  if (const Result<Fd> socket = ListenTcp(endpoint.address, endpoint.port); !socket) {
    e.Problem("modbus-server", socket.error().message,
              endpoint.port < 1024
                  ? "ports below 1024 are for root: set modbus.server.port to 1502"
                  : fmt::format("sudo ss -ltnp sport = :{}   # who has it; ip addr: is {} this "
                                "machine's?",
                                endpoint.port, endpoint.address));
    return;
  }
  e.Good("modbus-server", fmt::format("{} is free", endpoint.Name()));
}

}  // namespace

void CheckLinks(Examination& e) {
  CheckGpsd(e);
  CheckModbusClient(e);
  CheckModbusServer(e);
}

}  // namespace omnihdr::doctor
