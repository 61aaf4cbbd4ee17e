#include "drivers/v4l2/settings.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <optional>
#include <utility>

#include "drivers/v4l2/controls.h"
#include "drivers/v4l2/find_camera.h"

namespace omnihdr::v4l2 {
namespace {

std::optional<std::int64_t> WholeNumber(const std::string& text) {
  std::int64_t number = 0;
  const char* end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, number);
  if (read.ec != std::errc{} || read.ptr != end) return std::nullopt;
  return number;
}

bool IsMenu(const Control& control) {
  return control.type == V4L2_CTRL_TYPE_MENU || control.type == V4L2_CTRL_TYPE_INTEGER_MENU;
}

class V4l2Settings final : public CameraSettings {
 public:
  V4l2Settings(FoundCamera found, std::unique_ptr<V4l2Device> controls_device)
      : found_(std::move(found)),
        controls_device_(std::move(controls_device)),
        controls_(controls_device_ ? *controls_device_ : *found_.device) {}

  std::string camera() const override {
    return fmt::format("{} {}{}", found_.node.path, found_.card,
                       found_.node.serial.empty() ? "" : " (serial " + found_.node.serial + ")");
  }
  std::string lasting() const override {
    return "the camera keeps it until it is unplugged; opened for pictures, everything automatic "
           "is "
           "switched off and exposure and gain are set anew, the rest stays";
  }

  Result<std::vector<CameraSetting>> List() override {
    std::vector<CameraSetting> settings;
    OMNIHDR_ASSIGN(const std::vector<Control> all, controls_.List());
    for (const Control& control : all) {
      CameraSetting setting;
      setting.name = SettingName(control.name);
      OMNIHDR_ASSIGN(const std::int64_t value, controls_.Get(control));
      setting.value = fmt::format("{}", value);
      setting.allowed = Allowed(control);
      if (!control.writable()) {
        setting.note = "read only";
      } else if ((control.flags & V4L2_CTRL_FLAG_INACTIVE) != 0) {
        setting.note = "without effect while another control rules it";
      }
      settings.push_back(std::move(setting));
    }
    return settings;
  }

  Result<CameraSettingChange> Set(const std::string& name, const std::string& value) override {
    OMNIHDR_ASSIGN(const std::vector<Control> all, controls_.List());
    std::string names;
    for (const Control& control : all) {
      if (SettingName(control.name) == name) return SetControl(control, name, value);
      names += fmt::format("{}{}", names.empty() ? "" : ", ", SettingName(control.name));
    }
    return Fail(ErrorKind::kUsage, "{}: expected one of {}", name, names);
  }

 private:
  std::string Allowed(const Control& control) const {
    if (control.type == V4L2_CTRL_TYPE_BOOLEAN) {
      return fmt::format("0 or 1, default {}", control.default_value);
    }
    if (!IsMenu(control)) {
      return fmt::format("{} to {} in steps of {}, default {}", control.minimum, control.maximum,
                         control.step, control.default_value);
    }
    std::string text;
    for (const MenuEntry& entry : controls_.Entries(control)) {
      text += fmt::format("{}{} ({})", text.empty() ? "" : ", ", entry.index, entry.name);
    }
    return fmt::format("{}, default {}", text, control.default_value);
  }

  std::optional<std::int64_t> Meaning(const Control& control, const std::string& value) const {
    if (value == "default") return control.default_value;
    const std::optional<std::int64_t> number = WholeNumber(value);
    if (IsMenu(control)) {
      for (const MenuEntry& entry : controls_.Entries(control)) {
        if (entry.name == value || (number && entry.index == *number)) return entry.index;
      }
      return std::nullopt;
    }
    if (!number || *number < control.minimum || *number > control.maximum) return std::nullopt;
    return number;
  }

  Result<CameraSettingChange> SetControl(const Control& control, const std::string& name,
                                         const std::string& value) {
    CameraSettingChange change{name, value, "", Allowed(control)};
    const std::optional<std::int64_t> wanted = Meaning(control, value);
    if (!wanted) {
      return Fail(ErrorKind::kUsage, "{}={}: expected {}", name, value, change.allowed);
    }
    if (!control.writable()) {
      return Fail(ErrorKind::kUsage, "{}={}: it is read only", name, value);
    }
    const Wanted set{control, *wanted};
    OMNIHDR_ASSIGN(const std::vector<Applied> applied, controls_.Set({&set, 1}));
    change.value = fmt::format("{}", applied.front().read);
    change.as_asked = applied.front().read == *wanted;
    return change;
  }

  FoundCamera found_;
  std::unique_ptr<V4l2Device> controls_device_;
  Controls controls_;
};

}  // namespace

std::string SettingName(const std::string& control) {
  std::string name;
  for (const char c : control) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
      name += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    } else if (!name.empty() && name.back() != '_') {
      name += '_';
    }
  }
  if (!name.empty() && name.back() == '_') name.pop_back();
  return name;
}

Result<std::vector<std::unique_ptr<CameraSettings>>> OpenSettings(
    V4l2System& system, const V4l2CameraOptions& options) {
  std::vector<std::string> devices = options.devices;
  if (devices.empty()) devices.push_back(options.device);
  std::vector<std::unique_ptr<CameraSettings>> settings;
  for (const std::string& device : devices) {
    OMNIHDR_ASSIGN(FoundCamera found, FindCamera(system, device).Context("V4L2 camera"));
    std::unique_ptr<V4l2Device> controls;
    if (!options.controls_device.empty()) {
      controls = system.MakeDevice();
      const int opened = controls->Open(options.controls_device);
      if (opened < 0) return FailCall(fmt::format("open {}", options.controls_device), opened);
    }
    settings.push_back(std::make_unique<V4l2Settings>(std::move(found), std::move(controls)));
  }
  return settings;
}

}  // namespace omnihdr::v4l2
