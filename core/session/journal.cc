#include "core/session/journal.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "core/base/crc32c.h"
#include "core/session/journal_parser.h"
#include "core/session/limits.h"
#include "core/session/session_reader.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

// Room kept for lines in the journal's own blocks: a full disk can still be written into the
// record.
constexpr std::uint64_t kReserve = std::uint64_t{1} << 16;

// Files that wait for Sync, at most: bounds memory and the time of one Sync.
constexpr std::size_t kMaxUnsynced = 1024;

fs::path InfoPath(const fs::path& directory) { return directory / "session.json"; }
fs::path JournalPath(const fs::path& directory) { return directory / "frames.jsonl"; }

ErrorKind CreateKind(int error_number) {
  return error_number == EACCES || error_number == EPERM || error_number == EROFS
             ? ErrorKind::kPermission
             : ErrorKind::kCannotCreate;
}

// Makes a directory and its missing parents, each durable in its parent.
Status MakeDirectories(const fs::path& directory) {
  std::error_code error;
  if (directory.empty() || fs::is_directory(directory, error)) return {};
  const fs::path parent =
      directory.has_filename() ? directory.parent_path() : directory.parent_path().parent_path();
  OMNIHDR_TRY(MakeDirectories(parent));
  if (::mkdir(directory.c_str(), 0755) != 0 && errno != EEXIST) {
    const int error_number = errno;
    return FailErrno(CreateKind(error_number), directory.string(), error_number);
  }
  if (!fs::is_directory(directory, error)) {
    return Fail(ErrorKind::kCannotCreate, "{}: not a directory", directory.string());
  }
  return SyncDirectory(parent.empty() ? fs::path(".") : parent);
}

// Opens the journal, made when missing, and takes the writer's lock.
Result<Fd> OpenJournal(const fs::path& directory) {
  const fs::path path = JournalPath(directory);
  Fd fd(::open(path.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0644));
  if (!fd.valid()) {
    const int error_number = errno;
    return FailErrno(CreateKind(error_number), path.string(), error_number);
  }
  if (::flock(fd.get(), LOCK_EX | LOCK_NB) != 0) {
    if (errno == EWOULDBLOCK) {
      return Fail(ErrorKind::kTemporary, "{}: another process is writing this session",
                  path.string());
    }
    return FailErrno(ErrorKind::kIo, fmt::format("{}: lock", path.string()), errno);
  }
  return fd;
}

// Unfinished files of an interrupted writer: WriteFileAtomic's "*.tmp".
int RemoveTemporaryFiles(const fs::path& directory) {
  int removed = 0;
  std::error_code error;
  for (fs::directory_iterator it(directory, error), end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    if (it->path().extension() == ".tmp" && it->is_regular_file(ignored) &&
        fs::remove(it->path(), ignored)) {
      ++removed;
    }
  }
  return removed;
}

bool HoldsFiles(const fs::path& directory) {
  std::error_code error;
  const fs::directory_iterator it(directory, error);
  return !error && it != fs::directory_iterator();
}

// Whether a relative path stays within the directory it is relative to.
bool IsInside(const fs::path& path) {
  return path.is_relative() &&
         std::none_of(path.begin(), path.end(), [](const fs::path& part) { return part == ".."; });
}

}  // namespace

std::string_view ToString(Durability durability) {
  return durability == Durability::kFrame ? "frame" : "interval";
}

Result<SessionWriter> SessionWriter::Create(const fs::path& directory, const SessionInfo& info) {
  SessionWriter writer;
  const std::string text = FormatSessionInfo(info);
  OMNIHDR_ASSIGN(writer.info_,
                 ParseSessionInfo(text, InfoPath(directory).string()).Context("create session"));
  OMNIHDR_TRY(MakeDirectories(directory));
  OMNIHDR_ASSIGN(writer.journal_, OpenJournal(directory));
  // session.json comes last: a directory without it is not a session yet, whatever else it holds.
  std::error_code error;
  struct stat status {};
  if (::fstat(writer.journal_.get(), &status) != 0) {
    return FailErrno(ErrorKind::kIo, JournalPath(directory).string(), errno);
  }
  if (fs::exists(InfoPath(directory), error) || status.st_size != 0) {
    return Fail(ErrorKind::kCannotCreate, "{}: already holds a session", directory.string());
  }
  OMNIHDR_TRY(MakeDirectories(directory / "raw"));
  for (const SessionFile& file : info.files) {
    const fs::path relative(file.name);
    if (file.name.empty() || !IsInside(relative)) {
      return Fail(ErrorKind::kCannotCreate, "{}: \"{}\", expected a file's name inside the session",
                  directory.string(), file.name);
    }
    OMNIHDR_TRY(MakeDirectories((directory / relative).parent_path()));
    OMNIHDR_TRY(WriteFileAtomic(directory / relative, file.content));
  }
  OMNIHDR_TRY(WriteFileAtomic(InfoPath(directory), text));
  writer.directory_ = directory;
  OMNIHDR_TRY(writer.Remember());
  return writer;
}

