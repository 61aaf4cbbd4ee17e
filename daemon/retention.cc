#include "daemon/retention.h"

#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <system_error>
#include <utility>

#include "core/base/file.h"
#include "daemon/session_choice.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxSessions = 100'000;
constexpr double kSecondsADay = 86400.0;

struct Candidate {
  fs::path path;
  UtcTime ended;
  std::uint64_t bytes = 0;
};

// Blocks, not lengths: what deleting gives back.
std::uint64_t BytesBelow(const fs::path& directory) {
  std::uint64_t bytes = 0;
  std::error_code error;
  fs::recursive_directory_iterator it(directory, error);
  for (const fs::recursive_directory_iterator end; !error && it != end; it.increment(error)) {
    struct stat info {};
    if (::lstat(it->path().c_str(), &info) == 0 && S_ISREG(info.st_mode)) {
      bytes += static_cast<std::uint64_t>(info.st_blocks) * 512;
    }
  }
  return bytes;
}

bool IsDirectory(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(fs::symlink_status(path, error));
}

}  // namespace

Result<std::vector<Deletion>> PlanRetention(const fs::path& sessions,
                                            const RetentionOptions& options, UtcTime now,
                                            const std::vector<fs::path>& keep) {
  std::vector<Deletion> deletions;
  if (!options.on()) return deletions;
  std::vector<Candidate> candidates;
  std::error_code error;
  fs::directory_iterator it(sessions, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
    const fs::path session = it->path();
    if (!IsDirectory(session) || !SessionEnded(session) || !HoldsSession(session)) continue;
    const bool kept = std::any_of(keep.begin(), keep.end(), [&](const fs::path& other) {
      std::error_code ignored;
      return fs::equivalent(session, other, ignored);
    });
    if (kept) continue;
    Candidate candidate;
    candidate.path = options.deletes == Retention::kViews ? session / "views" : session;
    if (!IsDirectory(candidate.path)) continue;
    struct stat info {};
    if (::stat((session / kEndedFile).c_str(), &info) != 0) continue;
    candidate.ended = UtcTime::FromNanoseconds(std::int64_t{info.st_mtim.tv_sec} * 1'000'000'000 +
                                               info.st_mtim.tv_nsec);
    if (options.gb > 0.0) candidate.bytes = BytesBelow(candidate.path);
    candidates.push_back(std::move(candidate));
    if (candidates.size() > kMaxSessions) {
      return Fail(ErrorKind::kData, "{}: over {} sessions, expected at most so many",
                  sessions.string(), kMaxSessions);
    }
  }
  if (error) return FailErrno(ErrorKind::kIo, sessions.string(), error.value());
  std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return std::pair(a.ended, a.path) < std::pair(b.ended, b.path);
  });
  double bytes = 0.0;
  for (const Candidate& candidate : candidates) bytes += static_cast<double>(candidate.bytes);
  for (const Candidate& candidate : candidates) {
    const double days = static_cast<double>((now - candidate.ended).count()) * 1e-9 / kSecondsADay;
    std::string why;
    if (options.days > 0.0 && days > options.days) {
      why =
          fmt::format("ended {:.1f} days ago, storage.retention_days is {:g}", days, options.days);
    } else if (options.gb > 0.0 && bytes > options.gb * 1e9) {
      why = fmt::format("{:.3f} GB lie there, storage.retention_gb is {:g}", bytes * 1e-9,
                        options.gb);
    } else {
      continue;
    }
    bytes -= static_cast<double>(candidate.bytes);
    deletions.push_back({candidate.path, candidate.bytes, std::move(why)});
  }
  return deletions;
}

Status Delete(const Deletion& deletion) {
  std::error_code error;
  fs::remove(deletion.path / "session.json", error);
  fs::remove_all(deletion.path, error);
  if (error) return FailErrno(ErrorKind::kIo, deletion.path.string(), error.value());
  return SyncDirectory(deletion.path.parent_path());
}

}  // namespace omnihdr
