#include "daemon/api/status.h"

#include <fmt/format.h>

#include <cmath>
#include <iterator>

namespace omnihdr {
namespace {

using Json = nlohmann::json;

constexpr std::array<FrameStatus, kFrameStatusCount> kStatuses = {
    FrameStatus::kOk,      FrameStatus::kMissedTrigger,    FrameStatus::kCameraTimeout,
    FrameStatus::kCorrupt, FrameStatus::kExposureMismatch, FrameStatus::kDiskFull};
constexpr std::array<CaptureState, kCaptureStateCount> kStates = {
    CaptureState::kStarting, CaptureState::kWaitingForCamera, CaptureState::kIdle,
    CaptureState::kArmed,    CaptureState::kDegraded,         CaptureState::kStorageFull,
    CaptureState::kFault,    CaptureState::kStopping,         CaptureState::kCapturing};

// Untrusted text (camera names, paths) made valid UTF-8, so that it can be dumped.
std::string Utf8(const std::string& text) {
  return Json::parse(Json(text).dump(-1, ' ', false, Json::error_handler_t::replace))
      .get<std::string>();
}

Json OrNull(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? Json(*value) : Json(nullptr);
}

class Metrics {
 public:
  void Family(std::string_view name, std::string_view type, std::string_view help) {
    fmt::format_to(std::back_inserter(text_), "# HELP {0} {2}\n# TYPE {0} {1}\n", name, type, help);
  }
  void Sample(std::string_view name, std::string_view labels, double value) {
    if (labels.empty()) {
      fmt::format_to(std::back_inserter(text_), "{} {}\n", name, value);
    } else {
      fmt::format_to(std::back_inserter(text_), "{}{{{}}} {}\n", name, labels, value);
    }
  }
  void One(std::string_view name, std::string_view type, std::string_view help, double value) {
    Family(name, type, help);
    Sample(name, "", value);
  }
  // Buckets, sum and count of one series of a histogram family.
  void Histogram(std::string_view name, std::string_view labels, const LatencyCounts& counts) {
    std::uint64_t below = 0;
    for (std::size_t i = 0; i < counts.counts.size(); ++i) {
      below += counts.counts[i];
      const std::string bound =
          i < LatencyCounts::kBounds.size() ? fmt::format("{}", LatencyCounts::kBounds[i]) : "+Inf";
      fmt::format_to(std::back_inserter(text_), "{}_bucket{{{},le=\"{}\"}} {}\n", name, labels,
                     bound, below);
    }
    fmt::format_to(std::back_inserter(text_), "{0}_sum{{{1}}} {2}\n{0}_count{{{1}}} {3}\n", name,
                   labels, counts.sum_s, counts.total);
  }
  std::string Take() { return std::move(text_); }

