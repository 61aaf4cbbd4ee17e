#include "tests/emulators/iidc_device.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "tests/emulators/ladybug_frame.h"

namespace omnihdr::emulators {
namespace {

constexpr std::uint64_t kRomAddress = 0xFFFF'F000'0400;
constexpr std::uint32_t kFormat7At = 0x4000;  // + 0x100 · mode
constexpr std::uint32_t kFormat7End = 0x4800;
constexpr std::uint32_t kCompressedMode = 7;  // from kBase
constexpr std::uint32_t kShutterAbsolute = 0x3000;
constexpr std::uint32_t kGainAbsolute = 0x3010;
constexpr std::uint32_t kGammaAbsolute = 0x3020;

constexpr std::uint32_t kShutter = 0x81C;
constexpr std::uint32_t kGain = 0x820;
constexpr std::uint32_t kGamma = 0x818;
constexpr std::uint32_t kTrigger = 0x830;
constexpr std::uint32_t kFrameInfo = 0x12F8;
constexpr std::uint32_t kSoftwareTrigger = 0x62C;
constexpr std::uint32_t kSoftwareSource = 7;
constexpr std::uint32_t kIsoEnable = 0x614;
constexpr std::uint32_t kInitialize = 0x000;
constexpr std::uint32_t kCycleControl = 0x1800;
constexpr std::uint32_t kCycleSteps = 0x1820;  // + 0x20 · step: shutter, and gain 4 behind it
constexpr std::uint32_t kSeriesMode = 15;

constexpr std::uint32_t kPresent = 1U << 31;
constexpr std::uint32_t kAbsolute = 1U << 30;
constexpr std::uint32_t kOn = 1U << 25;
constexpr std::uint32_t kAuto = 1U << 24;
constexpr std::uint32_t kStepsPerOctave = 200;
constexpr std::size_t kMostTriggerTimes = 100'000;
constexpr std::size_t kMostPictures = 6;    // kept
constexpr std::size_t kBabbleBytes = 1700;  // no whole packet at the end

std::uint32_t FromFloat(double value) {
  return std::bit_cast<std::uint32_t>(static_cast<float>(value));
}
double ToDouble(std::uint32_t quadlet) { return std::bit_cast<float>(quadlet); }

// A pointer register's value for an offset from kBase.
std::uint32_t Pointer(std::uint32_t offset) {
  return static_cast<std::uint32_t>((IidcDevice::kBase + offset - 0xFFFF'F000'0000) / 4);
}

void AppendText(std::vector<std::uint32_t>& rom, std::string_view text) {
  const std::size_t words = (text.size() + 4) / 4;
  rom.push_back(static_cast<std::uint32_t>(words + 2) << 16);
  rom.push_back(0);
  rom.push_back(0);
  for (std::size_t word = 0; word < words; ++word) {
    std::uint32_t quadlet = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      const std::size_t at = 4 * word + i;
      quadlet = quadlet << 8 | (at < text.size() ? static_cast<unsigned char>(text[at]) : 0U);
    }
    rom.push_back(quadlet);
  }
}

std::vector<std::uint32_t> MakeRom(std::uint64_t guid) {
  std::vector<std::uint32_t> rom = {0x04040000,
                                    0x31333934,
                                    0x20FF5003,
                                    static_cast<std::uint32_t>(guid >> 32),
                                    static_cast<std::uint32_t>(guid),
                                    2U << 16,     // 5: root directory
                                    0x0300B09D,   // 6
                                    0xD1000001,   // 7: unit directory, one on
                                    3U << 16,     // 8: unit directory
                                    0x1200A02D,   // 9
                                    0x13000102,   // 10
                                    0xD4000001,   // 11: one on
                                    3U << 16,     // 12: unit dependent directory
                                    0x403C0000,   // 13: command base
                                    0x81000002,   // 14: vendor's name, two on
                                    0x82000000};  // 15: model's name
  AppendText(rom, "Omni Emulators");
  rom[15] |= static_cast<std::uint32_t>(rom.size() - 15);
  AppendText(rom, "Six-Eyed Test Head");
  return rom;
}

int BayerCode(BayerOrder order) {
  switch (order) {
    case BayerOrder::kRggb:
      return 0;
    case BayerOrder::kGbrg:
      return 1;
    case BayerOrder::kGrbg:
      return 2;
    default:
      return 3;
  }
}

std::uint32_t TileLetters(BayerOrder order) {
  const std::string_view letters = ToString(order);
  if (letters.size() != 4) return 0x59595959;
  std::uint32_t quadlet = 0;
  for (const char c : letters) quadlet = quadlet << 8 | static_cast<unsigned char>(c);
  return quadlet;
}

void PutWord(std::vector<std::byte>& bytes, std::size_t at, std::uint32_t word) {
  for (std::size_t i = 0; i < 4; ++i) {
    bytes[at + i] = static_cast<std::byte>(word >> (24 - 8 * i) & 0xFF);
  }
}

}  // namespace

