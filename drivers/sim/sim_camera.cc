#include "drivers/sim/sim_camera.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/session/rig_file.h"
#include "drivers/sim/geometry.h"
#include "drivers/sim/sensor.h"

namespace omnihdr::sim {
namespace {

constexpr std::size_t kMaxOnTheirWay = 4;
constexpr double kSamePlace = 1e-6;  // metres
constexpr double kShortest = 1e-6;
constexpr double kLongest = 10.0;
constexpr Nanoseconds kLongestWait = std::chrono::milliseconds(100);

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
}

Status CheckRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

}  // namespace

Status SimCameraOptions::Validate() const {
  OMNIHDR_TRY(simulation.Validate());
  if (wired && release) {
    return Fail(ErrorKind::kConfig,
                "wired: expected either a wire that is observed or one that is pulsed");
  }
  OMNIHDR_TRY(CheckRange("interval_m", interval_m, 0.0, 100.0));
  OMNIHDR_TRY(CheckRange("render_ahead", render_ahead, 0, 8));
  OMNIHDR_TRY(CheckRange("readout_s", readout_s, 0.0, 10.0));
  OMNIHDR_TRY(CheckRange("latency_s", latency_s, 0.0, 60.0));
  OMNIHDR_TRY(CheckRange("lost_probability", faults.lost_probability, 0.0, 1.0));
  OMNIHDR_TRY(CheckRange("torn_probability", faults.torn_probability, 0.0, 1.0));
  OMNIHDR_TRY(CheckRange("exposure_probability", faults.exposure_probability, 0.0, 1.0));
  OMNIHDR_TRY(CheckRange("vanish_probability", faults.vanish_probability, 0.0, 1.0));
  return CheckRange("away_s", faults.away_s, 0.0, 3600.0);
}

SimCamera::SimCamera(SimCameraOptions options, std::shared_ptr<const World> world)
    : options_(std::move(options)),
      world_(std::move(world)),
      // The first position is the next one after this.
      last_odometer_m_(-options_.interval_m) {}

SimCamera::~SimCamera() { Close(); }

Result<CameraInfo> SimCamera::Open() {
  if (Status valid = options_.Validate(); !valid) {
    return Forward(std::move(valid).error(), "simulated camera");
  }
  {
    std::lock_guard lock(mutex_);
    if (back_at_ && clock_.Now() >= *back_at_) {
      away_.clear();
      back_at_.reset();
    }
    if (!away_.empty()) {
      return Fail(ErrorKind::kUnavailable, "simulated camera: not there: {}", away_);
    }
  }
  bool left_running = false;
  {
    std::lock_guard lock(mutex_);
    left_running = running_ && !open_;
  }
  if (left_running) Stop();  // the device went while running
  const Simulation& simulation = options_.simulation;
  if (!world_) world_ = World::Create(simulation.scene, simulation.seed);
  world_->PrepareLight();
  if (walks_.empty()) walks_ = simulation.PlanWalks(*world_);
  if (simulation.layout == Layout::kRig && !optics_) {
    Result<Rig> rig = simulation.MakeRig();
    if (!rig) return Forward(std::move(rig).error(), "simulated camera");
    optics_ = std::make_unique<RigOptics>(std::move(*rig));
  }
  if (render_time_ == Nanoseconds(0)) {
    const HostTime before = clock_.Now();
    const double first = std::max(0.0, last_odometer_m_ + options_.interval_m);
    auto radiance = RenderAt(first);
    render_time_ = clock_.Now() - before;
    std::lock_guard lock(mutex_);
    Keep(first, std::move(radiance));
  }
  std::lock_guard lock(mutex_);
  if (!open_) {
    open_ = true;
    opened_at_ = clock_.Now();
    counter_ = 0;
    last_exposure_.reset();
    prepared_.reset();
  }
  CameraInfo info;
  info.description = simulation.Camera(optics_ ? &optics_->rig() : nullptr);
  if (optics_) info.files.push_back({"rig.toml", FormatRig(optics_->rig())});
  info.shortest = ExposureTime::Seconds(kShortest);
  info.longest = ExposureTime::Seconds(kLongest);
  // What the renderer keeps up with, with a quarter in reserve: other work shares the processor.
  info.min_trigger_interval = std::max(FromSeconds(options_.readout_s), render_time_ * 5 / 4);
  if (options_.release) {
    info.min_trigger_interval = std::max(info.min_trigger_interval, options_.release->spacing());
  }
  info.proof = ExposureProof::kEmbedded;
  info.wired = options_.wired;
  info.extra_json = FormatSimulation(simulation);
  return info;
}

