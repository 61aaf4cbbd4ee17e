#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/sphere/pose.h"

// Reading and writing JSON with errors that name file, line, key, value and expectation. Private to
// core/session: no other folder includes it.
namespace omnihdr::json {

using Json = nlohmann::json;

// Deeper nesting is refused: everything that walks a value recursively stays within a small stack.
inline constexpr int kMaxDepth = 64;

// Text of one JSON value and where it stands, for messages.
struct Source {
  std::string name;
  std::string_view text;
  // Line of the whole text when it is one line of a larger file (journal); 0 = look the key's line
  // up.
  int line = 0;
};

// Parses one value. Never throws; numbers that overflow, bad UTF-8 and NaN are errors (kData).
Result<Json> Parse(const Source& source);

// The compact text of one JSON value, if `text` is one: what is embedded in our own files.
std::optional<std::string> Compact(std::string_view text);

// One object of a Source and the dotted path that leads to it.
class ObjectReader {
 public:
  // `value` must be an object; checked by Object() below and by Root().
  static Result<ObjectReader> Root(const Source& source, const Json& value);

  bool Has(std::string_view key) const;  // present and not null
  // Errors: "file:line: path.key: value, expected <expected>".
  tl::unexpected<Error> Wrong(std::string_view key, std::string_view expected) const;

  Result<ObjectReader> Object(std::string_view key) const;
  Result<const Json*> Array(std::string_view key, std::string_view expected) const;
  Result<std::string> String(std::string_view key, std::string_view expected) const;
  Result<std::string> StringOr(std::string_view key, std::string fallback) const;
  Result<bool> BoolOr(std::string_view key, bool fallback) const;
  // A finite number in [low, high].
  Result<double> Number(std::string_view key, double low, double high,
                        std::string_view expected) const;
  Result<double> NumberOr(std::string_view key, double fallback, double low, double high,
                          std::string_view expected) const;
  // A whole number in [low, high]; 5.0 counts as 5.
  Result<std::int64_t> Integer(std::string_view key, std::int64_t low, std::int64_t high,
                               std::string_view expected) const;
  Result<std::int64_t> IntegerOr(std::string_view key, std::int64_t fallback, std::int64_t low,
                                 std::int64_t high, std::string_view expected) const;
  // [w, x, y, z] of unit length; normalised when the writer rounded it.
  Result<Eigen::Quaterniond> Quaternion(std::string_view key) const;
  // {"q": [w, x, y, z], "t": [x, y, z]}
  Result<Pose> ReadPose(std::string_view key) const;

  const Json& value() const { return *value_; }
  const Json* Find(std::string_view key) const;  // null values count as absent

 private:
  ObjectReader(const Source* source, const Json* value, std::string path)
      : source_(source), value_(value), path_(std::move(path)) {}
  std::string PathOf(std::string_view key) const;

  const Source* source_;
  const Json* value_;
  std::string path_;
};

// Value as a finite double, if it is one.
std::optional<double> FiniteNumber(const Json& value);
// Value as a whole number within [low, high], if it is one.
std::optional<std::int64_t> WholeNumber(const Json& value, std::int64_t low, std::int64_t high);

// Writes one object: members in the order added, doubles so that they read back exactly, bad UTF-8
// replaced by U+FFFD, NaN and infinities as null.
class ObjectWriter {
 public:
  // `lines`: every member on its own line (files for people); else all on one (journal).
  explicit ObjectWriter(bool lines = false) : lines_(lines) {}
  ObjectWriter& Add(std::string_view key, const Json& value);
  // `json_text` is one JSON value; text that is not becomes a JSON string.
  ObjectWriter& AddRaw(std::string_view key, std::string_view json_text);
  ObjectWriter& AddObject(std::string_view key, ObjectWriter object);
  // Every member of a JSON object given as text that this object does not have yet; text that is
  // not an object adds nothing.
  ObjectWriter& AddMembers(std::string_view json_object);
  std::string Finish() &&;

 private:
  void Key(std::string_view key);
  bool lines_;
  std::string text_;
  std::vector<std::string> keys_;
};

// [w, x, y, z]
Json QuaternionJson(const Eigen::Quaterniond& q);
// {"q": [w, x, y, z], "t": [x, y, z]}
ObjectWriter PoseObject(const Pose& pose);

}  // namespace omnihdr::json