double IidcDevice::ShutterSeconds(std::uint32_t raw) {
  return 1e-5 * std::exp2(static_cast<double>(raw) / kStepsPerOctave);
}
std::uint32_t IidcDevice::ShutterRaw(double seconds) {
  const double raw = std::round(kStepsPerOctave * std::log2(seconds / 1e-5));
  return static_cast<std::uint32_t>(std::clamp(raw, 0.0, 4095.0));
}
double IidcDevice::GainDecibels(std::uint32_t raw) { return static_cast<double>(raw) * 0.05 - 6.0; }
std::uint32_t IidcDevice::GainRaw(double decibels) {
  return static_cast<std::uint32_t>(std::clamp(std::round((decibels + 6.0) / 0.05), 0.0, 600.0));
}

IidcDevice::IidcDevice(const IidcDeviceOptions& options, const Clock& clock)
    : options_(options),
      clock_(clock),
      rom_(MakeRom(options.guid)),
      cycle_(options.cycle_start, options.exposure_cycle ? 2U : 0U) {
  PowerUp();
}

void IidcDevice::PowerUp() {
  power_up_ = clock_.Now();
  busy_until_ = power_up_;
  counter_ = options_.first_counter;
  sending_.clear();
  registers_.clear();
  ResetFeatures();
}

