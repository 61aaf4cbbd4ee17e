#pragma once

#include <functional>
#include <mutex>
#include <string>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/ports/camera.h"

namespace omnihdr {

struct CameraRunnerOptions {
  // A camera that is not there is looked for again after this long, doubling up to the longest.
  Nanoseconds first_retry = std::chrono::milliseconds(250);
  Nanoseconds longest_retry = std::chrono::seconds(5);
  // Deadline of one wait for a frame; also how soon a stop request is noticed.
  Nanoseconds receive_timeout = std::chrono::milliseconds(100);
};

struct CameraRunnerEvents {
  // The camera is open, not yet started. A failure (another camera than the session's, ...) closes
  // it again; it is retried like an absent one.
  std::function<Status(const CameraInfo&)> opened;
  std::function<void()> started;
  std::function<void(CameraFrame)> frame;
  // The camera is away, or has not come yet.
  std::function<void(const Error&)> away;
};

// Keeps one camera open: opens it, receives its frames, and when it goes, closes it and tries again
// with growing patience, for ever. Turn() from the camera's own thread, Command() from the event
// loop; events are called from the camera's thread.
class CameraRunner {
 public:
  CameraRunner(Camera& camera, const CameraRunnerOptions& options, CameraRunnerEvents events,
               const Clock& clock);
  ~CameraRunner();
  CameraRunner(const CameraRunner&) = delete;
  CameraRunner& operator=(const CameraRunner&) = delete;

  // One step of the life above. Returns how long to rest before the next turn, 0 when there is more
  // to do at once; waits itself no longer than receive_timeout (or as long as Camera::Open takes).
  Nanoseconds Turn();
  // Stops and closes the camera. From the camera's thread, or when it has ended.
  void Close();

  // Camera::Trigger, or kUnavailable with the reason when the camera is not running.
  Status Command(const ExposureRequest& request);
  bool running() const;
  // Closes the camera and opens it again, at once, by the next Turn: one that has stopped to take
  // pictures often takes them again after that. False when it is not running or asked to already.
  // Any thread.
  bool Rearm(std::string reason);

 private:
  void GoAway(const Error& error);

  Camera& camera_;
  const CameraRunnerOptions options_;
  const CameraRunnerEvents events_;
  const Clock& clock_;
  mutable std::mutex gate_;  // held while Command uses the camera: it cannot be closed meanwhile
  bool running_ = false;
  std::string away_reason_ = "the camera is not open yet";
  std::string rearm_;  // why; empty = not asked for
  Nanoseconds retry_;
  HostTime next_attempt_;
  bool open_ = false;
};

}  // namespace omnihdr
