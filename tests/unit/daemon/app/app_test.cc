#include "daemon/app.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>

#include <condition_variable>
#include <deque>
#include <filesystem>
#include <fstream>
#include <map>
#include <thread>

#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "daemon/logging.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::app_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::HasSubstr;

// Answers every request with a tiny frame, or does not, as the test says. Any thread.
class FakeCamera final : public Camera {
 public:
  Result<CameraInfo> Open() override {
    std::lock_guard lock(mutex_);
    if (!present_) return Fail(ErrorKind::kUnavailable, "no such device");
    CameraInfo info;
    info.description.model = "fake";
    info.description.width = 128;
    info.description.height = 64;
    info.shortest = ExposureTime::Seconds(1e-6);
    info.longest = longest_;
    info.proof = ExposureProof::kEmbedded;
    return info;
  }
  void Close() override {}
  Status Start() override { return {}; }
  void Stop() override {}
  Status Trigger(const ExposureRequest& request) override {
    {
      std::lock_guard lock(mutex_);
      if (!present_) return Fail(ErrorKind::kUnavailable, "unplugged");
      requests_.push_back(request);
    }
    changed_.notify_all();
    return {};
  }
  Result<CameraFrame> Receive(Nanoseconds timeout) override {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout,
                      [this] { return !present_ || (answering_ && !requests_.empty()); });
    if (!present_) {
      requests_.clear();
      return Fail(ErrorKind::kUnavailable, "unplugged");
    }
    if (!answering_ || requests_.empty()) return Fail(ErrorKind::kTemporary, "nothing yet");
    const ExposureRequest request = requests_.front();
    requests_.pop_front();
    CameraFrame frame;
    frame.trigger = request.trigger;
    frame.camera_counter = Value(request.trigger);
    frame.measured_exposure = request.exposure;
    frame.proof = ExposureProof::kEmbedded;
    frame.mid_exposure = request.trigger_time + milliseconds(1);
    frame.pixels = Image<std::uint8_t>(128, 64, 3, 100);
    return frame;
  }

  void SetPresent(bool present) {
    {
      std::lock_guard lock(mutex_);
      present_ = present;
    }
    changed_.notify_all();
  }
  void SetAnswering(bool answering) {
    {
      std::lock_guard lock(mutex_);
      answering_ = answering;
    }
    changed_.notify_all();
  }
  void SetLongest(ExposureTime longest) { longest_ = longest; }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<ExposureRequest> requests_;
  bool present_ = true;
  bool answering_ = true;
  ExposureTime longest_ = ExposureTime::Seconds(10);
};

// Never triggers by itself.
class SilentSource final : public TriggerSource {
 public:
  std::string_view kind() const override { return "silent"; }
  Status Start() override { return {}; }
  void Stop() override {}
  Result<std::optional<TriggerEvent>> Poll() override { return std::nullopt; }
};

// Triggers as a test says.
class ToldSource final : public TriggerSource {
 public:
  std::string_view kind() const override { return "told"; }
  Status Start() override { return {}; }
  void Stop() override {}
  Result<std::optional<TriggerEvent>> Poll() override {
    std::lock_guard lock(mutex_);
    if (events_.empty()) return std::nullopt;
    TriggerEvent event = events_.front();
    events_.pop_front();
    return event;
  }
  std::optional<HostTime> NextDeadline() const override {
    return SystemClock().Now() + milliseconds(5);
  }
  void Tell(TriggerEvent event) {
    std::lock_guard lock(mutex_);
    events_.push_back(std::move(event));
  }

 private:
  std::mutex mutex_;
  std::deque<TriggerEvent> events_;
};

