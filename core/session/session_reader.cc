#include "core/session/session_reader.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <limits>
#include <utility>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/journal_parser.h"
#include "core/session/json.h"
#include "core/session/limits.h"
#include "core/session/response_members.h"
#include "core/session/utc_text.h"

namespace omnihdr {
namespace {

using json::Json;
using json::ObjectReader;
using json::ObjectWriter;
namespace limits = session_limits;

Result<CameraDescription> ReadCamera(const ObjectReader& session) {
  OMNIHDR_ASSIGN(const ObjectReader json, session.Object("camera"));
  CameraDescription camera;
  OMNIHDR_ASSIGN(camera.model, json.StringOr("model", ""));
  OMNIHDR_ASSIGN(camera.serial, json.StringOr("serial", ""));
  OMNIHDR_ASSIGN(const std::int64_t bits,
                 json.IntegerOr("bits", 8, 8, 16, "a whole number in [8, 16]"));
  camera.bits = static_cast<int>(bits);

  constexpr std::string_view kLayouts = "\"panorama\", \"rig\" or \"perspective\"";
  OMNIHDR_ASSIGN(const std::string layout, json.String("layout", kLayouts));
  if (layout == "panorama") {
    camera.layout = Layout::kPanorama;
  } else if (layout == "rig") {
    camera.layout = Layout::kRig;
  } else if (layout == "perspective") {
    camera.layout = Layout::kPerspective;
  } else {
    return json.Wrong("layout", kLayouts);
  }

  constexpr std::string_view kSide = "pixels in [64, 65536]";
  OMNIHDR_ASSIGN(const std::int64_t width,
                 json.Integer("width", limits::kMinSide, limits::kMaxSide, kSide));
  OMNIHDR_ASSIGN(const std::int64_t height,
                 json.Integer("height", limits::kMinSide, limits::kMaxSide, kSide));
  if (width * height > static_cast<std::int64_t>(kMaxImagePixels)) {
    return json.Wrong(
        "height", fmt::format("at most {} pixels in all with width {}", kMaxImagePixels, width));
  }
  camera.width = static_cast<int>(width);
  camera.height = static_cast<int>(height);

  if (camera.layout == Layout::kPanorama) {
    constexpr std::string_view kProjections = "\"cylindrical\" or \"equirectangular\"";
    OMNIHDR_ASSIGN(const std::string name, json.String("projection", kProjections));
    const std::optional<ProjectionKind> projection = ProjectionKindFromString(name);
    if (!projection) return json.Wrong("projection", kProjections);
    camera.projection = *projection;
    if (camera.projection == ProjectionKind::kCylindrical) {
      constexpr std::string_view kZ = "a number in [-1000, 1000]";
      OMNIHDR_ASSIGN(camera.z_min,
                     json.Number("z_min", -limits::kMaxCylinderZ, limits::kMaxCylinderZ, kZ));
      OMNIHDR_ASSIGN(camera.z_max,
                     json.Number("z_max", -limits::kMaxCylinderZ, limits::kMaxCylinderZ, kZ));
      if (!(camera.z_max - camera.z_min >= 1e-6)) {
        return json.Wrong("z_max", fmt::format("more than z_min, {}", camera.z_min));
      }
    }
  } else if (camera.layout == Layout::kRig) {
    constexpr std::string_view kBayer = "\"RGGB\", \"GRBG\", \"GBRG\", \"BGGR\" or \"none\"";
    OMNIHDR_ASSIGN(camera.bayer, json.String("bayer", kBayer));
    if (camera.bayer != "RGGB" && camera.bayer != "GRBG" && camera.bayer != "GBRG" &&
        camera.bayer != "BGGR" && camera.bayer != "none") {
      return json.Wrong("bayer", kBayer);
    }
  } else if (json.Has("fx") || json.Has("fy") || json.Has("cx") || json.Has("cy")) {
    // A bracket from an unknown lens has no intrinsics; half of them is a mistake.
    constexpr std::string_view kFocal = "pixels in [1, 1e+06]";
    constexpr std::string_view kCentre = "pixels in [-1e+06, 1e+06]";
    OMNIHDR_ASSIGN(camera.intrinsics.fx, json.Number("fx", 1.0, 1e6, kFocal));
    OMNIHDR_ASSIGN(camera.intrinsics.fy, json.Number("fy", 1.0, 1e6, kFocal));
    OMNIHDR_ASSIGN(camera.intrinsics.cx, json.Number("cx", -1e6, 1e6, kCentre));
    OMNIHDR_ASSIGN(camera.intrinsics.cy, json.Number("cy", -1e6, 1e6, kCentre));
  }
  return camera;
}

Result<BracketDescription> ReadBracket(const ObjectReader& session) {
  OMNIHDR_ASSIGN(const ObjectReader json, session.Object("bracket"));
  BracketDescription bracket;
  constexpr std::string_view kOrders = "\"sawtooth\", \"triangle\" or \"list\"";
  OMNIHDR_ASSIGN(const std::string order, json.String("order", kOrders));
  if (order == "sawtooth") {
    bracket.order = BracketOrder::kSawtooth;
  } else if (order == "triangle") {
    bracket.order = BracketOrder::kTriangle;
  } else if (order == "list") {
    bracket.order = BracketOrder::kList;
  } else {
    return json.Wrong("order", kOrders);
  }
  constexpr std::string_view kExposures =
      "an array of 1 to 1000 exposures, each in seconds in [1e-09, 100000]";
  OMNIHDR_ASSIGN(const Json* exposures, json.Array("exposures_s", kExposures));
  if (exposures->empty() || exposures->size() > limits::kMaxBracket) {
    return json.Wrong("exposures_s", kExposures);
  }
  for (const Json& value : *exposures) {
    const std::optional<double> seconds = json::FiniteNumber(value);
    if (!seconds || *seconds < limits::kMinExposureSeconds ||
        *seconds > limits::kMaxExposureSeconds) {
      return json.Wrong("exposures_s", kExposures);
    }
    bracket.exposures.push_back(ExposureTime::Seconds(*seconds));
  }
  OMNIHDR_ASSIGN(const std::int64_t frames,
                 json.IntegerOr("frames_per_position", 1, 1, limits::kMaxFramesPerPosition,
                                "a whole number in [1, 1000]"));
  bracket.frames_per_position = static_cast<int>(frames);
  OMNIHDR_ASSIGN(bracket.metered, json.BoolOr("metered", false));
  return bracket;
}

ObjectWriter CameraObject(const CameraDescription& camera) {
  ObjectWriter json;
  json.Add("model", camera.model).Add("serial", camera.serial).Add("bits", camera.bits);
  json.Add("layout", std::string(ToString(camera.layout)));
  if (camera.layout == Layout::kPanorama) {
    json.Add("projection", std::string(ToString(camera.projection)));
  }
  json.Add("width", camera.width).Add("height", camera.height);
  if (camera.layout == Layout::kPanorama && camera.projection == ProjectionKind::kCylindrical) {
    json.Add("z_min", camera.z_min).Add("z_max", camera.z_max);
  }
  if (camera.layout == Layout::kRig) json.Add("bayer", camera.bayer);
  if (camera.layout == Layout::kPerspective && camera.intrinsics.fx > 0.0) {
    json.Add("fx", camera.intrinsics.fx).Add("fy", camera.intrinsics.fy);
    json.Add("cx", camera.intrinsics.cx).Add("cy", camera.intrinsics.cy);
  }
  return json;
}

// The keys of session.json's top level that SessionInfo has members for.
constexpr std::array<std::string_view, 6> kOwnKeys = {"format", "version",  "created",
                                                      "camera", "response", "bracket"};

}  // namespace

Result<SessionInfo> ParseSessionInfo(std::string_view text, const std::string& name) {
  if (text.size() > limits::kMaxInfoBytes) {
    return Fail(ErrorKind::kData, "{}: {} bytes, expected at most {}", name, text.size(),
                limits::kMaxInfoBytes);
  }
  const json::Source source{name, text, 0};
  OMNIHDR_ASSIGN(Json value, json::Parse(source));
  OMNIHDR_ASSIGN(const ObjectReader json, ObjectReader::Root(source, value));
  constexpr std::string_view kFormat = "\"omnihdr-session\"";
  OMNIHDR_ASSIGN(const std::string format, json.String("format", kFormat));
  if (format != "omnihdr-session") return json.Wrong("format", kFormat);
  OMNIHDR_TRY(json.Integer("version", 1, 1, "1, the version this program reads"));

  SessionInfo info;
  OMNIHDR_ASSIGN(info.created, json.StringOr("created", ""));
  OMNIHDR_ASSIGN(info.camera, ReadCamera(json));
  OMNIHDR_ASSIGN(const ObjectReader response, json.Object("response"));
  OMNIHDR_ASSIGN(info.response, json::ReadResponse(response));
  if (json.Has("bracket")) {
    OMNIHDR_ASSIGN(info.bracket, ReadBracket(json));
  }
  for (const std::string_view key : kOwnKeys) value.erase(std::string(key));
  if (!value.empty()) info.extra_json = value.dump();
  return info;
}

std::string FormatSessionInfo(const SessionInfo& info) {
  ObjectWriter json(true);
  json.Add("format", "omnihdr-session").Add("version", 1).Add("created", info.created);
  json.AddObject("camera", CameraObject(info.camera));
  json.AddObject("response", json::ResponseObject(info.response));
  if (info.bracket) {
    Json exposures = Json::array();
    for (const ExposureTime exposure : info.bracket->exposures) {
      exposures.push_back(exposure.seconds());
    }
    ObjectWriter bracket;
    bracket.Add("order", std::string(ToString(info.bracket->order)));
    bracket.Add("exposures_s", exposures);
    if (info.bracket->frames_per_position != 1) {
      bracket.Add("frames_per_position", info.bracket->frames_per_position);
    }
    if (info.bracket->metered) bracket.Add("metered", true);
    json.AddObject("bracket", std::move(bracket));
  }
  if (!info.extra_json.empty()) json.AddMembers(info.extra_json);
  return std::move(json).Finish();
}

Result<JournalContents> ParseJournal(std::string_view text, const std::string& name,
                                     int first_line) {
  JournalParser parser(name);
  JournalContents contents;
  const JournalParser::Fed fed = parser.Feed(text, first_line, contents.frames);
  contents.complete_bytes = fed.bytes;
  if (fed.bytes < text.size()) {
    parser.Warn(parser.TornLineWarning(first_line + fed.lines, text.size() - fed.bytes));
  }
  if (parser.lines_used() == 0 && parser.lines_rejected() > 0) {
    return Fail(ErrorKind::kData, "{}: none of {} lines is usable; the first: {}", name,
                parser.lines_rejected(), parser.rejected().front());
  }
  if (parser.lines_used() == 0) {
    parser.Warn(fmt::format("{}: no frames: the session is empty", name));
  }
  contents.warnings = parser.warnings();
  contents.rejected = parser.rejected();
  if (parser.warnings_left_out() > 0) {
    contents.warnings.push_back(
        fmt::format("{}: {} more warnings", name, parser.warnings_left_out()));
  }
  return contents;
}

std::string FormatFrameRecord(const FrameRecord& record) {
  ObjectWriter json;
  json.Add("frame", Value(record.frame)).Add("position", Value(record.position));
  if (!record.file.empty()) json.Add("file", record.file);
  if (record.exposure.time.seconds() != 0.0) {
    json.Add("exposure_s", record.exposure.time.seconds());
  }
  json.Add("gain_db", record.exposure.gain.value);
  json.Add("trigger_ns", record.trigger_time.ns()).Add("timestamp_ns", record.timestamp.ns());
  if (record.odometer_m) json.Add("odometer_m", *record.odometer_m);
  json.Add("status", std::string(ToString(record.status)));
  if (!record.detail.empty()) json.Add("detail", record.detail);
  if (record.crc32c) json.Add("crc32c", *record.crc32c);
  if (record.step) json.Add("step", *record.step);
  if (record.retakes > 0) json.Add("retakes", record.retakes);
  if (record.camera_time) json.Add("camera_time_ns", record.camera_time->ns());
  if (record.timestamp_error) json.Add("timestamp_error_ns", record.timestamp_error->count());
  if (record.utc) json.Add("utc", IsoUtcNanoseconds(*record.utc)).Add("utc_ns", record.utc->ns());
  if (!record.utc_source.empty()) json.Add("utc_source", record.utc_source);
  if (record.utc_error_s) json.Add("utc_error_s", *record.utc_error_s);
  if (record.proof != ExposureProof::kNone) {
    json.Add("exposure_proof", std::string(ToString(record.proof)));
  }
  if (record.gnss) {
    ObjectWriter gnss;
    gnss.Add("lat", record.gnss->lat_deg).Add("lon", record.gnss->lon_deg);
    gnss.Add("alt_m", record.gnss->alt_m);
    gnss.Add("time", record.gnss->time);
    gnss.Add("fix", record.gnss->fix);
    if (record.gnss->dimensions > 0) gnss.Add("dimensions", record.gnss->dimensions);
    if (record.gnss->error_m) gnss.Add("error_m", *record.gnss->error_m);
    if (record.gnss->time_error_s) gnss.Add("time_error_s", *record.gnss->time_error_s);
    if (record.gnss->age_s) gnss.Add("age_s", *record.gnss->age_s);
    if (!record.gnss->time_source.empty()) gnss.Add("time_source", record.gnss->time_source);
    json.AddObject("gnss", std::move(gnss));
  }
  if (record.gnss_missing) json.Add("gnss_missing", true);
  if (record.heading_deg) json.Add("heading_deg", *record.heading_deg);
  if (record.pose) json.AddObject("pose", json::PoseObject(*record.pose));
  if (record.temperature_c) json.Add("temperature_c", *record.temperature_c);
  if (!record.settings_readback_json.empty()) {
    json.AddRaw("settings_readback", record.settings_readback_json);
  }
  if (!record.truth_json.empty()) json.AddRaw("truth", record.truth_json);
  return std::move(json).Finish();
}

Result<SessionContents> ReadSession(const std::filesystem::path& directory) {
  const std::filesystem::path info_path = directory / "session.json";
  const std::filesystem::path journal_path = directory / "frames.jsonl";
  OMNIHDR_ASSIGN(const std::string info_text, ReadTextFile(info_path, limits::kMaxInfoBytes));
  SessionContents contents;
  OMNIHDR_ASSIGN(contents.info, ParseSessionInfo(info_text, info_path.string()));
  OMNIHDR_ASSIGN(const std::string journal, ReadTextFile(journal_path, limits::kMaxJournalBytes));
  OMNIHDR_ASSIGN(contents.journal, ParseJournal(journal, journal_path.string()));
  return contents;
}

JournalFollower::JournalFollower(const std::filesystem::path& session_directory)
    : path_(session_directory / "frames.jsonl"),
      parser_(std::make_unique<JournalParser>(path_.string())) {}
JournalFollower::JournalFollower(JournalFollower&&) noexcept = default;
JournalFollower& JournalFollower::operator=(JournalFollower&&) noexcept = default;
JournalFollower::~JournalFollower() = default;

Result<std::vector<FrameRecord>> JournalFollower::ReadNew() {
  // Asked before the file is: what is durable by now is there.
  const std::size_t limit =
      limit_ ? std::max<std::size_t>(limit_(), offset_) : std::numeric_limits<std::size_t>::max();
  const Fd fd(::open(path_.c_str(), O_RDONLY | O_CLOEXEC));
  if (!fd.valid()) {
    return FailErrno(errno == ENOENT ? ErrorKind::kNoInput : ErrorKind::kIo, path_.string(), errno);
  }
  struct stat status {};
  if (::fstat(fd.get(), &status) != 0) return FailErrno(ErrorKind::kIo, path_.string(), errno);
  if (!S_ISREG(status.st_mode)) {
    return Fail(ErrorKind::kNoInput, "{}: not a regular file", path_.string());
  }
  if (static_cast<std::size_t>(status.st_size) < offset_) {
    return Fail(ErrorKind::kData, "{}: {} bytes, expected at least the {} read before",
                path_.string(), status.st_size, offset_);
  }

  std::vector<FrameRecord> frames;
  std::string text;  // from offset_ on
  constexpr std::size_t kChunk = std::size_t{1} << 18;
  constexpr std::size_t kMaxPending = std::size_t{1} << 26;
  for (;;) {
    const std::size_t kept = text.size();
    const std::size_t chunk = std::min(kChunk, limit - offset_ - kept);
    text.resize(kept + chunk);
    ssize_t n = 0;
    do {
      n = ::pread(fd.get(), text.data() + kept, chunk, static_cast<off_t>(offset_ + kept));
    } while (n < 0 && errno == EINTR);
    if (n < 0) return FailErrno(ErrorKind::kIo, path_.string(), errno);
    text.resize(kept + static_cast<std::size_t>(n));
    if (n == 0) break;
    // Whole lines now; what is left grows by the next chunk.
    const std::size_t newline = std::string_view(text).substr(kept).rfind('\n');
    if (newline == std::string_view::npos) {
      if (text.size() < kMaxPending) continue;
      return Fail(ErrorKind::kData, "{}:{}: over {} bytes, expected a line of at most {}",
                  path_.string(), next_line_, text.size(), limits::kMaxLineBytes);
    }
    const JournalParser::Fed fed =
        parser_->Feed(std::string_view(text).substr(0, kept + newline + 1), next_line_, frames);
    offset_ += fed.bytes;
    next_line_ += fed.lines;
    text.erase(0, fed.bytes);
  }
  const JournalParser::Fed fed = parser_->Feed(text, next_line_, frames);
  offset_ += fed.bytes;
  next_line_ += fed.lines;
  torn_bytes_ = text.size() - fed.bytes;
  return frames;
}

const std::vector<std::string>& JournalFollower::warnings() const { return parser_->warnings(); }

std::size_t JournalFollower::rejected() const { return parser_->lines_rejected(); }

std::optional<std::string> JournalFollower::TornTail() const {
  if (torn_bytes_ == 0) return std::nullopt;
  return parser_->TornLineWarning(next_line_, torn_bytes_);
}

}  // namespace omnihdr
