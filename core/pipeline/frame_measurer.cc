#include "core/pipeline/frame_measurer.h"

#include <algorithm>
#include <utility>

#include "core/image/image_io.h"
#include "core/session/response_json.h"
#include "core/session/rig_file.h"

namespace omnihdr {
namespace {

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

// The lens masks of the rig as one picture of the stacked frame; empty when no sensor has one.
Result<Image<std::uint8_t>> StackedMask(const Rig& rig, const std::filesystem::path& directory) {
  OMNIHDR_ASSIGN(const std::vector<int> rows, StackedRows(rig));
  Image<std::uint8_t> stacked;
  for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
    const RigSensor& sensor = rig.sensors[s];
    if (sensor.mask_file.empty()) continue;
    const std::filesystem::path file = directory / sensor.mask_file;
    OMNIHDR_ASSIGN(const Image<std::uint8_t> mask, ReadMask(file));
    if (mask.width() != sensor.lens.width() || mask.height() != sensor.lens.height()) {
      return Fail(ErrorKind::kData, "{}: mask of {}x{}, expected the size of sensor \"{}\", {}x{}",
                  file.string(), mask.width(), mask.height(), sensor.name, sensor.lens.width(),
                  sensor.lens.height());
    }
    if (stacked.empty()) stacked = Image<std::uint8_t>(mask.width(), rows.back(), 1, 255);
    for (int y = 0; y < mask.height(); ++y) {
      std::copy_n(mask.row(y), mask.width(), stacked.row(rows[s] + y));
    }
  }
  return stacked;
}

// A lat-long mask of another size: the nearest pixel counts.
Image<std::uint8_t> Resized(ImageView<const std::uint8_t> mask, int width, int height) {
  Image<std::uint8_t> resized(width, height);
  for (int y = 0; y < height; ++y) {
    const int from_y = static_cast<int>((y + 0.5) * mask.height() / height);
    for (int x = 0; x < width; ++x) {
      resized.at(x, y) = mask.at(static_cast<int>((x + 0.5) * mask.width() / width), from_y);
    }
  }
  return resized;
}

void Intersect(ImageView<const std::uint8_t> other, Image<std::uint8_t>* mask) {
  for (int y = 0; y < mask->height(); ++y) {
    for (int x = 0; x < mask->width(); ++x) {
      if (other.at(x, y) < 128) mask->at(x, y) = 0;
    }
  }
}

}  // namespace

Result<Image<std::uint8_t>> ReadMask(const std::filesystem::path& file) {
  OMNIHDR_ASSIGN(const DecodedImage decoded, ReadImage(file));
  Image<std::uint8_t> mask(decoded.width(), decoded.height());
  std::visit(
      [&mask](const auto& image) {
        const int shift = sizeof(image.data()[0]) == 2 ? 8 : 0;
        for (int y = 0; y < mask.height(); ++y) {
          for (int x = 0; x < mask.width(); ++x) {
            mask.at(x, y) = static_cast<std::uint8_t>(image.pixel(x, y)[0] >> shift);
          }
        }
      },
      decoded.pixels);
  return mask;
}

Result<FrameMeasurer> FrameMeasurer::Open(const std::filesystem::path& session,
                                          const SessionInfo& info,
                                          ImageView<const std::uint8_t> mask,
                                          const std::string& mask_name,
                                          const std::array<double, 3>& white_balance) {
  const CameraDescription& camera = info.camera;
  FrameMeasurer measurer;
  measurer.bits_ = camera.bits;
  measurer.responses_ = {info.response};
  const bool has_frame_size = mask.width() == camera.width && mask.height() == camera.height;
  if (camera.layout != Layout::kRig) {
    measurer.projection_ = camera.layout == Layout::kPanorama
                               ? camera.PanoramaProjection()
                               : Projection::Equirectangular(camera.width, camera.height);
    if (!mask.empty()) {
      if (!has_frame_size) {
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
  OMNIHDR_ASSIGN(Image<std::uint8_t> stacked, StackedMask(rig, session));
  Image<std::uint8_t> panorama;
  if (has_frame_size) {
    if (stacked.empty()) stacked = Image<std::uint8_t>(camera.width, camera.height, 1, 255);
    Intersect(mask, &stacked);
  } else if (!mask.empty()) {
    if (mask.width() != 2 * mask.height()) {
      return Fail(ErrorKind::kData,
                  "{}: {}x{} pixels, expected the stacked frames' size {}x{} or a lat-long picture "
                  "twice as wide as high",
                  mask_name, mask.width(), mask.height(), camera.width, camera.height);
    }
    panorama = Resized(mask, width, width / 2);
  }
  Result<Stitcher> stitcher =
      Stitcher::Create(std::move(rig), measurer.projection_, {stacked.view(), panorama.view()});
  if (!stitcher) return Forward(std::move(stitcher).error(), rig_file.string());
  measurer.stitcher_.emplace(std::move(*stitcher));
  measurer.mask_ = std::move(stacked);
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
