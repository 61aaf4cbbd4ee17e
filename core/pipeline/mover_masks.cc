#include "core/pipeline/mover_masks.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <system_error>

#include "core/pipeline/rig_masks.h"

namespace omnihdr {

Status MarkMovers(const std::filesystem::path& folder, const FrameRecord& frame,
                  Measurement* measurement) {
  const std::filesystem::path file =
      folder / std::filesystem::path(frame.file).filename().replace_extension(".png");
  std::error_code error;
  if (!std::filesystem::exists(file, error)) return {};
  OMNIHDR_ASSIGN(const Image<std::uint8_t> mask, ReadMask(file));
  Image<std::uint8_t>& flags = measurement->flags;
  const double shape = static_cast<double>(flags.width()) / flags.height();
  const double mask_shape = static_cast<double>(mask.width()) / mask.height();
  if (std::abs(mask_shape / shape - 1.0) > 0.01) {
    return Fail(ErrorKind::kData, "{}: {}x{}, expected the shape of the panorama, {}x{}",
                file.string(), mask.width(), mask.height(), flags.width(), flags.height());
  }
  const double x_scale = static_cast<double>(mask.width()) / flags.width();
  const double y_scale = static_cast<double>(mask.height()) / flags.height();
  for (int y = 0; y < flags.height(); ++y) {
    const int my = std::min(static_cast<int>((y + 0.5) * y_scale), mask.height() - 1);
    for (int x = 0; x < flags.width(); ++x) {
      const int mx = std::min(static_cast<int>((x + 0.5) * x_scale), mask.width() - 1);
      if (mask.at(mx, my) >= 128) flags.at(x, y) |= kMover;
    }
  }
  return {};
}

}  // namespace omnihdr