 private:
  std::string text_;
};

// As Prometheus wants it within quotes.
std::string LabelValue(const std::string& text) {
  std::string escaped;
  for (const char c : Utf8(text)) {
    if (c == '\\' || c == '"') escaped += '\\';
    if (c == '\n') {
      escaped += "\\n";
    } else {
      escaped += c;
    }
  }
  return escaped;
}

double AsDouble(std::uint64_t value) { return static_cast<double>(value); }

}  // namespace

Json StatusToJson(const StatusReport& s) {
  Json drops = Json::object();
  std::uint64_t dropped = 0;
  for (const FrameStatus status : kStatuses) {
    if (status == FrameStatus::kOk) continue;
    drops[std::string(ToString(status))] = s.lines[status];
    dropped += s.lines[status];
  }
  Json missed = Json::object();
  for (std::size_t i = 0; i < kMissReasonCount; ++i) {
    missed[std::string(ToString(static_cast<MissReason>(i)))] = s.capture.missed[i];
  }
  Json camera_counters = Json::object();
  for (const auto& [name, value] : s.camera_counters) camera_counters[name] = value;
  Json exposure;
  if (const auto& abilities = s.camera_abilities) {
    exposure = {{"shortest_s", abilities->shortest_s},
                {"longest_s", abilities->longest_s},
                {"latency_frames", abilities->exposure_latency_frames},
                {"min_trigger_interval_s", abilities->min_trigger_interval_s},
                {"proof", ToString(abilities->proof)}};
  }
  Json json = {
      {"version", s.version},
      {"uptime_s", s.uptime_s},
      {"state", ToString(s.state.state)},
      {"reason", Utf8(s.state.reason)},
      {"remedy", Utf8(s.state.remedy)},
      {"session",
       {{"directory", Utf8(s.session_directory)},
        {"resumed", s.session_resumed},
        {"first_frame", s.session_first_frame},
        {"rotations", s.session_rotations},
        {"ended", s.session_ended}}},
      {"camera",
       {{"ready", s.camera_ready},
        {"model", Utf8(s.camera_model)},
        {"serial", Utf8(s.camera_serial)},
        {"exposure", std::move(exposure)},
        {"counters", std::move(camera_counters)},
        {"rearmed", s.camera_rearmed},
        {"pulsed", s.camera_pulsed},
        {"clock_jumps", s.capture.clock_jumps}}},
      {"orientation",
       {{"what", s.orientation.what},
        {"text", Utf8(s.orientation.text)},
        {"agreement", s.orientation.agreement},
        {"frames", s.orientation.frames},
        {"looks", s.orientation.looks}}},
      {"armed", s.armed},
      {"trigger_source", s.trigger_source},
      {"trigger_wired", s.trigger_wired},
      {"triggers",
       {{"accepted", s.triggers},
        {"in_flight", s.triggers_in_flight},
        {"ignored", s.triggers_ignored},
        {"refused", s.capture.refused},
        {"late_frames", s.capture.late_frames},
        {"camera_gaps", s.capture.camera_gaps},
        {"lost_unlisted", s.capture.lost_unlisted},
        {"without_session", s.triggers_without_session},
        {"waited", s.capture.waited},
        {"retaken", s.capture.retaken},
        {"edges_without_frame", s.capture.edges_without_frame},
        {"frames_without_edge", s.capture.frames_without_edge},
        {"frames_disarmed", s.capture.frames_disarmed},
        {"missed", missed}}},
      {"positions_triggered", s.positions_triggered},
      {"frames_recorded", s.lines[FrameStatus::kOk]},
      {"frames_dropped", dropped},
      {"drops", drops},
      {"views",
       {{"enabled", s.pipeline_enabled},
        {"finished", s.views_finished},
        {"backlog", s.backlog},
        {"quality_level", s.quality_level},
        {"quality", s.quality},
        {"reduced", s.views_reduced},
        {"last", s.last_view ? Json(*s.last_view) : Json(nullptr)},
        {"error", Utf8(s.views_error)}}},
      {"odometer_m",
       s.odometer_m && std::isfinite(*s.odometer_m) ? Json(*s.odometer_m) : Json(nullptr)},
      {"heading_deg", OrNull(s.heading_deg)},
      {"minutes_left", OrNull(s.storage.minutes_left)},
      {"storage",
       {{"free_bytes", s.storage.free_bytes ? Json(*s.storage.free_bytes) : Json(nullptr)},
        {"total_bytes", s.storage.total_bytes ? Json(*s.storage.total_bytes) : Json(nullptr)},
        {"minutes_left", OrNull(s.storage.minutes_left)},
        {"warning", Utf8(s.storage.warning)},
        {"stop", Utf8(s.storage.stop)},
        {"error", Utf8(s.storage.error)},
        {"errors", s.storage_errors},
        {"durability", ToString(s.durability)},
        {"max_loss_s", s.max_loss_s},
        {"unsynced_frames", s.unsynced_frames},
        {"deleted", s.deleted}}},
      {"buffers", {{"free", s.buffers_free}, {"of", s.buffers}}},
  };
  json["last_frame_age_s"] = OrNull(s.last_frame_age_s);
  json["latency"] = Json::object();
  for (std::size_t i = 0; i < s.latencies.size(); ++i) {
    const LatencyCounts& counts = s.latencies[i];
    const double mean = counts.total > 0 ? counts.sum_s / AsDouble(counts.total) : 0.0;
    json["latency"][std::string(ToString(static_cast<CaptureLatency>(i)))] = {
        {"count", counts.total}, {"mean_s", counts.total > 0 ? Json(mean) : Json(nullptr)}};
  }
  json["api"] = {{"requests", s.api_requests}, {"refused", Json::object()}};
  for (const auto& [reason, count] : s.api_refused) json["api"]["refused"][reason] = count;
  json["config"] = {{"reloads", s.reloads},
                    {"reloads_refused", s.reloads_refused},
                    {"error", Utf8(s.reload_error)},
                    {"restart_needed", s.restart_needed}};
  json["clock"] = {{"synchronised", s.utc.synchronised},
                   {"error_s", OrNull(s.utc.error_s)},
                   {"tai_offset_s", s.utc.tai_offset_s ? Json(*s.utc.tai_offset_s) : Json()}};
  json["gnss"] = nullptr;
  if (s.gnss) {
    json["gnss"] = {{"lat", s.gnss->lat_deg},
                    {"lon", s.gnss->lon_deg},
                    {"alt_m", s.gnss->alt_m},
                    {"fix", s.gnss->fix},
                    {"dimensions", s.gnss->dimensions},
                    {"time", Utf8(s.gnss->time)},
                    {"error_m", OrNull(s.gnss->error_m)},
                    {"age_s", OrNull(s.gnss->age_s)}};
  }
  json["links"] = Json::array();
  for (const auto& [name, link] : s.links) {
    json["links"].push_back({{"name", name},
                             {"up", link.up},
                             {"problem", Utf8(link.problem)},
                             {"opened", link.opened},
                             {"messages", link.messages},
                             {"errors", link.errors},
                             {"lost", link.lost}});
  }
  json["metering"] = s.metering;
  if (s.bracket_steps > 0) {
    json["bracket"] = {
        {"order", s.bracket_order},         {"step", s.bracket_step},
        {"steps", s.bracket_steps},         {"exposure_s", s.exposure.time.seconds()},
        {"gain_db", s.exposure.gain.value}, {"changes", s.bracket_changes}};
  } else {
    json["bracket"] = nullptr;
  }
  return json;
}

std::string StatusToMetrics(const StatusReport& s) {
  Metrics m;
  m.Family("omnihdr_build_info", "gauge", "Version of the daemon.");
  m.Sample("omnihdr_build_info", fmt::format("version=\"{}\"", s.version), 1.0);
  m.One("omnihdr_uptime_seconds", "gauge", "Seconds since the daemon started.", s.uptime_s);
  m.Family("omnihdr_state", "gauge", "1 for the state the appliance is in.");
  for (const CaptureState state : kStates) {
    m.Sample("omnihdr_state", fmt::format("state=\"{}\"", ToString(state)),
             state == s.state.state ? 1.0 : 0.0);
  }
  m.Family("omnihdr_state_info", "gauge", "1, with the state, its reason and what to do about it.");
  m.Sample("omnihdr_state_info",
           fmt::format("state=\"{}\",reason=\"{}\",remedy=\"{}\"", ToString(s.state.state),
                       LabelValue(s.state.reason), LabelValue(s.state.remedy)),
           1.0);
  m.One("omnihdr_camera_ready", "gauge", "1 when a camera is open.", s.camera_ready ? 1.0 : 0.0);
  if (const auto& abilities = s.camera_abilities) {
    m.One("omnihdr_camera_exposure_latency_frames", "gauge",
          "Frames after which a new exposure is in force.", abilities->exposure_latency_frames);
    m.One("omnihdr_camera_min_trigger_interval_seconds", "gauge",
          "Least time between two triggers that the camera accepts.",
          abilities->min_trigger_interval_s);
  }
  m.Family("omnihdr_camera_events_total", "counter", "What the camera's driver counts, by name.");
  for (const auto& [name, value] : s.camera_counters) {
    m.Sample("omnihdr_camera_events_total", fmt::format("event=\"{}\"", name), AsDouble(value));
  }
  if (s.orientation.what != "off") {
    m.One("omnihdr_orientation_agreement", "gauge",
          "How far neighbouring sensors agree under the rig file, -1 to 1.",
          s.orientation.agreement);
    m.One("omnihdr_orientation_contradicted", "gauge",
          "1 when they contradict it, and agree under another order or rotation.",
          s.orientation.what == "contradicted" ? 1.0 : 0.0);
  }
  m.One("omnihdr_triggers_total", "counter", "Triggers of the session.", AsDouble(s.triggers));
  m.One("omnihdr_triggers_in_flight", "gauge", "Triggers not yet journaled.",
        AsDouble(s.triggers_in_flight));
  m.One("omnihdr_triggers_ignored_total", "counter",
        "Trigger events while disarmed or without a session.", AsDouble(s.triggers_ignored));
  m.One("omnihdr_triggers_refused_total", "counter", "Triggers without room for a line.",
        AsDouble(s.capture.refused));
  m.One("omnihdr_triggers_without_session", "gauge",
        "Triggers that came before there was a session; journaled as missed once there is one.",
        AsDouble(s.triggers_without_session));
  m.Family("omnihdr_triggers_missed_total", "counter",
           "Triggers without an exposure since the start, by reason.");
  for (std::size_t i = 0; i < kMissReasonCount; ++i) {
    m.Sample("omnihdr_triggers_missed_total",
             fmt::format("reason=\"{}\"", ToString(static_cast<MissReason>(i))),
             AsDouble(s.capture.missed[i]));
  }
  m.One("omnihdr_triggers_lost_unlisted_total", "counter",
        "Events the trigger source reported lost that got no journal line.",
        AsDouble(s.capture.lost_unlisted));
  m.One("omnihdr_triggers_waited_total", "counter",
        "Triggers whose exposure a busy camera put off.", AsDouble(s.capture.waited));
  m.One("omnihdr_steps_retaken_total", "counter",
        "Steps of the bracket taken again because their exposure was not proved.",
        AsDouble(s.capture.retaken));
  m.One("omnihdr_camera_rearmed_total", "counter",
        "Times the camera was opened anew because triggers gave no frame.",
        AsDouble(s.camera_rearmed));
  m.One("omnihdr_camera_clock_jumps_total", "counter",
        "Jumps of the camera's clock against the machine's.", AsDouble(s.capture.clock_jumps));
  m.One("omnihdr_utc_synchronised", "gauge", "1 while the machine's UTC is kept by a time source.",
        s.utc.synchronised ? 1.0 : 0.0);
  if (s.utc.error_s) {
    m.One("omnihdr_utc_error_seconds", "gauge", "Bound of the error of the machine's UTC.",
          *s.utc.error_s);
  }
  if (s.trigger_wired) {
    m.One("omnihdr_edges_without_frame_total", "counter",
          "Edges of a wired camera's trigger that got no frame.",
          AsDouble(s.capture.edges_without_frame));
    m.One("omnihdr_frames_without_edge_total", "counter",
          "Frames of a wired camera that no edge was seen for.",
          AsDouble(s.capture.frames_without_edge));
    m.One("omnihdr_frames_disarmed_total", "counter",
          "Frames that a wired camera took while the daemon was disarmed.",
          AsDouble(s.capture.frames_disarmed));
  }
  m.Family("omnihdr_frames_total", "counter", "Journal lines of the session by status.");
  for (const FrameStatus status : kStatuses) {
    m.Sample("omnihdr_frames_total", fmt::format("status=\"{}\"", ToString(status)),
             AsDouble(s.lines[status]));
  }
  m.One("omnihdr_late_frames_total", "counter", "Frames that came after their deadline.",
        AsDouble(s.capture.late_frames));
  m.One("omnihdr_camera_gaps_total", "counter", "Frames the camera's counter says were lost.",
        AsDouble(s.capture.camera_gaps));
  m.One("omnihdr_views_finished", "gauge", "Views of the session on disk.",
        AsDouble(s.views_finished));
  m.One("omnihdr_views_backlog", "gauge", "Positions with pixels whose view is not on disk.",
        static_cast<double>(s.backlog));
  m.One("omnihdr_views_quality_level", "gauge",
        "How much less work than in full the next view gets, 0 = full.",
        static_cast<double>(s.quality_level));
  m.One("omnihdr_views_reduced", "gauge", "Views on disk of reduced quality, to be upgraded.",
        AsDouble(s.views_reduced));
  m.One("omnihdr_buffers_free", "gauge", "Free frame buffers.", AsDouble(s.buffers_free));
  m.Family("omnihdr_latency_seconds", "histogram",
           "How long a stage took: edge_to_command, command_to_frame, frame_to_durable, "
           "trigger_to_view, and of each view view_pose, view_stereo, view_merge, view_write.");
  for (std::size_t i = 0; i < s.latencies.size(); ++i) {
    m.Histogram("omnihdr_latency_seconds",
                fmt::format("stage=\"{}\"", ToString(static_cast<CaptureLatency>(i))),
                s.latencies[i]);
  }
  if (s.last_frame_age_s) {
    m.One("omnihdr_last_frame_age_seconds", "gauge", "Since the newest frame came.",
          *s.last_frame_age_s);
  }
  m.One("omnihdr_api_requests_total", "counter", "Requests to the API that were answered.",
        AsDouble(s.api_requests));
  m.Family("omnihdr_api_refused_total", "counter",
           "Requests to the API that were refused before they were looked at, by reason.");
  for (const auto& [reason, count] : s.api_refused) {
    m.Sample("omnihdr_api_refused_total", fmt::format("reason=\"{}\"", reason), AsDouble(count));
  }
  m.One("omnihdr_config_reloads_total", "counter",
        "Reloads of the configuration that were applied.", AsDouble(s.reloads));
  m.One("omnihdr_config_reloads_refused_total", "counter",
        "Reloads that were refused; the configuration stayed as it was.",
        AsDouble(s.reloads_refused));
  m.One("omnihdr_config_restart_needed", "gauge",
        "Keys of the configuration file that apply at a restart only.",
        static_cast<double>(s.restart_needed.size()));
  if (s.bracket_steps > 0) {
    m.One("omnihdr_next_exposure_seconds", "gauge", "Exposure of the next trigger.",
          s.exposure.time.seconds());
  }
  if (s.odometer_m) m.One("omnihdr_odometer_metres", "gauge", "Way travelled.", *s.odometer_m);
  if (s.storage.minutes_left) {
    m.One("omnihdr_storage_minutes_left", "gauge",
          "Minutes until the storage is full at the present rate.", *s.storage.minutes_left);
  }
  if (s.storage.free_bytes && s.storage.total_bytes) {
    m.One("omnihdr_storage_free_bytes", "gauge", "Free space of the storage.",
          AsDouble(*s.storage.free_bytes));
    m.One("omnihdr_storage_size_bytes", "gauge", "Size of the storage.",
          AsDouble(*s.storage.total_bytes));
  }
  m.One("omnihdr_storage_readable", "gauge", "1 when the free space of the storage can be read.",
        s.storage.error.empty() ? 1.0 : 0.0);
  m.One("omnihdr_storage_warning", "gauge", "1 when the storage is under a limit that warns.",
        s.storage.warning.empty() ? 0.0 : 1.0);
  m.One("omnihdr_storage_stop", "gauge",
        "1 when the storage is under a limit at which no picture is stored.",
        s.storage.stop.empty() ? 0.0 : 1.0);
  m.One("omnihdr_storage_errors_total", "counter", "Writes and syncs of the storage that failed.",
        AsDouble(s.storage_errors));
  m.One("omnihdr_unsynced_frames", "gauge", "Frames that a power cut would cost.",
        AsDouble(s.unsynced_frames));
  m.One("omnihdr_session_rotations_total", "counter",
        "How often the next session directory went on.", AsDouble(s.session_rotations));
  m.One("omnihdr_retention_deleted_total", "counter",
        "Sessions, or views of sessions, that retention deleted.", AsDouble(s.deleted));
  if (s.gnss) {
    m.One("omnihdr_gnss_fix", "gauge", "Quality of the GNSS fix, as NMEA GGA counts.",
          static_cast<double>(s.gnss->fix));
  }
  const auto links = [&](std::string_view name, std::string_view type, std::string_view help,
                         auto value) {
    m.Family(name, type, help);
    for (const auto& [link, report] : s.links) {
      m.Sample(name, fmt::format("link=\"{}\"", link), value(report));
    }
  };
  if (!s.links.empty()) {
    links("omnihdr_link_up", "gauge", "1 while a connection to the vehicle works.",
          [](const LinkReport& r) { return r.up ? 1.0 : 0.0; });
    links("omnihdr_link_opened_total", "counter", "How often the connection was made.",
          [](const LinkReport& r) { return AsDouble(r.opened); });
    links("omnihdr_link_messages_total", "counter", "Messages and events understood.",
          [](const LinkReport& r) { return AsDouble(r.messages); });
    links("omnihdr_link_errors_total", "counter", "Time-outs, refusals, broken messages.",
          [](const LinkReport& r) { return AsDouble(r.errors); });
    links("omnihdr_link_lost_total", "counter", "Events and readings known to be missing.",
          [](const LinkReport& r) { return AsDouble(r.lost); });
  }
  return m.Take();
}

std::string StatusForPeople(const Json& s) {
  std::string text;
  const auto line = [&text](std::string_view name, const std::string& value) {
    fmt::format_to(std::back_inserter(text), "{:<12}{}\n", name, value);
  };
  line("state",
       fmt::format("{} ({})", s.at("state").get<std::string>(), s.at("reason").get<std::string>()));
  if (const std::string remedy = s.value("remedy", ""); !remedy.empty()) line("to do", remedy);
  const Json& session = s.at("session");
  const std::string directory = session.at("directory").get<std::string>();
  line("session", directory.empty()
                      ? "none yet"
                      : directory + (session.at("ended").get<bool>()     ? " (ended)"
                                     : session.at("resumed").get<bool>() ? " (continued)"
                                                                         : ""));
  const Json& camera = s.at("camera");
  line("camera", fmt::format("{}{}", camera.at("model").get<std::string>(),
                             camera.at("ready").get<bool>() ? "" : " (not ready)") +
                     (camera.value("pulsed", false) ? ", released by pulses on its wire" : ""));
  if (const Json exposure = camera.value("exposure", Json()); exposure.is_object()) {
    const int latency = exposure.value("latency_frames", 0);
    const double interval = exposure.value("min_trigger_interval_s", 0.0);
    line("exposures",
         fmt::format("{:.6g} to {:.6g} s, in force {}{}; proof: {}",
                     exposure.value("shortest_s", 0.0), exposure.value("longest_s", 0.0),
                     latency == 0 ? "with the next frame" : fmt::format("{} frames later", latency),
                     interval > 0.0
                         ? fmt::format(", the next trigger after {:.3g} s at the soonest", interval)
                         : "",
                     exposure.value("proof", "")));
  }
  if (const Json orientation = s.value("orientation", Json::object());
      orientation.value("what", "off") != "off") {
    line("orientation",
         fmt::format("{} ({})", orientation.value("what", ""), orientation.value("text", "")));
  }
  line("positions",
       fmt::format("{} triggered by {}", s.at("positions_triggered").get<std::int64_t>(),
                   s.at("trigger_source").get<std::string>() +
                       (s.value("trigger_wired", false) ? ", the camera on its wire" : "")));
  const Json& triggers = s.at("triggers");
  if (const auto waiting = triggers.value("without_session", std::uint64_t{0}); waiting > 0) {
    line("triggers", fmt::format("{} missed before there was a session", waiting));
  }
  std::string missed;
  const Json by_reason = triggers.value("missed", Json::object());
  for (const auto& [reason, count] : by_reason.items()) {
    if (count.get<std::uint64_t>() == 0) continue;
    fmt::format_to(std::back_inserter(missed), "{}{} {}", missed.empty() ? "" : ", ", reason,
                   count.get<std::uint64_t>());
  }
  if (!missed.empty()) line("missed", missed + " since the start");
  if (s.value("trigger_wired", false)) {
    line("wire", fmt::format("{} edges without frame, {} frames without edge",
                             triggers.value("edges_without_frame", std::uint64_t{0}),
                             triggers.value("frames_without_edge", std::uint64_t{0})));
  }
  std::string drops;
  for (const auto& [reason, count] : s.at("drops").items()) {
    if (count.get<std::uint64_t>() == 0) continue;
    fmt::format_to(std::back_inserter(drops), "{}{} {}", drops.empty() ? "" : ", ", reason,
                   count.get<std::uint64_t>());
  }
  line("frames", fmt::format("{} recorded, {} lost{}", s.at("frames_recorded").get<std::uint64_t>(),
                             s.at("frames_dropped").get<std::uint64_t>(),
                             drops.empty() ? "" : " (" + drops + ")"));
  const Json& views = s.at("views");
  if (views.at("enabled").get<bool>()) {
    const std::string error = views.at("error").get<std::string>();
    const auto reduced = views.value("reduced", std::uint64_t{0});
    line("views",
         fmt::format("{} finished{}, backlog {}{}", views.at("finished").get<std::uint64_t>(),
                     reduced > 0 ? fmt::format(" ({} of reduced quality)", reduced) : "",
                     views.at("backlog").get<std::int64_t>(),
                     error.empty() ? "" : " (stalled: " + error + ")"));
    if (views.contains("quality_level")) {
      line("quality", fmt::format("level {} ({})", views.value("quality_level", 0),
                                  views.value("quality", "")));
    }
  } else {
    line("views", "not made here (pipeline.enabled = false)");
  }
  if (const Json& bracket = s.at("bracket"); bracket.is_object()) {
    line("next", fmt::format("{:.6g} s, step {} of {} ({})", bracket.at("exposure_s").get<double>(),
                             bracket.at("step").get<int>() + 1, bracket.at("steps").get<int>(),
                             bracket.at("order").get<std::string>()));
  }
  if (const Json& bracket = s.at("bracket"); bracket.is_object()) {
    const Json changes = bracket.value("changes", Json::array());
    for (const Json& change : changes) line("bracket", change.get<std::string>());
  }
  if (const Json metering = s.value("metering", Json()); metering.is_object()) {
    if (metering.contains("error")) {
      line("metering", metering["error"].get<std::string>());
    } else {
      std::string steps;
      for (const Json& step : metering.value("exposures_s", Json::array())) {
        fmt::format_to(std::back_inserter(steps), "{}{:.6g}", steps.empty() ? "" : ", ",
                       step.get<double>());
      }
      line("metering", fmt::format("{:.1f} stops: {} s{}", metering.value("range_stops", 0.0),
                                   steps, metering.value("adopted", false) ? ", adopted" : ""));
      for (const Json& note : metering.value("notes", Json::array())) {
        line("metering", note.get<std::string>());
      }
    }
  }
  if (const Json clock = s.value("clock", Json()); clock.is_object()) {
    const Json error = clock.value("error_s", Json());
    const std::string within =
        error.is_number() ? fmt::format(", to within {:.3g} s", error.get<double>()) : "";
    line("utc", clock.value("synchronised", false)
                    ? "synchronised" + within
                    : "free: no time source keeps the machine's clock");
  }
  if (const Json& odometer = s.at("odometer_m"); odometer.is_number()) {
    line("odometer", fmt::format("{:.2f} m", odometer.get<double>()));
  }
  if (const Json& gnss = s.value("gnss", Json()); gnss.is_object()) {
    line("gnss", fmt::format("{:.6f}, {:.6f}, quality {}", gnss.value("lat", 0.0),
                             gnss.value("lon", 0.0), gnss.value("fix", 0)));
  }
  if (const Json storage = s.value("storage", Json()); storage.is_object()) {
    std::string said;
    const auto say = [&said](const std::string& what) {
      if (!what.empty()) said += (said.empty() ? "" : ", ") + what;
    };
    if (const Json free = storage.value("free_bytes", Json()); free.is_number()) {
      say(fmt::format("{:.1f} GB free", free.get<double>() * 1e-9));
    }
    if (const Json minutes = storage.value("minutes_left", Json()); minutes.is_number()) {
      say(fmt::format("{:.0f} minutes left", minutes.get<double>()));
    }
    for (const char* problem : {"error", "stop", "warning"}) {
      if (const std::string problem_text = storage.value(problem, ""); !problem_text.empty()) {
        say(fmt::format("{}: {}", problem, problem_text));
      }
    }
    if (const double loss = storage.value("max_loss_s", 0.0); loss > 0.0) {
      say(fmt::format("a power cut costs at most the last {:g} s", loss));
    }
    line("storage", said);
  }
  for (const Json& link : s.value("links", Json::array())) {
    const std::string problem = link.value("problem", "");
    line("link", fmt::format("{}{}", link.value("name", ""),
                             problem.empty() ? std::string(" works") : ": " + problem));
  }
  if (const Json config = s.value("config", Json()); config.is_object()) {
    if (const std::string error = config.value("error", ""); !error.empty()) {
      line("reload", "refused: " + error);
    }
    std::string keys;
    for (const Json& key : config.value("restart_needed", Json::array())) {
      keys += (keys.empty() ? "" : ", ") + key.get<std::string>();
    }
    if (!keys.empty()) line("restart", "needed for " + keys);
  }
  line("daemon", fmt::format("version {}, up {:.0f} s", s.at("version").get<std::string>(),
                             s.at("uptime_s").get<double>()));
  return text;
}

std::string ProgressLine(const Json& s) {
  const Json& views = s.at("views");
  std::string text = fmt::format(
      "{:<9} positions {}  frames {}  views {}  backlog {}", s.at("state").get<std::string>(),
      s.at("positions_triggered").get<std::int64_t>(), s.at("frames_recorded").get<std::uint64_t>(),
      views.at("finished").get<std::uint64_t>(), views.at("backlog").get<std::int64_t>());
  if (const int level = views.value("quality_level", 0); level > 0) {
    text += fmt::format("  quality level {}", level);
  }
  if (const auto dropped = s.at("frames_dropped").get<std::uint64_t>(); dropped > 0) {
    text += fmt::format("  lost {}", dropped);
  }
  if (const std::string error = views.at("error").get<std::string>(); !error.empty()) {
    text += fmt::format("  views stalled: {}", error);
  }
  return text;
}

}  // namespace omnihdr
