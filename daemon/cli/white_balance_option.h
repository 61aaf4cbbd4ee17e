#pragma once

#include <array>
#include <string>
#include <vector>

#include "core/base/result.h"

namespace CLI {
class App;
}

namespace omnihdr {

// --white-balance R,G,B; `gains` stays empty when it is not given.
void AddWhiteBalanceOption(CLI::App* command, const std::string& help, std::vector<double>* gains);
// Error kUsage: not three gains in [0.1, 10].
Result<std::array<double, 3>> WhiteBalanceOf(const std::vector<double>& gains);

}  // namespace omnihdr
