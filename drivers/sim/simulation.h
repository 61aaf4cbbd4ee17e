#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/capture/bracket_plan.h"
#include "core/session/session.h"
#include "core/sphere/rig.h"
#include "drivers/sim/movers.h"
#include "drivers/sim/sensor.h"
#include "drivers/sim/world.h"

namespace omnihdr::sim {

// Everything needed to render a simulated session's truth again: world, way, sensor. Travels in
// session.json as {"simulation": {...}}.
struct Simulation {
  SceneKind scene = SceneKind::kHall;
  std::uint64_t seed = 1;
  // What the camera delivers: panoramas, or stacked raw frames of a rig (kPanorama, kRig).
  Layout layout = Layout::kPanorama;
  ProjectionKind projection = ProjectionKind::kEquirectangular;
  int width = 1536;  // of the panorama, 128 to 8192; its height follows
  // The rig: a rig file, empty = the nominal Ladybug2. Its sensors get so many columns, an even
  // number of 64 to 8192; 0 = as the file says.
  std::string rig_file;
  int sensor_width = 0;
  int samples = 4;       // rays a pixel: 1, 4, 9 or 16
  double start_m = 0.0;  // distance along the path at odometer 0
  MotionOptions motion;
  MoverOptions movers;
  SensorOptions sensor;

  Status Validate() const;  // kConfig error naming the option and its range
  // Equirectangular 2:1, or a cylinder from −67° to +67° (z ±2.356) with square pixels at the
  // horizon.
  Projection MakeProjection() const;
  Pose PoseAt(const World& world, double odometer_m) const {
    return world.PoseAt(start_m + odometer_m, motion);
  }
  // The ways of the movers, to be made once, and the movers where they are at an odometer's
  // reading: at equal readings they stand still.
  std::vector<Walk> PlanWalks(const World& world) const { return world.PlanWalks(movers, start_m); }
  MoverGroup MoversAt(const World& world, const std::vector<Walk>& walks, double odometer_m) const {
    return world.MoversAt(walks, movers.speed * odometer_m);
  }
  // The unit that takes the pictures (layout rig): SimulatedUnit of the rig file, of this seed.
  Result<Rig> MakeRig() const;
  // `rig`: of the layout rig, else null.
  CameraDescription Camera(const Rig* rig = nullptr) const;
};

// {"simulation": {...}} and back; keys that are missing keep their default, unknown ones are
// ignored.
std::string FormatSimulation(const Simulation& simulation);
Result<Simulation> ParseSimulation(const std::string& json);
// A frame's truth: {"pose": {"q", "t"}, "scene", "seed", "odometer_m"}.
std::string FormatTruth(const Simulation& simulation, const Pose& world_from_camera,
                        double odometer_m);

struct SimulateOptions {
  Simulation simulation;
  BracketOptions bracket;
  int positions = 9;       // 1 to 100000
  double spacing_m = 0.3;  // between positions, 0 to 100
  bool write_odometer = true;
  // Satellite fixes with normal noise of so many metres on each horizontal axis, twice that in
  // height; 0 = none.
  double gnss_sigma_m = 0.0;
  std::string created;  // ISO 8601 for session.json; empty = now
  Status Validate() const;
};

// Writes a complete session directory from a simulated drive, as fast as it can: a line and a PNG a
// frame, truth included; with movers also movers/ with a PNG a frame, 255 where one is seen: on the
// frame's own pixels, of a rig on a lat-long picture `width` wide. `progress` (may be empty) hears
// of every frame stored. Equal options (with `created` given) give equal bytes.
Status WriteSimulatedSession(const std::filesystem::path& directory, const SimulateOptions& options,
                             const std::function<void(const FrameRecord&)>& progress);

}  // namespace omnihdr::sim
