#include <gpiod.h>

#include <algorithm>
#include <cerrno>
#include <string>
#include <utility>

#include "drivers/gpio/lines.h"

// Lines over libgpiod 2, which speaks the kernel's second interface: debouncing in the kernel, a
// sequence number with every event, a buffer as large as asked for of which the kernel drops the
// oldest when it is full.
namespace omnihdr::gpio {
namespace {

constexpr std::size_t kKernelBuffer = 1024;
constexpr const char* kConsumer = "omnihdrd";

template <auto Free>
struct Freer {
  template <typename T>
  void operator()(T* object) const {
    Free(object);
  }
};
using Chip = std::unique_ptr<gpiod_chip, Freer<gpiod_chip_close>>;
using ChipInfo = std::unique_ptr<gpiod_chip_info, Freer<gpiod_chip_info_free>>;
using Settings = std::unique_ptr<gpiod_line_settings, Freer<gpiod_line_settings_free>>;
using Config = std::unique_ptr<gpiod_line_config, Freer<gpiod_line_config_free>>;
using RequestConfig = std::unique_ptr<gpiod_request_config, Freer<gpiod_request_config_free>>;
using Request = std::unique_ptr<gpiod_line_request, Freer<gpiod_line_request_release>>;
using Buffer = std::unique_ptr<gpiod_edge_event_buffer, Freer<gpiod_edge_event_buffer_free>>;

gpiod_line_bias BiasSetting(Bias bias) {
  switch (bias) {
    case Bias::kAsIs:
      return GPIOD_LINE_BIAS_AS_IS;
    case Bias::kDisabled:
      return GPIOD_LINE_BIAS_DISABLED;
    case Bias::kPullUp:
      return GPIOD_LINE_BIAS_PULL_UP;
    case Bias::kPullDown:
      return GPIOD_LINE_BIAS_PULL_DOWN;
  }
  return GPIOD_LINE_BIAS_AS_IS;
}

gpiod_line_edge EdgeSetting(Edge edge) {
  switch (edge) {
    case Edge::kRising:
      return GPIOD_LINE_EDGE_RISING;
    case Edge::kFalling:
      return GPIOD_LINE_EDGE_FALLING;
    case Edge::kBoth:
      break;
  }
  return GPIOD_LINE_EDGE_BOTH;
}

class EdgeLine2 final : public EdgeLine {
 public:
  EdgeLine2(Request request, Buffer buffer, std::string name)
      : request_(std::move(request)), buffer_(std::move(buffer)), name_(std::move(name)) {}
  int fd() const override { return gpiod_line_request_get_fd(request_.get()); }
  bool debounced() const override { return true; }

  Result<std::size_t> Read(std::span<EdgeEvent> events) override {
    const std::size_t most = std::min(events.size(), kMostEvents);
    const int got = gpiod_line_request_read_edge_events(request_.get(), buffer_.get(), most);
    if (got < 0) return FailLine(fmt::format("read events of {}", name_), errno);
    for (int i = 0; i < got; ++i) {
      gpiod_edge_event* from =
          gpiod_edge_event_buffer_get_event(buffer_.get(), static_cast<unsigned long>(i));
      EdgeEvent& to = events[static_cast<std::size_t>(i)];
      to = EdgeEvent{};
      to.time = HostTime::FromNanoseconds(
          static_cast<std::int64_t>(gpiod_edge_event_get_timestamp_ns(from)));
      to.rising = gpiod_edge_event_get_event_type(from) == GPIOD_EDGE_EVENT_RISING_EDGE;
      // The first event has number 1; the number itself has 32 bits in the kernel.
      const auto number = static_cast<std::uint32_t>(gpiod_edge_event_get_line_seqno(from));
      to.lost_before = static_cast<std::uint32_t>(number - last_number_ - 1);
      last_number_ = number;
    }
    return static_cast<std::size_t>(got);
  }

 private:
  Request request_;
  Buffer buffer_;
  const std::string name_;
  std::uint32_t last_number_ = 0;
};

class OutputLine2 final : public OutputLine {
 public:
  OutputLine2(Request request, unsigned offset, std::string name)
      : request_(std::move(request)), offset_(offset), name_(std::move(name)) {}
  ~OutputLine2() override {
    gpiod_line_request_set_value(request_.get(), offset_, GPIOD_LINE_VALUE_INACTIVE);
  }
  Status Set(bool active) override {
    const gpiod_line_value value = active ? GPIOD_LINE_VALUE_ACTIVE : GPIOD_LINE_VALUE_INACTIVE;
    if (gpiod_line_request_set_value(request_.get(), offset_, value) == 0) return {};
    return FailLine(fmt::format("set {}", name_), errno);
  }

