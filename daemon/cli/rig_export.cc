#include "daemon/cli/rig_export.h"

#include <fmt/format.h>

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>
#include <span>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/base/parallel_for.h"
#include "core/image/image_io.h"
#include "core/photometry/mosaic.h"
#include "core/photometry/response.h"
#include "core/photometry/sensor_picture.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/read_frame.h"
#include "core/session/response_json.h"
#include "core/session/rig_file.h"
#include "core/session/session_reader.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int kPictureQuality = 95;
constexpr double kWhiteShare = 0.99;  // of a frame's samples that stay below white

// Names become parts of paths, URDF links and other programs' identifiers.
std::string IdentifierOf(const std::string& name) {
  std::string id = name;
  for (char& c : id) {
    const bool is_plain = (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') ||
                          (c >= 'A' && c <= 'Z') || c == '_' || c == '-';
    if (!is_plain) c = '_';
  }
  return id;
}

struct Head {
  SessionInfo info;
  Rig rig;
  std::vector<int> rows;           // StackedRows
  std::vector<std::string> names;  // unique
  std::vector<PortableLens> lenses;
  std::vector<Response> responses;  // by sensor
};

Result<Head> ReadHead(const fs::path& session, const SessionInfo& info) {
  if (info.camera.layout != Layout::kRig) {
    return Fail(ErrorKind::kUsage, "{}: camera.layout: \"{}\", expected \"rig\": frames of a head",
                (session / "session.json").string(), ToString(info.camera.layout));
  }
  const fs::path file = session / "rig.toml";
  Head head;
  head.info = info;
  OMNIHDR_ASSIGN(head.rig, ReadRig(file));
  Result<std::vector<int>> rows = StackedRows(head.rig);
  if (!rows) return Forward(std::move(rows).error(), file.string());
  head.rows = std::move(*rows);
  for (const RigSensor& sensor : head.rig.sensors) {
    std::string name = IdentifierOf(sensor.name);
    if (std::find(head.names.begin(), head.names.end(), name) != head.names.end()) {
      name += fmt::format("_{}", head.names.size());
    }
    head.names.push_back(std::move(name));
    Result<PortableLens> lens = MakePortable(sensor.lens);
    if (!lens) {
      return Forward(std::move(lens).error(),
                     fmt::format("{}: sensor \"{}\"", file.string(), sensor.name));
    }
    head.lenses.push_back(*lens);
    if (sensor.response_json.empty()) {
      head.responses.push_back(info.response);
      continue;
    }
    OMNIHDR_ASSIGN(Response response,
                   ParseResponse(sensor.response_json, fmt::format("{}: sensor \"{}\": response",
                                                                   file.string(), sensor.name)));
    head.responses.push_back(std::move(response));
  }
  return head;
}

cv::ColorConversionCodes ToRgb(BayerOrder order) {
  switch (order) {
    case BayerOrder::kRggb:
      return cv::COLOR_BayerBG2RGB;
    case BayerOrder::kGrbg:
      return cv::COLOR_BayerGB2RGB;
    case BayerOrder::kGbrg:
      return cv::COLOR_BayerGR2RGB;
    default:
      return cv::COLOR_BayerRG2RGB;
  }
}

// Samples of one sensor in linear light, its gains applied; mosaics stay mosaics.
Image<float> LinearSamples(const SensorPicture& picture, const RigSensor& sensor,
                           const Response& response) {
  const int channels = picture.values.channels();
  Image<float> linear(picture.width(), picture.height(), channels);
  ParallelFor(picture.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < picture.width(); ++x) {
        for (int c = 0; c < channels; ++c) {
          int colour = channels == 3 ? c : 1;
          if (picture.bayer != BayerOrder::kNone) colour = BayerChannel(picture.bayer, x, y);
          const double exposure =
              response.ExposureFromValue(colour, static_cast<double>(picture.values.at(x, y, c)));
          linear.at(x, y, c) =
              static_cast<float>(exposure * sensor.gain[static_cast<std::size_t>(colour)]);
        }
      }
    }
  });
  return linear;
}

