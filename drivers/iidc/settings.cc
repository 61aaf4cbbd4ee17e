#include "drivers/iidc/settings.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/iidc/features.h"
#include "drivers/iidc/find_camera.h"
#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

struct Named {
  std::string_view name;
  std::uint32_t offset;
  std::string_view unit;  // of its absolute value
};
constexpr Named kFeatures[] = {
    {"brightness", kBrightness, "%"},
    {"auto_exposure", kAutoExposure, "EV"},
    {"sharpness", kSharpness, ""},
    {"white_balance", kWhiteBalance, "K"},
    {"hue", kHue, "deg"},
    {"saturation", kSaturation, "%"},
    {"gamma", kGamma, ""},
    {"shutter", kShutter, "s"},
    {"gain", kGain, "dB"},
    {"iris", kIris, "F"},
    {"focus", kFocus, "m"},
    {"temperature", kTemperature, "K"},
    {"trigger_delay", kTriggerDelay, "s"},
    {"frame_rate", kFrameRate, "1/s"},
};
// Of the value: cameras quantise absolute values without saying how.
constexpr double kCloseEnough = 0.02;
constexpr std::uint32_t kLargestOffset = 0xFFFFC;

template <typename T>
std::optional<T> NumberIn(std::string_view text, int base = 10) {
  T number{};
  std::from_chars_result read{};
  if constexpr (std::is_floating_point_v<T>) {
    read = std::from_chars(text.data(), text.data() + text.size(), number);
    if (!std::isfinite(number)) return std::nullopt;
  } else {
    read = std::from_chars(text.data(), text.data() + text.size(), number, base);
  }
  if (read.ec != std::errc{} || read.ptr != text.data() + text.size()) return std::nullopt;
  return number;
}

// "0x1f" or "31".
std::optional<std::uint32_t> Quadlet(std::string_view text) {
  if (text.starts_with("0x")) return NumberIn<std::uint32_t>(text.substr(2), 16);
  return NumberIn<std::uint32_t>(text);
}

class IidcSettings final : public CameraSettings {
 public:
  IidcSettings(FoundCamera found, const RegisterTimeouts& timeouts)
      : found_(std::move(found)), registers_(*found_.link, found_.rom.command_base, timeouts) {}

  std::string camera() const override {
    return fmt::format("{} {} {} (serial {})", found_.link->name(), FormatGuid(found_.rom.guid),
                       found_.rom.model, found_.serial);
  }
  std::string lasting() const override {
    return "the camera keeps it until it is opened for pictures, which initialises it, or loses "
           "power";
  }

  Result<std::vector<CameraSetting>> List() override {
    std::vector<CameraSetting> settings;
    for (const Named& each : kFeatures) {
      OMNIHDR_ASSIGN(const Feature feature, Feature::Open(registers_, each.offset, each.name));
      if (!feature.inquiry().present) continue;
      CameraSetting setting;
      setting.name = each.name;
      OMNIHDR_ASSIGN(setting.value, Now(each, feature));
      OMNIHDR_ASSIGN(setting.allowed, Allowed(each, feature));
      if (!feature.inquiry().manual) setting.note = "read only";
      settings.push_back(std::move(setting));
    }
    return settings;
  }

  Result<CameraSettingChange> Set(const std::string& name, const std::string& value) override {
    if (name.starts_with("0x")) return SetRegister(name, value);
    std::string names;
    for (const Named& each : kFeatures) {
      if (each.name == name) return SetFeature(each, value);
      names += fmt::format("{}{}", names.empty() ? "" : ", ", each.name);
    }
    return Fail(ErrorKind::kUsage, "{}: expected a register (0x...) or one of {}", name, names);
  }

 private:
  static bool IsAbsolute(const Feature& feature) { return feature.inquiry().absolute; }

  Result<std::string> Now(const Named& named, const Feature& feature) const {
    if (!feature.inquiry().readable) return std::string("?");
    OMNIHDR_ASSIGN(const std::uint32_t quadlet, feature.ReadRaw());
    const FeatureValue value = ParseFeatureValue(quadlet);
    if (feature.inquiry().on_off && !value.on) return std::string("off");
    std::string text;
    if (named.offset == kWhiteBalance) {
      text = fmt::format("{},{}", value.value_u, value.value);
    } else if (IsAbsolute(feature) && value.absolute) {
      OMNIHDR_ASSIGN(const double absolute, feature.ReadAbsolute());
      text = fmt::format("{:.6g}", absolute);
    } else {
      text = fmt::format("{}{}", IsAbsolute(feature) ? "raw:" : "", value.value);
    }
    return value.automatic ? "auto (" + text + ")" : text;
  }

