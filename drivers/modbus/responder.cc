#include "drivers/modbus/responder.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string_view>

namespace omnihdr::modbus {
namespace {

constexpr std::uint8_t kReadCoils = 1;
constexpr std::uint8_t kReadInputs = 2;
constexpr std::uint8_t kReadHolding = 3;
constexpr std::uint8_t kReadInputRegisters = 4;
constexpr std::uint8_t kWriteCoil = 5;
constexpr std::uint8_t kWriteRegister = 6;
constexpr std::uint8_t kWriteCoils = 15;
constexpr std::uint8_t kWriteRegisters = 16;
constexpr int kMostBits = 2000;
constexpr int kMostRegisters = 125;

std::uint16_t Word(std::span<const std::uint8_t> bytes, std::size_t at) {
  return static_cast<std::uint16_t>(bytes[at] << 8 | bytes[at + 1]);
}

void PutWord(std::uint16_t word, std::uint8_t* to) {
  to[0] = static_cast<std::uint8_t>(word >> 8);
  to[1] = static_cast<std::uint8_t>(word & 0xFF);
}

std::uint16_t Clamp16(double value) {
  return static_cast<std::uint16_t>(std::clamp(std::floor(value), 0.0, 65534.0));
}

// Two ASCII characters a register, cut where they do not fit.
void PutText(std::string_view text, std::span<std::uint16_t> registers) {
  for (std::size_t i = 0; i < std::min(text.size(), 2 * registers.size()); ++i) {
    const auto c = static_cast<unsigned char>(text[i]);
    const std::uint16_t letter = c >= 0x20 && c < 0x7F ? c : '?';
    registers[i / 2] |= static_cast<std::uint16_t>(i % 2 == 0 ? letter << 8 : letter);
  }
}

bool IsFault(CaptureState state) {
  return state == CaptureState::kFault || state == CaptureState::kStorageFull ||
         state == CaptureState::kWaitingForCamera || state == CaptureState::kDegraded;
}

}  // namespace

void Responder::Show(const ApplianceStatus& s) {
  registers_.fill(0);
  const auto put32 = [this](int at, std::uint64_t value) {
    registers_[static_cast<std::size_t>(at)] = static_cast<std::uint16_t>(value >> 16 & 0xFFFF);
    registers_[static_cast<std::size_t>(at) + 1] = static_cast<std::uint16_t>(value & 0xFFFF);
  };
  inputs_[kInputCameraReady] = s.camera_ready;
  inputs_[kInputArmed] = s.armed;
  inputs_[kInputBusy] = s.busy;
  inputs_[kInputFault] = IsFault(s.state);
  inputs_[kInputSessionEnded] = s.session_ended;
  inputs_[kInputOdometer] = s.odometer_m.has_value();
  inputs_[kInputGnss] = s.gnss_fix;
  inputs_[kInputControl] = static_cast<bool>(command_);
  registers_[kRegMapVersion] = kMapVersion;
  registers_[kRegState] = static_cast<std::uint16_t>(s.state);
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    if (inputs_[i]) registers_[kRegFlags] |= static_cast<std::uint16_t>(1U << i);
  }
  registers_[kRegUptime] =
      static_cast<std::uint16_t>(std::fmod(std::max(s.uptime_s, 0.0), 65536.0));
  put32(kRegTriggers, s.triggers);
  put32(kRegFramesRecorded, s.frames_recorded);
  put32(kRegFramesLost, s.frames_lost);
  put32(kRegViewsFinished, s.views_finished);
  put32(kRegViewsWaiting, s.views_waiting);
  registers_[kRegMinutesLeft] =
      s.minutes_left && std::isfinite(*s.minutes_left) ? Clamp16(*s.minutes_left) : 0xFFFF;
  registers_[kRegStorageLevel] = static_cast<std::uint16_t>(s.storage_level);
  put32(kRegStorageFreeMb,
        s.storage_free_bytes
            ? std::min<std::uint64_t>(*s.storage_free_bytes / 1'000'000, 0xFFFFFFFEU)
            : 0xFFFFFFFFU);
  registers_[kRegQualityLevel] = Clamp16(s.quality_level);
  std::uint32_t odometer = 0x80000000U;
  if (s.odometer_m && std::isfinite(*s.odometer_m)) {
    // Beyond 2147 km it begins anew, as odometers do.
    const double mm = std::remainder(std::floor(*s.odometer_m * 1000.0), 4294967296.0);
    odometer = static_cast<std::uint32_t>(static_cast<std::int64_t>(mm));
    if (odometer == 0x80000000U) odometer = 0x7FFFFFFFU;
  }
  put32(kRegOdometer, odometer);
  PutText(s.last_fault, std::span(registers_).subspan(kRegLastFault, 32));
  texts_.fill(0);
  PutText(s.reason, std::span(texts_).first(kRegRemedy - kRegReason));
  PutText(s.remedy, std::span(texts_).subspan(kRegRemedy - kRegReason));
}

