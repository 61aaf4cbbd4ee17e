#include "daemon/cli/camera_trial.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <thread>
#include <utility>
#include <variant>

namespace omnihdr {
namespace {

constexpr Nanoseconds kAgain = std::chrono::milliseconds(2);
// Of the largest code: a picture darker or brighter says nothing of its exposure.
constexpr double kDark = 0.02;
constexpr double kBright = 0.95;
constexpr double kLeastRise = 0.98;  // of the level, with a longer exposure
// Between which levels a step of two stops shows, and which share of it must.
constexpr double kUsableLow = 0.16;
constexpr double kUsableHigh = 0.7;
constexpr double kLeastFollowed = 0.3;  // codings with a gamma follow by half of it
constexpr double kStepStops = 2.0;
constexpr int kLatencySteps = 8;

class Trial {
 public:
  Trial(Camera& camera, CameraInfo info, const CameraTrialOptions& options)
      : camera_(camera), info_(std::move(info)), options_(options) {}

  CameraTrialStep Starts() {
    for (int i = 0; i < options_.starts; ++i) {
      if (const Status started = camera_.Start(); !started) {
        return Failed(fmt::format("start {}: {}", i + 1, started.error().message));
      }
      // The first, the last and every tenth time it must show that it works.
      if (i == 0 || i + 1 == options_.starts || i % 10 == 0) {
        const Result<CameraFrame> frame = Take(Clamped(0.01));
        if (!frame) return Failed(fmt::format("start {}: {}", i + 1, frame.error().message));
      }
      camera_.Stop();
    }
    return Passed(fmt::format("started and stopped {} times", options_.starts));
  }

  CameraTrialStep Ladder() {
    if (const Status started = camera_.Start(); !started) return Failed(started.error().message);
    const double least = info_.shortest.seconds();
    const double most = std::max(least, std::min(info_.longest.seconds(), options_.longest_s));
    double worst = 0.0;
    double slowest_s = 0.0;
    double last_level = 0.0;
    std::string levels;
    std::optional<ExposureProof> weakest;
    for (int i = 0; i < options_.exposures; ++i) {
      const double part = static_cast<double>(i) / (options_.exposures - 1);
      const ExposureTime time = Clamped(least * std::pow(most / least, part));
      const HostTime begin = clock_.Now();
      const Result<CameraFrame> frame = Take(time);
      const double latency_s = static_cast<double>((clock_.Now() - begin).count()) * 1e-9;
      const std::string which = fmt::format("{:.4g} s", time.seconds());
      if (!frame) return Failed(fmt::format("{}: {}", which, frame.error().message));
      if (frame->status != FrameStatus::kOk) {
        return Failed(fmt::format("{}: {}: {}", which, ToString(frame->status), frame->detail));
      }
      if (!frame->measured_exposure || frame->proof == ExposureProof::kNone) {
        return Failed(fmt::format("{}: the frame has no proof of its exposure", which));
      }
      const double measured = frame->measured_exposure->EffectiveSeconds();
      const double off = std::abs(measured / time.seconds() - 1.0);
      if (off > options_.exposure_tolerance) {
        return Failed(
            fmt::format("{}: proved exposure {:.4g} s, off by {:.1f} %, expected {:.1f} %", which,
                        measured, 100.0 * off, 100.0 * options_.exposure_tolerance));
      }
      const double level = MeanLevel(*frame, info_.description.bits);
      const bool tells = last_level > kDark && last_level < kBright && level < kBright;
      if (tells && level < kLeastRise * last_level) {
        return Failed(fmt::format("{}: level {:.3f}, darker than {:.3f} at the exposure before",
                                  which, level, last_level));
      }
      last_level = level;
      if (level >= kUsableLow && level <= kUsableHigh) usable_ = time;
      worst = std::max(worst, off);
      slowest_s = std::max(slowest_s, latency_s - time.seconds());
      levels += fmt::format("{}{:.3f}", levels.empty() ? "" : " ", level);
      if (!weakest || frame->proof > *weakest) weakest = frame->proof;
    }
    return Passed(fmt::format(
        "{} exposures from {:.4g} to {:.4g} s, proof {}, off by {:.2f} % at most, levels {}, "
        "picture at most {:.0f} ms after its exposure",
        options_.exposures, least, most, ToString(*weakest), 100.0 * worst, levels,
        1e3 * slowest_s));
  }

