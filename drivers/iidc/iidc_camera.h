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
#include "drivers/iidc/camera_clock.h"
#include "drivers/iidc/camera_setup.h"
#include "drivers/iidc/exposure_table.h"
#include "drivers/iidc/frame_assembler.h"
#include "drivers/iidc/frame_info.h"

namespace omnihdr::iidc {

// An IIDC camera (Camera's laws hold), triggered by software: a trigger sets shutter and gain,
// reads them back, waits until the camera is ready, and triggers it. One picture is on its way at a
// time; a trigger before it has arrived is refused as busy, as is one while four pictures wait to
// be received. The exposure a frame had is what the camera wrote into the frame; without that, what
// its registers said (proof readback). A picture that does not come within frame_timeout_s of its
// exposure is given up; when it comes later it is thrown away, for its time stamp is older than the
// next trigger. Registers that fail at a trigger give a kMissedTrigger frame that says so; three
// such in a row, or a camera that has gone, end in kUnavailable.
//
// With IidcCameraOptions::release a pulse on that wire takes the place of the software trigger, and
// all else is the same. A pulse that could not be given is a kMissedTrigger frame, too, but the
// wire's failure, not the camera's.
//
// Wired (IidcCameraOptions::wired), it exposes at every pulse on its input with what Prepare has
// set last. Three pictures by software at each start, thrown away, fit its clock to the host's;
// after that the edges that Trigger tells of keep the fit. A clock that has jumped is fitted in the
// same way again, and the pulses of that moment find no camera. Frames come as their pulses made
// them, and say when (CameraFrame::wired).
class IidcCamera final : public Camera {
 public:
  IidcCamera(IidcCameraOptions options, std::unique_ptr<LinkFinder> finder,
             RegisterTimeouts timeouts = {});
  ~IidcCamera() override;

  Result<CameraInfo> Open() override;
  void Close() override;
  Status Start() override;
  void Stop() override;
  Status Trigger(const ExposureRequest& request) override;
  Result<CameraFrame> Receive(Nanoseconds timeout) override;
  void Prepare(const Exposure& next) override;

  struct Counts {
    std::uint64_t torn = 0;    // frames with lost or surplus bytes
    std::uint64_t strays = 0;  // frames that no trigger waited for
    std::uint64_t lost = 0;    // triggers whose frame never came
  };
  Counts counts() const;
  std::vector<CameraCounter> Counters() const override;

 private:
  struct InForce {
    Exposure asked;
    Exposure measured;
    std::uint32_t shutter_raw = 0;
    std::uint32_t gain_raw = 0;
    bool settled = false;  // the pictures that may have had the one before are thrown away
  };
  // When the trigger was sent.
  struct Sent {
    HostTime before;
    HostTime after;
    bool confirmed = false;
    std::string unreleased;  // why the wire gave no pulse; empty = it did
  };

  Status RunShots(std::stop_token stop, Stage& stage);
  // Wired (wired_shots.cc).
  Status RunWired(std::stop_token stop, Stage& stage);
  Status WireUp(const std::stop_token& stop);
  Status FitClock(const std::stop_token& stop);
  Status PrepareWired();
  Status ReadWired();
  void DeliverWired(RawFrame raw);
  std::optional<HostTime> TakeEdge(HostTime near, Nanoseconds within);
  Result<std::optional<CameraFrame>> TakePicture(const ExposureRequest& request,
                                                 std::stop_token stop);
  Status SetExposure(const Exposure& exposure);
  Result<Sent> SendTrigger();
  Sent PulseWire();
  std::optional<CameraFrame> NotReleased(const ExposureRequest& request, const Sent& sent);
  Result<std::optional<RawFrame>> WaitForFrame(const Sent& sent, std::stop_token stop);
  CameraFrame MakeFrame(const ExposureRequest& request, const Sent& sent, RawFrame raw);
  std::uint64_t Count(std::optional<std::uint32_t> embedded);
  void Prove(const EmbeddedInfo& info, CameraFrame& frame) const;
  bool IsStray(const RawFrame& frame, const Sent& sent);
  Status DropStrays();
  Status StartLink();
  Status RestartStream();

  const IidcCameraOptions options_;
  const std::unique_ptr<LinkFinder> finder_;
  const RegisterTimeouts timeouts_;
  const SystemClock clock_;

  // Of whoever runs Open, Start, Stop and Close, and of the worker in between.
  std::optional<ReadyCamera> camera_;
  std::optional<FrameAssembler> assembler_;
  CameraClock camera_clock_;
  std::uint64_t jumps_before_ = 0;  // of camera_clock_, before the camera was opened
  ExposureTable shutters_;
  ExposureTable gains_;
  std::optional<InForce> in_force_;
  std::optional<std::uint32_t> last_counter_;
  std::uint64_t counter_ = 0;  // as told outside: pictures thrown away on purpose left out
  std::uint64_t counter_at_last_ = 0;
  std::uint32_t discarded_ = 0;  // since last_counter_
  int failures_ = 0;

  // Wired, of the worker.
  std::optional<Exposure> wanted_;
  std::uint64_t fitted_jumps_ = 0;
  Nanoseconds arrival_delay_{0};  // from an exposure's end to its frame's arrival, as last seen

  Handover handover_{"IIDC camera"};
  mutable std::mutex mutex_;
  Counts counts_;               // with mutex_
  std::deque<HostTime> edges_;  // with mutex_: told of by Trigger, the newest last
};

// Where the options say that the camera is: this machine's USB, recorded or not, or its FireWire.
std::unique_ptr<LinkFinder> MakeFinder(const IidcCameraOptions& options);
std::unique_ptr<Camera> MakeIidcCamera(IidcCameraOptions options);

}  // namespace omnihdr::iidc
