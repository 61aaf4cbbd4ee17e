#pragma once

#include <chrono>
#include <functional>
#include <thread>

namespace omnihdr::testing {

// True as soon as `holds` does, which is asked every two milliseconds; false when it does not
// within `timeout`.
inline bool Eventually(const std::function<bool()>& holds,
                       std::chrono::seconds timeout = std::chrono::seconds(5)) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  while (std::chrono::steady_clock::now() < deadline) {
    if (holds()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return holds();
}

}  // namespace omnihdr::testing