void IidcDevice::ResetFeatures() {
  registers_[0x100] = 1U << (31 - 7);
  registers_[0x19C] = 1U << 31 | 1U << (31 - kCompressedMode);
  registers_[0x2E0] = Pointer(kFormat7At);
  registers_[0x2E0 + 4 * kCompressedMode] = Pointer(kFormat7At + 0x100 * kCompressedMode);
  registers_[0x400] = kPresent | 1U << 30;
  registers_[0x608] = 7U << 29;
  registers_[0x604] = 0;
  registers_[kIsoEnable] = 0;
  registers_[0x628] = 0;
  registers_[0x1F20] = options_.serial;
  registers_[0x1040] = TileLetters(options_.bayer);
  if (options_.embedded_info) registers_[kFrameInfo] = kPresent | 0x3FFU << 16;

  // Everything automatic, as cameras come.
  const std::uint32_t all = kPresent | 1U << 27 | 1U << 26 | 1U << 25 | 1U << 24 | 4095;
  for (const std::uint32_t offset : {0x804U, 0x808U, 0x810U, 0x814U, kGamma, 0x834U, 0x83CU}) {
    registers_[offset - 0x300] = all;
    registers_[offset] = kPresent | kOn | kAuto | 777;
  }
  const std::uint32_t no_switch = all & ~(1U << 26);
  for (const std::uint32_t offset : {0x800U, 0x80CU}) {
    registers_[offset - 0x300] = no_switch;
    registers_[offset] = kPresent | kOn | kAuto | 512U << 12 | 640;
  }
  for (const std::uint32_t offset : {kShutter, kGain}) {
    registers_[offset - 0x300] = all | kAbsolute;
    registers_[offset] = kPresent | kOn | kAuto | 1000;
  }
  registers_[0x71C] = Pointer(kShutterAbsolute);
  registers_[0x720] = Pointer(kGainAbsolute);
  registers_[0x718] = Pointer(kGammaAbsolute);
  registers_[kShutterAbsolute] = FromFloat(options_.shortest_s);
  registers_[kShutterAbsolute + 4] = FromFloat(options_.longest_s);
  registers_[kShutterAbsolute + 8] = FromFloat(ShutterSeconds(1000));
  registers_[kGainAbsolute] = FromFloat(-6.0);
  registers_[kGainAbsolute + 4] = FromFloat(24.0);
  registers_[kGainAbsolute + 8] = FromFloat(0.0);
  registers_[kTrigger - 0x300] = kPresent | 1U << 27 | 1U << 26 | 1U << 25 | 1U << 23 | 1U << 16 |
                                 1U << 15 | 1U << 1 |  // input 0, software; modes 0, 14, 15
                                 (options_.series ? 1U : 0U);
  registers_[kTrigger] = kPresent;
  AbortSeries();
  if (options_.exposure_cycle) {
    registers_[kCycleControl] = kPresent;
    for (std::uint32_t step = 0; step < IidcCycle::kSteps; ++step) {
      registers_[kCycleSteps + 0x20 * step] = kPresent | 100 * step;
      registers_[kCycleSteps + 0x20 * step + 4] = kPresent | GainRaw(0.0);
    }
  }
  settings_ = {{1000, GainRaw(0.0)}};

  registers_[0x1E80] = kPresent | 1U << 24 | 60;

  format7_.clear();
  for (const std::uint32_t mode : {0U, kCompressedMode}) {
    auto& csr = format7_[mode];
    const bool raw = mode == 0;
    csr[0x000] = raw ? static_cast<std::uint32_t>(options_.max_width) << 16 |
                           static_cast<std::uint32_t>(options_.max_height)
                     : 512U << 16 | 96;
    csr[0x004] = 4U << 16 | 2;
    csr[0x04C] = 2U << 16 | 2;
    csr[0x014] = raw ? 1U << 31 | 1U << (31 - 5) | 1U << (31 - 9) | 1U << (31 - 10) : 1U << 31;
    csr[0x040] = 4U << 16 | 4096;
    csr[0x044] = 512;  // recommended
    csr[0x058] = static_cast<std::uint32_t>(BayerCode(options_.bayer)) << 24;
    csr[0x07C] = kPresent;
  }
}

std::uint32_t& IidcDevice::Format7(std::uint32_t offset) {
  return format7_[registers_[0x604] >> 29][offset];
}

void IidcDevice::UpdateTotals() {
  const std::uint32_t size = Format7(0x00C);
  const std::uint32_t pixels = (size >> 16) * (size & 0xFFFF);
  const std::uint32_t bytes = pixels * (IsDeep() ? 2 : 1);
  Format7(0x054) = (IsDeep() ? 12U : 8U) << 24;
  const std::uint32_t packet = Format7(0x044) >> 16;
  Format7(0x034) = pixels;
  Format7(0x03C) = bytes;
  Format7(0x048) = packet == 0 ? 0 : (bytes + packet - 1) / packet;
}

std::optional<std::uint32_t> IidcDevice::ReadOne(std::uint64_t address) const {
  if (address % 4 != 0) return std::nullopt;
  if (address >= kRomAddress && address < kRomAddress + 4 * rom_.size()) {
    return rom_[(address - kRomAddress) / 4];
  }
  if (address < kBase) return std::nullopt;
  const std::uint64_t offset = address - kBase;
  if (offset >= kFormat7At && offset < kFormat7End) {
    const auto mode = format7_.find(static_cast<std::uint32_t>(offset - kFormat7At) / 0x100);
    if (mode == format7_.end()) return std::nullopt;
    const auto found = mode->second.find(static_cast<std::uint32_t>(offset) % 0x100);
    return found == mode->second.end() ? 0 : found->second;
  }
  if (offset == kSoftwareTrigger) return IsBusy(clock_.Now()) ? kPresent : 0;
  if (offset >= 0x5000) return std::nullopt;
  const auto found = registers_.find(static_cast<std::uint32_t>(offset));
  return found == registers_.end() ? 0 : found->second;
}

