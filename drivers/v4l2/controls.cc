#include "drivers/v4l2/controls.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace omnihdr::v4l2 {
namespace {

constexpr std::size_t kMaxGroup = 8;
constexpr int kMaxControls = 256;
constexpr std::int64_t kMaxEntries = 64;

// What is switched off, in this order.
struct Off {
  std::uint32_t id;
  std::int64_t value;
  bool to_default = false;  // to what the driver calls the default instead
};
constexpr Off kOff[] = {
    {V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0},
    {V4L2_CID_AUTOGAIN, 0},
    {V4L2_CID_ISO_SENSITIVITY_AUTO, V4L2_ISO_SENSITIVITY_MANUAL},
    {V4L2_CID_AUTO_WHITE_BALANCE, 0},
    {V4L2_CID_AUTO_N_PRESET_WHITE_BALANCE, V4L2_WHITE_BALANCE_MANUAL},
    {V4L2_CID_AUTOBRIGHTNESS, 0},
    {V4L2_CID_HUE_AUTO, 0},
    {V4L2_CID_CHROMA_AGC, 0},
    {V4L2_CID_BACKLIGHT_COMPENSATION, 0},
    {V4L2_CID_WIDE_DYNAMIC_RANGE, 0},
    {V4L2_CID_IMAGE_STABILIZATION, 0},
    {V4L2_CID_SCENE_MODE, V4L2_SCENE_MODE_NONE},
    {V4L2_CID_FOCUS_AUTO, 0},
    {V4L2_CID_POWER_LINE_FREQUENCY, V4L2_CID_POWER_LINE_FREQUENCY_DISABLED},
    {V4L2_CID_TEST_PATTERN, 0},
    {V4L2_CID_DIGITAL_GAIN, 0, true},
};

// Told with the session: what shapes the pixels and stays as it is.
constexpr std::uint32_t kTold[] = {
    V4L2_CID_BRIGHTNESS,     V4L2_CID_CONTRAST,     V4L2_CID_SATURATION,
    V4L2_CID_GAMMA,          V4L2_CID_SHARPNESS,    V4L2_CID_WHITE_BALANCE_TEMPERATURE,
    V4L2_CID_RED_BALANCE,    V4L2_CID_BLUE_BALANCE, V4L2_CID_BLACK_LEVEL,
    V4L2_CID_FOCUS_ABSOLUTE, V4L2_CID_IRIS_ABSOLUTE};

std::string Spelled(const Control& control) {
  return fmt::format("control \"{}\" ({:#010x})", control.name, control.id);
}

Status SwitchOff(const Controls& controls, const Control& control, std::int64_t value,
                 std::vector<FixedControl>& fixed) {
  OMNIHDR_ASSIGN(std::int64_t now, controls.Get(control));
  if (now != value && control.writable()) {
    const Wanted wanted{control, value};
    OMNIHDR_ASSIGN(const std::vector<Applied> applied, controls.Set({&wanted, 1}));
    now = applied.front().read;
  }
  if (now != value) {
    return Fail(ErrorKind::kConfig, "{}: {}: stays so, expected {}{}", Spelled(control), now, value,
                control.writable() ? "" : " (it cannot be written)");
  }
  fixed.push_back({control.name, now});
  return {};
}

Status SwitchOffExposure(const Controls& controls, std::vector<FixedControl>& fixed) {
  OMNIHDR_ASSIGN(const std::optional<Control> mode, controls.Find(V4L2_CID_EXPOSURE_AUTO));
  if (!mode) return {};
  for (const std::int64_t manual : {V4L2_EXPOSURE_MANUAL, V4L2_EXPOSURE_SHUTTER_PRIORITY}) {
    if (!controls.HasEntry(*mode, manual)) continue;
    return SwitchOff(controls, *mode, manual, fixed);
  }
  return Fail(ErrorKind::kConfig,
              "{}: has no manual mode: expected entry {} (manual) or {} (shutter priority)",
              Spelled(*mode), static_cast<int>(V4L2_EXPOSURE_MANUAL),
              static_cast<int>(V4L2_EXPOSURE_SHUTTER_PRIORITY));
}

}  // namespace

bool Control::writable() const {
  return (flags & (V4L2_CTRL_FLAG_READ_ONLY | V4L2_CTRL_FLAG_GRABBED)) == 0;
}