void SimCamera::Close() {
  Stop();
  std::lock_guard lock(mutex_);
  open_ = false;
}

Status SimCamera::Start() {
  std::lock_guard lock(mutex_);
  if (!open_) return Fail(ErrorKind::kUnavailable, "simulated camera: start: not open");
  if (!away_.empty()) {
    return Fail(ErrorKind::kUnavailable, "simulated camera: start: not there: {}", away_);
  }
  if (running_) return {};
  running_ = true;
  busy_until_ = clock_.Now();
  renderer_ = std::make_unique<Stage>(
      "sim-render", [this](std::stop_token stop, Stage& stage) { return RenderLoop(stop, stage); });
  return {};
}

void SimCamera::Stop() {
  std::unique_ptr<Stage> renderer;
  {
    std::lock_guard lock(mutex_);
    running_ = false;
    renderer = std::move(renderer_);
  }
  if (renderer) {
    renderer->RequestStop();
    {
      // The loop is now before its look at the stop token or in its wait, never between the two.
      std::lock_guard lock(mutex_);
    }
    changed_.notify_all();
    // Only an exception ends the loop with an error, and the camera stops either way.
    static_cast<void>(renderer->Join());
  }
  std::lock_guard lock(mutex_);
  shots_.clear();
  frames_.clear();
}

void SimCamera::GoAway(std::string reason, std::optional<Nanoseconds> back_after) {
  away_ = std::move(reason);
  back_at_.reset();
  if (back_after) back_at_ = clock_.Now() + *back_after;
  open_ = false;
  shots_.clear();
  frames_.clear();
  changed_.notify_all();
}

void SimCamera::Unplug() {
  std::lock_guard lock(mutex_);
  GoAway("unplugged", std::nullopt);
}

void SimCamera::PlugIn() {
  std::lock_guard lock(mutex_);
  away_.clear();
  back_at_.reset();
}

bool SimCamera::Chance(double probability, const std::vector<std::uint64_t>& listed,
                       TriggerId trigger, std::uint64_t salt) const {
  if (std::find(listed.begin(), listed.end(), Value(trigger)) != listed.end()) return true;
  if (probability <= 0.0) return false;
  Random random(options_.simulation.sensor.seed * 1000003 + Value(trigger) * 131 + salt);
  return random.Unit() < probability;
}

Status SimCamera::Trigger(const ExposureRequest& request) {
  if (!request.exposure.IsValid() || request.exposure.time.seconds() < kShortest ||
      request.exposure.time.seconds() > kLongest) {
    return Fail(ErrorKind::kUsage, "simulated camera: exposure {} s: expected {} to {} s",
                request.exposure.time.seconds(), kShortest, kLongest);
  }
  std::lock_guard lock(mutex_);
  if (!away_.empty()) return Fail(ErrorKind::kUnavailable, "simulated camera: {}", away_);
  if (!running_) return Fail(ErrorKind::kUnavailable, "simulated camera: trigger: not started");
  const double odometer_m = request.odometer_m.value_or(
      static_cast<double>(Value(request.trigger)) * options_.interval_m);
  if (options_.release) {
    OMNIHDR_TRY(CheckFree(clock_.Now()));
    const Result<CameraRelease::Moment> released = options_.release->Release(Nanoseconds(0));
    if (released) return Begin(request, released->after, odometer_m);
    if (released.error().kind != ErrorKind::kUnavailable) {
      return Fail(released.error().kind, "simulated camera: {}", released.error().message);
    }
    // A wire that is not there is no reason to look for the camera anew.
    Pending missed;
    missed.frame.trigger = request.trigger;
    missed.frame.status = FrameStatus::kMissedTrigger;
    missed.frame.detail = released.error().message;
    missed.frame.camera_counter = counter_;
    missed.frame.mid_exposure = request.trigger_time;
    missed.ready = clock_.Now();
    frames_.push_back(std::move(missed));
    changed_.notify_all();
    return {};
  }
  if (!options_.wired) return Begin(request, clock_.Now(), odometer_m);
  ExposureRequest pulse = request;
  pulse.exposure = prepared_.value_or(request.exposure);
  Status begun = Begin(pulse, std::min(request.trigger_time, clock_.Now()), odometer_m);
  // A sensor that is busy does not see the pulse, and nobody is told.
  if (!begun && begun.error().kind == ErrorKind::kTemporary) return {};
  return begun;
}

