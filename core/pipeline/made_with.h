#pragma once

#include <filesystem>
#include <string>

#include "core/base/result.h"
#include "core/pipeline/options.h"

namespace omnihdr {

// What decides a view's bytes beside the journal and the frames, as eight hex digits (CRC-32C):
// every option, what is in the mask's file (not its name), the session's rig.toml and the lens
// masks it names. view.json tells it (made_with), so that a session continued or looked at again
// with anything else is noticed. Errors: a mask or rig.toml that cannot be read.
Result<std::string> MadeWith(const PipelineOptions& options, const std::filesystem::path& session);

// Says that views of `views_directory` were made with something else than `made_with`; "" when they
// were not, or do not tell. Looks at the first and the last complete view.
std::string OtherwiseMade(const std::filesystem::path& views_directory,
                          const std::string& made_with);

}  // namespace omnihdr