  // Exposures two stops apart in turn: each picture must be of its own trigger's exposure, which
  // its brightness tells without the driver's word. Where no exposure of the ladder shows the
  // scene, only the time from trigger to picture is told.
  CameraTrialStep Latency() {
    const ExposureTime bright = usable_.value_or(Clamped(0.01));
    const ExposureTime dark = Clamped(bright.seconds() / std::exp2(kStepStops));
    const double stops = std::log2(bright.seconds() / dark.seconds());
    double quickest_s = 0.0;
    double slowest_s = 0.0;
    double last_level = 0.0;
    for (int i = 0; i <= kLatencySteps; ++i) {
      const ExposureTime time = i % 2 == 0 ? bright : dark;
      const HostTime begin = clock_.Now();
      const Result<CameraFrame> frame = Take(time);
      const double took_s =
          static_cast<double>((clock_.Now() - begin).count()) * 1e-9 - time.seconds();
      const std::string which = fmt::format("step {} to {:.4g} s", i, time.seconds());
      if (!frame) return Failed(fmt::format("{}: {}", which, frame.error().message));
      if (frame->status != FrameStatus::kOk) {
        return Failed(fmt::format("{}: {}: {}", which, ToString(frame->status), frame->detail));
      }
      const double level = MeanLevel(*frame, info_.description.bits);
      if (usable_ && i > 0 && stops >= 1.0) {
        const double moved = std::log2(std::max(level, 1e-6) / std::max(last_level, 1e-6));
        if (moved / (i % 2 == 0 ? stops : -stops) < kLeastFollowed) {
          return Failed(
              fmt::format("{}: level {:.3f} after {:.3f}, expected a step of {:.1f} stops", which,
                          level, last_level, i % 2 == 0 ? stops : -stops));
        }
      }
      last_level = level;
      quickest_s = i == 0 ? took_s : std::min(quickest_s, took_s);
      slowest_s = std::max(slowest_s, took_s);
    }
    return Passed(fmt::format(
        "{}; picture {:.0f} to {:.0f} ms after its trigger, less its exposure; a setting acts "
        "after {} frames",
        usable_ && stops >= 1.0
            ? fmt::format("{} steps of {:.1f} stops, each seen in the first picture after it",
                          kLatencySteps, stops)
            : fmt::format(
                  "steps at {:.4g} s are not looked for in the pictures, which are too dark or "
                  "too bright at every exposure of the ladder",
                  bright.seconds()),
        1e3 * quickest_s, 1e3 * slowest_s, info_.exposure_latency_frames));
  }

  // Every accepted trigger must end as one frame, or as a gap in the camera's own counter.
  CameraTrialStep Accounting() {
    std::vector<TriggerId> given;
    std::vector<CameraFrame> frames;
    int refused = 0;
    const HostTime begin = clock_.Now();
    const HostTime deadline = begin + options_.frame_timeout * (options_.triggers + 1);
    while (static_cast<int>(given.size()) < options_.triggers && clock_.Now() < deadline) {
      const ExposureRequest request = Request(Clamped(0.002));
      if (const Status commanded = camera_.Trigger(request); commanded) {
        given.push_back(request.trigger);
      } else if (commanded.error().kind == ErrorKind::kTemporary) {
        ++refused;
        std::this_thread::sleep_for(kAgain);
      } else {
        return Failed(commanded.error().message);
      }
      if (const Status received = Collect(Nanoseconds(0), &frames); !received) {
        return Failed(received.error().message);
      }
    }
    while (frames.size() < given.size()) {
      const std::size_t before = frames.size();
      if (const Status received = Collect(options_.frame_timeout, &frames); !received) {
        return Failed(received.error().message);
      }
      if (frames.size() == before) break;
    }
    const double seconds = static_cast<double>((clock_.Now() - begin).count()) * 1e-9;
    std::size_t next = 0;
    for (const CameraFrame& frame : frames) {
      const auto found =
          std::find(given.begin() + static_cast<std::ptrdiff_t>(next), given.end(), frame.trigger);
      if (found == given.end()) {
        return Failed(fmt::format("a frame of trigger {} that came twice, too early or never was",
                                  Value(frame.trigger)));
      }
      next = static_cast<std::size_t>(found - given.begin()) + 1;
    }
    const std::size_t without = given.size() - frames.size();
    const std::uint64_t told = frames.empty()
                                   ? 0
                                   : frames.back().camera_counter - frames.front().camera_counter +
                                         1 - static_cast<std::uint64_t>(frames.size());
    const std::string seen = fmt::format(
        "{} triggers, {} frames in order, {} lost by the camera's counter, {} refused "
        "while busy, {:.1f} pictures a second",
        given.size(), frames.size(), told, refused,
        static_cast<double>(frames.size()) / std::max(seconds, 1e-9));
    if (static_cast<int>(given.size()) < options_.triggers) return Failed(seen + ": busy for ever");
    // A last frame that is lost has none after it whose counter would tell.
    if (without > told + 1) return Failed(seen + fmt::format(": {} without a trace", without));
    return Passed(seen);
  }