// A vehicle's connection, its lamps and its strobe in one.
class FakeVehicle final : public VehicleLink,
                          public StatusOutput,
                          public StrobeOutput,
                          public PlaceSource {
 public:
  std::string_view name() const override { return "fake vehicle"; }
  Status Start() override {
    started = true;
    return {};
  }
  LinkReport report() const override {
    std::lock_guard lock(mutex_);
    return report_;
  }
  void Report(bool up, const std::string& problem) {
    std::lock_guard lock(mutex_);
    report_.up = up;
    report_.problem = problem;
    report_.opened = 1;
  }
  void Show(const ApplianceStatus& status) override {
    std::lock_guard lock(mutex_);
    shown_ = status;
  }
  ApplianceStatus shown() const {
    std::lock_guard lock(mutex_);
    return shown_;
  }
  Status Pulse() override {
    ++pulses;
    return Fail(ErrorKind::kUnavailable, "the line has gone");
  }
  std::optional<GnssFix> Fix(HostTime) const override {
    GnssFix fix;
    fix.lat_deg = 52.5;
    fix.fix = 4;
    return fix;
  }
  std::optional<double> HeadingDeg(HostTime) const override { return 12.5; }

  std::atomic<bool> started = false;
  std::atomic<int> pulses = 0;

 private:
  mutable std::mutex mutex_;
  LinkReport report_;
  ApplianceStatus shown_;
};

// Writes no pictures, but keeps the law: a view is complete two positions later, or at Finish.
class FakeProcessor final : public SessionProcessor {
 public:
  FakeProcessor(const std::filesystem::path& session, std::atomic<bool>& failing)
      : follower_(session), failing_(failing) {}
  Result<Progress> Step() override {
    if (failing_) return Fail(ErrorKind::kIo, "views: No space left on device");
    OMNIHDR_ASSIGN(const std::vector<FrameRecord> records, follower_.ReadNew());
    for (const FrameRecord& record : records) {
      if (record.status == FrameStatus::kOk) {
        ++counts_.positions_seen;
      } else {
        ++counts_.positions_without_pixels;
      }
    }
    counts_.views_complete = std::max(counts_.views_complete, counts_.positions_seen - 2);
    return records.empty() ? Progress::kNothingNew : Progress::kWorked;
  }
  Status Finish() override {
    counts_.views_complete = counts_.positions_seen;
    return {};
  }
  Counts counts() const override { return counts_; }

 private:
  JournalFollower follower_;
  std::atomic<bool>& failing_;
  Counts counts_;
};

class AppTest : public ::testing::Test {
 protected:
  AppTest() {
    InitLogging(LogLevel::kError);
    config_.session.directory = directory_.path().string();
    config_.session.name = "s";
    config_.api.socket = (directory_.path() / "api.sock").string();
    config_.camera.frame_timeout_s = 0.2;
    config_.camera.reconnect_s = 0.1;
    config_.trigger.armed_at_start = true;
  }
  ~AppTest() override { EXPECT_TRUE(Join(true)); }

  std::filesystem::path session() const { return directory_.path() / "s"; }

