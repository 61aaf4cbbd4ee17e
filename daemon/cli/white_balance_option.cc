#include "daemon/cli/white_balance_option.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>

namespace omnihdr {

void AddWhiteBalanceOption(CLI::App* command, const std::string& help, std::vector<double>* gains) {
  command->add_option("--white-balance", *gains, help)->delimiter(',')->expected(3);
}

Result<std::array<double, 3>> WhiteBalanceOf(const std::vector<double>& gains) {
  std::array<double, 3> balance{};
  const bool in_range = std::all_of(gains.begin(), gains.end(),
                                    [](double gain) { return gain >= 0.1 && gain <= 10.0; });
  if (gains.size() != balance.size() || !in_range) {
    return Fail(ErrorKind::kUsage, "--white-balance: {}, expected three gains in [0.1, 10]",
                fmt::join(gains, ","));
  }
  std::copy(gains.begin(), gains.end(), balance.begin());
  return balance;
}

}  // namespace omnihdr
