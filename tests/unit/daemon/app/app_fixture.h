#pragma once

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "daemon/app.h"
#include "daemon/logging.h"
#include "tests/support/temporary_directory.h"

// The daemon in this process, put together from doubles.
namespace omnihdr::testing_app {

using std::chrono::milliseconds;
using std::chrono::seconds;

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
    while (stuck) std::this_thread::sleep_for(milliseconds(5));
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
  std::vector<CameraCounter> Counters() const override { return {{"stale_frames", 3}}; }

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

  std::atomic<bool> stuck = false;  // as in a call of a driver that does not come back

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
  LostEvents TakeLost() override {
    std::lock_guard lock(mutex_);
    return std::exchange(lost_, {});
  }
  void Tell(TriggerEvent event) {
    std::lock_guard lock(mutex_);
    events_.push_back(std::move(event));
  }
  void Tell(int times) {
    std::lock_guard lock(mutex_);
    for (int i = 0; i < times; ++i) events_.emplace_back().time = SystemClock().Now();
  }
  void Lose(std::uint64_t count, const std::string& reason) {
    std::lock_guard lock(mutex_);
    lost_ = {count, reason};
  }

 private:
  std::mutex mutex_;
  std::deque<TriggerEvent> events_;
  LostEvents lost_;
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
    while (stuck) std::this_thread::sleep_for(milliseconds(5));
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
  std::atomic<bool> stuck = false;

 private:
  mutable std::mutex mutex_;
  LinkReport report_;
  ApplianceStatus shown_;
};

// Writes no pictures, but keeps the law: a view is complete two positions later, or at Finish.
class FakeProcessor final : public SessionProcessor {
 public:
  FakeProcessor(const std::filesystem::path& session, std::atomic<bool>& failing,
                std::atomic<bool>& stuck, ProcessorCallbacks callbacks)
      : follower_(session), failing_(failing), stuck_(stuck), callbacks_(std::move(callbacks)) {}
  Result<Progress> Step() override {
    while (stuck_) std::this_thread::sleep_for(milliseconds(5));
    if (failing_) return Fail(ErrorKind::kIo, "views: No space left on device");
    OMNIHDR_ASSIGN(const std::vector<FrameRecord> records, follower_.ReadNew());
    for (const FrameRecord& record : records) {
      if (record.status == FrameStatus::kOk) {
        ++counts_.positions_seen;
        ViewDone view;
        view.position = record.position;
        if (callbacks_.view_done) callbacks_.view_done(view);
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
  std::atomic<bool>& stuck_;
  const ProcessorCallbacks callbacks_;
  Counts counts_;
};

class AppFixture : public ::testing::Test {
 protected:
  AppFixture() {
    InitLogging(LogLevel::kError);
    config_.session.directory = directory_.path().string();
    config_.session.name = "s";
    config_.api.socket = (directory_.path() / "api.sock").string();
    config_.camera.frame_timeout_s = 0.2;
    config_.camera.reconnect_s = 0.1;
    config_.trigger.armed_at_start = true;
    config_.storage.allow_root = true;
    // Whoever else fills this machine's disk must not change the state.
    config_.storage.limits = {0.0, 0.0, 0.0, 0.0};
  }
  ~AppFixture() override { EXPECT_TRUE(Join(true)); }

  std::filesystem::path session() const { return directory_.path() / "s"; }

  void Start() {
    auto choice = ChooseSession(config_.session, "", SystemClock().NowUtc());
    ASSERT_TRUE(choice);
    app_ = std::make_unique<App>(
        config_, *choice,
        [this](const PartsContext& context) -> Result<AppParts> {
          first_trigger_ = context.first_trigger;
          last_odometer_m_ = context.last_odometer_m;
          command_ = context.command;
          AppParts parts;
          parts.camera = other_camera_;
          if (!parts.camera) parts.camera = camera_;
          parts.triggers = triggers_;
          if (vehicle_) {
            parts.links.push_back(vehicle_);
            parts.outputs.push_back(vehicle_);
            parts.strobe = vehicle_;
            parts.place = vehicle_;
          }
          parts.open_pipeline = [this](const std::filesystem::path& session,
                                       ProcessorCallbacks callbacks) {
            return Result<std::unique_ptr<SessionProcessor>>(std::make_unique<FakeProcessor>(
                session, views_fail_, views_stuck_, std::move(callbacks)));
          };
          parts.patience = patience_;
          return parts;
        },
        read_config_);
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
  // A minute: views run at the lowest priority, which on a busy machine can be next to nothing.
  static bool Eventually(const std::function<bool()>& holds) {
    for (int i = 0; i < 6000; ++i) {
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
  std::shared_ptr<Camera> other_camera_;  // instead of that
  std::atomic<bool> views_fail_ = false;
  std::atomic<bool> views_stuck_ = false;
  StagePatience patience_;
  std::uint64_t first_trigger_ = 0;
  std::optional<double> last_odometer_m_;
  CommandHandler command_;
  ReadConfig read_config_;
  std::shared_ptr<TriggerSource> triggers_ = std::make_shared<SilentSource>();
  std::shared_ptr<FakeVehicle> vehicle_;
  std::unique_ptr<App> app_;
  std::thread thread_;
  Status outcome_;
};

}  // namespace omnihdr::testing_app
