#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/session/session.h"

namespace omnihdr {

// Turns journal lines, fed one after the other, into records; remembers what was seen before. One
// for batch reading, following and resuming. Private to core/session.
class JournalParser {
 public:
  explicit JournalParser(std::string name) : name_(std::move(name)) {}

  // What a piece of journal gave.
  struct Fed {
    std::size_t bytes = 0;  // up to and including the last complete line
    int lines = 0;          // newlines within these bytes
  };
  // Parses the complete lines of `text`, the first of which has number `first_line`. A last line
  // without its newline counts as complete when it is a whole JSON object.
  Fed Feed(std::string_view text, int first_line, std::vector<FrameRecord>& frames);

  // "file:line: torn last line ..." for `bytes` left after the last complete line.
  std::string TornLineWarning(int line, std::size_t bytes) const;
  void Warn(std::string warning);

  const std::string& name() const { return name_; }
  const std::vector<std::string>& warnings() const { return warnings_; }
  const std::vector<std::string>& rejected() const { return rejected_; }
  std::size_t lines_used() const { return lines_used_; }
  std::size_t lines_rejected() const { return lines_rejected_; }
  std::size_t warnings_left_out() const { return warnings_left_out_; }
  // One more than the largest frame number in any line, and no less than the number of lines: a
  // number whose pixel file cannot belong to an earlier line.
  std::uint64_t next_frame() const { return next_frame_; }

 private:
  void TakeLine(std::string_view line, int number, std::vector<FrameRecord>& frames);
  void Reject(std::string message);
  // False when the number was there before.
  bool AddFrameNumber(std::uint64_t number);

  std::string name_;
  std::vector<std::string> warnings_;
  std::vector<std::string> rejected_;
  std::size_t lines_used_ = 0;
  std::size_t lines_rejected_ = 0;
  std::size_t warnings_left_out_ = 0;
  std::uint64_t next_frame_ = 0;
  std::int64_t last_position_ = -1;
  // Frame numbers seen, as ranges first..last: one entry for a journal in order, however long.
  std::map<std::uint64_t, std::uint64_t> ranges_;
};

// A line ends with the CRC-32C of all that stands before it: `..., "line_crc32c": 123}`. Readers
// take the line whatever it says (it may have been edited on purpose); CheckSession tells.
std::string SealJournalLine(std::string line);  // of an object, without newline
enum class JournalSeal : std::uint8_t { kNone, kHolds, kBroken };
JournalSeal JournalSealOf(std::string_view line);

// The record of one line (without newline) or what is wrong with it: "name:number: key: value,
// ...".
Result<FrameRecord> ParseFrameRecord(std::string_view line, const std::string& name, int number);

}  // namespace omnihdr
