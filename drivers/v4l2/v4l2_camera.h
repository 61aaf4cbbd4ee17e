#pragma once

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
#include "drivers/handover/handover.h"
#include "drivers/v4l2/camera_setup.h"
#include "drivers/v4l2/exposure_log.h"

namespace omnihdr::v4l2 {

// A camera over V4L2 (Camera's laws hold). It runs freely; a trigger sets exposure and gain right
// after a frame, and takes the first frame that began after the trigger and for which that exposure
// is certain to be in force. Two triggers are on their way at most; another one is refused as busy,
// as is one while four pictures wait to be received. The second one's exposure is written while the
// first one's frame is still coming, as soon as that frame is certain not to be touched by it: a
// measured latency says from which frame on a setting may act. What Prepare says comes next is
// written while nothing is on its way: a trigger that comes once it is in force takes the first
// frame that begins after it. The exposure of a frame is what was read back, in force since as many
// frames as were measured (proof latency; readback when the latency could not be measured). A
// picture whose brightness contradicts that has no proof; two such in a row, and the latency is
// measured anew. The camera's counter goes up by one a picture and by the frames lost between (gaps
// in the kernel's sequence).
class V4l2Camera final : public Camera {
 public:
  V4l2Camera(V4l2CameraOptions options, std::unique_ptr<V4l2System> system);
  ~V4l2Camera() override;

  Result<CameraInfo> Open() override;
  void Close() override;
  Status Start() override;
  void Stop() override;
  Status Trigger(const ExposureRequest& request) override;
  void Prepare(const Exposure& next) override;
  Result<CameraFrame> Receive(Nanoseconds timeout) override;

  // Of the open camera: the path of its node, and which requests it takes.
  const std::string& node() const { return camera_->node; }
  HandoverLimits limits() const;

  struct Counts {
    std::uint64_t damaged = 0;         // frames with the driver's error flag
    std::uint64_t stale = 0;           // older than one that had come before
    std::uint64_t lost_frames = 0;     // gaps of the sequence
    std::uint64_t lost_triggers = 0;   // whose picture never came
    std::uint64_t clamped = 0;         // settings that the camera made something else of
    std::uint64_t contradictions = 0;  // brightness did not follow the exposure
    std::uint64_t measurements = 0;    // of the latency, after that of Open
    std::uint64_t early = 0;           // exposures written while the frame before was coming
    std::uint64_t prepared = 0;        // exposures written before their trigger, with nothing to do
  };
  Counts counts() const;
  std::vector<CameraCounter> Counters() const override;

 private:
  struct Reference {
    Level level;
    Exposure exposure;
  };
  // A trigger that was taken, and its time on the clock of the frames' stamps.
  struct Shot {
    ExposureRequest request;
    HostTime trigger;
  };
  // The trigger after the one whose frame is coming.
  struct Next {
    Shot shot;
    bool written = false;
    std::uint32_t after = 0;             // when written: the newest frame then
    SetExposure set;                     // when written
    std::optional<Reference> reference;  // when written
  };

  Status Run(std::stop_token stop, Stage& stage);
  // An error: the camera has gone.
  Status Shoot(const Shot& shot, const std::stop_token& stop);
  Status Idle(const std::stop_token& stop);
  std::optional<Shot> TakeTrigger(const std::stop_token& stop);
  Result<std::optional<CameraFrame>> TakePicture(const Shot& shot, std::stop_token stop);
  Result<bool> SetExposureNow(const Exposure& exposure, std::stop_token stop);
  Result<std::optional<Filled>> NextFrame(Nanoseconds timeout);
  Result<std::optional<Filled>> NextOfStream(Nanoseconds timeout);
  Status CommandNext(const Shot& shot, const Filled& filled, const std::stop_token& stop);
  std::optional<Reference> ReferenceOf(const Filled& filled) const;
  Status Drain();
  Status RecycleReady();
  HostTime ExposureStart(const Filled& filled, const Exposure& exposure) const;
  CameraFrame MakeFrame(const Shot& shot, const Filled& filled, const SetExposure& exposure);
  // Why a frame's brightness cannot be that of its exposure; nothing when it can, and when there is
  // nothing to hold it against.
  std::optional<std::string> Contradiction(const Filled& filled, const SetExposure& exposure);
  void HoldPrepared(const Filled& filled);
  Status MeasureAnew();
  Status RestartStream();
  void ForgetStream();

  const V4l2CameraOptions options_;
  const std::unique_ptr<V4l2System> system_;
  const Clock& clock_;  // of system_

  // Of whoever runs Open, Start, Stop and Close, and of the worker in between.
  std::unique_ptr<ReadyCamera> camera_;
  ExposureLog log_;
  std::optional<SetExposure> set_;
  std::uint32_t set_at_ = 0;  // the newest frame when it was written
  std::optional<std::uint32_t> last_sequence_;
  std::optional<HostTime> last_stamp_;
  std::optional<Reference> reference_;
  bool to_be_held_ = false;  // what was prepared, against `reference_`
  std::optional<Next> next_;
  std::deque<Filled> ready_;  // out of the stream, not looked at yet
  std::uint64_t counter_ = 0;
  std::uint64_t lost_since_ = 0;  // frames, since the last picture
  int contradictions_ = 0;        // in a row
  int failures_ = 0;

  Handover handover_{"V4L2 camera"};
  mutable std::mutex mutex_;
  Counts counts_;  // with mutex_
};

}  // namespace omnihdr::v4l2
