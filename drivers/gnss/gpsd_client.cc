#include "drivers/gnss/gpsd_client.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <utility>

#include "core/base/tcp.h"

namespace omnihdr::gnss {
namespace {

constexpr int kTurnMs = 200;
constexpr Nanoseconds kFirstPause = std::chrono::milliseconds(200);
// Ten a second for three seconds, some of them in several parts.
constexpr std::size_t kReportsKept = 64;
constexpr double kMovingMetresPerSecond = 1.0;
constexpr std::string_view kWatch =
    "?WATCH={\"enable\":true,\"json\":true,\"scaled\":true,\"pps\":true};\n";

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<Nanoseconds::rep>(std::llround(seconds * 1e9)));
}

Status CheckRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

}  // namespace

Status GpsdOptions::Validate() const {
  if (!IsNumericAddress(address)) {
    return Fail(ErrorKind::kConfig, "address: \"{}\": expected a numeric IPv4 or IPv6 address",
                address);
  }
  if (port < 1 || port > 65535) {
    return Fail(ErrorKind::kConfig, "port: {}: expected 1 to 65535", port);
  }
  OMNIHDR_TRY(CheckRange("max_age_s", max_age_s, 0.1, 60.0));
  OMNIHDR_TRY(CheckRange("timeout_s", timeout_s, 0.1, 60.0));
  OMNIHDR_TRY(CheckRange("silent_s", silent_s, 0.2, 3600.0));
  return CheckRange("reconnect_s", reconnect_s, 0.1, 3600.0);
}

GpsdClient::GpsdClient(const GpsdOptions& options, const Clock& clock)
    : options_(options), clock_(clock), wake_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {}

GpsdClient::~GpsdClient() {
  if (!stage_) return;
  stage_->RequestStop();
  const std::uint64_t one = 1;
  // Not written: the thread looks for itself within kTurnMs.
  [[maybe_unused]] const ssize_t written = write(wake_.get(), &one, sizeof one);
}

Status GpsdClient::Start() {
  if (stage_) return {};
  OMNIHDR_TRY(options_.Validate().Context("gnss"));
  stage_ = std::make_unique<Stage>(
      "gnss", [this](std::stop_token stop, Stage& self) { return Run(stop, self); });
  return {};
}

LinkReport GpsdClient::report() const {
  std::lock_guard lock(mutex_);
  LinkReport report = report_;
  if (!report.up && report.problem.empty()) report.problem = "connecting";
  return report;
}

void GpsdClient::Take(Report report, HostTime now) {
  std::lock_guard lock(mutex_);
  ++report_.messages;
  report_.up = true;
  report_.problem.clear();
  known_.push_back({now, std::move(report)});
  if (known_.size() > kReportsKept) known_.pop_front();
}

// With the lock held.
const GpsdClient::Known* GpsdClient::At(HostTime at) const {
  for (auto it = known_.rbegin(); it != known_.rend(); ++it) {
    if (it->received > at) continue;
    return at - it->received <= FromSeconds(options_.max_age_s) ? &*it : nullptr;
  }
  return nullptr;
}

std::optional<GnssFix> GpsdClient::Fix(HostTime at) const {
  std::lock_guard lock(mutex_);
  const Known* known = At(at);
  if (known == nullptr || !known->report.fix) return std::nullopt;
  GnssFix fix = *known->report.fix;
  fix.age_s = static_cast<double>((at - known->received).count()) * 1e-9;
  return fix;
}

std::optional<double> GpsdClient::HeadingDeg(HostTime at) const {
  if (!options_.track_heading) return std::nullopt;
  std::lock_guard lock(mutex_);
  const Known* known = At(at);
  if (known == nullptr || !known->report.track_deg ||
      !(known->report.speed_m_s.value_or(0.0) >= kMovingMetresPerSecond)) {
    return std::nullopt;
  }
  const double turned = std::fmod(*known->report.track_deg, 360.0);
  return turned < 0.0 ? turned + 360.0 : turned;
}

// Connects and takes reports until something is wrong, which is what it gives.
Status GpsdClient::Listen(std::stop_token stop, Stage& self) {
  OMNIHDR_ASSIGN(socket_,
                 ConnectTcp(options_.address, options_.port, FromSeconds(options_.timeout_s)));
  const auto asked = static_cast<ssize_t>(kWatch.size());
  if (send(socket_.get(), kWatch.data(), kWatch.size(), MSG_NOSIGNAL) != asked) {
    return FailErrno(ErrorKind::kUnavailable, "ask for reports", errno);
  }
  {
    std::lock_guard lock(mutex_);
    ++report_.opened;
  }
  ReportParser parser;
  LineCutter lines;
  std::uint64_t errors = 0;
  HostTime heard = clock_.Now();
  while (!stop.stop_requested()) {
    self.Progress();
    std::array<pollfd, 2> waiting = {{{wake_.get(), POLLIN, 0}, {socket_.get(), POLLIN, 0}}};
    if (poll(waiting.data(), waiting.size(), kTurnMs) < 0 && errno != EINTR) {
      return FailErrno(ErrorKind::kSystem, "poll", errno);
    }
    if (clock_.Now() - heard >= FromSeconds(options_.silent_s)) {
      return Fail(ErrorKind::kTemporary, "{} for {} s: is a receiver connected to gpsd?",
                  parser.greeted() ? "gpsd tells of no position" : "it is silent, or no gpsd,",
                  options_.silent_s);
    }
    if (waiting[1].revents == 0) continue;
    std::array<char, 4096> bytes{};
    const ssize_t got = recv(socket_.get(), bytes.data(), bytes.size(), 0);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) continue;
    if (got < 0) return FailErrno(ErrorKind::kUnavailable, "receive", errno);
    if (got == 0) return Fail(ErrorKind::kUnavailable, "gpsd has hung up");
    lines.Add({bytes.data(), static_cast<std::size_t>(got)});
    while (const std::optional<std::string> line = lines.Next()) {
      const HostTime now = clock_.Now();
      if (std::optional<Report> report = parser.Parse(*line, now)) {
        heard = now;
        Take(std::move(*report), now);
      }
    }
    if (const std::uint64_t all = parser.errors() + lines.too_long(); all > errors) {
      std::lock_guard lock(mutex_);
      report_.errors += all - errors;
      errors = all;
    }
  }
  return {};
}

Status GpsdClient::Run(std::stop_token stop, Stage& self) {
  const Nanoseconds longest = FromSeconds(options_.reconnect_s);
  Nanoseconds pause = kFirstPause;
  while (!stop.stop_requested()) {
    self.Progress();
    const std::uint64_t before = report().messages;
    const Status listened = Listen(stop, self);
    socket_.Close();
    if (listened) continue;  // told to stop
    if (report().messages > before) pause = kFirstPause;
    {
      std::lock_guard lock(mutex_);
      ++report_.errors;
      report_.up = false;
      report_.problem =
          fmt::format("gpsd {}:{}: {}", options_.address, options_.port, listened.error().message);
    }
    const HostTime until = clock_.Now() + std::min(pause, longest);
    while (!stop.stop_requested() && clock_.Now() < until) {
      pollfd wake{wake_.get(), POLLIN, 0};
      const Nanoseconds left = until - clock_.Now();
      poll(&wake, 1,
           static_cast<int>(std::clamp<std::int64_t>(left.count() / 1'000'000 + 1, 1, kTurnMs)));
    }
    pause = std::min(pause * 2, longest);
  }
  return {};
}

}  // namespace omnihdr::gnss
