#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/session/session.h"

namespace omnihdr {

// session.json from text; `name` (a path) is for error messages, which name file, key, value and what
// was expected. Unknown keys are ignored; those in kExtraKeys are kept in extra_json.
Result<SessionInfo> ParseSessionInfo(std::string_view text, const std::string& name);
// The text of session.json for `info`; ParseSessionInfo of it gives `info` back.
std::string FormatSessionInfo(const SessionInfo& info);

struct JournalContents {
  std::vector<FrameRecord> frames;    // in file order
  std::vector<std::string> warnings;  // torn tail dropped, duplicate frame numbers ignored, ...
  std::size_t complete_bytes = 0;     // length up to and including the last complete line
};
// frames.jsonl from text. A torn last line is dropped with a warning; any other malformed line is an
// error naming "file:line: key: value: expected ...". `first_line` numbers the lines of a continuation.
Result<JournalContents> ParseJournal(std::string_view text, const std::string& name,
                                     int first_line = 1);
// One journal line without the newline; ParseJournal of it gives `record` back.
std::string FormatFrameRecord(const FrameRecord& record);

struct SessionContents {
  SessionInfo info;
  JournalContents journal;
};
// Reads session.json and frames.jsonl of a session directory.
Result<SessionContents> ReadSession(const std::filesystem::path& directory);

// Follows a journal that another thread or process is appending to. Not thread-safe.
class JournalFollower {
 public:
  explicit JournalFollower(std::filesystem::path session_directory);
  // Lines completed since the last call; a line without its newline yet is left for later (it is torn
  // only if the writer is gone).
  Result<std::vector<FrameRecord>> ReadNew();
  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  std::filesystem::path path_;
  std::size_t offset_ = 0;
  int next_line_ = 1;
  std::vector<std::string> warnings_;
};

}  // namespace omnihdr