// The value that `share` of the samples stay below.
float Quantile(const std::vector<Image<float>>& pictures, double share) {
  std::vector<float> samples;
  constexpr int kStep = 7;  // odd: all colours of a mosaic
  for (const Image<float>& picture : pictures) {
    const int count = picture.width() * picture.channels();
    for (int y = 0; y < picture.height(); y += kStep) {
      const float* row = picture.row(y);
      for (int i = 0; i < count; i += kStep) samples.push_back(row[i]);
    }
  }
  const auto at =
      samples.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(samples.size()));
  std::nth_element(samples.begin(), at, samples.end());
  return *at;
}

Image<std::uint8_t> Developed(const Image<float>& linear, BayerOrder bayer, float white) {
  const int width = linear.width();
  const int height = linear.height();
  cv::Mat samples(height, width, CV_16UC(linear.channels()));
  const float scale = 65535.0F / white;
  for (int y = 0; y < height; ++y) {
    const float* from = linear.row(y);
    auto* to = samples.ptr<std::uint16_t>(y);
    for (int i = 0; i < width * linear.channels(); ++i) {
      to[i] = static_cast<std::uint16_t>(std::clamp(scale * from[i] + 0.5F, 0.0F, 65535.0F));
    }
  }
  cv::Mat colour = samples;
  if (bayer != BayerOrder::kNone && linear.channels() == 1) {
    cv::demosaicing(samples, colour, ToRgb(bayer));
  }
  Image<std::uint8_t> out(width, height, colour.channels());
  for (int y = 0; y < height; ++y) {
    const auto* from = colour.ptr<std::uint16_t>(y);
    std::uint8_t* to = out.row(y);
    for (int i = 0; i < width * out.channels(); ++i) {
      to[i] = EncodeSrgb(static_cast<float>(from[i]) / 65535.0F);
    }
  }
  return out;
}

// The own frame of a view, sensor by sensor, bright enough to look at and to match: exposures of a
// bracket differ by more than feature detectors bear.
Result<std::vector<Image<std::uint8_t>>> SensorPictures(const fs::path& session, const Head& head,
                                                        const FrameRecord& record) {
  OMNIHDR_ASSIGN(const DecodedImage frame, ReadFrame(session, head.info.camera, record));
  std::vector<Image<float>> linear;
  std::vector<BayerOrder> orders;
  for (std::size_t s = 0; s < head.rig.sensors.size(); ++s) {
    const RigSensor& sensor = head.rig.sensors[s];
    OMNIHDR_ASSIGN(const SensorPicture picture,
                   MakeSensorPicture(frame, head.info.camera.bits, sensor.bayer, head.rows[s],
                                     head.rows[s + 1] - head.rows[s]));
    linear.push_back(LinearSamples(picture, sensor, head.responses[s]));
    orders.push_back(picture.bayer);
  }
  const float white = std::max(Quantile(linear, kWhiteShare), 1e-9F);
  std::vector<Image<std::uint8_t>> pictures;
  for (std::size_t s = 0; s < linear.size(); ++s) {
    pictures.push_back(Developed(linear[s], orders[s], white));
  }
  return pictures;
}

// Calls write(view, sensor's index, JPEG) for every picture.
template <typename Write>
Result<std::size_t> ForEveryPicture(const fs::path& session, const Head& head,
                                    const ExportPlan& plan, const Write& write) {
  std::size_t count = 0;
  for (const ExportedView& view : plan.views) {
    if (view.own.file.empty()) {
      return Fail(ErrorKind::kData, "{}: frame {} of view {} has no pixels, expected a picture",
                  session.string(), Value(view.own.frame), view.name);
    }
    OMNIHDR_ASSIGN(const std::vector<Image<std::uint8_t>> pictures,
                   SensorPictures(session, head, view.own));
    for (std::size_t s = 0; s < pictures.size(); ++s) {
      OMNIHDR_ASSIGN(const std::vector<std::byte> jpeg, EncodeJpeg(pictures[s], kPictureQuality));
      OMNIHDR_TRY(write(view, s, jpeg));
      ++count;
    }
  }
  return count;
}

