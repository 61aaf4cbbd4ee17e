#include "core/session/view_writer.h"

#include <fcntl.h>
#include <linux/fs.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <limits>
#include <utility>

#include "core/base/file.h"
#include "core/session/json.h"
#include "core/session/limits.h"
#include "core/session/view_names.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;
namespace limits = session_limits;
using json::Json;
using json::ObjectReader;
using json::ObjectWriter;

constexpr std::int64_t kMaxLevel = 1000;  // of quality: a later version may know more than this one

bool IsComplete(const fs::path& views, PositionId position) {
  return ReadViewRecord(views, position).has_value();
}

Status RemoveAll(const fs::path& path) {
  std::error_code error;
  fs::remove_all(path, error);
  if (error) {
    return Fail(ErrorKind::kIo, "{}: remove: {}", path.string(), error.message());
  }
  return {};
}

ErrorKind CreateKind(int error_number) {
  return error_number == EACCES || error_number == EPERM || error_number == EROFS
             ? ErrorKind::kPermission
             : ErrorKind::kCannotCreate;
}

// A directory that only one process at a time can be filling.
Result<Fd> LockDirectory(const fs::path& directory) {
  Fd fd(::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW));
  if (!fd.valid()) return FailErrno(ErrorKind::kIo, directory.string(), errno);
  if (::flock(fd.get(), LOCK_EX | LOCK_NB) != 0) {
    return Fail(ErrorKind::kTemporary, "{}: another process is writing this view",
                directory.string());
  }
  return fd;
}

bool IsSameDirectory(const Fd& fd, const fs::path& directory) {
  struct stat opened {};
  struct stat named {};
  return ::fstat(fd.get(), &opened) == 0 && ::lstat(directory.c_str(), &named) == 0 &&
         opened.st_dev == named.st_dev && opened.st_ino == named.st_ino;
}

// An empty temporary directory, locked.
Result<Fd> MakeTemporary(const fs::path& temporary) {
  struct stat existing {};
  if (::lstat(temporary.c_str(), &existing) == 0) {
    if (S_ISDIR(existing.st_mode)) {
      OMNIHDR_ASSIGN(const Fd stale, LockDirectory(temporary));
      OMNIHDR_TRY(RemoveAll(temporary));
    } else {
      OMNIHDR_TRY(RemoveAll(temporary));
    }
  }
  if (::mkdir(temporary.c_str(), 0755) != 0) {
    const int error_number = errno;
    return FailErrno(CreateKind(error_number), temporary.string(), error_number);
  }
  OMNIHDR_ASSIGN(Fd lock, LockDirectory(temporary));
  if (!IsSameDirectory(lock, temporary)) {
    return Fail(ErrorKind::kTemporary, "{}: another process is writing this view",
                temporary.string());
  }
  return lock;
}

Status SyncTree(const fs::path& directory) {
  std::error_code error;
  std::vector<fs::path> directories = {directory};
  for (fs::recursive_directory_iterator it(directory, error), end; !error && it != end;
       it.increment(error)) {
    if (it->is_symlink()) continue;
    if (it->is_directory()) {
      directories.push_back(it->path());
    } else if (it->is_regular_file()) {
      OMNIHDR_TRY(SyncFile(it->path()));
    }
  }
  if (error) return Fail(ErrorKind::kIo, "{}: {}", directory.string(), error.message());
  for (auto it = directories.rbegin(); it != directories.rend(); ++it) {
    OMNIHDR_TRY(SyncDirectory(*it));
  }
  return {};
}

int RenameAt(const fs::path& from, const fs::path& to, unsigned flags) {
  return ::renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), flags) == 0 ? 0 : errno;
}

// Puts the temporary directory into its place. `replacing`: what is there now goes.
Status MoveIntoPlace(const fs::path& temporary, const fs::path& final_path, bool replacing) {
  if (!replacing) {
    int error_number = RenameAt(temporary, final_path, RENAME_NOREPLACE);
    if (error_number == EINVAL || error_number == ENOSYS) {
      // A file system without the flag. rename() refuses to replace a directory that is not empty.
      error_number = RenameAt(temporary, final_path, 0);
    }
    if (error_number == EEXIST || error_number == ENOTEMPTY) {
      return Fail(ErrorKind::kCannotCreate, "{}: already exists", final_path.string());
    }
    if (error_number != 0) {
      return FailErrno(ErrorKind::kIo, fmt::format("{}: rename", final_path.string()),
                       error_number);
    }
    return {};
  }
  int error_number = RenameAt(temporary, final_path, RENAME_EXCHANGE);
  if (error_number == EINVAL || error_number == ENOSYS) {
    // Then for a moment there is no view, never half of one.
    OMNIHDR_TRY(RemoveAll(final_path));
    error_number = RenameAt(temporary, final_path, 0);
  }
  if (error_number != 0) {
    return FailErrno(ErrorKind::kIo, fmt::format("{}: rename", final_path.string()), error_number);
  }
  return {};
}

