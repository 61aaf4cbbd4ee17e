#include "tests/emulators/vhci_usb.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <list>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/base/file.h"

namespace omnihdr::emulators {
namespace {

using Answer = DeviceAnswer;

constexpr const char* kAttach = "/sys/devices/platform/vhci_hcd.0/attach";
// Bus 1, device 2 and on of the machine the device is said to come from.
constexpr int kFirstDeviceId = 0x10002;
constexpr int kHighSpeed = 3;

// A message of USB/IP (Documentation/usb/usbip_protocol.rst of the kernel): twelve words, the most
// significant byte first. Words 0 to 4 are command, number, device, direction (1 = in), endpoint.
constexpr std::size_t kWords = 12;
using Message = std::array<std::uint32_t, kWords>;
enum Command : std::uint32_t { kSubmit = 1, kUnlink = 2, kSubmitted = 3, kUnlinked = 4 };
constexpr std::size_t kCommandAt = 0;
constexpr std::size_t kNumberAt = 1;
constexpr std::size_t kInAt = 3;
constexpr std::size_t kEndpointAt = 4;
constexpr std::size_t kStatusAt = 5;  // of an answer
constexpr std::size_t kUnlinkAt = 5;  // the number of the one to be unlinked
constexpr std::size_t kLengthAt = 6;  // of the buffer; in an answer, what was moved
constexpr std::size_t kSetupAt = 10;  // the eight bytes of the setup packet as they are
constexpr std::uint32_t kLargest = 16U << 20;

bool ReceiveAll(int fd, void* data, std::size_t bytes) {
  return bytes == 0 || ::recv(fd, data, bytes, MSG_WAITALL) == static_cast<ssize_t>(bytes);
}

bool SendAll(int fd, const void* data, std::size_t bytes) {
  const char* at = static_cast<const char*>(data);
  while (bytes > 0) {
    const ssize_t sent = ::send(fd, at, bytes, MSG_NOSIGNAL);
    if (sent <= 0) return false;
    at += sent;
    bytes -= static_cast<std::size_t>(sent);
  }
  return true;
}

struct Urb {
  std::uint32_t number = 0;
  bool stream = false;  // else a request that is never answered
  std::vector<std::byte> buffer;
  std::size_t filled = 0;
};

int StatusOf(Answer answer) {
  switch (answer) {
    case Answer::kOk:
    case Answer::kNak:
      return 0;
    case Answer::kStall:
      return -EPIPE;
    case Answer::kGone:
      break;
  }
  return -ESHUTDOWN;
}

}  // namespace

struct VhciUsb::Impl {
  Impl(std::shared_ptr<UsbFunction> function_in, int port_in)
      : function(std::move(function_in)), port(port_in) {}

  bool Attach() {
    int ends[2] = {-1, -1};
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) return false;
    socket = Fd(ends[0]);
    const Fd kernels(ends[1]);
    const std::string text =
        fmt::format("{} {} {} {}", port, kernels.get(), kFirstDeviceId + port, kHighSpeed);
    // The port is in use until the kernel has done with the device that was there before.
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    const auto size = static_cast<ssize_t>(text.size());
    while (true) {
      const Fd attach(::open(kAttach, O_WRONLY | O_CLOEXEC));
      if (attach.get() < 0) return false;
      if (::write(attach.get(), text.data(), text.size()) == size) break;
      if (errno != EBUSY || std::chrono::steady_clock::now() > deadline) return false;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    urbs.clear();
    worker = std::thread([this] { Serve(); });
    return true;
  }

  void Detach() {
    if (!worker.joinable()) return;
    ::shutdown(socket.get(), SHUT_RDWR);
    worker.join();
    socket = Fd();
  }

  void Serve() {
    while (true) {
      pollfd ready{socket.get(), POLLIN, 0};
      const bool waiting = std::any_of(urbs.begin(), urbs.end(), [](auto& u) { return u.stream; });
      if (::poll(&ready, 1, waiting ? 1 : -1) < 0 && errno != EINTR) return;
      if (ready.revents != 0 && !Hear()) return;
      if (!PumpStream()) return;
    }
  }