Result<Head> HeadOf(const fs::path& session) {
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  return ReadHead(session, contents.info);
}

RigExportReport ReportOf(const Head& head, std::size_t pictures, bool has_poses) {
  RigExportReport report;
  report.pictures = pictures;
  report.has_poses = has_poses;
  for (const PortableLens& lens : head.lenses) {
    report.lens_error_px = std::max(report.lens_error_px, lens.error_px);
  }
  return report;
}

Json ArrayOf(const Eigen::Vector3d& v) { return Json::array({v.x(), v.y(), v.z()}); }

Json RotationVector(const Eigen::Quaterniond& q) {
  const Eigen::AngleAxisd turn(q);
  return ArrayOf(turn.angle() * turn.axis());
}

// COLMAP's FULL_OPENCV has the same five coefficients, and three more that are 0 here.
std::string ColmapModelOf(const PortableLens& lens) {
  return lens.is_fisheye ? "OPENCV_FISHEYE" : "FULL_OPENCV";
}
std::vector<double> ColmapParametersOf(const PortableLens& lens) {
  const auto& k = lens.distortion;
  std::vector<double> p = {
      lens.focal.x(), lens.focal.y(), lens.centre.x(), lens.centre.y(), k[0], k[1], k[2], k[3]};
  if (!lens.is_fisheye) p.insert(p.end(), {k[4], 0.0, 0.0, 0.0});
  return p;
}

}  // namespace

Result<PortableLens> MakePortable(const Lens& lens) {
  PortableLens portable;
  portable.width = lens.width();
  portable.height = lens.height();
  portable.focal = lens.focal();
  portable.centre = lens.centre();
  portable.distortion = lens.distortion();
  portable.is_fisheye = lens.kind() != LensKind::kPinhole;
  if (lens.kind() == LensKind::kPinhole ||
      (lens.kind() == LensKind::kFisheye && lens.distortion()[4] == 0.0)) {
    return portable;
  }
  // With the ratio of the focal lengths kept, u = cx + cos φ · (f θ + f k1 θ³ + … + f k4 θ⁹) and v
  // likewise are linear in cx, cy, f and f·k.
  constexpr int kSteps = 40;
  constexpr int kUnknowns = 7;
  struct Sample {
    Eigen::Vector2d pixel;
    Eigen::Vector2d direction;
    double theta = 0.0;
  };
  std::vector<Sample> samples;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; j <= kSteps; ++j) {
      const Eigen::Vector2d pixel(0.5 + (lens.width() - 1.0) * j / kSteps,
                                  0.5 + (lens.height() - 1.0) * i / kSteps);
      const auto ray = lens.RayFromPixel(pixel.x(), pixel.y());
      if (!ray) continue;
      const double rho = ray->head<2>().norm();
      const Eigen::Vector2d direction =
          rho > 0.0 ? Eigen::Vector2d(ray->head<2>() / rho) : Eigen::Vector2d(0.0, 0.0);
      samples.push_back({pixel, direction, std::atan2(rho, ray->z())});
    }
  }
  if (samples.size() < kSteps) {
    return Fail(ErrorKind::kData, "lens: {} of {} points of the picture have rays, expected more",
                samples.size(), (kSteps + 1) * (kSteps + 1));
  }
  const double ratio = lens.focal().y() / lens.focal().x();
  const auto rows = static_cast<Eigen::Index>(2 * samples.size());
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(rows, kUnknowns);
  Eigen::VectorXd b(rows);
  for (std::size_t k = 0; k < samples.size(); ++k) {
    const Sample& sample = samples[k];
    const double square = sample.theta * sample.theta;
    for (int axis = 0; axis < 2; ++axis) {
      const auto row = static_cast<Eigen::Index>(2 * k + static_cast<std::size_t>(axis));
      a(row, axis) = 1.0;
      double power = sample.theta * sample.direction[axis] * (axis == 1 ? ratio : 1.0);
      for (int p = 2; p < kUnknowns; ++p, power *= square) a(row, p) = power;
      b(row) = sample.pixel[axis];
    }
  }
  const Eigen::VectorXd x = a.colPivHouseholderQr().solve(b);
  portable.centre = x.head<2>();
  portable.focal = {x[2], x[2] * ratio};
  for (int p = 0; p < 4; ++p) portable.distortion[static_cast<std::size_t>(p)] = x[3 + p] / x[2];
  portable.distortion[4] = 0.0;
  const Eigen::VectorXd off = a * x - b;
  for (std::size_t k = 0; k < samples.size(); ++k) {
    portable.error_px =
        std::max(portable.error_px, off.segment<2>(static_cast<Eigen::Index>(2 * k)).norm());
  }
  return portable;
}

