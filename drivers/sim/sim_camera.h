#pragma once

#include <condition_variable>
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
#include "core/ports/camera_release.h"
#include "drivers/sim/rig_optics.h"
#include "drivers/sim/simulation.h"
#include "drivers/sim/world.h"

namespace omnihdr::sim {

// What goes wrong, by chance (0 to 1 per frame, decided by the noise seed and the trigger's number)
// or for triggers named.
struct FaultOptions {
  double lost_probability = 0.0;      // the frame never arrives; the camera's counter skips it
  double torn_probability = 0.0;      // the lower part is the picture before; delivered as kCorrupt
  double exposure_probability = 0.0;  // taken with the exposure before; measured_exposure says so
  double vanish_probability = 0.0;    // the device goes when the trigger is commanded
  std::vector<std::uint64_t> lost;
  std::vector<std::uint64_t> torn;
  std::vector<std::uint64_t> exposure;
  std::vector<std::uint64_t> vanish;
  double away_s = 1.0;  // how long a device that went cannot be opened
};

struct SimCameraOptions {
  Simulation simulation;
  // Metres between triggers: where pictures are rendered ahead of time, and where the vehicle is
  // taken to be when a request carries no odometer (trigger number times this). 0 = it stands
  // still.
  double interval_m = 0.3;
  int render_ahead = 2;     // pictures kept ready, 0 to 8; each takes 4 bytes a value
  double readout_s = 0.02;  // sensor busy after the exposure, 0 to 10
  double latency_s = 0.0;   // further delay until the frame arrives, 0 to 60
  FaultOptions faults;
  // It hangs on the trigger's wire: see SimCamera.
  bool wired = false;
  // A wire that is pulsed to make it expose; null = there is none. Not with `wired`.
  std::shared_ptr<CameraRelease> release;
  Status Validate() const;  // kConfig error naming the option and its range
};

// A camera in a rendered world (Camera's laws hold). Frames are rendered in a thread of its own,
// ahead of time where the next positions can be known; a trigger that comes before the sensor has
// been read out, or while four frames are on their way, is refused as busy. The frame's noise
// depends on the noise seed and the trigger's number alone, so that a drive repeated gives the same
// pixels.
//
// Wired, it takes what Trigger tells it for a pulse on its wire, and exposes with what Prepare has
// set last; a pulse while it is busy is not seen by it. Pulse gives one that nobody tells of.
//
// With SimCameraOptions::release its exposure begins with the pulse that Trigger gives (kTemporary
// while the one before is too near); a wire that is not there makes a kMissedTrigger frame.
class SimCamera final : public Camera {
 public:
  // `world` may be shared between cameras; null = made by the first Open. Options must be valid
  // (Open reports it otherwise) and `world`, if given, must be of their scene and seed.
  explicit SimCamera(SimCameraOptions options, std::shared_ptr<const World> world = nullptr);
  ~SimCamera() override;

  Result<CameraInfo> Open() override;
  void Close() override;
  Status Start() override;
  void Stop() override;
  Status Trigger(const ExposureRequest& request) override;
  Result<CameraFrame> Receive(Nanoseconds timeout) override;
  void Prepare(const Exposure& next) override;

  // A pulse on the wire; the vehicle is where the picture before was taken. Any thread.
  void Pulse();

  // Pulls the plug (frames on their way are lost) and puts it back. Any thread.
  void Unplug();
  void PlugIn();

 private:
  struct Shot {
    ExposureRequest request;
    HostTime start;
    double odometer_m = 0.0;
    std::uint64_t counter = 0;
    Exposure in_force;
    bool torn = false;
    bool lost = false;
  };
  struct Pending {
    CameraFrame frame;
    HostTime ready;
    bool lost = false;
  };
  struct CachedView {
    double odometer_m = 0.0;
    std::shared_ptr<const Image<float>> radiance;
  };

  // All with mutex_.
  Status CheckFree(HostTime at) const;
  Status Begin(const ExposureRequest& request, HostTime start, double odometer_m);
  Status RenderLoop(std::stop_token stop, Stage& stage);
  std::shared_ptr<const Image<float>> RenderAt(double odometer_m) const;
  std::shared_ptr<const Image<float>> FindCached(double odometer_m) const;     // with mutex_
  void Keep(double odometer_m, std::shared_ptr<const Image<float>> radiance);  // with mutex_
  std::optional<double> NextToRender() const;                                  // with mutex_
  void Develop(const Shot& shot, const std::shared_ptr<const Image<float>>& radiance);
  void GoAway(std::string reason, std::optional<Nanoseconds> back_after);  // with mutex_
  bool Chance(double probability, const std::vector<std::uint64_t>& listed, TriggerId trigger,
              std::uint64_t salt) const;

  const SimCameraOptions options_;
  const SystemClock clock_;
  std::shared_ptr<const World> world_;
  std::unique_ptr<const RigOptics> optics_;  // layout rig, from the first Open on
  std::vector<Walk> walks_;                  // of the movers, from the first Open on
  Nanoseconds render_time_{0};

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool open_ = false;
  bool running_ = false;
  std::string away_;                 // why the device is not there; empty = it is
  std::optional<HostTime> back_at_;  // when it returns by itself
  std::deque<Shot> shots_;           // exposed, to be rendered
  int rendering_ = 0;
  std::deque<Pending> frames_;  // rendered, in trigger order
  std::vector<CachedView> cache_;
  double last_odometer_m_;
  HostTime busy_until_;
  HostTime opened_at_;
  std::uint64_t counter_ = 0;
  std::optional<Exposure> last_exposure_;
  std::optional<Exposure> prepared_;
  std::shared_ptr<const Image<std::uint8_t>> last_pixels_;  // render thread only
  std::unique_ptr<Stage> renderer_;
};

}  // namespace omnihdr::sim
