#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace omnihdr {

// A TOML value as far as keys of our files use them.
struct TomlValue {
  enum class Type { kBoolean, kInteger, kFloat, kString, kArray, kOther };
  Type type = Type::kOther;
  bool boolean = false;
  std::int64_t integer = 0;
  double real = 0.0;
  std::string text;
  std::vector<TomlValue> items;
  // Where it stands: bytes [begin, end) of the text, quotes and brackets included.
  std::size_t begin = 0;
  std::size_t end = 0;
};

// A value for messages and for `config show`: TOML, shortened when it is long.
std::string ShownToml(const TomlValue& value);
// TOML text that reads back as the same value (and is JSON too).
std::string TomlText(double value);
std::string TomlText(std::string_view value);

// One key (value set) or one section heading (no value) of a file.
struct TomlEntry {
  // Dotted; a part that is not a bare key is quoted. The tables of an array of tables count from 0:
  // the second [[sensor]] is the heading "sensor[1]", its keys are "sensor[1].name".
  std::string key;
  std::optional<TomlValue> value;
  int line = 0;
};

struct TomlDocument {
  std::vector<TomlEntry> entries;  // in the order of lines
  // Why the text is not TOML.
  std::string error;
  int error_line = 0;
};

inline constexpr std::size_t kMaxTomlBytes = std::size_t{1} << 20;

// Parses untrusted text: size, UTF-8 and nesting are checked before the TOML library sees it. Never
// throws. Memory is bounded by some 200 times `max_bytes`.
TomlDocument ParseToml(std::string_view text, std::size_t max_bytes = kMaxTomlBytes);

}  // namespace omnihdr
