#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "drivers/v4l2/device.h"

namespace omnihdr::v4l2 {

// A control as the driver describes it.
struct Control {
  std::uint32_t id = 0;
  std::string name;
  std::uint32_t type = 0;
  std::int64_t minimum = 0;
  std::int64_t maximum = 0;
  std::int64_t step = 1;  // at least 1
  std::int64_t default_value = 0;
  std::uint32_t flags = 0;
  bool writable() const;  // not read-only, not grabbed; one that is inactive can be written
  // The value nearest to `wanted` that range and step allow.
  std::int64_t Nearest(std::int64_t wanted) const;
};

struct Wanted {
  Control control;
  std::int64_t value = 0;
};
// What became of a wanted value. `written` differs from `asked` when the range or the step did not
// allow it, `read` from `written` when the device made something else of it.
struct Applied {
  std::uint32_t id = 0;
  std::string name;
  std::int64_t asked = 0;
  std::int64_t written = 0;
  std::int64_t read = 0;
  bool clamped() const { return asked != written || written != read; }
};

struct MenuEntry {
  std::int64_t index = 0;
  std::string name;  // of an integer menu: its value
};

// The controls of a device. Errors name control, value and what was expected.
class Controls {
 public:
  explicit Controls(V4l2Device& device) : device_(&device) {}
  // Nothing when the device has no such control. One whose range makes no sense is kProtocol.
  Result<std::optional<Control>> Find(std::uint32_t id) const;
  // All that hold a number, in the driver's order; at most 256.
  Result<std::vector<Control>> List() const;
  Result<std::int64_t> Get(const Control& control) const;
  // All in one call, so that they act together, and then read back.
  Result<std::vector<Applied>> Set(std::span<const Wanted> wanted) const;
  // Whether a menu has the entry.
  bool HasEntry(const Control& menu, std::int64_t index) const;
  std::vector<MenuEntry> Entries(const Control& menu) const;

 private:
  V4l2Device* device_;
};

// A setting that alters pixels by itself, as it is now.
struct FixedControl {
  std::string name;
  std::int64_t value = 0;
};

// Switches off everything that alters pixels by itself, exposure first, and holds what was read
// back against it; what a camera lacks is left out. `white_balance` is a colour temperature in
// kelvin, nothing = as it is. kConfig when something stays automatic.
Result<std::vector<FixedControl>> SwitchOffAutomatic(const Controls& controls,
                                                     std::optional<int> white_balance);

}  // namespace omnihdr::v4l2
