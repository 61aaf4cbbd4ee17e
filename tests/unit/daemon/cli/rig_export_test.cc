// export of a head's sensors as a rig: what is written is read back by the other programs' own
// formulas, as their documentation has them.
#include "daemon/cli/rig_export.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/rig_file.h"
#include "core/session/view_writer.h"
#include "daemon/cli/command.h"
#include "tests/support/rig_session.h"
#include "tests/support/ring.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::rig_export_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using Json = nlohmann::json;

constexpr int kViews = 2;
// Bright spots at known places of the world, darkness elsewhere; near enough for the sensors'
// places on the head to matter.
const std::vector<Eigen::Vector3d> kSpots = {
    {2.0, 0.3, 0.2}, {-1.5, 1.2, -0.2}, {0.4, -2.0, 0.3}, {0.6, 0.2, 2.5}, {-0.5, -1.6, 0.9}};
constexpr double kSpotRadius = 0.05;

Pose PoseOf(int k) {
  Pose pose;
  pose.rotation = Eigen::AngleAxisd(0.5 * k, Eigen::Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY());
  pose.translation = {0.3 * k, 0.1 * k, 0.02 * k};
  return pose;
}

Eigen::Quaterniond FromRotationVector(const Json& v) {
  const Eigen::Vector3d r(v.at(0), v.at(1), v.at(2));
  if (r.norm() == 0.0) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(Eigen::AngleAxisd(r.norm(), r.normalized()));
}
Eigen::Vector3d Vector(const Json& v) { return Eigen::Vector3d(v.at(0), v.at(1), v.at(2)); }

// OpenCV's fisheye model: of X/Z, Y/Z to what focal length and centre make pixels of.
Eigen::Vector2d FisheyePoint(const Eigen::Vector3d& p, const std::vector<double>& k) {
  const double rho = p.head<2>().norm();
  const double theta = std::atan2(rho, p.z());
  const double s = theta * theta;
  const double bent = theta * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
  return p.head<2>() * (bent / rho);
}

