#include "daemon/cli/session_export.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "core/base/file.h"
#include "core/base/parallel_for.h"
#include "core/image/image_io.h"
#include "core/session/session_reader.h"
#include "core/sphere/projection.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

constexpr int kFaceQuality = 95;

// Axes of a picture as COLMAP and OpenSfM have them, in the panorama's frame: rows are right, down,
// forward.
Eigen::Matrix3d Axes(const Eigen::Vector3d& right, const Eigen::Vector3d& down) {
  Eigen::Matrix3d axes;
  axes.row(0) = right;
  axes.row(1) = down;
  axes.row(2) = right.cross(down);
  return axes;
}

const Eigen::Vector3d kX = Eigen::Vector3d::UnitX();
const Eigen::Vector3d kY = Eigen::Vector3d::UnitY();
const Eigen::Vector3d kZ = Eigen::Vector3d::UnitZ();

struct Face {
  const char* name;
  Eigen::Matrix3d face_from_picture;
};

std::vector<Face> Faces(bool all) {
  std::vector<Face> faces = {{"front", Axes(-kY, -kZ)},
                             {"left", Axes(kX, -kZ)},
                             {"back", Axes(kY, -kZ)},
                             {"right", Axes(-kX, -kZ)}};
  if (all) {
    faces.push_back({"up", Axes(-kY, kX)});
    faces.push_back({"down", Axes(-kY, -kX)});
  }
  return faces;
}

// camera_from_world of a camera with those axes.
Pose CameraFromWorld(const Pose& world_from_picture, const Eigen::Matrix3d& camera_from_picture) {
  return Pose{Eigen::Quaterniond(camera_from_picture), Eigen::Vector3d::Zero()} *
         world_from_picture.Inverse();
}

Image<std::uint8_t> FaceOf(const Image<std::uint8_t>& panorama, const Face& face, int size) {
  const Projection projection = Projection::Equirectangular(panorama.width(), panorama.height());
  const int channels = panorama.channels();
  Image<std::uint8_t> out(size, size, channels);
  const Eigen::Matrix3d picture_from_face = face.face_from_picture.transpose();
  ParallelFor(size, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < size; ++x) {
        const Eigen::Vector3d ray =
            picture_from_face *
            Eigen::Vector3d(2.0 * (x + 0.5) / size - 1.0, 2.0 * (y + 0.5) / size - 1.0, 1.0);
        const Eigen::Vector2d at = projection.PixelFromRay(ray) - Eigen::Vector2d(0.5, 0.5);
        const double left = std::floor(at.x());
        const double top = std::floor(at.y());
        const double fx = at.x() - left;
        const double fy = at.y() - top;
        const int w = panorama.width();
        const int x0 = (static_cast<int>(left) % w + w) % w;
        const int x1 = (x0 + 1) % w;
        const int y0 = std::clamp(static_cast<int>(top), 0, panorama.height() - 1);
        const int y1 = std::clamp(static_cast<int>(top) + 1, 0, panorama.height() - 1);
        for (int c = 0; c < channels; ++c) {
          const double value =
              (1.0 - fy) * ((1.0 - fx) * panorama.at(x0, y0, c) + fx * panorama.at(x1, y0, c)) +
              fy * ((1.0 - fx) * panorama.at(x0, y1, c) + fx * panorama.at(x1, y1, c));
          out.at(x, y, c) = static_cast<std::uint8_t>(std::lround(value));
        }
      }
    }
  });
  return out;
}

Result<Image<std::uint8_t>> ReadPanorama(const fs::path& path) {
  OMNIHDR_ASSIGN(DecodedImage image, ReadImage(path));
  if (image.is_16_bit() || image.width() != 2 * image.height()) {
    return Fail(ErrorKind::kData, "{}: {}x{}, expected a whole panorama of 8 bits", path.string(),
                image.width(), image.height());
  }
  return std::move(std::get<Image<std::uint8_t>>(image.pixels));
}

}  // namespace

Status MakeFolder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return Fail(ErrorKind::kCannotCreate, "{}: {}", folder.string(), error.message());
  return {};
}