  void Start() {
    auto choice = ChooseSession(config_.session, "", SystemClock().NowUtc());
    ASSERT_TRUE(choice);
    app_ = std::make_unique<App>(
        config_, *choice, [this](const PartsContext& context) -> Result<AppParts> {
          first_trigger_ = context.first_trigger;
          last_odometer_m_ = context.last_odometer_m;
          command_ = context.command;
          AppParts parts;
          parts.camera = camera_;
          parts.triggers = triggers_;
          if (vehicle_) {
            parts.links.push_back(vehicle_);
            parts.outputs.push_back(vehicle_);
            parts.strobe = vehicle_;
            parts.place = vehicle_;
          }
          parts.open_pipeline = [this](const std::filesystem::path& session, ProcessorCallbacks) {
            return Result<std::unique_ptr<SessionProcessor>>(
                std::make_unique<FakeProcessor>(session, views_fail_));
          };
          return parts;
        });
    thread_ = std::thread([this] {
      // As main does it: the signals are read by the loop alone.
      EXPECT_TRUE(BlockSignals());
      outcome_ = app_->Run();
    });
    ASSERT_TRUE(Eventually([&] { return static_cast<bool>(Client().Get("/v1/status")); }));
  }
  // Leaves the session open, as SIGTERM does.
  Status Join(bool stop) {
    if (!thread_.joinable()) return {};
    if (stop) {
      EXPECT_TRUE(Eventually([&] {
        const auto stopped = Client().Post("/v1/stop", {{"leave_open", true}});
        return stopped || stopped.error().kind == ErrorKind::kUnavailable;
      }));
    }
    thread_.join();
    app_.reset();
    return outcome_;
  }
  ApiClient Client() const { return ApiClient(config_.api.socket); }
  static bool Eventually(const std::function<bool()>& holds) {
    for (int i = 0; i < 1500; ++i) {
      if (holds()) return true;
      std::this_thread::sleep_for(milliseconds(10));
    }
    return false;
  }
  bool StatusHolds(const std::function<bool(const nlohmann::json&)>& holds) const {
    return Eventually([&] {
      const auto status = Client().Get("/v1/status");
      return status && holds(*status);
    });
  }
  ::testing::AssertionResult InState(const std::string& state) const {
    std::string found;
    const bool reached = StatusHolds([&](const auto& s) {
      found =
          s["state"].template get<std::string>() + ": " + s["reason"].template get<std::string>();
      return s["state"] == state;
    });
    return reached ? ::testing::AssertionSuccess() : ::testing::AssertionFailure() << found;
  }
  void Trigger(int times = 1) {
    for (int i = 0; i < times; ++i) {
      EXPECT_TRUE(Eventually([&] { return static_cast<bool>(Client().Post("/v1/trigger")); }));
    }
  }

  testing::TemporaryDirectory directory_;
  DaemonConfig config_;
  std::shared_ptr<FakeCamera> camera_ = std::make_shared<FakeCamera>();
  std::atomic<bool> views_fail_ = false;
  std::uint64_t first_trigger_ = 0;
  std::optional<double> last_odometer_m_;
  CommandHandler command_;
  std::shared_ptr<TriggerSource> triggers_ = std::make_shared<SilentSource>();
  std::shared_ptr<FakeVehicle> vehicle_;
  std::unique_ptr<App> app_;
  std::thread thread_;
  Status outcome_;
};

TEST_F(AppTest, ALimitedSeriesEndsTheSessionAndTheDaemonServesOn) {
  config_.trigger.limit = 4;
  config_.recorder.queue_frames = 8;
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(4);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_EQ(status["state"], "idle");
  EXPECT_EQ(status["views"]["finished"], 4);
  EXPECT_EQ(status["views"]["backlog"], 0);
  EXPECT_TRUE(SessionEnded(session()));
  EXPECT_FALSE(Client().Post("/v1/trigger"));
}

TEST_F(AppTest, StoppingLeavesTheSessionOpenAndTheNextRunContinuesIt) {
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(2);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 2; }));
  EXPECT_TRUE(Join(true));
  EXPECT_FALSE(SessionEnded(session()));
  Start();
  EXPECT_EQ(first_trigger_, 2U);
  ASSERT_TRUE(InState("armed"));
  EXPECT_EQ(Client().Post("/v1/trigger").value()["step"], 2);
  ASSERT_TRUE(Client().Post("/v1/stop"));
  EXPECT_TRUE(Join(false));
  EXPECT_TRUE(SessionEnded(session()));
  EXPECT_EQ(ReadSession(session())->journal.frames.size(), 3U);
}

TEST_F(AppTest, AStopWaitsForFramesOnTheirWay) {
  camera_->SetAnswering(false);
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(2);
  ASSERT_TRUE(Client().Post("/v1/stop", {{"leave_open", true}}));
  EXPECT_TRUE(Join(false));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 2U);
  EXPECT_EQ(frames[0].status, FrameStatus::kCameraTimeout);
  EXPECT_EQ(frames[1].status, FrameStatus::kCameraTimeout);
}