  Result<std::string> Allowed(const Named& named, const Feature& feature) const {
    const FeatureInquiry& inquiry = feature.inquiry();
    std::string text;
    if (named.offset == kWhiteBalance) {
      text = fmt::format("BLUE,RED, each {} to {}", inquiry.minimum, inquiry.maximum);
    } else if (IsAbsolute(feature)) {
      OMNIHDR_ASSIGN(const AbsoluteRange range, feature.ReadRange());
      text =
          fmt::format("{:.6g} to {:.6g}{}{}, raw:{} to raw:{}", range.minimum, range.maximum,
                      named.unit.empty() ? "" : " ", named.unit, inquiry.minimum, inquiry.maximum);
    } else {
      text = fmt::format("{} to {}", inquiry.minimum, inquiry.maximum);
    }
    if (inquiry.on_off) text += ", off";
    if (inquiry.automatic) text += ", auto";
    return text;
  }

  Result<CameraSettingChange> SetFeature(const Named& named, const std::string& value) {
    OMNIHDR_ASSIGN(const Feature feature, Feature::Open(registers_, named.offset, named.name));
    if (!feature.inquiry().present) {
      return Fail(ErrorKind::kUsage, "{}: the camera has no such feature", named.name);
    }
    CameraSettingChange change{std::string(named.name), value, "", ""};
    OMNIHDR_ASSIGN(change.allowed, Allowed(named, feature));
    OMNIHDR_ASSIGN(const bool understood, Write(named, feature, value, change));
    if (!understood) {
      return Fail(ErrorKind::kUsage, "{}={}: expected {}", named.name, value, change.allowed);
    }
    OMNIHDR_ASSIGN(change.value, Now(named, feature));
    return change;
  }

  // false: the feature does not take that value, and nothing was written.
  Result<bool> Write(const Named& named, const Feature& feature, std::string_view value,
                     CameraSettingChange& change) const {
    const FeatureInquiry& inquiry = feature.inquiry();
    const auto inside = [&inquiry](std::optional<std::uint32_t> raw) {
      return raw && *raw >= inquiry.minimum && *raw <= inquiry.maximum;
    };
    // What is written below is read back and held against it there.
    change.as_asked = true;
    if (value == "off") {
      if (!inquiry.on_off) return false;
      OMNIHDR_TRY(feature.SwitchOff());
      return true;
    }
    if (value == "auto") {
      if (!inquiry.automatic) return false;
      OMNIHDR_TRY(feature.SetAutomatic());
      return true;
    }
    if (named.offset == kWhiteBalance) {
      const std::size_t comma = value.find(',');
      if (comma == std::string_view::npos) return false;
      const auto blue = NumberIn<std::uint32_t>(value.substr(0, comma));
      const auto red = NumberIn<std::uint32_t>(value.substr(comma + 1));
      if (!inside(blue) || !inside(red)) return false;
      OMNIHDR_TRY(feature.SetManualPair(*blue, *red));
      return true;
    }
    const bool raw = value.starts_with("raw:");
    if (raw) value.remove_prefix(4);
    if (raw || !IsAbsolute(feature)) {
      const auto number = NumberIn<std::uint32_t>(value);
      if (!inside(number)) return false;
      OMNIHDR_TRY(feature.SetManual(number));
      return true;
    }
    const auto number = NumberIn<double>(value);
    OMNIHDR_ASSIGN(const AbsoluteRange range, feature.ReadRange());
    if (!number || *number < range.minimum || *number > range.maximum) return false;
    OMNIHDR_ASSIGN(const Feature::Set set, feature.SetAbsolute(*number));
    change.as_asked = std::abs(set.value - *number) <= kCloseEnough * std::abs(*number);
    return true;
  }

  Result<CameraSettingChange> SetRegister(const std::string& name, const std::string& value) {
    const auto offset = NumberIn<std::uint32_t>(std::string_view(name).substr(2), 16);
    if (!offset || *offset % 4 != 0 || *offset > kLargestOffset) {
      return Fail(ErrorKind::kUsage, "{}: expected an offset of a quadlet, 0x000 to {:#x}", name,
                  kLargestOffset);
    }
    CameraSettingChange change{name, value, "", "0x00000000 to 0xffffffff"};
    const auto quadlet = Quadlet(value);
    if (!quadlet) {
      return Fail(ErrorKind::kUsage, "{}={}: expected {}", name, value, change.allowed);
    }
    OMNIHDR_TRY(registers_.Write(*offset, *quadlet, name));
    OMNIHDR_ASSIGN(const std::uint32_t read, registers_.Read(*offset, name));
    change.value = fmt::format("{:#010x}", read);
    change.as_asked = read == *quadlet;
    return change;
  }

  FoundCamera found_;
  Registers registers_;
};

}  // namespace

Result<std::unique_ptr<CameraSettings>> OpenSettings(LinkFinder& finder, const std::string& id,
                                                     const RegisterTimeouts& timeouts) {
  OMNIHDR_ASSIGN(FoundCamera found, FindCamera(finder, id, timeouts).Context("IIDC camera"));
  return std::unique_ptr<CameraSettings>(
      std::make_unique<IidcSettings>(std::move(found), timeouts));
}

}  // namespace omnihdr::iidc