std::optional<IidcDevice::Answer> IidcDevice::Refuses() {
  ++requests_;
  TakeWhatIsDue();
  if (!plugged_in_) return Answer::kGone;
  if (faults_.nak_registers > 0) {
    --faults_.nak_registers;
    return Answer::kNak;
  }
  if (faults_.stall_registers > 0) {
    --faults_.stall_registers;
    return Answer::kStall;
  }
  if (faults_.stall_after >= 0 && faults_.stall_after-- == 0) return Answer::kStall;
  return std::nullopt;
}

IidcDevice::Answer IidcDevice::Read(std::uint64_t address, std::span<std::uint32_t> quadlets) {
  std::lock_guard lock(mutex_);
  if (const std::optional<Answer> refused = Refuses()) return *refused;
  for (std::size_t i = 0; i < quadlets.size(); ++i) {
    const std::optional<std::uint32_t> value = ReadOne(address + 4 * i);
    if (!value) return Answer::kStall;
    quadlets[i] = *value;
  }
  return Answer::kOk;
}

IidcDevice::Answer IidcDevice::Write(std::uint64_t address, std::uint32_t value) {
  std::lock_guard lock(mutex_);
  if (const std::optional<Answer> refused = Refuses()) return *refused;
  return WriteOne(address, value) ? Answer::kOk : Answer::kStall;
}

void IidcDevice::WriteFeature(std::uint32_t offset, std::uint32_t value) {
  const std::uint32_t inquiry = registers_[offset - 0x300];
  if ((inquiry & kPresent) == 0) return;
  if ((inquiry & 1U << 26) == 0) value |= kOn;  // cannot be switched off
  if (offset == kGamma && options_.keeps_gamma) value |= kOn;
  if ((inquiry & kAbsolute) == 0) value &= ~kAbsolute;
  registers_[offset] = value | kPresent;
  if ((value & kAbsolute) != 0) return;
  if (offset == kShutter) {
    registers_[kShutterAbsolute + 8] = FromFloat(ShutterSeconds(value & 0xFFF));
  } else if (offset == kGain) {
    registers_[kGainAbsolute + 8] = FromFloat(GainDecibels(value & 0xFFF));
  }
}

