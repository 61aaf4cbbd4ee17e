#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/capture/appliance.h"
#include "core/capture/capture_controller.h"
#include "core/capture/capture_state.h"
#include "core/capture/latency.h"
#include "core/capture/storage_guard.h"
#include "core/capture/trigger_ledger.h"
#include "core/session/journal.h"

namespace omnihdr {

// What the camera has said of itself when it was opened (CameraInfo).
struct CameraAbilities {
  double shortest_s = 0.0;
  double longest_s = 0.0;
  int exposure_latency_frames = 0;      // after which a new exposure is in force
  double min_trigger_interval_s = 0.0;  // between two triggers that it accepts
  ExposureProof proof = ExposureProof::kNone;
};

// What is known of whether the pictures of a head of several sensors are what its rig file says.
struct OrientationState {
  // "off" (no such head, or not wanted), "looking", or a verdict: "agrees", "contradicted",
  // "undecided".
  std::string what = "off";
  std::string text;        // one sentence; empty when off
  double agreement = 0.0;  // of neighbouring sensors, as configured: -1 to 1
  int frames = 0;          // that said something
  int looks = 0;
};

// All that the daemon tells about itself, at one moment.
struct StatusReport {
  std::string version;
  double uptime_s = 0.0;
  StateReport state;

  std::string session_directory;          // empty before there is a session
  bool session_resumed = false;           // continued from an earlier run
  std::uint64_t session_first_frame = 0;  // counted through the series
  std::uint64_t session_rotations = 0;    // this run: how often the next directory went on
  bool session_ended = false;             // all views are finished; nothing can be added

  bool camera_ready = false;
  std::string camera_model;
  std::string camera_serial;
  std::optional<CameraAbilities> camera_abilities;  // nothing before one was opened
  std::vector<std::pair<std::string, std::uint64_t>> camera_counters;  // the driver's own, by name
  std::uint64_t camera_rearmed = 0;  // opened anew because triggers gave no frame; this run

  bool armed = false;
  std::string trigger_source;
  bool trigger_wired = false;                  // the camera hangs on its wire
  bool camera_pulsed = false;                  // released by gpio.outputs.camera_trigger
  OrientationState orientation;                // of a head of several sensors
  std::uint64_t triggers = 0;                  // of the session, earlier runs included
  std::uint64_t triggers_in_flight = 0;        // not yet journaled
  std::uint64_t triggers_without_session = 0;  // of those: missed, waiting for a session's journal
  std::uint64_t triggers_ignored = 0;          // came while disarmed or without a session; this run
  std::int64_t positions_triggered = 0;
  OutcomeCounts lines;    // journal lines of the session by status
  CaptureCounts capture;  // this run

  bool pipeline_enabled = true;
  std::uint64_t views_finished = 0;       // on disk
  std::int64_t backlog = 0;               // positions with pixels whose view is not on disk
  int quality_level = 0;                  // of the next view; 0 = full
  std::string quality;                    // in words
  std::uint64_t views_reduced = 0;        // of those on disk, made at a level above 0
  std::optional<std::int64_t> last_view;  // position
  std::string views_error;                // what keeps the pipeline from working

  // Of the next trigger; steps = 0 before the camera has told its limits.
  int bracket_step = 0;
  int bracket_steps = 0;
  std::string bracket_order;
  std::vector<std::string> bracket_changes;  // what is not as it was configured
  nlohmann::json metering;  // of the first look at the scene; null = none was taken
  Exposure exposure;

  UtcQuality utc;
  std::optional<double> odometer_m;
  std::optional<double> heading_deg;
  std::optional<GnssFix> gnss;
  std::vector<std::pair<std::string, LinkReport>> links;  // connections to the vehicle, by name
  StorageReport storage;
  Durability durability = Durability::kFrame;
  double max_loss_s = 0.0;  // of what is journaled, in a power cut
  std::uint64_t unsynced_frames = 0;
  std::uint64_t storage_errors = 0;        // this run: writes and syncs that failed
  std::uint64_t deleted = 0;               // this run: sessions, or views of sessions, by retention
  CaptureLatencies latencies;              // this run
  std::optional<double> last_frame_age_s;  // nothing before the first frame
  std::uint64_t api_requests = 0;          // this run, answered
  std::vector<std::pair<std::string, std::uint64_t>> api_refused;  // by reason
  std::uint64_t reloads = 0;                                       // of the configuration, this run
  std::uint64_t reloads_refused = 0;
  std::string reload_error;                 // why the last one was refused; empty when it was not
  std::vector<std::string> restart_needed;  // keys whose value in the file is not in force
  std::uint64_t buffers_free = 0;
  std::uint64_t buffers = 0;
};

// The body of GET /v1/status. Keys may be added, not changed.
nlohmann::json StatusToJson(const StatusReport& status);
// The body of GET /metrics, Prometheus text format 0.0.4.
std::string StatusToMetrics(const StatusReport& status);
// For people, several lines, from the JSON form.
std::string StatusForPeople(const nlohmann::json& status);
// One line: "armed  positions 12  frames 11  views 9  backlog 2 ...", with what is unusual behind.
std::string ProgressLine(const nlohmann::json& status);

}  // namespace omnihdr
