#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/ports/camera.h"

namespace omnihdr::compliance {

// A camera under test and what the suite may expect of it. One of these per camera makes it take
// the whole suite (camera_compliance_test.cc).
struct Rig {
  std::shared_ptr<void> surroundings;  // what the camera needs as long as it lives
  std::unique_ptr<Camera> camera;
  // Exposures to ask for, within the camera's limits, shortest first.
  std::vector<ExposureTime> ladder;
  // The exposure of trigger n when the camera does not follow requests (replay).
  std::function<std::optional<Exposure>(std::uint64_t trigger)> fixed_exposure;
  // Triggers that can be given from number 0 on before the camera runs out.
  std::uint64_t triggers = 1'000'000;
  // Longest time from trigger to frame.
  Nanoseconds frame_timeout = std::chrono::seconds(5);
  // Takes the device away and brings it back; empty when that cannot be done.
  std::function<void()> unplug;
  std::function<void()> plug_in;
};

struct RigFactory {
  std::string name;
  std::function<Rig()> make;
};
// For readable test names.
inline void PrintTo(const RigFactory& factory, std::ostream* out) { *out << factory.name; }

// The cameras that take the suite in this program (rigs_test.cc, tests/kernel/compliance_rigs.cc).
std::vector<RigFactory> AllRigs();

}  // namespace omnihdr::compliance