class RigExport : public ::testing::Test {
 protected:
  void SetUp() override {
    testing::RingOptions options;
    options.width = 256;
    options.height = 192;
    options.vignetting = {};
    rig_ = testing::MakeRing(options);
    Result<SessionWriter> writer = SessionWriter::Create(Path("s"), testing::RigInfo(rig_));
    ASSERT_TRUE(writer) << writer.error().message;
    for (int k = 0; k < kViews; ++k) {
      const Pose pose = PoseOf(k);
      const auto scene = [&](const Eigen::Vector3d& from,
                             const Eigen::Vector3d& ray) -> Eigen::Vector3d {
        for (const Eigen::Vector3d& spot : kSpots) {
          const Eigen::Vector3d to = pose.CameraFromWorld(spot) - from;
          if ((to - ray.dot(to) * ray).norm() < kSpotRadius && ray.dot(to) > 0.0) {
            return Eigen::Vector3d::Constant(0.5);
          }
        }
        return Eigen::Vector3d::Constant(0.01);
      };
      const DecodedImage image = testing::ShootRig(rig_, scene, 1.0);
      FrameRecord record;
      record.frame = FrameId{static_cast<std::uint64_t>(k)};
      record.position = PositionId{k};
      record.file = "raw/" + std::to_string(k) + ".png";
      record.exposure = {ExposureTime::Seconds(1.0), GainDb{}};
      record.trigger_time = HostTime::FromNanoseconds(1'000'000'000LL * k);
      ASSERT_TRUE(writer->Append(
          record, EncodePng(std::get<Image<std::uint8_t>>(image.pixels).view()).value()));
      WriteOne(k, true);
    }
  }
  void WriteOne(int k, bool is_metric) {
    ViewRecord record;
    record.position = PositionId{k};
    record.pose = PoseOf(k);
    record.metric_scale = is_metric;
    record.frames = {static_cast<std::uint64_t>(k)};
    record.reference = static_cast<std::uint64_t>(k);
    record.mode = "spatiotemporal";
    const Status written = WriteView(
        Path("s") + "/views", PositionId{k}, true, [&](const fs::path& directory) -> Status {
          return WriteFileAtomic(directory / "view.json", FormatViewRecord(record));
        });
    ASSERT_TRUE(written) << written.error().message;
  }
  std::string Path(const std::string& name) const { return (directory_.path() / name).string(); }
  Json ReadJson(const std::string& name) const {
    return Json::parse(testing::FileText(Path(name)));
  }
  Result<int> Run(const std::string& to, std::vector<std::string> more = {}) {
    const std::vector<std::string> first = {"export", Path("s"), "--to", to, "--out", Path("out")};
    more.insert(more.begin(), first.begin(), first.end());
    return testing::RunCommand({AddExportCommand}, more, &printed_);
  }
  // The lenses show nothing beyond their angle, wherever their models put it.
  bool IsInView(const Eigen::Vector3d& in_lens) const {
    return std::atan2(in_lens.head<2>().norm(), in_lens.z()) <
           rig_.sensors.front().lens.max_angle() - 0.05;
  }
  // Whether the picture is bright at a point; counts it.
  void ExpectBright(const std::string& picture, const Eigen::Vector2d& at) {
    if (at.x() < 3 || at.y() < 3 || at.x() > 253 || at.y() > 189) return;
    const auto image = ReadImage(Path("out/images/" + picture));
    ASSERT_TRUE(image) << image.error().message;
    ASSERT_EQ(image->channels(), 3);
    const auto& pixels = std::get<Image<std::uint8_t>>(image->pixels);
    ++seen_;
    for (int c = 0; c < 3; ++c) {
      EXPECT_GT(pixels.at(static_cast<int>(at.x()), static_cast<int>(at.y()), c), 170)
          << picture << " " << at.transpose();
    }
  }

  testing::TemporaryDirectory directory_;
  Rig rig_;
  std::string printed_;
  int seen_ = 0;
};

TEST_F(RigExport, AColmapModelAndRigProjectWorldPointsToWhereTheSensorsShowThem) {
  const Result<int> done = Run("colmap", {"--sensors"});
  ASSERT_TRUE(done) << done.error().message;
  EXPECT_THAT(printed_, HasSubstr("12 pictures of sensors"));
  const Json config = ReadJson("out/rig_config.json");
  const Json& cameras = config.at(0).at("cameras");
  ASSERT_EQ(cameras.size(), rig_.sensors.size());
  EXPECT_EQ(cameras.at(0).at("ref_sensor"), true);
  std::map<std::string, const Json*> camera_of;
  for (const Json& camera : cameras) camera_of[camera.at("image_prefix")] = &camera;

  std::map<std::string, Pose> first;  // of a view, cam_from_world of the reference sensor
  std::istringstream lines(testing::FileText(Path("out/sparse/images.txt")));
  std::string line;
  int images = 0;
  while (std::getline(lines, line)) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    int id = 0;
    double w = 0;
    Eigen::Vector3d v;
    Pose pose;
    std::string name;
    words >> id >> w >> v.x() >> v.y() >> v.z() >> pose.translation.x() >> pose.translation.y() >>
        pose.translation.z() >> id >> name;
    pose.rotation = Eigen::Quaterniond(w, v.x(), v.y(), v.z());
    ++images;
    const std::size_t slash = name.rfind('/') + 1;
    ASSERT_TRUE(camera_of.contains(name.substr(0, slash))) << name;
    const Json& camera = *camera_of.at(name.substr(0, slash));
    EXPECT_EQ(camera.at("camera_model_name"), "OPENCV_FISHEYE");
    const std::vector<double> p = camera.at("camera_params");
    ASSERT_EQ(p.size(), 8U);
    // The pose of every other sensor is that of the reference, by the rig.
    if (camera.contains("ref_sensor")) {
      first[name.substr(slash)] = pose;
    } else {
      const Json& q = camera.at("cam_from_rig_rotation");
      const Pose cam_from_rig{Eigen::Quaterniond(q.at(0), q.at(1), q.at(2), q.at(3)),
                              Vector(camera.at("cam_from_rig_translation"))};
      const Pose by_rig = cam_from_rig * first.at(name.substr(slash));
      EXPECT_LT(by_rig.rotation.angularDistance(pose.rotation), 1e-7);
      EXPECT_LT((by_rig.translation - pose.translation).norm(), 1e-8);
    }
    for (const Eigen::Vector3d& spot : kSpots) {
      const Eigen::Vector3d x = pose.rotation * spot + pose.translation;
      if (!IsInView(x)) continue;
      const Eigen::Vector2d d = FisheyePoint(x, {p[4], p[5], p[6], p[7]});
      ExpectBright(name, {p[0] * d.x() + p[2], p[1] * d.y() + p[3]});
    }
  }
  EXPECT_EQ(images, kViews * static_cast<int>(rig_.sensors.size()));
  EXPECT_GE(seen_, kViews * static_cast<int>(kSpots.size()));
}

