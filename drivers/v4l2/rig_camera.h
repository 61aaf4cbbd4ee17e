#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/stage.h"
#include "core/ports/camera.h"
#include "core/sphere/rig.h"
#include "drivers/handover/handover.h"
#include "drivers/v4l2/camera_setup.h"
#include "drivers/v4l2/rig_member.h"

namespace omnihdr::v4l2 {

// Several V4L2 cameras as one (Camera's laws hold): one for each sensor of a rig file, in its
// order. A trigger is given to all of them at once; their pictures are grouped by trigger, whenever
// they arrive, and stacked into one raw frame. Each camera proves its own exposure by its own
// latency; the set has the weakest proof, and the exposure that is farthest from what was asked.
// Nothing but the trigger's moment synchronises them: they run freely, so that exposures begin up
// to a frame apart (skew_s of the frame's settings_readback says how far).
//
// A sensor without a whole picture makes the set corrupt: it is delivered with what there is
// (CameraFrame::partial, missing sensors black), and its detail names the sensors and why. Open
// needs all cameras. Later one may leave: sets are incomplete until it is back and what it was;
// when all have gone, the rig has.
class V4l2RigCamera final : public Camera {
 public:
  // Makes one system for each camera, by its number: they are opened side by side.
  using MakeSystem = std::function<std::unique_ptr<V4l2System>(std::size_t)>;
  // `retry`: between attempts to open a camera that has left.
  V4l2RigCamera(V4l2CameraOptions options, MakeSystem make_system,
                Nanoseconds retry = std::chrono::seconds(1));
  ~V4l2RigCamera() override;

  Result<CameraInfo> Open() override;
  void Close() override;
  Status Start() override;
  void Stop() override;
  Status Trigger(const ExposureRequest& request) override;
  void Prepare(const Exposure& next) override;
  Result<CameraFrame> Receive(Nanoseconds timeout) override;

  struct Counts {
    std::uint64_t incomplete = 0;   // sets without a whole picture of every sensor
    std::uint64_t late_frames = 0;  // came when their set had been delivered
    std::uint64_t departures = 0;   // of cameras
    std::uint64_t returns = 0;      // of those
    std::size_t away = 0;           // cameras that are not there
  };
  Counts counts() const;
  // Of the rig, and the sums of its cameras'.
  std::vector<CameraCounter> Counters() const override;

 private:
  // What one sensor has of a set.
  struct Slot {
    enum class State { kToCommand, kCommanded, kHere, kMissing };
    State state = State::kToCommand;
    std::uint64_t life = 0;  // the member's, when it was commanded
    std::string why;         // kMissing; kToCommand: why not yet
    CameraFrame frame;       // kHere
  };
  struct Set {
    ExposureRequest request;
    HostTime deadline;
    std::vector<Slot> slots;
  };

  void ForgetMembers();
  Status OpenMembers(std::vector<CameraInfo>& infos);
  Status Combine(const std::vector<CameraInfo>& infos);
  Status Run(const std::stop_token& stop, Stage& stage);
  void Begin(const ExposureRequest& request);
  void CommandMembers();
  void Collect(Nanoseconds timeout);
  void FindLost();
  void DeliverFinished();
  CameraFrame MakeFrame(Set& set);
  std::uint64_t Count(const Set& set);
  // Why every camera is away; empty when one is there.
  std::string AllAway() const;

  const V4l2CameraOptions options_;
  const MakeSystem make_system_;
  const Nanoseconds retry_;
  const SystemClock clock_;
  RigInbox inbox_;
  mutable std::mutex members_mutex_;  // for Counters: while the vector is changed
  std::vector<std::unique_ptr<RigMember>> members_;
  std::vector<std::string> names_;  // of the sensors
  std::vector<int> rows_;           // where each begins in the stack; the last is its height
  CameraInfo info_;

  // Of the worker.
  std::deque<Set> sets_;  // oldest first
  std::uint64_t counter_ = 0;
  std::vector<std::optional<std::uint64_t>> last_counters_;

  Handover handover_{"V4L2 rig"};
  mutable std::mutex mutex_;
  Counts counts_;  // with mutex_
};

// The cameras of this machine's kernel: one, or several as a rig (options.devices). kCannotCreate:
// a file of options.recording cannot be made.
Result<std::unique_ptr<Camera>> MakeKernelV4l2Camera(V4l2CameraOptions options);

}  // namespace omnihdr::v4l2
