#include "drivers/modbus/registers.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace omnihdr::modbus {

std::string_view ToString(Table table) { return table == Table::kInput ? "input" : "holding"; }

std::string_view ToString(NumberType type) {
  switch (type) {
    case NumberType::kU16:
      return "u16";
    case NumberType::kI16:
      return "i16";
    case NumberType::kU32:
      return "u32";
    case NumberType::kI32:
      return "i32";
    case NumberType::kF32:
      return "f32";
  }
  return "?";
}

std::string_view ToString(WordOrder order) {
  return order == WordOrder::kLowFirst ? "low-first" : "high-first";
}

int RegisterCount(NumberType type) {
  return type == NumberType::kU16 || type == NumberType::kI16 ? 1 : 2;
}

double Modulus(NumberType type) {
  switch (type) {
    case NumberType::kU16:
    case NumberType::kI16:
      return 65536.0;
    case NumberType::kU32:
    case NumberType::kI32:
      return 4294967296.0;
    case NumberType::kF32:
      break;
  }
  return 0.0;
}

Status NumberSpec::Validate() const {
  if (!configured()) return {};
  const int last = 65536 - RegisterCount(type);
  if (address > last) {
    return Fail(ErrorKind::kConfig, "register: {}: expected at most {} for a number of type {}",
                address, last, ToString(type));
  }
  if (!std::isfinite(scale) || scale == 0.0) {
    return Fail(ErrorKind::kConfig, "scale: {}: expected a number other than 0", scale);
  }
  if (!std::isfinite(offset)) {
    return Fail(ErrorKind::kConfig, "offset: {}: expected a number", offset);
  }
  return {};
}

double DecodeRaw(std::span<const std::uint16_t> registers, NumberType type, WordOrder order) {
  if (type == NumberType::kU16) return registers[0];
  if (type == NumberType::kI16) return static_cast<std::int16_t>(registers[0]);
  std::uint32_t high = registers[0];
  std::uint32_t low = registers[1];
  if (order == WordOrder::kLowFirst) std::swap(high, low);
  const std::uint32_t bits = high << 16 | low;
  if (type == NumberType::kU32) return bits;
  if (type == NumberType::kI32) return static_cast<std::int32_t>(bits);
  return std::bit_cast<float>(bits);
}

double OdometerCounter::Update(HostTime time, double raw) {
  if (!time_) {
    metres_ = raw * options_.scale + options_.offset;
    if (options_.not_below_m && metres_ < *options_.not_below_m) metres_ = *options_.not_below_m;
  } else {
    double counts = raw - raw_;
    if (options_.wrap > 0.0) counts = std::remainder(counts, options_.wrap);
    const double step = counts * options_.scale;
    // The vehicle's own clock may round its reading by a poll or a count.
    const double seconds = static_cast<double>((time - *time_).count()) * 1e-9 + 0.2;
    const double most = options_.max_speed_m_s * seconds + std::abs(options_.scale);
    if (std::abs(step) <= most) {
      metres_ += step;
    } else {
      ++resets_;
    }
  }
  time_ = time;
  raw_ = raw;
  return metres_;
}

}  // namespace omnihdr::modbus
