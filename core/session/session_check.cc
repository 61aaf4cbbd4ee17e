#include "core/session/session_check.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <system_error>
#include <utility>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/base/parallel_for.h"
#include "core/image/image_io.h"
#include "core/session/journal_parser.h"
#include "core/session/json.h"
#include "core/session/limits.h"
#include "core/session/session_reader.h"
#include "core/session/session_rig.h"
#include "core/session/view_check.h"
#include "core/session/view_names.h"
#include "core/session/view_writer.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;
namespace limits = session_limits;

constexpr std::size_t kPicturesAtOnce = 32;
constexpr std::size_t kViewsAtOnce = 4;  // of some 60 MB each while they are looked at
constexpr std::size_t kMaxEndBytes = std::size_t{1} << 16;

// Names in a directory, sorted; none when it cannot be read.
std::vector<std::string> Names(const fs::path& directory) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(directory, error), end; !error && it != end; it.increment(error)) {
    names.push_back(it->path().filename().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

bool IsTemporaryFile(const std::string& name) { return fs::path(name).extension() == ".tmp"; }

// Whether another process holds the lock. It is taken for a moment, so that a writer that starts in
// this very moment is refused as by another writer.
bool IsLocked(const fs::path& path, int flags) {
  const Fd fd(::open(path.c_str(), flags | O_CLOEXEC));
  return fd.valid() && ::flock(fd.get(), LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
}

// The number of "000012.png", which is how our recorder names frame 12's picture.
std::optional<std::uint64_t> FrameNumberOfFile(const std::string& name) {
  const std::string stem = fs::path(name).stem().string();
  if (stem.empty() || stem.size() > 12 ||
      !std::all_of(stem.begin(), stem.end(), [](char c) { return c >= '0' && c <= '9'; })) {
    return std::nullopt;
  }
  return std::stoull(stem);
}

struct Picture {
  std::string file;
  int line = 0;
  std::optional<std::uint32_t> crc32c;
};

class SessionChecker {
 public:
  SessionChecker(const fs::path& session, const SessionCheckOptions& options)
      : session_(session.has_filename() ? session : session.parent_path()),
        options_(options),
        views_(options.views.empty() ? session_ / "views" : options.views),
        views_name_(options.views.empty() ? "views" : options.views.string()) {}

  Result<SessionReport> Run() && {
    std::error_code error;
    if (!fs::is_directory(session_, error)) {
      return Fail(ErrorKind::kNoInput, "{}: no such directory", session_.string());
    }
    if (!fs::exists(session_ / "session.json", error) &&
        !fs::exists(session_ / "frames.jsonl", error)) {
      return Fail(ErrorKind::kNoInput,
                  "{}: neither session.json nor frames.jsonl, expected a session directory",
                  session_.string());
    }
    report_.is_being_written = !options_.lock_held && IsLocked(session_ / "frames.jsonl", O_RDONLY);
    // In this order a writer that goes on meanwhile has a line for everything listed, but for what
    // is_being_written excuses.
    const std::vector<std::string> views = Names(views_);
    const std::vector<std::string> raw = Names(session_ / "raw");
    CheckInfo();
    if (CheckJournal()) {
      CheckEnd();
      CheckPictures();
      CheckRawNames(raw);
      CheckViews(views);
    }
    CheckTopLevel();
    return std::move(report_);
  }

 private:
  void Add(SessionFinding finding) {
    (finding.kind == FindingKind::kDamage     ? report_.damage
     : finding.kind == FindingKind::kLeftover ? report_.leftovers
                                              : report_.notes) += 1;
    if (report_.findings.size() < options_.max_findings) {
      report_.findings.push_back(std::move(finding));
    }
  }
  void Add(FindingKind kind, std::string code, std::string file, std::string message,
           int line = 0) {
    message = WithoutName(std::move(message), (session_ / file).string(), &line);
    Add(SessionFinding{kind, std::move(code), std::move(file), line, std::move(message)});
  }
  void Damage(std::string code, std::string file, std::string message, int line = 0) {
    Add(FindingKind::kDamage, std::move(code), std::move(file), std::move(message), line);
  }

  // --- session.json

  void CheckInfo() {
    const fs::path path = session_ / "session.json";
    const Result<std::string> text = ReadTextFile(path, limits::kMaxInfoBytes);
    if (!text) {
      Damage("info-unreadable", "session.json", text.error().message);
      return;
    }
    Result<SessionInfo> info = ParseSessionInfo(*text, path.string());
    if (!info) {
      Damage("info-unreadable", "session.json", info.error().message);
      return;
    }
    info_ = std::move(*info);
    if (info_->camera.layout != Layout::kRig) return;
    const Result<std::vector<SessionFile>> rig = ReadRigFiles(session_);
    if (!rig) {
      Damage("rig-unreadable", "rig.toml", rig.error().message);
      return;
    }
    for (const SessionFile& file : *rig) known_.insert(fs::path(file.name).begin()->string());
  }

  // --- frames.jsonl

  // False when there is no journal to hold the rest against.
  bool CheckJournal() {
    const fs::path path = session_ / "frames.jsonl";
    const Result<std::string> text = ReadTextFile(path, limits::kMaxJournalBytes);
    if (!text) {
      Damage("journal-unreadable", "frames.jsonl", text.error().message);
      return false;
    }
    JournalParser parser("frames.jsonl");
    std::size_t begin = 0;
    int number = 1;
    while (begin < text->size()) {
      const std::size_t newline = text->find('\n', begin);
      const bool has_newline = newline != std::string::npos;
      const std::size_t end = has_newline ? newline + 1 : text->size();
      const std::string_view line = std::string_view(*text).substr(begin, end - begin);
      if (!TakeLine(parser, line, number, has_newline)) break;
      begin = end;
      ++number;
    }
    report_.lines = parser.lines_used();
    // A session begun by another program, or a line that was changed so that its checksum is gone.
    if (lines_unsealed_ > 0 && report_.lines_sealed > 0) {
      Add(FindingKind::kNote, "line-unsealed", "frames.jsonl",
          fmt::format("{} lines without line_crc32c, this the first; {} have it", lines_unsealed_,
                      report_.lines_sealed),
          first_unsealed_);
    }
    next_frame_ = parser.next_frame();
    if (parser.lines_used() == 0) {
      Add(FindingKind::kNote, "no-frames", "frames.jsonl", "no frames: the session is empty");
    }
    frames_ = FrameIndex(std::move(entries_));
    report_.positions = frames_.positions().size();
    report_.pictures = pictures_.size();
    return true;
  }

  // False when the rest of the journal is a piece of a line.
  bool TakeLine(JournalParser& parser, std::string_view line, int number, bool has_newline) {
    const std::size_t rejected = parser.lines_rejected();
    const std::size_t warnings = parser.warnings().size();
    std::vector<FrameRecord> records;
    if (parser.Feed(line, number, records).bytes == 0) {
      if (!report_.is_being_written) {
        Add(FindingKind::kLeftover, "line-torn", "frames.jsonl",
            fmt::format("torn last line of {} bytes, expected a whole line: its writer was "
                        "interrupted",
                        line.size()),
            number);
      }
      return false;
    }
    if (parser.lines_rejected() > rejected) {
      Damage("line-rejected", "frames.jsonl",
             parser.warnings().size() > warnings
                 ? WithoutName(parser.warnings().back(), "frames.jsonl")
                 : "not usable",
             number);
      NoteMentioned(line);
    } else if (parser.warnings().size() > warnings) {
      Add(FindingKind::kNote, "position-order", "frames.jsonl",
          WithoutName(parser.warnings().back(), "frames.jsonl"), number);
    }
    if (!has_newline && !report_.is_being_written) {
      Add(FindingKind::kLeftover, "line-unterminated", "frames.jsonl",
          "the last line has no newline: its writer was interrupted", number);
    }
    if (!records.empty()) TakeRecord(records.front(), line, number);
    return true;
  }

  // A picture that a line names which cannot be used is not one without a line.
  void NoteMentioned(std::string_view line) {
    constexpr std::string_view kFolder = "\"raw/";
    const std::size_t begin = line.find(kFolder);
    if (begin == std::string_view::npos) return;
    const std::string_view name = line.substr(begin + 1);
    mentioned_.emplace(name.substr(0, name.find('"')));
  }

  void TakeRecord(const FrameRecord& record, std::string_view line, int number) {
    CheckSeal(line, number);
    const std::uint64_t frame = Value(record.frame);
    const bool has_pixels = record.status == FrameStatus::kOk;
    entries_.push_back({frame, Value(record.position), has_pixels});
    if (last_frame_ && frame > *last_frame_ + 1) {
      Add(FindingKind::kNote, "frame-gap", "frames.jsonl",
          fmt::format("frame {} after frame {}: those between have no line", frame, *last_frame_),
          number);
    }
    last_frame_ = std::max(frame, last_frame_.value_or(0));
    if (record.file.empty()) return;
    const std::string file = fs::path(record.file).lexically_normal().string();
    const auto [named, is_new] = named_.emplace(file, number);
    if (!is_new) {
      Damage("raw-named-twice", file,
             fmt::format("named by lines {} and {} of frames.jsonl, expected a picture of one "
                         "frame",
                         named->second, number));
      return;
    }
    pictures_.push_back({file, number, record.crc32c});
    if (!record.crc32c) ++report_.pictures_without_checksum;
  }

  void CheckSeal(std::string_view line, int number) {
    while (!line.empty() && (line.back() == '\n' || line.back() == '\r')) line.remove_suffix(1);
    switch (JournalSealOf(line)) {
      case JournalSeal::kHolds:
        ++report_.lines_sealed;
        break;
      case JournalSeal::kBroken:
        Damage("line-changed", "frames.jsonl",
               "its line_crc32c does not hold: changed after it was written", number);
        break;
      case JournalSeal::kNone:
        ++lines_unsealed_;
        if (first_unsealed_ == 0) first_unsealed_ = number;
        break;
    }
  }

  // ended.json, which the daemon writes behind the last line.
  void CheckEnd() {
    std::error_code error;
    if (!fs::exists(session_ / "ended.json", error)) return;
    report_.is_ended = true;
    const Result<std::string> text = ReadTextFile(session_ / "ended.json", kMaxEndBytes);
    if (!text) {
      Damage("end-unreadable", "ended.json", text.error().message);
      return;
    }
    const json::Source source{(session_ / "ended.json").string(), *text, 0};
    const Result<json::Json> value = json::Parse(source);
    if (!value || !value->is_object() || !value->contains("frames")) {
      Damage(
          "end-unreadable", "ended.json",
          value ? "frames: missing, expected the number of journal lines" : value.error().message);
      return;
    }
    const std::optional<std::int64_t> frames =
        json::WholeNumber((*value)["frames"], 0, limits::kMaxFrame);
    if (!frames || static_cast<std::uint64_t>(*frames) != next_frame_) {
      Damage("end-count", "ended.json",
             fmt::format("frames: {}, expected {} as in frames.jsonl", (*value)["frames"].dump(),
                         next_frame_));
    }
  }

  // --- raw/

  void Progress(std::size_t done) const {
    if (options_.progress) options_.progress(done, total_);
  }

  void CheckPictures() {
    std::size_t views = 0;
    for (const std::string& name : Names(views_)) views += PositionFromName(name) ? 1 : 0;
    total_ = pictures_.size() + views;
    for (std::size_t begin = 0; begin < pictures_.size(); begin += kPicturesAtOnce) {
      const std::size_t count = std::min(kPicturesAtOnce, pictures_.size() - begin);
      struct Looked {
        std::vector<SessionFinding> findings;
        std::uint64_t bytes = 0;
      };
      std::vector<Looked> looked(count);
      ParallelFor(static_cast<int>(count), 1, [&](int from, int to) {
        for (auto k = static_cast<std::size_t>(from); k < static_cast<std::size_t>(to); ++k) {
          looked[k].bytes = CheckPicture(pictures_[begin + k], &looked[k].findings);
        }
      });
      for (Looked& one : looked) {
        report_.picture_bytes += one.bytes;
        for (SessionFinding& finding : one.findings) Add(std::move(finding));
      }
      Progress(begin + count);
    }
  }

  // Its size in bytes.
  std::uint64_t CheckPicture(const Picture& picture, std::vector<SessionFinding>* findings) const {
    const fs::path path = session_ / picture.file;
    const auto damage = [&](std::string code, std::string message) {
      findings->push_back(
          {FindingKind::kDamage, std::move(code), picture.file, 0,
           fmt::format("{} (frames.jsonl:{})", WithoutName(std::move(message), path.string()),
                       picture.line)});
    };
    std::error_code error;
    const fs::file_status status = fs::status(path, error);
    if (!fs::exists(status)) {
      damage("raw-missing", "missing, expected the picture that its journal line names");
      return 0;
    }
    if (!fs::is_regular_file(status)) {
      damage("raw-unreadable", "not a regular file");
      return 0;
    }
    const std::uint64_t bytes = fs::file_size(path, error);
    if (!error && bytes == 0) {
      damage("raw-empty", "0 bytes, expected a picture");
      return 0;
    }
    if (options_.quick) return error ? 0 : bytes;
    const Result<std::vector<std::byte>> content = ReadFile(path);
    if (!content) {
      damage("raw-unreadable", content.error().message);
      return 0;
    }
    if (picture.crc32c) {
      const std::uint32_t crc = Crc32c(*content);
      if (crc != *picture.crc32c) {
        damage("raw-checksum", fmt::format("crc32c {} of {} bytes, expected {} as journaled", crc,
                                           content->size(), *picture.crc32c));
        return content->size();
      }
    }
    const Result<DecodedImage> image = DecodeImage(*content, path.string());
    if (!image) {
      damage("raw-undecodable", image.error().message);
    } else if (info_ &&
               (image->width() != info_->camera.width || image->height() != info_->camera.height)) {
      damage("raw-size", fmt::format("{}x{}, expected {}x{} as session.json says", image->width(),
                                     image->height(), info_->camera.width, info_->camera.height));
    }
    return content->size();
  }

  // Files of raw/ that no line names.
  void CheckRawNames(const std::vector<std::string>& names) {
    std::error_code error;
    for (const std::string& name : names) {
      const std::string file = "raw/" + name;
      if (named_.contains(file) || mentioned_.contains(file)) continue;
      if (IsTemporaryFile(name)) {
        AddTemporaryFile(file);
        continue;
      }
      const std::optional<std::uint64_t> frame = FrameNumberOfFile(name);
      if (!frame || !fs::is_regular_file(session_ / file, error)) {
        Add(FindingKind::kNote, "unknown-file", file, "no line of frames.jsonl names it");
      } else if (frames_.Find(*frame) != nullptr) {
        // It was written when its line could not be, and the line went in without it.
        Add(FindingKind::kLeftover, "raw-unjournaled", file,
            fmt::format("the line of frame {} does not name it: its writer was interrupted",
                        *frame));
      } else if (*frame == next_frame_) {
        if (report_.is_being_written) continue;
        Add(FindingKind::kLeftover, "raw-unjournaled", file,
            fmt::format("no line of frame {}, the next one: its writer was interrupted", *frame));
      } else if (*frame < next_frame_ || !report_.is_being_written) {
        Damage(
            "raw-unjournaled", file,
            fmt::format("no line of frame {} in frames.jsonl, expected one: it was lost", *frame));
      }
    }
  }

  void AddTemporaryFile(const std::string& file) {
    if (report_.is_being_written) return;
    Add(FindingKind::kLeftover, "temporary-file", file,
        "an unfinished file: its writer was interrupted");
  }

  // --- views/

  void CheckViews(const std::vector<std::string>& names) {
    std::vector<PositionId> positions;
    for (const std::string& name : names) {
      if (const std::optional<PositionId> position = PositionFromName(name)) {
        positions.push_back(*position);
      } else if (!IsTemporaryViewName(name)) {
        Add(FindingKind::kNote, "unknown-file", views_name_ + "/" + name, "not a view");
      } else if (!IsLocked(views_ / name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW)) {
        Add(FindingKind::kLeftover, "view-temporary", views_name_ + "/" + name,
            "half a view: its writer was interrupted");
      }
    }
    std::sort(positions.begin(), positions.end());
    report_.views = positions.size();
    for (std::size_t begin = 0; begin < positions.size(); begin += kViewsAtOnce) {
      const std::size_t count = std::min(kViewsAtOnce, positions.size() - begin);
      std::vector<std::vector<SessionFinding>> looked(count);
      ParallelFor(static_cast<int>(count), 1, [&](int from, int to) {
        for (auto k = static_cast<std::size_t>(from); k < static_cast<std::size_t>(to); ++k) {
          const PositionId position = positions[begin + k];
          const std::string name = ViewDirectoryName(position);
          looked[k] =
              CheckView(views_ / name, position, views_name_ + "/" + name, frames_, options_.quick);
        }
      });
      for (std::vector<SessionFinding>& findings : looked) {
        for (SessionFinding& finding : findings) Add(std::move(finding));
      }
      Progress(pictures_.size() + begin + count);
    }
    NoteMissing(positions);
  }

  void NoteMissing(const std::vector<PositionId>& views) {
    if (report_.is_being_written || views.empty()) return;
    std::vector<std::int64_t> missing;
    for (const std::int64_t position : frames_.positions()) {
      if (!std::binary_search(views.begin(), views.end(), PositionId{position})) {
        missing.push_back(position);
      }
    }
    if (missing.empty()) return;
    Add(FindingKind::kNote, "views-missing", views_name_,
        fmt::format("{} of {} positions have no view, the first is {}: omnihdr process --resume "
                    "makes them",
                    missing.size(), frames_.positions().size(), missing.front()));
  }

  // --- the rest

  void CheckTopLevel() {
    known_.insert({"session.json", "frames.jsonl", "ended.json", "timings.jsonl", "rig.toml", "raw",
                   "views", "lost+found"});
    for (const auto& [file, line] : named_) known_.insert(fs::path(file).begin()->string());
    for (const std::string& name : Names(session_)) {
      if (known_.contains(name)) continue;
      if (IsTemporaryFile(name)) {
        AddTemporaryFile(name);
      } else {
        Add(FindingKind::kNote, "unknown-file", name, "not one of a session's files");
      }
    }
  }

  const fs::path session_;
  const SessionCheckOptions& options_;
  const fs::path views_;
  const std::string views_name_;
  SessionReport report_;
  std::optional<SessionInfo> info_;
  std::vector<FrameIndex::Entry> entries_;
  FrameIndex frames_{{}};
  std::vector<Picture> pictures_;
  std::map<std::string, int> named_;  // pictures, and the line that names them
  std::set<std::string> mentioned_;   // pictures of rejected lines
  std::set<std::string> known_;       // names of the top level
  std::optional<std::uint64_t> last_frame_;
  std::size_t lines_unsealed_ = 0;
  int first_unsealed_ = 0;
  std::uint64_t next_frame_ = 0;
  std::size_t total_ = 0;
};

}  // namespace

std::string_view ToString(FindingKind kind) {
  switch (kind) {
    case FindingKind::kDamage:
      return "damage";
    case FindingKind::kLeftover:
      return "leftover";
    case FindingKind::kNote:
      return "note";
  }
  return "?";
}

Result<SessionReport> CheckSession(const fs::path& session, const SessionCheckOptions& options) {
  return SessionChecker(session, options).Run();
}

}  // namespace omnihdr
