#include "daemon/cli/rig_sensor.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <vector>

#include "core/photometry/mosaic.h"
#include "core/session/rig_file.h"
#include "daemon/cli/exposed_image.h"

namespace omnihdr {

Result<RigSensorChoice> ChooseRigSensor(const std::string& rig_file, const std::string& sensor) {
  RigSensorChoice choice;
  choice.rig_file = rig_file;
  OMNIHDR_ASSIGN(choice.rig, ReadRig(rig_file));
  std::vector<std::string> names;
  for (const RigSensor& s : choice.rig.sensors) names.push_back(s.name);
  if (sensor.empty() && names.size() == 1) return choice;
  const auto named = std::find(names.begin(), names.end(), sensor);
  choice.index = static_cast<std::size_t>(named - names.begin());
  if (named == names.end()) {
    const char* end = sensor.data() + sensor.size();
    const auto [stopped, error] = std::from_chars(sensor.data(), end, choice.index);
    if (error != std::errc{} || stopped != end || choice.index >= names.size()) {
      return Fail(ErrorKind::kUsage, "--sensor {}: {} has {} (0 to {})",
                  sensor.empty() ? "is missing" : sensor, rig_file, fmt::join(names, ", "),
                  names.size() - 1);
    }
  }
  return choice;
}

Result<Image<std::uint8_t>> MaskOfSensor(const RigSensorChoice& choice, const std::string& frame,
                                         int width, int height,
                                         ImageView<const std::uint8_t> mask) {
  const RigSensor& sensor = choice.sensor();
  const Lens& lens = sensor.lens;
  int first_row = 0;
  if (width != lens.width() || height != lens.height()) {
    const Result<std::vector<int>> rows = StackedRows(choice.rig);
    if (!rows || width != lens.width() || height != rows->back()) {
      return Fail(
          ErrorKind::kData, "{}: {}x{}, expected {}x{} as sensor {} of {}{}", frame, width, height,
          lens.width(), lens.height(), sensor.name, choice.rig_file,
          rows ? fmt::format(", or {}x{} with all sensors stacked", lens.width(), rows->back())
               : "");
    }
    first_row = (*rows)[choice.index];
  }
  Image<std::uint8_t> own;
  if (!sensor.mask_file.empty()) {
    const std::filesystem::path file =
        std::filesystem::path(choice.rig_file).parent_path() / sensor.mask_file;
    OMNIHDR_ASSIGN(own, LoadPictureMask(file.string(), lens.width(), lens.height()));
  }
  Image<std::uint8_t> result(width, height);
  for (int y = 0; y < lens.height(); ++y) {
    for (int x = 0; x < width; ++x) {
      const bool use = (mask.empty() || mask.at(x, first_row + y) >= 128) &&
                       (own.empty() || own.at(x, y) >= 128);
      result.at(x, first_row + y) = use ? 255 : 0;
    }
  }
  return result;
}

}  // namespace omnihdr