TEST_F(AppTest, AnUnpluggedCameraIsAStateAndComesBack) {
  Start();
  ASSERT_TRUE(InState("armed"));
  camera_->SetAnswering(false);
  Trigger();
  camera_->SetPresent(false);
  ASSERT_TRUE(InState("waiting-for-camera"));
  // The vehicle drives on: what it passes is accounted for.
  Trigger();
  camera_->SetAnswering(true);
  camera_->SetPresent(true);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 3U);
  EXPECT_EQ(frames[0].status, FrameStatus::kCameraTimeout);
  EXPECT_THAT(frames[0].detail, HasSubstr("unplugged"));
  EXPECT_EQ(frames[1].status, FrameStatus::kMissedTrigger);
  EXPECT_THAT(frames[1].detail, HasSubstr("no camera"));
  EXPECT_EQ(frames[2].status, FrameStatus::kOk);
}

TEST_F(AppTest, ViewsThatCannotBeWrittenAreSaidAndTriedAgain) {
  views_fail_ = true;
  Start();
  ASSERT_TRUE(InState("degraded"));
  Trigger(3);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 3; }));
  EXPECT_THAT(Client().Get("/v1/status").value()["reason"].get<std::string>(),
              HasSubstr("No space left on device"));
  views_fail_ = false;
  ASSERT_TRUE(InState("armed"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["views"]["finished"] == 1; }));
}

TEST_F(AppTest, ABracketTheCameraCannotTakeIsAFaultWithItsReason) {
  camera_->SetLongest(ExposureTime::Seconds(0.002));
  Start();
  ASSERT_TRUE(InState("fault"));
  EXPECT_THAT(Client().Get("/v1/status").value()["reason"].get<std::string>(),
              HasSubstr("the camera's longest is 0.002 s"));
}

TEST_F(AppTest, FinishEndsTheSessionAndKeepsServing) {
  Start();
  EXPECT_TRUE(InState("armed"));
  Trigger(3);
  EXPECT_TRUE(Client().Post("/v1/finish"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }));
  EXPECT_EQ(Client().Get("/v1/status").value()["views"]["finished"], 3);
  ASSERT_TRUE(Client().Post("/v1/stop"));
  EXPECT_TRUE(Join(false));
}

TEST_F(AppTest, TheEventsTellTheWholeStory) {
  config_.trigger.armed_at_start = false;
  Start();
  std::vector<std::string> kinds;
  std::thread listener([&] {
    EXPECT_TRUE(Client().Events([&](const std::string& line) {
      const nlohmann::json event = nlohmann::json::parse(line);
      if (event["event"] == "status") {
        EXPECT_TRUE(Client().Post("/v1/arm"));
        Trigger();
        EXPECT_TRUE(
            Eventually([&] { return Client().Get("/v1/status").value()["frames_recorded"] == 1; }));
        EXPECT_TRUE(Client().Post("/v1/stop"));
      }
      kinds.push_back(event["event"]);
      return true;
    }));
  });
  listener.join();
  EXPECT_TRUE(Join(false));
  for (const char* kind : {"status", "trigger", "frame", "state", "session"}) {
    EXPECT_NE(std::find(kinds.begin(), kinds.end(), kind), kinds.end()) << kind;
  }
}

TEST_F(AppTest, ViewsAreMadeAtTheLowestPriorityAndCaptureIsNot) {
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  std::map<std::string, std::pair<int, int>> threads;  // name: nice value, policy
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string name;
    std::getline(std::ifstream(task.path() / "comm"), name);
    const int id = std::stoi(task.path().filename().string());
    threads[name] = {::getpriority(PRIO_PROCESS, static_cast<id_t>(id)), ::sched_getscheduler(id)};
  }
  const int usual = ::getpriority(PRIO_PROCESS, 0);
  ASSERT_TRUE(threads.contains("pipeline") && threads.contains("camera") &&
              threads.contains("recorder"));
  EXPECT_EQ(threads["pipeline"], (std::pair{19, SCHED_BATCH}));
  EXPECT_EQ(threads["camera"], (std::pair{usual, SCHED_OTHER}));
  EXPECT_EQ(threads["recorder"], (std::pair{usual, SCHED_OTHER}));
}

