#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "daemon/doctor/doctor.h"

namespace omnihdr::doctor {

struct BundleOptions {
  DoctorOptions doctor;           // whose configuration, user, ...
  std::filesystem::path out;      // FILE.tar.gz
  std::filesystem::path session;  // empty: the newest in session.directory
};

struct BundleReport {
  std::vector<std::string> files;    // in the bundle
  std::vector<std::string> missing;  // "what: why", of what could not be had
  std::uint64_t bytes = 0;           // of the bundle
};

// What somebody far away needs to help: state, diagnosis, configuration, the end of logs and
// journal, versions, facts of kernel and USB, headers of sessions; works with the daemon down. Law:
// no pixels, no secrets (see WithoutSecrets), no places (lat, lon and alt_m are left out); at most
// 1 MiB a file and 16 MiB in all before it is packed. Errors: the bundle cannot be written.
Result<BundleReport> WriteSupportBundle(const BundleOptions& options, const Machine& machine);

// `text` with the values of what is named like a secret (password, secret, token, credential,
// private, a key) in `key = value`, `"key": "value"` and `key=value`, and passwords in URLs,
// replaced by "(removed)".
std::string WithoutSecrets(const std::string& text);

}  // namespace omnihdr::doctor
