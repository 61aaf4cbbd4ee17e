#include "daemon/cli/grid_option.h"

#include <fmt/format.h>

#include <cstddef>
#include <utility>

#include "core/image/image_io.h"

namespace omnihdr {

Result<SphereGrid> GridToWrite(SphereGridKind kind, int size, const SphereGrid& source,
                               double z_min, double z_max) {
  if (size % 2 != 0 && kind == SphereGridKind::kEquirectangular) {
    return Fail(ErrorKind::kUsage, "--size: {}, expected an even width for --to latlong", size);
  }
  const SphereGrid grid =
      size > 0 ? GridOfSize(kind, size, z_min, z_max) : GridAsFineAs(source, kind, z_min, z_max);
  const std::size_t pixels =
      static_cast<std::size_t>(grid.width()) * static_cast<std::size_t>(grid.height());
  if (pixels > kMaxImagePixels) {
    return Fail(ErrorKind::kUsage, "--size: a picture of {}x{}, expected at most {} pixels",
                grid.width(), grid.height(), kMaxImagePixels);
  }
  return grid;
}

ExrAttributes AttributesFor(const SphereGrid& target, ExrAttributes attributes) {
  attributes.envmap = ExrEnvmap::kNone;
  attributes.strings.erase(kProjectionAttribute);
  attributes.floats.erase(kZMinAttribute);
  attributes.floats.erase(kZMaxAttribute);
  switch (target.kind()) {
    case SphereGridKind::kEquirectangular:
      attributes.envmap = ExrEnvmap::kLatLong;
      break;
    case SphereGridKind::kCubeStrip:
      attributes.envmap = ExrEnvmap::kCube;
      break;
    case SphereGridKind::kCylindrical:
      attributes.floats[kZMinAttribute] = target.z_min();
      attributes.floats[kZMaxAttribute] = target.z_max();
      [[fallthrough]];
    case SphereGridKind::kCubeCross:
    case SphereGridKind::kRhombicDodecahedron:
      attributes.strings[kProjectionAttribute] = ToString(target.kind());
      break;
  }
  return attributes;
}

std::string Shown(const SphereGrid& grid) {
  std::string text = fmt::format("{} {}x{}", ToString(grid.kind()), grid.width(), grid.height());
  if (grid.kind() == SphereGridKind::kCylindrical) {
    text += fmt::format(" (z {:.4g} to {:.4g})", grid.z_min(), grid.z_max());
  } else if (grid.faces() > 1) {
    text += fmt::format(" ({} faces of {})", grid.faces(), grid.face_width());
  }
  return text;
}

}  // namespace omnihdr
