#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/base/result.h"
#include "core/photometry/response.h"

namespace omnihdr {

// What a calibration changes of a sensor in a rig file; what is not set stays as it is.
struct RigEdit {
  std::string sensor;  // its name
  std::optional<std::array<double, 3>> gain;
  std::optional<std::array<double, 3>> vignetting;  // coefficients
  std::optional<Response> response;
};

// The text of a rig file with the edits made, in their order, and every other byte as it was:
// comments, order and layout are the owner's. Of a gain or vignetting the numbers that differ are
// replaced; a key that is missing gets a line of its own behind the sensor's other keys. Law: read
// back, it is the rig of `text` with the edits made, and nothing else has changed.
// Errors: `text` is not a rig file (as ParseRig), kUsage: no sensor of that name; what ParseRig
// says of the edited text.
Result<std::string> EditRig(std::string_view text, const std::string& name,
                            std::span<const RigEdit> edits);

// The same in a file, which is replaced in one step.
Status EditRigFile(const std::filesystem::path& path, std::span<const RigEdit> edits);

}  // namespace omnihdr
