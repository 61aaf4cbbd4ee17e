// export, called as from the command line. What is written is read back by the other programs'
// own formulas, as their documentation has them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/view_writer.h"
#include "core/sphere/projection.h"
#include "daemon/cli/command.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::export_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr int kWidth = 512;
constexpr int kViews = 3;
// What every picture shows: bright spots at known places of the world, darkness elsewhere.
const std::vector<Eigen::Vector3d> kSpots = {
    {4.0, 1.0, 0.5}, {-3.0, 2.0, -0.7}, {0.5, -4.0, 1.0}, {1.0, 0.4, 5.0}, {0.8, -0.3, -4.0}};

Pose PoseOf(int k) {
  Pose pose;
  pose.rotation = Eigen::AngleAxisd(0.3 * k, Eigen::Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY());
  pose.translation = {0.5 * k, 0.1 * k, 0.02 * k};
  return pose;
}
const Eigen::Quaterniond kOrientation(Eigen::AngleAxisd(0.4,
                                                        Eigen::Vector3d(1, 2, 3).normalized()));

class Export : public ::testing::Test {
 protected:
  void SetUp() override {
    testing::SessionPlan plan;
    plan.projection = Projection::Equirectangular(128, 64);
    plan.poses = testing::GentleBend(kViews, 0.3);
    Result<SessionWriter> writer = SessionWriter::Create(Path("s"), testing::InfoOf(plan));
    ASSERT_TRUE(writer) << writer.error().message;
    for (int k = 0; k < kViews; ++k) {
      FrameRecord record = testing::RecordOf(plan, static_cast<std::size_t>(k));
      record.utc = UtcTime::FromNanoseconds(1'767'225'600'250'000'000 + 1'000'000'000LL * k);
      if (k != 1) record.gnss = GnssFix{45.0 + k, -75.0, 100.0, "", 1};
      record.file.clear();
      record.status = FrameStatus::kCameraTimeout;
      ASSERT_TRUE(writer->Append(record, {}));
      WriteOne(k, 0);
    }
  }
  void WriteOne(int k, int chain) {
    ViewRecord record;
    record.position = PositionId{k};
    record.pose = PoseOf(k);
    record.metric_scale = true;
    record.chain = chain;
    record.orientation = kOrientation;
    record.frames = {static_cast<std::uint64_t>(k)};
    record.reference = static_cast<std::uint64_t>(k);
    record.mode = "spatiotemporal";
    const Status written = WriteView(
        Path("s") + "/views", PositionId{k}, true, [&](const fs::path& directory) -> Status {
          const auto jpeg = EncodeJpeg(Picture(k).view(), 100, true).value();
          OMNIHDR_TRY(WriteFileAtomic(directory / "preview.jpg", jpeg));
          return WriteFileAtomic(directory / "view.json", FormatViewRecord(record));
        });
    ASSERT_TRUE(written) << written.error().message;
  }
  static Image<std::uint8_t> Picture(int k) {
    const Projection projection = Projection::Equirectangular(kWidth, kWidth / 2);
    Image<std::uint8_t> image(kWidth, kWidth / 2, 3);
    for (int y = 0; y < image.height(); ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const Eigen::Vector3d ray = kOrientation * projection.RayFromPixel(x + 0.5, y + 0.5);
        for (const Eigen::Vector3d& spot : kSpots) {
          const Eigen::Vector3d to = PoseOf(k).CameraFromWorld(spot).normalized();
          if (to.dot(ray) < std::cos(0.04)) continue;
          for (int c = 0; c < 3; ++c) image.at(x, y, c) = 255;
        }
      }
    }
    return image;
  }
  std::string Path(const std::string& name) const { return (directory_.path() / name).string(); }
  Result<int> Run(const std::string& to, const std::string& out,
                  std::vector<std::string> more = {}) {
    more.insert(more.begin(), {"export", Path("s"), "--to", to, "--out", Path(out)});
    return testing::RunCommand({AddExportCommand}, more, &printed_);
  }

  testing::TemporaryDirectory directory_;
  std::string printed_;
};

TEST_F(Export, AColmapModelProjectsWorldPointsToWhereItsPicturesShowThem) {
  const Result<int> done = Run("colmap", "out", {"--face-size", "256"});
  ASSERT_TRUE(done) << done.error().message;
  std::istringstream cameras(testing::FileText(Path("out/sparse/cameras.txt")));
  std::string line;
  std::getline(cameras, line);
  int id = 0;
  std::string model;
  double width = 0;
  double height = 0;
  double fx = 0;
  double fy = 0;
  double cx = 0;
  double cy = 0;
  cameras >> id >> model >> width >> height >> fx >> fy >> cx >> cy;
  EXPECT_EQ(model, "PINHOLE");
  int seen = 0;
  int images = 0;
  std::istringstream lines(testing::FileText(Path("out/sparse/images.txt")));
  while (std::getline(lines, line)) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    double w = 0;
    double x = 0;
    double y = 0;
    double z = 0;
    Eigen::Vector3d t;
    std::string name;
    words >> id >> w >> x >> y >> z >> t.x() >> t.y() >> t.z() >> id >> name;
    const auto picture = ReadImage(Path("out/images/" + name));
    ASSERT_TRUE(picture) << picture.error().message;
    EXPECT_EQ(picture->width(), width);
    ++images;
    const auto& pixels = std::get<Image<std::uint8_t>>(picture->pixels);
    for (const Eigen::Vector3d& spot : kSpots) {
      // COLMAP: x_camera = R x_world + t; pixel = f X/Z + c.
      const Eigen::Vector3d p = Eigen::Quaterniond(w, x, y, z) * spot + t;
      if (p.z() <= 0.0) continue;
      const double u = fx * p.x() / p.z() + cx;
      const double v = fy * p.y() / p.z() + cy;
      if (u < 2 || v < 2 || u > width - 2 || v > height - 2) continue;
      ++seen;
      EXPECT_GT(pixels.at(static_cast<int>(u), static_cast<int>(v), 0), 200) << name;
    }
  }
  EXPECT_EQ(images, 6 * kViews);
  EXPECT_GE(seen, kViews * static_cast<int>(kSpots.size()) - 2);
}