TEST_F(RigExport, AnOpenSfmRigProjectsWorldPointsToWhereTheSensorsShowThem) {
  const Result<int> done = Run("opensfm", {"--sensors"});
  ASSERT_TRUE(done) << done.error().message;
  const Json rig = ReadJson("out/rig_cameras.json");
  const Json models = ReadJson("out/camera_models_overrides.json");
  const Json assignments = ReadJson("out/rig_assignments.json");
  const Json reconstruction = ReadJson("out/reconstruction.json").at(0);
  const Json overrides = ReadJson("out/exif_overrides.json");
  ASSERT_EQ(assignments.size(), std::size_t{kViews});
  for (const auto& [instance, pairs] : assignments.items()) {
    ASSERT_EQ(pairs.size(), rig_.sensors.size());
    const Json& pose = reconstruction.at("rig_instances").at(instance);
    for (const Json& pair : pairs) {
      const std::string name = pair.at(0);
      const Json& camera = rig.at(pair.at(1).get<std::string>());
      EXPECT_EQ(pose.at("rig_camera_ids").at(name), pair.at(1));
      EXPECT_EQ(overrides.at(name).at("camera"), camera.at("camera"));
      const Json& model = models.at(camera.at("camera").get<std::string>());
      EXPECT_EQ(model.at("projection_type"), "fisheye_opencv");
      const Json& shot = reconstruction.at("shots").at(name);
      for (const Eigen::Vector3d& spot : kSpots) {
        // World to rig to camera; normalised image coordinates are of the larger side.
        const Eigen::Vector3d in_rig =
            FromRotationVector(pose.at("rotation")) * spot + Vector(pose.at("translation"));
        const Eigen::Vector3d x =
            FromRotationVector(camera.at("rotation")) * in_rig + Vector(camera.at("translation"));
        const Eigen::Vector3d by_shot =
            FromRotationVector(shot.at("rotation")) * spot + Vector(shot.at("translation"));
        EXPECT_LT((x - by_shot).norm(), 1e-9);
        if (!IsInView(x)) continue;
        const Eigen::Vector2d d =
            FisheyePoint(x, {model.at("k1"), model.at("k2"), model.at("k3"), model.at("k4")});
        const double width = model.at("width");
        const double height = model.at("height");
        const double larger = std::max(width, height);
        ExpectBright(
            name,
            {(model.at("focal_x").get<double>() * d.x() + model.at("c_x").get<double>()) * larger +
                 0.5 * width,
             (model.at("focal_y").get<double>() * d.y() + model.at("c_y").get<double>()) * larger +
                 0.5 * height});
      }
    }
  }
  EXPECT_GE(seen_, kViews * static_cast<int>(kSpots.size()));
}

TEST_F(RigExport, RosJointsAndCameraInfoAreTheRigs) {
  fs::remove_all(Path("s") + "/views");  // a rig is one without views
  const Result<int> done = Run("ros");
  ASSERT_TRUE(done) << done.error().message;
  const std::string urdf = testing::FileText(Path("out/head.urdf"));
  const std::regex joint(
      "<child link=\"([^\"]*)_optical_frame\"/>\\s*<origin xyz=\"([^\"]*)\" rpy=\"([^\"]*)\"/>");
  std::size_t joints = 0;
  for (std::sregex_iterator it(urdf.begin(), urdf.end(), joint); it != std::sregex_iterator();
       ++it, ++joints) {
    const RigSensor& sensor = rig_.sensors.at(joints);
    std::istringstream numbers((*it)[2].str() + " " + (*it)[3].str());
    Eigen::Vector3d xyz;
    Eigen::Vector3d rpy;
    numbers >> xyz.x() >> xyz.y() >> xyz.z() >> rpy.x() >> rpy.y() >> rpy.z();
    const Eigen::Quaterniond q = Eigen::AngleAxisd(rpy.z(), Eigen::Vector3d::UnitZ()) *
                                 Eigen::AngleAxisd(rpy.y(), Eigen::Vector3d::UnitY()) *
                                 Eigen::AngleAxisd(rpy.x(), Eigen::Vector3d::UnitX());
    EXPECT_LT(q.angularDistance(sensor.camera_from_sensor.rotation), 1e-7) << sensor.name;
    EXPECT_LT((xyz - sensor.camera_from_sensor.translation).norm(), 1e-8) << sensor.name;
    const std::string info = testing::FileText(Path("out/camera_info/" + (*it)[1].str() + ".yaml"));
    EXPECT_THAT(info, HasSubstr("distortion_model: equidistant"));
    EXPECT_THAT(info, HasSubstr("image_width: 256\nimage_height: 192"));
    std::smatch matrix;
    ASSERT_TRUE(std::regex_search(
        info, matrix, std::regex("data: \\[([^,]*), 0, ([^,]*), 0, ([^,]*), ([^,]*), 0, 0, 1\\]")));
    EXPECT_NEAR(std::stod(matrix[1]), sensor.lens.focal().x(), 1e-6);
    EXPECT_NEAR(std::stod(matrix[2]), sensor.lens.centre().x() - 0.5, 1e-6);
    EXPECT_NEAR(std::stod(matrix[4]), sensor.lens.centre().y() - 0.5, 1e-6);
  }
  EXPECT_EQ(joints, rig_.sensors.size());
}

