#include <fmt/format.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <array>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "core/session/response_json.h"
#include "core/session/rig_edit.h"
#include "core/session/rig_file.h"
#include "tests/property/generators.h"

namespace omnihdr::rig_edit_test {
namespace {

using testing::AnyPose;
using testing::Between;

bool Coin() { return *rc::gen::arbitrary<bool>(); }

std::array<double, 3> AnyGain() {
  return {*Between(0.1, 4.0), *Between(0.1, 4.0), *Between(0.1, 4.0)};
}

std::array<double, 3> AnyFalloff() {
  return {*Between(-0.3, 0.0), *Between(-0.1, 0.1), *Between(-0.02, 0.02)};
}

Response AnyResponse() {
  if (Coin()) return Response::Linear(*Between(0.0, 100.0)).value();
  std::array<std::array<double, 2>, 3> a_b{};
  for (auto& [a, b] : a_b) {
    a = *Between(0.001, 0.1);
    b = *Between(-10.0, 10.0);
  }
  return Response::LogLinear(a_b).value();
}

RigSensor AnySensor(int number) {
  RigSensor sensor;
  sensor.name = *rc::gen::element<std::string>("cam", "[[sensor]]", "# = 'x'", "\xC3\xA4~\"\\") +
                std::to_string(number);
  sensor.lens = Lens::Fisheye(*rc::gen::inRange(2, 2000) * 2, 480, {*Between(50.0, 2000.0), 300.0},
                              {100.0, 200.0}, {}, 1.2)
                    .value();
  sensor.camera_from_sensor = AnyPose();
  if (Coin()) sensor.gain = AnyGain();
  if (Coin()) sensor.vignetting.coefficients = AnyFalloff();
  if (Coin()) sensor.response_json = FormatResponse(AnyResponse());
  return sensor;
}

std::string Blanks() { return *rc::gen::element<std::string>("", "", " ", "  ", "\t", " \t "); }

std::string Remark() {
  return *rc::gen::element<std::string>("", "", " # a remark", "# gain = [9, 9, 9]", "#[[sensor]]",
                                        " # \xE2\x82\xAC ~ \"'''[{", "# response = '''");
}

// A value as somebody else would write it: arrays over several lines with remarks, texts in other
// quotes.
std::string Rewritten(const std::string& value, const std::string& end) {
  if (value.front() == '[' && Coin()) {
    std::string text;
    for (const char c : value) {
      text += c;
      if (c == '[' || c == ',') text += Remark() + end + Blanks();
    }
    if (Coin()) text.insert(text.size() - 1, ", ");
    return text;
  }
  if (value.front() == '"' && value.find('\'') == std::string::npos && Coin()) {
    // No escapes in literal texts.
    std::string text;
    for (std::size_t i = 1; i + 1 < value.size(); ++i) {
      if (value[i] == '\\') ++i;
      text += value[i];
    }
    return Coin() ? fmt::format("'{}'", text) : fmt::format("'''{}{}'''", end, text);
  }
  return value;
}

// The text of a rig with its layout shuffled: order of a sensor's keys, blanks, remarks, line ends.
std::string Disarranged(const std::string& text) {
  const std::string end = Coin() ? "\n" : "\r\n";
  std::string out;
  std::vector<std::string> keys;
  const auto flush = [&] {
    while (!keys.empty()) {
      const auto at = *rc::gen::inRange<std::size_t>(0, keys.size());
      out += keys[at];
      keys.erase(keys.begin() + static_cast<std::ptrdiff_t>(at));
      const int empty = *rc::gen::inRange(0, 3);
      for (int k = 0; k < empty; ++k) out += Blanks() + Remark() + end;
    }
  };
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t equals = line.find(" = ");
    if (line.starts_with("[[") || equals == std::string::npos) {
      flush();
      out += Blanks() + line + Remark() + end;
      continue;
    }
    std::string key = line.substr(0, equals);
    if (Coin()) key = Coin() ? fmt::format("\"{}\"", key) : fmt::format("'{}'", key);
    keys.push_back(Blanks() + key + Blanks() + "=" + Blanks() +
                   Rewritten(line.substr(equals + 3), end) + Remark() + end);
  }
  flush();
  if (Coin()) out.resize(out.size() - end.size());
  return out;
}

std::size_t Count(const std::string& text, std::string_view what) {
  std::size_t n = 0;
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++n;
  return n;
}

RC_GTEST_PROP(RigEditLaw, EditingTheTextIsChangingTheRig, ()) {
  Rig rig;
  const int sensors = *rc::gen::inRange(1, 4);
  for (int i = 0; i < sensors; ++i) rig.sensors.push_back(AnySensor(i));
  RC_PRE(rig.Validate().has_value());
  const std::string text = Disarranged(FormatRig(rig));
  const Result<Rig> before = ParseRig(text, "rig.toml");
  RC_ASSERT(before.has_value());

  Rig expected = *before;
  std::vector<RigEdit> edits(static_cast<std::size_t>(*rc::gen::inRange(0, 4)));
  for (RigEdit& edit : edits) {
    RigSensor& sensor =
        expected.sensors[*rc::gen::inRange<std::size_t>(0, expected.sensors.size())];
    edit.sensor = sensor.name;
    if (Coin()) edit.gain = sensor.gain = AnyGain();
    if (Coin()) {
      edit.vignetting = AnyFalloff();
      sensor.vignetting.coefficients = *edit.vignetting;
    }
    if (Coin()) {
      edit.response = AnyResponse();
      sensor.response_json = FormatResponse(*edit.response);
    }
  }
  RC_PRE(expected.Validate().has_value());
  const Result<std::string> edited = EditRig(text, "rig.toml", edits);
  RC_ASSERT(edited.has_value());
  const Result<Rig> after = ParseRig(*edited, "rig.toml");
  RC_ASSERT(after.has_value());
  RC_ASSERT(FormatRig(*after) == FormatRig(expected));
  // Remarks and line ends outlive it; new keys bring one line end each.
  RC_ASSERT(Count(*edited, "a remark") == Count(text, "a remark"));
  RC_ASSERT(Count(*edited, "#") == Count(text, "#"));
  RC_ASSERT((Count(*edited, "\r\n") == 0) == (Count(text, "\r\n") == 0));
  // Once more changes nothing.
  RC_ASSERT(*EditRig(*edited, "rig.toml", edits.empty() ? edits : std::vector{edits.back()}) ==
            *edited);
}

}  // namespace
}  // namespace omnihdr::rig_edit_test
