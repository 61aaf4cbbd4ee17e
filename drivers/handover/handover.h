#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/base/stage.h"
#include "core/ports/camera.h"

namespace omnihdr {

// Which requests a camera takes.
struct HandoverLimits {
  ExposureTime shortest;
  ExposureTime longest;
  double least_gain_db = 0.0;
  double most_gain_db = 0.0;
  std::string gain_note;     // why there is no more of it, for the message; empty = nothing to say
  std::size_t requests = 1;  // on their way at once, at least 1
};

// What lies between the callers of a camera that works in a thread of its own and that thread:
// requests go one way, frames the other, and "the camera has gone" ends both. Law: a request is
// refused or taken; one that was taken and not forgotten by Stop or GoAway is given to the worker
// once, in order. Frames are received in the order in which they were delivered. At most
// limits.requests requests and kMaxWaiting frames (and those of requests taken before there were as
// many) are held.
//
// Threads: those of core/ports/camera.h: Trigger and Receive at any time; Open, Close, MayStart,
// Start and Stop from one thread; what the worker calls, from the worker.
class Handover {
 public:
  static constexpr std::size_t kMaxWaiting = 4;

  // `camera`: what messages begin with.
  explicit Handover(std::string camera) : camera_(std::move(camera)) {}
  Handover(const Handover&) = delete;
  Handover& operator=(const Handover&) = delete;

  // --- whoever opens, starts, stops and closes the camera
  void Open(HandoverLimits limits);
  void Close();
  bool IsOpen() const;  // and has not gone since
  // false: it runs already. kUnavailable: not open, or gone.
  Result<bool> MayStart() const;
  // The camera's stream runs; `body` is the worker's.
  void Start(std::string thread, Stage::Body body);
  // Ends the worker, then calls `stop_device` (when there was a worker), then forgets requests and
  // frames. Idempotent.
  void Stop(const std::function<void(bool gone)>& stop_device);

  // --- Camera::Trigger and Camera::Receive
  Status Trigger(const ExposureRequest& request);
  // kUnavailable: not started, or gone.
  Status CheckRunning(const char* doing) const;
  Result<CameraFrame> Receive(Nanoseconds timeout);
  // --- Camera::Prepare: the last one counts; one that Trigger would refuse is no hint.
  void Prepare(const Exposure& next);

  // --- the worker
  // The next request, to be ended by Done or Finish; nothing when none came within `timeout`.
  std::optional<ExposureRequest> Take(Nanoseconds timeout, const std::stop_token& stop);
  // What Prepare said since the last call. Take returns early, with nothing, when there is news.
  std::optional<Exposure> TakeHint();
  void Deliver(CameraFrame frame);
  // Whether no more frames wait than may; for those that nobody asked for.
  bool HasRoom() const;
  // The oldest request that was taken is at its end: the next may come.
  void Done();
  void Finish(CameraFrame frame);  // Deliver and Done at once
  // Requests and frames are forgotten; until Open every call says why.
  void GoAway(std::string reason);

  // The frame of a trigger that came to no picture.
  static CameraFrame Missed(const ExposureRequest& request, std::string why, std::uint64_t counter);

 private:
  void Forget();                                       // with mutex_
  Status CheckLimits(const Exposure& exposure) const;  // with mutex_
  Error Unavailable(const char* doing, const std::string& why) const;

  const std::string camera_;
  mutable std::mutex mutex_;
  // Two, so that a trigger wakes no one but the worker, which then finds the mutex free.
  std::condition_variable asked_;
  std::condition_variable delivered_;
  HandoverLimits limits_;
  bool open_ = false;
  bool running_ = false;
  std::string away_;  // why the camera has gone; empty = it has not
  std::deque<ExposureRequest> requests_;
  std::optional<Exposure> hint_;
  std::size_t taken_ = 0;
  std::deque<CameraFrame> frames_;
  std::unique_ptr<Stage> worker_;
};

}  // namespace omnihdr
