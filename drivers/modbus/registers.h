#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr::modbus {

enum class Table { kHolding, kInput };  // function codes 3 and 4
std::string_view ToString(Table table);

enum class NumberType { kU16, kI16, kU32, kI32, kF32 };
std::string_view ToString(NumberType type);

// Which register of a 32-bit number comes first. Bytes within a register are always high first.
enum class WordOrder { kHighFirst, kLowFirst };
std::string_view ToString(WordOrder order);

// A number in a device's registers: value = raw * scale + offset.
struct NumberSpec {
  Table table = Table::kHolding;
  int address = -1;  // as on the wire, from 0 to 65535; -1 = there is none
  NumberType type = NumberType::kU16;
  WordOrder word_order = WordOrder::kHighFirst;
  double scale = 1.0;
  double offset = 0.0;
  bool configured() const { return address >= 0; }
  // kConfig naming what is wrong: the number does not fit below address 65536, or the scale is 0.
  Status Validate() const;
};

int RegisterCount(NumberType type);
// Counts after which a number of this type begins anew; 0 for kF32.
double Modulus(NumberType type);
// The number as it stands in the registers, without scale and offset. `registers` holds
// RegisterCount(type) of them. Not finite when a kF32 is not.
double DecodeRaw(std::span<const std::uint16_t> registers, NumberType type, WordOrder order);

struct OdometerCounterOptions {
  double scale = 1.0;   // metres a count; may be negative
  double offset = 0.0;  // metres at count 0
  double wrap = 0.0;    // counts after which it begins anew; 0 = it does not
  double max_speed_m_s = 60.0;
  // The reading the way goes on from when the first one is lower: a vehicle's counter may have been
  // set back while nobody looked.
  std::optional<double> not_below_m;
};

// Metres from a counter that wraps around and may be set back. Laws: the way between two readings
// is the shorter one around the wrap; a step faster than max_speed_m_s is no way at all but a
// counter set anew, from where it goes on without a jump.
class OdometerCounter {
 public:
  explicit OdometerCounter(const OdometerCounterOptions& options) : options_(options) {}
  // Metres after a new reading of the raw counter (finite).
  double Update(HostTime time, double raw);
  std::uint64_t resets() const { return resets_; }

 private:
  const OdometerCounterOptions options_;
  std::optional<HostTime> time_;
  double raw_ = 0.0;
  double metres_ = 0.0;
  std::uint64_t resets_ = 0;
};

}  // namespace omnihdr::modbus
