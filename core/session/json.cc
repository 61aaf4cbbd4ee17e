#include "core/session/json.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>

namespace omnihdr::json {
namespace {

constexpr std::size_t kShownValueBytes = 60;

int LineOfOffset(std::string_view text, std::size_t offset) {
  return 1 + static_cast<int>(std::count(
                 text.begin(),
                 text.begin() + static_cast<std::ptrdiff_t>(std::min(offset, text.size())), '\n'));
}

// The line on which the last key of a dotted path stands, or its innermost parent when it is
// missing. Looks for the quoted names one after the other; the parser gives no positions.
int LineOfPath(const Source& source, std::string_view path) {
  std::size_t offset = 0;
  while (!path.empty()) {
    const std::size_t dot = path.find('.');
    const std::string_view name = path.substr(0, dot);
    path = dot == std::string_view::npos ? std::string_view() : path.substr(dot + 1);
    const std::size_t found = source.text.find('"' + std::string(name) + '"', offset);
    if (found == std::string_view::npos) break;
    offset = found;
  }
  return LineOfOffset(source.text, offset);
}

std::string Place(const Source& source, int line) {
  return fmt::format("{}:{}", source.name, source.line > 0 ? source.line : line);
}

// Depth of the deepest bracket outside strings.
int Depth(std::string_view text) {
  int depth = 0;
  int deepest = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') {
        ++i;
      } else if (c == '"') {
        in_string = false;
      }
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      deepest = std::max(deepest, ++depth);
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return deepest;
}

struct NonFinite {
  std::string key;
  std::string token;
  std::size_t offset = 0;
};

bool IsNonFiniteToken(std::string_view token) {
  std::string lower(token);
  std::transform(lower.begin(), lower.end(), lower.begin(), [](char c) {
    return static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  });
  if (!lower.empty() && (lower[0] == '-' || lower[0] == '+')) lower.erase(0, 1);
  if (lower == "nan" || lower == "inf" || lower == "infinity") return true;
  if (lower.empty() || std::isdigit(static_cast<unsigned char>(lower[0])) == 0) return false;
  char* end = nullptr;
  const double value = std::strtod(lower.c_str(), &end);
  return *end == '\0' && std::isinf(value);
}

// What other writers put for a number that JSON cannot hold: NaN, -Infinity, 1e999. Found so that
// the message can name the key.
std::optional<NonFinite> FindNonFinite(std::string_view text) {
  std::string_view last_string;
  std::string_view key;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '"') {
      const std::size_t begin = i + 1;
      for (++i; i < text.size() && text[i] != '"'; ++i) {
        if (text[i] == '\\') ++i;
      }
      last_string = text.substr(std::min(begin, text.size()),
                                std::min(i, text.size()) - std::min(begin, text.size()));
    } else if (c == ':') {
      key = last_string;
    } else if (std::string_view(" \t\r\n{}[],").find(c) == std::string_view::npos) {
      const std::size_t begin = i;
      while (i < text.size() &&
             std::string_view(" \t\r\n{}[],:\"").find(text[i]) == std::string_view::npos) {
        ++i;
      }
      const std::string_view token = text.substr(begin, i - begin);
      if (token.size() < 400 && IsNonFiniteToken(token)) {
        return NonFinite{std::string(key), std::string(token), begin};
      }
      --i;
    }
  }
  return std::nullopt;
}

std::string Dump(const Json& value) {
  return value.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string Shown(const Json& value) {
  std::string text = Dump(value);
  if (text.size() > kShownValueBytes) {
    std::size_t cut = kShownValueBytes;
    while (cut > 0 && (static_cast<unsigned char>(text[cut]) & 0xC0U) == 0x80U) --cut;
    text.resize(cut);
    text += "...";
  }
  return text;
}

}  // namespace

Result<Json> Parse(const Source& source) {
  const int depth = Depth(source.text);
  if (depth > kMaxDepth) {
    return Fail(ErrorKind::kData, "{}: nested {} deep, expected at most {}", Place(source, 1),
                depth, kMaxDepth);
  }
  try {
    return Json::parse(source.text);
  } catch (const Json::exception& exception) {
    if (const std::optional<NonFinite> bad = FindNonFinite(source.text)) {
      return Fail(ErrorKind::kData, "{}: {}: {}, expected a finite number",
                  Place(source, LineOfOffset(source.text, bad->offset)), bad->key,
                  bad->token.substr(0, kShownValueBytes));
    }
    std::string reason = exception.what();
    std::size_t offset = 0;
    if (const auto* at = dynamic_cast<const Json::parse_error*>(&exception)) {
      offset = at->byte > 0 ? at->byte - 1 : 0;
    }
    // "[json.exception.parse_error.101] parse error at line 1, column 3: syntax error ...": the
    // line is that of this text, not of the file.
    if (const std::size_t column = reason.find("column "); column != std::string::npos) {
      reason = reason.substr(column);
    }
    if (reason.size() > 300) reason = reason.substr(0, 300) + "...";
    // The library quotes what it read, which need not be UTF-8.
    reason = Dump(Json(reason));
    reason = reason.substr(1, reason.size() - 2);
    return Fail(ErrorKind::kData, "{}: not JSON: {}",
                Place(source, LineOfOffset(source.text, offset)), reason);
  }
}

