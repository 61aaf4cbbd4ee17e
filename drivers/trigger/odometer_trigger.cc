#include "drivers/trigger/odometer_trigger.h"

#include <fmt/format.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <utility>

namespace omnihdr {
namespace {

// Marks beyond which an odometer that jumps is not followed one by one.
constexpr std::int64_t kMostMarksAtOnce = 1024;
// A mark k · d may be rounded up beyond the pulse that lies on it; it must not wait for the next
// one.
constexpr double kRoundingM = 1e-6;

}  // namespace

Status OdometerTriggerOptions::Validate() const {
  if (distance_m >= 0.001 && distance_m <= 10000.0) return {};
  return Fail(ErrorKind::kConfig, "distance_m: {}: expected 0.001 to 10000", distance_m);
}

OdometerTrigger::OdometerTrigger(const OdometerTriggerOptions& options,
                                 std::shared_ptr<Odometer> odometer, const Clock& clock)
    : options_(options), odometer_(std::move(odometer)), clock_(clock) {}

OdometerTrigger::~OdometerTrigger() { Stop(); }

Status OdometerTrigger::Start() {
  OMNIHDR_TRY(options_.Validate());
  if (fd_.valid()) return {};
  Fd fd(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, "distance trigger: eventfd", errno);
  fd_ = std::move(fd);
  odometer_->Listen([descriptor = fd_.get()] {
    const std::uint64_t one = 1;
    // Full means that it is readable already.
    [[maybe_unused]] const ssize_t written = write(descriptor, &one, sizeof one);
  });
  Synchronise();
  return {};
}

void OdometerTrigger::Stop() {
  if (!fd_.valid()) return;
  odometer_->Listen({});
  fd_.Close();
  counting_since_.reset();
}

Status OdometerTrigger::SetDistance(double distance_m) {
  OdometerTriggerOptions options = options_;
  options.distance_m = distance_m;
  OMNIHDR_TRY(options.Validate());
  options_ = options;
  // Marks of the old distance have no numbers in the new one.
  counted_before_ = false;
  counting_since_.reset();
  if (fd_.valid()) Synchronise();
  return {};
}

void OdometerTrigger::Synchronise() {
  const HostTime now = clock_.Now();
  const std::optional<double> reading = odometer_->OdometerMetres(now);
  if (!reading || !(std::abs(*reading / options_.distance_m) < 9e15)) return;
  const auto mark = static_cast<std::int64_t>(std::ceil(*reading / options_.distance_m - 1e-9));
  standing_.reset();
  if (*reading >= static_cast<double>(mark) * options_.distance_m - kRoundingM) standing_ = mark;
  next_ = counted_before_ ? std::max(next_, mark) : mark;
  counted_before_ = true;
  counting_since_ = now;
  odometer_lost_ = odometer_->lost();
}

Result<std::optional<TriggerEvent>> OdometerTrigger::Poll() {
  if (!fd_.valid()) return std::nullopt;
  std::uint64_t news = 0;
  if (read(fd_.get(), &news, sizeof news) < 0 && errno != EAGAIN && errno != EINTR) {
    return FailErrno(ErrorKind::kSystem, "distance trigger: read", errno);
  }
  if (!counting_since_) Synchronise();
  if (!counting_since_) return std::nullopt;

  const HostTime now = clock_.Now();
  const std::uint64_t late = SkipLate(now);
  const std::optional<HostTime> passed = odometer_->TimeAt(NextMark() - kRoundingM);
  if (!passed || *passed > now) {
    // Marks that were lost wait for the event that tells of them: none of their own can be made.
    next_ -= static_cast<std::int64_t>(late);
    return std::nullopt;
  }
  TriggerEvent event;
  event.time = std::max(*passed, *counting_since_);
  event.odometer_m = NextMark();
  event.lost_before = late;
  if (late > 0) event.lost_reason = LateReason();
  event.standing = standing_ == next_;
  ++next_;
  return event;
}

std::uint64_t OdometerTrigger::SkipLate(HostTime now) {
  std::uint64_t late = 0;
  if (const std::optional<double> reading = odometer_->OdometerMetres(now)) {
    const double reached = *reading / options_.distance_m - static_cast<double>(kMostMarksAtOnce);
    if (reached > static_cast<double>(next_) && reached < 9e15) {
      const auto skip = static_cast<std::int64_t>(reached) - next_;
      late += static_cast<std::uint64_t>(skip);
      next_ += skip;
    }
  }
  for (std::int64_t i = 0; i <= kMostMarksAtOnce + 1; ++i) {
    const std::optional<HostTime> passed = odometer_->TimeAt(NextMark() - kRoundingM);
    if (!passed || now - std::max(*passed, *counting_since_) <= options_.max_late) break;
    ++late;
    ++next_;
  }
  return late;
}

std::string OdometerTrigger::LateReason() {
  const std::uint64_t missing = odometer_->lost() - odometer_lost_;
  odometer_lost_ += missing;
  return fmt::format(
      "the odometer told of this mark more than {} ms after it was passed{}",
      std::chrono::duration_cast<std::chrono::milliseconds>(options_.max_late).count(),
      missing > 0 ? fmt::format(" (readings lost: {})", missing) : "");
}

LostEvents OdometerTrigger::TakeLost() {
  if (!fd_.valid() || !counting_since_) return {};
  const std::uint64_t late = SkipLate(clock_.Now());
  return {late, late > 0 ? LateReason() : ""};
}

std::optional<HostTime> OdometerTrigger::NextDeadline() const {
  if (!fd_.valid() || !counting_since_) return std::nullopt;
  const std::optional<HostTime> passed = odometer_->TimeAt(NextMark() - kRoundingM);
  // What has been passed is told of by the descriptor or by the next mark.
  if (!passed || *passed <= clock_.Now()) return std::nullopt;
  return passed;
}

}  // namespace omnihdr