  CameraTrialStep Unplug() {
    options_.ask("unplug the camera");
    const HostTime deadline = clock_.Now() + options_.return_timeout;
    ErrorKind kind = ErrorKind::kTemporary;
    while (kind != ErrorKind::kUnavailable && clock_.Now() < deadline) {
      const Result<CameraFrame> frame = camera_.Receive(std::chrono::milliseconds(200));
      kind = frame ? ErrorKind::kTemporary : frame.error().kind;
    }
    if (kind != ErrorKind::kUnavailable) return Failed("the camera did not say that it has gone");
    camera_.Stop();
    camera_.Close();
    options_.ask("plug the camera in again");
    const HostTime back = clock_.Now() + options_.return_timeout;
    std::string why = "never tried";
    while (clock_.Now() < back) {
      if (Result<CameraInfo> opened = camera_.Open(); opened) {
        info_ = *std::move(opened);
        if (const Status started = camera_.Start(); !started) {
          return Failed(started.error().message);
        }
        const Result<CameraFrame> frame = Take(Clamped(0.01));
        if (!frame) return Failed(frame.error().message);
        return Passed("gone, said so, and back with a picture");
      } else {
        why = opened.error().message;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
    }
    return Failed("did not come back: " + why);
  }

 private:
  static CameraTrialStep Passed(std::string detail) { return {"", true, std::move(detail)}; }
  static CameraTrialStep Failed(std::string detail) { return {"", false, std::move(detail)}; }

  // One that the camera can make.
  ExposureTime Clamped(double seconds) const {
    const double quantum_s = info_.exposure_quantum_s;
    if (quantum_s > 0.0) seconds = std::round(seconds / quantum_s) * quantum_s;
    return std::clamp(ExposureTime::Seconds(seconds), info_.shortest, info_.longest);
  }
  ExposureRequest Request(ExposureTime time) {
    ExposureRequest request;
    request.trigger = TriggerId{next_trigger_++};
    request.exposure.time = time;
    request.trigger_time = clock_.Now();
    return request;
  }
  Result<CameraFrame> Take(ExposureTime time) {
    return TakeOnePicture(camera_, Request(time), options_.frame_timeout);
  }
  // What has come, and what comes until nothing does for `timeout`.
  Status Collect(Nanoseconds timeout, std::vector<CameraFrame>* frames) {
    Result<CameraFrame> frame = camera_.Receive(timeout);
    if (!frame) {
      if (frame.error().kind == ErrorKind::kTemporary) return {};
      return Forward(std::move(frame.error()));
    }
    frame->pixels = {};
    frames->push_back(*std::move(frame));
    return {};
  }

  Camera& camera_;
  CameraInfo info_;
  const CameraTrialOptions& options_;
  const SystemClock clock_;
  std::optional<ExposureTime> usable_;  // of the ladder: shows the scene, not clipped
  std::uint64_t next_trigger_ = 0;
};

}  // namespace

Result<CameraFrame> TakeOnePicture(Camera& camera, const ExposureRequest& request,
                                   Nanoseconds timeout) {
  const SystemClock clock;
  const HostTime deadline = clock.Now() + timeout;
  while (true) {
    const Status commanded = camera.Trigger(request);
    if (commanded) break;
    if (commanded.error().kind != ErrorKind::kTemporary || clock.Now() >= deadline) {
      return Fail(commanded.error().kind, "{}", commanded.error().message);
    }
    std::this_thread::sleep_for(kAgain);
  }
  return camera.Receive(timeout);
}

double MeanLevel(const CameraFrame& frame, int bits) {
  const double most = std::exp2(bits) - 1.0;
  return std::visit(
      [&](const auto& pixels) {
        double sum = 0.0;
        for (const auto value : pixels.values()) sum += static_cast<double>(value);
        return pixels.empty() ? 0.0 : sum / (most * static_cast<double>(pixels.size()));
      },
      frame.pixels);
}

std::vector<CameraTrialStep> RunCameraTrial(
    Camera& camera, const CameraInfo& info, const CameraTrialOptions& options,
    const std::function<void(const CameraTrialStep&)>& told) {
  Trial trial(camera, info, options);
  std::vector<CameraTrialStep> steps;
  const auto add = [&](const char* name, CameraTrialStep step) {
    step.name = name;
    told(step);
    steps.push_back(std::move(step));
    return steps.back().passed;
  };
  bool goes_on = add("start and stop", trial.Starts());
  goes_on = goes_on && add("exposures", trial.Ladder());
  goes_on = goes_on && add("latency", trial.Latency());
  goes_on = goes_on && add("triggers", trial.Accounting());
  if (goes_on && options.ask) add("unplug", trial.Unplug());
  camera.Stop();
  return steps;
}

}  // namespace omnihdr