std::optional<std::string> Compact(std::string_view text) {
  const Result<Json> value = Parse({"", text, 0});
  if (!value) return std::nullopt;
  return Dump(*value);
}

Result<ObjectReader> ObjectReader::Root(const Source& source, const Json& value) {
  if (!value.is_object()) {
    return Fail(ErrorKind::kData, "{}: {}, expected a JSON object", Place(source, 1), Shown(value));
  }
  return ObjectReader(&source, &value, "");
}

std::string ObjectReader::PathOf(std::string_view key) const {
  return path_.empty() ? std::string(key) : fmt::format("{}.{}", path_, key);
}

const Json* ObjectReader::Find(std::string_view key) const {
  const auto found = value_->find(std::string(key));
  return found == value_->end() || found->is_null() ? nullptr : &*found;
}

bool ObjectReader::Has(std::string_view key) const { return Find(key) != nullptr; }

tl::unexpected<Error> ObjectReader::Wrong(std::string_view key, std::string_view expected) const {
  const std::string path = PathOf(key);
  const auto found = value_->find(std::string(key));
  return Fail(ErrorKind::kData, "{}: {}: {}, expected {}",
              Place(*source_, LineOfPath(*source_, path)), path,
              found == value_->end() ? "missing" : Shown(*found), expected);
}

Result<ObjectReader> ObjectReader::Object(std::string_view key) const {
  const Json* value = Find(key);
  if (value == nullptr || !value->is_object()) return Wrong(key, "a JSON object");
  return ObjectReader(source_, value, PathOf(key));
}

Result<const Json*> ObjectReader::Array(std::string_view key, std::string_view expected) const {
  const Json* value = Find(key);
  if (value == nullptr || !value->is_array()) return Wrong(key, expected);
  return value;
}

Result<std::string> ObjectReader::String(std::string_view key, std::string_view expected) const {
  const Json* value = Find(key);
  if (value == nullptr || !value->is_string()) return Wrong(key, expected);
  return value->get_ref<const std::string&>();
}

Result<std::string> ObjectReader::StringOr(std::string_view key, std::string fallback) const {
  if (!Has(key)) return fallback;
  return String(key, "a string");
}

Result<bool> ObjectReader::BoolOr(std::string_view key, bool fallback) const {
  const Json* value = Find(key);
  if (value == nullptr) return fallback;
  if (!value->is_boolean()) return Wrong(key, "true or false");
  return value->get<bool>();
}

Result<double> ObjectReader::Number(std::string_view key, double low, double high,
                                    std::string_view expected) const {
  const Json* value = Find(key);
  if (value == nullptr) return Wrong(key, expected);
  const std::optional<double> number = FiniteNumber(*value);
  if (!number || *number < low || *number > high) return Wrong(key, expected);
  return *number;
}

Result<double> ObjectReader::NumberOr(std::string_view key, double fallback, double low,
                                      double high, std::string_view expected) const {
  if (!Has(key)) return fallback;
  return Number(key, low, high, expected);
}

Result<std::int64_t> ObjectReader::Integer(std::string_view key, std::int64_t low,
                                           std::int64_t high, std::string_view expected) const {
  const Json* value = Find(key);
  if (value == nullptr) return Wrong(key, expected);
  const std::optional<std::int64_t> number = WholeNumber(*value, low, high);
  if (!number) return Wrong(key, expected);
  return *number;
}

Result<std::int64_t> ObjectReader::IntegerOr(std::string_view key, std::int64_t fallback,
                                             std::int64_t low, std::int64_t high,
                                             std::string_view expected) const {
  if (!Has(key)) return fallback;
  return Integer(key, low, high, expected);
}