std::optional<std::uint16_t> Responder::Register(int address) const {
  if (address == kCommandRegister) return last_command_;
  if (address >= kRegReason && address < kRegReason + kTextRegisters) {
    return texts_[static_cast<std::size_t>(address - kRegReason)];
  }
  if (address < 0 || address >= kStatusRegisters) return std::nullopt;
  // What the last request did is not to be older than the answer to it.
  if (address == kRegCommandCount) return static_cast<std::uint16_t>(command_count_ >> 16);
  if (address == kRegCommandCount + 1) return static_cast<std::uint16_t>(command_count_ & 0xFFFF);
  if (address == kRegCommandResult) return last_result_;
  return registers_[static_cast<std::size_t>(address)];
}

Responder::Outcome Responder::ReadBits(int address, int count, bool coils, std::uint8_t* to) const {
  const int last = coils ? kCommandCoils : kDiscreteInputs;
  if (address + count > last) return Exception::kIllegalAddress;
  std::fill(to, to + (count + 7) / 8, std::uint8_t{0});
  for (int i = 0; i < count; ++i) {
    const int bit = address + i;
    const bool on =
        coils ? bit == 0 && inputs_[kInputArmed] : inputs_[static_cast<std::size_t>(bit)];
    if (on) to[i / 8] |= static_cast<std::uint8_t>(1U << (i % 8));
  }
  return std::nullopt;
}

Responder::Outcome Responder::Command(ApplianceCommand command) {
  const Status done = command_(command);
  ++command_count_;
  last_result_ = done ? kDone : kRefused;
  if (done) {
    ++counts_.commands;
    return std::nullopt;
  }
  return done.error().kind == ErrorKind::kTemporary ? Exception::kServerBusy
                                                    : Exception::kServerFailure;
}

Responder::Outcome Responder::WriteCoil(int address, bool on) {
  if (address == 0) return Command(on ? ApplianceCommand::kArm : ApplianceCommand::kDisarm);
  return on ? Command(ApplianceCommand::kTrigger) : std::nullopt;
}

Responder::Outcome Responder::WriteRegister(int address, std::uint16_t value) {
  if (address != kCommandRegister) return Exception::kIllegalAddress;
  if (value < 1 || value > 3) return Exception::kIllegalValue;
  last_command_ = value;
  return Command(value == 1   ? ApplianceCommand::kArm
                 : value == 2 ? ApplianceCommand::kDisarm
                              : ApplianceCommand::kTrigger);
}

std::size_t Responder::Handle(std::span<const std::uint8_t> request, std::span<std::uint8_t> answer,
                              Outcome& failed) {
  const std::optional<std::size_t> length = RequestLength(request);
  if (length == 0) {
    failed = Exception::kIllegalFunction;
    return 0;
  }
  if (length != request.size()) {
    failed = Exception::kIllegalValue;
    return 0;
  }
  const std::uint8_t function = request[0];
  const int address = Word(request, 1);
  const int count = Word(request, 3);  // or the value to write
  answer[0] = function;
  switch (function) {
    case kReadCoils:
    case kReadInputs:
      if (count < 1 || count > kMostBits) {
        failed = Exception::kIllegalValue;
        return 0;
      }
      // Fits: 2000 bits are 250 bytes.
      answer[1] = static_cast<std::uint8_t>((count + 7) / 8);
      failed = ReadBits(address, count, function == kReadCoils, &answer[2]);
      return 2 + std::size_t{answer[1]};
    case kReadHolding:
    case kReadInputRegisters:
      if (count < 1 || count > kMostRegisters) {
        failed = Exception::kIllegalValue;
        return 0;
      }
      answer[1] = static_cast<std::uint8_t>(count * 2);
      for (int i = 0; i < count; ++i) {
        const std::optional<std::uint16_t> value = Register(address + i);
        if (!value) {
          failed = Exception::kIllegalAddress;
          return 0;
        }
        PutWord(*value, &answer[2 + static_cast<std::size_t>(i) * 2]);
      }
      return 2 + static_cast<std::size_t>(count) * 2;
    default:
      break;
  }
  if (!command_) {
    failed = Exception::kIllegalFunction;
    return 0;
  }
  std::copy_n(request.begin(), 5, answer.begin());
  switch (function) {
    case kWriteCoil:
      if (address >= kCommandCoils) {
        failed = Exception::kIllegalAddress;
      } else if (count != 0 && count != 0xFF00) {
        failed = Exception::kIllegalValue;
      } else {
        failed = WriteCoil(address, count != 0);
      }
      return 5;
    case kWriteRegister:
      failed = WriteRegister(address, static_cast<std::uint16_t>(count));
      return 5;
    case kWriteCoils:
      if (count < 1 || request[5] != (count + 7) / 8) {
        failed = Exception::kIllegalValue;
      } else if (address + count > kCommandCoils) {
        failed = Exception::kIllegalAddress;
      } else {
        for (int i = 0; i < count && !failed; ++i) {
          failed = WriteCoil(address + i, (request[6] >> i & 1) != 0);
        }
      }
      return 5;
    default:  // kWriteRegisters
      if (count < 1 || request[5] != count * 2) {
        failed = Exception::kIllegalValue;
      } else if (count != 1) {
        failed = Exception::kIllegalAddress;
      } else {
        failed = WriteRegister(address, Word(request, 6));
      }
      return 5;
  }
}

