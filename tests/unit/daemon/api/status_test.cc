#include "daemon/api/status.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <set>
#include <sstream>
#include <string>

namespace omnihdr::status_test {
namespace {

using testing::HasSubstr;
using testing::Not;

StatusReport Busy() {
  StatusReport s;
  s.version = "1.2.3";
  s.uptime_s = 12.5;
  s.state = {CaptureState::kDegraded, "2 of the last 16 triggers gave no frame", "drive slower"};
  s.session_directory = "/data/s";
  s.session_resumed = true;
  s.camera_ready = true;
  s.camera_model = "model";
  s.armed = true;
  s.trigger_source = "distance";
  s.triggers = 12;
  s.positions_triggered = 12;
  for (int i = 0; i < 10; ++i) s.lines.Add(FrameStatus::kOk);
  s.lines.Add(FrameStatus::kCameraTimeout);
  s.lines.Add(FrameStatus::kCameraTimeout);
  s.views_finished = 8;
  s.backlog = 2;
  s.quality = "full";
  s.last_view = 9;
  s.bracket_steps = 3;
  s.bracket_order = "sawtooth";
  s.exposure = {ExposureTime::Seconds(0.004), GainDb{}};
  s.odometer_m = 3.25;
  return s;
}

TEST(Status, AWiredCameraTheMachinesClockAndALookAtTheSceneAreTold) {
  StatusReport s = Busy();
  EXPECT_THAT(StatusForPeople(StatusToJson(s)), HasSubstr("free: no time source"));
  EXPECT_THAT(StatusToMetrics(s), Not(HasSubstr("omnihdr_edges_without_frame_total")));
  s.trigger_wired = true;
  s.capture.edges_without_frame = 3;
  s.capture.frames_without_edge = 2;
  s.utc = {true, 0.0025, 37};
  s.metering = {{"range_stops", 9.5},
                {"exposures_s", {0.001, 0.008}},
                {"notes", {"left out: a step"}},
                {"adopted", true}};
  const auto json = StatusToJson(s);
  EXPECT_EQ(json["triggers"]["edges_without_frame"], 3);
  EXPECT_EQ(json["clock"]["error_s"], 0.0025);
  const std::string people = StatusForPeople(json);
  EXPECT_THAT(people, HasSubstr("triggered by distance, the camera on its wire"));
  EXPECT_THAT(people, HasSubstr("3 edges without frame, 2 frames without edge"));
  EXPECT_THAT(people, HasSubstr("synchronised, to within 0.0025 s"));
  EXPECT_THAT(people, HasSubstr("9.5 stops: 0.001, 0.008 s, adopted"));
  EXPECT_THAT(people, HasSubstr("left out: a step"));
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_frames_without_edge_total 2\n"));
}

TEST(Status, JsonHoldsTheNumbersAScriptNeeds) {
  const auto json = StatusToJson(Busy());
  EXPECT_EQ(json["state"], "degraded");
  EXPECT_EQ(json["positions_triggered"], 12);
  EXPECT_EQ(json["frames_recorded"], 10);
  EXPECT_EQ(json["frames_dropped"], 2);
  EXPECT_EQ(json["drops"]["camera-timeout"], 2);
  EXPECT_EQ(json["drops"]["disk-full"], 0);
  EXPECT_EQ(json["views"]["finished"], 8);
  EXPECT_EQ(json["views"]["backlog"], 2);
  EXPECT_EQ(json["session"]["ended"], false);
  EXPECT_EQ(json["bracket"]["exposure_s"], 0.004);
  EXPECT_EQ(json["odometer_m"], 3.25);
}

TEST(Status, WhatTheCameraHasSaidOfItsExposuresIsTold) {
  StatusReport s = Busy();
  EXPECT_TRUE(StatusToJson(s)["camera"]["exposure"].is_null());
  EXPECT_THAT(StatusForPeople(StatusToJson(s)), Not(HasSubstr("exposures")));
  EXPECT_THAT(StatusToMetrics(s), Not(HasSubstr("omnihdr_camera_exposure_latency_frames")));
  s.camera_abilities = {1e-5, 4.0, 2, 0.25, ExposureProof::kEmbedded};
  const auto json = StatusToJson(s);
  EXPECT_EQ(json["camera"]["exposure"]["latency_frames"], 2);
  EXPECT_EQ(json["camera"]["exposure"]["proof"], "embedded");
  EXPECT_THAT(
      StatusForPeople(json),
      HasSubstr("exposures   1e-05 to 4 s, in force 2 frames later, the next trigger after 0.25 s "
                "at the soonest; proof: embedded\n"));
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_camera_exposure_latency_frames 2\n"));
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_camera_min_trigger_interval_seconds 0.25\n"));
}

TEST(Status, WhatTheCamerasDriverCountsIsToldByName) {
  StatusReport s = Busy();
  s.camera_counters = {{"stale_frames", 3}, {"sequence_gaps", 17}};
  const auto json = StatusToJson(s);
  EXPECT_EQ(json["camera"]["counters"]["stale_frames"], 3);
  const std::string metrics = StatusToMetrics(s);
  EXPECT_NE(metrics.find("omnihdr_camera_events_total{event=\"sequence_gaps\"} 17\n"),
            std::string::npos)
      << metrics;
}

TEST(Status, TheVehiclesConnectionsPlaceAndStorageAreTold) {
  StatusReport s = Busy();
  s.storage.minutes_left = 95.5;
  s.storage.free_bytes = 12'300'000'000;
  s.storage.total_bytes = 100'000'000'000;
  s.storage.warning = "12300 MB are free, storage.warn_free_mb is 20000";
  s.durability = Durability::kInterval;
  s.max_loss_s = 2.0;
  s.heading_deg = 271.5;
  s.gnss.emplace();
  s.gnss->lat_deg = 52.5;
  s.gnss->fix = 4;
  LinkReport link;
  link.problem = "no answer within 200 ms";
  link.errors = 7;
  link.lost = 2;
  s.links.emplace_back("modbus vehicle", link);
  const auto json = StatusToJson(s);
  EXPECT_EQ(json["minutes_left"], 95.5);
  EXPECT_EQ(json["heading_deg"], 271.5);
  EXPECT_EQ(json["gnss"]["fix"], 4);
  EXPECT_TRUE(json["gnss"]["age_s"].is_null());
  EXPECT_EQ(json["links"][0]["name"], "modbus vehicle");
  EXPECT_EQ(json["links"][0]["lost"], 2);
  const std::string metrics = StatusToMetrics(s);
  EXPECT_THAT(metrics, HasSubstr("omnihdr_link_up{link=\"modbus vehicle\"} 0"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_link_errors_total{link=\"modbus vehicle\"} 7"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_storage_minutes_left 95.5"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_storage_free_bytes 12300000000"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_storage_warning 1"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_storage_readable 1"));
  EXPECT_EQ(json["storage"]["durability"], "interval");
  EXPECT_EQ(json["storage"]["max_loss_s"], 2.0);
  const std::string people = StatusForPeople(json);
  EXPECT_THAT(people, HasSubstr("modbus vehicle: no answer within 200 ms"));
  EXPECT_THAT(people, HasSubstr("12.3 GB free, 96 minutes left, warning: 12300 MB are free"));
  EXPECT_THAT(people, HasSubstr("a power cut costs at most the last 2 s"));
  // What cannot be read is not told as if it could.
  s.storage = {};
  s.storage.error = "/data: free space: Input/output error";
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_storage_readable 0"));
  EXPECT_THAT(StatusToMetrics(s), Not(HasSubstr("omnihdr_storage_free_bytes")));
  EXPECT_TRUE(StatusToJson(s)["storage"]["free_bytes"].is_null());
}

TEST(Status, EachStagesLatencyIsAHistogramThatPrometheusReads) {
  StatusReport s = Busy();
  LatencyCounts& frame = s.latencies[static_cast<std::size_t>(CaptureLatency::kCommandToFrame)];
  frame.Add(std::chrono::milliseconds(3));
  frame.Add(std::chrono::milliseconds(30));
  frame.Add(std::chrono::hours(1));
  s.last_frame_age_s = 1.5;
  const std::string metrics = StatusToMetrics(s);
  const std::string name = "omnihdr_latency_seconds_bucket{stage=\"command_to_frame\",le=";
  EXPECT_THAT(metrics, HasSubstr("# TYPE omnihdr_latency_seconds histogram\n"));
  EXPECT_THAT(metrics, HasSubstr(name + "\"0.0025\"} 0\n"));
  EXPECT_THAT(metrics, HasSubstr(name + "\"0.005\"} 1\n"));
  EXPECT_THAT(metrics, HasSubstr(name + "\"0.05\"} 2\n"));
  EXPECT_THAT(metrics, HasSubstr(name + "\"600\"} 2\n"));
  EXPECT_THAT(metrics, HasSubstr(name + "\"+Inf\"} 3\n"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_latency_seconds_count{stage=\"command_to_frame\"} 3\n"));
  EXPECT_THAT(metrics,
              HasSubstr("omnihdr_latency_seconds_sum{stage=\"command_to_frame\"} 3600.033"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_last_frame_age_seconds 1.5\n"));
  EXPECT_EQ(StatusToJson(s)["latency"]["command_to_frame"]["count"], 3);
  EXPECT_TRUE(StatusToJson(s)["latency"]["trigger_to_view"]["mean_s"].is_null());
}

TEST(Status, AHeadWhoseSensorsContradictItsRigFileIsNamedAndMeasured) {
  StatusReport s = Busy();
  EXPECT_THAT(StatusForPeople(StatusToJson(s)), Not(HasSubstr("orientation")));
  EXPECT_THAT(StatusToMetrics(s), Not(HasSubstr("omnihdr_orientation")));
  s.orientation = {"contradicted", "they would agree if it were upside down", 0.125, 3, 4};
  const auto json = StatusToJson(s);
  EXPECT_EQ(json["orientation"]["what"], "contradicted");
  EXPECT_EQ(json["orientation"]["frames"], 3);
  EXPECT_THAT(StatusForPeople(json),
              HasSubstr("contradicted (they would agree if it were upside down)"));
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_orientation_contradicted 1\n"));
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_orientation_agreement 0.125\n"));
}

TEST(Status, ACameraThatIsReleasedByItsWireSaysSo) {
  StatusReport s = Busy();
  EXPECT_EQ(StatusToJson(s)["camera"]["pulsed"], false);
  EXPECT_THAT(StatusForPeople(StatusToJson(s)), Not(HasSubstr("released by pulses")));
  s.camera_pulsed = true;
  EXPECT_THAT(StatusForPeople(StatusToJson(s)), HasSubstr(", released by pulses on its wire"));
}

TEST(Status, EveryMetricHasHelpAndTypeOnceAndStandsInTheList) {
  StatusReport s = Busy();
  s.storage.minutes_left = 1.0;
  s.storage.free_bytes = 1;
  s.storage.total_bytes = 1;
  s.camera_abilities.emplace();
  s.trigger_wired = true;
  s.orientation.what = "agrees";
  s.utc.error_s = 0.001;
  s.last_frame_age_s = 1.0;
  s.gnss.emplace();
  s.links.emplace_back("gpsd", LinkReport{});
  std::istringstream lines(StatusToMetrics(s));
  std::set<std::string> helped;
  std::set<std::string> typed;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string first;
    std::string second;
    std::string third;
    words >> first >> second >> third;
    if (first != "#") {
      std::string family = first.substr(0, first.find('{'));
      for (const char* suffix : {"_bucket", "_sum", "_count"}) {
        const std::string::size_type at = family.rfind(suffix);
        if (at != std::string::npos && typed.count(family.substr(0, at)) > 0) {
          family.resize(at);
          break;
        }
      }
      EXPECT_TRUE(typed.count(family) > 0) << line;
    } else if (second == "HELP") {
      EXPECT_TRUE(helped.insert(third).second) << line;
    } else {
      EXPECT_TRUE(typed.insert(third).second) << line;
    }
  }
  EXPECT_EQ(helped, typed);
  // The list: a table with a row for each.
  std::ifstream file(std::string(OMNIHDR_SOURCE_DIR) + "/daemon/api/README.md");
  std::set<std::string> listed;
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("| `omnihdr_")) continue;
    listed.insert(line.substr(3, line.find('`', 3) - 3));
  }
  EXPECT_EQ(listed, typed);
}

TEST(Status, MissedTriggersAreToldWithTheirReason) {
  StatusReport s = Busy();
  s.triggers_without_session = 7;
  s.capture.missed[static_cast<std::size_t>(MissReason::kNoCamera)] = 5;
  s.capture.missed[static_cast<std::size_t>(MissReason::kSourceLost)] = 2;
  const auto json = StatusToJson(s);
  EXPECT_EQ(json["triggers"]["without_session"], 7);
  EXPECT_EQ(json["triggers"]["missed"]["no-camera"], 5);
  EXPECT_EQ(json["triggers"]["missed"]["camera-busy"], 0);
  const std::string metrics = StatusToMetrics(s);
  EXPECT_THAT(metrics, HasSubstr("omnihdr_triggers_without_session 7\n"));
  EXPECT_THAT(metrics, HasSubstr("omnihdr_triggers_missed_total{reason=\"no-camera\"} 5\n"));
  const std::string people = StatusForPeople(json);
  EXPECT_THAT(people, HasSubstr("7 missed before there was a session"));
  EXPECT_THAT(people, HasSubstr("no-camera 5, source-lost 2 since the start"));
}

TEST(Status, WhatIsNotKnownIsNull) {
  const auto json = StatusToJson(StatusReport{});
  EXPECT_TRUE(json["odometer_m"].is_null());
  EXPECT_TRUE(json["minutes_left"].is_null());
  EXPECT_TRUE(json["gnss"].is_null());
  EXPECT_TRUE(json["bracket"].is_null());
  EXPECT_TRUE(json["views"]["last"].is_null());
}

TEST(Status, NamesThatAreNotUtf8DoNotBreakTheAnswer) {
  StatusReport s = Busy();
  s.camera_model = "m\xff";
  EXPECT_NO_THROW(static_cast<void>(StatusToJson(s).dump()));
}

TEST(Status, MetricsAreInThePrometheusTextFormat) {
  const std::string text = StatusToMetrics(Busy());
  EXPECT_THAT(text, HasSubstr("# TYPE omnihdr_frames_total counter\n"));
  EXPECT_THAT(text, HasSubstr("omnihdr_frames_total{status=\"camera-timeout\"} 2\n"));
  EXPECT_THAT(text, HasSubstr("omnihdr_state{state=\"degraded\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("omnihdr_state{state=\"armed\"} 0\n"));
  EXPECT_THAT(text, HasSubstr("omnihdr_views_backlog 2\n"));
  EXPECT_EQ(text.back(), '\n');
}

TEST(Status, PeopleReadReasonsAndLosses) {
  const std::string text = StatusForPeople(StatusToJson(Busy()));
  EXPECT_THAT(text, HasSubstr("degraded (2 of the last 16 triggers gave no frame)"));
  EXPECT_THAT(text, HasSubstr("/data/s (continued)"));
  EXPECT_THAT(text, HasSubstr("10 recorded, 2 lost (camera-timeout 2)"));
  EXPECT_THAT(text, HasSubstr("0.004 s, step 1 of 3 (sawtooth)"));
  EXPECT_THAT(text, Not(HasSubstr("disk-full")));
}

TEST(Status, ReducedQualityIsTold) {
  StatusReport s = Busy();
  EXPECT_THAT(StatusForPeople(StatusToJson(s)), HasSubstr("level 0 (full)"));
  s.quality_level = 2;
  s.quality = "labels x 2/3, stereo width x 3/4";
  s.views_reduced = 3;
  const auto json = StatusToJson(s);
  EXPECT_EQ(json["views"]["quality_level"], 2);
  EXPECT_EQ(json["views"]["quality"], s.quality);
  EXPECT_EQ(json["views"]["reduced"], 3);
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_views_quality_level 2\n"));
  EXPECT_THAT(StatusToMetrics(s), HasSubstr("omnihdr_views_reduced 3\n"));
  EXPECT_THAT(StatusForPeople(json), HasSubstr("8 finished (3 of reduced quality), backlog 2"));
  EXPECT_THAT(StatusForPeople(json), HasSubstr("level 2 (labels x 2/3, stereo width x 3/4)"));
  EXPECT_EQ(ProgressLine(json),
            "degraded  positions 12  frames 10  views 8  backlog 2  quality level 2  lost 2");
}

TEST(Status, AnOlderDaemonsAnswerIsUnderstood) {
  auto json = StatusToJson(Busy());
  for (const char* key : {"quality_level", "quality", "reduced"}) json["views"].erase(key);
  EXPECT_THAT(StatusForPeople(json), HasSubstr("8 finished, backlog 2"));
  EXPECT_THAT(ProgressLine(json), Not(HasSubstr("quality")));
}

TEST(Status, TheProgressLineHasTheFourCounts) {
  EXPECT_EQ(ProgressLine(StatusToJson(Busy())),
            "degraded  positions 12  frames 10  views 8  backlog 2  lost 2");
}

}  // namespace
}  // namespace omnihdr::status_test