Result<Eigen::Quaterniond> ObjectReader::Quaternion(std::string_view key) const {
  constexpr std::string_view kExpected = "a unit quaternion [w, x, y, z]";
  OMNIHDR_ASSIGN(const Json* array, Array(key, kExpected));
  if (array->size() != 4) return Wrong(key, kExpected);
  std::array<double, 4> q{};
  for (std::size_t i = 0; i < 4; ++i) {
    const std::optional<double> number = FiniteNumber((*array)[i]);
    if (!number || std::abs(*number) > 2.0) return Wrong(key, kExpected);
    q[i] = *number;
  }
  Eigen::Quaterniond quaternion(q[0], q[1], q[2], q[3]);
  const double off = std::abs(quaternion.norm() - 1.0);
  if (!(off <= 1e-3)) return Wrong(key, kExpected);
  // Our own values pass through unchanged, to the last bit.
  if (off > 1e-9) quaternion.normalize();
  return quaternion;
}

Result<Pose> ObjectReader::ReadPose(std::string_view key) const {
  OMNIHDR_ASSIGN(const ObjectReader object, Object(key));
  Pose pose;
  OMNIHDR_ASSIGN(pose.rotation, object.Quaternion("q"));
  constexpr std::string_view kExpected = "three finite numbers [x, y, z]";
  OMNIHDR_ASSIGN(const Json* translation, object.Array("t", kExpected));
  if (translation->size() != 3) return object.Wrong("t", kExpected);
  for (std::size_t i = 0; i < 3; ++i) {
    const std::optional<double> number = FiniteNumber((*translation)[i]);
    if (!number) return object.Wrong("t", kExpected);
    pose.translation[static_cast<Eigen::Index>(i)] = *number;
  }
  return pose;
}

std::optional<double> FiniteNumber(const Json& value) {
  if (!value.is_number()) return std::nullopt;
  const auto number = value.get<double>();
  if (!std::isfinite(number)) return std::nullopt;
  return number;
}

std::optional<std::int64_t> WholeNumber(const Json& value, std::int64_t low, std::int64_t high) {
  std::int64_t number = 0;
  if (value.is_number_unsigned()) {
    const auto unsigned_number = value.get<std::uint64_t>();
    if (unsigned_number > static_cast<std::uint64_t>(INT64_MAX)) return std::nullopt;
    number = static_cast<std::int64_t>(unsigned_number);
  } else if (value.is_number_integer()) {
    number = value.get<std::int64_t>();
  } else if (value.is_number_float()) {
    const auto real = value.get<double>();
    // Beyond 2^53 a double does not say which whole number was meant.
    if (!(std::abs(real) <= 9007199254740992.0) || real != std::floor(real)) return std::nullopt;
    number = static_cast<std::int64_t>(real);
  } else {
    return std::nullopt;
  }
  if (number < low || number > high) return std::nullopt;
  return number;
}

void ObjectWriter::Key(std::string_view key) {
  text_ += text_.empty() ? (lines_ ? "{\n " : "{") : (lines_ ? ",\n " : ", ");
  text_ += Dump(Json(std::string(key)));
  text_ += ": ";
  keys_.emplace_back(key);
}

ObjectWriter& ObjectWriter::Add(std::string_view key, const Json& value) {
  Key(key);
  text_ += Dump(value);
  return *this;
}

ObjectWriter& ObjectWriter::AddRaw(std::string_view key, std::string_view json_text) {
  const std::optional<std::string> compact = Compact(json_text);
  Key(key);
  text_ += compact ? *compact : Dump(Json(std::string(json_text)));
  return *this;
}

ObjectWriter& ObjectWriter::AddObject(std::string_view key, ObjectWriter object) {
  Key(key);
  text_ += std::move(object).Finish();
  return *this;
}

ObjectWriter& ObjectWriter::AddMembers(std::string_view json_object) {
  const Result<Json> object = Parse({"", json_object, 0});
  if (!object || !object->is_object()) return *this;
  for (const auto& [key, value] : object->items()) {
    if (std::find(keys_.begin(), keys_.end(), key) == keys_.end()) Add(key, value);
  }
  return *this;
}

std::string ObjectWriter::Finish() && {
  if (text_.empty()) return "{}";
  text_ += lines_ ? "\n}\n" : "}";
  return std::move(text_);
}

Json QuaternionJson(const Eigen::Quaterniond& q) { return Json{q.w(), q.x(), q.y(), q.z()}; }

ObjectWriter PoseObject(const Pose& pose) {
  ObjectWriter writer;
  writer.Add("q", QuaternionJson(pose.rotation));
  writer.Add("t", Json{pose.translation.x(), pose.translation.y(), pose.translation.z()});
  return writer;
}

}  // namespace omnihdr::json