TEST_F(RigExport, PosesWithoutMetresAreNotMixedWithARigsMetres) {
  WriteOne(0, false);
  ASSERT_TRUE(Run("colmap", {"--sensors"}));
  EXPECT_THAT(printed_, HasSubstr("not in metres"));
  EXPECT_FALSE(fs::exists(Path("out/sparse")));
  EXPECT_TRUE(fs::exists(Path("out/rig_config.json")));
}

TEST_F(RigExport, OnlyFramesOfAHeadAndFormsThatKnowRigs) {
  const Result<int> tum = Run("tum", {"--sensors"});
  ASSERT_FALSE(tum);
  EXPECT_EQ(tum.error().kind, ErrorKind::kUsage);
  EXPECT_THAT(tum.error().message, HasSubstr("expected colmap or opensfm"));
  testing::SessionPlan plan;
  plan.projection = Projection::Equirectangular(128, 64);
  plan.poses = testing::GentleBend(1, 0.3);
  ASSERT_TRUE(SessionWriter::Create(Path("p"), testing::InfoOf(plan)));
  const Result<RigExportReport> panorama = ExportRigToRos(Path("p"), Path("out"));
  ASSERT_FALSE(panorama);
  EXPECT_THAT(panorama.error().message, HasSubstr("expected \"rig\""));
}

TEST(PortableLens, LensesOfTheSharedModelsAreAsTheyAre) {
  const Lens pinhole =
      Lens::Pinhole(320, 240, {200, 201}, {161, 119}, {-0.1, 0.02, 0.001, -0.002, 0.003}, 0.8)
          .value();
  const PortableLens a = MakePortable(pinhole).value();
  EXPECT_FALSE(a.is_fisheye);
  EXPECT_EQ(a.error_px, 0.0);
  EXPECT_EQ(a.distortion, pinhole.distortion());
  const Lens fisheye =
      Lens::Fisheye(320, 240, {120, 121}, {161, 119}, {-0.05, 0.01, -0.002, 0.0003, 0.0}, 1.5)
          .value();
  const PortableLens b = MakePortable(fisheye).value();
  EXPECT_TRUE(b.is_fisheye);
  EXPECT_EQ(b.error_px, 0.0);
  EXPECT_EQ(b.focal, fisheye.focal());
}

TEST(PortableLens, OthersAreFittedAndTheErrorIsWhatItIs) {
  const Lens lens =
      Lens::Fisheye(320, 240, {120, 121}, {161, 119}, {-0.05, 0.01, -0.002, 0.0003, 0.0004}, 1.5)
          .value();
  const PortableLens fit = MakePortable(lens).value();
  EXPECT_GT(fit.error_px, 0.0);
  EXPECT_LT(fit.error_px, 0.1);
  const std::vector<double> k(fit.distortion.begin(), fit.distortion.begin() + 4);
  double worst = 0.0;
  for (int y = 8; y < 240; y += 16) {
    for (int x = 8; x < 320; x += 16) {
      const auto ray = lens.RayFromPixel(x, y);
      if (!ray) continue;
      const Eigen::Vector2d d = FisheyePoint(*ray, k);
      worst =
          std::max(worst, (fit.focal.cwiseProduct(d) + fit.centre - Eigen::Vector2d(x, y)).norm());
    }
  }
  EXPECT_LT(worst, 1.2 * fit.error_px + 1e-6);
}

}  // namespace
}  // namespace omnihdr::rig_export_test
