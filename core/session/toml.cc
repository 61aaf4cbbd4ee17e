#include "core/session/toml.h"

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

// The library runs into undefined behaviour at some characters beyond ASCII (U+020C in a key,
// U+00E9 after a line-ending backslash). It therefore sees ASCII only: such a byte, and "~" itself,
// becomes
// "~XX". "~" has no meaning in TOML: inside quotes and comments it is text, elsewhere an error.
std::string Encode(std::string_view text) {
  std::string encoded;
  encoded.reserve(text.size());
  for (const char c : text) {
    if (static_cast<unsigned char>(c) >= 0x80 || c == '~') {
      encoded += fmt::format("~{:02X}", static_cast<unsigned>(static_cast<unsigned char>(c)));
    } else {
      encoded += c;
    }
  }
  return encoded;
}

std::string Decode(std::string_view encoded) {
  const auto digit = [&](std::size_t at) {
    const char c = at < encoded.size() ? encoded[at] : '?';
    return c >= '0' && c <= '9' ? c - '0' : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
  };
  std::string text;
  for (std::size_t i = 0; i < encoded.size(); ++i) {
    if (encoded[i] == '~' && digit(i + 1) >= 0 && digit(i + 2) >= 0) {
      text += static_cast<char>(digit(i + 1) * 16 + digit(i + 2));
      i += 2;
    } else {
      text += encoded[i];
    }
  }
  return text;
}

// Offset of "~" written as an escape, which Decode could not tell from its own; npos when there is
// none.
std::size_t FindEscapedTilde(std::string_view text) {
  for (std::size_t i = text.find('\\'); i != std::string_view::npos; i = text.find('\\', i + 1)) {
    std::string escape(text.substr(i + 1, 9));
    std::replace(escape.begin(), escape.end(), 'e', 'E');
    if (escape.starts_with("u007E") || escape == "U0000007E") return i;
  }
  return std::string_view::npos;
}

std::string_view LineAt(std::string_view text, int line) {
  for (; line > 1 && !text.empty(); --line) {
    text.remove_prefix(std::min(text.find('\n'), text.size() - 1) + 1);
  }
  return text.substr(0, text.find('\n'));
}

// What the library says of encoded text, in terms of the text itself.
std::string ErrorText(const toml::parse_error& error, std::string_view encoded) {
  const std::string_view line = LineAt(encoded, static_cast<int>(error.source().begin.line));
  const std::size_t column = std::max<std::size_t>(error.source().begin.column, 1);
  const std::string before = Decode(line.substr(0, std::min(column - 1, line.size())));
  const std::ptrdiff_t characters = std::count_if(before.begin(), before.end(), [](char c) {
    return (static_cast<unsigned char>(c) & 0xC0U) != 0x80U;
  });
  std::string message = Decode(error.description());
  const std::string seen = Decode(line.substr(std::min(column - 1, line.size()), 3));
  if (const std::size_t tilde = message.find("'~'");
      tilde != std::string::npos && !seen.starts_with('~')) {
    message.replace(tilde, 3, "a character beyond ASCII");
  }
  return fmt::format("column {}: {}", characters + 1, message);
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

// From the library's lines and columns of the encoded text to bytes of the text.
class Places {
 public:
  // `skipped`: bytes before `text`.
  Places(std::string_view text, std::size_t skipped) {
    lines_.push_back(0);
    for (std::size_t i = 0; i < text.size(); ++i) {
      const bool one = static_cast<unsigned char>(text[i]) < 0x80 && text[i] != '~';
      offsets_.insert(offsets_.end(), one ? 1 : 3, static_cast<std::uint32_t>(skipped + i));
      if (text[i] == '\n') lines_.push_back(offsets_.size());
    }
    offsets_.push_back(static_cast<std::uint32_t>(skipped + text.size()));
  }
  std::size_t Of(const toml::source_position& at) const {
    const std::size_t line = std::clamp<std::size_t>(at.line, 1, lines_.size()) - 1;
    const std::size_t column = std::max<std::size_t>(at.column, 1) - 1;
    return offsets_[std::min(lines_[line] + column, offsets_.size() - 1)];
  }

 private:
  std::vector<std::size_t> lines_;      // where they begin in the encoded text
  std::vector<std::uint32_t> offsets_;  // of every encoded byte, and of the end
};

TomlValue Convert(const toml::node& node, const Places& places, int depth) {
  TomlValue value;
  value.begin = places.Of(node.source().begin);
  value.end = places.Of(node.source().end);
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
    value.text = Decode(text->get());
  } else if (const auto* array = node.as_array(); array != nullptr && depth < kMaxTableDepth) {
    value.type = TomlValue::Type::kArray;
    for (const toml::node& item : *array) {
      value.items.push_back(Convert(item, places, depth + 1));
    }
  } else {
    value.text = node.is_table()   ? "a section"
                 : node.is_array() ? "nested arrays"
                                   : "a date or time";
  }
  return value;
}

