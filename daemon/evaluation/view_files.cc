#include "daemon/evaluation/view_files.h"

#include <algorithm>
#include <system_error>
#include <utility>

#include "core/image/exr.h"
#include "daemon/evaluation/picture_files.h"

namespace omnihdr {

Result<ViewFiles> ReadView(const std::filesystem::path& views, PositionId position) {
  ViewFiles view;
  OMNIHDR_ASSIGN(view.record, ReadViewRecord(views, position));
  const std::filesystem::path directory = views / ViewDirectoryName(position);
  const std::filesystem::path radiance_path = directory / "radiance.exr";
  OMNIHDR_ASSIGN(ExrImage radiance, ReadExr(radiance_path));
  OMNIHDR_ASSIGN(view.radiance, RadianceOf(radiance, radiance_path.string()));
  if (const auto origin = radiance.channels.find("origin"); origin != radiance.channels.end()) {
    view.origin = std::move(origin->second);
  }
  if (const auto sources = radiance.channels.find("sources"); sources != radiance.channels.end()) {
    const Image<float>& values = sources->second;
    view.sources = Image<std::uint8_t>(values.width(), values.height());
    std::transform(
        values.values().begin(), values.values().end(), view.sources.values().begin(),
        [](float v) { return static_cast<std::uint8_t>(v > 0.0F ? std::min(v, 255.0F) : 0.0F); });
  }
  const std::filesystem::path disparity_path = directory / "disparity.exr";
  std::error_code error;
  if (!std::filesystem::exists(disparity_path, error)) return view;
  OMNIHDR_ASSIGN(ExrImage disparity, ReadExr(disparity_path));
  const auto found = disparity.channels.find("disparity");
  if (found == disparity.channels.end() || disparity.width != radiance.width ||
      disparity.height != radiance.height) {
    return Fail(ErrorKind::kData,
                "{}: expected a channel \"disparity\" of {}x{}, the radiance's size",
                disparity_path.string(), radiance.width, radiance.height);
  }
  view.disparity = std::move(found->second);
  if (const auto confidence = disparity.channels.find("confidence");
      confidence != disparity.channels.end()) {
    view.confidence = std::move(confidence->second);
  }
  return view;
}

}  // namespace omnihdr
