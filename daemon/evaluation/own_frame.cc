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
#include "core/pipeline/rig_masks.h"

namespace omnihdr {
Result<FrameMeasurer> OpenOwnFrames(const std::filesystem::path& session, const SessionInfo& info,
                                    const FrameMaskOptions& options) {
  const CameraDescription& camera = info.camera;
  const bool is_rig = camera.layout == Layout::kRig;
  Image<std::uint8_t> mask;
  if (!options.file.empty()) {
    OMNIHDR_ASSIGN(mask, ReadMask(options.file).Context("mask"));
  }
  if (options.ignore_bottom > 0.0) {
    if (mask.empty()) {
      // A rig's panorama has no size of its own; rows are counted in thousandths of it.
      mask = is_rig ? Image<std::uint8_t>(2000, 1000, 1, 255)
                    : Image<std::uint8_t>(camera.width, camera.height, 1, 255);
    } else if (is_rig && mask.width() != 2 * mask.height()) {
      return Fail(ErrorKind::kUsage,
                  "mask: {}: {}x{} pixels, expected a lat-long picture together with rows to be "
                  "ignored",
                  options.file.string(), mask.width(), mask.height());
    }
    const int first_ignored =
        mask.height() - static_cast<int>(std::lround(options.ignore_bottom * mask.height()));
    for (int y = std::max(first_ignored, 0); y < mask.height(); ++y) {
      std::memset(mask.row(y), 0, static_cast<std::size_t>(mask.width()));
    }
  }
  return FrameMeasurer::Open(session, info, mask.view(), "mask: " + options.file.string());
}

Result<Image<float>> OwnFrameRadiance(const std::filesystem::path& session, FrameMeasurer& measurer,
                                      const FrameRecord& frame, const Projection& output,
                                      const Eigen::Quaterniond& camera_from_output) {
  OMNIHDR_ASSIGN(const DecodedImage picture, ReadImage(session / frame.file));
  const std::array<ExposedFrame, 1> exposed = {ExposedFrame{&picture, frame.exposure}};
  OMNIHDR_ASSIGN(const Measurement measurement,
                 measurer.Measure(exposed, MeasureOptions{}).Context(frame.file));
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