Result<SessionWriter> SessionWriter::Resume(const fs::path& directory) {
  SessionWriter writer;
  writer.directory_ = directory;
  const std::string info_name = InfoPath(directory).string();
  OMNIHDR_ASSIGN(const std::string info_text,
                 ReadTextFile(InfoPath(directory), session_limits::kMaxInfoBytes));
  OMNIHDR_ASSIGN(writer.info_, ParseSessionInfo(info_text, info_name));
  const fs::path journal_path = JournalPath(directory);
  // A new journal would number from 0 and write over the pictures of the one that is gone.
  std::error_code error;
  if (!fs::exists(journal_path, error) && HoldsFiles(directory / "raw")) {
    return Fail(ErrorKind::kData,
                "{}: missing, expected the journal of the pictures in {}: put it back, or move "
                "them away",
                journal_path.string(), (directory / "raw").string());
  }
  OMNIHDR_ASSIGN(writer.journal_, OpenJournal(directory));
  OMNIHDR_ASSIGN(const std::string text,
                 ReadTextFile(journal_path, session_limits::kMaxJournalBytes));

  JournalParser parser(journal_path.string());
  std::vector<FrameRecord> frames;
  const JournalParser::Fed fed = parser.Feed(text, 1, frames);
  writer.warnings_ = parser.warnings();
  if (fed.bytes < text.size()) {
    writer.warnings_.push_back(parser.TornLineWarning(1 + fed.lines, text.size() - fed.bytes));
  }
  // Also frees the blocks that an earlier writer had reserved.
  writer.journal_bytes_ = fed.bytes;
  OMNIHDR_TRY(writer.Repair());
  if (fed.bytes > 0 && text[fed.bytes - 1] != '\n') {
    constexpr std::byte kNewline{'\n'};
    OMNIHDR_TRY(WriteAll(writer.journal_.get(), std::span(&kNewline, 1), journal_path.string()));
    if (::fdatasync(writer.journal_.get()) != 0) {
      return FailErrno(ErrorKind::kIo, fmt::format("{}: fdatasync", journal_path.string()), errno);
    }
    ++writer.journal_bytes_;
  }

  writer.next_frame_ = parser.next_frame();
  if (!frames.empty()) {
    writer.last_position_ = Value(frames.back().position);
    writer.frames_at_last_position_ = static_cast<int>(
        std::count_if(frames.begin(), frames.end(), [&writer](const FrameRecord& frame) {
          return Value(frame.position) == writer.last_position_;
        }));
  }
  RemoveTemporaryFiles(directory);
  RemoveTemporaryFiles(directory / "raw");
  OMNIHDR_TRY(MakeDirectories(directory / "raw"));
  OMNIHDR_TRY(writer.Remember());
  return writer;
}

Status SessionWriter::Append(FrameRecord record, std::span<const std::byte> file_bytes) {
  const std::string frame_name = fmt::format("frame {}", Value(record.frame));
  if (Value(record.frame) < next_frame_) {
    return Fail(ErrorKind::kSoftware, "{}: {}: expected a frame number of {} or more",
                directory_.string(), frame_name, next_frame_);
  }
  if (!file_bytes.empty() && record.file.empty()) {
    return Fail(ErrorKind::kSoftware, "append {}: pixels without a file name", frame_name);
  }
  if (!file_bytes.empty()) record.crc32c = Crc32c(file_bytes);
  // What we could not read back must not get into the journal.
  if (Result<FrameRecord> readable = ParseFrameRecord(
          FormatFrameRecord(record), directory_.string(),
          static_cast<int>(std::min<std::uint64_t>(next_frame_, INT32_MAX - 1)) + 1);
      !readable) {
    return Fail(ErrorKind::kSoftware, "append {}: {}", frame_name, readable.error().message);
  }

  Status stored;
  if (!file_bytes.empty()) {
    stored = StorePixels(directory_ / record.file, file_bytes);
    if (!stored) {
      record.status = FrameStatus::kDiskFull;
      record.file.clear();
      record.crc32c.reset();
      record.detail = stored.error().message;
    }
  }
  if (Status line = AppendLine(record); !line) {
    return Forward(stored ? line.error() : stored.error(), fmt::format("append {}", frame_name));
  }
  const std::int64_t position = Value(record.position);
  frames_at_last_position_ = position == last_position_ ? frames_at_last_position_ + 1 : 1;
  last_position_ = position;
  next_frame_ = Value(record.frame) + 1;
  if (durability_ == Durability::kInterval) ++unsynced_lines_;
  if (!stored) return Forward(stored.error(), fmt::format("append {}", frame_name));
  return {};
}

