#include "core/session/session_repair.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <limits>
#include <map>
#include <optional>
#include <system_error>
#include <utility>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/session/journal_parser.h"
#include "core/session/json.h"
#include "core/session/limits.h"
#include "core/session/session_reader.h"
#include "core/session/view_check.h"
#include "core/session/view_names.h"
#include "core/session/view_writer.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kAside = "lost+found";
constexpr int kMaxNames = 10'000;  // of one name in lost+found

// Findings that say a view is not whole or cannot be read.
bool IsViewDamage(const std::string& code) {
  return code == "view-incomplete" || code == "view-unreadable" || code == "view-channels" ||
         code == "view-size" || code == "view-values" || code == "view-mismatch";
}

std::optional<RepairKind> KindFor(const std::string& code) {
  if (code == "line-torn") return RepairKind::kPutLineAside;
  if (code == "line-unterminated") return RepairKind::kEndLine;
  if (code == "raw-unjournaled" || code == "temporary-file") return RepairKind::kPutFileAside;
  if (code == "view-temporary" || IsViewDamage(code)) return RepairKind::kRemoveView;
  return std::nullopt;
}

Status MakeDirectory(const fs::path& directory) {
  if (::mkdir(directory.c_str(), 0755) != 0 && errno != EEXIST) {
    return FailErrno(ErrorKind::kCannotCreate, directory.string(), errno);
  }
  return SyncDirectory(directory.parent_path());
}

