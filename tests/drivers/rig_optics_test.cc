#include "drivers/sim/rig_optics.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>

#include "core/base/file.h"
#include "core/photometry/stitch.h"
#include "core/session/rig_file.h"
#include "core/session/session_reader.h"
#include "drivers/sim/simulation.h"

namespace omnihdr::sim::rig_optics_test {
namespace {

std::shared_ptr<const World> Hall() {
  static const auto world = World::Create(SceneKind::kHall, 1);
  return world;
}

TEST(SimulatedUnit, IsTheNominalHeadWithGainsVignettingAndASizeOfItsOwn) {
  const Rig nominal = NominalRig().value();
  ASSERT_EQ(nominal.sensors.size(), 6U);
  const Rig a = SimulatedUnit(nominal, 256, 1).value();
  const Rig again = SimulatedUnit(nominal, 256, 1).value();
  const Rig b = SimulatedUnit(nominal, 256, 2).value();
  EXPECT_EQ(FormatRig(a), FormatRig(again));
  EXPECT_NE(FormatRig(a), FormatRig(b));
  for (std::size_t s = 0; s < 6; ++s) {
    EXPECT_EQ(a.sensors[s].lens.width(), 256);
    const Vignetting& vignetting = a.sensors[s].vignetting;
    EXPECT_LT(vignetting.At(1.0), 0.8);
    EXPECT_NE(a.sensors[s].gain, a.sensors[(s + 1) % 6].gain);
    // The smaller picture shows the same field of view.
    const Lens& full = nominal.sensors[s].lens;
    const double scale = 256.0 / full.width();
    const Eigen::Vector3d ray(0.2, -0.1, 1.0);
    const auto at = a.sensors[s].lens.PixelFromRay(ray);
    const auto wanted = full.PixelFromRay(ray);
    ASSERT_TRUE(at && wanted);
    EXPECT_LT((*at - *wanted * scale).norm(), 1e-6);
  }
  EXPECT_FALSE(SimulatedUnit(nominal, 20, 1));
  // A head that was calibrated keeps what its file says.
  Rig calibrated = nominal;
  for (RigSensor& sensor : calibrated.sensors) sensor.gain = {1.5, 1.0, 2.0};
  EXPECT_EQ(SimulatedUnit(calibrated, 0, 1)->sensors[3].gain, calibrated.sensors[3].gain);
}

TEST(World, AnyPicturesRaysShowWhatAPanoramaShows) {
  const Projection projection = Projection::Equirectangular(256, 128);
  Image<float> corners(257, 129, 3);
  for (int y = 0; y <= 128; ++y) {
    for (int x = 0; x <= 256; ++x) {
      const Eigen::Vector3d ray = projection.RayFromPixel(x, y);
      for (int c = 0; c < 3; ++c) corners.at(x, y, c) = static_cast<float>(ray[c]);
    }
  }
  corners.at(3, 70, 1) = std::nanf("");
  const Pose pose = Hall()->PoseAt(1.0);
  const RenderedView panorama = Hall()->Render(pose, projection, 4);
  const RenderedView picture = Hall()->RenderRays(pose, corners.view(), 4);
  int different = 0;
  for (int y = 8; y < 120; ++y) {
    for (int x = 0; x < 256; ++x) {
      const float want = panorama.radiance.at(x, y, 1);
      const bool blind = (x == 2 || x == 3) && (y == 69 || y == 70);
      if (blind) {
        EXPECT_EQ(picture.radiance.at(x, y, 1), 0.0F);
        EXPECT_TRUE(std::isnan(picture.distance.at(x, y)));
        continue;
      }
      different += std::abs(picture.radiance.at(x, y, 1) / want - 1.0F) > 0.02F ? 1 : 0;
    }
  }
  EXPECT_LT(different, 256 * 112 / 50);
}

TEST(RigOptics, WhatTheSensorsCollectStitchesToTheWorldAsSeenFromTheCamerasCentre) {
  Rig rig = SimulatedUnit(NominalRig().value(), 192, 1).value();
  rig.sphere_radius_m = 4.0;
  const RigOptics optics(rig);
  const Pose pose = Hall()->PoseAt(1.0);
  const Image<float> collected = optics.Collect(*Hall(), pose, 4);
  EXPECT_EQ(collected.width(), optics.width());
  EXPECT_EQ(collected.height(), optics.height());
  // 16 bits without noise, exposed so that little clips.
  Image<std::uint16_t> frame(collected.width(), collected.height());
  for (std::size_t i = 0; i < frame.size(); ++i) {
    const float value = std::min(65535.0F, collected.data()[i] * 0.002F * 128.0F * 257.0F);
    frame.data()[i] = static_cast<std::uint16_t>(value + 0.5F);
  }
  const DecodedImage image{std::move(frame)};
  const Projection projection = Projection::Equirectangular(256, 128);
  Stitcher stitcher = Stitcher::Create(rig, projection, {}).value();
  Measurement m;
  const std::vector<RigFrame> frames = {{&image, {{ExposureTime::Seconds(0.002), GainDb{}}}}};
  ASSERT_TRUE(stitcher.Stitch(frames, std::vector{*Response::Linear()}, 16, {}, &m));
  const RenderedView truth = Hall()->Render(pose, projection, 16);
  std::array<int, 3> good{};
  int seen = 0;
  for (int y = 0; y < 128; ++y) {
    for (int x = 0; x < 256; ++x) {
      if ((m.flags.at(x, y) & (kMasked | kSaturatedAny)) != 0) continue;
      ++seen;
      for (int c = 0; c < 3; ++c) {
        const float ratio = m.radiance.at(x, y, c) / truth.radiance.at(x, y, c);
        good[static_cast<std::size_t>(c)] += std::abs(std::log10(ratio)) < 0.06F ? 1 : 0;
      }
    }
  }
  EXPECT_GT(seen, 256 * 128 * 7 / 10);
  // What is left are edges, which a mosaic of this size blurs.
  for (const int count : good) EXPECT_GT(count, seen * 8 / 10);
}

TEST(RigOptics, EachSensorSeesFromItsOwnPlace) {
  // Two sensors one metre apart look the same way at a near world.
  Rig rig;
  for (int s = 0; s < 2; ++s) {
    RigSensor sensor;
    sensor.name = s == 0 ? "left" : "right";
    sensor.lens = Lens::Pinhole(96, 96, {60, 60}, {48, 48}, {0, 0, 0, 0, 0}, 0.9).value();
    Eigen::Matrix3d axes;
    axes.col(0) = -Eigen::Vector3d::UnitY();
    axes.col(1) = -Eigen::Vector3d::UnitZ();
    axes.col(2) = Eigen::Vector3d::UnitX();
    sensor.camera_from_sensor.rotation = Eigen::Quaterniond(axes);
    sensor.camera_from_sensor.translation = {0.0, s == 0 ? 0.2 : -0.2, 0.0};
    rig.sensors.push_back(sensor);
  }
  const RigOptics optics(rig);
  const Pose pose = Hall()->PoseAt(1.0);
  const Image<float> both = optics.Collect(*Hall(), pose, 1);
  double different = 0.0;
  for (int y = 0; y < 96; ++y) {
    for (int x = 0; x < 96; ++x) {
      different += std::abs(std::log10(both.at(x, y) / both.at(x, y + 96))) > 0.02 ? 1.0 : 0.0;
    }
  }
  EXPECT_GT(different, 0.1 * 96 * 96);
}

TEST(SimulatedRigSession, HoldsStackedFramesAndTheCalibration) {
  const std::filesystem::path root =
      std::filesystem::temp_directory_path() / ("omnihdr-rig-session-" + std::to_string(getpid()));
  std::filesystem::remove_all(root);
  SimulateOptions options;
  options.simulation.scene = SceneKind::kTunnel;
  options.simulation.layout = Layout::kRig;
  options.simulation.sensor_width = 64;
  options.simulation.samples = 1;
  options.positions = 2;
  ASSERT_TRUE(WriteSimulatedSession(root, options, {}));
  const SessionContents session = ReadSession(root).value();
  const Rig rig = ReadRig(root / "rig.toml").value();
  EXPECT_EQ(session.info.camera.layout, Layout::kRig);
  EXPECT_EQ(session.info.camera.bayer, ToString(rig.sensors.front().bayer));
  const DecodedImage frame = ReadImage(root / session.journal.frames[1].file).value();
  EXPECT_EQ(frame.channels(), 1);
  EXPECT_EQ(frame.width(), session.info.camera.width);
  EXPECT_EQ(frame.height(), session.info.camera.height);
  EXPECT_EQ(frame.height(), StackedRows(rig).value().back());
  // Its truth can be rendered without the rig.
  EXPECT_TRUE(ParseSimulation(session.info.extra_json));
  std::filesystem::remove_all(root);

  options.simulation.rig_file = (root / "nowhere.toml").string();
  const Status missing = WriteSimulatedSession(root, options, {});
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().message.find("nowhere.toml"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::sim::rig_optics_test
