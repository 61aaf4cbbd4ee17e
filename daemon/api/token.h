#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "core/base/result.h"

namespace omnihdr {

// The secret that TCP clients of the API present: "Authorization: Bearer TOKEN".

inline constexpr std::size_t kMinTokenBytes = 16;
inline constexpr std::size_t kMaxTokenBytes = 512;
// Name of the service manager's credential that is used where no file is configured.
inline constexpr std::string_view kTokenCredential = "api-token";

// The token in a file: visible ASCII characters, a newline at the end does not count. Refuses
// (kPermission) a file that others than its owner may read or change, or that is neither root's nor
// ours; a credential of the service manager may be readable by a group, which is how it is handed
// over.
Result<std::string> ReadToken(const std::filesystem::path& file, bool credential);

// The configured file, else the service manager's credential. kConfig when there is neither.
Result<std::string> FindToken(const std::string& configured_file);

// Whether they are equal, in a time that depends on the presented text's length alone.
bool SameToken(std::string_view presented, std::string_view token);

}  // namespace omnihdr
