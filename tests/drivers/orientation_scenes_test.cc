// The simulator's worlds through its head: a calibration that is right is never called wrong.
#include <gtest/gtest.h>

#include <numbers>

#include "core/photometry/rig_orientation.h"
#include "drivers/sim/rig_optics.h"
#include "drivers/sim/simulation.h"
#include "drivers/sim/world.h"

namespace omnihdr::orientation_scenes_test {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

struct Counts {
  int agrees = 0;
  int contradicted = 0;
};

void Count(const Rig& rig, const Image<std::uint8_t>& frame, Counts* counts) {
  auto check = OrientationCheck::Create(rig);
  ASSERT_TRUE(check) << check.error().message;
  ASSERT_TRUE(check->Add(frame.view()));
  const OrientationReport report = check->Report();
  counts->agrees += report.verdict == OrientationVerdict::kAgrees ? 1 : 0;
  counts->contradicted += report.verdict == OrientationVerdict::kContradicted ? 1 : 0;
  EXPECT_NE(report.verdict, OrientationVerdict::kContradicted) << report.Text();
}

TEST(OrientationOfSimulatedHeads, IsNeverCalledWrongInAnySceneAndIsSeenWhereThePicturesTell) {
  Counts right;
  Counts off;
  int frames = 0;
  for (const sim::SceneKind scene : {sim::SceneKind::kHall, sim::SceneKind::kYard,
                                     sim::SceneKind::kTunnel, sim::SceneKind::kStreet}) {
    for (const std::uint64_t seed : {1, 2}) {
      sim::Simulation simulation;
      simulation.scene = scene;
      simulation.seed = seed;
      simulation.layout = Layout::kRig;
      simulation.sensor_width = 128;
      simulation.samples = 1;
      const auto world = sim::World::Create(scene, seed);
      const Result<Rig> rig = simulation.MakeRig();
      ASSERT_TRUE(rig) << rig.error().message;
      const sim::RigOptics optics(*rig);
      const Image<float> radiance = optics.Collect(*world, simulation.PoseAt(*world, 1.5), 1);
      // A calibration that is off by a degree or two, each sensor in its own way.
      Rig nominal = *rig;
      for (std::size_t i = 0; i < nominal.sensors.size(); ++i) {
        const double turn = (i % 2 == 0 ? 1.5 : -1.5) * kDegree;
        Eigen::Quaterniond& rotation = nominal.sensors[i].camera_from_sensor.rotation;
        rotation = rotation * Eigen::Quaterniond(Eigen::AngleAxisd(
                                  turn, Eigen::Vector3d::Unit(static_cast<Eigen::Index>(i % 3))));
      }
      for (const double seconds : {0.0005, 0.002, 0.008, 0.05}) {
        const Image<std::uint8_t> frame =
            sim::Expose(radiance.view(), {ExposureTime::Seconds(seconds), GainDb{0.0}},
                        simulation.sensor, seed);
        ASSERT_NO_FATAL_FAILURE(Count(*rig, frame, &right));
        ASSERT_NO_FATAL_FAILURE(Count(nominal, frame, &off));
        ++frames;
      }
    }
  }
  EXPECT_EQ(right.contradicted + off.contradicted, 0);
  // Every bracket has a frame that tells.
  EXPECT_GE(right.agrees, frames / 4) << "of " << frames;
}

}  // namespace
}  // namespace omnihdr::orientation_scenes_test
