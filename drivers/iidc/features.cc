#include "drivers/iidc/features.h"

#include <bit>
#include <cmath>
#include <utility>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

constexpr std::uint32_t kPresent = Bit(31);
constexpr std::uint32_t kAbsolute = Bit(30);
constexpr std::uint32_t kOnePush = Bit(26);
constexpr std::uint32_t kOn = Bit(25);
constexpr std::uint32_t kAuto = Bit(24);
constexpr std::uint32_t kValue = 0xFFF;

constexpr std::uint32_t kAbsoluteMinimum = 0x0;
constexpr std::uint32_t kAbsoluteMaximum = 0x4;
constexpr std::uint32_t kAbsoluteValue = 0x8;

// What to do with the features that alter pixels. Shutter, gain and the trigger have their own
// code.
enum class Policy {
  kOff,     // off where that is possible, else manual
  kManual,  // means nothing when off: manual, at its value
};
struct FeaturePolicy {
  std::uint32_t offset;
  std::string_view name;
  Policy policy;
};
constexpr FeaturePolicy kPolicies[] = {
    {kAutoExposure, "AUTO_EXPOSURE", Policy::kOff},
    {kSharpness, "SHARPNESS", Policy::kOff},
    {kHue, "HUE", Policy::kOff},
    {kSaturation, "SATURATION", Policy::kOff},
    {kGamma, "GAMMA", Policy::kOff},
    {kBrightness, "BRIGHTNESS", Policy::kManual},
    {kIris, "IRIS", Policy::kManual},
    {kFocus, "FOCUS", Policy::kManual},
    {kTriggerDelay, "TRIGGER_DELAY", Policy::kOff},
    // A frame rate would cap the exposure.
    {kFrameRate, "FRAME_RATE", Policy::kOff},
};

}  // namespace

FeatureInquiry ParseFeatureInquiry(std::uint32_t quadlet) {
  FeatureInquiry inquiry;
  inquiry.present = (quadlet & kPresent) != 0;
  inquiry.absolute = (quadlet & kAbsolute) != 0;
  inquiry.readable = (quadlet & Bit(27)) != 0;
  inquiry.on_off = (quadlet & Bit(26)) != 0;
  inquiry.automatic = (quadlet & Bit(25)) != 0;
  inquiry.manual = (quadlet & Bit(24)) != 0;
  inquiry.minimum = Field(quadlet, 23, 12);
  inquiry.maximum = Field(quadlet, 11, 0);
  return inquiry;
}

FeatureValue ParseFeatureValue(std::uint32_t quadlet) {
  FeatureValue value;
  value.present = (quadlet & kPresent) != 0;
  value.absolute = (quadlet & kAbsolute) != 0;
  value.one_push = (quadlet & kOnePush) != 0;
  value.on = (quadlet & kOn) != 0;
  value.automatic = (quadlet & kAuto) != 0;
  value.value = Field(quadlet, 11, 0);
  value.value_u = Field(quadlet, 23, 12);
  return value;
}

float FloatFromQuadlet(std::uint32_t quadlet) { return std::bit_cast<float>(quadlet); }
std::uint32_t QuadletFromFloat(float value) { return std::bit_cast<std::uint32_t>(value); }

Result<Feature> Feature::Open(const Registers& registers, std::uint32_t offset,
                              std::string_view name) {
  Feature feature(registers, offset, std::string(name));
  const std::uint32_t inquiry_offset = offset - kFeatureInquiryBelow;
  OMNIHDR_ASSIGN(const std::uint32_t quadlet,
                 registers.Read(inquiry_offset, feature.name_ + " inquiry"));
  feature.inquiry_ = ParseFeatureInquiry(quadlet);
  if (feature.inquiry_.present && feature.inquiry_.absolute) {
    OMNIHDR_ASSIGN(feature.absolute_pointer_,
                   registers.Read(inquiry_offset + kAbsolutePointerAboveInquiry,
                                  feature.name_ + " absolute pointer"));
  }
  return feature;
}

Result<FeatureValue> Feature::SetManual(std::optional<std::uint32_t> value) const {
  OMNIHDR_ASSIGN(const std::uint32_t before, ReadRaw());
  std::uint32_t quadlet = (before & ~(kAbsolute | kOnePush | kAuto)) | kPresent | kOn;
  std::uint32_t mask = kAuto;
  if (value) {
    if (*value < inquiry_.minimum || *value > inquiry_.maximum) {
      return Fail(ErrorKind::kConfig, "{} ({:#05x}): {}: expected {} to {}", name_, offset_, *value,
                  inquiry_.minimum, inquiry_.maximum);
    }
    quadlet = (quadlet & ~kValue) | *value;
    mask |= kValue;
  }
  OMNIHDR_ASSIGN(const std::uint32_t after, registers_.WriteChecked(offset_, quadlet, mask, name_));
  return ParseFeatureValue(after);
}

Status Feature::SwitchOff() const {
  OMNIHDR_ASSIGN(const std::uint32_t before, ReadRaw());
  const std::uint32_t quadlet = (before & ~(kAbsolute | kOnePush | kOn | kAuto)) | kPresent;
  OMNIHDR_TRY(registers_.WriteChecked(offset_, quadlet, kOn, name_));
  return {};
}