std::int64_t Control::Nearest(std::int64_t wanted) const {
  const std::int64_t inside = std::clamp(wanted, minimum, maximum);
  const auto above = static_cast<std::uint64_t>(inside) - static_cast<std::uint64_t>(minimum);
  const auto size = static_cast<std::uint64_t>(step);
  std::uint64_t down = above / size * size;
  if (above - down >= size - (above - down) &&
      down + size <= static_cast<std::uint64_t>(maximum) - static_cast<std::uint64_t>(minimum)) {
    down += size;
  }
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(minimum) + down);
}

namespace {

Control Described(const v4l2_query_ext_ctrl& query) {
  Control control;
  control.id = query.id;
  control.name = std::string(query.name, strnlen(query.name, sizeof query.name));
  for (char& c : control.name) {
    if (c < 0x20 || c > 0x7E) c = '?';
  }
  control.type = query.type;
  control.minimum = query.minimum;
  control.maximum = query.maximum;
  control.step = static_cast<std::int64_t>(std::clamp<std::uint64_t>(query.step, 1, INT64_MAX));
  control.default_value = query.default_value;
  control.flags = query.flags;
  return control;
}

Status CheckRange(const Control& control) {
  if (control.minimum > control.maximum) {
    return Fail(ErrorKind::kProtocol, "{}: range {} to {}: expected a range", Spelled(control),
                control.minimum, control.maximum);
  }
  return {};
}

bool HoldsANumber(const v4l2_query_ext_ctrl& query) {
  switch (query.type) {
    case V4L2_CTRL_TYPE_INTEGER:
    case V4L2_CTRL_TYPE_BOOLEAN:
    case V4L2_CTRL_TYPE_MENU:
    case V4L2_CTRL_TYPE_INTEGER_MENU:
    case V4L2_CTRL_TYPE_BITMASK:
    case V4L2_CTRL_TYPE_INTEGER64:
      return (query.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_HAS_PAYLOAD |
                             V4L2_CTRL_FLAG_WRITE_ONLY)) == 0;
    default:
      return false;
  }
}

}  // namespace

Result<std::optional<Control>> Controls::Find(std::uint32_t id) const {
  v4l2_query_ext_ctrl query{};
  query.id = id;
  const int called = device_->Ioctl(VIDIOC_QUERY_EXT_CTRL, &query);
  if (called == -EINVAL || called == -ENOTTY) return std::optional<Control>();
  if (called < 0) return FailCall(fmt::format("query control {:#010x}", id), called);
  if ((query.flags & V4L2_CTRL_FLAG_DISABLED) != 0 || query.id != id) {
    return std::optional<Control>();
  }
  Control control = Described(query);
  OMNIHDR_TRY(CheckRange(control));
  return std::optional<Control>(std::move(control));
}

Result<std::vector<Control>> Controls::List() const {
  std::vector<Control> controls;
  std::uint32_t last = 0;
  for (int i = 0; i < kMaxControls; ++i) {
    v4l2_query_ext_ctrl query{};
    query.id = last | V4L2_CTRL_FLAG_NEXT_CTRL;
    const int called = device_->Ioctl(VIDIOC_QUERY_EXT_CTRL, &query);
    if (called == -EINVAL || called == -ENOTTY) break;
    if (called < 0) return FailCall(fmt::format("query the control after {:#010x}", last), called);
    if (query.id <= last) {
      return Fail(ErrorKind::kProtocol, "control {:#010x} after {:#010x}: expected a higher number",
                  query.id, last);
    }
    last = query.id;
    if (!HoldsANumber(query)) continue;
    Control control = Described(query);
    OMNIHDR_TRY(CheckRange(control));
    controls.push_back(std::move(control));
  }
  return controls;
}

Result<std::int64_t> Controls::Get(const Control& control) const {
  v4l2_ext_control value{};
  value.id = control.id;
  v4l2_ext_controls group{};
  group.which = V4L2_CTRL_WHICH_CUR_VAL;
  group.count = 1;
  group.controls = &value;
  const int called = device_->Ioctl(VIDIOC_G_EXT_CTRLS, &group);
  if (called < 0) return FailCall(fmt::format("read {}", Spelled(control)), called);
  return control.type == V4L2_CTRL_TYPE_INTEGER64 ? std::int64_t{value.value64}
                                                  : std::int64_t{value.value};
}

