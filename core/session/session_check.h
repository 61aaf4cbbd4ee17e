#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"

namespace omnihdr {

// Whether a session directory holds what it says: every journal line, every picture that a line
// names, every view. Nothing is written; a session that a daemon is writing may be checked, too.

enum class FindingKind : std::uint8_t {
  kDamage,    // something recorded is lost or contradicts something else
  kLeftover,  // what an interrupted program left behind; nothing that was recorded is lost
  kNote,      // worth knowing, nothing wrong
};
std::string_view ToString(FindingKind kind);

// What was found, and `code`, its word for scripts:
//   session.json  info-unreadable, rig-unreadable, end-unreadable, end-count
//   frames.jsonl  journal-unreadable, line-rejected, line-changed (its line_crc32c does not hold),
//                 line-torn, line-unterminated, line-unsealed, position-order, frame-gap, no-frames
//   raw/          raw-missing, raw-empty, raw-unreadable, raw-checksum, raw-undecodable, raw-size,
//                 raw-named-twice, raw-unjournaled, temporary-file, unknown-file
//   views/        view-temporary, view-incomplete, view-unreadable, view-channels, view-size,
//                 view-values, view-mismatch, view-journal, view-unknown-file,
//                 views-missing
struct SessionFinding {
  FindingKind kind = FindingKind::kNote;
  std::string code;
  std::string file;     // relative to the session; views elsewhere: their own path
  int line = 0;         // of that file; 0 = all of it
  std::string message;  // what is there, and what was expected
};

struct SessionCheckOptions {
  // Where the views are; empty: SESSION/views.
  std::filesystem::path views;
  // Looks at names and sizes of pictures and at view.json, without reading pixels.
  bool quick = false;
  // The caller holds the journal's lock: nobody is writing.
  bool lock_held = false;
  // Findings that are kept; further ones are counted.
  std::size_t max_findings = 10'000;
  // Files looked at so far, of so many; called between files, from the calling thread.
  std::function<void(std::size_t done, std::size_t total)> progress;
};

struct SessionReport {
  // In the order session.json, frames.jsonl (by line), raw/ (by line, then by name), views/ (by
  // position).
  std::vector<SessionFinding> findings;
  // All of them, those not kept included.
  std::size_t damage = 0;
  std::size_t leftovers = 0;
  std::size_t notes = 0;

  // Another process holds the journal: what it has not finished is not a leftover.
  bool is_being_written = false;
  bool is_ended = false;
  std::size_t lines = 0;  // usable ones
  std::size_t lines_sealed = 0;
  std::size_t pictures = 0;  // that lines name
  std::uint64_t picture_bytes = 0;
  std::size_t pictures_without_checksum = 0;
  std::size_t positions = 0;  // with a usable frame
  std::size_t views = 0;      // directories named as one
};

// Law: a session of which no byte has changed since our programs wrote it, whatever moment they
// were interrupted at, has no damage. Errors: the directory is not there, or holds no session.
// Memory is bounded by the journal's size and a few pictures; uses the worker pool.
Result<SessionReport> CheckSession(const std::filesystem::path& session,
                                   const SessionCheckOptions& options = {});

}  // namespace omnihdr
