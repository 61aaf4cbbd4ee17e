#include "drivers/sim/rig_optics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/photometry/mosaic.h"
#include "core/session/rig_file.h"
#include "drivers/sim/geometry.h"
#include "drivers/sim/nominal_rig.h"

namespace omnihdr::sim {
namespace {

LensGrid ScaledGrid(const LensGrid& grid, double scale) {
  LensGrid scaled = grid;
  scaled.step_x *= scale;
  scaled.step_y *= scale;
  for (Eigen::Vector2f& point : scaled.points) point *= static_cast<float>(scale);
  return scaled;
}

Result<Lens> ScaledLens(const Lens& lens, double scale) {
  const int width = static_cast<int>(std::lround(lens.width() * scale / 2.0)) * 2;
  const int height = static_cast<int>(std::lround(lens.height() * scale / 2.0)) * 2;
  constexpr int kLeast = 32;
  if (width < kLeast || height < kLeast) {
    return Fail(ErrorKind::kConfig, "sensor_width: {}: a sensor of {}x{}, expected at least {}x{}",
                width, width, height, kLeast, kLeast);
  }
  const Eigen::Vector2d focal = lens.focal() * scale;
  const Eigen::Vector2d centre = lens.centre() * scale;
  switch (lens.kind()) {
    case LensKind::kPinhole:
      return Lens::Pinhole(width, height, focal, centre, lens.distortion(), lens.max_angle());
    case LensKind::kFisheye:
      return Lens::Fisheye(width, height, focal, centre, lens.distortion(), lens.max_angle());
    case LensKind::kGrid:
      break;
  }
  return Lens::Grid(width, height, focal, centre, ScaledGrid(*lens.raw_from_rectified(), scale),
                    ScaledGrid(*lens.rectified_from_raw(), scale));
}

}  // namespace

Result<Rig> NominalRig() { return ParseRig(NominalRigText(), "config/rigs/ladybug2.toml"); }

Result<Rig> SimulatedUnit(const Rig& nominal, int width, std::uint64_t seed) {
  Rig rig = nominal;
  bool plain = true;
  for (const RigSensor& sensor : rig.sensors) {
    plain = plain && sensor.gain == std::array<double, 3>{1.0, 1.0, 1.0} &&
            sensor.vignetting.coefficients == std::array<double, 3>{};
  }
  Random random(seed * 7919 + 3);
  for (RigSensor& sensor : rig.sensors) {
    if (width != 0) {
      OMNIHDR_ASSIGN(sensor.lens,
                     ScaledLens(sensor.lens, static_cast<double>(width) / sensor.lens.width()));
      sensor.mask_file.clear();  // of another size
    }
    if (!plain) continue;
    // Silicon sees least blue; sensors differ by a few percent (thesis: within 5).
    const double sensitivity = random.Range(0.97F, 1.03F);
    sensor.gain = {sensitivity * random.Range(1.38F, 1.46F), sensitivity,
                   sensitivity * random.Range(1.62F, 1.74F)};
    sensor.vignetting.coefficients = {random.Range(-0.42F, -0.34F), random.Range(0.02F, 0.08F),
                                      0.0};
  }
  OMNIHDR_TRY(rig.Validate());
  return rig;
}

RigOptics::RigOptics(Rig rig) : rig_(std::move(rig)), rows_(StackedRows(rig_).value()) {
  factor_ = Image<float>(width(), height());
  for (std::size_t s = 0; s < rig_.sensors.size(); ++s) {
    const RigSensor& sensor = rig_.sensors[s];
    const Lens& lens = sensor.lens;
    Image<float> rays(lens.width() + 1, lens.height() + 1, 3,
                      std::numeric_limits<float>::quiet_NaN());
    for (int y = 0; y <= lens.height(); ++y) {
      for (int x = 0; x <= lens.width(); ++x) {
        if (const auto ray = lens.RayFromPixel(x, y)) {
          for (int c = 0; c < 3; ++c) rays.at(x, y, c) = static_cast<float>((*ray)[c]);
        }
      }
    }
    corner_rays_.push_back(std::move(rays));
    const Eigen::Vector2d centre =
        lens.kind() == LensKind::kGrid
            ? lens.PixelFromRay(Eigen::Vector3d::UnitZ()).value_or(lens.centre())
            : lens.centre();
    const double half_diagonal = 0.5 * std::hypot(lens.width(), lens.height());
    for (int y = 0; y < lens.height(); ++y) {
      for (int x = 0; x < lens.width(); ++x) {
        const auto c = static_cast<std::size_t>(
            sensor.bayer == BayerOrder::kNone ? 1 : BayerChannel(sensor.bayer, x, y));
        const double rho = (Eigen::Vector2d(x + 0.5, y + 0.5) - centre).norm() / half_diagonal;
        factor_.at(x, rows_[s] + y) =
            static_cast<float>(sensor.vignetting.At(rho) / sensor.gain[c]);
      }
    }
  }
}

Image<float> RigOptics::Collect(const World& world, const Pose& world_from_camera, int samples,
                                const MoverGroup* movers) const {
  Image<float> collected(width(), height());
  for (std::size_t s = 0; s < rig_.sensors.size(); ++s) {
    const RigSensor& sensor = rig_.sensors[s];
    const RenderedView view = world.RenderRays(world_from_camera * sensor.camera_from_sensor,
                                               corner_rays_[s].view(), samples, movers);
    for (int y = 0; y < view.radiance.height(); ++y) {
      const float* factor = factor_.row(rows_[s] + y);
      float* out = collected.row(rows_[s] + y);
      for (int x = 0; x < view.radiance.width(); ++x) {
        const int c = sensor.bayer == BayerOrder::kNone ? 1 : BayerChannel(sensor.bayer, x, y);
        out[x] = view.radiance.pixel(x, y)[c] * factor[x];
      }
    }
  }
  return collected;
}

}  // namespace omnihdr::sim
