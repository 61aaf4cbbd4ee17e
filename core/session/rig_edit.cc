#include "core/session/rig_edit.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/session/response_json.h"
#include "core/session/rig_file.h"
#include "core/session/toml.h"

namespace omnihdr {
namespace {

// Bytes [begin, end) of the text become `text`.
struct Splice {
  std::size_t begin = 0;
  std::size_t end = 0;
  std::string text;
};

std::string Spliced(std::string_view text, std::vector<Splice> splices) {
  std::stable_sort(splices.begin(), splices.end(),
                   [](const Splice& a, const Splice& b) { return a.begin < b.begin; });
  std::string result;
  std::size_t done = 0;
  for (const Splice& splice : splices) {
    result += text.substr(done, splice.begin - done);
    result += splice.text;
    done = splice.end;
  }
  result += text.substr(done);
  return result;
}

bool IsBlank(char c) { return c == ' ' || c == '\t'; }

// The place of one sensor's keys in the text of a valid rig.
class SensorTable {
 public:
  SensorTable(std::string_view text, const TomlDocument& document, std::size_t sensor)
      : text_(text), prefix_(fmt::format("sensor[{}].", sensor)) {
    for (const TomlEntry& entry : document.entries) {
      if (!entry.value || !entry.key.starts_with(prefix_)) continue;
      if (entry.key.find('.', prefix_.size()) != std::string::npos) continue;
      keys_.push_back(&entry);
      if (last_ == nullptr || entry.value->end > last_->end) last_ = &*entry.value;
    }
  }

  void Set(std::string_view key, const std::array<double, 3>& numbers) {
    const TomlValue* value = Find(key);
    if (value == nullptr) {
      Insert(key, fmt::format("[{}, {}, {}]", TomlText(numbers[0]), TomlText(numbers[1]),
                              TomlText(numbers[2])));
      return;
    }
    for (std::size_t c = 0; c < 3; ++c) {
      const TomlValue& item = value->items[c];
      const double before =
          item.type == TomlValue::Type::kInteger ? static_cast<double>(item.integer) : item.real;
      // By its text: a zero with a sign equals one without and is written otherwise.
      std::string number = TomlText(numbers[c]);
      if (TomlText(before) != number) splices_.push_back({item.begin, item.end, std::move(number)});
    }
  }

  void Set(std::string_view key, std::string_view text) {
    const TomlValue* value = Find(key);
    if (value == nullptr) {
      Insert(key, TomlText(text));
    } else if (value->text != text) {
      splices_.push_back({value->begin, value->end, TomlText(text)});
    }
  }

  std::string Edited() const { return Spliced(text_, splices_); }

 private:
  const TomlValue* Find(std::string_view key) const {
    for (const TomlEntry* entry : keys_) {
      if (std::string_view(entry->key).substr(prefix_.size()) == key) return &*entry->value;
    }
    return nullptr;
  }

  // Behind the sensor's last key: on a line of its own, or inside the braces of an inline table.
  void Insert(std::string_view key, const std::string& value) {
    std::size_t next = last_->end;
    while (next < text_.size() && IsBlank(text_[next])) ++next;
    if (next < text_.size() && (text_[next] == ',' || text_[next] == '}')) {
      splices_.push_back({last_->end, last_->end, fmt::format(", {} = {}", key, value)});
      return;
    }
    // The key's own line, which a value of several lines began further up, tells the indent.
    const std::size_t line_break =
        last_->begin == 0 ? text_.npos : text_.rfind('\n', last_->begin - 1);
    const std::size_t line = line_break == text_.npos ? 0 : line_break + 1;
    std::size_t indent = line;
    while (IsBlank(text_[indent])) ++indent;
    const std::size_t end = std::min(text_.find('\n', next), text_.size());
    const bool carriage = end > 0 && end < text_.size() && text_[end - 1] == '\r';
    const std::size_t at = carriage ? end - 1 : end;
    splices_.push_back({at, at,
                        fmt::format("{}{}{} = {}", carriage ? "\r\n" : "\n",
                                    text_.substr(line, indent - line), key, value)});
  }

  std::string_view text_;
  std::string prefix_;
  std::vector<const TomlEntry*> keys_;  // the sensor's own, not those of its lens grids
  const TomlValue* last_ = nullptr;     // a valid sensor has keys
  std::vector<Splice> splices_;
};

Result<std::string> EditOne(std::string_view text, const std::string& name, const RigEdit& edit) {
  OMNIHDR_ASSIGN(Rig rig, ParseRig(text, name));
  const auto sensor = std::find_if(rig.sensors.begin(), rig.sensors.end(),
                                   [&edit](const RigSensor& s) { return s.name == edit.sensor; });
  if (sensor == rig.sensors.end()) {
    std::vector<std::string> names;
    for (const RigSensor& s : rig.sensors) names.push_back(s.name);
    return Fail(ErrorKind::kUsage, "{}: no sensor \"{}\", expected one of {}", name, edit.sensor,
                fmt::join(names, ", "));
  }
  const TomlDocument document = ParseToml(text, kMaxRigBytes);
  SensorTable table(text, document, static_cast<std::size_t>(sensor - rig.sensors.begin()));
  if (edit.gain) {
    sensor->gain = *edit.gain;
    table.Set("gain", *edit.gain);
  }
  if (edit.vignetting) {
    sensor->vignetting.coefficients = *edit.vignetting;
    table.Set("vignetting", *edit.vignetting);
  }
  if (edit.response) {
    sensor->response_json = FormatResponse(*edit.response);
    table.Set("response", sensor->response_json);
  }
  std::string edited = table.Edited();
  const Result<Rig> again = ParseRig(edited, name);
  if (!again) return Forward(again.error(), "with what was calibrated");
  if (FormatRig(*again) != FormatRig(rig)) {
    return Fail(ErrorKind::kData,
                "{}: sensor \"{}\": cannot be changed where it stands, expected its keys on lines "
                "of their own",
                name, edit.sensor);
  }
  return edited;
}

}  // namespace

Result<std::string> EditRig(std::string_view text, const std::string& name,
                            std::span<const RigEdit> edits) {
  std::string edited(text);
  for (const RigEdit& edit : edits) {
    OMNIHDR_ASSIGN(edited, EditOne(edited, name, edit));
  }
  return edited;
}

Status EditRigFile(const std::filesystem::path& path, std::span<const RigEdit> edits) {
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(path, kMaxRigBytes));
  OMNIHDR_ASSIGN(const std::string edited, EditRig(text, path.string(), edits));
  return WriteFileAtomic(path, edited);
}

}  // namespace omnihdr