// Where the volume has gone from under it, the same path leads into the directory that it was
// mounted on: nothing must be written there.
Status SessionWriter::Remember() {
  struct stat info {};
  if (::stat(directory_.c_str(), &info) != 0) {
    return FailErrno(ErrorKind::kIo, directory_.string(), errno);
  }
  device_ = info.st_dev;
  inode_ = info.st_ino;
  return {};
}

Status SessionWriter::CheckDirectory() const {
  struct stat info {};
  if (::stat(directory_.c_str(), &info) != 0) {
    return FailErrno(ErrorKind::kIo, directory_.string(), errno);
  }
  if (info.st_dev == device_ && info.st_ino == inode_) return {};
  return Fail(ErrorKind::kIo,
              "{}: not the directory that was opened, expected its file system to stay mounted",
              directory_.string());
}

Status SessionWriter::StorePixels(const fs::path& path, std::span<const std::byte> bytes) {
  OMNIHDR_TRY(CheckDirectory());
  OMNIHDR_TRY(MakeDirectories(path.parent_path()));
  if (durability_ == Durability::kFrame) return WriteFileAtomic(path, bytes);
  const std::string temporary = path.string() + ".tmp";
  Fd fd(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (!fd.valid()) return FailErrno(ErrorKind::kIo, temporary, errno);
  Status written = WriteAll(fd.get(), bytes, temporary);
  if (written && ::rename(temporary.c_str(), path.c_str()) != 0) {
    written = FailErrno(ErrorKind::kIo, path.string(), errno);
  }
  if (!written) {
    ::unlink(temporary.c_str());
    return written;
  }
  unsynced_files_.push_back(path);
  if (unsynced_files_.size() >= kMaxUnsynced) return Sync();
  return {};
}

Status SessionWriter::Sync() {
  std::vector<fs::path> directories;
  for (const fs::path& path : unsynced_files_) {
    OMNIHDR_TRY(SyncFile(path));
    const fs::path parent = path.parent_path();
    if (std::find(directories.begin(), directories.end(), parent) == directories.end()) {
      directories.push_back(parent);
    }
  }
  for (const fs::path& parent : directories) OMNIHDR_TRY(SyncDirectory(parent));
  if (unsynced_lines_ > 0 && ::fdatasync(journal_.get()) != 0) {
    return FailErrno(ErrorKind::kIo, fmt::format("{}: fdatasync", JournalPath(directory_).string()),
                     errno);
  }
  unsynced_files_.clear();
  unsynced_lines_ = 0;
  return {};
}

Status SessionWriter::AppendLine(const FrameRecord& record) {
  const std::string path = JournalPath(directory_).string();
  if (needs_repair_) OMNIHDR_TRY(Repair());
  const std::string line = SealJournalLine(FormatFrameRecord(record)) + "\n";
  if (line.size() > session_limits::kMaxLineBytes) {
    return Fail(ErrorKind::kSoftware, "{}: a line of {} bytes, expected at most {}", path,
                line.size(), session_limits::kMaxLineBytes);
  }
  if (reserved_bytes_ < journal_bytes_ + kReserve / 2) {
    // Not every file system can; then the reserve is what is free.
    const std::uint64_t length = journal_bytes_ + kReserve;
    if (::fallocate(journal_.get(), FALLOC_FL_KEEP_SIZE, 0, static_cast<off_t>(length)) == 0) {
      reserved_bytes_ = length;
    }
  }
  needs_repair_ = true;
  Status written =
      WriteAll(journal_.get(), std::as_bytes(std::span(line.data(), line.size())), path);
  if (written && durability_ == Durability::kFrame && ::fdatasync(journal_.get()) != 0) {
    written = FailErrno(ErrorKind::kIo, fmt::format("{}: fdatasync", path), errno);
  }
  if (!written) {
    // A torn line may only be the last: the next one must not be appended to it. If this fails now,
    // it is tried again before the next line.
    if (const Status repaired = Repair(); !repaired) {
      written.error().message += fmt::format(" (and {})", repaired.error().message);
    }
    return written;
  }
  needs_repair_ = false;
  journal_bytes_ += line.size();
  return {};
}

Status SessionWriter::Repair() {
  const std::string path = JournalPath(directory_).string();
  if (::ftruncate(journal_.get(), static_cast<off_t>(journal_bytes_)) != 0) {
    return FailErrno(ErrorKind::kIo, fmt::format("{}: drop the torn last line", path), errno);
  }
  reserved_bytes_ = 0;
  if (::fdatasync(journal_.get()) != 0) {
    return FailErrno(ErrorKind::kIo, fmt::format("{}: fdatasync", path), errno);
  }
  needs_repair_ = false;
  return {};
}

}  // namespace omnihdr
