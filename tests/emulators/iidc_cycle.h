#pragma once

#include <cstdint>
#include <random>

namespace omnihdr::emulators {

// Where an emulated camera's exposure cycle stands when a trigger begins a series of pictures (of
// one, but for trigger mode 15). No public source tells which of them a real camera does.
enum class CycleStart {
  kContinues,       // behind the picture before
  kBeginsAnew,      // at the first step
  kRandomStep,      // anywhere
  kSkipsAfterLoss,  // behind the picture before, one step left out when that was lost
};

// Which of the four steps the next picture takes.
class IidcCycle {
 public:
  static constexpr std::uint32_t kSteps = 4;

  explicit IidcCycle(CycleStart start, std::uint32_t first = 0) : start_(start), next_(first) {}

  void BeginSeries() {
    if (start_ == CycleStart::kBeginsAnew) next_ = 0;
    if (start_ == CycleStart::kRandomStep) next_ = random_() % kSteps;
  }
  std::uint32_t Take() {
    const std::uint32_t step = next_;
    next_ = (next_ + 1) % kSteps;
    return step;
  }
  void FrameLost() {
    if (start_ == CycleStart::kSkipsAfterLoss) Skip();
  }
  void Skip() { next_ = (next_ + 1) % kSteps; }

 private:
  CycleStart start_;
  std::uint32_t next_;
  std::minstd_rand random_{7};
};

}  // namespace omnihdr::emulators
