#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "daemon/config.h"
#include "daemon/doctor/machine.h"

namespace omnihdr::doctor {

enum class Verdict {
  kGood,
  kSkipped,  // could not be looked at, or need not be: says why
  kWarning,  // works, and may not do so for long or not as well as expected
  kProblem,  // does not work
};
std::string_view ToString(Verdict verdict);

// What one check found. Law: a warning and a problem have a remedy; a problem's remedy is what to
// type where typing helps.
struct Diagnosis {
  std::string check;  // "camera", "usb-memory", ...
  Verdict verdict = Verdict::kGood;
  std::string found;
  std::string remedy;
};

struct DoctorOptions {
  std::filesystem::path config{kDefaultConfigFile};
  bool config_must_exist = true;
  // For whom devices must be open; "" = the service's user when there is one, else the caller.
  std::string user;
  // Pictures a second that the storage must take; 0 = as the configuration's trigger says.
  double pictures_per_second = 0.0;
  bool measure_disk = true;
  Nanoseconds timeout = std::chrono::seconds(2);  // of each connection
};

// Looks at everything the configuration names, and at what the machine needs for it. Nothing is
// changed but for a few pictures written and removed again (measure_disk); GPIO lines and cameras
// are looked at, not opened. Never fails: what cannot be looked at is a diagnosis.
std::vector<Diagnosis> Examine(const DoctorOptions& options, const Machine& machine);

}  // namespace omnihdr::doctor
