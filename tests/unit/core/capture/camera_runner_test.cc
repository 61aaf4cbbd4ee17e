#include "core/capture/camera_runner.h"

#include <gtest/gtest.h>

#include "tests/unit/core/capture/simulated.h"

namespace omnihdr::camera_runner_test {
namespace {

using std::chrono::milliseconds;
using testing_capture::FrameFor;
using testing_capture::SimulatedClock;

// Does what the test tells it, and checks that it is used as the port says.
class ScriptedCamera final : public Camera {
 public:
  Result<CameraInfo> Open() override {
    EXPECT_FALSE(open);
    ++opens;
    if (!present) return Fail(ErrorKind::kUnavailable, "no such device");
    open = true;
    CameraInfo info;
    return info;
  }
  void Close() override {
    open = false;
    ++closes;
  }
  Status Start() override {
    if (!start_error.empty()) return Fail(ErrorKind::kUnavailable, "{}", start_error);
    started = true;
    return {};
  }
  void Stop() override { started = false; }
  Status Trigger(const ExposureRequest& request) override {
    EXPECT_TRUE(started);
    commanded.push_back(request);
    return {};
  }
  Result<CameraFrame> Receive(Nanoseconds) override {
    EXPECT_TRUE(started);
    if (!present) return Fail(ErrorKind::kUnavailable, "unplugged");
    if (frames.empty()) return Fail(ErrorKind::kTemporary, "nothing yet");
    CameraFrame frame = std::move(frames.front());
    frames.pop_front();
    return frame;
  }

  bool present = true;
  bool open = false;
  bool started = false;
  std::string start_error;
  int opens = 0;
  int closes = 0;
  std::vector<ExposureRequest> commanded;
  std::deque<CameraFrame> frames;
};

struct Bench {
  Bench()
      : runner(camera, {},
               CameraRunnerEvents{
                   .opened = [this](const CameraInfo&) -> Status {
                     if (!opened_error.empty()) {
                       return Fail(ErrorKind::kUnavailable, "{}", opened_error);
                     }
                     return {};
                   },
                   .started = [this] { ++started; },
                   .frame = [this](CameraFrame frame) { frames.push_back(std::move(frame)); },
                   .away = [this](const Error& error) { away.push_back(error.message); }},
               clock) {}
  SimulatedClock clock;
  ScriptedCamera camera;
  std::string opened_error;
  int started = 0;
  std::vector<CameraFrame> frames;
  std::vector<std::string> away;
  CameraRunner runner;
};

TEST(CameraRunner, OpensStartsAndHandsFramesOn) {
  Bench bench;
  EXPECT_FALSE(bench.runner.Command({}));
  EXPECT_EQ(bench.runner.Turn().count(), 0);
  EXPECT_TRUE(bench.runner.running());
  EXPECT_EQ(bench.started, 1);
  ExposureRequest request;
  request.trigger = TriggerId{3};
  ASSERT_TRUE(bench.runner.Command(request));
  bench.camera.frames.push_back(FrameFor(bench.camera.commanded[0]));
  bench.runner.Turn();
  bench.runner.Turn();
  ASSERT_EQ(bench.frames.size(), 1U);
  EXPECT_EQ(Value(bench.frames[0].trigger), 3U);
}

TEST(CameraRunner, AnAbsentCameraIsLookedForWithGrowingPatienceForEver) {
  Bench bench;
  bench.camera.present = false;
  std::vector<std::int64_t> rests_ms;
  for (int i = 0; i < 8; ++i) {
    const Nanoseconds rest = bench.runner.Turn();
    rests_ms.push_back(rest.count() / 1'000'000);
    bench.clock.Advance(rest);
  }
  EXPECT_EQ(rests_ms, (std::vector<std::int64_t>{250, 500, 1000, 2000, 4000, 5000, 5000, 5000}));
  EXPECT_EQ(bench.camera.opens, 8);
  EXPECT_EQ(bench.runner.Command({}).error().message, "no camera: no such device");
  bench.camera.present = true;
  bench.runner.Turn();
  EXPECT_TRUE(bench.runner.running());
}

TEST(CameraRunner, DoesNotAskAgainBeforeItsTime) {
  Bench bench;
  bench.camera.present = false;
  bench.runner.Turn();
  bench.clock.Advance(milliseconds(100));
  EXPECT_EQ(bench.runner.Turn(), milliseconds(150));
  EXPECT_EQ(bench.camera.opens, 1);
}

TEST(CameraRunner, AnUnpluggedCameraIsClosedAndOpenedAgain) {
  Bench bench;
  bench.runner.Turn();
  bench.camera.present = false;
  const Nanoseconds rest = bench.runner.Turn();
  EXPECT_FALSE(bench.runner.running());
  EXPECT_FALSE(bench.camera.open);
  EXPECT_EQ(bench.away, (std::vector<std::string>{"unplugged"}));
  bench.camera.present = true;
  bench.clock.Advance(rest);
  bench.runner.Turn();
  EXPECT_TRUE(bench.runner.running());
  EXPECT_EQ(bench.started, 2);
}

TEST(CameraRunner, ACameraThatGoesAtOnceEveryTimeIsAskedLessAndLess) {
  Bench bench;
  std::vector<std::int64_t> rests_ms;
  for (int i = 0; i < 3; ++i) {
    bench.camera.present = true;
    bench.runner.Turn();
    bench.camera.present = false;
    const Nanoseconds rest = bench.runner.Turn();
    rests_ms.push_back(rest.count() / 1'000'000);
    bench.clock.Advance(rest);
  }
  EXPECT_EQ(rests_ms, (std::vector<std::int64_t>{250, 500, 1000}));
}

TEST(CameraRunner, ARunningCameraCanBeOpenedAnewAtOnce) {
  Bench bench;
  EXPECT_FALSE(bench.runner.Rearm("not yet open"));
  bench.runner.Turn();
  EXPECT_TRUE(bench.runner.Rearm("no frames"));
  EXPECT_FALSE(bench.runner.Rearm("asked already"));
  bench.runner.Turn();
  EXPECT_EQ(bench.away, (std::vector<std::string>{"no frames"}));
  EXPECT_FALSE(bench.camera.open);
  bench.runner.Turn();
  EXPECT_TRUE(bench.runner.running());
  EXPECT_EQ(bench.camera.opens, 2);
  EXPECT_EQ(bench.started, 2);
}

TEST(CameraRunner, ACameraTheListenerRefusesIsClosedAgain) {
  Bench bench;
  bench.opened_error = "another camera";
  EXPECT_GT(bench.runner.Turn().count(), 0);
  EXPECT_FALSE(bench.camera.open);
  EXPECT_EQ(bench.away, (std::vector<std::string>{"another camera"}));
}

TEST(CameraRunner, ACameraThatDoesNotStartIsClosedAgain) {
  Bench bench;
  bench.camera.start_error = "no bandwidth";
  EXPECT_GT(bench.runner.Turn().count(), 0);
  EXPECT_FALSE(bench.camera.open);
  EXPECT_EQ(bench.started, 0);
}

TEST(CameraRunner, CloseEndsCommands) {
  Bench bench;
  bench.runner.Turn();
  bench.runner.Close();
  EXPECT_FALSE(bench.camera.open);
  EXPECT_EQ(bench.runner.Command({}).error().message, "no camera: the camera is closed");
}

}  // namespace
}  // namespace omnihdr::camera_runner_test