Result<RigExportReport> ExportRigToColmap(const fs::path& session, const ExportPlan& plan,
                                          const fs::path& out) {
  OMNIHDR_ASSIGN(const Head head, HeadOf(session));
  const std::size_t sensors = head.rig.sensors.size();
  for (const std::string& name : head.names) OMNIHDR_TRY(MakeFolder(out / "images/head" / name));
  const auto write = [&](const ExportedView& view, std::size_t s, std::span<const std::byte> jpeg) {
    return WriteFileAtomic(out / "images/head" / head.names[s] / (view.name + ".jpg"), jpeg);
  };
  OMNIHDR_ASSIGN(const std::size_t pictures, ForEveryPicture(session, head, plan, write));

  Json cameras = Json::array();
  const Pose camera_from_first = head.rig.sensors.front().camera_from_sensor;
  for (std::size_t s = 0; s < sensors; ++s) {
    Json camera = {{"image_prefix", "head/" + head.names[s] + "/"}};
    if (s == 0) {
      camera["ref_sensor"] = true;
    } else {
      const Pose pose = head.rig.sensors[s].camera_from_sensor.Inverse() * camera_from_first;
      const Eigen::Quaterniond& q = pose.rotation;
      camera["cam_from_rig_rotation"] = {q.w(), q.x(), q.y(), q.z()};
      camera["cam_from_rig_translation"] = ArrayOf(pose.translation);
    }
    camera["camera_model_name"] = ColmapModelOf(head.lenses[s]);
    camera["camera_params"] = ColmapParametersOf(head.lenses[s]);
    cameras.push_back(std::move(camera));
  }
  OMNIHDR_TRY(WriteFileAtomic(out / "rig_config.json",
                              Json::array({{{"cameras", cameras}}}).dump(1) + "\n"));
  if (!plan.is_metric) return ReportOf(head, pictures, false);

  OMNIHDR_TRY(MakeFolder(out / "sparse"));
  std::string models = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  for (std::size_t s = 0; s < sensors; ++s) {
    const PortableLens& lens = head.lenses[s];
    models += fmt::format("{} {} {} {} {:.12g}\n", s + 1, ColmapModelOf(lens), lens.width,
                          lens.height, fmt::join(ColmapParametersOf(lens), " "));
  }
  std::string images =
      "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; a line of points\n";
  int number = 0;
  for (const ExportedView& view : plan.views) {
    for (std::size_t s = 0; s < sensors; ++s) {
      const Pose pose = (view.world_from_camera * head.rig.sensors[s].camera_from_sensor).Inverse();
      const Eigen::Quaterniond& q = pose.rotation;
      const Eigen::Vector3d& t = pose.translation;
      images += fmt::format(
          "{} {:.12g} {:.12g} {:.12g} {:.12g} {:.12g} {:.12g} {:.12g} {} head/{}/{}.jpg\n\n",
          ++number, q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z(), s + 1, head.names[s],
          view.name);
    }
  }
  OMNIHDR_TRY(WriteFileAtomic(out / "sparse/cameras.txt", models));
  OMNIHDR_TRY(WriteFileAtomic(out / "sparse/images.txt", images));
  OMNIHDR_TRY(
      WriteFileAtomic(out / "sparse/points3D.txt", std::string("# no points: poses alone\n")));
  return ReportOf(head, pictures, true);
}

