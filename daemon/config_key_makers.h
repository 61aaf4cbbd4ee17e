#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/tcp.h"
#include "daemon/config_keys.h"

// Makers of configuration keys, so that a key is one line of a table.
namespace omnihdr::config_key_makers {

namespace fs = std::filesystem;

// Every maker takes an accessor from a config to the member, so that a key is one line below.
template <typename T>
using Member = T& (*)(DaemonConfig&);

template <typename T>
T Get(DaemonConfig copy, Member<T> member) {
  return member(copy);
}

inline std::optional<double> AsNumber(const TomlValue& value) {
  if (value.type == TomlValue::Type::kFloat && std::isfinite(value.real)) return value.real;
  if (value.type == TomlValue::Type::kInteger) return static_cast<double>(value.integer);
  return std::nullopt;
}

inline ConfigKey Number(std::string name, std::string_view unit, double low, double high,
                        Member<double> member) {
  return {std::move(name), fmt::format("{} in [{:g}, {:g}]", unit, low, high),
          [=](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            const std::optional<double> number = AsNumber(value);
            if (!number || *number < low || *number > high) return false;
            member(config) = *number;
            return true;
          },
          [=](const DaemonConfig& config) { return TomlText(Get(config, member)); }};
}

// 0 switches off; else a number in [low, high].
inline ConfigKey NumberOrZero(std::string name, std::string_view unit, std::string_view zero,
                              double low, double high, Member<double> member) {
  return {std::move(name), fmt::format("{} in [{:g}, {:g}], or 0 {}", unit, low, high, zero),
          [=](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            const std::optional<double> number = AsNumber(value);
            if (!number || (*number != 0.0 && (*number < low || *number > high))) return false;
            member(config) = *number;
            return true;
          },
          [=](const DaemonConfig& config) { return TomlText(Get(config, member)); }};
}

template <typename T>
ConfigKey Whole(std::string name, std::string_view unit, std::int64_t low, std::int64_t high,
                Member<T> member) {
  return {std::move(name), fmt::format("{} in [{}, {}]", unit, low, high),
          [=](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kInteger || value.integer < low ||
                value.integer > high) {
              return false;
            }
            member(config) = static_cast<T>(value.integer);
            return true;
          },
          [=](const DaemonConfig& config) { return fmt::format("{}", Get(config, member)); }};
}

// An even number of pixels in [low, high], or 0 when `zero` says what that means.
inline ConfigKey EvenPixels(std::string name, std::string_view zero, int low, int high,
                            Member<int> member) {
  const bool zero_allowed = !zero.empty();
  return {std::move(name),
          fmt::format("an even number of pixels in [{}, {}]{}{}", low, high,
                      zero_allowed ? ", or 0 " : "", zero),
          [=](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kInteger) return false;
            const bool in_range =
                value.integer >= low && value.integer <= high && value.integer % 2 == 0;
            if (!in_range && !(zero_allowed && value.integer == 0)) return false;
            member(config) = static_cast<int>(value.integer);
            return true;
          },
          [=](const DaemonConfig& config) { return fmt::format("{}", Get(config, member)); }};
}

inline ConfigKey Switch(std::string name, Member<bool> member) {
  return {std::move(name), "true or false",
          [=](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kBoolean) return false;
            member(config) = value.boolean;
            return true;
          },
          [=](const DaemonConfig& config) {
            return std::string(Get(config, member) ? "true" : "false");
          }};
}

template <typename T>
std::string_view NameOf(T value) {
  return ToString(value);
}

inline std::string_view NameOf(ProcessMode mode) {
  switch (mode) {
    case ProcessMode::kAuto:
      return "auto";
    case ProcessMode::kSpatiotemporal:
      return "spatiotemporal";
    case ProcessMode::kTemporal:
      return "temporal";
  }
  return "?";
}

inline std::string_view NameOf(OutputOrientation orientation) {
  return orientation == OutputOrientation::kAligned ? "aligned" : "camera";
}

inline std::string_view NameOf(ExrPixelType type) {
  return type == ExrPixelType::kFloat ? "float" : "half";
}

inline std::string_view NameOf(NanPixels nan) {
  switch (nan) {
    case NanPixels::kNever:
      return "never";
    case NanPixels::kNoData:
      return "no-data";
    case NanPixels::kUnmeasured:
      return "unmeasured";
  }
  return "?";
}

inline std::string_view NameOf(MergeWeights weights) {
  return weights == MergeWeights::kHat ? "hat" : "inverse-variance";
}

inline std::string_view NameOf(Demosaic demosaic) {
  return demosaic == Demosaic::kEdgeAware ? "edge-aware" : "bilinear";
}

template <typename T>
ConfigKey Choice(std::string name, std::vector<T> values, Member<T> member) {
  std::string expected;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (i > 0) expected += i + 1 == values.size() ? " or " : ", ";
    expected += TomlText(NameOf(values[i]));
  }
  return {std::move(name), std::move(expected),
          [=](DaemonConfig& config, const TomlValue& toml, const fs::path&) {
            if (toml.type != TomlValue::Type::kString) return false;
            for (const T value : values) {
              if (NameOf(value) != toml.text) continue;
              member(config) = value;
              return true;
            }
            return false;
          },
          [=](const DaemonConfig& config) { return TomlText(NameOf(Get(config, member))); }};
}

enum class Empty { kAllowed, kRefused };

inline ConfigKey Path(std::string name, std::string_view expected, Empty empty,
                      std::size_t max_bytes, Member<std::string> member) {
  return {std::move(name), std::string(expected),
          [=](DaemonConfig& config, const TomlValue& value, const fs::path& directory) {
            if (value.type != TomlValue::Type::kString) return false;
            if (value.text.empty()) {
              if (empty == Empty::kRefused) return false;
              member(config).clear();
              return true;
            }
            if (value.text.find('\0') != std::string::npos) return false;
            const fs::path path(value.text);
            const std::string resolved =
                path.is_absolute() ? path.string() : (directory / path).lexically_normal().string();
            if (resolved.size() > max_bytes) return false;
            member(config) = resolved;
            return true;
          },
          [=](const DaemonConfig& config) { return TomlText(Get(config, member)); }};
}

// Text of at most `max_bytes` without control characters; may be empty.
inline ConfigKey Text(std::string name, std::string_view expected, std::size_t max_bytes,
                      Member<std::string> member) {
  return {std::move(name), fmt::format("{} of at most {} bytes, or \"\"", expected, max_bytes),
          [=](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kString || value.text.size() > max_bytes ||
                std::any_of(value.text.begin(), value.text.end(), [](char c) {
                  return static_cast<unsigned char>(c) < 0x20 || c == 0x7F;
                })) {
              return false;
            }
            member(config) = value.text;
            return true;
          },
          [=](const DaemonConfig& config) { return TomlText(Get(config, member)); }};
}

inline ConfigKey Address(std::string name, Member<std::string> member) {
  return {std::move(name), "a numeric IPv4 or IPv6 address",
          [=](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kString || !IsNumericAddress(value.text)) {
              return false;
            }
            member(config) = value.text;
            return true;
          },
          [=](const DaemonConfig& config) { return TomlText(Get(config, member)); }};
}

}  // namespace omnihdr::config_key_makers

// A lambda from the config to a member, as the makers want it.
#define OMNIHDR_MEMBER(member) +[](DaemonConfig& c) -> decltype((c.member)) { return c.member; }
