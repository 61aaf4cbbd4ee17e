#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "core/base/clock.h"

namespace omnihdr::iidc {

// Turns the camera's wrapping cycle time into one that grows, and into host time. Every frame tells
// that its moment in camera time lies between two host times (the command before it, its arrival
// after it); the offset between the clocks is what all recent frames agree with, their difference
// in speed allowed for. Law: while the clocks drift less than kMaxDriftPpm, ToHost is off by no
// more than uncertainty(). A frame that contradicts all that is known is not believed: fewer than
// kJumpFrames in a row are outliers; as many that agree with each other are a clock that has jumped
// (a restart), and begin a new fit. Meanwhile ToHost knows nothing. One thread.
class CameraClock {
 public:
  static constexpr double kMaxDriftPpm = 200.0;
  static constexpr std::size_t kMaxFrames = 64;
  static constexpr std::size_t kJumpFrames = 3;

  // The camera's time of a cycle time in nanoseconds (0 to 128 s) that arrived at a host time.
  // Host times must not go back by more than 30 s.
  CameraTime Unwrap(std::int64_t cycle_ns, HostTime arrived);
  // The camera's time `camera` was at some host time from `earliest` to `latest`.
  void Add(CameraTime camera, HostTime earliest, HostTime latest);
  // Nothing before the first Add, and while it is not clear whether the clock has jumped.
  std::optional<HostTime> ToHost(CameraTime camera) const;
  // Half the range of host times that ToHost's answer stands for.
  Nanoseconds uncertainty(CameraTime camera) const;
  // Forgets the fit, not the counts.
  void Reset();
  std::uint64_t jumps() const { return jumps_; }
  std::uint64_t outliers() const { return outliers_; }

 private:
  struct Bounds {
    CameraTime camera;
    std::int64_t low_ns;  // host − camera
    std::int64_t high_ns;
  };
  // The range of offsets at a camera time; low > high when the frames contradict each other.
  static Bounds At(const std::deque<Bounds>& frames, CameraTime camera);
  static bool Contradict(const Bounds& added, const std::deque<Bounds>& frames);

  std::deque<Bounds> frames_;
  std::deque<Bounds> suspects_;  // the newest ones, which contradict frames_ and agree
  std::uint64_t jumps_ = 0;
  std::uint64_t outliers_ = 0;
  std::optional<std::int64_t> last_cycle_ns_;
  HostTime last_arrived_;
  std::int64_t last_camera_ns_ = 0;
};

}  // namespace omnihdr::iidc
