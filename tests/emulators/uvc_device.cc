#include "tests/emulators/uvc_device.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace omnihdr::emulators {
namespace {

// Requests of the class.
enum Code : std::uint8_t {
  kSetCur = 0x01,
  kGetCur = 0x81,
  kGetMin = 0x82,
  kGetMax = 0x83,
  kGetRes = 0x84,
  kGetLen = 0x85,
  kGetInfo = 0x86,
  kGetDef = 0x87,
};
// What the control VC_REQUEST_ERROR_CODE tells of the request before.
enum Error : std::uint8_t {
  kNone = 0,
  kWrongState = 2,
  kOutOfRange = 4,
  kInvalidUnit = 5,
  kInvalidControl = 6,
  kInvalidRequest = 7,
};
constexpr std::uint8_t kErrorCodeControl = 2;
constexpr std::uint8_t kProbeControl = 1;
constexpr std::uint8_t kCommitControl = 2;
constexpr std::size_t kProbeBytes = 34;
constexpr std::size_t kHeaderBytes = 12;
enum HeaderBit : std::uint8_t {
  kFrameId = 0x01,
  kEndOfFrame = 0x02,
  kHasTime = 0x04,
  kHasClock = 0x08,
  kErrorBit = 0x40,
  kEndOfHeader = 0x80,
};
constexpr std::uint32_t kManual = 1;
constexpr std::uint32_t kAperturePriority = 8;
constexpr std::uint32_t kDaylight = 6500;  // kelvin
constexpr std::uint32_t kNeutral = 4600;
constexpr std::size_t kMaxWaiting = 1;  // frames

void Put(std::span<std::uint8_t> to, std::size_t at, std::uint32_t value, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; ++i) {
    to[at + i] = static_cast<std::uint8_t>(value >> (8 * i) & 0xFF);
  }
}

std::uint32_t Get(std::span<const std::uint8_t> from, std::size_t at, std::size_t bytes) {
  std::uint32_t value = 0;
  for (std::size_t i = bytes; i-- > 0;) value = value << 8 | from[at + i];
  return value;
}

std::uint32_t Units(double seconds) {
  return static_cast<std::uint32_t>(std::lround(seconds * 1e7));
}

}  // namespace

UvcDevice::UvcDevice(UvcDeviceOptions options, const Clock& clock)
    : options_(std::move(options)), clock_(clock), latency_(options_.latency_frames) {
  PowerUp();
}

// As cameras come: everything automatic.
void UvcDevice::PowerUp() {
  controls_.clear();
  const auto add = [this](std::uint8_t entity, std::uint8_t selector, std::size_t bytes,
                          std::uint32_t least, std::uint32_t most, std::uint32_t step,
                          std::uint32_t initial) {
    controls_[{entity, selector}] = {bytes, least, most, step, initial, initial};
  };
  // The resolution of this one is the set of its modes.
  add(kCameraTerminal, kAutoMode, 1, 0, 0xFF, kManual | kAperturePriority, kAperturePriority);
  add(kCameraTerminal, kAutoPriority, 1, 0, 1, 1, 1);
  add(kCameraTerminal, kExposure, 4, options_.shortest_units, options_.longest_units, 1, 100);
  add(kProcessingUnit, kBacklight, 2, 0, 2, 1, 1);
  add(kProcessingUnit, kGain, 2, 0, 255, 1, options_.unity_gain);
  add(kProcessingUnit, kPowerLine, 1, 0, 2, 1, 1);
  add(kProcessingUnit, kTemperature, 2, 2800, 6500, 10, kNeutral);
  add(kProcessingUnit, kAutoTemperature, 1, 0, 1, 1, 1);
  writes_.clear();
  last_error_ = kNone;
  probe_ = {kGrey, Units(options_.interval_s)};
  commit_ = probe_;
  streaming_ = false;
  sending_.clear();
  power_up_ = clock_.Now();
}

DeviceAnswer UvcDevice::Fail(std::uint8_t error) {
  last_error_ = error;
  return DeviceAnswer::kStall;
}

std::uint32_t UvcDevice::Value(std::uint8_t entity, std::uint8_t selector) const {
  return controls_.at({entity, selector}).now;
}

UvcDevice::Setting UvcDevice::SettingNow() const {
  Setting setting;
  // In automatic mode it is what the default scene needs, whatever was written.
  const bool manual = Value(kCameraTerminal, kAutoMode) == kManual;
  setting.seconds = manual ? 1e-4 * Value(kCameraTerminal, kExposure) : 0.02;
  setting.gain = static_cast<double>(Value(kProcessingUnit, kGain)) / options_.unity_gain;
  const bool automatic = Value(kProcessingUnit, kAutoTemperature) != 0;
  setting.kelvin = automatic ? kDaylight : Value(kProcessingUnit, kTemperature);
  return setting;
}

