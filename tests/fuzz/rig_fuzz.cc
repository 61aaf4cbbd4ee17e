#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "core/session/rig_edit.h"
#include "core/session/rig_file.h"

// Laws: any bytes give a rig or an error with a message; a rig that was read is valid, what is
// written of it reads back, and the second writing equals the first; its lenses answer any pixel;
// every sensor can be given other gains, fall-off and response where it stands, and what is there
// already is left alone.
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
  for (const RigSensor& sensor : rig->sensors) {
    const std::array edit = {RigEdit{sensor.name, std::array{1.5, 1.0, 1.25},
                                     std::array{0.1, 0.0, 0.0}, Response::Linear(3.0).value()}};
    const Result<std::string> edited = EditRig(text, "rig.toml", edit);
    if (!edited && size + 200 < kMaxRigBytes) std::abort();
    if (edited && EditRig(*edited, "rig.toml", edit).value() != *edited) std::abort();
  }
  return 0;
}
