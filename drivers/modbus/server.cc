#include "drivers/modbus/server.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

#include "core/base/tcp.h"

namespace omnihdr::modbus {
namespace {

using std::chrono::milliseconds;

constexpr int kTurnMs = 200;  // longest wait for anything
constexpr auto kFirstPause = milliseconds(500);
// Requests of one client that are answered before the others' turn, and its rest when more wait.
constexpr int kRequestsAtOnce = 32;
constexpr auto kRest = milliseconds(20);
// A gap in a serial frame longer than any USB adapter makes.
constexpr auto kSerialGap = milliseconds(40);

}  // namespace

StatusServer::StatusServer(const ServerOptions& options, CommandHandler command, const Clock& clock)
    : options_(options),
      clock_(clock),
      wake_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)),
      responder_(std::move(command)),
      rtu_(static_cast<std::uint8_t>(options.endpoint.unit)) {
  responder_.Show(ApplianceStatus{});
}

StatusServer::~StatusServer() {
  if (!stage_) return;
  stage_->RequestStop();
  const std::uint64_t one = 1;
  // Not written: the thread looks for itself within kTurnMs.
  [[maybe_unused]] const ssize_t written = write(wake_.get(), &one, sizeof one);
}

Status StatusServer::Start() {
  if (stage_) return {};
  OMNIHDR_TRY(options_.Validate().Context("modbus server"));
  stage_ = std::make_unique<Stage>(
      "modbus-server", [this](std::stop_token stop, Stage& self) { return Run(stop, self); });
  return {};
}

void StatusServer::Show(const ApplianceStatus& status) {
  std::lock_guard lock(mutex_);
  status_ = status;
  shown_ = true;
}

LinkReport StatusServer::report() const {
  std::lock_guard lock(mutex_);
  return report_;
}

void StatusServer::CountError() {
  std::lock_guard lock(mutex_);
  ++report_.errors;
}

Status StatusServer::Open() {
  if (options_.endpoint.connection == Connection::kRtu) {
    OMNIHDR_ASSIGN(serial_, OpenSerial(options_.endpoint));
    rtu_.Silence();
    return {};
  }
  OMNIHDR_ASSIGN(listener_, ListenTcp(options_.endpoint.address, options_.endpoint.port));
  port_ = LocalPort(listener_.get());
  return {};
}

Status StatusServer::Run(std::stop_token stop, Stage& self) {
  const bool serial = options_.endpoint.connection == Connection::kRtu;
  Nanoseconds pause = kFirstPause;
  while (!stop.stop_requested()) {
    self.Progress();
    Status served;
    if (!(serial ? serial_ : listener_).valid()) {
      served = Open();
      if (served) {
        std::lock_guard lock(mutex_);
        report_.up = true;
        report_.problem.clear();
        ++report_.opened;
      }
    } else {
      served = serial ? ServeSerial() : ServeTcp();
    }
    if (served) {
      continue;
    }
    serial_.Close();
    listener_.Close();
    connected_.clear();
    port_ = 0;
    {
      std::lock_guard lock(mutex_);
      ++report_.errors;
      report_.up = false;
      report_.problem = served.error().message;
    }
    const HostTime until = clock_.Now() + pause;
    while (!stop.stop_requested() && clock_.Now() < until) {
      pollfd wake{wake_.get(), POLLIN, 0};
      poll(&wake, 1, kTurnMs);
    }
    pause = std::min<Nanoseconds>(pause * 2, options_.longest_pause);
  }
  return {};
}

std::size_t StatusServer::Answer(std::span<const std::uint8_t> request,
                                 std::span<std::uint8_t, kMaxPdu> answer) {
  ApplianceStatus status;
  bool news = false;
  {
    std::lock_guard lock(mutex_);
    news = std::exchange(shown_, false);
    if (news) status = status_;
  }
  if (news) responder_.Show(status);
  const std::uint64_t exceptions = responder_.counts().exceptions;
  const std::size_t length = responder_.Answer(request, answer);
  std::lock_guard lock(mutex_);
  if (responder_.counts().exceptions > exceptions) {
    ++report_.errors;
  } else {
    ++report_.messages;
  }
  return length;
}

Status StatusServer::ServeTcp() {
  const HostTime now = clock_.Now();
  std::vector<pollfd> waiting;
  waiting.push_back({wake_.get(), POLLIN, 0});
  waiting.push_back({listener_.get(), POLLIN, 0});
  int timeout = kTurnMs;
  for (const auto& client : connected_) {
    const bool rests = client->rests_until > now;
    if (rests) timeout = std::min(timeout, static_cast<int>(kRest.count()));
    waiting.push_back({rests ? -1 : client->fd.get(), POLLIN, 0});
  }
  if (poll(waiting.data(), waiting.size(), timeout) < 0 && errno != EINTR) {
    return FailErrno(ErrorKind::kSystem, "modbus server: poll", errno);
  }
  const std::size_t clients = connected_.size();
  for (std::size_t i = 0; i < clients; ++i) {
    Connected& client = *connected_[i];
    // What was read before the rest is still to be answered, whether more has come or not.
    const bool rested = waiting[i + 2].fd < 0 && client.rests_until <= clock_.Now();
    if (waiting[i + 2].revents != 0 || rested) Hear(client);
    if (clock_.Now() - client.last_heard > options_.idle) client.gone = true;
  }
  std::erase_if(connected_, [](const auto& client) { return client->gone; });
  if (waiting[1].revents != 0) Accept();
  return {};
}

