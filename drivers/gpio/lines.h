#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr::gpio {

// A line by the label or name of its chip ("pinctrl-bcm2711", "gpiochip0", "/dev/gpiochip0") and by
// its own name or, where it has none, its offset on the chip ("17"). Numbers of chips change from
// one start of the machine to the next; labels and names do not.
struct LineName {
  std::string chip;
  std::string line;
  bool configured() const { return !line.empty(); }
  std::string Text() const { return chip + " line " + line; }
};

// Edges of the voltage: rising is from low to high.
enum class Edge { kRising, kFalling, kBoth };
std::string_view ToString(Edge edge);
enum class Bias { kAsIs, kDisabled, kPullUp, kPullDown };
std::string_view ToString(Bias bias);

struct EdgeRequest {
  LineName name;
  Edge edge = Edge::kRising;
  Bias bias = Bias::kAsIs;
  Nanoseconds debounce{0};  // asked of the kernel, where it can
};

struct EdgeEvent {
  HostTime time;  // CLOCK_MONOTONIC, taken by the kernel in its interrupt
  bool rising = true;
  std::uint64_t lost_before = 0;  // edges of this line that the kernel dropped before this one
  // The kernel's buffer was full when this event was read and the kernel does not count: edges
  // after this one may be lost.
  bool buffer_was_full = false;
};

// An input line of which the kernel keeps the edges. One thread.
class EdgeLine {
 public:
  virtual ~EdgeLine() = default;
  // Readable when there are edges.
  virtual int fd() const = 0;
  // Whether the kernel suppresses bouncing.
  virtual bool debounced() const = 0;
  // The oldest edges not yet read. Call when fd() is readable: else it waits. kUnavailable when the
  // chip has gone.
  virtual Result<std::size_t> Read(std::span<EdgeEvent> events) = 0;
};

struct OutputRequest {
  LineName name;
  bool active_low = false;
};

// An output line, inactive until set and inactive again when it is destroyed.
class OutputLine {
 public:
  virtual ~OutputLine() = default;
  virtual Status Set(bool active) = 0;
};

// The machine's lines. The only thing that knows a library.
class Lines {
 public:
  virtual ~Lines() = default;
  virtual std::string_view library() const = 0;
  // kUnavailable when there is no such chip or line (yet), or when it is in use; kPermission when
  // it may not be opened.
  virtual Result<std::unique_ptr<EdgeLine>> RequestEdges(const EdgeRequest& request) = 0;
  virtual Result<std::unique_ptr<OutputLine>> RequestOutput(const OutputRequest& request) = 0;
};

// Lines by libgpiod, version 1 or 2 as found when this was built.
std::unique_ptr<Lines> MakeLines();

// Most edges that one Read gives.
inline constexpr std::size_t kMostEvents = 64;

// The paths of all chips, in order.
std::vector<std::string> ChipPaths();
// The offset a line's text says, -1 when it is no number.
int OffsetFromText(const std::string& text);
// What opening or requesting a line failed with, as a Result.
tl::unexpected<Error> FailLine(const std::string& what, int error_number);

}  // namespace omnihdr::gpio