bool IidcDevice::WriteOne(std::uint64_t address, std::uint32_t value) {
  if (address % 4 != 0 || address < kBase || address >= kBase + 0x5000) return false;
  const auto offset = static_cast<std::uint32_t>(address - kBase);
  if (offset >= kFormat7At && offset < kFormat7End) {
    const std::uint32_t at = offset % 0x100;
    // Only the selected mode's are written by anybody.
    if ((offset - kFormat7At) / 0x100 != registers_[0x604] >> 29) return false;
    if (at == 0x07C) {
      std::uint32_t verdict = kPresent;
      const std::uint32_t size = Format7(0x00C);
      const std::uint32_t place = Format7(0x008);
      const std::uint32_t most = Format7(0x000);
      if ((size >> 16) + (place >> 16) > most >> 16 ||
          (size & 0xFFFF) + (place & 0xFFFF) > (most & 0xFFFF)) {
        verdict |= 1U << 23;
      }
      if (options_.handshake_never_ends) verdict |= 1U << 30;
      Format7(0x07C) = verdict;
    } else if (at == 0x008 || at == 0x00C || at == 0x010) {
      Format7(at) = value;
    } else if (at == 0x044) {
      Format7(at) = (value & 0xFFFF0000) | (Format7(at) & 0xFFFF);
    } else {
      return false;
    }
    UpdateTotals();
    return true;
  }
  switch (offset) {
    case kInitialize:
      if ((value & kPresent) != 0) ResetFeatures();
      return true;
    case kSoftwareTrigger:
      if ((value & kPresent) != 0) Trigger(kSoftwareSource);
      return true;
    case kTrigger:
      AbortSeries();  // touching it ends what it began
      registers_[offset] = value;
      return true;
    case kCycleControl:
      if (options_.exposure_cycle) registers_[offset] = kPresent | (value & kOn);
      return true;
    case kFrameInfo:
      if (options_.embedded_info) {
        registers_[offset] = (registers_[offset] & 0xFFFF0000) | (value & 0x3FF);
      }
      return true;
    case kShutterAbsolute + 8: {
      const std::uint32_t raw = ShutterRaw(ToDouble(value));
      registers_[offset] = FromFloat(ShutterSeconds(raw));
      registers_[kShutter] = (registers_[kShutter] & ~0xFFFU) | ShutterWord(raw);
      return true;
    }
    case kGainAbsolute + 8: {
      const std::uint32_t raw = GainRaw(ToDouble(value));
      registers_[offset] = FromFloat(GainDecibels(raw));
      registers_[kGain] = (registers_[kGain] & ~0xFFFU) | raw;
      return true;
    }
    case kIsoEnable:
      registers_[offset] = value & kPresent;
      if (value == 0) {
        sending_.clear();
        AbortSeries();
      }
      return true;
    default:
      break;
  }
  if (offset >= kCycleSteps && offset < kCycleSteps + 0x20 * IidcCycle::kSteps) {
    const std::uint32_t at = offset % 0x20;
    if (!options_.exposure_cycle || (at != 0 && at != 4)) return true;
    // Out of range is pulled in: the gain's ends at 600.
    registers_[offset] = kPresent | (at == 0 ? value & 0xFFF : std::min(value & 0xFFF, 600U));
  } else if (offset >= 0x800 && offset < 0x890) {
    WriteFeature(offset, value);
  } else {
    registers_[offset] = value;
  }
  return true;
}

std::uint32_t IidcDevice::ShutterWord(std::uint32_t raw) const {
  return options_.coarse_words ? raw & ~0xFU : raw;
}

void IidcDevice::Pulse() {
  std::lock_guard lock(mutex_);
  if (plugged_in_) Trigger(0);
}

bool IidcDevice::CycleIsOn() const {
  const auto control = registers_.find(kCycleControl);
  return control != registers_.end() && (control->second & kOn) != 0;
}

bool IidcDevice::IsBusy(HostTime now) const {
  return now < busy_until_ || series_left_ > 0 || endless_series_;
}

void IidcDevice::AbortSeries() {
  series_left_ = 0;
  endless_series_ = false;
}

void IidcDevice::TakeWhatIsDue() {
  while ((series_left_ > 0 || endless_series_) && busy_until_ <= clock_.Now()) {
    if (!endless_series_) --series_left_;
    Expose(busy_until_);
  }
}

void IidcDevice::Trigger(std::uint32_t source) {
  TakeWhatIsDue();
  const HostTime now = clock_.Now();
  const std::uint32_t mode = registers_[kTrigger];
  const bool on =
      (mode & kOn) != 0 && (mode >> 21 & 7U) == source && (registers_[kIsoEnable] & kPresent) != 0;
  if (!on || IsBusy(now)) {
    ++triggers_refused_;
    return;
  }
  if ((mode >> 16 & 0xFU) == kSeriesMode) {
    const std::uint32_t pictures = mode & 0xFFF;
    endless_series_ = pictures == 0;
    series_left_ = std::max(pictures, 1U) - 1;
  }
  cycle_.BeginSeries();
  Expose(now);
}

