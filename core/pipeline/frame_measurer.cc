#include "core/pipeline/frame_measurer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/image/image_io.h"
#include "core/pipeline/rig_masks.h"
#include "core/session/response_json.h"
#include "core/session/rig_file.h"

namespace omnihdr {
namespace {

// Samples of a mosaic's colour stand further apart than its pixels.
constexpr double kMosaicSpacing = 1.4;

PanoramaOptics OpticsOf(const Rig& rig, int width) {
  double square = 0.0;
  bool is_mosaic = false;
  for (const RigSensor& sensor : rig.sensors) {
    square += sensor.camera_from_sensor.translation.squaredNorm();
    is_mosaic = is_mosaic || sensor.bayer != BayerOrder::kNone;
  }
  return {static_cast<double>(width) / (is_mosaic ? kMosaicSpacing : 1.0),
          std::sqrt(square / static_cast<double>(rig.sensors.size()))};
}

Status CheckRig(const Rig& rig, const std::filesystem::path& rig_file, const SessionInfo& info,
                const std::filesystem::path& info_file) {
  const CameraDescription& camera = info.camera;
  Result<std::vector<int>> rows = StackedRows(rig);
  if (!rows) return Forward(std::move(rows).error(), rig_file.string());
  const int width = rig.sensors.front().lens.width();
  if (width != camera.width || rows->back() != camera.height) {
    return Fail(ErrorKind::kData,
                "{}: camera.width, height: {}x{}, expected {}x{}: the {} sensors of {} stacked",
                info_file.string(), camera.width, camera.height, width, rows->back(),
                rig.sensors.size(), rig_file.filename().string());
  }
  for (const RigSensor& sensor : rig.sensors) {
    if (camera.bayer != ToString(sensor.bayer)) {
      return Fail(ErrorKind::kData, "{}: sensor \"{}\": bayer: \"{}\", expected \"{}\" as {} says",
                  rig_file.string(), sensor.name, ToString(sensor.bayer), camera.bayer,
                  info_file.filename().string());
    }
  }
  return {};
}

}  // namespace

Result<FrameMeasurer> FrameMeasurer::Open(const std::filesystem::path& session,
                                          const SessionInfo& info,
                                          ImageView<const std::uint8_t> mask,
                                          const std::string& mask_name,
                                          const std::array<double, 3>& white_balance) {
  const CameraDescription& camera = info.camera;
  FrameMeasurer measurer;
  measurer.bits_ = camera.bits;
  measurer.responses_ = {info.response};
  measurer.optics_.columns = camera.width;
  measurer.rows_ = {0, camera.height};
  if (camera.layout != Layout::kRig) {
    measurer.projection_ = camera.layout == Layout::kPanorama
                               ? camera.PanoramaProjection()
                               : Projection::Equirectangular(camera.width, camera.height);
    if (!mask.empty()) {
      if (mask.width() != camera.width || mask.height() != camera.height) {
        return Fail(ErrorKind::kData, "{}: {}x{} pixels, expected the frames' size {}x{}",
                    mask_name, mask.width(), mask.height(), camera.width, camera.height);
      }
      measurer.mask_ = Image<std::uint8_t>(mask.width(), mask.height());
      for (int y = 0; y < mask.height(); ++y) {
        std::copy_n(mask.row(y), mask.width(), measurer.mask_.row(y));
      }
    }
    return measurer;
  }

  const std::filesystem::path rig_file = session / "rig.toml";
  OMNIHDR_ASSIGN(Rig rig, ReadRig(rig_file));
  OMNIHDR_TRY(CheckRig(rig, rig_file, info, session / "session.json"));
  for (RigSensor& sensor : rig.sensors) {
    for (std::size_t c = 0; c < 3; ++c) sensor.gain[c] *= white_balance[c];
  }
  const int width = NaturalPanoramaWidth(rig);
  measurer.projection_ = Projection::Equirectangular(width, width / 2);
  measurer.optics_ = OpticsOf(rig, width);
  if (std::any_of(rig.sensors.begin(), rig.sensors.end(),
                  [](const RigSensor& s) { return !s.response_json.empty(); })) {
    measurer.responses_.clear();
    for (const RigSensor& sensor : rig.sensors) {
      if (sensor.response_json.empty()) {
        measurer.responses_.push_back(info.response);
        continue;
      }
      OMNIHDR_ASSIGN(Response response, ParseResponse(sensor.response_json,
                                                      fmt::format("{}: sensor \"{}\": response",
                                                                  rig_file.string(), sensor.name)));
      measurer.responses_.push_back(std::move(response));
    }
  }
  OMNIHDR_ASSIGN(measurer.rows_, StackedRows(rig));
  for (const RigSensor& sensor : rig.sensors) measurer.sensor_names_.push_back(sensor.name);
  const SphereGrid grid(measurer.projection_);
  OMNIHDR_ASSIGN(RigMasks masks, ReadRigMasks(rig, session, grid, mask, mask_name));
  Result<Stitcher> stitcher = Stitcher::Create(std::move(rig), grid, masks.views());
  if (!stitcher) return Forward(std::move(stitcher).error(), rig_file.string());
  measurer.stitcher_.emplace(std::move(*stitcher));
  measurer.mask_ = std::move(masks.sensors);
  return measurer;
}

std::optional<std::string> FrameMeasurer::WhiteLevelWarning(double value_high) {
  if (white_level_told_) return std::nullopt;
  for (std::size_t s = 0; s < white_levels_.size(); ++s) {
    const Response& response = responses_[responses_.size() == 1 ? 0 : s];
    const std::optional<WhiteLevel> white = white_levels_[s].Find();
    const double usable = response.HighestUsable(value_high);
    // What lies above is left out as saturated already.
    if (!white || white->value > usable) continue;
    white_level_told_ = true;
    return fmt::format(
        "{}: clips at value {:.1f} ({:.2g} % of its samples, in {} exposures), expected above "
        "{:.1f}, up to which values count as usable: highlights may be red or cyan; omnihdr "
        "calibrate response "
        "measures its white level, or lower photometry.value_high",
        stitcher_ ? fmt::format("sensor \"{}\"", sensor_names_[s]) : std::string("the camera"),
        white->value, 100.0 * white->share, white->exposures, usable);
  }
  return std::nullopt;
}

Result<Measurement> FrameMeasurer::Measure(std::span<const ExposedFrame> frames,
                                           const MeasureOptions& options) {
  if (!white_level_told_) {
    white_levels_.resize(rows_.size() - 1);
    constexpr int kStep = 5;  // odd: every colour of a mosaic
    for (const ExposedFrame& frame : frames) {
      if (frame.image->height() != rows_.back()) continue;  // told below
      const ImageView<const std::uint8_t> mask =
          mask_.width() == frame.image->width() && mask_.height() == frame.image->height()
              ? mask_.view()
              : ImageView<const std::uint8_t>();
      for (std::size_t s = 0; s < white_levels_.size(); ++s) {
        white_levels_[s].Add(*frame.image, bits_, frame.exposure.EffectiveSeconds(), rows_[s],
                             rows_[s + 1] - rows_[s], mask, kStep);
      }
    }
  }
  if (!stitcher_) {
    return omnihdr::Measure(frames, projection_, responses_.front(), bits_, mask_.view(), options);
  }
  std::vector<RigFrame> rig_frames;
  for (const ExposedFrame& frame : frames) {
    rig_frames.push_back({frame.image, {frame.exposure}});
  }
  Measurement measurement;
  OMNIHDR_TRY(stitcher_->Stitch(rig_frames, responses_, bits_, options, &measurement));
  return measurement;
}

}  // namespace omnihdr