  bool Hear() {
    std::array<std::uint8_t, 4 * kWords> raw;
    if (!ReceiveAll(socket.get(), raw.data(), raw.size())) return false;
    Message message;
    for (std::size_t i = 0; i < kWords; ++i) {
      message[i] = std::uint32_t{raw[4 * i]} << 24 | std::uint32_t{raw[4 * i + 1]} << 16 |
                   std::uint32_t{raw[4 * i + 2]} << 8 | raw[4 * i + 3];
    }
    if (message[kCommandAt] == kUnlink) return Unlink(message);
    if (message[kCommandAt] != kSubmit || message[kLengthAt] > kLargest) return false;
    const std::size_t length = message[kLengthAt];
    const bool in = message[kInAt] == 1;
    std::vector<std::uint8_t> data(in ? 0 : length);
    if (!ReceiveAll(socket.get(), data.data(), data.size())) return false;
    if (message[kEndpointAt] == (function->stream_endpoint() & 0x0FU) && in) {
      urbs.push_back({message[kNumberAt], true, std::vector<std::byte>(length), 0});
      return true;
    }
    if (message[kEndpointAt] != 0) return Reply(message[kNumberAt], -EPIPE, 0, nullptr, 0);
    UsbFunction::Setup setup;
    std::copy_n(raw.begin() + 4 * kSetupAt, setup.size(), setup.begin());
    const Answer answer = function->Control(setup, data);
    if (answer == Answer::kNak) {
      urbs.push_back({message[kNumberAt], false, {}, 0});
      return true;
    }
    if (answer != Answer::kOk) return Reply(message[kNumberAt], StatusOf(answer), 0, nullptr, 0);
    if (!in) return Reply(message[kNumberAt], 0, length, nullptr, 0);
    data.resize(std::min(data.size(), length));
    return Reply(message[kNumberAt], 0, data.size(), data.data(), data.size());
  }

  bool Unlink(const Message& message) {
    const auto found = std::find_if(
        urbs.begin(), urbs.end(), [&](const Urb& urb) { return urb.number == message[kUnlinkAt]; });
    const bool pending = found != urbs.end();
    if (pending) urbs.erase(found);
    // 0: its answer is on the way already.
    return Send(kUnlinked, message[kNumberAt], pending ? -ECONNRESET : 0, 0);
  }

  // Gives the oldest transfers of the stream what the device has.
  bool PumpStream() {
    for (auto urb = urbs.begin(); urb != urbs.end();) {
      if (!urb->stream) {
        ++urb;
        continue;
      }
      const DeviceMoved moved = function->ReadStream(std::span(urb->buffer).subspan(urb->filled));
      urb->filled += moved.bytes;
      if (!moved.ended) return true;
      if (!Reply(urb->number, StatusOf(moved.answer), urb->filled, urb->buffer.data(), urb->filled))
        return false;
      urb = urbs.erase(urb);
    }
    return true;
  }

  bool Reply(std::uint32_t number, int status, std::size_t moved, const void* data,
             std::size_t bytes) {
    return Send(kSubmitted, number, status, moved) && SendAll(socket.get(), data, bytes);
  }

  bool Send(Command command, std::uint32_t number, int status, std::size_t moved) {
    Message message{};
    message[kCommandAt] = command;
    message[kNumberAt] = number;
    message[kStatusAt] = static_cast<std::uint32_t>(status);
    message[kLengthAt] = static_cast<std::uint32_t>(moved);
    std::array<std::uint8_t, 4 * kWords> raw;
    for (std::size_t i = 0; i < raw.size(); ++i) {
      raw[i] = static_cast<std::uint8_t>(message[i / 4] >> (24 - 8 * (i % 4)) & 0xFF);
    }
    return SendAll(socket.get(), raw.data(), raw.size());
  }

  void PlugIn() {
    if (Attach()) return;
    fmt::print(stderr, "vhci_hcd: attach: {}\n", std::strerror(errno));
    std::abort();
  }

  const std::shared_ptr<UsbFunction> function;
  const int port;
  Fd socket;
  std::list<Urb> urbs;  // the worker's own
  std::thread worker;
};

VhciUsb::VhciUsb(std::shared_ptr<UsbFunction> function, int port)
    : impl_(std::make_unique<Impl>(std::move(function), port)) {
  impl_->PlugIn();
}

VhciUsb::~VhciUsb() { impl_->Detach(); }

void VhciUsb::Unplug() {
  impl_->function->Unplug();
  impl_->Detach();
}

void VhciUsb::PlugIn() {
  impl_->function->PlugIn();
  impl_->PlugIn();
}

}  // namespace omnihdr::emulators