void IidcDevice::Expose(HostTime now) {
  Setting setting;
  if (CycleIsOn()) {
    for (; faults_.skipped_steps > 0; --faults_.skipped_steps) cycle_.Skip();
    const std::uint32_t at = kCycleSteps + 0x20 * cycle_.Take();
    setting = {registers_[at] & 0xFFF, registers_[at + 4] & 0xFFF};
  } else {
    settings_.push_back(
        {ShutterRaw(ToDouble(registers_[kShutterAbsolute + 8])), registers_[kGain] & 0xFFF});
    while (settings_.size() > static_cast<std::size_t>(options_.exposure_latency) + 1) {
      settings_.pop_front();
    }
    setting = settings_.front();
  }
  if (faults_.wrong_exposures > 0) {
    --faults_.wrong_exposures;
    setting.shutter += kStepsPerOctave;
  }
  const auto exposed = Nanoseconds(std::llround(ShutterSeconds(setting.shutter) * 1e9));
  const auto readout = Nanoseconds(std::llround(options_.readout_s * 1e9));
  busy_until_ = now + exposed + readout;
  if (trigger_times_.size() < kMostTriggerTimes) trigger_times_.push_back(now);
  Sending frame;
  frame.bytes = TakePicture(setting, now);
  frame.ready = busy_until_;
  ++counter_;
  if (faults_.lose_frames > 0) {
    --faults_.lose_frames;
    cycle_.FrameLost();
    return;
  }
  if (faults_.late_frames > 0) {
    --faults_.late_frames;
    frame.ready = frame.ready + Nanoseconds(std::llround(faults_.late_s * 1e9));
  }
  if (faults_.short_frames > 0) {
    --faults_.short_frames;
    frame.bytes.resize(std::min(frame.bytes.size(), faults_.short_bytes));
  }
  if (faults_.unmarked_losses > 0) {
    --faults_.unmarked_losses;
    const std::size_t packet = options_.link_packet_bytes;
    if (frame.bytes.size() > 2 * packet) {
      frame.bytes.erase(frame.bytes.begin() + static_cast<std::ptrdiff_t>(packet),
                        frame.bytes.begin() + static_cast<std::ptrdiff_t>(2 * packet));
    }
  }
  sending_.push_back(std::move(frame));
  if (faults_.babbling_frames > 0) {
    --faults_.babbling_frames;
    for (int i = 0; i < 2; ++i) {
      sending_.push_back({TakePicture(setting, now), 0, busy_until_});
      ++counter_;
      sending_.push_back({std::vector<std::byte>(kBabbleBytes, std::byte{0x5A}), 0, busy_until_});
    }
  }
}

double IidcDevice::RadianceAt(int x, int y) const {
  if (options_.scene) return options_.scene(x, y);
  const int sensor = y / std::max(1, options_.rows_per_sensor);
  const int row = y % std::max(1, options_.rows_per_sensor);
  const int colour = options_.bayer == BayerOrder::kNone ? 1 : BayerChannel(options_.bayer, x, row);
  constexpr std::array<double, 3> kTint = {0.8, 1.0, 0.6};
  // Each sensor sees a ramp of its own brightness, over 100 : 1 in all.
  return kTint[static_cast<std::size_t>(colour)] * 4000.0 * std::exp2(-sensor) *
         (0.2 + static_cast<double>(x) / options_.max_width);
}

std::uint8_t IidcDevice::PixelAt(int x, int y, double exposure_s, double gain_db) const {
  return Value(x, y, exposure_s * std::pow(10.0, gain_db / 20.0));
}

std::uint8_t IidcDevice::Value(int x, int y, double exposure) const {
  double value = RadianceAt(x, y) * exposure;
  if (options_.grain > 0) {
    std::uint32_t mixed =
        static_cast<std::uint32_t>(y) * 73856093U ^ static_cast<std::uint32_t>(x) * 19349663U;
    mixed = (mixed ^ mixed >> 15) * 2246822519U;
    mixed ^= mixed >> 13;
    const auto range = static_cast<std::uint32_t>(2 * options_.grain + 1);
    value += static_cast<double>(mixed % range) - options_.grain;
  }
  return static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0, 255.0)));
}

