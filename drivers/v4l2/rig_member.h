#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/stage.h"
#include "core/ports/camera.h"
#include "drivers/v4l2/v4l2_camera.h"

namespace omnihdr::v4l2 {

// Frames of a rig's members as they arrive, for the rig's worker. Thread-safe.
class RigInbox {
 public:
  static constexpr std::size_t kMost = 64;
  struct Arrival {
    std::size_t member = 0;
    CameraFrame frame;
  };
  void Put(std::size_t member, CameraFrame frame);
  // All there are; waits up to `timeout` for the first.
  std::vector<Arrival> TakeAll(Nanoseconds timeout);
  void Clear();

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Arrival> arrivals_;
};

// One camera of a rig, kept open: its frames go into the inbox; when it leaves, it is closed and
// looked for again, every `retry`, until it is back and what it was. Open, Start, Stop and Close
// from one thread, Trigger and state from any.
class RigMember {
 public:
  // `name`: for messages, such as "sensor 1 \"rear\" (usb-…)".
  RigMember(std::size_t number, std::string name, const V4l2CameraOptions& options,
            std::unique_ptr<V4l2System> system, Nanoseconds retry, RigInbox& inbox);
  ~RigMember() { Close(); }
  RigMember(const RigMember&) = delete;
  RigMember& operator=(const RigMember&) = delete;

  const std::string& name() const { return name_; }
  Result<CameraInfo> Open();
  void Close();
  // Of the open camera.
  const std::string& node() const { return camera_.node(); }
  HandoverLimits limits() const { return camera_.limits(); }
  // From here on a camera that returns must have this picture, and these exposures within its own.
  void Expect(const CameraInfo& info);
  // Streams, when the camera is there, and keeps an eye on it. An error: it is there and does not.
  Status Start();
  void Stop();

  // As Camera::Trigger; kUnavailable with the reason while the camera is away.
  Status Trigger(const ExposureRequest& request);
  // As Camera::Prepare; nothing while the camera is away.
  void Prepare(const Exposure& next);
  struct State {
    bool present = false;
    std::string why;         // it is away
    std::uint64_t life = 0;  // goes up each time it leaves or returns
    std::uint64_t departures = 0;
    std::uint64_t returns = 0;
  };
  State state() const;
  std::vector<CameraCounter> Counters() const { return camera_.Counters(); }

 private:
  Status Watch(const std::stop_token& stop, Stage& stage);
  void Leave(std::string why);
  void LookForIt();
  Status IsTheSame(const CameraInfo& info) const;
  std::string Explained(const std::string& why) const;

  const std::size_t number_;
  const std::string name_;
  const Nanoseconds retry_;
  RigInbox& inbox_;
  const SystemClock clock_;
  const V4l2System* const system_;  // camera_'s
  V4l2Camera camera_;
  std::optional<CameraInfo> expected_;
  HostTime next_attempt_;

  mutable std::mutex gate_;  // held while Trigger uses the camera: it is not closed meanwhile
  State state_;
  std::unique_ptr<Stage> stage_;
};

}  // namespace omnihdr::v4l2