// Radiance statistics of a view without any valid pixel are NaN, which JSON writes as null.
Result<double> NumberOrNull(const ObjectReader& object, std::string_view key) {
  if (object.value().contains(std::string(key)) && !object.Has(key)) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  constexpr double kHuge = std::numeric_limits<double>::max();
  return object.Number(key, -kHuge, kHuge, "a number or null");
}

Result<ViewRecord> ReadRecordFile(const fs::path& path, PositionId position) {
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(path, limits::kMaxViewBytes));
  OMNIHDR_ASSIGN(ViewRecord record, ParseViewRecord(text, path.string()));
  if (record.position != position) {
    return Fail(ErrorKind::kData, "{}: position: {}, expected {} as the directory's name",
                path.string(), Value(record.position), Value(position));
  }
  return record;
}

Json VectorJson(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

Result<Eigen::Vector3d> ReadSigma(const ObjectReader& pose, std::string_view key) {
  constexpr std::string_view kExpected = "three numbers of at least 0 [x, y, z]";
  OMNIHDR_ASSIGN(const Json* array, pose.Array(key, kExpected));
  Eigen::Vector3d sigma;
  if (array->size() != 3) return pose.Wrong(key, kExpected);
  for (std::size_t i = 0; i < 3; ++i) {
    const std::optional<double> number = json::FiniteNumber((*array)[i]);
    if (!number || *number < 0.0) return pose.Wrong(key, kExpected);
    sigma[static_cast<Eigen::Index>(i)] = *number;
  }
  return sigma;
}

Result<PositionId> ReadPosition(const ObjectReader& object, std::string_view key) {
  OMNIHDR_ASSIGN(const std::int64_t position,
                 object.Integer(key, 0, limits::kMaxPosition, "a whole number in [0, 999999999]"));
  return PositionId{position};
}

Result<int> ReadCount(const ObjectReader& object, std::string_view key) {
  OMNIHDR_ASSIGN(const std::int64_t count,
                 object.Integer(key, 0, INT32_MAX, "a whole number in [0, 2147483647]"));
  return static_cast<int>(count);
}

// The additive keys that say more of the pose.
Status ReadPoseNotes(const ObjectReader& view, ViewRecord* record) {
  OMNIHDR_ASSIGN(const ObjectReader pose, view.Object("pose"));
  if (pose.Has("sigma_rotation_deg") || pose.Has("sigma_t")) {
    PoseSigma sigma;
    OMNIHDR_ASSIGN(sigma.rotation_deg, ReadSigma(pose, "sigma_rotation_deg"));
    OMNIHDR_ASSIGN(sigma.translation, ReadSigma(pose, "sigma_t"));
    record->sigma = sigma;
  }
  OMNIHDR_ASSIGN(record->dead_reckoned, view.StringOr("dead_reckoned", ""));
  if (view.Has("relocalised")) {
    OMNIHDR_ASSIGN(const ObjectReader object, view.Object("relocalised"));
    Relocalisation relocalised;
    OMNIHDR_ASSIGN(relocalised.place, ReadPosition(object, "place"));
    OMNIHDR_ASSIGN(relocalised.seen_from, ReadPosition(object, "seen_from"));
    OMNIHDR_ASSIGN(relocalised.from_chain, ReadCount(object, "from_chain"));
    OMNIHDR_ASSIGN(relocalised.matches, ReadCount(object, "matches"));
    record->relocalised = relocalised;
  }
  if (view.Has("gnss_scale")) {
    OMNIHDR_ASSIGN(const ObjectReader object, view.Object("gnss_scale"));
    constexpr double kHuge = std::numeric_limits<double>::max();
    constexpr std::string_view kExpected = "a number of at least 0";
    GnssScale scale;
    OMNIHDR_ASSIGN(scale.metres_per_unit, object.Number("metres_per_unit", 0.0, kHuge, kExpected));
    OMNIHDR_ASSIGN(scale.sigma, object.Number("sigma", 0.0, kHuge, kExpected));
    OMNIHDR_ASSIGN(scale.fixes, ReadCount(object, "fixes"));
    OMNIHDR_ASSIGN(scale.outliers, ReadCount(object, "outliers"));
    record->gnss_scale = scale;
  }
  if (view.Has("loop")) {
    OMNIHDR_ASSIGN(const ObjectReader object, view.Object("loop"));
    constexpr double kHuge = std::numeric_limits<double>::max();
    constexpr std::string_view kExpected = "a number of at least 0";
    LoopClosure loop;
    OMNIHDR_ASSIGN(loop.place, ReadPosition(object, "place"));
    OMNIHDR_ASSIGN(loop.seen_from, ReadPosition(object, "seen_from"));
    OMNIHDR_ASSIGN(loop.matches, ReadCount(object, "matches"));
    OMNIHDR_ASSIGN(loop.drift_rotation_deg,
                   object.Number("drift_rotation_deg", 0.0, kHuge, kExpected));
    OMNIHDR_ASSIGN(loop.drift_translation,
                   object.Number("drift_translation", 0.0, kHuge, kExpected));
    OMNIHDR_ASSIGN(loop.drift_scale, object.Number("drift_scale", 0.0, kHuge, kExpected));
    OMNIHDR_ASSIGN(loop.corrected, object.BoolOr("corrected", false));
    record->loop = loop;
  }
  return {};
}

constexpr std::string_view kFrameNumber = "a whole number in [0, 999999999999]";

}  // namespace