void SimCamera::Prepare(const Exposure& next) {
  std::lock_guard lock(mutex_);
  prepared_ = next;
}

void SimCamera::Pulse() {
  std::lock_guard lock(mutex_);
  if (!running_ || !away_.empty() || !prepared_) return;
  ExposureRequest pulse;
  pulse.trigger = TriggerId{counter_};
  pulse.exposure = *prepared_;
  [[maybe_unused]] const Status begun = Begin(pulse, clock_.Now(), std::max(0.0, last_odometer_m_));
}

Status SimCamera::CheckFree(HostTime at) const {
  if (at < busy_until_) {
    return Fail(ErrorKind::kTemporary, "simulated camera: busy with the picture before for {} ms",
                (busy_until_ - at).count() / 1'000'000 + 1);
  }
  if (shots_.size() + static_cast<std::size_t>(rendering_) + frames_.size() >= kMaxOnTheirWay) {
    return Fail(ErrorKind::kTemporary, "simulated camera: busy: {} pictures are on their way",
                kMaxOnTheirWay);
  }
  return {};
}

Status SimCamera::Begin(const ExposureRequest& request, HostTime start, double odometer_m) {
  const FaultOptions& faults = options_.faults;
  OMNIHDR_TRY(CheckFree(start));
  if (Chance(faults.vanish_probability, faults.vanish, request.trigger, 4)) {
    GoAway(fmt::format("vanished at trigger {}", Value(request.trigger)),
           FromSeconds(faults.away_s));
    return Fail(ErrorKind::kUnavailable, "simulated camera: {}", away_);
  }
  Shot shot;
  shot.request = request;
  shot.start = start;
  shot.odometer_m = odometer_m;
  shot.counter = counter_++;
  shot.in_force = request.exposure;
  if (Chance(faults.exposure_probability, faults.exposure, request.trigger, 1)) {
    shot.in_force = last_exposure_.value_or(request.exposure);
    if (shot.in_force == request.exposure) shot.in_force.time = request.exposure.time + Stops{1.0};
  }
  last_exposure_ = request.exposure;
  shot.torn = Chance(faults.torn_probability, faults.torn, request.trigger, 2);
  shot.lost = Chance(faults.lost_probability, faults.lost, request.trigger, 3);
  busy_until_ = start + FromSeconds(shot.in_force.time.seconds()) + FromSeconds(options_.readout_s);
  last_odometer_m_ = shot.odometer_m;
  shots_.push_back(std::move(shot));
  changed_.notify_all();
  return {};
}

Result<CameraFrame> SimCamera::Receive(Nanoseconds timeout) {
  const HostTime deadline = clock_.Now() + timeout;
  std::unique_lock lock(mutex_);
  while (true) {
    if (!away_.empty()) return Fail(ErrorKind::kUnavailable, "simulated camera: {}", away_);
    if (!running_) return Fail(ErrorKind::kUnavailable, "simulated camera: receive: not started");
    const HostTime now = clock_.Now();
    while (!frames_.empty() && frames_.front().lost && frames_.front().ready <= now) {
      frames_.pop_front();
    }
    if (!frames_.empty() && frames_.front().ready <= now) {
      CameraFrame frame = std::move(frames_.front().frame);
      frames_.pop_front();
      return frame;
    }
    if (now >= deadline) {
      return Fail(ErrorKind::kTemporary, "simulated camera: no picture within {} ms",
                  timeout.count() / 1'000'000);
    }
    HostTime until = std::min(deadline, now + kLongestWait);
    if (!frames_.empty()) until = std::min(until, frames_.front().ready);
    changed_.wait_for(lock, until - now);
  }
}

std::shared_ptr<const Image<float>> SimCamera::RenderAt(double odometer_m) const {
  const Simulation& simulation = options_.simulation;
  const Pose pose = simulation.PoseAt(*world_, odometer_m);
  const MoverGroup movers = simulation.MoversAt(*world_, walks_, odometer_m);
  if (optics_) {
    return std::make_shared<const Image<float>>(
        optics_->Collect(*world_, pose, simulation.samples, &movers));
  }
  RenderedView view =
      world_->Render(pose, simulation.MakeProjection(), simulation.samples, &movers);
  return std::make_shared<const Image<float>>(std::move(view.radiance));
}

std::shared_ptr<const Image<float>> SimCamera::FindCached(double odometer_m) const {
  for (const CachedView& view : cache_) {
    if (std::abs(view.odometer_m - odometer_m) < kSamePlace) return view.radiance;
  }
  return nullptr;
}