// A file's own size and CRC-32C, read piece by piece.
struct Content {
  std::uint64_t bytes = 0;
  std::uint32_t crc32c = 0;
};
Result<Content> ContentOf(const fs::path& path) {
  const Fd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
  if (!fd.valid()) return FailErrno(ErrorKind::kIo, path.string(), errno);
  Content content;
  std::vector<std::byte> piece(std::size_t{1} << 20);
  for (;;) {
    const ssize_t n = ::read(fd.get(), piece.data(), piece.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return FailErrno(ErrorKind::kIo, path.string(), errno);
    if (n == 0) return content;
    const auto part = std::span(piece).first(static_cast<std::size_t>(n));
    content.crc32c = Crc32c(part, content.crc32c);
    content.bytes += part.size();
  }
}

class SessionRepairer {
 public:
  SessionRepairer(const fs::path& session, UtcTime now, const RepairOptions& options)
      : session_(session.has_filename() ? session : session.parent_path()),
        now_(now),
        options_(options) {}

  Result<RepairReport> Run() && {
    // Held to the end, so that no daemon begins to write meanwhile.
    Fd lock;
    if (options_.apply) {
      OMNIHDR_ASSIGN(lock, LockJournal());
    }
    SessionCheckOptions check = options_.check;
    check.max_findings = std::numeric_limits<std::size_t>::max();
    check.lock_held = lock.valid();
    OMNIHDR_ASSIGN(report_.found, CheckSession(session_, check));
    Plan();
    if (options_.apply) {
      for (RepairAction& action : report_.actions) {
        OMNIHDR_TRY(Do(action).Context(fmt::format("repair {}", action.file)));
      }
    }
    return std::move(report_);
  }

 private:
  Result<Fd> LockJournal() const {
    const fs::path path = session_ / "frames.jsonl";
    Fd fd(::open(path.c_str(), O_RDWR | O_APPEND | O_CLOEXEC));
    if (!fd.valid()) {
      // Without a journal there is nothing to mend, and nobody writes one.
      if (errno == ENOENT) return Fd();
      return FailErrno(errno == EACCES || errno == EROFS ? ErrorKind::kPermission : ErrorKind::kIo,
                       path.string(), errno);
    }
    if (::flock(fd.get(), LOCK_EX | LOCK_NB) != 0) {
      return Fail(ErrorKind::kTemporary, "{}: another process is writing this session",
                  path.string());
    }
    return fd;
  }

  void Plan() {
    std::map<std::string, std::size_t> views;  // their action, so that each has one
    for (const SessionFinding& finding : report_.found.findings) {
      const std::optional<RepairKind> kind = KindFor(finding.code);
      if (!kind) {
        if (finding.kind == FindingKind::kDamage) report_.remaining.push_back(finding);
        continue;
      }
      if (finding.code == "raw-unjournaled" && finding.kind == FindingKind::kDamage) {
        report_.remaining.push_back(finding);  // the picture is kept, its line is gone
      }
      if (!IsViewDamage(finding.code)) {
        report_.actions.push_back({*kind, finding.file, finding.message, ""});
        continue;
      }
      const fs::path directory = DirectoryOf(finding);
      const auto [at, is_new] = views.emplace(directory.string(), report_.actions.size());
      const std::string message =
          fmt::format("{}: {}", fs::path(finding.file).filename().string(), finding.message);
      if (is_new) {
        report_.actions.push_back({KindForView(directory), directory.string(), message, ""});
      } else {
        report_.actions[at->second].why += "; " + message;
      }
    }
  }

  // The view's directory of a finding about a file in it, named as findings name it.
  static fs::path DirectoryOf(const SessionFinding& finding) {
    return fs::path(finding.file).parent_path();
  }

  RepairKind KindForView(const fs::path& directory) const {
    const std::optional<PositionId> position = PositionFromName(directory.filename().string());
    return position && CanBeMade(*position) ? RepairKind::kRemoveView : RepairKind::kPutViewAside;
  }

  // Whether every frame of the position that should have pixels has them as they were.
  bool CanBeMade(PositionId position) const {
    if (!journal_) {
      Result<SessionContents> contents = ReadSession(session_);
      journal_ = contents ? std::move(contents->journal.frames) : std::vector<FrameRecord>();
      for (const SessionFinding& finding : report_.found.findings) {
        if (finding.kind == FindingKind::kDamage) damaged_.emplace(finding.file, true);
      }
    }
    bool any = false;
    for (const FrameRecord& frame : *journal_) {
      if (frame.position != position || frame.status != FrameStatus::kOk) continue;
      if (damaged_.contains(fs::path(frame.file).lexically_normal().string())) return false;
      any = true;
    }
    return any;
  }

  // Where the action's file is: findings name views elsewhere by their own path.
  fs::path PathOf(const RepairAction& action) const {
    const bool is_view =
        action.kind == RepairKind::kRemoveView || action.kind == RepairKind::kPutViewAside;
    return is_view && !options_.check.views.empty() ? fs::path(action.file)
                                                    : session_ / action.file;
  }

  Status Do(RepairAction& action) {
    switch (action.kind) {
      case RepairKind::kPutLineAside:
        return PutLineAside(action);
      case RepairKind::kEndLine:
        return EndLine();
      case RepairKind::kPutFileAside:
      case RepairKind::kPutViewAside:
        return PutAside(action);
      case RepairKind::kRemoveView:
        return RemoveView(PathOf(action));
    }
    return {};
  }

  Status PutLineAside(RepairAction& action) {
    const fs::path path = session_ / "frames.jsonl";
    OMNIHDR_ASSIGN(const std::string text, ReadTextFile(path, session_limits::kMaxJournalBytes));
    const std::size_t newline = text.rfind('\n');
    const std::size_t end = newline == std::string::npos ? 0 : newline + 1;
    const std::string_view torn = std::string_view(text).substr(end);
    OMNIHDR_ASSIGN(const fs::path place, FreePlace("frames.jsonl.torn"));
    action.put_to = place.lexically_relative(session_).string();
    OMNIHDR_TRY(List(action, {torn.size(), Crc32c(std::as_bytes(std::span(torn)))}));
    OMNIHDR_TRY(WriteFileAtomic(place, torn));
    if (::truncate(path.c_str(), static_cast<off_t>(end)) != 0) {
      return FailErrno(ErrorKind::kIo, fmt::format("{}: truncate", path.string()), errno);
    }
    return SyncFile(path);
  }

  Status EndLine() const {
    const fs::path path = session_ / "frames.jsonl";
    const Fd fd(::open(path.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC));
    if (!fd.valid()) return FailErrno(ErrorKind::kIo, path.string(), errno);
    constexpr std::byte kNewline{'\n'};
    OMNIHDR_TRY(WriteAll(fd.get(), std::span(&kNewline, 1), path.string()));
    return SyncFile(path);
  }

  Status PutAside(RepairAction& action) {
    const fs::path from = PathOf(action);
    const fs::path folder = from.parent_path().filename();
    const bool from_top = from.parent_path() == session_;
    OMNIHDR_ASSIGN(const fs::path place,
                   FreePlace(from_top ? from.filename() : folder / from.filename()));
    action.put_to = place.lexically_relative(session_).string();
    std::error_code error;
    Content content;
    if (fs::is_regular_file(fs::symlink_status(from, error))) {
      OMNIHDR_ASSIGN(content, ContentOf(from));
    }
    OMNIHDR_TRY(List(action, content));
    // Never over something else.
    if (::renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, place.c_str(), RENAME_NOREPLACE) != 0 &&
        (errno != EINVAL || ::rename(from.c_str(), place.c_str()) != 0)) {
      return FailErrno(ErrorKind::kIo, fmt::format("{}: move to {}", from.string(), place.string()),
                       errno);
    }
    OMNIHDR_TRY(SyncDirectory(place.parent_path()));
    return SyncDirectory(from.parent_path());
  }

  // By way of the name of an unfinished view: interrupted, it is no half view under its own name.
  static Status RemoveView(const fs::path& directory) {
    fs::path doomed = directory;
    if (const auto position = PositionFromName(directory.filename().string())) {
      doomed = TemporaryViewName(directory.parent_path(), *position);
      std::error_code error;
      fs::remove_all(doomed, error);
      if (!error) fs::rename(directory, doomed, error);
      if (error) return Fail(ErrorKind::kIo, "{}: {}", directory.string(), error.message());
    }
    std::error_code error;
    fs::remove_all(doomed, error);
    if (error) return Fail(ErrorKind::kIo, "{}: remove: {}", doomed.string(), error.message());
    return SyncDirectory(directory.parent_path());
  }

  // lost+found/NAME, or NAME.1, NAME.2, ... when there is one already; its folder is made.
  Result<fs::path> FreePlace(const fs::path& name) const {
    const fs::path aside = session_ / kAside;
    OMNIHDR_TRY(MakeDirectory(aside));
    const fs::path wanted = aside / name;
    if (wanted.parent_path() != aside) OMNIHDR_TRY(MakeDirectory(wanted.parent_path()));
    fs::path place = wanted;
    std::error_code error;
    for (int k = 1; fs::exists(fs::symlink_status(place, error)); ++k) {
      if (k > kMaxNames) {
        return Fail(ErrorKind::kCannotCreate, "{}: {} of that name already", wanted.string(),
                    kMaxNames);
      }
      place = wanted;
      place += fmt::format(".{}", k);
    }
    return place;
  }

  // One line of the list, durable before anything moves.
  Status List(const RepairAction& action, const Content& content) const {
    const fs::path path = session_ / kAside / "list.jsonl";
    const Fd fd(::open(path.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0644));
    if (!fd.valid()) return FailErrno(ErrorKind::kCannotCreate, path.string(), errno);
    json::ObjectWriter line;
    line.Add("file", action.put_to)
        .Add("from", action.file)
        .Add("bytes", content.bytes)
        .Add("crc32c", content.crc32c)
        .Add("put_aside_utc_ns", now_.ns());
    struct stat status {};
    if (::stat(PathOf(action).c_str(), &status) == 0) {
      line.Add("modified_utc_ns",
               std::int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec);
    }
    line.Add("why", action.why);
    const std::string text = std::move(line).Finish() + "\n";
    OMNIHDR_TRY(WriteAll(fd.get(), std::as_bytes(std::span(text)), path.string()));
    OMNIHDR_TRY(SyncFile(path));
    return SyncDirectory(path.parent_path());
  }

  const fs::path session_;
  const UtcTime now_;
  const RepairOptions& options_;
  RepairReport report_;
  mutable std::optional<std::vector<FrameRecord>> journal_;
  mutable std::map<std::string, bool> damaged_;
};

}  // namespace

std::string_view ToString(RepairKind kind) {
  switch (kind) {
    case RepairKind::kPutLineAside:
      return "put-line-aside";
    case RepairKind::kEndLine:
      return "end-line";
    case RepairKind::kPutFileAside:
      return "put-file-aside";
    case RepairKind::kRemoveView:
      return "remove-view";
    case RepairKind::kPutViewAside:
      return "put-view-aside";
  }
  return "?";
}

Result<RepairReport> RepairSession(const fs::path& session, UtcTime now,
                                   const RepairOptions& options) {
  return SessionRepairer(session, now, options).Run();
}

}  // namespace omnihdr
