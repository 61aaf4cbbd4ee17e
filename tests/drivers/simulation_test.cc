#include "drivers/sim/simulation.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>

#include "core/base/file.h"
#include "core/session/session_reader.h"
#include "core/sphere/geodesy.h"

namespace omnihdr::sim::simulation_test {
namespace {

namespace fs = std::filesystem;

class SimulatedSession : public testing::Test {
 protected:
  void SetUp() override {
    root_ =
        fs::temp_directory_path() / ("omnihdr-simulation-" + std::to_string(getpid()) + "-" +
                                     testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(root_);
    options_.simulation.scene = SceneKind::kTunnel;
    options_.simulation.width = 128;
    options_.simulation.samples = 1;
    options_.positions = 3;
    options_.created = "2026-01-01T00:00:00Z";
  }
  void TearDown() override { fs::remove_all(root_); }

  fs::path root_;
  SimulateOptions options_;
};

TEST_F(SimulatedSession, EqualOptionsGiveEqualBytes) {
  ASSERT_TRUE(WriteSimulatedSession(root_ / "a", options_, {}));
  ASSERT_TRUE(WriteSimulatedSession(root_ / "b", options_, {}));
  for (const char* name : {"session.json", "frames.jsonl", "raw/000000.png", "raw/000002.png"}) {
    EXPECT_EQ(ReadFile(root_ / "a" / name).value(), ReadFile(root_ / "b" / name).value()) << name;
  }
  EXPECT_NE(ReadFile(root_ / "a/raw/000000.png").value(),
            ReadFile(root_ / "a/raw/000002.png").value());
}

TEST_F(SimulatedSession, ADataMatrixHasEveryExposureAtEveryPosition) {
  options_.bracket.frames_per_position = 3;
  options_.positions = 2;
  options_.spacing_m = 0.5;
  ASSERT_TRUE(WriteSimulatedSession(root_, options_, {}));
  const Result<SessionContents> session = ReadSession(root_);
  ASSERT_TRUE(session) << session.error().message;
  ASSERT_EQ(session->journal.frames.size(), 6U);
  for (std::size_t i = 0; i < 6; ++i) {
    const FrameRecord& frame = session->journal.frames[i];
    EXPECT_EQ(Value(frame.position), static_cast<std::int64_t>(i / 3));
    EXPECT_NEAR(frame.exposure.time.seconds(), 0.001 * static_cast<double>(1U << (2 * (i % 3))),
                1e-9);
    EXPECT_NEAR(*frame.odometer_m, 0.5 * static_cast<double>(i / 3), 1e-12);
  }
}

TEST_F(SimulatedSession, TheJournalCarriesTheTruthAndTheOdometerOnlyWhenWanted) {
  options_.write_odometer = false;
  options_.simulation.start_m = 4.0;
  ASSERT_TRUE(WriteSimulatedSession(root_, options_, {}));
  const Result<SessionContents> session = ReadSession(root_);
  ASSERT_TRUE(session) << session.error().message;
  const Result<Simulation> simulation = ParseSimulation(session->info.extra_json);
  ASSERT_TRUE(simulation) << simulation.error().message;
  const auto world = World::Create(simulation->scene, simulation->seed);
  for (const FrameRecord& frame : session->journal.frames) {
    EXPECT_FALSE(frame.odometer_m);
    const auto truth = nlohmann::json::parse(frame.truth_json);
    const Pose pose = world->PoseAt(4.0 + 0.3 * static_cast<double>(Value(frame.position)));
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(truth["pose"]["t"][static_cast<std::size_t>(axis)].get<double>(),
                  pose.translation[axis], 1e-12);
    }
  }
}

TEST_F(SimulatedSession, FixesAreWhereTheCameraIsToWithinTheirStatedNoise) {
  options_.gnss_sigma_m = 0.5;
  options_.positions = 12;
  options_.spacing_m = 2.0;
  ASSERT_TRUE(WriteSimulatedSession(root_, options_, {}));
  const Result<SessionContents> session = ReadSession(root_);
  ASSERT_TRUE(session) << session.error().message;
  const auto world = World::Create(options_.simulation.scene, options_.simulation.seed);
  const auto place = [&](std::size_t i) {
    const GnssFix& fix = *session->journal.frames[i].gnss;
    return GeodeticPlace{fix.lat_deg, fix.lon_deg, fix.alt_m};
  };
  double squares = 0.0;
  for (std::size_t i = 1; i < 12; ++i) {
    ASSERT_TRUE(session->journal.frames[i].gnss);
    EXPECT_DOUBLE_EQ(session->journal.frames[i].gnss->error_m.value_or(0.0),
                     0.5 * std::numbers::sqrt2);
    const Eigen::Vector3d driven =
        world->PoseAt(2.0 * static_cast<double>(i)).translation - world->PoseAt(0.0).translation;
    const Eigen::Vector3d off = EastNorthUp(place(0), place(i)) - driven;
    squares += off.head<2>().squaredNorm();
  }
  // Two fixes with noise on two axes each.
  EXPECT_GT(std::sqrt(squares / 11 / 4), 0.2);
  EXPECT_LT(std::sqrt(squares / 11 / 4), 1.0);
}

TEST(Simulation, ItsJsonComesBackAndWrongValuesAreNamed) {
  Simulation simulation;
  simulation.scene = SceneKind::kStreet;
  simulation.seed = 42;
  simulation.width = 640;
  simulation.projection = ProjectionKind::kCylindrical;
  simulation.motion = {12.5, 2.0};
  simulation.sensor.full_well_e = 8000.0;
  const Result<Simulation> again = ParseSimulation(FormatSimulation(simulation));
  ASSERT_TRUE(again) << again.error().message;
  EXPECT_EQ(FormatSimulation(*again), FormatSimulation(simulation));
  const auto message = [](const char* json) {
    const Result<Simulation> parsed = ParseSimulation(json);
    return parsed ? std::string() : parsed.error().message;
  };
  EXPECT_NE(message(R"({"simulation": {"scene": "moon"}})").find("simulation.scene"),
            std::string::npos);
  EXPECT_NE(message(R"({"simulation": {"width": 1}})").find("simulation.width: 1"),
            std::string::npos);
  EXPECT_NE(message(R"({"simulation": {"seed": "one"}})").find("simulation.seed"),
            std::string::npos);
  EXPECT_NE(message("{").find("simulation"), std::string::npos);
  EXPECT_NE(message(R"({"simulation": 3})").find("simulation"), std::string::npos);
}

TEST(Simulation, ACylinderReachesAsFarAsSaidWithSquarePixelsAtTheHorizon) {
  Simulation simulation;
  simulation.projection = ProjectionKind::kCylindrical;
  const Projection projection = simulation.MakeProjection();
  EXPECT_EQ(projection.width(), 1536);
  EXPECT_EQ(projection.height(), 1152);
  EXPECT_NEAR(projection.z_max(), 2.356, 1e-12);
}

}  // namespace
}  // namespace omnihdr::sim::simulation_test
