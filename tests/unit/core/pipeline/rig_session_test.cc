#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/pipeline/frame_measurer.h"
#include "core/session/rig_file.h"
#include "core/session/session_reader.h"
#include "core/session/session_rig.h"
#include "core/session/view_writer.h"
#include "tests/support/rig_session.h"
#include "tests/support/ring.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::rig_session_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::ProcessAll;
using testing::Processed;
using testing::TemporaryDirectory;

// Balls in the room, and a drive through it.
testing::Room Hall() {
  testing::Room room;
  room.detail_m = 1.2;  // a mosaic of this size cannot show more
  room.balls.push_back({{2.5, 1.6, 0.0}, 0.6, 1.0F});
  return room;
}

// Share of a view's pixels off by more than 15 % in green, of those that have a value.
struct Quality {
  double off = 0.0;
  double valid = 0.0;
};
Quality Judge(const fs::path& view, const Pose& world_from_camera,
              const Eigen::Quaterniond& camera_from_output) {
  const ExrImage exr = ReadExr(view / "radiance.exr").value();
  const Projection projection = Projection::Equirectangular(exr.width, exr.height);
  const testing::Truth truth = testing::Render(
      Hall(), projection, world_from_camera * Pose{camera_from_output, Eigen::Vector3d::Zero()});
  Quality quality;
  for (int y = 0; y < exr.height; ++y) {
    for (int x = 0; x < exr.width; ++x) {
      const float got = exr.channels.at("G").at(x, y);
      if (!std::isfinite(got) || exr.channels.at("origin").at(x, y) == 0.0F) continue;
      quality.valid += 1.0;
      const float want = truth.radiance.at(x, y, 1);
      quality.off += std::abs(got / want - 1.0F) > 0.15F ? 1.0 : 0.0;
    }
  }
  quality.off /= std::max(1.0, quality.valid);
  quality.valid /= static_cast<double>(exr.width) * exr.height;
  return quality;
}

TEST(RigSession, ABracketTakenStandingStillBecomesARadiancePanorama) {
  const TemporaryDirectory directory;
  const Rig rig = testing::MakeRing({.sphere_radius_m = 4.0});
  testing::WriteRigSession(directory.path(), rig, Hall(), {Pose{}}, {0.1, 0.5, 2.5}, 3);
  PipelineOptions options = testing::QuickOptions();
  options.mode = ProcessMode::kTemporal;
  const Processed done = ProcessAll(directory.path(), {}, options);
  EXPECT_THAT(done.said.warnings, IsEmpty());
  EXPECT_THAT(done.said.Positions(), ElementsAre(0));
  const fs::path view = directory.path() / "views" / "000000";
  const ExrImage exr = ReadExr(view / "radiance.exr").value();
  EXPECT_EQ(exr.width, NaturalPanoramaWidth(rig));
  EXPECT_EQ(exr.height, exr.width / 2);
  const Quality quality = Judge(view, Pose{}, Eigen::Quaterniond::Identity());
  EXPECT_GT(quality.valid, 0.75);
  EXPECT_LT(quality.off, 0.06);
}

TEST(RigSession, AnEdgeAwareMosaicIsNearerToTheScene) {
  const TemporaryDirectory directory;
  testing::WriteRigSession(directory.path(), testing::MakeRing({.sphere_radius_m = 4.0}), Hall(),
                           {Pose{}}, {0.1, 0.5, 2.5}, 3);
  const auto off = [&](Demosaic demosaic) {
    const TemporaryDirectory out;
    PipelineOptions options = testing::QuickOptions();
    options.mode = ProcessMode::kTemporal;
    options.demosaic = demosaic;
    ProcessAll(directory.path(), out.path(), options);
    return Judge(out.path() / "views" / "000000", Pose{}, Eigen::Quaterniond::Identity()).off;
  };
  EXPECT_LT(off(Demosaic::kEdgeAware), 0.8 * off(Demosaic::kBilinear));
}