std::string FormatViewRecord(const ViewRecord& record) {
  ObjectWriter view(true);
  view.Add("position", Value(record.position));
  ObjectWriter pose = json::PoseObject(record.pose);
  if (record.sigma) {
    pose.Add("sigma_rotation_deg", VectorJson(record.sigma->rotation_deg));
    pose.Add("sigma_t", VectorJson(record.sigma->translation));
  }
  view.AddObject("pose", std::move(pose));
  view.Add("scale", record.metric_scale ? "metric" : "relative");
  if (record.scale_source != ScaleSource::kNone) {
    view.Add("scale_source", std::string(ToString(record.scale_source)));
  }
  if (record.gnss_scale) {
    ObjectWriter gnss;
    gnss.Add("metres_per_unit", record.gnss_scale->metres_per_unit)
        .Add("sigma", record.gnss_scale->sigma)
        .Add("fixes", record.gnss_scale->fixes)
        .Add("outliers", record.gnss_scale->outliers);
    view.AddObject("gnss_scale", std::move(gnss));
  }
  view.Add("chain", record.chain);
  if (!record.chain_reason.empty()) view.Add("chain_reason", record.chain_reason);
  if (!record.dead_reckoned.empty()) view.Add("dead_reckoned", record.dead_reckoned);
  if (record.relocalised) {
    ObjectWriter relocalised;
    relocalised.Add("place", Value(record.relocalised->place))
        .Add("seen_from", Value(record.relocalised->seen_from))
        .Add("from_chain", record.relocalised->from_chain)
        .Add("matches", record.relocalised->matches);
    view.AddObject("relocalised", std::move(relocalised));
  }
  if (record.loop) {
    ObjectWriter loop;
    loop.Add("place", Value(record.loop->place))
        .Add("seen_from", Value(record.loop->seen_from))
        .Add("matches", record.loop->matches)
        .Add("drift_rotation_deg", record.loop->drift_rotation_deg)
        .Add("drift_translation", record.loop->drift_translation)
        .Add("drift_scale", record.loop->drift_scale)
        .Add("corrected", record.loop->corrected);
    view.AddObject("loop", std::move(loop));
  }
  view.Add("orientation", json::QuaternionJson(record.orientation));
  view.Add("frames", record.frames);
  view.Add("reference", record.reference);
  view.Add("mode", record.mode);
  ObjectWriter radiance;
  radiance.Add("min", record.radiance_min).Add("max", record.radiance_max);
  radiance.Add("valid_fraction", record.valid_fraction);
  view.AddObject("radiance", std::move(radiance));
  view.Add("warnings", record.warnings);
  view.Add("quality_level", record.quality_level);
  if (!record.quality.empty()) view.Add("quality", record.quality);
  if (!record.made_with.empty()) view.Add("made_with", record.made_with);
  if (!record.resume_json.empty()) view.AddRaw("resume", record.resume_json);
  return std::move(view).Finish();
}

