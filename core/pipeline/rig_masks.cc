#include "core/pipeline/rig_masks.h"

#include <algorithm>
#include <variant>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/image/image_io.h"
#include "core/photometry/mosaic.h"

namespace omnihdr {
namespace {

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

// The same in any projection.
Image<std::uint8_t> Projected(ImageView<const std::uint8_t> mask, const SphereGrid& grid) {
  if (grid.kind() == SphereGridKind::kEquirectangular) {
    return Resized(mask, grid.width(), grid.height());
  }
  const SphereGrid from = SphereGrid::Equirectangular(mask.width(), mask.height());
  Image<std::uint8_t> projected(grid.width(), grid.height());
  ParallelFor(grid.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < grid.width(); ++x) {
        const auto ray = grid.RayFromPixel(x + 0.5, y + 0.5);
        const auto at = ray ? from.PixelFromRay(*ray) : std::nullopt;
        if (!at) continue;
        projected.at(x, y) = mask.at(std::clamp(static_cast<int>(at->x()), 0, mask.width() - 1),
                                     std::clamp(static_cast<int>(at->y()), 0, mask.height() - 1));
      }
    }
  });
  return projected;
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

Result<Image<std::uint8_t>> ReadLensMasks(const Rig& rig, const std::filesystem::path& directory) {
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

Result<RigMasks> ReadRigMasks(const Rig& rig, const std::filesystem::path& directory,
                              const SphereGrid& grid, ImageView<const std::uint8_t> mask,
                              const std::string& mask_name) {
  OMNIHDR_ASSIGN(const std::vector<int> rows, StackedRows(rig));
  RigMasks masks;
  OMNIHDR_ASSIGN(masks.sensors, ReadLensMasks(rig, directory));
  const int width = rig.sensors.front().lens.width();
  const int height = rows.back();
  if (mask.empty()) return masks;
  if (mask.width() == width && mask.height() == height) {
    if (masks.sensors.empty()) masks.sensors = Image<std::uint8_t>(width, height, 1, 255);
    Intersect(mask, &masks.sensors);
    return masks;
  }
  if (mask.width() != 2 * mask.height()) {
    return Fail(ErrorKind::kData,
                "{}: {}x{} pixels, expected the stacked frames' size {}x{} or a lat-long picture "
                "twice as wide as high",
                mask_name, mask.width(), mask.height(), width, height);
  }
  masks.panorama = Projected(mask, grid);
  return masks;
}

}  // namespace omnihdr
