#pragma once

#include <deque>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/base/clock.h"
#include "core/capture/capture_controller.h"
#include "core/capture/recorder.h"
#include "core/ports/camera.h"

namespace omnihdr::testing_capture {

class SimulatedClock final : public Clock {
 public:
  HostTime Now() const override { return now_; }
  UtcTime NowUtc() const override { return UtcTime::FromNanoseconds(kUtcOffset + now_.ns()); }
  void Advance(Nanoseconds by) { now_ = now_ + by; }
  static constexpr std::int64_t kUtcOffset = 1'700'000'000'000'000'000;

 private:
  HostTime now_ = HostTime::FromNanoseconds(1'000'000'000);
};

// A sink with a fixed room that keeps what it is given.
class KeepingSink final : public CaptureSink {
 public:
  explicit KeepingSink(std::size_t buffer_room = 4, std::size_t line_room = 1000)
      : free_buffers(buffer_room), free_lines(line_room) {}
  bool TryReserveLine() override {
    if (free_lines == 0) return false;
    --free_lines;
    return true;
  }
  void ReleaseLine() override { ++free_lines; }
  bool TryReserveBuffer() override {
    if (free_buffers == 0) return false;
    --free_buffers;
    return true;
  }
  void ReleaseBuffer() override { ++free_buffers; }
  void Submit(CaptureLine line) override { lines.push_back(std::move(line)); }

  std::size_t free_buffers;
  std::size_t free_lines;
  std::vector<CaptureLine> lines;
};

inline CameraDescription SmallCamera() {
  CameraDescription description;
  description.model = "test";
  description.width = 8;
  description.height = 4;
  return description;
}

// What a faultless camera answers to a request.
inline CameraFrame FrameFor(const ExposureRequest& request, std::uint64_t counter = 0) {
  CameraFrame frame;
  frame.trigger = request.trigger;
  frame.camera_counter = counter;
  frame.measured_exposure = request.exposure;
  frame.proof = ExposureProof::kEmbedded;
  frame.mid_exposure = request.trigger_time + std::chrono::milliseconds(5);
  frame.pixels = Image<std::uint8_t>(8, 4, 3, static_cast<std::uint8_t>(Value(request.trigger)));
  return frame;
}

}  // namespace omnihdr::testing_capture
