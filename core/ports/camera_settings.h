#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"

namespace omnihdr {

// One thing that can be set at a camera by hand.
struct CameraSetting {
  std::string name;     // as Set takes it
  std::string value;    // as it is, as Set takes it: a number, "off", "auto", ...
  std::string allowed;  // what Set takes: "1 to 5000 in steps of 1", "0 (Off), 1 (50 Hz)"
  std::string note;     // what else there is to say: "read only"; empty = nothing
};

// What became of a setting.
struct CameraSettingChange {
  std::string name;
  std::string asked;
  std::string value;  // read back
  std::string allowed;
  bool as_asked = false;  // to what the camera's own steps allow
};

// The settings of one camera that is not in use, for whoever brings it up. One thread.
class CameraSettings {
 public:
  virtual ~CameraSettings() = default;
  // Which camera it is, for messages.
  virtual std::string camera() const = 0;
  // Whether the settings survive Camera::Open, as a sentence.
  virtual std::string lasting() const = 0;
  virtual Result<std::vector<CameraSetting>> List() = 0;
  // kUsage, with what is allowed, when there is no such setting or value.
  virtual Result<CameraSettingChange> Set(const std::string& name, const std::string& value) = 0;
};

}  // namespace omnihdr