Status Feature::SetAutomatic() const {
  OMNIHDR_ASSIGN(const std::uint32_t before, ReadRaw());
  const std::uint32_t quadlet = (before & ~kOnePush) | kPresent | kOn | kAuto;
  OMNIHDR_TRY(registers_.WriteChecked(offset_, quadlet, kOn | kAuto, name_));
  return {};
}

Result<FeatureValue> Feature::SetManualPair(std::uint32_t u, std::uint32_t v) const {
  for (const std::uint32_t value : {u, v}) {
    if (value < inquiry_.minimum || value > inquiry_.maximum) {
      return Fail(ErrorKind::kConfig, "{} ({:#05x}): {}: expected {} to {}", name_, offset_, value,
                  inquiry_.minimum, inquiry_.maximum);
    }
  }
  const std::uint32_t quadlet = kPresent | kOn | u << 12 | v;
  OMNIHDR_ASSIGN(const std::uint32_t after,
                 registers_.WriteChecked(offset_, quadlet, kOn | kAuto | 0xFFFFFF, name_));
  return ParseFeatureValue(after);
}

Result<Registers> Feature::Absolute() const {
  if (!inquiry_.present || !inquiry_.absolute || absolute_pointer_ == 0) {
    return Fail(ErrorKind::kConfig, "{} ({:#05x}): the camera has no absolute values of it", name_,
                offset_ - kFeatureInquiryBelow);
  }
  return registers_.At(absolute_pointer_);
}

Result<AbsoluteRange> Feature::ReadRange() const {
  OMNIHDR_ASSIGN(const Registers absolute, Absolute());
  OMNIHDR_ASSIGN(const std::uint32_t low, absolute.Read(kAbsoluteMinimum, name_ + " minimum"));
  OMNIHDR_ASSIGN(const std::uint32_t high, absolute.Read(kAbsoluteMaximum, name_ + " maximum"));
  const AbsoluteRange range{FloatFromQuadlet(low), FloatFromQuadlet(high)};
  if (!std::isfinite(range.minimum) || !std::isfinite(range.maximum) ||
      range.minimum > range.maximum) {
    return Fail(ErrorKind::kProtocol, "{}: range {} to {} ({:#010x}, {:#010x}): expected numbers",
                name_, range.minimum, range.maximum, low, high);
  }
  return range;
}

Result<double> Feature::ReadAbsolute() const {
  OMNIHDR_ASSIGN(const Registers absolute, Absolute());
  OMNIHDR_ASSIGN(const std::uint32_t quadlet, absolute.Read(kAbsoluteValue, name_ + " value"));
  const double value = FloatFromQuadlet(quadlet);
  if (!std::isfinite(value)) {
    return Fail(ErrorKind::kProtocol, "{} value: {:#010x}: expected a number", name_, quadlet);
  }
  return value;
}

Result<Feature::Set> Feature::SetAbsolute(double value) const {
  OMNIHDR_ASSIGN(const Registers absolute, Absolute());
  OMNIHDR_ASSIGN(const std::uint32_t before, ReadRaw());
  const std::uint32_t control = (before & kValue) | kPresent | kAbsolute | kOn;
  // Already as it should be most of the time.
  if ((before & (kAbsolute | kOnePush | kOn | kAuto)) != (kAbsolute | kOn)) {
    OMNIHDR_TRY(registers_.WriteChecked(offset_, control, kAbsolute | kOn | kAuto, name_));
  }
  OMNIHDR_TRY(absolute.Write(kAbsoluteValue, QuadletFromFloat(static_cast<float>(value)),
                             name_ + " value"));
  Set set;
  OMNIHDR_ASSIGN(set.value, ReadAbsolute());
  OMNIHDR_ASSIGN(const std::uint32_t after, ReadRaw());
  set.raw = after & kValue;
  return set;
}

Result<std::vector<SettledFeature>> SettleFeatures(const Registers& registers,
                                                   const FixedSettings& settings) {
  std::vector<SettledFeature> settled;
  for (const FeaturePolicy& each : kPolicies) {
    OMNIHDR_ASSIGN(const Feature feature, Feature::Open(registers, each.offset, each.name));
    if (!feature.inquiry().present) continue;
    const bool off = each.policy == Policy::kOff && feature.inquiry().on_off;
    if (off) {
      OMNIHDR_TRY(feature.SwitchOff());
    } else {
      OMNIHDR_TRY(feature.SetManual());
    }
    OMNIHDR_ASSIGN(const std::uint32_t quadlet, feature.ReadRaw());
    settled.push_back({feature.name(), quadlet, off});
  }
  OMNIHDR_ASSIGN(const Feature balance, Feature::Open(registers, kWhiteBalance, "WHITE_BALANCE"));
  if (balance.inquiry().present) {
    OMNIHDR_ASSIGN(const std::uint32_t before, balance.ReadRaw());
    const FeatureValue now = ParseFeatureValue(before);
    OMNIHDR_TRY(balance.SetManualPair(settings.white_balance_blue.value_or(now.value_u),
                                      settings.white_balance_red.value_or(now.value)));
    OMNIHDR_ASSIGN(const std::uint32_t quadlet, balance.ReadRaw());
    settled.push_back({balance.name(), quadlet, false});
  } else if (settings.white_balance_blue || settings.white_balance_red) {
    return Fail(ErrorKind::kConfig, "WHITE_BALANCE: the camera has none: expected none configured");
  }
  return settled;
}

}  // namespace omnihdr::iidc