TEST(RigSession, ADriveBecomesViewsAsFromPanoramas) {
  const TemporaryDirectory directory;
  const std::vector<Pose> poses = testing::GentleBend(4, 0.2);
  testing::WriteRigSession(directory.path(), testing::MakeRing({.sphere_radius_m = 4.0}), Hall(),
                           poses, {0.25, 0.5, 1.0}, 1);
  const Processed done = ProcessAll(directory.path());
  EXPECT_THAT(done.said.warnings, IsEmpty());
  EXPECT_THAT(done.said.Positions(), ElementsAre(0, 1, 2, 3));
  for (int k = 0; k < 4; ++k) {
    const fs::path view = directory.path() / "views" / ViewDirectoryName(PositionId{k});
    const ViewRecord record = ReadViewRecord(directory.path() / "views", PositionId{k}).value();
    EXPECT_EQ(record.mode, "spatiotemporal");
    const Quality quality = Judge(view, poses[static_cast<std::size_t>(k)], record.orientation);
    EXPECT_GT(quality.valid, 0.75) << k;
    EXPECT_LT(quality.off, 0.12) << k;
    EXPECT_TRUE(fs::exists(view / "disparity.exr"));
  }
  // A processor that goes on later writes the same bytes.
  const TemporaryDirectory again;
  {
    testing::Said said;
    const auto half = testing::OpenProcessor(directory.path(), &said, again.path());
    ASSERT_NE(half, nullptr);
    for (int k = 0; k < 3; ++k) ASSERT_TRUE(half->Step());
  }
  ProcessAll(directory.path(), again.path());
  EXPECT_TRUE(
      testing::SameBytes(testing::ViewBytes(directory.path()), testing::ViewBytes(again.path())));
}

class RigMeasurer : public ::testing::Test {
 protected:
  void SetUp() override {
    rig_ = testing::MakeRing();
    info_ = testing::RigInfo(rig_);
    WriteRig();
  }
  void WriteRig() { testing::WriteText(path() / "rig.toml", FormatRig(rig_)); }
  void WriteMask(const std::string& name, const Image<std::uint8_t>& mask) {
    const std::vector<std::byte> png = EncodePng(mask.view()).value();
    testing::WriteText(path() / name, {reinterpret_cast<const char*>(png.data()), png.size()});
  }
  std::string Refusal(ImageView<const std::uint8_t> mask = {}) {
    const Result<FrameMeasurer> measurer = FrameMeasurer::Open(path(), info_, mask, "m.png");
    return measurer ? "" : measurer.error().message;
  }
  // Share of the panorama that is masked in a picture of a grey scene.
  double Masked(ImageView<const std::uint8_t> mask = {}) {
    FrameMeasurer measurer = FrameMeasurer::Open(path(), info_, mask).value();
    const DecodedImage image = testing::ShootRing(
        rig_, [](const Eigen::Vector3d&) { return Eigen::Vector3d(0.7, 0.7, 0.7); }, 10.0, 1.0);
    const std::vector<ExposedFrame> frames = {{&image, {ExposureTime::Seconds(1.0), GainDb{}}}};
    const Measurement m = measurer.Measure(frames, {}).value();
    const auto masked = std::count(m.flags.values().begin(), m.flags.values().end(), kMasked);
    return static_cast<double>(masked) / static_cast<double>(m.flags.size());
  }
  const fs::path& path() const { return directory_.path(); }

  TemporaryDirectory directory_;
  Rig rig_;
  SessionInfo info_;
};

TEST_F(RigMeasurer, TellsHowFineAndHowLargeTheHeadIs) {
  const FrameMeasurer measurer = FrameMeasurer::Open(path(), info_).value();
  double square = 0.0;
  for (const RigSensor& sensor : rig_.sensors) {
    square += sensor.camera_from_sensor.translation.squaredNorm();
  }
  EXPECT_NEAR(measurer.optics().viewpoint_m,
              std::sqrt(square / static_cast<double>(rig_.sensors.size())), 1e-12);
  // A mosaic's colours stand apart.
  EXPECT_LE(measurer.optics().columns, measurer.projection().width());
  EXPECT_GT(measurer.optics().columns, 0.5 * measurer.projection().width());
}

