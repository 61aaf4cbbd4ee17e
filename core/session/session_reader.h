#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/session/session.h"

namespace omnihdr {

// session.json from text; `name` (a path) is for error messages: "file:line: key: value, expected
// ...". Unknown keys are ignored; those of the top level are kept in extra_json and written back.
Result<SessionInfo> ParseSessionInfo(std::string_view text, const std::string& name);
// The text of session.json for `info`; ParseSessionInfo of it gives `info` back.
std::string FormatSessionInfo(const SessionInfo& info);

struct JournalContents {
  std::vector<FrameRecord> frames;  // in file order
  // Torn tail dropped, lines rejected, duplicate frame numbers ignored, positions out of order, ...
  std::vector<std::string> warnings;
  // Those of the warnings that cost a line: "file:line: key: value, expected ...: frame skipped".
  std::vector<std::string> rejected;
  std::size_t complete_bytes = 0;  // length up to and including the last complete line
};
// frames.jsonl from text. A torn last line is dropped with a warning (a last line that is whole and
// only lacks its newline counts). Any other malformed line is rejected, so that one bad line does
// not cost a survey: it stands in `rejected` and in `warnings`, and the other lines are used. A
// journal that has lines of which none is usable is an error. A journal without lines is a success
// with a warning. `first_line` numbers the lines of a continuation.
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

class JournalParser;

// Follows a journal that another thread or process is appending to. Not thread-safe.
class JournalFollower {
 public:
  explicit JournalFollower(const std::filesystem::path& session_directory);
  JournalFollower(JournalFollower&&) noexcept;
  JournalFollower& operator=(JournalFollower&&) noexcept;
  ~JournalFollower();
  // Reads no further than `bytes` says when ReadNew is called: for whoever knows the writer and
  // must not see what it may take back.
  void ReadUpTo(std::function<std::uint64_t()> bytes) { limit_ = std::move(bytes); }
  // Lines completed since the last call, malformed ones rejected as by ParseJournal. A last line
  // that is not whole yet is left for later (it is torn only if the writer is gone: TornTail).
  Result<std::vector<FrameRecord>> ReadNew();
  // All warnings so far, those of rejected lines included.
  const std::vector<std::string>& warnings() const;
  // Lines rejected so far.
  std::size_t rejected() const;
  // What to warn about when the writer is gone: the last ReadNew left a piece of a line behind.
  std::optional<std::string> TornTail() const;

 private:
  std::filesystem::path path_;
  std::function<std::uint64_t()> limit_;  // empty = to the end
  std::size_t offset_ = 0;
  std::size_t torn_bytes_ = 0;
  int next_line_ = 1;
  std::unique_ptr<JournalParser> parser_;
};

}  // namespace omnihdr
