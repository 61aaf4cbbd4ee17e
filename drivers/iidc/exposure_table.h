#pragma once

#include <cmath>
#include <cstdint>
#include <map>
#include <optional>

namespace omnihdr::iidc {

// What the camera's value register stands for, learnt from settings read back: the embedded frame
// information holds register values only. Law: Find answers only when everything learnt about a
// value agrees to within kTolerance.
class ExposureTable {
 public:
  static constexpr double kTolerance = 1e-3;  // relative

  void Learn(std::uint32_t raw, double value) {
    const auto [at, added] = entries_.try_emplace(raw, Entry{value, false});
    if (!added && std::abs(at->second.value - value) > kTolerance * std::abs(value) + 1e-9) {
      at->second.ambiguous = true;
    }
  }
  std::optional<double> Find(std::uint32_t raw) const {
    const auto found = entries_.find(raw);
    if (found == entries_.end() || found->second.ambiguous) return std::nullopt;
    return found->second.value;
  }
  bool ambiguous(std::uint32_t raw) const {
    const auto found = entries_.find(raw);
    return found != entries_.end() && found->second.ambiguous;
  }

 private:
  struct Entry {
    double value = 0.0;
    bool ambiguous = false;
  };
  std::map<std::uint32_t, Entry> entries_;  // at most 4096: values have 12 bits
};

}  // namespace omnihdr::iidc