std::uint16_t IidcDevice::DeepPixelAt(int x, int y, double exposure_s, double gain_db) const {
  return DeepValue(x, y, exposure_s * std::pow(10.0, gain_db / 20.0));
}

std::uint16_t IidcDevice::DeepValue(int x, int y, double exposure) const {
  const double value = RadianceAt(x, y) * exposure * 4095.0 / 255.0;
  return static_cast<std::uint16_t>(std::lround(std::min(4095.0, value)) << 4);
}

bool IidcDevice::IsDeep() {
  const std::uint32_t coding = Format7(0x010) >> 24;
  return coding == 5 || coding == 10;
}

std::vector<std::byte> IidcDevice::Pixels(const Setting& setting) {
  const std::uint32_t size = Format7(0x00C);
  const std::uint32_t place = Format7(0x008);
  const std::size_t packet = std::max(1U, Format7(0x044) >> 16);
  const std::size_t count = std::size_t{Format7(0x048)} * packet;
  const std::array<std::uint32_t, 5> key = {size, place, setting.shutter, setting.gain,
                                            static_cast<std::uint32_t>(count)};
  if (const auto found = pictures_.find(key); found != pictures_.end()) return found->second;
  const int width = static_cast<int>(size >> 16);
  const int height = static_cast<int>(size & 0xFFFF);
  const double exposure =
      ShutterSeconds(setting.shutter) * std::pow(10.0, GainDecibels(setting.gain) / 20.0);
  std::vector<std::byte> bytes(count);
  std::size_t at = 0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width && at < bytes.size(); ++x) {
      const int sensor_x = x + static_cast<int>(place >> 16);
      const int sensor_y = y + static_cast<int>(place & 0xFFFF);
      if (IsDeep()) {
        const std::uint16_t value = DeepValue(sensor_x, sensor_y, exposure);
        const int first = options_.low_byte_first ? 0 : 8;
        bytes[at++] = static_cast<std::byte>(value >> first);
        bytes[at++] = static_cast<std::byte>(value >> (8 - first));
        continue;
      }
      bytes[at++] = static_cast<std::byte>(Value(sensor_x, sensor_y, exposure));
    }
  }
  if (pictures_.size() >= kMostPictures) pictures_.clear();
  pictures_.emplace(key, bytes);
  return bytes;
}

