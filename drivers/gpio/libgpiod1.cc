#include <gpiod.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <ctime>
#include <utility>

#include "drivers/gpio/lines.h"

// Lines over libgpiod 1.6, which speaks the kernel's first interface: no debouncing, no sequence
// numbers, and a buffer of 16 events per line of which the kernel drops the newest when it is full.
namespace omnihdr::gpio {
namespace {

constexpr std::size_t kKernelBuffer = 16;
constexpr const char* kConsumer = "omnihdrd";

struct ChipCloser {
  void operator()(gpiod_chip* chip) const { gpiod_chip_close(chip); }
};
using Chip = std::unique_ptr<gpiod_chip, ChipCloser>;

// Kernels before 5.7 stamp events with CLOCK_REALTIME.
HostTime KernelTime(const timespec& stamp) {
  const auto ns = [](const timespec& t) {
    return static_cast<std::int64_t>(t.tv_sec) * 1'000'000'000 + t.tv_nsec;
  };
  const SystemClock clock;
  const std::int64_t monotonic = clock.Now().ns();
  const std::int64_t realtime = clock.NowUtc().ns();
  const std::int64_t time = ns(stamp);
  const bool is_realtime = std::abs(time - realtime) < std::abs(time - monotonic);
  return HostTime::FromNanoseconds(is_realtime ? time - realtime + monotonic : time);
}

int BiasFlags(Bias bias) {
  switch (bias) {
    case Bias::kAsIs:
      return 0;
    case Bias::kDisabled:
      return GPIOD_LINE_REQUEST_FLAG_BIAS_DISABLE;
    case Bias::kPullUp:
      return GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP;
    case Bias::kPullDown:
      return GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN;
  }
  return 0;
}

int RequestType(Edge edge) {
  switch (edge) {
    case Edge::kRising:
      return GPIOD_LINE_REQUEST_EVENT_RISING_EDGE;
    case Edge::kFalling:
      return GPIOD_LINE_REQUEST_EVENT_FALLING_EDGE;
    case Edge::kBoth:
      break;
  }
  return GPIOD_LINE_REQUEST_EVENT_BOTH_EDGES;
}

class EdgeLine1 final : public EdgeLine {
 public:
  EdgeLine1(Chip chip, gpiod_line* line, std::string name)
      : chip_(std::move(chip)), line_(line), name_(std::move(name)) {}
  ~EdgeLine1() override { gpiod_line_release(line_); }
  int fd() const override { return gpiod_line_event_get_fd(line_); }
  bool debounced() const override { return false; }

  Result<std::size_t> Read(std::span<EdgeEvent> events) override {
    std::array<gpiod_line_event, kKernelBuffer> raw{};
    const auto most = static_cast<unsigned>(std::min(events.size(), raw.size()));
    const int got = gpiod_line_event_read_multiple(line_, raw.data(), most);
    if (got < 0) return FailLine(fmt::format("read events of {}", name_), errno);
    for (int i = 0; i < got; ++i) {
      const gpiod_line_event& from = raw[static_cast<std::size_t>(i)];
      EdgeEvent& to = events[static_cast<std::size_t>(i)];
      to = EdgeEvent{};
      to.time = KernelTime(from.ts);
      to.rising = from.event_type == GPIOD_LINE_EVENT_RISING_EDGE;
      to.buffer_was_full = static_cast<std::size_t>(i) + 1 == kKernelBuffer;
    }
    return static_cast<std::size_t>(got);
  }

 private:
  Chip chip_;
  gpiod_line* line_;
  const std::string name_;
};

class OutputLine1 final : public OutputLine {
 public:
  OutputLine1(Chip chip, gpiod_line* line, std::string name)
      : chip_(std::move(chip)), line_(line), name_(std::move(name)) {}
  ~OutputLine1() override {
    gpiod_line_set_value(line_, 0);
    gpiod_line_release(line_);
  }
  Status Set(bool active) override {
    if (gpiod_line_set_value(line_, active ? 1 : 0) == 0) return {};
    return FailLine(fmt::format("set {}", name_), errno);
  }

 private:
  Chip chip_;
  gpiod_line* line_;
  const std::string name_;
};

struct Found {
  Chip chip;
  gpiod_line* line = nullptr;
};

// A chip by path, label or name. The library's own search ends at the first chip that may not be
// opened.
Result<Chip> OpenChip(const std::string& name) {
  if (name.starts_with('/')) {
    if (Chip chip(gpiod_chip_open(name.c_str())); chip) return chip;
    return FailLine(fmt::format("GPIO chip {}", name), errno);
  }
  int reason = ENOENT;
  Chip by_name;
  for (const std::string& path : ChipPaths()) {
    Chip chip(gpiod_chip_open(path.c_str()));
    if (!chip) {
      reason = errno;
      continue;
    }
    if (gpiod_chip_label(chip.get()) == name) return chip;
    if (gpiod_chip_name(chip.get()) == name) by_name = std::move(chip);
  }
  if (by_name) return by_name;
  return FailLine(fmt::format("GPIO chip {}", name), reason);
}

Result<Found> Find(const LineName& name) {
  Found found;
  OMNIHDR_ASSIGN(found.chip, OpenChip(name.chip));
  found.line = gpiod_chip_find_line(found.chip.get(), name.line.c_str());
  const int offset = OffsetFromText(name.line);
  if (found.line == nullptr && offset >= 0) {
    if (static_cast<unsigned>(offset) >= gpiod_chip_num_lines(found.chip.get())) {
      return Fail(ErrorKind::kUnavailable, "GPIO {}: the chip has lines 0 to {}", name.Text(),
                  static_cast<int>(gpiod_chip_num_lines(found.chip.get())) - 1);
    }
    found.line = gpiod_chip_get_line(found.chip.get(), static_cast<unsigned>(offset));
  }
  if (found.line == nullptr) return FailLine(fmt::format("GPIO {}", name.Text()), errno);
  return found;
}

class Lines1 final : public Lines {
 public:
  std::string_view library() const override { return "libgpiod 1"; }

  Result<std::unique_ptr<EdgeLine>> RequestEdges(const EdgeRequest& request) override {
    OMNIHDR_ASSIGN(Found found, Find(request.name));
    const gpiod_line_request_config config{kConsumer, RequestType(request.edge),
                                           BiasFlags(request.bias)};
    if (gpiod_line_request(found.line, &config, 0) != 0) {
      return FailLine(fmt::format("request GPIO {}", request.name.Text()), errno);
    }
    return std::make_unique<EdgeLine1>(std::move(found.chip), found.line, request.name.Text());
  }

  Result<std::unique_ptr<OutputLine>> RequestOutput(const OutputRequest& request) override {
    OMNIHDR_ASSIGN(Found found, Find(request.name));
    const gpiod_line_request_config config{
        kConsumer, GPIOD_LINE_REQUEST_DIRECTION_OUTPUT,
        request.active_low ? GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW : 0};
    if (gpiod_line_request(found.line, &config, 0) != 0) {
      return FailLine(fmt::format("request GPIO {}", request.name.Text()), errno);
    }
    return std::make_unique<OutputLine1>(std::move(found.chip), found.line, request.name.Text());
  }
};

}  // namespace

std::unique_ptr<Lines> MakeLines() { return std::make_unique<Lines1>(); }

}  // namespace omnihdr::gpio
