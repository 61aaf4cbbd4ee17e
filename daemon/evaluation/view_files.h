#pragma once

#include <cstdint>
#include <filesystem>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/session/session.h"
#include "core/session/view_writer.h"

namespace omnihdr {

// A written view, read back.
struct ViewFiles {
  ViewRecord record;
  Image<float> radiance;  // W×H×3
  Image<float>
      disparity;  // W×H×1, 1/metre or 1/baseline unit; empty when the view has none (temporal)
  Image<float> confidence;      // W×H×1, of the disparity; empty when the file has none
  Image<float> origin;          // W×H×1, PixelOrigin
  Image<std::uint8_t> sources;  // W×H×1, MergedView::sources; empty when not told
};
Result<ViewFiles> ReadView(const std::filesystem::path& views, PositionId position);

}  // namespace omnihdr