void Flatten(const toml::table& table, const Places& places, const std::string& prefix, int depth,
             std::vector<TomlEntry>& entries);

// `key`'s heading and what is below it.
void FlattenTable(const toml::table& table, const Places& places, const std::string& key, int line,
                  int depth, std::vector<TomlEntry>& entries) {
  TomlEntry entry{key, std::nullopt, line};
  if (depth >= kMaxTableDepth) {
    entry.value = TomlValue{};
    entry.value->text = "sections nested too deep";
  }
  entries.push_back(std::move(entry));
  if (depth < kMaxTableDepth) Flatten(table, places, key + ".", depth + 1, entries);
}

void Flatten(const toml::table& table, const Places& places, const std::string& prefix, int depth,
             std::vector<TomlEntry>& entries) {
  for (const auto& [name, node] : table) {
    const std::string key = prefix + KeyPart(Decode(name.str()));
    const int line = static_cast<int>(name.source().begin.line);
    const toml::array* array = node.as_array();
    if (const toml::table* child = node.as_table()) {
      FlattenTable(*child, places, key, line, depth, entries);
    } else if (array != nullptr && !array->empty() && array->is_array_of_tables()) {
      for (std::size_t i = 0; i < array->size(); ++i) {
        const toml::table* item = array->get(i)->as_table();
        FlattenTable(*item, places, fmt::format("{}[{}]", key, i),
                     static_cast<int>(item->source().begin.line), depth, entries);
      }
    } else {
      entries.push_back({key, Convert(node, places, 0), line});
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

TomlDocument ParseToml(std::string_view text, std::size_t max_bytes) {
  TomlDocument document;
  if (text.size() > max_bytes) {
    document.error = fmt::format("{} bytes, expected at most {}", text.size(), max_bytes);
    return document;
  }
  if (const std::size_t bad = FindBadUtf8(text); bad != std::string_view::npos) {
    document.error_line = LineOf(text, bad);
    document.error = fmt::format("byte 0x{:02x}, expected UTF-8 text",
                                 static_cast<unsigned>(static_cast<unsigned char>(text[bad])));
    return document;
  }
  const std::size_t skipped = text.starts_with("\xEF\xBB\xBF") ? 3 : 0;
  text.remove_prefix(skipped);
  if (const std::size_t tilde = FindEscapedTilde(text); tilde != std::string_view::npos) {
    document.error_line = LineOf(text, tilde);
    document.error = "\"~\" as an escape, expected the character itself";
    return document;
  }
  // The library looks a few bytes ahead; with line ends behind the text it always finds some.
  const std::string encoded = Encode(text) + "\n\n\n\n";
  try {
    const toml::table table = toml::parse(std::string_view(encoded));
    Flatten(table, Places(text, skipped), "", 0, document.entries);
  } catch (const toml::parse_error& error) {
    document.error_line = static_cast<int>(error.source().begin.line);
    document.error = ErrorText(error, encoded);
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