void StatusServer::Accept() {
  while (true) {
    Fd fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (!fd.valid()) {
      if (errno == EMFILE || errno == ENFILE) {
        // The listener stays readable: without a pause this would spin.
        CountError();
        poll(nullptr, 0, 100);
      }
      return;
    }
    if (connected_.size() >= options_.clients) {
      CountError();
      continue;
    }
    auto client = std::make_unique<Connected>();
    client->fd = std::move(fd);
    client->last_heard = clock_.Now();
    connected_.push_back(std::move(client));
  }
}

void StatusServer::Hear(Connected& client) {
  bool read_all = false;
  for (int answered = 0; answered < kRequestsAtOnce;) {
    TcpFramer::Frame frame;
    const TcpFramer::State state = client.framer.Next(frame);
    if (state == TcpFramer::State::kBroken) {
      CountError();
      client.gone = true;
      return;
    }
    if (state == TcpFramer::State::kNeedMore) {
      if (read_all) return;
      const std::span<std::uint8_t> room = client.framer.Room();
      const ssize_t got = recv(client.fd.get(), room.data(), room.size(), 0);
      if (got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR)) {
        client.gone = true;
        return;
      }
      if (got < 0) return;
      client.framer.Filled(static_cast<std::size_t>(got));
      client.last_heard = clock_.Now();
      read_all = static_cast<std::size_t>(got) < room.size();
      continue;
    }
    std::array<std::uint8_t, kTcpHeader + kMaxPdu> answer{};
    const std::span<std::uint8_t, kMaxPdu> body(answer.data() + kTcpHeader, kMaxPdu);
    std::size_t length = 2;
    // 0 and 255 mean the device at this address itself.
    if (frame.unit == 0 || frame.unit == 0xFF || frame.unit == options_.endpoint.unit) {
      length = Answer(frame.pdu, body);
    } else {
      body[0] = static_cast<std::uint8_t>(frame.pdu[0] | 0x80);
      body[1] = static_cast<std::uint8_t>(Exception::kGatewayTarget);
      CountError();
    }
    answer[0] = static_cast<std::uint8_t>(frame.transaction >> 8);
    answer[1] = static_cast<std::uint8_t>(frame.transaction & 0xFF);
    answer[4] = static_cast<std::uint8_t>((length + 1) >> 8);
    answer[5] = static_cast<std::uint8_t>((length + 1) & 0xFF);
    answer[6] = frame.unit;
    const auto bytes = static_cast<ssize_t>(kTcpHeader + length);
    if (send(client.fd.get(), answer.data(), static_cast<std::size_t>(bytes), MSG_NOSIGNAL) !=
        bytes) {
      // It does not read what it asked for.
      CountError();
      client.gone = true;
      return;
    }
    ++answered;
  }
  client.rests_until = clock_.Now() + kRest;
}

Status StatusServer::ServeSerial() {
  std::array<pollfd, 2> waiting = {{{wake_.get(), POLLIN, 0}, {serial_.get(), POLLIN, 0}}};
  const int timeout = rtu_.empty() ? kTurnMs : static_cast<int>(kSerialGap.count());
  if (poll(waiting.data(), waiting.size(), timeout) < 0 && errno != EINTR) {
    return FailErrno(ErrorKind::kSystem, "modbus server: poll", errno);
  }
  if (!rtu_.empty() && clock_.Now() - heard_serial_ >= kSerialGap) {
    rtu_.Silence();
    CountError();
  }
  if ((waiting[1].revents & POLLIN) != 0) return HearSerial();
  if ((waiting[1].revents & (POLLERR | POLLHUP | POLLNVAL)) != 0) {
    return Fail(ErrorKind::kUnavailable, "{}: the serial device has gone",
                options_.endpoint.device);
  }
  return {};
}

Status StatusServer::HearSerial() {
  std::array<std::uint8_t, 256> bytes{};
  const ssize_t got = read(serial_.get(), bytes.data(), bytes.size());
  if (got < 0 && (errno == EAGAIN || errno == EINTR)) return {};
  if (got <= 0) {
    return FailErrno(ErrorKind::kUnavailable, options_.endpoint.device, got == 0 ? ENODEV : errno);
  }
  heard_serial_ = clock_.Now();
  const std::optional<RtuFramer::Frame> frame =
      rtu_.Take(std::span<const std::uint8_t>(bytes).first(static_cast<std::size_t>(got)));
  if (!frame) return {};
  std::array<std::uint8_t, kMaxPdu + 3> answer{};
  const std::size_t length =
      Answer(frame->pdu, std::span<std::uint8_t, kMaxPdu>(answer.data() + 1, kMaxPdu));
  if (frame->unit == 0) return {};  // a broadcast is done and not answered
  answer[0] = frame->unit;
  const std::uint16_t crc = Crc16(std::span<const std::uint8_t>(answer).first(1 + length));
  answer[1 + length] = static_cast<std::uint8_t>(crc & 0xFF);
  answer[2 + length] = static_cast<std::uint8_t>(crc >> 8);
  const auto size = static_cast<ssize_t>(length + 3);
  // The line's own buffer holds more than one answer: one that does not fit is not waited for.
  if (write(serial_.get(), answer.data(), static_cast<std::size_t>(size)) != size) {
    CountError();
    tcflush(serial_.get(), TCOFLUSH);
  }
  return {};
}

}  // namespace omnihdr::modbus
