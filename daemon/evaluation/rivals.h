#pragma once

#include <filesystem>
#include <optional>
#include <string_view>

#include "core/base/result.h"
#include "daemon/evaluation/evaluation.h"

namespace omnihdr {

// What a session's views are to be compared with, made from the same frames.
enum class Rival {
  // Our merge with the scene's true poses and disparity: what is left is the merge's own error. A
  // reference line and no upper bound: neighbours' disagreement can tell more than true depth.
  kOracle,
  // The frames of the same neighbours averaged along equal directions, as if all had been taken at
  // one place: true rotations, no disparity, no weighing by agreement.
  kUnregistered,
};
std::string_view ToString(Rival rival);

// Writes OUTPUT/views of a session whose scene is known (simulation), in the form of any view.
// `width`: of the lat-long pictures, 0 = the frames' panorama. Errors: as ReadSession and
// OpenReference; a scene whose poses are not known; a perspective session; files that cannot be
// written.
Status WriteRivalViews(const std::filesystem::path& session, Rival rival,
                       const FrameMaskOptions& mask, int width,
                       const std::filesystem::path& output);

}  // namespace omnihdr
