#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/capture/capture_controller.h"
#include "tests/unit/core/capture/simulated.h"

namespace omnihdr::testing_capture {

// 12.5 m at one second.
struct SteadyWay final : public PositionSource {
  std::optional<double> OdometerMetres(HostTime at) const override {
    return 12.5 + metres_per_s * (static_cast<double>(at.ns()) * 1e-9 - 1.0);
  }
  double metres_per_s = 0.0;
};

inline BracketPlan Sawtooth(int frames_per_position = 1) {
  BracketOptions options;
  options.frames_per_position = frames_per_position;
  return BracketPlan::Make(options, {}).value();
}

// The controller with a camera that only notes what it is asked.
struct Bench {
  explicit Bench(std::size_t buffers = 4, std::size_t lines = 1000, std::uint64_t first = 0,
                 int frames_per_position = 1, const CaptureOptions& options = {})
      : sink(buffers, lines),
        controller(
            Sawtooth(frames_per_position), SmallCamera(), options, TriggerId{first}, sink,
            [this](const ExposureRequest& request) -> Status {
              if (!refusal.empty()) return Fail(ErrorKind::kTemporary, "{}", refusal);
              commanded.push_back(request);
              return {};
            },
            &positions, clock) {}

  Result<AcceptedTrigger> TryTrigger(std::uint64_t lost_before = 0) {
    TriggerEvent event;
    event.time = clock.Now();
    event.lost_before = lost_before;
    return controller.OnTrigger(event);
  }
  void Trigger(std::uint64_t lost_before = 0) { EXPECT_TRUE(TryTrigger(lost_before)); }
  const FrameRecord& record(std::size_t i) const { return sink.lines.at(i).record; }

  SimulatedClock clock;
  SteadyWay positions;
  KeepingSink sink;
  std::string refusal;
  std::vector<ExposureRequest> commanded;
  CaptureController controller;
};

}  // namespace omnihdr::testing_capture