TEST_F(AppTest, LampsAndFieldBusShowWhatTheApplianceDoes) {
  vehicle_ = std::make_shared<FakeVehicle>();
  vehicle_->Report(true, "");
  Start();
  EXPECT_TRUE(vehicle_->started);
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().state == CaptureState::kArmed; }));
  EXPECT_TRUE(vehicle_->shown().armed);
  EXPECT_TRUE(vehicle_->shown().gnss_fix);
  camera_->SetAnswering(false);
  Trigger();
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().busy; }));
  EXPECT_EQ(vehicle_->pulses, 1) << "a pulse with every picture that is commanded";
  ASSERT_TRUE(Eventually([&] { return !vehicle_->shown().busy; }));
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().frames_lost == 1; }));
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().state == CaptureState::kDegraded; }));
  EXPECT_THAT(vehicle_->shown().last_fault, HasSubstr("camera-timeout"));
  camera_->SetAnswering(true);
  Trigger();
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().frames_recorded == 1; }));
  EXPECT_TRUE(Join(true));
  EXPECT_EQ(vehicle_->shown().state, CaptureState::kStopping);
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 2U);
  for (const FrameRecord& frame : frames) {
    EXPECT_EQ(frame.gnss->lat_deg, 52.5);
    EXPECT_EQ(frame.gnss->fix, 4);
    EXPECT_EQ(frame.heading_deg, 12.5);
  }
}

TEST_F(AppTest, AConnectionThatIsMissingDegradesAndIsToldUntilItWorksAgain) {
  vehicle_ = std::make_shared<FakeVehicle>();
  vehicle_->Report(false, "no answer");
  Start();
  ASSERT_TRUE(InState("degraded"));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_THAT(status["reason"].get<std::string>(), HasSubstr("fake vehicle: no answer"));
  EXPECT_EQ(status["links"][0]["up"], false);
  vehicle_->Report(true, "");
  ASSERT_TRUE(InState("armed"));
}

TEST_F(AppTest, AFieldBusArmsDisarmsAndTriggersAndHearsWhyNot) {
  config_.trigger.armed_at_start = false;
  vehicle_ = std::make_shared<FakeVehicle>();
  Start();
  ASSERT_TRUE(InState("idle"));
  const Status refused = command_(ApplianceCommand::kTrigger);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("disarmed: arm first"));
  EXPECT_TRUE(command_(ApplianceCommand::kArm));
  EXPECT_TRUE(command_(ApplianceCommand::kTrigger));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(command_(ApplianceCommand::kDisarm));
  EXPECT_FALSE(command_(ApplianceCommand::kTrigger));
}

TEST_F(AppTest, TriggersLostInTheKernelAreJournalLinesWithTheirReason) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  Start();
  ASSERT_TRUE(InState("armed"));
  TriggerEvent event;
  event.time = SystemClock().Now();
  event.odometer_m = 12.5;
  event.lost_before = 2;
  event.lost_reason = "the kernel lost this edge of the trigger line: its buffer was full";
  source->Tell(event);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 3U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(frames[i].status, FrameStatus::kMissedTrigger);
    EXPECT_EQ(frames[i].detail, event.lost_reason);
  }
  EXPECT_EQ(frames[2].status, FrameStatus::kOk);
  EXPECT_EQ(frames[2].odometer_m, 12.5);
  Start();
  EXPECT_EQ(last_odometer_m_, 12.5) << "a continued session goes on from its last place";
}

TEST_F(AppTest, ManyClientsAtOnceAreServed) {
  Start();
  ASSERT_TRUE(InState("armed"));
  std::vector<std::thread> clients;
  std::atomic<int> accepted = 0;
  for (int c = 0; c < 6; ++c) {
    clients.emplace_back([&] {
      for (int i = 0; i < 20; ++i) {
        if (Client().Post("/v1/trigger")) ++accepted;
        EXPECT_TRUE(Client().Get("/v1/status"));
      }
    });
  }
  for (std::thread& client : clients) client.join();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), static_cast<std::size_t>(accepted.load()));
  for (std::size_t i = 0; i < frames.size(); ++i) EXPECT_EQ(Value(frames[i].frame), i);
}

}  // namespace
}  // namespace omnihdr::app_test
