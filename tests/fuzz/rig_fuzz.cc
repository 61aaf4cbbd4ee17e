#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "core/session/rig_file.h"

// Laws: any bytes give a rig or an error with a message; a rig that was read is valid, what is
// written of it reads back, and the second writing equals the first; its lenses answer any pixel.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const Result<Rig> rig = ParseRig(text, "rig.toml");
  if (!rig) {
    if (rig.error().message.empty()) std::abort();
    return 0;
  }
  if (!rig->Validate()) std::abort();
  const std::string written = FormatRig(*rig);
  const Result<Rig> again = ParseRig(written, "again.toml");
  if (!again || FormatRig(*again) != written) std::abort();
  for (const RigSensor& sensor : rig->sensors) {
    const Lens& lens = sensor.lens;
    for (int k = 0; k < 16; ++k) {
      const auto ray =
          lens.RayFromPixel(lens.width() * (k % 4) / 3.0, lens.height() * (k / 4) / 3.0);
      if (!ray) continue;
      if (!(std::abs(ray->norm() - 1.0) < 1e-9)) std::abort();
      const auto pixel = lens.PixelFromRay(*ray);
      if (pixel && !(pixel->x() >= 0.0 && pixel->x() <= lens.width())) std::abort();
    }
  }
  return 0;
}