DeviceAnswer UvcDevice::Handle(const Request& request, std::vector<std::uint8_t>& data) {
  std::lock_guard lock(mutex_);
  if (!plugged_in_) return DeviceAnswer::kGone;
  if (request.interface == kStreamInterface) return HandleStream(request, data);
  if (request.entity == 0) {
    if (request.selector != kErrorCodeControl || request.code != kGetCur) {
      return Fail(kInvalidControl);
    }
    data = {last_error_};
    return DeviceAnswer::kOk;
  }
  if (faults_.stall_controls > 0) {
    --faults_.stall_controls;
    return Fail(kWrongState);
  }
  return HandleControl(request, data);
}

DeviceAnswer UvcDevice::HandleControl(const Request& request, std::vector<std::uint8_t>& data) {
  constexpr std::uint8_t kReadWrite = 0x03;
  constexpr std::uint8_t kAutoupdate = 0x08;
  const auto found = controls_.find({request.entity, request.selector});
  if (found == controls_.end()) {
    return Fail(request.entity == kCameraTerminal || request.entity == kProcessingUnit
                    ? kInvalidControl
                    : kInvalidUnit);
  }
  Control& control = found->second;
  std::uint32_t value = 0;
  switch (request.code) {
    case kSetCur:
      if (data.size() != control.bytes) return Fail(kInvalidRequest);
      return Write(found->first, control, Get(data, 0, control.bytes));
    case kGetCur:
      value = control.now;
      break;
    case kGetMin:
      value = control.least;
      break;
    case kGetMax:
      value = control.most;
      break;
    case kGetRes:
      value = control.step;
      break;
    case kGetDef:
      value = control.initial;
      break;
    case kGetLen:
      data = {static_cast<std::uint8_t>(control.bytes), 0};
      return DeviceAnswer::kOk;
    case kGetInfo:
      data = {
          static_cast<std::uint8_t>(kReadWrite | (options_.controls_autoupdate ? kAutoupdate : 0))};
      return DeviceAnswer::kOk;
    default:
      return Fail(kInvalidRequest);
  }
  data.assign(control.bytes, 0);
  Put(data, 0, value, control.bytes);
  return DeviceAnswer::kOk;
}

DeviceAnswer UvcDevice::Write(const Key& key, Control& control, std::uint32_t value) {
  const Key mode{kCameraTerminal, kAutoMode};
  const bool fits = key == mode ? value == kManual || value == kAperturePriority
                                : value >= control.least && value <= control.most;
  if (!fits) return Fail(kOutOfRange);
  if ((key == Key{kCameraTerminal, kExposure} && controls_.at(mode).now != kManual) ||
      (key == Key{kProcessingUnit, kTemperature} &&
       Value(kProcessingUnit, kAutoTemperature) != 0)) {
    return Fail(kWrongState);
  }
  writes_.push_back(key);
  if (key == Key{kCameraTerminal, kExposure}) {
    if (faults_.ignores_exposure) return DeviceAnswer::kOk;
    value = std::max(value / options_.coarse_units * options_.coarse_units, control.least);
  }
  control.now = value;
  const HostTime now = clock_.Now();
  Advance(now);
  Setting setting = SettingNow();
  setting.from = FrameBeingExposed(now) + static_cast<std::uint64_t>(latency_);
  // Every setting of a camera at rest acts on its first frame.
  if (!streaming_) settings_.clear();
  settings_.push_back(setting);
  return DeviceAnswer::kOk;
}