void SimCamera::Keep(double odometer_m, std::shared_ptr<const Image<float>> radiance) {
  // The one in use and those ahead; whatever lies behind goes first.
  const auto most = static_cast<std::size_t>(options_.render_ahead) + 1;
  while (cache_.size() >= most) {
    cache_.erase(std::min_element(
        cache_.begin(), cache_.end(),
        [](const CachedView& a, const CachedView& b) { return a.odometer_m < b.odometer_m; }));
  }
  cache_.push_back({odometer_m, std::move(radiance)});
}

std::optional<double> SimCamera::NextToRender() const {
  if (options_.interval_m <= 0.0) return std::nullopt;
  // Triggers come at multiples of the interval beyond the last one.
  for (int i = 1; i <= options_.render_ahead; ++i) {
    const double place = last_odometer_m_ + i * options_.interval_m;
    if (!FindCached(place)) return place;
  }
  return std::nullopt;
}

Status SimCamera::RenderLoop(std::stop_token stop, Stage& stage) {
  std::unique_lock lock(mutex_);
  while (!stop.stop_requested()) {
    stage.Progress();
    if (!shots_.empty()) {
      const Shot shot = std::move(shots_.front());
      shots_.pop_front();
      rendering_ = 1;
      auto radiance = FindCached(shot.odometer_m);
      lock.unlock();
      const bool rendered = radiance == nullptr;
      if (rendered) radiance = RenderAt(shot.odometer_m);
      Develop(shot, radiance);
      lock.lock();
      if (rendered) Keep(shot.odometer_m, std::move(radiance));
      rendering_ = 0;
      continue;
    }
    if (const std::optional<double> place = NextToRender()) {
      lock.unlock();
      auto radiance = RenderAt(*place);
      lock.lock();
      Keep(*place, std::move(radiance));
      continue;
    }
    changed_.wait_for(lock, kLongestWait);
  }
  return {};
}

void SimCamera::Develop(const Shot& shot, const std::shared_ptr<const Image<float>>& radiance) {
  const Simulation& simulation = options_.simulation;
  Pending pending;
  CameraFrame& frame = pending.frame;
  if (options_.wired) {
    frame.wired = WiredStart{shot.start, Nanoseconds(0)};
  } else {
    frame.trigger = shot.request.trigger;
  }
  frame.camera_counter = shot.counter;
  frame.measured_exposure = shot.in_force;
  frame.proof = ExposureProof::kEmbedded;
  const Nanoseconds exposed = FromSeconds(shot.in_force.time.seconds());
  frame.mid_exposure = shot.start + exposed / 2;
  frame.settings_readback_json =
      fmt::format(R"({{"exposure_s":{:.9g},"gain_db":{:.9g}}})", shot.in_force.time.seconds(),
                  shot.in_force.gain.value);
  frame.truth_json =
      FormatTruth(simulation, simulation.PoseAt(*world_, shot.odometer_m), shot.odometer_m);
  Image<std::uint8_t> pixels =
      Expose(radiance->view(), shot.in_force, simulation.sensor, Value(shot.request.trigger));
  if (shot.torn) {
    const int row = pixels.height() / 2;
    frame.status = FrameStatus::kCorrupt;
    frame.detail = fmt::format("torn at row {}", row);
    const std::size_t row_bytes = pixels.size() / static_cast<std::size_t>(pixels.height());
    const std::size_t kept = row_bytes * static_cast<std::size_t>(row);
    if (last_pixels_ && last_pixels_->size() == pixels.size()) {
      std::memcpy(pixels.data() + kept, last_pixels_->data() + kept, pixels.size() - kept);
    } else {
      std::memset(pixels.data() + kept, 0, pixels.size() - kept);
    }
  } else if (!options_.faults.torn.empty() || options_.faults.torn_probability > 0.0) {
    last_pixels_ = std::make_shared<const Image<std::uint8_t>>(pixels.Clone());
  }
  frame.pixels = std::move(pixels);
  pending.lost = shot.lost;
  pending.ready = shot.start + exposed + FromSeconds(options_.readout_s + options_.latency_s);
  std::lock_guard lock(mutex_);
  frame.camera_time = CameraTime::FromNanoseconds((frame.mid_exposure - opened_at_).count());
  if (!away_.empty()) return;
  frames_.push_back(std::move(pending));
  changed_.notify_all();
}

}  // namespace omnihdr::sim
