#pragma once

#include <array>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/base/stage.h"
#include "core/capture/appliance.h"
#include "core/capture/camera_runner.h"
#include "core/capture/capture_controller.h"
#include "core/capture/capture_state.h"
#include "core/capture/latency.h"
#include "core/capture/recorder.h"
#include "core/capture/storage_guard.h"
#include "core/pipeline/session_processor.h"
#include "core/ports/camera.h"
#include "core/ports/trigger.h"
#include "daemon/api/event_hub.h"
#include "daemon/api/server.h"
#include "daemon/config.h"
#include "daemon/config_reload.h"
#include "daemon/event_loop.h"
#include "daemon/logging.h"
#include "daemon/orientation_watch.h"
#include "daemon/session_choice.h"
#include "daemon/session_rotation.h"
#include "daemon/supervisor.h"
#include "daemon/system_utc.h"
#include "daemon/watchdog.h"

namespace omnihdr {

// The longest honest piece of work of each stage; beyond that it counts as stuck, and the service
// manager's watchdog is not fed any more.
struct StagePatience {
  Nanoseconds camera = std::chrono::seconds(30);
  Nanoseconds recorder = std::chrono::seconds(60);
  Nanoseconds pipeline = std::chrono::seconds(600);
};

// What the daemon is put together from: made from the configuration by parts.h, from doubles in
// tests.
struct AppParts {
  std::shared_ptr<Camera> camera;
  std::shared_ptr<TriggerSource> triggers;
  std::shared_ptr<PositionSource> positions;  // may be null
  std::shared_ptr<PlaceSource> place;         // may be null
  // Connections to the vehicle, started and ended by the daemon; where its status is shown, and the
  // line that tells of every picture (may be null).
  std::vector<std::shared_ptr<VehicleLink>> links;
  std::vector<std::shared_ptr<StatusOutput>> outputs;
  std::shared_ptr<StrobeOutput> strobe;
  // Gives the running trigger source another interval or distance, from the main loop; empty when
  // the source has neither.
  std::function<Status(const TriggerConfig&)> retune;
  // Opens the pipeline over a session directory; empty = no views are made here.
  std::function<Result<std::unique_ptr<SessionProcessor>>(const std::filesystem::path& session,
                                                          ProcessorCallbacks callbacks)>
      open_pipeline;
  StagePatience patience;
};
struct PartsContext {
  std::uint64_t first_trigger =
      0;                       // number of the next trigger: more than 0 in a continued session
  std::function<bool()> room;  // whether a frame buffer is free; any thread
  std::optional<double> last_odometer_m;  // the last place in the journal of a continued session
  CommandHandler command;                 // for masters on a field bus
};
using MakeParts = std::function<Result<AppParts>(const PartsContext&)>;

// The bracket a configuration asks for.
// `burst`: as trigger.burst, a whole bracket at a position.
BracketOptions MakeBracketOptions(const BracketConfig& bracket, bool burst);

// The daemon. Everything is built in order by Run and torn down in reverse; data flow one way:
//   trigger (main loop) -> controller -> camera (own thread) -> recorder (own thread) -> journal on
//   disk
//   -> pipeline (own thread, lowest priority), which reads the journal like any other tool would.
// Ends in one of three ways:
//   SIGTERM, SIGINT   triggers stop, frames on their way are journaled, the pipeline finishes the
//   step it
//                     is in; the session stays open and the next start goes on with it
//                     (session_choice.h)
//   stop              the session is ended first: all views are finished
//   finish, or the end of the trigger series: the session is ended, the daemon keeps serving
class App final : public ApiBackend {
 public:
  // `read_config` reads the configuration again for a reload; empty = there is nothing to read.
  App(DaemonConfig config, SessionChoice choice, MakeParts make_parts, ReadConfig read_config = {});
  ~App() override;

  // Runs until the daemon is told to stop. An error decides the exit code. BlockSignals() must have
  // been called before any thread was made.
  Status Run();

  Result<StatusReport> GetStatus() override;
  ApiReply Arm() override;
  ApiReply Disarm() override;
  ApiReply Trigger() override;
  ApiReply Finish() override;
  ApiReply Stop(bool leave_session_open) override;
  ApiReply Reload() override;

 private:
  // A session that is open for writing.
  struct Session {
    explicit Session(SessionWriter writer) : store(std::move(writer)) {}
    SessionFrameStore store;  // the recorder's thread, once that runs
    std::filesystem::path directory;
    SessionInfo info;
    bool resumed = false;
    std::uint64_t first_frame = 0;  // its frames are counted from here
    SessionExtent extent;           // the recorder's thread, once that runs
    // The number of the next trigger: frames are counted through a series of sessions.
    std::uint64_t next_frame() const { return std::max(first_frame, store.writer().next_frame()); }
  };
  // The series of sessions as the recorder sees it: goes on with the next one when it is time.
  class SeriesStore final : public FrameStore {
   public:
    explicit SeriesStore(App& app) : app_(app) {}
    Status Append(const FrameRecord& record, std::span<const std::byte> file_bytes) override;
    std::uint64_t lines() const override;

