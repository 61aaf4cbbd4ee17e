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
  const SphereGrid grid(measurer.projection_);
  OMNIHDR_ASSIGN(RigMasks masks, ReadRigMasks(rig, session, grid, mask, mask_name));
  Result<Stitcher> stitcher = Stitcher::Create(std::move(rig), grid, masks.views());
  if (!stitcher) return Forward(std::move(stitcher).error(), rig_file.string());
  measurer.stitcher_.emplace(std::move(*stitcher));
  measurer.mask_ = std::move(masks.sensors);
  return measurer;
}

Result<Measurement> FrameMeasurer::Measure(std::span<const ExposedFrame> frames,
                                           const MeasureOptions& options) {
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
