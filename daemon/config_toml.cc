#include "daemon/config_toml.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>

// The library's assertions abort on some short malformed inputs, and in release builds it turns
// them into promises to the optimiser; without either it reports those inputs as errors.
#undef NDEBUG
#define TOML_ASSERT(condition) static_cast<void>(0)
#define TOML_HEADER_ONLY 1
#define TOML_EXCEPTIONS 1
#define TOML_MAX_NESTED_VALUES 32
#define TOML_ENABLE_UNRELEASED_FEATURES 0
#define TOML_ENABLE_FORMATTERS 0
#include <toml++/toml.h>

namespace omnihdr {
namespace {

constexpr std::size_t kShownBytes = 80;
// Keys of tables nest through headings ("[a.b.c...]") without limit in the library.
constexpr int kMaxTableDepth = 16;

// Offset of the first byte that is not well-formed UTF-8 (or is NUL); npos when there is none.
std::size_t FindBadUtf8(std::string_view text) {
  std::size_t i = 0;
  const auto byte = [&](std::size_t at) { return static_cast<unsigned char>(text[at]); };
  while (i < text.size()) {
    const unsigned char lead = byte(i);
    if (lead == 0) return i;
    std::size_t length = 1;
    std::uint32_t code = lead;
    if (lead >= 0x80) {
      if (lead >= 0xC2 && lead <= 0xDF) {
        length = 2;
        code = lead & 0x1FU;
      } else if ((lead & 0xF0U) == 0xE0U) {
        length = 3;
        code = lead & 0x0FU;
      } else if (lead >= 0xF0 && lead <= 0xF4) {
        length = 4;
        code = lead & 0x07U;
      } else {
        return i;
      }
      if (i + length > text.size()) return i;
      for (std::size_t k = 1; k < length; ++k) {
        if ((byte(i + k) & 0xC0U) != 0x80U) return i;
        code = (code << 6U) | (byte(i + k) & 0x3FU);
      }
      const bool overlong = (length == 3 && code < 0x800) || (length == 4 && code < 0x10000);
      if (overlong || code > 0x10FFFF || (code >= 0xD800 && code <= 0xDFFF)) return i;
    }
    i += length;
  }
  return std::string_view::npos;
}

// Behind the opening quote at `begin`: the offset behind the closing one. A string on one line ends
// with the line at the latest.
std::size_t SkipString(std::string_view text, std::size_t begin) {
  const char quote = text[begin];
  const std::string three(3, quote);
  const bool multi_line = text.substr(begin, 3) == three;
  std::size_t i = begin + (multi_line ? 3 : 1);
  for (; i < text.size(); ++i) {
    if (text[i] == '\\' && quote == '"' && i + 1 < text.size() && text[i + 1] != '\n') {
      ++i;
    } else if (multi_line && text.substr(i, 3) == three) {
      // Up to two quotes before the closing three belong to the string.
      i += 3;
      for (int k = 0; k < 2 && i < text.size() && text[i] == quote; ++k) ++i;
      return i;
    } else if (!multi_line && (text[i] == quote || text[i] == '\n')) {
      return i + 1;
    }
  }
  return text.size();
}

// Offset of the first character beyond ASCII outside comments and quotes, where TOML has none; npos
// when there is none. The library runs into undefined behaviour at some of them (U+020C in a key).
std::size_t FindStrayCharacter(std::string_view text) {
  std::size_t i = 0;
  while (i < text.size()) {
    if (static_cast<unsigned char>(text[i]) >= 0x80) return i;
    if (text[i] == '#') {
      i = std::min(text.find('\n', i), text.size());
    } else if (text[i] == '"' || text[i] == '\'') {
      i = SkipString(text, i);
    } else {
      ++i;
    }
  }
  return std::string_view::npos;
}

int LineOf(std::string_view text, std::size_t offset) {
  return 1 + static_cast<int>(std::count(text.begin(),
                                         text.begin() + static_cast<std::ptrdiff_t>(offset), '\n'));
}

std::string KeyPart(std::string_view part) {
  const bool bare = !part.empty() && std::all_of(part.begin(), part.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
           c == '-';
  });
  return bare ? std::string(part) : TomlText(part);
}

TomlValue Convert(const toml::node& node, int depth) {
  TomlValue value;
  if (const auto* boolean = node.as_boolean()) {
    value.type = TomlValue::Type::kBoolean;
    value.boolean = boolean->get();
  } else if (const auto* integer = node.as_integer()) {
    value.type = TomlValue::Type::kInteger;
    value.integer = integer->get();
  } else if (const auto* real = node.as_floating_point()) {
    value.type = TomlValue::Type::kFloat;
    value.real = real->get();
  } else if (const auto* text = node.as_string()) {
    value.type = TomlValue::Type::kString;
    value.text = text->get();
  } else if (const auto* array = node.as_array(); array != nullptr && depth < kMaxTableDepth) {
    value.type = TomlValue::Type::kArray;
    for (const toml::node& item : *array) value.items.push_back(Convert(item, depth + 1));
  } else {
    value.text = node.is_table()   ? "a section"
                 : node.is_array() ? "nested arrays"
                                   : "a date or time";
  }
  return value;
}

void Flatten(const toml::table& table, const std::string& prefix, int depth,
             std::vector<TomlEntry>& entries) {
  for (const auto& [key, node] : table) {
    TomlEntry entry;
    entry.key = prefix + KeyPart(key.str());
    entry.line = static_cast<int>(key.source().begin.line);
    const toml::table* child = node.as_table();
    if (child == nullptr) {
      entry.value = Convert(node, 0);
    } else if (depth >= kMaxTableDepth) {
      entry.value = TomlValue{};
      entry.value->text = "sections nested too deep";
    }
    entries.push_back(entry);
    if (child != nullptr && depth < kMaxTableDepth) {
      Flatten(*child, entry.key + ".", depth + 1, entries);
    }
  }
}

}  // namespace