   private:
    App& app_;
  };
  enum class StorageProblem { kFrames, kSync, kLimit };
  enum class Phase {
    kRunning,
    kEnding,    // no more triggers; the views are being finished
    kEnded,     // the session is complete
    kStopping,  // waiting for frames on their way, then leaving
  };

  // Startup, main thread.
  Status ResumeSession();
  Status MakeController();
  Status StartLoop();
  void StartStages();
  void StartSessionStages();
  Status TearDown();

  // Camera thread.
  Status RunCamera(std::stop_token stop, Stage& self);
  Status OnCameraOpened(const CameraInfo& info);
  void OnCameraAway(const Error& error);
  void TellPlan();  // to the camera: the exposures that are to come
  void TellNotes();
  void PrepareNext();
  // Recorder thread.
  Status RunRecorder(std::stop_token stop, Stage& self);
  void OnJournaled(const FrameRecord& record);
  // Pipeline thread.
  Status RunPipeline(std::stop_token stop, Stage& self);
  Status FinishViews(SessionProcessor* processor, const std::filesystem::path& session);
  void CloseViews(const SessionProcessor* processor);
  void OnViewDone(const ViewDone& view);
  void OnQualityChanged(int level, int backlog);
  void OnOrientation(const OrientationState& found);  // orientation watch's thread
  void SetArmed(bool armed);                          // main loop
  void SetViewsError(const std::string& error);
  // Until there is more than `known` lines, or the views are to be finished.
  void WaitForJournal(std::stop_token stop, Nanoseconds timeout, std::uint64_t known);

  // Main loop.
  void OnSignal(int signal);
  void OnHangup();
  void OnTriggersReady();
  void TakeStanding();
  // Metering (app_meter.cc).
  void WantMeter();                                           // main loop, when armed
  void MeterIfDue(const std::stop_token& stop, Stage& self);  // camera thread
  Result<nlohmann::json> Meter(const std::stop_token& stop, Stage& self);
  Result<bool> AdoptBracket(const std::vector<ExposureTime>& exposures, nlohmann::json& report);
  void EndMeter(nlohmann::json report);
  // What the configuration asks for, or the look at the scene has put in its place.
  BracketOptions WantedBracket(const BracketConfig& bracket) const;
  BracketDescription DescribePlan(const BracketPlan& plan) const;
  Result<AcceptedTrigger> HandleTrigger(const TriggerEvent& event);
  void StartSource();
  void DrainSource();
  void StopSource();
  void DisarmBecause(const Error& error);
  void CheckSeriesEnd();
  void EndSession(const std::string& reason, bool exit_after);
  void StopNow(const std::string& reason);
  void CheckDrained();
  bool Drained() const;
  void Supervise();
  void OnSessionEnded();
  void OnStateChanged(const StateReport& report);
  void ScheduleCaptureTimer();
  void CheckFrameless();
  StatusReport BuildStatus() const;
  ApiReply OnLoop(std::function<ApiReply()> function);
  ApiReply ArmNow();
  ApiReply DisarmNow();
  ApiReply TriggerNow();
  // From outside, for field buses; any thread but the loop's.
  Status Command(ApplianceCommand command);

  // Reload (app_reload.cc); main loop.
  ApiReply ApplyConfig(const Result<DaemonConfig>& next);
  ApiReply RefuseConfig(const Error& error);
  Status ChangeBracket(const BracketConfig& bracket);

  // Storage (app_storage.cc); recorder thread, where nothing else is said.
  void WatchStorage();
  void ReadStorage(const std::filesystem::path& directory);
  void SetStorageProblem(StorageProblem which, const std::string& problem);
  Status SyncIfDue(bool at_once);
  std::pair<Durability, Nanoseconds> durability() const;  // any thread
  void RotateIfDue(const FrameRecord& record);
  Status BeginNextSession(Session& current, FrameId first, const std::string& why);
  Status RunRetention(std::stop_token stop, Stage& self);  // retention thread
  void ApplyRetention(const std::stop_token& stop);        // retention thread

  // The vehicle (app_vehicle.cc).
  Status StartLinks();
  void StopLinks();
  void CheckLinks();  // main loop
  void ShowSoon();    // any thread
  void ShowStatus();  // main loop
  Status CommandCamera(const ExposureRequest& request);

  std::shared_ptr<Session> session() const;
  void PostOrLog(EventLoop::Callback message);

  // Written by the main loop, in a reload: only what a reload changes, and that under mutex_. Other
  // threads take mutex_ to read it; what a reload does not change needs none.
  DaemonConfig config_;
  const SessionChoice choice_;
  const MakeParts make_parts_;
  const ReadConfig read_config_;
  AppParts parts_;
  const SystemClock clock_;
  const SystemUtc utc_;
  const HostTime started_ = clock_.Now();
  ServiceNotifier notifier_;
  EventHub hub_;
  CaptureStateMachine state_;
  std::unique_ptr<EventLoop> loop_;

