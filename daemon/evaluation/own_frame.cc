#include "daemon/evaluation/own_frame.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/base/parallel_for.h"
#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/photometry/sampler.h"

namespace omnihdr {
namespace {

template <typename T>
void KeepWhite(const Image<T>& picture, double white, Image<std::uint8_t>& mask) {
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      if (static_cast<double>(picture.at(x, y)) < white / 2.0) mask.at(x, y) = 0;
    }
  }
}

}  // namespace

Result<Image<std::uint8_t>> LoadFrameMask(const FrameMaskOptions& options,
                                          const CameraDescription& camera) {
  Image<std::uint8_t> mask(camera.width, camera.height, 1, 255);
  if (!options.file.empty()) {
    OMNIHDR_ASSIGN(const DecodedImage picture, ReadImage(options.file).Context("mask"));
    if (picture.width() != camera.width || picture.height() != camera.height) {
      return Fail(ErrorKind::kData, "mask: {}: {}x{} pixels, expected the frames' size {}x{}",
                  options.file.string(), picture.width(), picture.height(), camera.width,
                  camera.height);
    }
    if (picture.is_16_bit()) {
      KeepWhite(std::get<1>(picture.pixels), 65535.0, mask);
    } else {
      KeepWhite(std::get<0>(picture.pixels), 255.0, mask);
    }
  }
  const int first_ignored =
      camera.height - static_cast<int>(std::lround(options.ignore_bottom * camera.height));
  for (int y = std::max(first_ignored, 0); y < camera.height; ++y) {
    std::memset(mask.row(y), 0, static_cast<std::size_t>(camera.width));
  }
  return mask;
}

Result<Image<float>> OwnFrameRadiance(const std::filesystem::path& session, const SessionInfo& info,
                                      const FrameRecord& frame, ImageView<const std::uint8_t> mask,
                                      const Projection& output,
                                      const Eigen::Quaterniond& camera_from_output) {
  OMNIHDR_ASSIGN(const DecodedImage picture, ReadImage(session / frame.file));
  const std::array<ExposedFrame, 1> exposed = {ExposedFrame{&picture, frame.exposure}};
  OMNIHDR_ASSIGN(const Measurement measurement,
                 Measure(exposed, info.camera.PanoramaProjection(), info.response, info.camera.bits,
                         mask, MeasureOptions{})
                     .Context(frame.file));
  const PanoramaSampler sampler(measurement);
  const Eigen::Matrix3d rotation = camera_from_output.toRotationMatrix();
  Image<float> radiance(output.width(), output.height(), 3,
                        std::numeric_limits<float>::quiet_NaN());
  ParallelFor(output.height(), 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < output.width(); ++x) {
        const Eigen::Vector3d ray = rotation * output.RayFromPixel(x + 0.5, y + 0.5);
        const RadianceSample sample = sampler.Sample(ray.cast<float>());
        if ((sample.flags & kMasked) == 0) {
          std::copy(sample.rgb.begin(), sample.rgb.end(), radiance.pixel(x, y));
        }
      }
    }
  });
  return radiance;
}

}  // namespace omnihdr
