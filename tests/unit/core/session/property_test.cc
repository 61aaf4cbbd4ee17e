#include <gtest/gtest.h>
#include <rapidcheck.h>
#include <rapidcheck/gtest.h>
#include <stdlib.h>

#include <bit>
#include <cmath>
#include <string>
#include <vector>

#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::property_test {
namespace {

// The same cases in every run, unless somebody asks for others.
const int kSeeded = ::setenv("RC_PARAMS", "seed=20260101", 0);

double AnyDouble(double low, double high) {
  const auto bits = *rc::gen::arbitrary<std::uint64_t>();
  const auto value = std::bit_cast<double>(bits * 0x9E3779B97F4A7C15ULL);
  if (std::isfinite(value) && value >= low && value <= high) return value;
  const double unit = static_cast<double>(bits * 0xBF58476D1CE4E5B9ULL) * 0x1p-64;
  return std::min(high, low + (high - low) * unit);
}

std::int64_t AnyInteger(std::int64_t low, std::int64_t high) {
  return *rc::gen::inRange<std::int64_t>(low, high);
}

bool Coin() { return *rc::gen::arbitrary<bool>(); }

std::string AnyText() {
  const auto pieces = *rc::gen::container<std::vector<std::string>>(rc::gen::element<std::string>(
      "a", "Z", " ", "\"", "\\", "/", "\n", "\t", "\x01", "\x7F", "\xC3\xA9", "\xE2\x82\xAC",
      "\xF0\x9F\x98\x80", "{", "}", "[", ":", ",", "null", "\xEF\xBF\xBD"));
  std::string text;
  for (const std::string& piece : pieces) text += piece;
  return text;
}

Eigen::Quaterniond AnyRotation() {
  Eigen::Quaterniond q(AnyDouble(-1, 1), AnyDouble(-1, 1), AnyDouble(-1, 1), AnyDouble(-1, 1));
  return q.norm() < 1e-3 ? Eigen::Quaterniond::Identity() : q.normalized();
}

Pose AnyPose() {
  return {AnyRotation(),
          Eigen::Vector3d(AnyDouble(-1e9, 1e9), AnyDouble(-1e9, 1e9), AnyDouble(-1e9, 1e9))};
}

std::string AnyJsonObject() {
  return *rc::gen::element<std::string>("{}", R"({"a":1})",
                                        R"({"a":[1.5,null,{"b":"c"}],"z":true})");
}

bool Same(const Pose& a, const Pose& b) {
  return a.rotation.coeffs() == b.rotation.coeffs() && a.translation == b.translation;
}

FrameRecord AnyRecord() {
  FrameRecord record;
  record.frame = FrameId{static_cast<std::uint64_t>(AnyInteger(0, 1'000'000'000'000))};
  record.position = PositionId{AnyInteger(0, 1'000'000'000)};
  record.status = *rc::gen::element(FrameStatus::kOk, FrameStatus::kMissedTrigger,
                                    FrameStatus::kCameraTimeout, FrameStatus::kCorrupt,
                                    FrameStatus::kExposureMismatch, FrameStatus::kDiskFull);
  const bool ok = record.status == FrameStatus::kOk;
  if (ok || Coin())
    record.file = *rc::gen::element<std::string>("a.png", "raw/000001.png", "r/\xC3\xA9 b");
  if (ok || Coin()) record.exposure.time = ExposureTime::Seconds(AnyDouble(1e-9, 1e5));
  record.exposure.gain.value = AnyDouble(-200, 200);
  record.trigger_time = HostTime::FromNanoseconds(AnyInteger(INT64_MIN, INT64_MAX));
  record.timestamp = HostTime::FromNanoseconds(AnyInteger(INT64_MIN, INT64_MAX));
  if (Coin()) record.odometer_m = AnyDouble(-1e12, 1e12);
  record.detail = AnyText();
  if (Coin()) record.crc32c = static_cast<std::uint32_t>(AnyInteger(0, 1LL << 32));
  if (Coin()) record.utc = UtcTime::FromNanoseconds(AnyInteger(INT64_MIN, INT64_MAX));
  if (Coin()) record.utc_source = "system-synchronised";
  if (Coin()) record.utc_error_s = AnyDouble(0, 10);
  if (Coin()) record.step = static_cast<int>(AnyInteger(0, 64));
  if (Coin()) record.retakes = static_cast<std::uint64_t>(AnyInteger(0, 1000));
  if (Coin()) record.camera_time = CameraTime::FromNanoseconds(AnyInteger(INT64_MIN, INT64_MAX));
  if (Coin()) record.timestamp_error = Nanoseconds(AnyInteger(0, INT64_MAX));
  record.gnss_missing = Coin();
  record.proof =
      *rc::gen::element(ExposureProof::kNone, ExposureProof::kEmbedded, ExposureProof::kReadback,
                        ExposureProof::kLatency, ExposureProof::kFile);
  if (Coin()) {
    GnssFix fix;
    fix.lat_deg = AnyDouble(-90, 90);
    fix.lon_deg = AnyDouble(-180, 180);
    fix.alt_m = AnyDouble(-1e4, 1e5);
    fix.time = AnyText();
    fix.fix = static_cast<int>(AnyInteger(0, 256));
    fix.dimensions = static_cast<int>(AnyInteger(0, 4));
    if (Coin()) fix.error_m = AnyDouble(0, 1e5);
    if (Coin()) fix.time_error_s = AnyDouble(0, 10);
    if (Coin()) fix.age_s = AnyDouble(0, 10);
    fix.time_source = AnyText();
    record.gnss = fix;
  }
  if (Coin()) record.heading_deg = AnyDouble(-360, 360);
  if (Coin()) record.pose = AnyPose();
  if (Coin()) record.temperature_c = AnyDouble(-100, 200);
  if (Coin()) record.settings_readback_json = AnyJsonObject();
  if (Coin()) record.truth_json = AnyJsonObject();
  return record;
}

RC_GTEST_PROP(SessionProperty, AFrameRecordReadsBackExactlyAsWritten, ()) {
  const FrameRecord written = AnyRecord();
  const std::string line = FormatFrameRecord(written);
  RC_ASSERT(line.find('\n') == std::string::npos);
  const Result<JournalContents> journal = ParseJournal(line + "\n", "j");
  if (!journal) RC_FAIL(journal.error().message);
  RC_ASSERT(journal->frames.size() == 1U);
  const FrameRecord& read = journal->frames[0];
  RC_ASSERT(read.frame == written.frame);
  RC_ASSERT(read.position == written.position);
  RC_ASSERT(read.file == written.file);
  RC_ASSERT(read.exposure == written.exposure);
  RC_ASSERT(read.trigger_time == written.trigger_time);
  RC_ASSERT(read.timestamp == written.timestamp);
  RC_ASSERT(read.odometer_m == written.odometer_m);
  RC_ASSERT(read.status == written.status);
  RC_ASSERT(read.detail == written.detail);
  RC_ASSERT(read.crc32c == written.crc32c);
  RC_ASSERT(read.utc == written.utc);
  RC_ASSERT(read.utc_source == written.utc_source);
  RC_ASSERT(read.utc_error_s == written.utc_error_s);
  RC_ASSERT(read.step == written.step);
  RC_ASSERT(read.retakes == written.retakes);
  RC_ASSERT(read.camera_time == written.camera_time);
  RC_ASSERT(read.timestamp_error == written.timestamp_error);
  RC_ASSERT(read.gnss_missing == written.gnss_missing);
  RC_ASSERT(read.proof == written.proof);
  RC_ASSERT(read.gnss.has_value() == written.gnss.has_value());
  if (written.gnss) {
    RC_ASSERT(read.gnss->lat_deg == written.gnss->lat_deg);
    RC_ASSERT(read.gnss->lon_deg == written.gnss->lon_deg);
    RC_ASSERT(read.gnss->alt_m == written.gnss->alt_m);
    RC_ASSERT(read.gnss->time == written.gnss->time);
    RC_ASSERT(read.gnss->fix == written.gnss->fix);
    RC_ASSERT(read.gnss->dimensions == written.gnss->dimensions);
    RC_ASSERT(read.gnss->error_m == written.gnss->error_m);
    RC_ASSERT(read.gnss->time_error_s == written.gnss->time_error_s);
    RC_ASSERT(read.gnss->age_s == written.gnss->age_s);
    RC_ASSERT(read.gnss->time_source == written.gnss->time_source);
  }
  RC_ASSERT(read.heading_deg == written.heading_deg);
  RC_ASSERT(read.pose.has_value() == written.pose.has_value());
  if (written.pose) RC_ASSERT(Same(*read.pose, *written.pose));
  RC_ASSERT(read.temperature_c == written.temperature_c);
  RC_ASSERT(read.settings_readback_json == written.settings_readback_json);
  RC_ASSERT(read.truth_json == written.truth_json);
  RC_ASSERT(FormatFrameRecord(read) == line);
}

RC_GTEST_PROP(SessionProperty, ASessionInfoReadsBackExactlyAsWritten, ()) {
  SessionInfo written;
  written.created = AnyText();
  CameraDescription& camera = written.camera;
  camera.model = AnyText();
  camera.serial = AnyText();
  camera.bits = static_cast<int>(AnyInteger(8, 17));
  camera.layout = *rc::gen::element(Layout::kPanorama, Layout::kRig, Layout::kPerspective);
  camera.width = static_cast<int>(AnyInteger(64, 16384));
  camera.height = static_cast<int>(AnyInteger(64, 16384));
  if (camera.layout == Layout::kPanorama && Coin()) {
    camera.projection = ProjectionKind::kCylindrical;
    camera.z_min = AnyDouble(-1000, 0);
    camera.z_max = AnyDouble(0.001, 1000);
  }
  if (camera.layout == Layout::kRig) {
    camera.bayer = *rc::gen::element<std::string>("RGGB", "GRBG", "GBRG", "BGGR");
  }
  if (camera.layout == Layout::kPerspective && Coin()) {
    camera.intrinsics = {AnyDouble(1, 1e6), AnyDouble(1, 1e6), AnyDouble(-1e6, 1e6),
                         AnyDouble(-1e6, 1e6)};
  }
  if (Coin()) {
    written.response = *Response::Linear(AnyDouble(0, 127));
  } else {
    written.response = *Response::LogLinear({{{AnyDouble(0.001, 0.1), AnyDouble(-9, 9)},
                                              {AnyDouble(0.001, 0.1), AnyDouble(-9, 9)},
                                              {AnyDouble(0.001, 0.1), AnyDouble(-9, 9)}}});
  }
  if (Coin()) {
    written.bracket.emplace();
    written.bracket->order =
        *rc::gen::element(BracketOrder::kSawtooth, BracketOrder::kTriangle, BracketOrder::kList);
    const std::int64_t count = AnyInteger(1, 20);
    for (std::int64_t i = 0; i < count; ++i) {
      written.bracket->exposures.push_back(ExposureTime::Seconds(AnyDouble(1e-9, 1e5)));
    }
    written.bracket->frames_per_position = static_cast<int>(AnyInteger(1, 1001));
    written.bracket->metered = Coin();
  }
  if (Coin()) written.extra_json = R"({"simulation":{"seed":1},"x":[]})";

  const std::string text = FormatSessionInfo(written);
  const Result<SessionInfo> read = ParseSessionInfo(text, "s");
  if (!read) RC_FAIL(read.error().message);
  RC_ASSERT(read->created == written.created);
  RC_ASSERT(read->camera.model == camera.model);
  RC_ASSERT(read->camera.serial == camera.serial);
  RC_ASSERT(read->camera.bits == camera.bits);
  RC_ASSERT(read->camera.layout == camera.layout);
  RC_ASSERT(read->camera.width == camera.width);
  RC_ASSERT(read->camera.height == camera.height);
  RC_ASSERT(read->camera.projection == camera.projection);
  RC_ASSERT(read->camera.z_min == camera.z_min);
  RC_ASSERT(read->camera.z_max == camera.z_max);
  RC_ASSERT(read->camera.bayer == camera.bayer);
  RC_ASSERT(read->camera.intrinsics.fx == camera.intrinsics.fx);
  RC_ASSERT(read->camera.intrinsics.fy == camera.intrinsics.fy);
  RC_ASSERT(read->camera.intrinsics.cx == camera.intrinsics.cx);
  RC_ASSERT(read->camera.intrinsics.cy == camera.intrinsics.cy);
  RC_ASSERT(read->response.black() == written.response.black());
  RC_ASSERT(read->response.loglinear() == written.response.loglinear());
  RC_ASSERT(read->bracket.has_value() == written.bracket.has_value());
  if (written.bracket) {
    RC_ASSERT(read->bracket->order == written.bracket->order);
    RC_ASSERT(read->bracket->exposures == written.bracket->exposures);
    RC_ASSERT(read->bracket->frames_per_position == written.bracket->frames_per_position);
    RC_ASSERT(read->bracket->metered == written.bracket->metered);
  }
  RC_ASSERT(read->extra_json == written.extra_json);
  RC_ASSERT(FormatSessionInfo(*read) == text);
}

RC_GTEST_PROP(SessionProperty, AViewRecordReadsBackExactlyAsWritten, ()) {
  ViewRecord written;
  written.position = PositionId{AnyInteger(0, 1'000'000'000)};
  written.pose = AnyPose();
  written.metric_scale = Coin();
  written.scale_source = *rc::gen::element(ScaleSource::kNone, ScaleSource::kOdometer,
                                           ScaleSource::kGnss, ScaleSource::kGiven);
  if (Coin()) {
    written.gnss_scale =
        GnssScale{AnyDouble(0, 1e3), AnyDouble(0, 1e3), static_cast<int>(AnyInteger(0, 100)),
                  static_cast<int>(AnyInteger(0, 100))};
  }
  written.chain = static_cast<int>(AnyInteger(0, 1000));
  written.chain_reason = AnyText();
  if (Coin()) {
    written.sigma = PoseSigma{{AnyDouble(0, 9), AnyDouble(0, 9), AnyDouble(0, 9)},
                              {AnyDouble(0, 9), AnyDouble(0, 9), AnyDouble(0, 9)}};
  }
  written.dead_reckoned = AnyText();
  if (Coin()) {
    written.relocalised = Relocalisation{
        PositionId{AnyInteger(0, 1'000'000'000)}, PositionId{AnyInteger(0, 1'000'000'000)},
        static_cast<int>(AnyInteger(0, 1000)), static_cast<int>(AnyInteger(0, 400))};
  }
  if (Coin()) {
    written.loop = LoopClosure{PositionId{AnyInteger(0, 1'000'000'000)},
                               PositionId{AnyInteger(0, 1'000'000'000)},
                               static_cast<int>(AnyInteger(0, 400)),
                               AnyDouble(0, 180),
                               AnyDouble(0, 1e6),
                               AnyDouble(0, 10),
                               Coin()};
  }
  written.orientation = AnyRotation();
  const std::int64_t count = AnyInteger(0, 9);
  for (std::int64_t i = 0; i < count; ++i) {
    written.frames.push_back(static_cast<std::uint64_t>(AnyInteger(0, 1'000'000'000'000)));
  }
  written.reference = static_cast<std::uint64_t>(AnyInteger(0, 1'000'000'000'000));
  written.mode = *rc::gen::element<std::string>("spatiotemporal", "temporal");
  written.radiance_min = Coin() ? AnyDouble(0, 1e9) : std::nan("");
  written.radiance_max = Coin() ? AnyDouble(0, 1e9) : std::nan("");
  written.valid_fraction = AnyDouble(0, 1);
  if (Coin()) written.warnings = {AnyText(), AnyText()};
  if (Coin()) written.resume_json = AnyJsonObject();

  const std::string text = FormatViewRecord(written);
  const Result<ViewRecord> read = ParseViewRecord(text, "v");
  if (!read) RC_FAIL(read.error().message);
  const auto same = [](double a, double b) { return a == b || (std::isnan(a) && std::isnan(b)); };
  RC_ASSERT(read->position == written.position);
  RC_ASSERT(Same(read->pose, written.pose));
  RC_ASSERT(read->metric_scale == written.metric_scale);
  RC_ASSERT(read->scale_source == written.scale_source);
  RC_ASSERT(read->gnss_scale == written.gnss_scale);
  RC_ASSERT(read->chain == written.chain);
  RC_ASSERT(read->chain_reason == written.chain_reason);
  RC_ASSERT(read->sigma.has_value() == written.sigma.has_value());
  if (written.sigma) {
    RC_ASSERT(read->sigma->rotation_deg == written.sigma->rotation_deg);
    RC_ASSERT(read->sigma->translation == written.sigma->translation);
  }
  RC_ASSERT(read->dead_reckoned == written.dead_reckoned);
  RC_ASSERT(read->relocalised.has_value() == written.relocalised.has_value());
  if (written.relocalised) RC_ASSERT(read->relocalised->place == written.relocalised->place);
  RC_ASSERT(read->loop.has_value() == written.loop.has_value());
  if (written.loop) {
    RC_ASSERT(read->loop->drift_translation == written.loop->drift_translation);
    RC_ASSERT(read->loop->corrected == written.loop->corrected);
  }
  RC_ASSERT(read->orientation.coeffs() == written.orientation.coeffs());
  RC_ASSERT(read->frames == written.frames);
  RC_ASSERT(read->reference == written.reference);
  RC_ASSERT(read->mode == written.mode);
  RC_ASSERT(same(read->radiance_min, written.radiance_min));
  RC_ASSERT(same(read->radiance_max, written.radiance_max));
  RC_ASSERT(read->valid_fraction == written.valid_fraction);
  RC_ASSERT(read->warnings == written.warnings);
  RC_ASSERT(read->resume_json == written.resume_json);
  RC_ASSERT(FormatViewRecord(*read) == text);
}

RC_GTEST_PROP(SessionProperty, AFollowerSeesTheSameFramesHoweverTheJournalGrows, ()) {
  std::string text;
  const std::int64_t lines = AnyInteger(1, 12);
  for (std::int64_t i = 0; i < lines; ++i) {
    text += Coin() ? FormatFrameRecord(test::SampleRecord(
                         static_cast<std::uint64_t>(AnyInteger(0, 10)), AnyInteger(0, 5)))
                   : *rc::gen::element<std::string>("", "{", "{}", "x", "[]");
    text += '\n';
  }
  const test::TemporaryDirectory directory;
  JournalFollower follower(directory.path());
  std::vector<std::string> seen;
  std::size_t length = 0;
  while (true) {
    test::Spill(directory.path() / "frames.jsonl", text.substr(0, length));
    const Result<std::vector<FrameRecord>> frames = follower.ReadNew();
    RC_ASSERT(frames.has_value());
    for (const FrameRecord& frame : *frames) seen.push_back(FormatFrameRecord(frame));
    if (length == text.size()) break;
    length = std::min(text.size(), length + static_cast<std::size_t>(AnyInteger(1, 300)));
  }
  std::vector<std::string> whole;
  const Result<JournalContents> journal =
      ParseJournal(text, (directory.path() / "frames.jsonl").string());
  if (journal) {
    for (const FrameRecord& frame : journal->frames) whole.push_back(FormatFrameRecord(frame));
    RC_ASSERT(follower.warnings().size() + (journal->frames.empty() ? 1U : 0U) ==
              journal->warnings.size());
  }
  RC_ASSERT(seen == whole);
}

}  // namespace
}  // namespace omnihdr::property_test