std::size_t Responder::Answer(std::span<const std::uint8_t> request,
                              std::span<std::uint8_t, kMaxPdu> answer) {
  if (request.empty()) return 0;
  ++counts_.requests;
  Outcome failed;
  const std::size_t length = Handle(request, answer, failed);
  if (!failed) return length;
  ++counts_.exceptions;
  answer[0] = static_cast<std::uint8_t>(request[0] | 0x80);
  answer[1] = static_cast<std::uint8_t>(*failed);
  return 2;
}

std::optional<std::size_t> RequestLength(std::span<const std::uint8_t> pdu) {
  if (pdu.empty()) return std::nullopt;
  switch (pdu[0]) {
    case kReadCoils:
    case kReadInputs:
    case kReadHolding:
    case kReadInputRegisters:
    case kWriteCoil:
    case kWriteRegister:
      return 5;
    case kWriteCoils:
    case kWriteRegisters:
      if (pdu.size() < 6) return std::nullopt;
      return 6 + std::size_t{pdu[5]};
    default:
      return 0;
  }
}

std::span<std::uint8_t> TcpFramer::Room() {
  if (consumed_ > 0) {
    std::memmove(buffer_.data(), buffer_.data() + consumed_, size_ - consumed_);
    size_ -= consumed_;
    consumed_ = 0;
  }
  return std::span(buffer_).subspan(size_);
}

TcpFramer::State TcpFramer::Next(Frame& frame) {
  const std::span<const std::uint8_t> rest =
      std::span<const std::uint8_t>(buffer_).subspan(consumed_, size_ - consumed_);
  // Told as early as it can be known, so that nobody waits for what never comes.
  if (rest.size() >= 4 && Word(rest, 2) != 0) return State::kBroken;
  if (rest.size() < 6) return State::kNeedMore;
  const std::size_t length = Word(rest, 4);  // unit and PDU
  if (length < 2 || length > 1 + kMaxPdu) return State::kBroken;
  if (rest.size() < 6 + length) return State::kNeedMore;
  frame.transaction = Word(rest, 0);
  frame.unit = rest[6];
  frame.pdu = rest.subspan(kTcpHeader, length - 1);
  consumed_ += 6 + length;
  return State::kFrame;
}

std::optional<RtuFramer::Frame> RtuFramer::Take(std::span<const std::uint8_t> bytes) {
  // Only the newest bytes can be a request that ends now.
  if (bytes.size() > 256) bytes = bytes.last(256);
  if (size_ + bytes.size() > buffer_.size()) {
    const std::size_t kept = 256;
    std::memmove(buffer_.data(), buffer_.data() + size_ - kept, kept);
    size_ = kept;
  }
  std::copy(bytes.begin(), bytes.end(), buffer_.begin() + static_cast<std::ptrdiff_t>(size_));
  size_ += bytes.size();
  const std::span<const std::uint8_t> all = std::span<const std::uint8_t>(buffer_).first(size_);
  for (std::size_t begin = 0; begin + 4 <= all.size(); ++begin) {
    const std::span<const std::uint8_t> frame = all.subspan(begin);
    if (frame[0] != unit_ && frame[0] != 0) continue;
    const std::span<const std::uint8_t> pdu = frame.subspan(1, frame.size() - 3);
    const std::optional<std::size_t> length = RequestLength(pdu);
    // Functions that are not there are answered, too, when the frame is whole as it stands.
    const bool whole = length && (*length == pdu.size() || *length == 0);
    if (!whole) continue;
    const std::uint16_t crc =
        static_cast<std::uint16_t>(frame[frame.size() - 2] | frame[frame.size() - 1] << 8);
    if (Crc16(frame.first(frame.size() - 2)) != crc) continue;
    size_ = 0;
    return Frame{frame[0], pdu};
  }
  return std::nullopt;
}

std::uint16_t Crc16(std::span<const std::uint8_t> bytes) {
  std::uint16_t crc = 0xFFFF;
  for (const std::uint8_t byte : bytes) {
    crc = static_cast<std::uint16_t>(crc ^ byte);
    for (int bit = 0; bit < 8; ++bit) {
      crc = static_cast<std::uint16_t>((crc & 1) != 0 ? (crc >> 1) ^ 0xA001 : crc >> 1);
    }
  }
  return crc;
}

}  // namespace omnihdr::modbus
