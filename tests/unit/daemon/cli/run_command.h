#pragma once

#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "daemon/cli/command.h"

namespace omnihdr::testing {

// The outcome of `omnihdr WORDS`, of which only `commands` exist, and what it printed; an error of
// parsing is kUsage.
inline Result<int> RunCommand(const std::vector<AddCommand>& commands,
                              std::vector<std::string> words, std::string* printed) {
  CLI::App app("omnihdr");
  CommandRun run;
  for (const AddCommand add : commands) add(app, run);
  std::reverse(words.begin(), words.end());
  try {
    app.parse(std::move(words));
  } catch (const CLI::ParseError& error) {
    return Fail(ErrorKind::kUsage, "{}", error.what());
  }
  ::testing::internal::CaptureStdout();
  Result<int> result = run();
  *printed = ::testing::internal::GetCapturedStdout();
  return result;
}

}  // namespace omnihdr::testing
