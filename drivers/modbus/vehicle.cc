#include "drivers/modbus/vehicle.h"

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <utility>

namespace omnihdr::modbus {
namespace {

constexpr Nanoseconds kFirstPause = std::chrono::milliseconds(200);
constexpr Nanoseconds kLeastAhead = std::chrono::milliseconds(100);
constexpr double kMovingMetresPerSecond = 0.5;

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<Nanoseconds::rep>(std::llround(seconds * 1e9)));
}

Status CheckRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

OdometerCounterOptions CounterOptions(const VehicleOptions& options) {
  OdometerCounterOptions counter;
  counter.scale = options.odometer.scale;
  counter.offset = options.odometer.offset;
  counter.wrap =
      options.odometer_wrap > 0.0 ? options.odometer_wrap : Modulus(options.odometer.type);
  counter.max_speed_m_s = options.max_speed_m_s;
  counter.not_below_m = options.not_below_m;
  return counter;
}

MotionTrackOptions TrackOptions(const VehicleOptions& options) {
  MotionTrackOptions track;
  track.valid = FromSeconds(options.stale_s);
  // A reading or two may fail to come; a vehicle that is not heard of is not guessed any further.
  track.ahead = std::max(FromSeconds(2.0 * options.poll_s), kLeastAhead);
  return track;
}

void Rest(std::stop_token stop, Nanoseconds time) {
  std::mutex mutex;
  std::condition_variable_any never;
  std::unique_lock lock(mutex);
  never.wait_for(lock, stop, time, [] { return false; });
}

}  // namespace

Status VehicleOptions::Validate() const {
  OMNIHDR_TRY(endpoint.Validate());
  OMNIHDR_TRY(CheckRange("poll_s", poll_s, 0.005, 60.0));
  OMNIHDR_TRY(CheckRange("timeout_s", timeout_s, 0.01, 10.0));
  OMNIHDR_TRY(CheckRange("stale_s", stale_s, 0.05, 3600.0));
  OMNIHDR_TRY(CheckRange("reconnect_s", reconnect_s, 0.1, 3600.0));
  OMNIHDR_TRY(CheckRange("max_speed_m_s", max_speed_m_s, 0.1, 1000.0));
  OMNIHDR_TRY(CheckRange("odometer.wrap", odometer_wrap, 0.0, 1e15));
  OMNIHDR_TRY(odometer.Validate().Context("odometer"));
  OMNIHDR_TRY(speed.Validate().Context("speed"));
  OMNIHDR_TRY(heading.Validate().Context("heading"));
  OMNIHDR_TRY(heartbeat.Validate().Context("heartbeat"));
  if (!odometer.configured() && !speed.configured() && !heading.configured()) {
    return Fail(ErrorKind::kConfig, "no register of odometer, speed or heading: expected one");
  }
  return {};
}

Vehicle::Vehicle(const VehicleOptions& options, const Clock& clock)
    : options_(options),
      clock_(clock),
      client_(options.endpoint),
      odometer_{options.odometer, "odometer", 0, 0, 0.0},
      speed_{options.speed, "speed", 0, 0, 0.0},
      heading_{options.heading, "heading", 0, 0, 0.0},
      heartbeat_{options.heartbeat, "heartbeat", 0, 0, 0.0},
      counter_(CounterOptions(options)),
      track_(TrackOptions(options)) {
  // Numbers that lie side by side are read at once: they belong to one moment, and a serial line
  // has time for few requests. Gaps are not read over, since a device may refuse them.
  std::vector<Number*> numbers;
  for (Number* number : {&odometer_, &speed_, &heading_, &heartbeat_}) {
    if (number->spec.configured()) numbers.push_back(number);
  }
  std::sort(numbers.begin(), numbers.end(), [](const Number* a, const Number* b) {
    return std::pair(a->spec.table, a->spec.address) < std::pair(b->spec.table, b->spec.address);
  });
  for (Number* number : numbers) {
    const int end = number->spec.address + RegisterCount(number->spec.type);
    const bool joins =
        !blocks_.empty() && blocks_.back().table == number->spec.table &&
        number->spec.address <=
            blocks_.back().address + static_cast<int>(blocks_.back().registers.size());
    if (!joins) blocks_.push_back({number->spec.table, number->spec.address, {}});
    Block& block = blocks_.back();
    const auto needed = static_cast<std::size_t>(end - block.address);
    block.registers.resize(std::max(block.registers.size(), needed));
    number->block = blocks_.size() - 1;
    number->offset = static_cast<std::size_t>(number->spec.address - block.address);
  }
}

Vehicle::~Vehicle() {
  if (stage_) stage_->RequestStop();
}

Status Vehicle::Start() {
  if (stage_) return {};
  OMNIHDR_TRY(options_.Validate().Context("modbus client"));
  stage_ = std::make_unique<Stage>(
      "modbus-vehicle", [this](std::stop_token stop, Stage& self) { return Run(stop, self); });
  return {};
}

double Vehicle::Value(const Number& number) const {
  return number.raw * number.spec.scale + number.spec.offset;
}

Status Vehicle::Poll() {
  const HostTime before = clock_.Now();
  for (Block& block : blocks_) {
    OMNIHDR_TRY(client_.Read(block.table, block.address, block.registers));
  }
  const HostTime after = clock_.Now();
  for (Number* number : {&odometer_, &speed_, &heading_, &heartbeat_}) {
    if (!number->spec.configured()) continue;
    const std::span<const std::uint16_t> registers =
        std::span<const std::uint16_t>(blocks_[number->block].registers)
            .subspan(number->offset, static_cast<std::size_t>(RegisterCount(number->spec.type)));
    number->raw = DecodeRaw(registers, number->spec.type, number->spec.word_order);
    if (!std::isfinite(number->raw)) {
      return Fail(ErrorKind::kProtocol, "{} in {} register {}: {}: expected a finite number",
                  number->name, ToString(number->spec.table), number->spec.address, number->raw);
    }
  }
  return Take(before + (after - before) / 2);
}