TEST_F(Export, AnOpenSfmReconstructionProjectsWorldPointsToWhereItsPicturesShowThem) {
  const Result<int> done = Run("opensfm", "out");
  ASSERT_TRUE(done) << done.error().message;
  const auto json = nlohmann::json::parse(testing::FileText(Path("out/reconstruction.json")));
  const auto& shots = json.at(0).at("shots");
  EXPECT_EQ(json.at(0).at("cameras").at("omnihdr").at("projection_type"), "spherical");
  ASSERT_EQ(shots.size(), std::size_t{kViews});
  for (const auto& [name, shot] : shots.items()) {
    const auto picture = ReadImage(Path("out/images/" + name));
    ASSERT_TRUE(picture) << picture.error().message;
    const auto& pixels = std::get<Image<std::uint8_t>>(picture->pixels);
    const auto vector = [&from = shot](const char* key) {
      return Eigen::Vector3d(from.at(key).at(0), from.at(key).at(1), from.at(key).at(2));
    };
    const Eigen::Vector3d r = vector("rotation");
    const Eigen::AngleAxisd turn(
        r.norm(), r.norm() > 0 ? Eigen::Vector3d(r.normalized()) : Eigen::Vector3d(1, 0, 0));
    for (const Eigen::Vector3d& spot : kSpots) {
      // OpenSfM: lon = atan2(x, z), lat = atan2(-y, hypot(x, z)); u = lon/2pi, v = -lat/2pi of the
      // picture's larger side, from its middle.
      const Eigen::Vector3d p = turn * spot + vector("translation");
      const double lon = std::atan2(p.x(), p.z());
      const double lat = std::atan2(-p.y(), std::hypot(p.x(), p.z()));
      const double u = lon / (2 * std::numbers::pi) * kWidth + kWidth / 2.0;
      const double v = -lat / (2 * std::numbers::pi) * kWidth + kWidth / 4.0;
      EXPECT_GT(pixels.at(static_cast<int>(u), static_cast<int>(v), 0), 200) << name;
    }
  }
  const auto exif = nlohmann::json::parse(testing::FileText(Path("out/exif_overrides.json")));
  EXPECT_NEAR(exif.at("000002.jpg").at("capture_time").get<double>(), 1767225602.25, 1e-6);
  EXPECT_EQ(exif.at("000002.jpg").at("gps").at("latitude"), 47.0);
  EXPECT_FALSE(exif.at("000001.jpg").contains("gps")) << "a frame without a fix has no place";
}

TEST_F(Export, ATrajectoryHasThePosesAndTheirTimes) {
  ASSERT_TRUE(Run("tum", "poses.tum"));
  std::istringstream lines(testing::FileText(Path("poses.tum")));
  std::string line;
  std::getline(lines, line);
  EXPECT_THAT(line, HasSubstr("UTC"));
  for (int k = 0; k < kViews; ++k) {
    double seconds = 0;
    Eigen::Vector3d t;
    Eigen::Quaterniond q;
    lines >> seconds >> t.x() >> t.y() >> t.z() >> q.x() >> q.y() >> q.z() >> q.w();
    EXPECT_NEAR(seconds, 1767225600.25 + k, 1e-5);
    EXPECT_LT((t - PoseOf(k).translation).norm(), 1e-8);
    EXPECT_LT(q.angularDistance(PoseOf(k).rotation), 1e-7);
  }
}

TEST_F(Export, OneChainIsWrittenAndTheOthersAreTold) {
  WriteOne(2, 5);
  ASSERT_TRUE(Run("tum", "poses.tum"));
  EXPECT_THAT(printed_, HasSubstr("2 views of chain 0"));
  EXPECT_THAT(printed_, HasSubstr("5 (1 views)"));
  ASSERT_TRUE(Run("tum", "poses.tum", {"--chain", "5"}));
  EXPECT_THAT(printed_, HasSubstr("1 views of chain 5"));
  const Result<int> none = Run("tum", "poses.tum", {"--chain", "7"});
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().kind, ErrorKind::kUsage);
  EXPECT_THAT(none.error().message, HasSubstr("no chain 7, there are 0, 5"));
}

TEST_F(Export, ASessionWithoutViewsIsAnError) {
  fs::remove_all(Path("s") + "/views");
  const Result<int> none = Run("tum", "poses.tum");
  ASSERT_FALSE(none);
  EXPECT_THAT(none.error().message, HasSubstr("omnihdr process"));
}

}  // namespace
}  // namespace omnihdr::export_test