DeviceAnswer UvcDevice::HandleStream(const Request& request, std::vector<std::uint8_t>& data) {
  if (request.selector != kProbeControl && request.selector != kCommitControl) {
    return Fail(kInvalidControl);
  }
  if (request.code == kGetLen) {
    data = {kProbeBytes, 0};
    return DeviceAnswer::kOk;
  }
  if (request.code == kGetInfo) {
    data = {0x03};
    return DeviceAnswer::kOk;
  }
  const std::uint32_t shortest = Units(options_.interval_s);
  if (request.code == kSetCur) {
    if (data.size() < 26) return Fail(kInvalidRequest);
    Commit wanted;
    wanted.format = data[2] == kYuyv ? kYuyv : kGrey;
    wanted.interval = Get(data, 4, 4) > shortest + shortest / 2 ? 2 * shortest : shortest;
    if (request.selector == kProbeControl) {
      probe_ = wanted;
      return DeviceAnswer::kOk;
    }
    // A camera on a bulk endpoint begins with the commit.
    commit_ = wanted;
    streaming_ = true;
    begin_ = clock_.Now();
    frame_ = 0;
    sending_.clear();
    settings_ = {SettingNow()};
    rendered_setting_.reset();
    return DeviceAnswer::kOk;
  }
  if (request.code < kGetCur || request.code > kGetDef) return Fail(kInvalidRequest);
  Commit told = request.selector == kProbeControl ? probe_ : commit_;
  if (request.code == kGetDef || request.code == kGetMin) told = {kGrey, shortest};
  if (request.code == kGetMax) told.interval = 2 * shortest;
  const auto pixels = static_cast<std::uint32_t>(options_.width * options_.height);
  data.assign(kProbeBytes, 0);
  data[0] = 1;  // the interval is to be kept
  data[2] = told.format;
  data[3] = 1;
  Put(data, 4, told.interval, 4);
  Put(data, 18, told.format == kYuyv ? 2 * pixels : pixels, 4);
  Put(data, 22, kPayloadBytes, 4);
  Put(data, 26, kClockHz, 4);
  data[30] = 3;  // frame identifiers and marks of a frame's end
  return DeviceAnswer::kOk;
}

void UvcDevice::StopStream() {
  std::lock_guard lock(mutex_);
  streaming_ = false;
  sending_.clear();
}

Nanoseconds UvcDevice::Interval() const {
  return Nanoseconds(100 * std::int64_t{commit_.interval});
}

std::uint64_t UvcDevice::FrameBeingExposed(HostTime now) const {
  if (!streaming_ || now < begin_) return 0;
  return static_cast<std::uint64_t>((now - begin_).count() / Interval().count());
}