  mutable std::mutex mutex_;  // of what follows, up to the blank line
  std::shared_ptr<Session> session_;
  std::string camera_model_;
  std::string camera_serial_;
  std::optional<CameraAbilities> camera_abilities_;
  OutcomeCounts lines_;
  std::uint64_t journaled_ = 0;
  std::uint64_t durable_bytes_ = 0;  // of the journal
  std::uint64_t positions_with_pixels_ = 0;
  std::int64_t last_position_with_pixels_ = -1;
  SessionProcessor::Counts views_;         // of the session whose views are being made
  SessionProcessor::Counts views_before_;  // of those finished before it
  bool views_caught_up_ = false;
  std::optional<std::int64_t> last_view_;
  std::string views_error_;
  bool finish_views_ = false;
  std::condition_variable_any journal_grew_;
  StorageGuard storage_guard_;
  StorageReport storage_report_;
  // Sessions whose views are to be finished, the one that is written last.
  std::deque<std::filesystem::path> views_queue_;
  std::uint64_t rotations_ = 0;
  std::optional<SessionInfo> camera_session_;  // what a session of the open camera is begun with
  std::vector<std::string> bracket_changes_;
  std::optional<std::vector<ExposureTime>> metered_;  // the bracket that was adopted
  nlohmann::json metering_report_;                    // of the last look, null before it

  // Held while a bracket is checked against the camera and put in force.
  std::mutex plan_mutex_;
  ExposureLimits exposure_limits_;
  std::mutex reload_mutex_;  // held by whoever reloads
  std::atomic<bool> reload_again_ = false;

  // Loop thread.
  std::uint64_t reloads_ = 0;
  std::uint64_t reloads_refused_ = 0;
  std::string reload_error_;                 // why the last one was refused
  std::vector<std::string> restart_needed_;  // keys of the file that are not in force
  Phase phase_ = Phase::kRunning;
  bool exit_after_end_ = false;
  bool ended_ = false;
  bool armed_ = false;
  bool source_running_ = false;
  int watched_fd_ = -1;
  std::uint64_t ignored_triggers_ = 0;
  HostTime last_trigger_;
  std::optional<TriggerEvent> standing_;  // waits for the camera
  std::string end_reason_;
  HostTime stop_deadline_;
  Status outcome_;
  EventLoop::Timer* trigger_timer_ = nullptr;
  EventLoop::Timer* capture_timer_ = nullptr;
  EventLoop::Timer* drain_timer_ = nullptr;
  EventLoop::Timer* supervise_timer_ = nullptr;
  Supervisor supervisor_;
  FloodGate stall_log_;
  std::string stalled_;  // the fault that a stage which stood still is
  Nanoseconds supervise_interval_ = std::chrono::seconds(1);
  std::atomic<bool> stopping_ = false;
  std::optional<double> last_odometer_m_;  // of the session that is continued
  std::uint64_t last_retakes_ = 0;         // likewise
  std::uint64_t rearmed_ = 0;
  std::uint64_t clock_jumps_ = 0;  // as last logged
  std::string last_fault_;
  struct LinkLog {
    std::string problem;  // as last logged
    FloodGate gate;
  };
  std::map<std::string, LinkLog, std::less<>> link_logs_;
  std::atomic<bool> shows_ = false;  // there are outputs, and they are not ended yet
  std::atomic<bool> show_wanted_ = false;
  // Recorder thread.
  HostTime storage_watched_;
  std::array<std::string, 3> storage_problems_;
  HostTime unsynced_since_;
  HostTime rotation_retry_;
  // Any thread. A look is wanted; one is being taken, or about to be: nothing else is commanded.
  std::atomic<bool> meter_due_ = false;
  std::atomic<bool> metering_ = false;
  std::atomic<std::uint64_t> commanded_ = 0;  // exposures of triggers
  std::optional<CameraInfo> metered_camera_;  // camera thread: the one that is open
  // Any thread.
  std::atomic<std::uint64_t> unsynced_ = 0;
  std::atomic<std::uint64_t> storage_errors_ = 0;
  std::atomic<std::uint64_t> deleted_ = 0;
  LatencyTracker latency_;
  std::atomic<bool> ending_ = false;  // no further session is begun
  FloodGate retention_log_;           // retention thread

  Recorder recorder_;
  FloodGate drop_log_;                             // recorder thread
  FloodGate storage_log_;                          // recorder thread
  std::unique_ptr<CaptureController> controller_;  // from before the stages until after them
  std::unique_ptr<CameraRunner> runner_;
  std::unique_ptr<ApiServer> api_;
  std::unique_ptr<Stage> pipeline_stage_;
  std::unique_ptr<Stage> recorder_stage_;
  std::unique_ptr<Stage> camera_stage_;
  std::unique_ptr<Stage> reload_stage_;
  std::unique_ptr<Stage> retention_stage_;
  std::unique_ptr<OrientationWatch> orientation_;  // from before the stages until after them
};

}  // namespace omnihdr