Result<RigExportReport> ExportRigToOpenSfm(const fs::path& session, const ExportPlan& plan,
                                           const fs::path& out) {
  OMNIHDR_ASSIGN(const Head head, HeadOf(session));
  OMNIHDR_TRY(MakeFolder(out / "images"));
  const auto picture_name = [&](const ExportedView& view, std::size_t s) {
    return view.name + "_" + head.names[s] + ".jpg";
  };
  const auto write = [&](const ExportedView& view, std::size_t s, std::span<const std::byte> jpeg) {
    return WriteFileAtomic(out / "images" / picture_name(view, s), jpeg);
  };
  OMNIHDR_ASSIGN(const std::size_t pictures, ForEveryPicture(session, head, plan, write));

  Json models = Json::object();
  Json rig_cameras = Json::object();
  for (std::size_t s = 0; s < head.rig.sensors.size(); ++s) {
    const PortableLens& lens = head.lenses[s];
    const auto& k = lens.distortion;
    const double larger = std::max(lens.width, lens.height);
    // In units of the larger side, from the picture's middle.
    Json model = {{"projection_type", lens.is_fisheye ? "fisheye_opencv" : "brown"},
                  {"width", lens.width},
                  {"height", lens.height},
                  {"focal_x", lens.focal.x() / larger},
                  {"focal_y", lens.focal.y() / larger},
                  {"c_x", (lens.centre.x() - 0.5 * lens.width) / larger},
                  {"c_y", (lens.centre.y() - 0.5 * lens.height) / larger},
                  {"k1", k[0]},
                  {"k2", k[1]}};
    if (lens.is_fisheye) {
      model["k3"] = k[2];
      model["k4"] = k[3];
    } else {
      model["k3"] = k[4];
      model["p1"] = k[2];
      model["p2"] = k[3];
    }
    models[head.names[s]] = std::move(model);
    const Pose pose = head.rig.sensors[s].camera_from_sensor.Inverse();
    rig_cameras[head.names[s]] = {{"rotation", RotationVector(pose.rotation)},
                                  {"translation", ArrayOf(pose.translation)},
                                  {"camera", head.names[s]}};
  }
  Json assignments = Json::object();
  Json overrides = Json::object();
  Json shots = Json::object();
  Json instances = Json::object();
  for (const ExportedView& view : plan.views) {
    Json pairs = Json::array();
    Json camera_of = Json::object();
    for (std::size_t s = 0; s < head.rig.sensors.size(); ++s) {
      const std::string name = picture_name(view, s);
      pairs.push_back(Json::array({name, head.names[s]}));
      camera_of[name] = head.names[s];
      overrides[name] = ExifOverrideOf(view);
      overrides[name]["camera"] = head.names[s];
      const Pose pose = (view.world_from_camera * head.rig.sensors[s].camera_from_sensor).Inverse();
      shots[name] = {{"rotation", RotationVector(pose.rotation)},
                     {"translation", ArrayOf(pose.translation)},
                     {"camera", head.names[s]},
                     {"orientation", 1},
                     {"capture_time", view.seconds}};
    }
    assignments[view.name] = std::move(pairs);
    const Pose pose = view.world_from_camera.Inverse();
    instances[view.name] = {{"rotation", RotationVector(pose.rotation)},
                            {"translation", ArrayOf(pose.translation)},
                            {"rig_camera_ids", std::move(camera_of)}};
  }
  OMNIHDR_TRY(WriteFileAtomic(out / "camera_models_overrides.json", models.dump(1) + "\n"));
  OMNIHDR_TRY(WriteFileAtomic(out / "rig_cameras.json", rig_cameras.dump(1) + "\n"));
  OMNIHDR_TRY(WriteFileAtomic(out / "rig_assignments.json", assignments.dump(1) + "\n"));
  OMNIHDR_TRY(WriteFileAtomic(out / "exif_overrides.json", overrides.dump(1) + "\n"));
  if (!plan.is_metric) return ReportOf(head, pictures, false);
  const Json reconstruction = Json::array({{{"cameras", models},
                                            {"shots", shots},
                                            {"points", Json::object()},
                                            {"rig_cameras", rig_cameras},
                                            {"rig_instances", instances}}});
  OMNIHDR_TRY(WriteFileAtomic(out / "reconstruction.json", reconstruction.dump(1) + "\n"));
  return ReportOf(head, pictures, true);
}

