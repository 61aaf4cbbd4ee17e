#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// What a feature's inquiry register says.
struct FeatureInquiry {
  bool present = false;
  bool absolute = false;
  bool readable = false;
  bool on_off = false;
  bool automatic = false;
  bool manual = false;
  std::uint32_t minimum = 0;
  std::uint32_t maximum = 0;
};
FeatureInquiry ParseFeatureInquiry(std::uint32_t quadlet);

// A feature's value register.
struct FeatureValue {
  bool present = false;
  bool absolute = false;
  bool one_push = false;
  bool on = false;
  bool automatic = false;
  std::uint32_t value = 0;    // bits 11..0; white balance: red
  std::uint32_t value_u = 0;  // bits 23..12; white balance: blue
};
FeatureValue ParseFeatureValue(std::uint32_t quadlet);

// IEEE-754 single as a register holds it.
float FloatFromQuadlet(std::uint32_t quadlet);
std::uint32_t QuadletFromFloat(float value);

struct AbsoluteRange {
  double minimum = 0.0;
  double maximum = 0.0;
};

// One feature of an open camera. Everything that is set is read back.
class Feature {
 public:
  // `offset`: of the value register. Reads the inquiry.
  static Result<Feature> Open(const Registers& registers, std::uint32_t offset,
                              std::string_view name);
  const FeatureInquiry& inquiry() const { return inquiry_; }
  const std::string& name() const { return name_; }
  std::uint32_t offset() const { return offset_; }

  Result<std::uint32_t> ReadRaw() const { return registers_.Read(offset_, name_); }
  // Not automatic any more, switched on, its value as given or, without one, as it is.
  Result<FeatureValue> SetManual(std::optional<std::uint32_t> value = std::nullopt) const;
  // The pixels untouched by it. Requires inquiry().on_off.
  Status SwitchOff() const;
  // The camera's own rule. Requires inquiry().automatic.
  Status SetAutomatic() const;
  // White balance.
  Result<FeatureValue> SetManualPair(std::uint32_t u, std::uint32_t v) const;
  // In the feature's own unit: seconds, dB, ... kConfig when the camera has no absolute values.
  Result<AbsoluteRange> ReadRange() const;
  Result<double> ReadAbsolute() const;
  // What the camera made of it (it quantises) and the value register's bits 11..0 that go with it.
  struct Set {
    double value = 0.0;
    std::uint32_t raw = 0;
  };
  Result<Set> SetAbsolute(double value) const;

 private:
  Feature(Registers registers, std::uint32_t offset, std::string name)
      : registers_(std::move(registers)), offset_(offset), name_(std::move(name)) {}
  Result<Registers> Absolute() const;
  Registers registers_;
  std::uint32_t offset_;
  std::string name_;
  FeatureInquiry inquiry_;
  std::uint32_t absolute_pointer_ = 0;
};

// White balance as the camera applies it; nothing = left at its value but made manual.
struct FixedSettings {
  std::optional<std::uint32_t> white_balance_blue;
  std::optional<std::uint32_t> white_balance_red;
};

// Makes the pixels a function of light, shutter and gain alone: every feature that could alter them
// by itself is switched off, or made manual where it cannot be, and read back. Returns what each
// register holds now, as (name, quadlet).
struct SettledFeature {
  std::string name;
  std::uint32_t quadlet = 0;
  bool off = false;
};
Result<std::vector<SettledFeature>> SettleFeatures(const Registers& registers,
                                                   const FixedSettings& settings);

}  // namespace omnihdr::iidc