TEST_F(RigMeasurer, WithoutItsCalibrationASessionIsRefused) {
  fs::remove(path() / "rig.toml");
  EXPECT_THAT(Refusal(), HasSubstr("rig.toml"));
  testing::WriteText(path() / "rig.toml", "format = 7");
  EXPECT_THAT(Refusal(), HasSubstr("rig.toml"));
}

TEST_F(RigMeasurer, FramesThatAreNotTheSensorsStackedAreRefusedWithBothSizes) {
  info_.camera.height = 480;
  EXPECT_THAT(Refusal(), HasSubstr("128x480, expected 128x576"));
  EXPECT_THAT(Refusal(), HasSubstr("session.json"));
}

TEST_F(RigMeasurer, AnotherBayerOrderThanTheRigsIsRefusedWithBoth) {
  info_.camera.bayer = "RGGB";
  EXPECT_THAT(Refusal(), HasSubstr("\"sensor0\""));
  EXPECT_THAT(Refusal(), HasSubstr("\"BGGR\", expected \"RGGB\""));
}

TEST_F(RigMeasurer, AMaskMayCoverTheStackedFrameOrThePanorama) {
  const double plain = Masked();
  Image<std::uint8_t> stacked(128, 576, 1, 255);
  for (int y = 0; y < 96; ++y) std::fill_n(stacked.row(y), 128, std::uint8_t{0});  // sensor 0
  EXPECT_NEAR(Masked(stacked.view()) - plain, 0.10, 0.04);
  Image<std::uint8_t> lower(100, 50, 1, 255);
  for (int y = 25; y < 50; ++y) std::fill_n(lower.row(y), 100, std::uint8_t{0});
  EXPECT_NEAR(Masked(lower.view()), 0.5, 0.01);
  const Image<std::uint8_t> neither(100, 80, 1, 255);
  EXPECT_THAT(Refusal(neither.view()), HasSubstr("m.png: 100x80"));
  EXPECT_THAT(Refusal(neither.view()), HasSubstr("128x576"));
}

TEST_F(RigMeasurer, LensMasksAreReadFromBesideTheRigFile) {
  const double plain = Masked();
  rig_.sensors[2].mask_file = "two.png";
  WriteRig();
  EXPECT_THAT(Refusal(), HasSubstr("two.png"));
  WriteMask("two.png", Image<std::uint8_t>(64, 96, 1, 255));
  EXPECT_THAT(Refusal(), HasSubstr("64x96, expected the size of sensor \"sensor2\", 128x96"));
  WriteMask("two.png", Image<std::uint8_t>(128, 96, 1, 0));
  EXPECT_NEAR(Masked() - plain, 0.10, 0.04);
}

TEST_F(RigMeasurer, ASensorsOwnResponseIsUsed) {
  rig_.sensors[0].response_json = R"({"model": "linear", "black": 32})";
  WriteRig();
  FrameMeasurer measurer = FrameMeasurer::Open(path(), info_).value();
  const DecodedImage image = testing::ShootRing(
      rig_, [](const Eigen::Vector3d&) { return Eigen::Vector3d(0.7, 0.7, 0.7); }, 10.0, 1.0);
  const std::vector<ExposedFrame> frames = {{&image, {ExposureTime::Seconds(1.0), GainDb{}}}};
  const Measurement m = measurer.Measure(frames, {}).value();
  const int width = m.radiance.width();
  // Sensor 0 looks ahead; behind, the session's response holds.
  EXPECT_NEAR(m.radiance.at(width / 2, width / 4, 1), (0.7 * 128.0 - 32.0) / (128.0 - 32.0), 0.02);
  EXPECT_NEAR(m.radiance.at(0, width / 4, 1), 0.7, 0.02);
  rig_.sensors[0].response_json = R"({"model": "cubic"})";
  testing::WriteText(path() / "rig.toml", FormatRig(rig_));
  EXPECT_THAT(Refusal(), HasSubstr("sensor[0].response"));
}