 private:
  Request request_;
  const unsigned offset_;
  const std::string name_;
};

// A chip by path, label or name. The library knows paths only.
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
    const ChipInfo info(gpiod_chip_get_info(chip.get()));
    if (!info) continue;
    if (gpiod_chip_info_get_label(info.get()) == name) return chip;
    if (gpiod_chip_info_get_name(info.get()) == name) by_name = std::move(chip);
  }
  if (by_name) return by_name;
  return FailLine(fmt::format("GPIO chip {}", name), reason);
}

Result<unsigned> FindOffset(gpiod_chip* chip, const LineName& name) {
  const int named = gpiod_chip_get_line_offset_from_name(chip, name.line.c_str());
  if (named >= 0) return static_cast<unsigned>(named);
  const int error = errno;
  const int offset = OffsetFromText(name.line);
  if (offset < 0) return FailLine(fmt::format("GPIO {}", name.Text()), error);
  const ChipInfo info(gpiod_chip_get_info(chip));
  const std::size_t count = info ? gpiod_chip_info_get_num_lines(info.get()) : 0;
  if (static_cast<std::size_t>(offset) >= count) {
    return Fail(ErrorKind::kUnavailable, "GPIO {}: the chip has lines 0 to {}", name.Text(),
                static_cast<int>(count) - 1);
  }
  return static_cast<unsigned>(offset);
}

struct Requested {
  Request request;
  unsigned offset = 0;
};

Result<Requested> RequestLine(const LineName& name, gpiod_line_settings* settings) {
  OMNIHDR_ASSIGN(const Chip chip, OpenChip(name.chip));
  Requested requested;
  OMNIHDR_ASSIGN(requested.offset, FindOffset(chip.get(), name));
  const Config lines(gpiod_line_config_new());
  const RequestConfig how(gpiod_request_config_new());
  if (!lines || !how ||
      gpiod_line_config_add_line_settings(lines.get(), &requested.offset, 1, settings) != 0) {
    return FailLine(fmt::format("GPIO {}", name.Text()), errno);
  }
  gpiod_request_config_set_consumer(how.get(), kConsumer);
  gpiod_request_config_set_event_buffer_size(how.get(), kKernelBuffer);
  requested.request.reset(gpiod_chip_request_lines(chip.get(), how.get(), lines.get()));
  if (!requested.request) return FailLine(fmt::format("request GPIO {}", name.Text()), errno);
  return requested;
}

class Lines2 final : public Lines {
 public:
  std::string_view library() const override { return "libgpiod 2"; }

  Result<std::unique_ptr<EdgeLine>> RequestEdges(const EdgeRequest& request) override {
    const Settings settings(gpiod_line_settings_new());
    if (!settings) return FailLine(fmt::format("GPIO {}", request.name.Text()), errno);
    gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_INPUT);
    gpiod_line_settings_set_edge_detection(settings.get(), EdgeSetting(request.edge));
    gpiod_line_settings_set_bias(settings.get(), BiasSetting(request.bias));
    gpiod_line_settings_set_event_clock(settings.get(), GPIOD_LINE_CLOCK_MONOTONIC);
    gpiod_line_settings_set_debounce_period_us(
        settings.get(), static_cast<unsigned long>(request.debounce.count() / 1000));
    OMNIHDR_ASSIGN(Requested requested, RequestLine(request.name, settings.get()));
    Buffer buffer(gpiod_edge_event_buffer_new(kMostEvents));
    if (!buffer) return FailLine(fmt::format("GPIO {}", request.name.Text()), errno);
    return std::make_unique<EdgeLine2>(std::move(requested.request), std::move(buffer),
                                       request.name.Text());
  }

  Result<std::unique_ptr<OutputLine>> RequestOutput(const OutputRequest& request) override {
    const Settings settings(gpiod_line_settings_new());
    if (!settings) return FailLine(fmt::format("GPIO {}", request.name.Text()), errno);
    gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_OUTPUT);
    gpiod_line_settings_set_active_low(settings.get(), request.active_low);
    gpiod_line_settings_set_output_value(settings.get(), GPIOD_LINE_VALUE_INACTIVE);
    OMNIHDR_ASSIGN(Requested requested, RequestLine(request.name, settings.get()));
    return std::make_unique<OutputLine2>(std::move(requested.request), requested.offset,
                                         request.name.Text());
  }
};

}  // namespace

std::unique_ptr<Lines> MakeLines() { return std::make_unique<Lines2>(); }

}  // namespace omnihdr::gpio