Result<ViewRecord> ParseViewRecord(std::string_view text, const std::string& name) {
  if (text.size() > limits::kMaxViewBytes) {
    return Fail(ErrorKind::kData, "{}: {} bytes, expected at most {}", name, text.size(),
                limits::kMaxViewBytes);
  }
  const json::Source source{name, text, 0};
  OMNIHDR_ASSIGN(const Json value, json::Parse(source));
  OMNIHDR_ASSIGN(const ObjectReader view, ObjectReader::Root(source, value));
  ViewRecord record;
  OMNIHDR_ASSIGN(const std::int64_t position, view.Integer("position", 0, limits::kMaxPosition,
                                                           "a whole number in [0, 999999999]"));
  record.position = PositionId{position};
  OMNIHDR_ASSIGN(record.pose, view.ReadPose("pose"));
  constexpr std::string_view kScales = "\"metric\" or \"relative\"";
  OMNIHDR_ASSIGN(const std::string scale, view.String("scale", kScales));
  if (scale != "metric" && scale != "relative") return view.Wrong("scale", kScales);
  record.metric_scale = scale == "metric";
  constexpr std::string_view kSources = "\"odometer\", \"gnss\", \"given\" or \"none\"";
  OMNIHDR_ASSIGN(const std::string unit_from, view.StringOr("scale_source", "none"));
  const std::optional<ScaleSource> known_source = ScaleSourceFromString(unit_from);
  if (!known_source) return view.Wrong("scale_source", kSources);
  record.scale_source = *known_source;
  OMNIHDR_ASSIGN(const std::int64_t chain,
                 view.IntegerOr("chain", 0, 0, INT32_MAX, "a whole number in [0, 2147483647]"));
  record.chain = static_cast<int>(chain);
  OMNIHDR_ASSIGN(record.chain_reason, view.StringOr("chain_reason", ""));
  OMNIHDR_TRY(ReadPoseNotes(view, &record));
  OMNIHDR_ASSIGN(record.orientation, view.Quaternion("orientation"));
  constexpr std::string_view kFrames = "an array of frame numbers";
  OMNIHDR_ASSIGN(const Json* frames, view.Array("frames", kFrames));
  for (const Json& frame : *frames) {
    const std::optional<std::int64_t> number = json::WholeNumber(frame, 0, limits::kMaxFrame);
    if (!number) return view.Wrong("frames", kFrames);
    record.frames.push_back(static_cast<std::uint64_t>(*number));
  }
  OMNIHDR_ASSIGN(const std::int64_t reference,
                 view.Integer("reference", 0, limits::kMaxFrame, kFrameNumber));
  record.reference = static_cast<std::uint64_t>(reference);
  OMNIHDR_ASSIGN(record.mode, view.String("mode", "\"spatiotemporal\" or \"temporal\""));
  OMNIHDR_ASSIGN(const ObjectReader radiance, view.Object("radiance"));
  OMNIHDR_ASSIGN(record.radiance_min, NumberOrNull(radiance, "min"));
  OMNIHDR_ASSIGN(record.radiance_max, NumberOrNull(radiance, "max"));
  OMNIHDR_ASSIGN(record.valid_fraction, NumberOrNull(radiance, "valid_fraction"));
  if (view.Has("warnings")) {
    constexpr std::string_view kWarnings = "an array of strings";
    OMNIHDR_ASSIGN(const Json* warnings, view.Array("warnings", kWarnings));
    for (const Json& warning : *warnings) {
      if (!warning.is_string()) return view.Wrong("warnings", kWarnings);
      record.warnings.push_back(warning.get<std::string>());
    }
  }
  OMNIHDR_ASSIGN(const std::int64_t level,
                 view.IntegerOr("quality_level", 0, 0, kMaxLevel, "a whole number in [0, 1000]"));
  record.quality_level = static_cast<int>(level);
  OMNIHDR_ASSIGN(record.quality, view.StringOr("quality", ""));
  OMNIHDR_ASSIGN(record.made_with, view.StringOr("made_with", ""));
  if (const Json* resume = view.Find("resume")) record.resume_json = resume->dump();
  return record;
}