// A sensor's own white level decides what is saturated; one that clips short of what counts as
// usable is told of, once, and of the others nothing.
TEST_F(RigMeasurer, ASensorThatClipsEarlyIsNamedUntilItsWhiteLevelIsKnown) {
  constexpr std::uint8_t kFull = 225;
  const auto bright_ahead = [](const Eigen::Vector3d& at) -> Eigen::Vector3d {
    return Eigen::Vector3d::Constant(0.2 + 3.0 * std::max(0.0, at.normalized().x()));
  };
  const auto measure = [&](FrameMeasurer& measurer, double seconds) {
    DecodedImage image = testing::ShootRing(rig_, bright_ahead, 10.0, seconds);
    auto& pixels = std::get<Image<std::uint8_t>>(image.pixels);
    for (int y = 0; y < rig_.sensors[0].lens.height(); ++y) {  // sensor 0 looks ahead
      for (int x = 0; x < pixels.width(); ++x) pixels.at(x, y) = std::min(pixels.at(x, y), kFull);
    }
    const std::vector<ExposedFrame> frames = {{&image, {ExposureTime::Seconds(seconds), {}}}};
    return measurer.Measure(frames, {}).value();
  };
  const double usable = MeasureOptions{}.value_high;
  FrameMeasurer wrong = FrameMeasurer::Open(path(), info_).value();
  const Measurement taken_for_light = measure(wrong, 1.0);
  EXPECT_FALSE(wrong.WhiteLevelWarning(usable));  // one exposure
  measure(wrong, 2.0);
  const std::optional<std::string> warning = wrong.WhiteLevelWarning(usable);
  ASSERT_TRUE(warning);
  EXPECT_THAT(*warning, HasSubstr("sensor \"sensor0\": clips at value 22"));
  EXPECT_FALSE(wrong.WhiteLevelWarning(usable));  // told
  const int width = taken_for_light.radiance.width();
  EXPECT_EQ(taken_for_light.flags.at(width / 2, width / 4) & kSaturatedAny, 0);

  rig_.sensors[0].response_json = R"({"model": "linear", "white": 225})";
  WriteRig();
  FrameMeasurer right = FrameMeasurer::Open(path(), info_).value();
  measure(right, 2.0);
  const Measurement saturated = measure(right, 1.0);
  EXPECT_FALSE(right.WhiteLevelWarning(usable));
  EXPECT_NE(saturated.flags.at(width / 2, width / 4) & kSaturatedAny, 0);
}

TEST_F(RigMeasurer, TheCalibrationTravelsWithItsMasks) {
  rig_.sensors[1].mask_file = "masks/one.png";
  rig_.sensors[2].mask_file = "masks/one.png";
  WriteRig();
  fs::create_directories(path() / "masks");
  WriteMask("masks/one.png", Image<std::uint8_t>(128, 96, 1, 255));
  info_.files = ReadRigFiles(path()).value();
  EXPECT_EQ(info_.files.size(), 2U);
  const TemporaryDirectory other;
  ASSERT_TRUE(SessionWriter::Create(other.path() / "s", info_));
  EXPECT_EQ(testing::FileText(other.path() / "s" / "rig.toml"),
            testing::FileText(path() / "rig.toml"));
  EXPECT_TRUE(FrameMeasurer::Open(other.path() / "s", info_));

  rig_.sensors[1].mask_file = "../secret.png";
  WriteRig();
  const Result<std::vector<SessionFile>> outside = ReadRigFiles(path());
  ASSERT_FALSE(outside);
  EXPECT_THAT(outside.error().message, HasSubstr("../secret.png"));
  info_.files = {{"../x", ""}};
  EXPECT_FALSE(SessionWriter::Create(other.path() / "t", info_));
  EXPECT_FALSE(fs::exists(other.path() / "x"));
}

}  // namespace
}  // namespace omnihdr::rig_session_test
