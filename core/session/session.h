#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "core/base/units.h"
#include "core/photometry/response.h"
#include "core/sphere/pose.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// The data of a session directory, version 1 (README: "Session format"). Pure data: reading and
// writing are in session_reader.h, journal.h and view_writer.h.

enum class Layout { kPanorama, kRig, kPerspective };
std::string_view ToString(Layout layout);

struct PerspectiveIntrinsics {
  double fx = 0.0;
  double fy = 0.0;
  double cx = 0.0;
  double cy = 0.0;
};

struct CameraDescription {
  std::string model;
  std::string serial;
  int bits =
      8;  // significant bits of a value, 8..16; values are stored low-aligned in 16-bit files
  Layout layout = Layout::kPanorama;
  int width = 0;  // of one stored frame, in pixels
  int height = 0;
  ProjectionKind projection = ProjectionKind::kEquirectangular;  // layout panorama
  double z_min = 0.0;                                            // cylindrical only
  double z_max = 0.0;
  // layout rig: RGGB, GRBG, GBRG or BGGR, or none where the sensors deliver grey or finished colour
  std::string bayer;
  PerspectiveIntrinsics intrinsics;       // layout perspective
  Projection PanoramaProjection() const;  // requires layout panorama
};

enum class BracketOrder { kSawtooth, kTriangle, kList };
std::string_view ToString(BracketOrder order);

struct BracketDescription {
  BracketOrder order = BracketOrder::kSawtooth;
  std::vector<ExposureTime> exposures;
  // Frames taken at one position: 1 while driving; the whole bracket for a data matrix. Additive
  // key "frames_per_position", default 1.
  int frames_per_position = 1;
  // From a look at the scene, not from the configuration. Additive key "metered", default false.
  bool metered = false;
};

// A small file that lies beside session.json from the start, such as the rig's calibration.
struct SessionFile {
  std::string name;  // relative to the session directory, without ".."
  std::string content;
};

struct SessionInfo {
  std::string created;  // ISO 8601, UTC
  CameraDescription camera;
  Response response = *Response::Linear();
  std::optional<BracketDescription> bracket;
  // Free-form additive keys that our own tools wrote ("simulation": ...), kept as JSON text and
  // passed through; empty when absent. A JSON object: {"simulation": {...}}.
  std::string extra_json;
  // What SessionWriter::Create stores beside session.json; not read back. Layout rig: rig.toml and
  // the masks it names.
  std::vector<SessionFile> files;
};

// Why a journal line has or has not usable pixels.
enum class FrameStatus {
  kOk,
  kMissedTrigger,     // the camera was busy or the trigger came too fast
  kCameraTimeout,     // commanded, no frame before the deadline
  kCorrupt,           // torn or damaged pixels
  kExposureMismatch,  // the exposure in force was not the one asked for, or could not be proved
  kDiskFull,          // pixels could not be stored
};
std::string_view ToString(FrameStatus status);
std::optional<FrameStatus> FrameStatusFromString(std::string_view name);

// How the exposure of a frame is known.
enum class ExposureProof {
  kNone,      // nothing confirms it
  kEmbedded,  // written into the frame by the sensor
  kReadback,  // registers read back around the frame
  kLatency,   // commanded, with a latency measured on this device
  kFile,      // as recorded in a replayed session
};
std::string_view ToString(ExposureProof proof);
std::optional<ExposureProof> ExposureProofFromString(std::string_view name);

struct GnssFix {
  double lat_deg = 0.0;
  double lon_deg = 0.0;
  double alt_m = 0.0;
  std::string time;  // UTC of the fix as the receiver says it, ISO 8601
  // As in NMEA GGA: 0 none, 1 GNSS, 2 differential, 3 PPS, 4 RTK fixed, 5 RTK float, 6 dead
  // reckoning, 8 simulated.
  int fix = 0;
  // Optional keys: how good it is.
  int dimensions = 0;                            // 2 = alt_m is not known, 3 = it is; 0 = not said
  std::optional<double> error_m = std::nullopt;  // horizontal, as the receiver estimates it
  std::optional<double> time_error_s = std::nullopt;  // of `time`
  std::string time_source = {};                       // where `time` comes from: "gnss", "gnss+pps"
  std::optional<double> age_s = std::nullopt;         // from its arrival to the moment of the frame
};

// One line of frames.jsonl.
struct FrameRecord {
  FrameId frame{};
  PositionId position{};
  std::string file;  // relative to the session directory; empty when there are no pixels
  Exposure exposure;
  HostTime trigger_time;
  HostTime timestamp;  // middle of the exposure
  std::optional<double> odometer_m;
  FrameStatus status = FrameStatus::kOk;
  // Optional keys.
  std::string detail;                   // for people: why the status is not ok
  std::optional<std::uint32_t> crc32c;  // of the pixel file
  // Of the trigger; "utc_ns", and "utc" for people: ISO 8601 with nanoseconds.
  std::optional<UtcTime> utc;
  // "utc_source": where that comes from: CLOCK_REALTIME, "system-synchronised" (by NTP, PTP, PPS,
  // as the kernel says) or "system-free"; "gnss": the receiver's time and the age of its report,
  // where the machine's clock is free; empty = not known.
  std::string utc_source;
  // The kernel's bound of the clock's error when synchronised; with "gnss", how late a report may
  // come after the moment that it tells of.
  std::optional<double> utc_error_s;
  // Index into session.json's bracket.exposures_s, and the triggers by which steps taken again have
  // put the bracket off since the session began.
  std::optional<int> step;
  std::uint64_t retakes = 0;
  // The camera's own time of the exposure's middle ("camera_time_ns"), and the bound of the error
  // of `timestamp` where it comes from that by a fitted clock ("timestamp_error_ns"); without the
  // latter, `timestamp` follows from when the camera was commanded.
  std::optional<CameraTime> camera_time;
  std::optional<Nanoseconds> timestamp_error;
  bool gnss_missing = false;                   // there is a receiver, but it had no fix that counts
  ExposureProof proof = ExposureProof::kNone;  // "exposure_proof"
  std::optional<GnssFix> gnss;
  std::optional<double> heading_deg;
  std::optional<Pose> pose;  // known from elsewhere
  std::optional<double> temperature_c;
  std::string settings_readback_json;  // JSON value as text; empty when absent
  std::string truth_json;  // simulator's truth, JSON object as text; never used to process
};

}  // namespace omnihdr
