#include "drivers/sim/simulation.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <cmath>
#include <ctime>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <system_error>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/capture/recorder.h"
#include "core/image/image_io.h"
#include "core/photometry/mosaic.h"
#include "core/session/journal.h"
#include "core/session/rig_file.h"
#include "core/sphere/geodesy.h"
#include "drivers/sim/rig_optics.h"

namespace omnihdr::sim {
namespace {

using Json = nlohmann::json;

constexpr double kCylinderZ = 2.356;  // thesis: the side sensors' reach

template <typename T>
Status Check(const char* name, T value, T low, T high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

std::string NowIso8601() {
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", utc);
}

// A PNG with 255 where movers cover any of a pixel.
Result<std::vector<std::byte>> MoverMask(const Image<float>& share) {
  Image<std::uint8_t> mask(share.width(), share.height());
  for (int y = 0; y < share.height(); ++y) {
    for (int x = 0; x < share.width(); ++x) mask.at(x, y) = share.at(x, y) > 0.0F ? 255 : 0;
  }
  return EncodePng(mask.view());
}

// Where the scenes lie: X is east, Y north.
constexpr GeodeticPlace kOrigin{45.4, -75.7, 70.0};

// A receiver's fix at a place; equal arguments give equal fixes.
GnssFix FixAt(const Eigen::Vector3d& place, double sigma_m, std::uint64_t seed) {
  Random random(seed * 6151 + 389);
  const auto normal = [&random] {
    double sum = -6.0;
    for (int k = 0; k < 12; ++k) sum += static_cast<double>(random.Unit());
    return sum;
  };
  const double east = sigma_m * normal();
  const double north = sigma_m * normal();
  const double up = 2.0 * sigma_m * normal();
  const GeodeticPlace at = PlaceAt(kOrigin, place + Eigen::Vector3d(east, north, up));
  GnssFix fix;
  fix.lat_deg = at.lat_deg;
  fix.lon_deg = at.lon_deg;
  fix.alt_m = at.alt_m;
  fix.error_m = std::numbers::sqrt2 * sigma_m;  // horizontal, root mean square
  fix.fix = 1;
  return fix;
}

// The number at a key: absent keeps `value`, another type is an error.
template <typename T>
Status Read(const Json& object, const char* key, T& value) {
  const auto found = object.find(key);
  if (found == object.end()) return {};
  if (!found->is_number() || (std::is_integral_v<T> && !found->is_number_integer())) {
    return Fail(ErrorKind::kData, "simulation.{}: {}: expected a number", key, found->dump());
  }
  value = found->get<T>();
  return {};
}

}  // namespace

Status Simulation::Validate() const {
  OMNIHDR_TRY(Check("width", width, 128, 8192));
  if (width % 2 != 0) return Fail(ErrorKind::kConfig, "width: {}: expected an even number", width);
  if (samples != 1 && samples != 4 && samples != 9 && samples != 16) {
    return Fail(ErrorKind::kConfig, "samples: {}: expected 1, 4, 9 or 16", samples);
  }
  if (layout == Layout::kPerspective) {
    return Fail(ErrorKind::kConfig, "layout: perspective: expected panorama or rig");
  }
  if (sensor_width != 0) OMNIHDR_TRY(Check("sensor_width", sensor_width, 64, 8192));
  if (sensor_width % 2 != 0) {
    return Fail(ErrorKind::kConfig, "sensor_width: {}: expected an even number", sensor_width);
  }
  if (layout == Layout::kRig) OMNIHDR_TRY(MakeRig());
  OMNIHDR_TRY(Check("start_m", start_m, -1e6, 1e6));
  OMNIHDR_TRY(motion.Validate());
  OMNIHDR_TRY(movers.Validate());
  return sensor.Validate();
}

Projection Simulation::MakeProjection() const {
  if (projection == ProjectionKind::kCylindrical) {
    // z grows by 2π/W a row at the horizon.
    const int height = static_cast<int>(std::lround(width * 2 * kCylinderZ / (2 * M_PI)));
    return Projection::Cylindrical(width, height, -kCylinderZ, kCylinderZ);
  }
  return Projection::Equirectangular(width, width / 2);
}

Result<Rig> Simulation::MakeRig() const {
  Result<Rig> nominal = rig_file.empty() ? NominalRig() : ReadRig(rig_file);
  if (!nominal) return Forward(std::move(nominal).error(), "rig");
  Result<Rig> unit = SimulatedUnit(*nominal, sensor_width, seed);
  if (!unit) return unit;
  if (Result<std::vector<int>> rows = StackedRows(*unit); !rows) {
    return Forward(std::move(rows).error(), rig_file);
  }
  for (const RigSensor& each : unit->sensors) {
    if (each.bayer != unit->sensors.front().bayer) {
      return Fail(ErrorKind::kConfig,
                  "{}: sensor \"{}\": bayer: \"{}\", expected \"{}\" as sensor "
                  "\"{}\": a session has one order",
                  rig_file, each.name, ToString(each.bayer), ToString(unit->sensors.front().bayer),
                  unit->sensors.front().name);
    }
  }
  return unit;
}

CameraDescription Simulation::Camera(const Rig* rig) const {
  const Projection panorama = MakeProjection();
  CameraDescription camera;
  camera.model = "omnihdr simulator";
  camera.serial = fmt::format("{}-{}", ToString(scene), seed);
  camera.bits = 8;
  if (rig != nullptr) {
    camera.layout = Layout::kRig;
    camera.width = rig->sensors.front().lens.width();
    camera.height = StackedRows(*rig).value().back();
    camera.bayer = ToString(rig->sensors.front().bayer);
    return camera;
  }
  camera.layout = Layout::kPanorama;
  camera.width = panorama.width();
  camera.height = panorama.height();
  camera.projection = projection;
  camera.z_min = panorama.z_min();
  camera.z_max = panorama.z_max();
  return camera;
}

std::string FormatSimulation(const Simulation& s) {
  Json simulation = {{"scene", ToString(s.scene)},
                     {"seed", s.seed},
                     {"layout", ToString(s.layout)},
                     {"projection", ToString(s.projection)},
                     {"width", s.width},
                     {"samples", s.samples},
                     {"start_m", s.start_m},
                     {"yaw_deg_per_m", s.motion.yaw_deg_per_m},
                     {"sway_deg", s.motion.sway_deg},
                     {"full_well_e", s.sensor.full_well_e},
                     {"read_noise", s.sensor.read_noise},
                     {"prnu", s.sensor.prnu},
                     {"noise_seed", s.sensor.seed}};
  if (s.sensor.white != 255.0) simulation["white"] = s.sensor.white;
  if (s.movers.count > 0) {
    simulation["movers"] = s.movers.count;
    simulation["mover_speed"] = s.movers.speed;
  }
  return Json{{"simulation", simulation}}.dump();
}

Result<Simulation> ParseSimulation(const std::string& json) {
  const Json document = Json::parse(json, nullptr, /*allow_exceptions=*/false);
  if (!document.is_object() || !document.contains("simulation") ||
      !document["simulation"].is_object()) {
    return Fail(ErrorKind::kData, "simulation: expected a JSON object");
  }
  const Json& object = document["simulation"];
  Simulation s;
  if (const auto scene = object.find("scene"); scene != object.end()) {
    const auto kind = scene->is_string() ? SceneKindFromString(scene->get<std::string>())
                                         : std::optional<SceneKind>();
    if (!kind) {
      return Fail(ErrorKind::kData, "simulation.scene: {}: expected hall, yard, tunnel or street",
                  scene->dump());
    }
    s.scene = *kind;
  }
  if (const auto name = object.find("projection"); name != object.end()) {
    const auto kind = name->is_string() ? ProjectionKindFromString(name->get<std::string>())
                                        : std::optional<ProjectionKind>();
    if (!kind) {
      return Fail(ErrorKind::kData,
                  "simulation.projection: {}: expected equirectangular or cylindrical",
                  name->dump());
    }
    s.projection = *kind;
  }
  OMNIHDR_TRY(Read(object, "seed", s.seed));
  OMNIHDR_TRY(Read(object, "width", s.width));
  OMNIHDR_TRY(Read(object, "samples", s.samples));
  OMNIHDR_TRY(Read(object, "start_m", s.start_m));
  OMNIHDR_TRY(Read(object, "yaw_deg_per_m", s.motion.yaw_deg_per_m));
  OMNIHDR_TRY(Read(object, "sway_deg", s.motion.sway_deg));
  OMNIHDR_TRY(Read(object, "movers", s.movers.count));
  OMNIHDR_TRY(Read(object, "mover_speed", s.movers.speed));
  OMNIHDR_TRY(Read(object, "full_well_e", s.sensor.full_well_e));
  OMNIHDR_TRY(Read(object, "read_noise", s.sensor.read_noise));
  OMNIHDR_TRY(Read(object, "white", s.sensor.white));
  OMNIHDR_TRY(Read(object, "prnu", s.sensor.prnu));
  OMNIHDR_TRY(Read(object, "noise_seed", s.sensor.seed));
  if (Status valid = s.Validate(); !valid) {
    return Fail(ErrorKind::kData, "simulation.{}", valid.error().message);
  }
  return s;
}

std::string FormatTruth(const Simulation& simulation, const Pose& world_from_camera,
                        double odometer_m) {
  const Eigen::Quaterniond& q = world_from_camera.rotation;
  const Eigen::Vector3d& t = world_from_camera.translation;
  return Json{{"pose", {{"q", {q.w(), q.x(), q.y(), q.z()}}, {"t", {t.x(), t.y(), t.z()}}}},
              {"scene", ToString(simulation.scene)},
              {"seed", simulation.seed},
              {"odometer_m", odometer_m}}
      .dump();
}

Status SimulateOptions::Validate() const {
  OMNIHDR_TRY(simulation.Validate());
  OMNIHDR_TRY(Check("positions", positions, 1, 100000));
  OMNIHDR_TRY(Check("spacing_m", spacing_m, 0.0, 100.0));
  OMNIHDR_TRY(Check("gnss_sigma_m", gnss_sigma_m, 0.0, 1000.0));
  return {};
}

Status WriteSimulatedSession(const std::filesystem::path& directory, const SimulateOptions& options,
                             const std::function<void(const FrameRecord&)>& progress) {
  OMNIHDR_TRY(options.Validate());
  OMNIHDR_ASSIGN(const BracketPlan plan, BracketPlan::Make(options.bracket, ExposureLimits{}));
  const Simulation& simulation = options.simulation;

  SessionInfo info;
  info.created = options.created.empty() ? NowIso8601() : options.created;
  std::optional<RigOptics> optics;
  if (simulation.layout == Layout::kRig) {
    OMNIHDR_ASSIGN(Rig rig, simulation.MakeRig());
    info.camera = simulation.Camera(&rig);
    info.files.push_back({"rig.toml", FormatRig(rig)});
    optics.emplace(std::move(rig));
  } else {
    info.camera = simulation.Camera();
  }
  info.bracket = plan.Description();
  info.extra_json = FormatSimulation(simulation);
  OMNIHDR_ASSIGN(SessionWriter writer, SessionWriter::Create(directory, info));

  const std::shared_ptr<const World> world = World::Create(simulation.scene, simulation.seed);
  const Projection projection = simulation.MakeProjection();
  const std::vector<Walk> walks = simulation.PlanWalks(*world);
  if (!walks.empty()) {
    std::error_code error;
    std::filesystem::create_directories(directory / "movers", error);
    if (error) {
      return Fail(ErrorKind::kCannotCreate, "{}: {}", (directory / "movers").string(),
                  error.message());
    }
  }
  const int per_position = plan.frames_per_position();
  for (int position = 0; position < options.positions; ++position) {
    const double odometer = position * options.spacing_m;
    const Pose pose = simulation.PoseAt(*world, odometer);
    const MoverGroup movers = simulation.MoversAt(*world, walks, odometer);
    Image<float> light;
    std::vector<std::byte> mover_mask;
    if (optics) {
      light = optics->Collect(*world, pose, simulation.samples, &movers);
      if (!movers.empty()) {
        const Projection sphere =
            Projection::Equirectangular(simulation.width, simulation.width / 2);
        OMNIHDR_ASSIGN(mover_mask, MoverMask(world->Render(pose, sphere, 1, &movers).movers));
      }
    } else {
      RenderedView view = world->Render(pose, projection, simulation.samples, &movers);
      light = std::move(view.radiance);
      if (!movers.empty()) {
        OMNIHDR_ASSIGN(mover_mask, MoverMask(view.movers));
      }
    }
    for (int i = 0; i < per_position; ++i) {
      const auto number =
          static_cast<std::uint64_t>(position) * static_cast<std::uint64_t>(per_position) +
          static_cast<std::uint64_t>(i);
      FrameRecord record;
      record.frame = FrameId{number};
      record.position = PositionId{position};
      record.file = FrameFileName(record.frame);
      record.exposure = plan.ForTrigger(TriggerId{number});
      // One second apart: simulated time, not that of the writer.
      record.trigger_time =
          HostTime::FromNanoseconds((static_cast<std::int64_t>(number) + 1) * 1'000'000'000);
      record.timestamp =
          record.trigger_time +
          Nanoseconds(static_cast<std::int64_t>(record.exposure.time.seconds() * 0.5e9));
      if (options.write_odometer) record.odometer_m = odometer;
      if (options.gnss_sigma_m > 0.0) {
        record.gnss = FixAt(pose.translation, options.gnss_sigma_m,
                            simulation.sensor.seed * 1'000'003 + number);
      }
      record.proof = ExposureProof::kEmbedded;
      record.truth_json = FormatTruth(simulation, pose, odometer);
      const Image<std::uint8_t> pixels =
          Expose(light.view(), record.exposure, simulation.sensor, number);
      OMNIHDR_ASSIGN(const std::vector<std::byte> png, EncodePng(pixels.view()));
      if (!mover_mask.empty()) {
        const std::filesystem::path name = std::filesystem::path(record.file).filename();
        OMNIHDR_TRY(WriteFileAtomic(directory / "movers" / name, mover_mask));
      }
      OMNIHDR_TRY(writer.Append(record, png));
      if (progress) progress(record);
    }
  }
  return {};
}

}  // namespace omnihdr::sim
