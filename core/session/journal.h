#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/file.h"
#include "core/base/result.h"
#include "core/session/session.h"

namespace omnihdr {

// When what is appended is made to outlast a power cut.
enum class Durability {
  kFrame,     // before Append returns
  kInterval,  // at the next Sync
};
std::string_view ToString(Durability durability);

// Writes a session: session.json once, then pixels and one journal line a frame. Law: when Append
// returns success, the pixel file and the line are durable; whatever happens at any moment, the
// journal is a prefix of what was appended, plus at most one torn line. One writer a session (an
// advisory lock on frames.jsonl refuses a second). With Durability::kInterval pixel file and line
// outlast the process when Append returns, and a power cut after the next successful Sync: what
// such a cut leaves of a newer frame may be a line whose pixels are missing or do not have the CRC
// it says. Not thread-safe.
class SessionWriter {
 public:
  // Makes the directory (parents included), info.files, session.json and an empty journal. Fails
  // when the directory already holds a session.
  static Result<SessionWriter> Create(const std::filesystem::path& directory,
                                      const SessionInfo& info);
  // Continues an existing session: drops a torn last line, removes temporary files, goes on with
  // the next frame number. Refuses when the journal is gone and pictures are there (kData).
  static Result<SessionWriter> Resume(const std::filesystem::path& directory);

  // Stores `file_bytes` (an encoded PNG, ...) as record.file, syncs it, then appends the line. When
  // the pixels cannot be stored the line is still attempted, with status disk-full and no file, and
  // the error is returned. record.crc32c is filled in. Empty file_bytes = a line only. On any error
  // of the line itself the journal keeps its earlier lines and the frame number is still free.
  Status Append(FrameRecord record, std::span<const std::byte> file_bytes);

  void SetDurability(Durability durability) { durability_ = durability; }
  // Makes durable what has been appended since the last one. On an error all of that is tried again
  // with the next call.
  Status Sync();
  // Lines that wait for Sync.
  std::size_t unsynced() const { return unsynced_lines_; }

  const std::filesystem::path& directory() const { return directory_; }
  const SessionInfo& info() const { return info_; }
  // How much of the journal is durable. What lies behind it may be taken back: the beginning of a
  // line, or a line that could not be synchronised.
  std::uint64_t durable_bytes() const { return journal_bytes_; }
  // Frames in the journal so far; the next frame number.
  std::uint64_t next_frame() const { return next_frame_; }
  // Position of the last line, or -1.
  std::int64_t last_position() const { return last_position_; }
  // How many lines the last position has.
  int frames_at_last_position() const { return frames_at_last_position_; }
  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  SessionWriter() = default;
  std::filesystem::path directory_;
  SessionInfo info_;
  Status Repair();
  Status AppendLine(const FrameRecord& record);
  Status StorePixels(const std::filesystem::path& path, std::span<const std::byte> bytes);
  Status Remember();
  Status CheckDirectory() const;

  Fd journal_;
  std::uint64_t journal_bytes_ = 0;   // length of the complete lines
  std::uint64_t reserved_bytes_ = 0;  // blocks of the journal allocated up to here
  bool needs_repair_ = false;         // there may be bytes after the complete lines
  std::uint64_t next_frame_ = 0;
  std::int64_t last_position_ = -1;
  int frames_at_last_position_ = 0;
  Durability durability_ = Durability::kFrame;
  std::vector<std::filesystem::path> unsynced_files_;
  std::size_t unsynced_lines_ = 0;
  std::uint64_t device_ = 0;  // of the directory, when it was opened
  std::uint64_t inode_ = 0;
  std::vector<std::string> warnings_;
};

}  // namespace omnihdr