Result<ExportPlan> PlanExport(const fs::path& session, const fs::path& views, int chain) {
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  std::map<std::uint64_t, const FrameRecord*> frames;
  for (const FrameRecord& frame : contents.journal.frames) frames[Value(frame.frame)] = &frame;
  OMNIHDR_ASSIGN(const std::vector<PositionId> positions, CompleteViews(views));
  if (positions.empty()) {
    return Fail(ErrorKind::kNoInput, "{}: no view, expected some: omnihdr process makes them",
                views.string());
  }
  ExportPlan plan;
  std::vector<std::pair<ViewRecord, PositionId>> records;
  for (const PositionId position : positions) {
    OMNIHDR_ASSIGN(ViewRecord record, ReadViewRecord(views, position));
    if (record.mode == "temporal") {
      return Fail(ErrorKind::kData,
                  "{}: mode \"temporal\", expected \"spatiotemporal\": its views have no poses",
                  (views / ViewDirectoryName(position) / "view.json").string());
    }
    ++plan.chains[record.chain];
    records.emplace_back(std::move(record), position);
  }
  plan.chain = chain;
  if (chain < 0) {
    plan.chain =
        std::max_element(plan.chains.begin(), plan.chains.end(), [](const auto& a, const auto& b) {
          return a.second < b.second;
        })->first;
  } else if (!plan.chains.contains(chain)) {
    std::vector<int> numbers;
    for (const auto& [number, count] : plan.chains) numbers.push_back(number);
    return Fail(ErrorKind::kUsage, "{}: no chain {}, there are {}", views.string(), chain,
                fmt::join(numbers, ", "));
  }
  plan.is_metric = true;
  plan.is_utc = true;
  for (const auto& [record, position] : records) {
    const auto own = frames.find(record.reference);
    if (record.chain == plan.chain && own != frames.end()) {
      plan.is_utc = plan.is_utc && own->second->utc.has_value();
    }
  }
  for (const auto& [record, position] : records) {
    if (record.chain != plan.chain) continue;
    const auto own = frames.find(record.reference);
    if (own == frames.end()) {
      return Fail(ErrorKind::kData, "{}: reference: frame {}, expected one that the journal has",
                  (views / ViewDirectoryName(position) / "view.json").string(), record.reference);
    }
    ExportedView view;
    view.name = ViewDirectoryName(position);
    view.preview = views / view.name / "preview.jpg";
    view.world_from_camera = record.pose;
    view.world_from_picture = record.pose * Pose{record.orientation, Eigen::Vector3d::Zero()};
    view.seconds = 1e-9 * static_cast<double>(plan.is_utc ? own->second->utc->ns()
                                                          : own->second->trigger_time.ns());
    if (own->second->gnss && own->second->gnss->fix > 0) view.gnss = own->second->gnss;
    view.own = *own->second;
    plan.is_metric = plan.is_metric && record.metric_scale;
    plan.views.push_back(std::move(view));
  }
  return plan;
}