Result<std::vector<Applied>> Controls::Set(std::span<const Wanted> wanted) const {
  if (wanted.empty() || wanted.size() > kMaxGroup) {
    return Fail(ErrorKind::kSoftware, "{} controls: expected 1 to {}", wanted.size(), kMaxGroup);
  }
  v4l2_ext_control values[kMaxGroup] = {};
  std::vector<Applied> applied;
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const Control& control = wanted[i].control;
    const std::int64_t value = control.Nearest(wanted[i].value);
    applied.push_back({control.id, control.name, wanted[i].value, value, value});
    values[i].id = control.id;
    if (control.type == V4L2_CTRL_TYPE_INTEGER64) {
      values[i].value64 = value;
    } else {
      values[i].value = static_cast<std::int32_t>(value);
    }
  }
  v4l2_ext_controls group{};
  group.which = V4L2_CTRL_WHICH_CUR_VAL;
  group.count = static_cast<std::uint32_t>(wanted.size());
  group.controls = values;
  const int called = device_->Ioctl(VIDIOC_S_EXT_CTRLS, &group);
  if (called < 0) {
    // With error_idx == count the driver does not say which one it was.
    std::string what = "set";
    for (std::size_t i = 0; i < wanted.size(); ++i) {
      if (group.error_idx < wanted.size() && group.error_idx != i) continue;
      const Control& control = wanted[i].control;
      what += fmt::format(" {} to {}, expected {} to {} in steps of {}", Spelled(control),
                          applied[i].written, control.minimum, control.maximum, control.step);
    }
    // How uvcvideo passes on that a camera refuses it for the state it is in.
    if (called == -EILSEQ) what += " (the camera is in no state for it)";
    return FailCall(what, called);
  }
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    OMNIHDR_ASSIGN(applied[i].read, Get(wanted[i].control));
  }
  return applied;
}

bool Controls::HasEntry(const Control& menu, std::int64_t index) const {
  if (index < menu.minimum || index > menu.maximum) return false;
  v4l2_querymenu query{};
  query.id = menu.id;
  query.index = static_cast<std::uint32_t>(index);
  return device_->Ioctl(VIDIOC_QUERYMENU, &query) >= 0;
}

std::vector<MenuEntry> Controls::Entries(const Control& menu) const {
  std::vector<MenuEntry> entries;
  for (std::int64_t i = menu.minimum; i <= menu.maximum && i < menu.minimum + kMaxEntries; ++i) {
    v4l2_querymenu query{};
    query.id = menu.id;
    query.index = static_cast<std::uint32_t>(i);
    if (device_->Ioctl(VIDIOC_QUERYMENU, &query) < 0) continue;
    if (menu.type == V4L2_CTRL_TYPE_INTEGER_MENU) {
      entries.push_back({i, fmt::format("{}", std::int64_t{query.value})});
      continue;
    }
    const char* name = reinterpret_cast<const char*>(query.name);
    entries.push_back({i, std::string(name, strnlen(name, sizeof query.name))});
  }
  return entries;
}

Result<std::vector<FixedControl>> SwitchOffAutomatic(const Controls& controls,
                                                     std::optional<int> white_balance) {
  std::vector<FixedControl> fixed;
  OMNIHDR_TRY(SwitchOffExposure(controls, fixed));
  for (const Off& off : kOff) {
    OMNIHDR_ASSIGN(const std::optional<Control> control, controls.Find(off.id));
    if (!control) continue;
    const std::int64_t value = off.to_default ? control->default_value : off.value;
    // A mode that the camera does not know cannot be left for it.
    if (control->type == V4L2_CTRL_TYPE_MENU && !controls.HasEntry(*control, value)) continue;
    // A range without the value, such as a backlight that begins at 1, has its lowest.
    OMNIHDR_TRY(SwitchOff(controls, *control, control->Nearest(value), fixed));
  }
  for (const std::uint32_t id : kTold) {
    OMNIHDR_ASSIGN(const std::optional<Control> control, controls.Find(id));
    if (!control) continue;
    if (id == V4L2_CID_WHITE_BALANCE_TEMPERATURE && white_balance) {
      OMNIHDR_TRY(SwitchOff(controls, *control, control->Nearest(*white_balance), fixed));
      continue;
    }
    OMNIHDR_ASSIGN(const std::int64_t value, controls.Get(*control));
    fixed.push_back({control->name, value});
  }
  return fixed;
}

}  // namespace omnihdr::v4l2
