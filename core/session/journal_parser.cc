#include "core/session/journal_parser.h"

#include <algorithm>
#include <cassert>
#include <filesystem>
#include <span>
#include <utility>

#include "core/base/crc32c.h"
#include "core/session/json.h"
#include "core/session/limits.h"
#include "core/session/session_reader.h"

namespace omnihdr {
namespace {

using json::ObjectReader;
namespace limits = session_limits;

bool IsBlank(std::string_view line) {
  return line.find_first_not_of(" \t\r\n") == std::string_view::npos;
}

bool IsWholeObject(std::string_view line) {
  if (line.size() > limits::kMaxLineBytes) return false;
  const Result<json::Json> value = json::Parse({"", line, 0});
  return value && value->is_object();
}

// Relative, staying inside the session directory, naming a file.
bool IsPathInside(const std::string& file) {
  if (file.find('\0') != std::string::npos || file.size() > 1024) return false;
  const std::filesystem::path path(file);
  if (path.is_absolute() || !path.has_filename()) return false;
  return std::all_of(path.begin(), path.end(),
                     [](const std::filesystem::path& part) { return part != ".."; }) &&
         path.filename() != ".";
}

Result<GnssFix> ReadGnss(const ObjectReader& line) {
  GnssFix fix;
  OMNIHDR_ASSIGN(const ObjectReader gnss, line.Object("gnss"));
  OMNIHDR_ASSIGN(fix.lat_deg, gnss.Number("lat", -90.0, 90.0, "degrees in [-90, 90]"));
  OMNIHDR_ASSIGN(fix.lon_deg, gnss.Number("lon", -360.0, 360.0, "degrees in [-360, 360]"));
  OMNIHDR_ASSIGN(fix.alt_m, gnss.NumberOr("alt_m", 0.0, -1e7, 1e7, "metres in [-1e7, 1e7]"));
  OMNIHDR_ASSIGN(fix.time, gnss.StringOr("time", ""));
  // Who writes a position and says nothing of its quality means it.
  OMNIHDR_ASSIGN(const std::int64_t kind,
                 gnss.IntegerOr("fix", 1, 0, 255, "a whole number in [0, 255]"));
  fix.fix = static_cast<int>(kind);
  OMNIHDR_ASSIGN(const std::int64_t dimensions,
                 gnss.IntegerOr("dimensions", 0, 0, 3, "a whole number in [0, 3]"));
  fix.dimensions = static_cast<int>(dimensions);
  const auto optional = [&gnss](std::string_view key, std::optional<double>& value) -> Status {
    if (!gnss.Has(key)) return {};
    OMNIHDR_ASSIGN(value, gnss.Number(key, 0.0, 1e9, "a number in [0, 1e9]"));
    return {};
  };
  OMNIHDR_TRY(optional("error_m", fix.error_m));
  OMNIHDR_TRY(optional("time_error_s", fix.time_error_s));
  OMNIHDR_TRY(optional("age_s", fix.age_s));
  OMNIHDR_ASSIGN(fix.time_source, gnss.StringOr("time_source", ""));
  return fix;
}

Result<FrameRecord> ReadRecord(const ObjectReader& line) {
  FrameRecord record;
  OMNIHDR_ASSIGN(const std::int64_t frame, line.Integer("frame", 0, limits::kMaxFrame,
                                                        "a whole number in [0, 999999999999]"));
  record.frame = FrameId{static_cast<std::uint64_t>(frame)};
  OMNIHDR_ASSIGN(const std::int64_t position, line.Integer("position", 0, limits::kMaxPosition,
                                                           "a whole number in [0, 999999999]"));
  record.position = PositionId{position};

  constexpr std::string_view kStatuses =
      "\"ok\", \"missed-trigger\", \"camera-timeout\", \"corrupt\", \"exposure-mismatch\" or "
      "\"disk-full\"";
  OMNIHDR_ASSIGN(const std::string status_name, line.String("status", kStatuses));
  const std::optional<FrameStatus> status = FrameStatusFromString(status_name);
  if (!status) return line.Wrong("status", kStatuses);
  record.status = *status;
  const bool ok = record.status == FrameStatus::kOk;

  constexpr std::string_view kFile = "a relative path inside the session directory";
  OMNIHDR_ASSIGN(record.file, line.StringOr("file", ""));
  if ((ok || !record.file.empty()) && !IsPathInside(record.file)) return line.Wrong("file", kFile);

  // A trigger that yielded nothing need not have an exposure.
  if (ok || line.Has("exposure_s")) {
    OMNIHDR_ASSIGN(const double seconds,
                   line.Number("exposure_s", limits::kMinExposureSeconds,
                               limits::kMaxExposureSeconds, "seconds in [1e-09, 100000]"));
    record.exposure.time = ExposureTime::Seconds(seconds);
  }
  OMNIHDR_ASSIGN(record.exposure.gain.value,
                 line.NumberOr("gain_db", 0.0, -limits::kMaxGainDb, limits::kMaxGainDb,
                               "decibels in [-200, 200]"));

  constexpr std::string_view kNanoseconds = "whole nanoseconds";
  OMNIHDR_ASSIGN(const std::int64_t trigger_ns,
                 line.IntegerOr("trigger_ns", 0, INT64_MIN, INT64_MAX, kNanoseconds));
  record.trigger_time = HostTime::FromNanoseconds(trigger_ns);
  OMNIHDR_ASSIGN(const std::int64_t timestamp_ns,
                 line.IntegerOr("timestamp_ns", 0, INT64_MIN, INT64_MAX, kNanoseconds));
  record.timestamp = HostTime::FromNanoseconds(timestamp_ns);
  if (line.Has("odometer_m")) {
    OMNIHDR_ASSIGN(record.odometer_m,
                   line.Number("odometer_m", -1e12, 1e12, "metres in [-1e+12, 1e+12]"));
  }

  OMNIHDR_ASSIGN(record.detail, line.StringOr("detail", ""));
  if (line.Has("crc32c")) {
    OMNIHDR_ASSIGN(const std::int64_t crc,
                   line.Integer("crc32c", 0, UINT32_MAX, "a whole number in [0, 4294967295]"));
    record.crc32c = static_cast<std::uint32_t>(crc);
  }
  if (line.Has("utc_ns")) {
    OMNIHDR_ASSIGN(const std::int64_t utc_ns,
                   line.Integer("utc_ns", INT64_MIN, INT64_MAX, kNanoseconds));
    record.utc = UtcTime::FromNanoseconds(utc_ns);
  }
  OMNIHDR_ASSIGN(record.utc_source, line.StringOr("utc_source", ""));
  if (line.Has("utc_error_s")) {
    OMNIHDR_ASSIGN(record.utc_error_s, line.Number("utc_error_s", 0.0, 1e9, "seconds in [0, 1e9]"));
  }
  if (line.Has("step")) {
    OMNIHDR_ASSIGN(const std::int64_t step,
                   line.Integer("step", 0, 1'000'000, "a whole number in [0, 1000000]"));
    record.step = static_cast<int>(step);
  }
  OMNIHDR_ASSIGN(const std::int64_t retakes, line.IntegerOr("retakes", 0, 0, limits::kMaxFrame,
                                                            "a whole number in [0, 999999999999]"));
  record.retakes = static_cast<std::uint64_t>(retakes);
  if (line.Has("camera_time_ns")) {
    OMNIHDR_ASSIGN(const std::int64_t ns,
                   line.Integer("camera_time_ns", INT64_MIN, INT64_MAX, kNanoseconds));
    record.camera_time = CameraTime::FromNanoseconds(ns);
  }
  if (line.Has("timestamp_error_ns")) {
    OMNIHDR_ASSIGN(const std::int64_t ns,
                   line.Integer("timestamp_error_ns", 0, INT64_MAX, "whole nanoseconds from 0"));
    record.timestamp_error = Nanoseconds(ns);
  }
  OMNIHDR_ASSIGN(record.gnss_missing, line.BoolOr("gnss_missing", false));
  if (line.Has("exposure_proof")) {
    constexpr std::string_view kProofs =
        "\"none\", \"embedded\", \"readback\", \"latency\" or \"file\"";
    OMNIHDR_ASSIGN(const std::string name, line.String("exposure_proof", kProofs));
    const std::optional<ExposureProof> proof = ExposureProofFromString(name);
    if (!proof) return line.Wrong("exposure_proof", kProofs);
    record.proof = *proof;
  }
  if (line.Has("gnss")) {
    OMNIHDR_ASSIGN(record.gnss, ReadGnss(line));
  }
  if (line.Has("heading_deg")) {
    OMNIHDR_ASSIGN(record.heading_deg,
                   line.Number("heading_deg", -720.0, 720.0, "degrees in [-720, 720]"));
  }
  if (line.Has("pose")) {
    OMNIHDR_ASSIGN(record.pose, line.ReadPose("pose"));
  }
  if (line.Has("temperature_c")) {
    OMNIHDR_ASSIGN(record.temperature_c, line.Number("temperature_c", -273.15, 1e4,
                                                     "degrees Celsius in [-273.15, 10000]"));
  }
  if (const json::Json* value = line.Find("settings_readback")) {
    record.settings_readback_json = value->dump();
  }
  if (const json::Json* value = line.Find("truth")) {
    if (!value->is_object()) return line.Wrong("truth", "a JSON object");
    record.truth_json = value->dump();
  }
  return record;
}

// The frame number of a line whose other values may be wrong.
std::optional<std::uint64_t> FrameNumberOf(std::string_view line) {
  const Result<json::Json> value = json::Parse({"", line, 0});
  if (!value || !value->is_object() || !value->contains("frame")) return std::nullopt;
  const std::optional<std::int64_t> number =
      json::WholeNumber((*value)["frame"], 0, limits::kMaxFrame);
  if (!number) return std::nullopt;
  return static_cast<std::uint64_t>(*number);
}

constexpr std::string_view kSealKey = "\"line_crc32c\"";
constexpr std::string_view kSealPrefix = ", \"line_crc32c\": ";

std::uint32_t CrcOfText(std::string_view text) {
  return Crc32c(std::as_bytes(std::span(text.data(), text.size())));
}

}  // namespace

std::string SealJournalLine(std::string line) {
  assert(line.size() > 2 && line.back() == '}');
  line.pop_back();
  const std::uint32_t crc = CrcOfText(line);
  return fmt::format("{}{}{}}}", line, kSealPrefix, crc);
}

JournalSeal JournalSealOf(std::string_view line) {
  if (line.find(kSealKey) == std::string_view::npos) return JournalSeal::kNone;
  const std::size_t at = line.rfind(kSealPrefix);
  // Another program wrote it anew, in a form of its own.
  if (at == std::string_view::npos || line.back() != '}') return JournalSeal::kBroken;
  const std::string_view digits =
      line.substr(at + kSealPrefix.size(), line.size() - at - kSealPrefix.size() - 1);
  return digits == fmt::format("{}", CrcOfText(line.substr(0, at))) ? JournalSeal::kHolds
                                                                    : JournalSeal::kBroken;
}

Result<FrameRecord> ParseFrameRecord(std::string_view line, const std::string& name, int number) {
  if (line.size() > limits::kMaxLineBytes) {
    return Fail(ErrorKind::kData, "{}:{}: {} bytes, expected a line of at most {}", name, number,
                line.size(), limits::kMaxLineBytes);
  }
  const json::Source source{name, line, number};
  OMNIHDR_ASSIGN(const json::Json value, json::Parse(source));
  OMNIHDR_ASSIGN(const ObjectReader reader, ObjectReader::Root(source, value));
  return ReadRecord(reader);
}

JournalParser::Fed JournalParser::Feed(std::string_view text, int first_line,
                                       std::vector<FrameRecord>& frames) {
  Fed fed;
  while (fed.bytes < text.size()) {
    const std::size_t newline = text.find('\n', fed.bytes);
    const std::string_view line = text.substr(fed.bytes, newline - fed.bytes);
    if (newline == std::string_view::npos) {
      // A prefix of an object is never an object: if this parses, nothing is missing but the
      // newline.
      if (IsWholeObject(line)) {
        TakeLine(line, first_line + fed.lines, frames);
        fed.bytes = text.size();
      }
      break;
    }
    TakeLine(line, first_line + fed.lines, frames);
    fed.bytes = newline + 1;
    ++fed.lines;
  }
  return fed;
}

void JournalParser::TakeLine(std::string_view line, int number, std::vector<FrameRecord>& frames) {
  if (IsBlank(line)) return;
  next_frame_ = std::max<std::uint64_t>(next_frame_, lines_used_ + lines_rejected_ + 1);
  Result<FrameRecord> record = ParseFrameRecord(line, name_, number);
  if (!record) {
    if (const std::optional<std::uint64_t> frame = FrameNumberOf(line)) {
      next_frame_ = std::max(next_frame_, *frame + 1);
    }
    Reject(fmt::format("{}: frame skipped", record.error().message));
    return;
  }
  const std::uint64_t frame = Value(record->frame);
  if (!AddFrameNumber(frame)) {
    Reject(fmt::format("{}:{}: frame: {}, expected a number not used before: frame skipped", name_,
                       number, frame));
    return;
  }
  next_frame_ = std::max(next_frame_, frame + 1);
  const std::int64_t position = Value(record->position);
  if (position < last_position_) {
    Warn(fmt::format("{}:{}: position: {}, expected {} or more: positions out of order", name_,
                     number, position, last_position_));
  }
  last_position_ = position;
  ++lines_used_;
  frames.push_back(std::move(*record));
}

bool JournalParser::AddFrameNumber(std::uint64_t number) {
  auto after = ranges_.upper_bound(number);
  if (after != ranges_.begin()) {
    const auto before = std::prev(after);
    if (number <= before->second) return false;
    if (number == before->second + 1) {
      before->second = number;
      if (after != ranges_.end() && after->first == number + 1) {
        before->second = after->second;
        ranges_.erase(after);
      }
      return true;
    }
  }
  if (after != ranges_.end() && after->first == number + 1) {
    const std::uint64_t last = after->second;
    ranges_.erase(after);
    ranges_[number] = last;
    return true;
  }
  ranges_[number] = number;
  return true;
}

std::string JournalParser::TornLineWarning(int line, std::size_t bytes) const {
  return fmt::format("{}:{}: torn last line of {} bytes dropped: its writer was interrupted", name_,
                     line, bytes);
}

void JournalParser::Warn(std::string warning) {
  if (warnings_.size() < limits::kMaxWarnings) {
    warnings_.push_back(std::move(warning));
  } else {
    ++warnings_left_out_;
  }
}

void JournalParser::Reject(std::string message) {
  ++lines_rejected_;
  if (rejected_.size() < limits::kMaxWarnings) rejected_.push_back(message);
  Warn(std::move(message));
}

}  // namespace omnihdr
