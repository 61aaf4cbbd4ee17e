#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/ports/camera.h"
#include "core/ports/trigger.h"
#include "core/session/session.h"

namespace omnihdr {

struct ReplayOptions {
  std::filesystem::path session;  // a session directory of layout panorama or perspective
  // Least time between two triggers, 0 to 3600 s: what the disk and the computer are given for a
  // frame.
  double interval_s = 0.2;
  Status Validate() const;  // kConfig error naming the option and its range
};

// A recorded session as a camera: trigger n takes line n of the journal, whatever the trigger asks
// for, with the pixels, the exposure (proof kFile) and the status recorded there; lines without
// pixels come as frames without pixels. A line whose file is missing or damaged comes as kCorrupt.
// Camera's laws hold; the session is read by Open, its pixels by Receive.
class ReplayCamera final : public Camera {
 public:
  explicit ReplayCamera(ReplayOptions options);
  Result<CameraInfo> Open() override;
  void Close() override;
  Status Start() override;
  void Stop() override;
  Status Trigger(const ExposureRequest& request) override;
  Result<CameraFrame> Receive(Nanoseconds timeout) override;

  // For the trigger that belongs to this camera. Any thread.
  bool Ready() const;  // started, and nothing on its way
  std::optional<FrameRecord> Line(std::uint64_t number) const;
  std::size_t lines() const;  // 0 before the first Open
  const ReplayOptions& options() const { return options_; }

 private:
  CameraFrame Load(std::uint64_t line, const ExposureRequest& request) const;

  const ReplayOptions options_;
  const SystemClock clock_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool open_ = false;
  bool running_ = false;
  bool delivering_ = false;
  std::shared_ptr<const std::vector<FrameRecord>> frames_;
  SessionInfo info_;
  std::deque<ExposureRequest> requested_;
  std::uint64_t counter_ = 0;
};

struct ReplayTriggerOptions {
  std::uint64_t first = 0;  // journal line to begin with: where an interrupted replay goes on
  std::uint64_t limit = 0;  // events before it is exhausted; 0 = none
  // Asked before every event: whether there is room for a frame (free buffers). Empty = always.
  std::function<bool()> room;
};

// The triggers of a recorded session, one a journal line with the odometer recorded there, as fast
// as the camera and `room` allow but not faster than the interval; exhausted after the last line.
class ReplayTrigger final : public TriggerSource {
 public:
  ReplayTrigger(std::shared_ptr<const ReplayCamera> camera, ReplayTriggerOptions options);
  std::string_view kind() const override { return "replay"; }
  Status Start() override;
  void Stop() override { started_ = false; }
  Result<std::optional<TriggerEvent>> Poll() override;
  std::optional<HostTime> NextDeadline() const override;
  bool exhausted() const override;
  bool needs_camera() const override { return true; }

 private:
  const std::shared_ptr<const ReplayCamera> camera_;
  const ReplayTriggerOptions options_;
  const SystemClock clock_;
  bool started_ = false;
  HostTime earliest_;
  std::uint64_t events_ = 0;
};

}  // namespace omnihdr
