#include "drivers/sim/movers.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>

#include "core/image/image_io.h"
#include "core/session/session_reader.h"
#include "drivers/sim/simulation.h"
#include "drivers/sim/world.h"

namespace omnihdr::sim::movers_test {
namespace {

const Projection kProjection = Projection::Equirectangular(256, 128);

const World& TheYard() {
  static const std::shared_ptr<const World> world = World::Create(SceneKind::kYard, 3);
  return *world;
}

Simulation WithMovers(int count) {
  Simulation simulation;
  simulation.scene = SceneKind::kYard;
  simulation.seed = 3;
  simulation.width = 256;
  simulation.movers.count = count;
  return simulation;
}

RenderedView RenderAt(const Simulation& simulation, double odometer_m) {
  const World& world = TheYard();
  const MoverGroup movers = simulation.MoversAt(world, simulation.PlanWalks(world), odometer_m);
  return world.Render(simulation.PoseAt(world, odometer_m), kProjection, 4, &movers);
}

bool SameBytes(const Image<float>& a, const Image<float>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

double AreaOf(const Image<float>& share) {
  double area = 0.0;
  for (int y = 0; y < share.height(); ++y) {
    for (int x = 0; x < share.width(); ++x) {
      area += static_cast<double>(share.at(x, y)) * kProjection.PixelSolidAngle(y);
    }
  }
  return area;
}

TEST(Movers, OutsideThemAndBehindThemTheWorldIsWhatItIsWithout) {
  const Simulation simulation = WithMovers(3);
  const RenderedView with = RenderAt(simulation, 0.6);
  const RenderedView without = TheYard().Render(simulation.PoseAt(TheYard(), 0.6), kProjection, 4);
  EXPECT_TRUE(SameBytes(with.background, without.radiance));
  EXPECT_TRUE(SameBytes(with.background_distance, without.distance));
  int covered = 0;
  for (int y = 0; y < kProjection.height(); ++y) {
    for (int x = 0; x < kProjection.width(); ++x) {
      if (with.movers.at(x, y) > 0.0F) {
        ++covered;
        continue;
      }
      for (int c = 0; c < 3; ++c) {
        ASSERT_EQ(with.radiance.at(x, y, c), without.radiance.at(x, y, c)) << x << ", " << y;
      }
    }
  }
  EXPECT_GT(covered, 30);
  EXPECT_TRUE(without.movers.empty());
}

TEST(Movers, APersonFacesTheCameraWithTheAreaOfAPerson) {
  // At r metres 1.75 m by 0.4 to 0.5 m, at the distances where walks are: 1 to 5 m.
  const RenderedView view = RenderAt(WithMovers(1), 0.0);
  const double area = AreaOf(view.movers);
  EXPECT_GT(area, 0.5 * 1.7 * 0.35 / 25.0);
  EXPECT_LT(area, 1.75 * 0.5 / 0.8);
  for (int y = 0; y < kProjection.height(); ++y) {
    for (int x = 0; x < kProjection.width(); ++x) {
      if (view.movers.at(x, y) < 1.0F) continue;
      EXPECT_LT(view.distance.at(x, y), view.background_distance.at(x, y));
      EXPECT_GT(view.distance.at(x, y), 0.5F);
      EXPECT_GT(view.radiance.at(x, y, 1), 0.0F);
    }
  }
}

TEST(Movers, WalkAsFarAsTheirSpeedSaysAndStandWhenTheVehicleDoes) {
  Simulation simulation = WithMovers(2);
  const RenderedView first = RenderAt(simulation, 0.9);
  EXPECT_TRUE(SameBytes(first.radiance, RenderAt(simulation, 0.9).radiance));
  simulation.movers.speed = 0.0;
  const RenderedView slow = RenderAt(simulation, 0.9);
  EXPECT_FALSE(SameBytes(first.movers, slow.movers));
  EXPECT_TRUE(SameBytes(first.background, slow.background));
}

TEST(Movers, KeepOffTheVehiclesWayInEveryScene) {
  for (const SceneKind kind :
       {SceneKind::kHall, SceneKind::kYard, SceneKind::kTunnel, SceneKind::kStreet}) {
    const auto world = World::Create(kind, 1);
    MoverOptions options;
    options.count = 4;
    const std::vector<Walk> walks = world->PlanWalks(options, 0.0);
    EXPECT_EQ(walks.size(), 4U) << ToString(kind);
    for (const Walk& walk : walks) {
      EXPECT_GE(Length(walk.to - walk.from), 1.5F);
      for (double s = -1.0; s < 6.0; s += 0.1) {
        const Pose pose = world->PoseAt(s);
        for (float u = 0.0F; u <= 1.0F; u += 0.1F) {
          const Vec3 at = Lerp(walk.from, walk.to, u);
          EXPECT_GT(std::hypot(static_cast<double>(at.x) - pose.translation.x(),
                               static_cast<double>(at.y) - pose.translation.y()),
                    0.8);
        }
      }
    }
  }
}

TEST(Movers, AWrittenSessionTellsOfThemAndHasAMaskAFrame) {
  const std::filesystem::path session =
      std::filesystem::path(::testing::TempDir()) / "omnihdr_movers_test_session";
  std::filesystem::remove_all(session);
  SimulateOptions options;
  options.simulation = WithMovers(2);
  options.simulation.samples = 1;
  options.positions = 2;
  options.bracket.exposures = {ExposureTime::Seconds(0.001), ExposureTime::Seconds(0.004)};
  options.created = "2020-01-01T00:00:00Z";
  ASSERT_TRUE(WriteSimulatedSession(session, options, {}));
  const Result<SessionContents> contents = ReadSession(session);
  ASSERT_TRUE(contents) << contents.error().message;
  const Result<Simulation> read = ParseSimulation(contents->info.extra_json);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->movers.count, 2);
  EXPECT_EQ(read->movers.speed, options.simulation.movers.speed);
  for (const FrameRecord& frame : contents->journal.frames) {
    const Result<DecodedImage> mask =
        ReadImage(session / "movers" / std::filesystem::path(frame.file).filename());
    ASSERT_TRUE(mask) << mask.error().message;
    EXPECT_EQ(mask->width(), 256);
    EXPECT_EQ(mask->height(), 128);
  }
  std::filesystem::remove_all(session);
}

TEST(Movers, AWorldWithoutThemIsDescribedAsBefore) {
  EXPECT_EQ(FormatSimulation(WithMovers(0)).find("mover"), std::string::npos);
  EXPECT_NE(FormatSimulation(WithMovers(1)).find("mover"), std::string::npos);
}

TEST(Movers, OptionsOutOfRangeAreRefusedByName) {
  MoverOptions options;
  options.count = 17;
  EXPECT_NE(options.Validate().error().message.find("movers: 17: expected 0 to 16"),
            std::string::npos);
  options.count = 1;
  options.speed = -1.0;
  EXPECT_NE(options.Validate().error().message.find("mover_speed: -1"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::sim::movers_test
