// A head whose rig file is another one's: found by the tool and by the daemon, which goes on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "core/session/rig_file.h"
#include "daemon/api/client.h"
#include "drivers/sim/simulation.h"
#include "tests/integration/daemon_fixture.h"

namespace omnihdr::rig_file_test {
namespace {

using integration::RunOmnihdr;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

constexpr int kPositions = 5;

class HeadOfTheWrongRigFile : public integration::DaemonFixture {
 protected:
  void Record() {
    sim::SimulateOptions options;
    options.simulation.scene = sim::SceneKind::kYard;
    options.simulation.layout = Layout::kRig;
    options.simulation.sensor_width = 256;
    options.simulation.samples = 1;
    options.bracket.exposures = {ExposureTime::Seconds(0.002)};
    options.positions = kPositions;
    options.write_odometer = false;
    const Status written = sim::WriteSimulatedSession(directory() / "source", options, {});
    ASSERT_TRUE(written) << written.error().message;
  }
  // The head's first two sensors have each other's place.
  void ExchangePoses() const {
    const fs::path file = directory() / "source" / "rig.toml";
    Result<Rig> rig = ReadRig(file);
    ASSERT_TRUE(rig) << rig.error().message;
    std::swap(rig->sensors[0].camera_from_sensor, rig->sensors[1].camera_from_sensor);
    std::ofstream(file) << FormatRig(*rig);
  }
};

TEST_F(HeadOfTheWrongRigFile, TheToolSaysWhichMistakeItIsWithAnExitCodeOfItsOwn) {
  ASSERT_NO_FATAL_FAILURE(Record());
  const std::string session = (directory() / "source").string();
  const auto [right, agrees] =
      RunOmnihdr({"calibrate", "verify", "--session", session}, directory());
  EXPECT_EQ(right, 0) << agrees;
  EXPECT_THAT(agrees, HasSubstr("agrees: neighbouring sensors show the same"));
  ASSERT_NO_FATAL_FAILURE(ExchangePoses());
  const auto [wrong, contradicted] =
      RunOmnihdr({"calibrate", "verify", "--session", session}, directory());
  EXPECT_EQ(wrong, 65) << contradicted;
  EXPECT_THAT(contradicted, HasSubstr("they would agree if sensors \"0\" and \"1\" are exchanged"));
  EXPECT_EQ(RunOmnihdr({"calibrate", "verify"}, directory()).first, 64);
}

TEST_F(HeadOfTheWrongRigFile, TheDaemonNamesItIsDegradedAndGoesOnTakingPictures) {
  ASSERT_NO_FATAL_FAILURE(Record());
  ASSERT_NO_FATAL_FAILURE(ExchangePoses());
  WriteConfig(ReplayCamera("replay"), "[pipeline]\nenabled = false\n");
  const auto daemon = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["orientation"]["what"] == "contradicted"; }))
      << daemon->Log();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == kPositions; }))
      << daemon->Log();
  EXPECT_EQ(StatusNow()["frames_dropped"], 0);
  EXPECT_THAT(StatusNow()["orientation"]["text"].get<std::string>(),
              HasSubstr("sensors \"0\" and \"1\" are exchanged"));
  EXPECT_THAT(daemon->Log(), HasSubstr("orientation: neighbouring sensors contradict"));
  EXPECT_THAT(Client().GetText("/metrics").value(),
              HasSubstr("omnihdr_orientation_contradicted 1\n"));
}

TEST_F(HeadOfTheWrongRigFile, ItIsNotLookedForWhereThatIsNotWanted) {
  ASSERT_NO_FATAL_FAILURE(Record());
  ASSERT_NO_FATAL_FAILURE(ExchangePoses());
  WriteConfig(ReplayCamera("replay"), "[pipeline]\nenabled = false\n");
  fs::create_directories(directory() / "omnihdr.d");
  std::ofstream(directory() / "omnihdr.d" / "own.toml") << "camera.check_orientation = false\n";
  const auto daemon = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == kPositions; }))
      << daemon->Log();
  EXPECT_EQ(StatusNow()["orientation"]["what"], "off");
}

}  // namespace
}  // namespace omnihdr::rig_file_test
