#pragma once

#include <cstdint>
#include <filesystem>

#include "core/base/result.h"
#include "core/image/image.h"
#include "daemon/evaluation/evaluation.h"

namespace omnihdr {

struct ContactSheetOptions {
  EvaluationOptions evaluation;  // which views, reference and mask
  int cell_width = 480;          // of one picture, pixels
  int rows = 12;                 // at most; positions beyond are sampled evenly
};

// A picture to look a session over: a row a position, with its input frame, the tone-mapped view,
// the disparity in false colour (near warm, far cool, unknown hatched; one scale for the whole
// sheet) and, where a reference exists, the error (blue too dark, red too bright, grey unknown).
// Pictures are in the view's orientation. RGB, 8 bits. Errors: as EvaluateSession, and a session
// without any view.
Result<Image<std::uint8_t>> MakeContactSheet(const std::filesystem::path& session,
                                             const ContactSheetOptions& options);

}  // namespace omnihdr