std::uint32_t UvcDevice::DeviceClock(HostTime at) const {
  return static_cast<std::uint32_t>((at - power_up_).count() / (1'000'000'000 / kClockHz));
}

std::size_t UvcDevice::FrameBytes() const {
  const auto pixels = static_cast<std::size_t>(options_.width * options_.height);
  return commit_.format == kYuyv ? 2 * pixels : pixels;
}

// Makes the frames whose time has come: one is there when its interval is over.
void UvcDevice::Advance(HostTime now) {
  if (!streaming_) return;
  for (const std::uint64_t end = FrameBeingExposed(now); frame_ < end; ++frame_) {
    while (settings_.size() > 1 && settings_[1].from <= frame_) settings_.pop_front();
    if (faults_.silent || sending_.size() >= kMaxWaiting) continue;
    Make(settings_.front());
  }
}

void UvcDevice::Make(const Setting& setting) {
  Sending frame;
  frame.odd = odd_;
  odd_ = !odd_;
  if (faults_.swallowed > 0) {
    --faults_.swallowed;
    return;
  }
  frame.began = DeviceClock(begin_ + static_cast<std::int64_t>(frame_) * Interval());
  Render(setting);
  frame.bytes = rendered_;
  if (faults_.torn > 0) {
    --faults_.torn;
    frame.bytes.resize(frame.bytes.size() / 2);
  }
  if (faults_.marked > 0) {
    --faults_.marked;
    frame.damaged = true;
  }
  if (faults_.unended > 0) {
    --faults_.unended;
    frame.ended = false;
  }
  if (faults_.overlong > 0) {
    --faults_.overlong;
    frame.bytes.resize(frame.bytes.size() + 100);
  }
  sending_.push_back(std::move(frame));
}

double UvcDevice::Share(int x, int y, int channel, double effective_seconds) const {
  constexpr double kToShare = 128.0 / 255.0;
  // Over 16 : 1 in all, and half of the range in the middle at a fiftieth of a second.
  const double radiance =
      scene_.empty() ? 100.0 * std::exp2(4.0 * (x + 0.5) / options_.width +
                                         0.5 * (y + 0.5) / options_.height - 2.25)
                     : static_cast<double>(scene_.at(x, y, scene_.channels() == 3 ? channel : 0));
  return std::clamp(radiance * effective_seconds * kToShare, 0.0, 1.0);
}

void UvcDevice::Render(const Setting& setting) {
  if (rendered_setting_ && *rendered_setting_ == setting) return;
  rendered_setting_ = setting;
  rendered_.resize(FrameBytes());
  // A frame lasts its interval, and so does the longest exposure.
  const double seconds =
      std::min(setting.seconds, 1e-9 * static_cast<double>(Interval().count())) * setting.gain;
  std::size_t at = 0;
  if (commit_.format == kGrey) {
    for (int y = 0; y < options_.height; ++y) {
      for (int x = 0; x < options_.width; ++x) {
        rendered_[at++] = static_cast<std::byte>(std::lround(255.0 * Share(x, y, 1, seconds)));
      }
    }
    return;
  }
  const double balance[3] = {setting.kelvin / kNeutral, 1.0, kNeutral / setting.kelvin};
  const auto code = [](double value) { return static_cast<std::byte>(std::lround(value)); };
  for (int y = 0; y < options_.height; ++y) {
    for (int x = 0; x + 1 < options_.width; x += 2) {
      // BT.601, limited range; two pixels share their colour.
      double rgb[2][3];
      double mean[3];
      for (int c = 0; c < 3; ++c) {
        for (int i = 0; i < 2; ++i) rgb[i][c] = Share(x + i, y, c, seconds * balance[c]);
        mean[c] = 0.5 * (rgb[0][c] + rgb[1][c]);
      }
      const auto luma = [](const double* p) { return 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]; };
      rendered_[at++] = code(16.0 + 219.0 * luma(rgb[0]));
      rendered_[at++] = code(128.0 + 224.0 * (mean[2] - luma(mean)) / 1.772);
      rendered_[at++] = code(16.0 + 219.0 * luma(rgb[1]));
      rendered_[at++] = code(128.0 + 224.0 * (mean[0] - luma(mean)) / 1.402);
    }
  }
}

DeviceMoved UvcDevice::ReadStream(std::span<std::byte> buffer) {
  std::lock_guard lock(mutex_);
  if (!plugged_in_) return {DeviceAnswer::kGone, 0, true};
  if (faults_.stall_stream > 0) {
    --faults_.stall_stream;
    return {DeviceAnswer::kStall, 0, true};
  }
  const HostTime now = clock_.Now();
  Advance(now);
  if (sending_.empty() || buffer.size() <= kHeaderBytes) return {};
  Sending& frame = sending_.front();
  const std::size_t room = std::min(buffer.size(), kPayloadBytes) - kHeaderBytes;
  const std::size_t take = std::min(room, frame.bytes.size() - frame.sent);
  const bool last = frame.sent + take == frame.bytes.size();
  std::uint8_t header[kHeaderBytes] = {};
  header[0] = kHeaderBytes;
  header[1] = static_cast<std::uint8_t>(
      kEndOfHeader | kHasTime | kHasClock | (frame.odd ? kFrameId : 0) |
      (frame.damaged ? kErrorBit : 0) | (last && frame.ended ? kEndOfFrame : 0));
  Put(header, 2, frame.began, 4);
  Put(header, 6, DeviceClock(now), 4);
  Put(header, 10, static_cast<std::uint32_t>((now - power_up_).count() / 1'000'000 & 0x7FF), 2);
  std::memcpy(buffer.data(), header, kHeaderBytes);
  std::memcpy(buffer.data() + kHeaderBytes, frame.bytes.data() + frame.sent, take);
  frame.sent += take;
  if (last) sending_.pop_front();
  return {DeviceAnswer::kOk, kHeaderBytes + take, true};
}

void UvcDevice::Set(const Faults& faults) {
  std::lock_guard lock(mutex_);
  faults_ = faults;
}

void UvcDevice::SetLatency(int frames) {
  std::lock_guard lock(mutex_);
  latency_ = frames;
}

void UvcDevice::SetScene(Image<float> radiance) {
  std::lock_guard lock(mutex_);
  Advance(clock_.Now());
  scene_ = std::move(radiance);
  rendered_setting_.reset();
}

void UvcDevice::Unplug() {
  std::lock_guard lock(mutex_);
  plugged_in_ = false;
  sending_.clear();
}

void UvcDevice::PlugIn() {
  std::lock_guard lock(mutex_);
  plugged_in_ = true;
  PowerUp();
}

bool UvcDevice::plugged_in() const {
  std::lock_guard lock(mutex_);
  return plugged_in_;
}

std::uint8_t UvcDevice::PixelAt(int x, int y, double seconds, double gain) const {
  std::lock_guard lock(mutex_);
  return static_cast<std::uint8_t>(std::lround(255.0 * Share(x, y, 1, seconds * gain)));
}

std::uint32_t UvcDevice::ControlNow(std::uint8_t entity, std::uint8_t selector) const {
  std::lock_guard lock(mutex_);
  return Value(entity, selector);
}

std::vector<std::pair<std::uint8_t, std::uint8_t>> UvcDevice::writes() const {
  std::lock_guard lock(mutex_);
  return writes_;
}

bool UvcDevice::streaming() const {
  std::lock_guard lock(mutex_);
  return streaming_;
}

}  // namespace omnihdr::emulators
