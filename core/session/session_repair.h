#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/session/session_check.h"

namespace omnihdr {

// Brings a session back to what its programs can go on with. Laws: no byte that was captured is
// changed or deleted (what is in the way is moved to SESSION/lost+found, which has a list of it);
// only views that can be made again are removed; a second repair finds nothing to do; interrupted
// at any moment, it can be run again.

enum class RepairKind : std::uint8_t {
  kPutLineAside,  // a torn last line goes to lost+found, then the journal ends before it
  kEndLine,       // the last line gets its newline
  kPutFileAside,  // a file that no journal line names goes to lost+found
  kRemoveView,    // half or damaged, and its position can be processed again
  kPutViewAside,  // half or damaged, and it cannot be made again: to lost+found
};
std::string_view ToString(RepairKind kind);

struct RepairAction {
  RepairKind kind = RepairKind::kPutFileAside;
  std::string file;    // relative to the session; views elsewhere: their own path
  std::string why;     // what was found there
  std::string put_to;  // where it is now, relative to the session; "" when it was not put aside
};

struct RepairOptions {
  // false: nothing is written, the report tells what would be done.
  bool apply = false;
  SessionCheckOptions check;
};

struct RepairReport {
  SessionReport found;                // before
  std::vector<RepairAction> actions;  // done, or to be done
  // Damage that no action mends: what the journal or a picture has lost.
  std::vector<SessionFinding> remaining;
};

// `now` is for the list in lost+found (list.jsonl: where each came from, size, crc32c, date, why).
// Errors: as CheckSession; another process is writing the session (kTemporary, with apply); a file
// that could not be moved: what was done before stays done.
Result<RepairReport> RepairSession(const std::filesystem::path& session, UtcTime now,
                                   const RepairOptions& options = {});

}  // namespace omnihdr