std::string FormatTum(const ExportPlan& plan) {
  std::string text = fmt::format(
      "# seconds ({}) x y z qx qy qz qw: world_from_camera, X forward, Y left, Z up, {}\n",
      plan.is_utc ? "UTC" : "of the host",
      plan.is_metric ? "metres" : "in units of the first baseline");
  for (const ExportedView& view : plan.views) {
    const Eigen::Vector3d& t = view.world_from_camera.translation;
    const Eigen::Quaterniond& q = view.world_from_camera.rotation;
    text += fmt::format("{:.6f} {:.9g} {:.9g} {:.9g} {:.9g} {:.9g} {:.9g} {:.9g}\n", view.seconds,
                        t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
  }
  return text;
}

nlohmann::ordered_json ExifOverrideOf(const ExportedView& view) {
  nlohmann::ordered_json exif = {{"capture_time", view.seconds}, {"orientation", 1}};
  if (view.gnss) {
    exif["gps"] = {{"latitude", view.gnss->lat_deg},
                   {"longitude", view.gnss->lon_deg},
                   {"altitude", view.gnss->alt_m},
                   {"dop", view.gnss->error_m.value_or(15.0)}};
  }
  return exif;
}

Status ExportOpenSfm(const ExportPlan& plan, const fs::path& out) {
  using Json = nlohmann::ordered_json;
  OMNIHDR_TRY(MakeFolder(out / "images"));
  Json camera;
  Json shots = Json::object();
  Json overrides = Json::object();
  const Eigen::Matrix3d camera_from_picture = Axes(-kY, -kZ);
  for (const ExportedView& view : plan.views) {
    const std::string image = view.name + ".jpg";
    OMNIHDR_ASSIGN(const std::vector<std::byte> jpeg, ReadFile(view.preview));
    OMNIHDR_TRY(WriteFileAtomic(out / "images" / image, jpeg));
    if (camera.is_null()) {
      OMNIHDR_ASSIGN(const Image<std::uint8_t> picture, ReadPanorama(view.preview));
      camera = {{"projection_type", "spherical"},
                {"width", picture.width()},
                {"height", picture.height()}};
    }
    const Pose pose = CameraFromWorld(view.world_from_picture, camera_from_picture);
    const Eigen::AngleAxisd turn(pose.rotation);
    const Eigen::Vector3d r = turn.angle() * turn.axis();
    Json shot = {
        {"rotation", {r.x(), r.y(), r.z()}},
        {"translation", {pose.translation.x(), pose.translation.y(), pose.translation.z()}},
        {"camera", "omnihdr"},
        {"orientation", 1},
        {"capture_time", view.seconds}};
    shots[image] = std::move(shot);
    overrides[image] = ExifOverrideOf(view);
  }
  const Json reconstruction = Json::array(
      {{{"cameras", {{"omnihdr", camera}}}, {"shots", shots}, {"points", Json::object()}}});
  OMNIHDR_TRY(WriteFileAtomic(out / "reconstruction.json", reconstruction.dump(1) + "\n"));
  OMNIHDR_TRY(WriteFileAtomic(out / "exif_overrides.json", overrides.dump(1) + "\n"));
  return WriteFileAtomic(out / "camera_models_overrides.json",
                         Json{{"all", camera}}.dump(1) + "\n");
}

Status ExportColmap(const ExportPlan& plan, int face_size, bool all_faces, const fs::path& out) {
  OMNIHDR_TRY(MakeFolder(out / "images"));
  OMNIHDR_TRY(MakeFolder(out / "sparse"));
  const std::vector<Face> faces = Faces(all_faces);
  std::string images =
      "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; a line of points\n";
  int number = 0;
  for (const ExportedView& view : plan.views) {
    OMNIHDR_ASSIGN(const Image<std::uint8_t> panorama, ReadPanorama(view.preview));
    for (const Face& face : faces) {
      const std::string name = fmt::format("{}_{}.jpg", view.name, face.name);
      const Image<std::uint8_t> picture = FaceOf(panorama, face, face_size);
      OMNIHDR_ASSIGN(const std::vector<std::byte> jpeg, EncodeJpeg(picture, kFaceQuality));
      OMNIHDR_TRY(WriteFileAtomic(out / "images" / name, jpeg));
      const Pose pose = CameraFromWorld(view.world_from_picture, face.face_from_picture);
      const Eigen::Quaterniond& q = pose.rotation;
      const Eigen::Vector3d& t = pose.translation;
      images += fmt::format("{} {:.12g} {:.12g} {:.12g} {:.12g} {:.12g} {:.12g} {:.12g} 1 {}\n\n",
                            ++number, q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z(), name);
    }
  }
  OMNIHDR_TRY(WriteFileAtomic(
      out / "sparse" / "cameras.txt",
      fmt::format(
          "# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy\n1 PINHOLE {0} {0} {1} {1} {1} "
          "{1}\n",
          face_size, 0.5 * face_size)));
  OMNIHDR_TRY(WriteFileAtomic(out / "sparse" / "images.txt", images));
  return WriteFileAtomic(out / "sparse" / "points3D.txt",
                         std::string("# no points: poses alone\n"));
}

}  // namespace omnihdr