std::string TomlText(double value) {
  if (std::isnan(value)) return "nan";
  if (std::isinf(value)) return value > 0.0 ? "inf" : "-inf";
  std::string text = fmt::format("{}", value);
  if (text.find_first_of(".e") == std::string::npos) text += ".0";
  return text;
}

std::string TomlText(std::string_view value) {
  std::string text = "\"";
  for (const char c : value) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\') {
      text += '\\';
      text += c;
    } else if (c == '\n') {
      text += "\\n";
    } else if (c == '\t') {
      text += "\\t";
    } else if (byte < 0x20 || byte == 0x7F) {
      text += fmt::format("\\u{:04X}", byte);
    } else {
      text += c;
    }
  }
  return text + '"';
}

std::string ShownToml(const TomlValue& value) {
  std::string text;
  switch (value.type) {
    case TomlValue::Type::kBoolean:
      text = value.boolean ? "true" : "false";
      break;
    case TomlValue::Type::kInteger:
      text = fmt::format("{}", value.integer);
      break;
    case TomlValue::Type::kFloat:
      text = TomlText(value.real);
      break;
    case TomlValue::Type::kString:
      text = TomlText(value.text);
      break;
    case TomlValue::Type::kArray: {
      text = "[";
      for (const TomlValue& item : value.items) {
        if (text.size() > kShownBytes) break;
        if (text.size() > 1) text += ", ";
        text += ShownToml(item);
      }
      text += "]";
      break;
    }
    case TomlValue::Type::kOther:
      text = value.text;
      break;
  }
  if (text.size() > kShownBytes) {
    std::size_t cut = kShownBytes;
    while (cut > 0 && (static_cast<unsigned char>(text[cut]) & 0xC0U) == 0x80U) --cut;
    text = text.substr(0, cut) + "...";
  }
  return text;
}

TomlDocument ParseToml(std::string_view text) {
  TomlDocument document;
  if (text.size() > kMaxConfigBytes) {
    document.error = fmt::format("{} bytes, expected at most {}", text.size(), kMaxConfigBytes);
    return document;
  }
  if (const std::size_t bad = FindBadUtf8(text); bad != std::string_view::npos) {
    document.error_line = LineOf(text, bad);
    document.error = fmt::format("byte 0x{:02x}, expected UTF-8 text",
                                 static_cast<unsigned>(static_cast<unsigned char>(text[bad])));
    return document;
  }
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  if (const std::size_t stray = FindStrayCharacter(text); stray != std::string_view::npos) {
    document.error_line = LineOf(text, stray);
    document.error = "a character beyond ASCII, expected only in quotes and comments";
    return document;
  }
  // The library looks a few bytes ahead; with line ends behind the text it always finds some.
  const std::string padded = std::string(text) + "\n\n\n\n";
  try {
    const toml::table table = toml::parse(std::string_view(padded));
    Flatten(table, "", 0, document.entries);
  } catch (const toml::parse_error& error) {
    document.error_line = static_cast<int>(error.source().begin.line);
    document.error =
        fmt::format("column {}: {}", error.source().begin.column, std::string(error.description()));
    document.entries.clear();
  } catch (const std::exception& error) {
    document.error = error.what();
    document.entries.clear();
  }
  std::stable_sort(document.entries.begin(), document.entries.end(),
                   [](const TomlEntry& a, const TomlEntry& b) { return a.line < b.line; });
  return document;
}

}  // namespace omnihdr