Result<RigExportReport> ExportRigToRos(const fs::path& session, const fs::path& out) {
  OMNIHDR_ASSIGN(const Head head, HeadOf(session));
  OMNIHDR_TRY(MakeFolder(out / "camera_info"));
  std::string urdf =
      "<?xml version=\"1.0\"?>\n<robot name=\"omnihdr_head\">\n  <link name=\"head\"/>\n";
  for (std::size_t s = 0; s < head.rig.sensors.size(); ++s) {
    const PortableLens& lens = head.lenses[s];
    const std::string& name = head.names[s];
    const std::size_t coefficients = lens.is_fisheye ? 4 : 5;
    // ROS counts pixels from the middle of the first one.
    const Eigen::Vector2d centre = lens.centre - Eigen::Vector2d(0.5, 0.5);
    const std::string yaml = fmt::format(
        "image_width: {}\nimage_height: {}\ncamera_name: {}\n"
        "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{:.12g}, 0, {:.12g}, 0, {:.12g}, {:.12g}, "
        "0, 0, 1]\n"
        "distortion_model: {}\n"
        "distortion_coefficients:\n  rows: 1\n  cols: {}\n  data: [{:.12g}]\n"
        "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
        "projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{:.12g}, 0, {:.12g}, 0, 0, {:.12g}, "
        "{:.12g}, 0, 0, 0, 1, 0]\n",
        lens.width, lens.height, name, lens.focal.x(), centre.x(), lens.focal.y(), centre.y(),
        lens.is_fisheye ? "equidistant" : "plumb_bob", coefficients,
        fmt::join(lens.distortion.begin(),
                  lens.distortion.begin() + static_cast<std::ptrdiff_t>(coefficients), ", "),
        lens.focal.x(), centre.x(), lens.focal.y(), centre.y());
    OMNIHDR_TRY(WriteFileAtomic(out / "camera_info" / (name + ".yaml"), yaml));
    const Pose& pose = head.rig.sensors[s].camera_from_sensor;
    // URDF: R = Rz(yaw) Ry(pitch) Rx(roll).
    const Eigen::Matrix3d r = pose.rotation.toRotationMatrix();
    const double pitch = std::atan2(-r(2, 0), std::hypot(r(0, 0), r(1, 0)));
    const bool is_upright = std::hypot(r(0, 0), r(1, 0)) > 1e-9;
    const double yaw = is_upright ? std::atan2(r(1, 0), r(0, 0)) : std::atan2(-r(0, 1), r(1, 1));
    const double roll = is_upright ? std::atan2(r(2, 1), r(2, 2)) : 0.0;
    urdf += fmt::format(
        "  <link name=\"{0}_optical_frame\"/>\n  <joint name=\"{0}_joint\" type=\"fixed\">\n"
        "    <parent link=\"head\"/>\n    <child link=\"{0}_optical_frame\"/>\n"
        "    <origin xyz=\"{1:.9g} {2:.9g} {3:.9g}\" rpy=\"{4:.12g} {5:.12g} {6:.12g}\"/>\n"
        "  </joint>\n",
        name, pose.translation.x(), pose.translation.y(), pose.translation.z(), roll, pitch, yaw);
  }
  OMNIHDR_TRY(WriteFileAtomic(out / "head.urdf", urdf + "</robot>\n"));
  return ReportOf(head, 0, false);
}

}  // namespace omnihdr
