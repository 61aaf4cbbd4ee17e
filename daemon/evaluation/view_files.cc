#include "daemon/evaluation/view_files.h"

#include <array>
#include <system_error>
#include <utility>

#include "core/image/exr.h"

namespace omnihdr {

Result<ViewFiles> ReadView(const std::filesystem::path& views, PositionId position) {
  ViewFiles view;
  OMNIHDR_ASSIGN(view.record, ReadViewRecord(views, position));
  const std::filesystem::path directory = views / ViewDirectoryName(position);
  const std::filesystem::path radiance_path = directory / "radiance.exr";
  OMNIHDR_ASSIGN(const ExrImage radiance, ReadExr(radiance_path));
  view.radiance = Image<float>(radiance.width, radiance.height, 3);
  constexpr std::array<const char*, 3> kNames = {"R", "G", "B"};
  for (int c = 0; c < 3; ++c) {
    const char* name = kNames[static_cast<std::size_t>(c)];
    const auto found = radiance.channels.find(name);
    if (found == radiance.channels.end()) {
      return Fail(ErrorKind::kData, "{}: no channel {}, expected R, G and B",
                  radiance_path.string(), name);
    }
    for (int y = 0; y < radiance.height; ++y) {
      for (int x = 0; x < radiance.width; ++x) view.radiance.at(x, y, c) = found->second.at(x, y);
    }
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
  return view;
}

}  // namespace omnihdr
