#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image.h"
#include "core/session/session.h"

namespace omnihdr {

// What a camera can do, told once it is open.
struct CameraInfo {
  CameraDescription description;
  Response response = *Response::Linear();
  ExposureTime shortest;
  ExposureTime longest;
  // Exposures between which the camera can distinguish; 0 = continuous.
  double exposure_quantum_s = 0.0;
  // Frames after which a new exposure is in force; 0 = with the next frame.
  int exposure_latency_frames = 0;
  // Least time between two triggers that the camera accepts.
  Nanoseconds min_trigger_interval{0};
  // What the camera can say about the exposure a frame really had.
  ExposureProof proof = ExposureProof::kNone;
  // It hangs on the wire whose edges are observed, and exposes by itself at every pulse with what
  // Prepare has set: see Camera::Trigger.
  bool wired = false;
  // JSON object for session.json's additive keys, empty for none.
  std::string extra_json;
  // What belongs beside session.json: a rig's calibration (layout rig), its masks.
  std::vector<SessionFile> files;
};

// One picture to take: which trigger wants it and with what exposure.
struct ExposureRequest {
  TriggerId trigger{};
  Exposure exposure;
  HostTime trigger_time;
  // Where the vehicle is when the trigger fires, as the odometer says.
  std::optional<double> odometer_m;
  // Of a camera that is wired to the trigger: why the edge itself was not seen, so that
  // trigger_time is not its own; empty = it was seen.
  std::string unseen_edge;
};

// What triggers will ask for until something else is told: these exposures in this order, again and
// again.
struct ExposurePlan {
  std::vector<Exposure> order;  // one turn of it
  // The exposures of one turn are asked for together, at one place: by triggers of one time.
  bool burst = false;
};

// What a recording says about the moment of a frame: it is told on when the frame is replayed, for
// the replaying host's own clock and place say nothing about it.
struct RecordedMoment {
  std::optional<UtcTime> utc;
  std::optional<GnssFix> gnss;
  std::optional<double> heading_deg;
  std::optional<Pose> pose;
};

// When the exposure of a frame began that nobody commanded.
struct WiredStart {
  HostTime at;
  Nanoseconds error{0};  // how far `at` may be off, either way
};

// A frame as it comes from the camera. Buffers circulate with a status: a damaged or late frame is
// delivered and marked, never silently left out.
struct CameraFrame {
  TriggerId trigger{};
  // Of a wired camera's frames: the exposure began by itself then, and `trigger` says nothing.
  std::optional<WiredStart> wired;
  // Its exposure was the one that was due in a cycle of the camera's own, whatever was asked for.
  bool cycled = false;
  FrameStatus status = FrameStatus::kOk;  // kOk, kCorrupt or kMissedTrigger
  std::string detail;                     // when not ok
  // Corrupt, but some of a rig's sensors are whole: the pixels are kept beside the journal's line,
  // whose detail says which are not, and take no part in any view.
  bool partial = false;
  std::uint64_t camera_counter = 0;  // the camera's own frame counter: gaps are lost frames
  // The exposure the frame really had and how that is known. Nothing when the camera cannot tell.
  std::optional<Exposure> measured_exposure;
  ExposureProof proof = ExposureProof::kNone;
  HostTime mid_exposure;
  std::optional<CameraTime> camera_time;  // of the middle of the exposure
  // Bound of the error of mid_exposure where it follows from camera_time by a fitted clock; nothing
  // where it follows from when the camera was commanded.
  std::optional<Nanoseconds> mid_exposure_error;
  // How often the camera's clock has jumped against the host's since it was opened.
  std::uint64_t clock_jumps = 0;
  std::optional<double> temperature_c;
  std::string settings_readback_json;
  std::string truth_json;                  // simulator only
  std::optional<RecordedMoment> recorded;  // replay only
  // Values as the session's camera description says: panorama RGB, or a Bayer stack.
  std::variant<Image<std::uint8_t>, Image<std::uint16_t>> pixels;
};

// Something that a camera counts, since it was made.
struct CameraCounter {
  std::string name;  // small letters, digits and "_"
  std::uint64_t value = 0;
};

// A camera that takes one picture at a time on request. Life: Open -> Start -> (Trigger, Receive)*
// -> Stop -> Start ... -> Close; every call in any state returns an error rather than misbehave,
// and Start/Stop/Close are idempotent. Threads: Trigger from one thread and Receive from another at
// the same time; everything else when neither runs. No exception leaves a camera.
class Camera {
 public:
  virtual ~Camera() = default;
  // Finds and configures the device: everything automatic off, settings read back. kUnavailable
  // when there is no such device (yet).
  virtual Result<CameraInfo> Open() = 0;
  virtual void Close() = 0;
  virtual Status Start() = 0;
  virtual void Stop() = 0;
  // Commands the exposure. Returns at once; the picture arrives through Receive. kTemporary when
  // the camera is still busy with the picture before; kUnavailable when it has gone. A wired camera
  // (CameraInfo::wired) is told that an edge of its wire was seen, at request.trigger_time: it
  // commands nothing, and its frames come with `wired` whether or not their edge was told.
  virtual Status Trigger(const ExposureRequest& request) = 0;
  // The exposure that the next trigger will probably ask for: a camera which takes a while to set
  // it does so in the pause before, and the trigger finds it set. A hint: another may be asked for.
  // A wired camera takes its next picture with it. Returns at once, says nothing. Any thread.
  virtual void Prepare(const Exposure& /*next*/) {}
  // The exposures that are to come: a camera that can step through them by itself gets ready for
  // it, in its own time. A hint, like Prepare: what a trigger asks for holds. Kept over Stop and
  // Close. Returns at once. Any thread.
  virtual void Plan(const ExposurePlan& /*plan*/) {}
  // The next picture, in trigger order; kTemporary when none came within the timeout; kUnavailable
  // when the device has gone and Open must be called again.
  virtual Result<CameraFrame> Receive(Nanoseconds timeout) = 0;
  // What the driver counts beyond the frames' own words: always the same names. Any thread, at any
  // time.
  virtual std::vector<CameraCounter> Counters() const { return {}; }
  // What the driver has to tell people, a sentence each, the oldest first; nothing when all is
  // told. At most a few are kept. Any thread, at any time.
  virtual std::optional<std::string> TakeNote() { return std::nullopt; }
};

}  // namespace omnihdr