Status Vehicle::Take(HostTime time) {
  const Nanoseconds stale = FromSeconds(options_.stale_s);
  if (heartbeat_.spec.configured()) {
    if (last_heartbeat_ != heartbeat_.raw) heartbeat_since_ = time;
    last_heartbeat_ = heartbeat_.raw;
    if (time - heartbeat_since_ >= stale) {
      return Fail(ErrorKind::kProtocol,
                  "heartbeat in {} register {}: {} for more than {} s: its data are stale",
                  ToString(heartbeat_.spec.table), heartbeat_.spec.address, heartbeat_.raw,
                  options_.stale_s);
    }
  }
  if (odometer_.spec.configured() && speed_.spec.configured()) {
    const bool moved = last_raw_ != odometer_.raw;
    if (moved || !(std::abs(Value(speed_)) > kMovingMetresPerSecond)) moved_at_ = time;
    if (time - moved_at_ >= stale) {
      return Fail(ErrorKind::kProtocol,
                  "odometer in {} register {}: {} for more than {} s at a speed of {:.1f} m/s: it "
                  "is stale",
                  ToString(odometer_.spec.table), odometer_.spec.address, odometer_.raw,
                  options_.stale_s, Value(speed_));
    }
  }
  {
    std::lock_guard lock(mutex_);
    if (odometer_.spec.configured()) {
      const double metres = counter_.Update(time, odometer_.raw);
      track_.Add(time, metres,
                 speed_.spec.configured() ? std::optional(Value(speed_)) : std::nullopt);
      if (counter_.resets() != resets_) {
        // What was before has nothing to do with what comes.
        resets_ = counter_.resets();
        track_.Clear();
        track_.Add(time, metres);
      }
    }
    if (speed_.spec.configured()) speed_m_s_ = Value(speed_);
    if (heading_.spec.configured()) {
      const double turned = std::fmod(Value(heading_), 360.0);
      heading_deg_ = turned < 0.0 ? turned + 360.0 : turned;
      if (*heading_deg_ >= 360.0) heading_deg_ = 0.0;
    }
    newest_ = time;
    ++report_.messages;
    report_.up = true;
    report_.problem.clear();
    report_.lost = resets_;
  }
  last_raw_ = odometer_.raw;
  std::lock_guard lock(listener_mutex_);
  if (listener_) listener_();
  return {};
}

Status Vehicle::Run(std::stop_token stop, Stage& self) {
  const Nanoseconds timeout = FromSeconds(options_.timeout_s);
  const Nanoseconds interval = FromSeconds(options_.poll_s);
  const Nanoseconds longest_pause = FromSeconds(options_.reconnect_s);
  Nanoseconds pause = kFirstPause;
  HostTime next = clock_.Now();
  while (!stop.stop_requested()) {
    self.Progress();
    Status polled = client_.open() ? Status{} : client_.Open(timeout);
    if (polled) {
      bool fresh = false;
      {
        std::lock_guard lock(mutex_);
        fresh = !report_.up;
      }
      polled = Poll();
      if (polled && fresh) {
        std::lock_guard lock(mutex_);
        ++report_.opened;
      }
    }
    if (polled) {
      pause = kFirstPause;
      next = std::max(next + interval, clock_.Now());
      Rest(stop, next - clock_.Now());
      continue;
    }
    if (polled.error().kind != ErrorKind::kProtocol) client_.Close();
    {
      std::lock_guard lock(mutex_);
      ++report_.errors;
      report_.up = false;
      report_.problem = fmt::format("{}: {}", options_.endpoint.Name(), polled.error().message);
    }
    // The first try again comes soon: most time-outs are a single lost answer.
    Rest(stop, std::min(pause, longest_pause));
    pause = std::min(pause * 2, longest_pause);
    next = clock_.Now();
  }
  client_.Close();
  return {};
}

LinkReport Vehicle::report() const {
  std::lock_guard lock(mutex_);
  LinkReport report = report_;
  if (report.problem.empty() && !report.up) report.problem = "connecting";
  return report;
}

std::optional<double> Vehicle::OdometerMetres(HostTime at) const {
  std::lock_guard lock(mutex_);
  return track_.At(at);
}

std::optional<HostTime> Vehicle::TimeAt(double odometer_m) const {
  std::lock_guard lock(mutex_);
  return track_.TimeAt(odometer_m);
}

void Vehicle::Listen(std::function<void()> listener) {
  std::lock_guard lock(listener_mutex_);
  listener_ = std::move(listener);
}

std::uint64_t Vehicle::lost() const {
  std::lock_guard lock(mutex_);
  return resets_;
}

std::optional<double> Vehicle::HeadingDeg(HostTime at) const {
  std::lock_guard lock(mutex_);
  if (!heading_deg_ || at - newest_ >= FromSeconds(options_.stale_s)) return std::nullopt;
  return heading_deg_;
}

std::optional<double> Vehicle::SpeedMetresPerSecond(HostTime at) const {
  std::lock_guard lock(mutex_);
  if (!speed_m_s_ || at - newest_ >= FromSeconds(options_.stale_s)) return std::nullopt;
  return speed_m_s_;
}

}  // namespace omnihdr::modbus