std::vector<std::byte> IidcDevice::TakePicture(const Setting& setting, HostTime start) {
  const std::uint32_t place = Format7(0x008);
  const double seconds = ShutterSeconds(setting.shutter);
  const double decibels = GainDecibels(setting.gain);
  const std::size_t packet = std::max(1U, Format7(0x044) >> 16);
  const bool compressed = registers_[0x604] >> 29 == kCompressedMode;
  std::vector<std::byte> bytes =
      compressed ? std::vector<std::byte>(std::size_t{Format7(0x048)} * packet) : Pixels(setting);
  const std::int64_t since =
      (start - power_up_).count() + std::int64_t{options_.first_cycle_s} * 1'000'000'000;
  const std::int64_t cycles = since % 1'000'000'000 / 125'000;
  const auto cycle_time = static_cast<std::uint32_t>(
      since / 1'000'000'000 % 128 << 25 | cycles << 12 | since % 125'000 * 3072 / 125'000);
  const std::uint32_t words[] = {cycle_time,
                                 kPresent | kOn | setting.gain,
                                 kPresent | kOn | ShutterWord(setting.shutter),
                                 registers_[0x800],
                                 registers_[0x804],
                                 registers_[0x80C],
                                 counter_,
                                 0,
                                 0,
                                 place};
  if (compressed) {
    std::vector<std::byte> data = Compressed(seconds, decibels, words);
    data.resize(bytes.size());
    return data;
  }
  std::size_t at = 0;
  for (int item = 0; item < 10; ++item) {
    if ((registers_[kFrameInfo] & 1U << item) == 0 || at + 4 > bytes.size()) continue;
    PutWord(bytes, at, words[item]);
    at += 4;
  }
  return bytes;
}

std::vector<std::byte> IidcDevice::Compressed(double seconds, double decibels,
                                              std::span<const std::uint32_t> words) {
  Image<std::uint8_t> stack(options_.max_width, options_.max_height);
  for (int y = 0; y < stack.height(); ++y) {
    for (int x = 0; x < stack.width(); ++x) stack.at(x, y) = PixelAt(x, y, seconds, decibels);
  }
  LadybugWords header;
  header.cycle_time = words[0];
  header.gain = words[1];
  header.shutter = words[2];
  header.sequence = words[6];
  const int quality = std::max(1, static_cast<int>(registers_[0x1E80] & 0xFF));
  std::vector<std::byte> frame = BuildLadybugFrame(stack, header, quality);
  if (faults_.damaged_headers > 0) {
    --faults_.damaged_headers;
    frame[0x10] = std::byte{0};
  }
  return frame;
}

IidcDevice::Moved IidcDevice::ReadStream(std::span<std::byte> buffer) {
  std::lock_guard lock(mutex_);
  Moved moved;
  if (!plugged_in_) return {Answer::kGone, 0, true};
  TakeWhatIsDue();
  if (faults_.stall_stream > 0) {
    --faults_.stall_stream;
    return {Answer::kStall, 0, true};
  }
  while (moved.bytes < buffer.size() && !sending_.empty() &&
         sending_.front().ready <= clock_.Now()) {
    Sending& frame = sending_.front();
    const std::size_t take = std::min(buffer.size() - moved.bytes, frame.bytes.size() - frame.sent);
    std::memcpy(buffer.data() + moved.bytes, frame.bytes.data() + frame.sent, take);
    moved.bytes += take;
    frame.sent += take;
    moved.answer = Answer::kOk;
    if (frame.sent < frame.bytes.size()) break;
    const bool short_end = frame.bytes.size() % options_.link_packet_bytes != 0 || take == 0;
    sending_.pop_front();
    if (short_end) {
      moved.ended = true;
      return moved;
    }
  }
  moved.ended = moved.bytes == buffer.size();
  return moved;
}

bool IidcDevice::StreamIsReady() {
  std::lock_guard lock(mutex_);
  if (!plugged_in_ || faults_.stall_stream > 0) return true;
  TakeWhatIsDue();
  return !sending_.empty() && sending_.front().ready <= clock_.Now();
}

void IidcDevice::Set(const Faults& faults) {
  std::lock_guard lock(mutex_);
  faults_ = faults;
}

void IidcDevice::Unplug() {
  std::lock_guard lock(mutex_);
  plugged_in_ = false;
  sending_.clear();
}

void IidcDevice::PlugIn() {
  std::lock_guard lock(mutex_);
  plugged_in_ = true;
  PowerUp();
}

bool IidcDevice::plugged_in() const {
  std::lock_guard lock(mutex_);
  return plugged_in_;
}

std::uint32_t IidcDevice::Register(std::uint32_t offset) const {
  std::lock_guard lock(mutex_);
  return ReadOne(kBase + offset).value_or(0);
}

std::uint64_t IidcDevice::requests() const {
  std::lock_guard lock(mutex_);
  return requests_;
}

std::vector<HostTime> IidcDevice::trigger_times() const {
  std::lock_guard lock(mutex_);
  return trigger_times_;
}

bool IidcDevice::stall_pending() const {
  std::lock_guard lock(mutex_);
  return faults_.stall_after >= 0;
}

int IidcDevice::triggers_refused() const {
  std::lock_guard lock(mutex_);
  return triggers_refused_;
}

}  // namespace omnihdr::emulators