std::string ViewDirectoryName(PositionId position) { return fmt::format("{:06}", Value(position)); }

Status WriteView(const fs::path& views_directory, PositionId position, bool replace,
                 const std::function<Status(const fs::path& directory)>& fill) {
  const std::string what = fmt::format("write view {}", ViewDirectoryName(position));
  if (Value(position) < 0 || Value(position) > limits::kMaxPosition) {
    return Fail(ErrorKind::kSoftware, "{}: expected a position in [0, {}]", what,
                limits::kMaxPosition);
  }
  std::error_code error;
  const bool new_directory = fs::create_directories(views_directory, error);
  if (error) {
    return Fail(CreateKind(error.value()), "{}: {}: {}", what, views_directory.string(),
                error.message());
  }
  const fs::path parent = views_directory.parent_path();
  if (new_directory) OMNIHDR_TRY(SyncDirectory(parent.empty() ? fs::path(".") : parent));

  const fs::path final_path = views_directory / ViewDirectoryName(position);
  const fs::path temporary = TemporaryViewName(views_directory, position);
  // A directory of that name which is not a complete view is rubbish somebody left; it goes.
  if (!replace && IsComplete(views_directory, position)) {
    return Fail(ErrorKind::kCannotCreate, "{}: {}: already exists", what, final_path.string());
  }
  OMNIHDR_ASSIGN(Fd lock, MakeTemporary(temporary).Context(what));

  Status done = fill(temporary);
  if (done) {
    // Only a view that will be found again may take the place.
    if (Result<ViewRecord> record = ReadRecordFile(temporary / "view.json", position); !record) {
      done = Forward(std::move(record).error());
    }
  }
  if (done) done = SyncTree(temporary);
  bool replacing = false;
  if (done) {
    replacing = fs::symlink_status(final_path, error).type() != fs::file_type::not_found;
    done = MoveIntoPlace(temporary, final_path, replacing);
  }
  if (done) done = SyncDirectory(views_directory);
  if (!done || replacing) {
    // What is under the temporary name now is the failure, or the view that was replaced.
    const Status removed = RemoveAll(temporary);
    if (done && !removed) return Forward(removed.error(), what);
  }
  return std::move(done).Context(what);
}

Result<std::map<PositionId, int>> CompleteViewLevels(const fs::path& views_directory) {
  std::map<PositionId, int> levels;
  std::error_code error;
  if (!fs::exists(views_directory, error)) return levels;
  fs::directory_iterator it(views_directory, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
    const std::optional<PositionId> position = PositionFromName(it->path().filename().string());
    if (!position) continue;
    if (const Result<ViewRecord> record = ReadViewRecord(views_directory, *position)) {
      levels.emplace(*position, record->quality_level);
    }
  }
  if (error) {
    return Fail(ErrorKind::kNoInput, "{}: {}", views_directory.string(), error.message());
  }
  return levels;
}

Result<std::vector<PositionId>> CompleteViews(const fs::path& views_directory) {
  OMNIHDR_ASSIGN(const auto levels, CompleteViewLevels(views_directory));
  std::vector<PositionId> positions;
  for (const auto& [position, level] : levels) positions.push_back(position);
  return positions;
}

Result<ViewRecord> ReadViewRecord(const fs::path& views_directory, PositionId position) {
  return ReadRecordFile(views_directory / ViewDirectoryName(position) / "view.json", position);
}

Result<int> RemoveTemporaryViews(const fs::path& views_directory) {
  std::error_code error;
  if (!fs::exists(views_directory, error)) return 0;
  std::vector<fs::path> found;
  fs::directory_iterator it(views_directory, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
    if (IsTemporaryViewName(it->path().filename().string())) found.push_back(it->path());
  }
  if (error) {
    return Fail(ErrorKind::kNoInput, "{}: {}", views_directory.string(), error.message());
  }
  int removed = 0;
  for (const fs::path& path : found) {
    Result<Fd> lock;
    if (fs::is_directory(fs::symlink_status(path, error))) {
      lock = LockDirectory(path);
      if (!lock) continue;  // somebody is filling it
    }
    OMNIHDR_TRY(RemoveAll(path));
    ++removed;
  }
  return removed;
}

}  // namespace omnihdr
