#include "drivers/gpio/inputs.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <utility>

#include "core/base/realtime.h"

namespace omnihdr::gpio {
namespace {

constexpr int kTurnMs = 200;

Nanoseconds FromSeconds(double seconds) {
  return Nanoseconds(static_cast<Nanoseconds::rep>(std::llround(seconds * 1e9)));
}

Status CheckRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

EdgeFilterOptions FilterOptions(const InputOptions& options) {
  return {options.edge, FromSeconds(options.debounce_s)};
}

}  // namespace

Status InputOptions::Validate() const {
  if (!name.configured()) return {};
  if (name.chip.empty()) {
    return Fail(ErrorKind::kConfig, "chip: \"\": expected a chip's label or name for line {}",
                name.line);
  }
  return CheckRange("debounce_s", debounce_s, 0.0, 1.0);
}

Status InputsOptions::Validate() const {
  OMNIHDR_TRY(trigger.Validate().Context("trigger"));
  OMNIHDR_TRY(wheel.Validate().Context("wheel"));
  OMNIHDR_TRY(CheckRange("wheel.pulses_per_metre", pulses_per_metre, 0.01, 1e6));
  return CheckRange("reconnect_s", reconnect_s, 0.1, 3600.0);
}

Inputs::Inputs(const InputsOptions& options, std::unique_ptr<Lines> lines, const Clock& clock)
    : options_(options),
      lines_(std::move(lines)),
      clock_(clock),
      trigger_(options.trigger.name.configured() ? std::make_shared<EdgeTrigger>() : nullptr),
      wheel_(options.wheel.name.configured()
                 ? std::make_shared<WheelOdometer>(options.pulses_per_metre, options.start_m)
                 : nullptr),
      wake_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  trigger_input_.options = options.trigger;
  wheel_input_.options = options.wheel;
}

Inputs::~Inputs() {
  if (!stage_) return;
  stage_->RequestStop();
  const std::uint64_t one = 1;
  // Not written: the thread looks for itself within kTurnMs.
  [[maybe_unused]] const ssize_t written = write(wake_.get(), &one, sizeof one);
}

Status Inputs::Start() {
  if (stage_) return {};
  OMNIHDR_TRY(options_.Validate().Context("gpio"));
  stage_ = std::make_unique<Stage>(
      "gpio-inputs", [this](std::stop_token stop, Stage& self) { return Run(stop, self); });
  return {};
}

LinkReport Inputs::report() const {
  std::lock_guard lock(mutex_);
  LinkReport report = report_;
  if (!report.up && report.problem.empty()) report.problem = "opening the lines";
  return report;
}

void Inputs::Open(Input& input, bool is_wheel) {
  const EdgeFilterOptions filter = FilterOptions(input.options);
  EdgeRequest request;
  request.name = input.options.name;
  request.edge = input.options.edge;
  request.bias = input.options.bias;
  request.debounce = filter.debounce;
  Result<std::unique_ptr<EdgeLine>> line = lines_->RequestEdges(request);
  if (line && !(*line)->debounced() && EdgeFilter::RequestFor(filter) != request.edge) {
    line->reset();  // given back before it is asked for anew
    request.edge = EdgeFilter::RequestFor(filter);
    line = lines_->RequestEdges(request);
  }
  if (!line) {
    input.problem = line.error().message;
    input.try_again = clock_.Now() + FromSeconds(options_.reconnect_s);
    std::lock_guard lock(mutex_);
    ++report_.errors;
    return;
  }
  input.filter.emplace(filter, (*line)->debounced());
  input.train = {};
  input.line = std::move(*line);
  input.problem.clear();
  if (is_wheel) wheel_->Begin(clock_.Now());
  std::lock_guard lock(mutex_);
  ++report_.opened;
}

void Inputs::Hear(Input& input, bool is_wheel) {
  std::array<EdgeEvent, kMostEvents> events;
  const Result<std::size_t> got = input.line->Read(events);
  if (!got) {
    input.line.reset();
    input.problem = got.error().message;
    input.try_again = clock_.Now() + FromSeconds(options_.reconnect_s);
    std::lock_guard lock(mutex_);
    ++report_.errors;
    return;
  }
  std::uint64_t lost = 0;
  std::uint64_t counted_edges = 0;
  for (std::size_t i = 0; i < *got; ++i) {
    const std::optional<EdgeFilter::Counted> counted = input.filter->Take(events[i]);
    if (!counted) continue;
    ++counted_edges;
    if (is_wheel) {
      const std::uint64_t missing =
          counted->doubtful ? input.train.MissingBefore(counted->time) : 0;
      const bool estimated = missing > counted->lost_before;
      const std::uint64_t before = std::max(missing, counted->lost_before);
      wheel_->Pulse(counted->time, before, estimated);
      input.train.Add(counted->time);
      lost += before;
    } else {
      const std::uint64_t before = counted->lost_before > 0 ? counted->lost_before
                                   : counted->doubtful      ? 1
                                                            : 0;
      trigger_->Edge(counted->time, before,
                     counted->lost_before > 0
                         ? "the kernel lost this edge of the trigger line: its buffer was full"
                         : "edges of the trigger line may be lost here, one or more: the kernel's "
                           "buffer of 16 was full");
      lost += before;
    }
  }
  std::lock_guard lock(mutex_);
  report_.messages += counted_edges;
  report_.lost += lost;
}

void Inputs::Report() {
  std::string problem;
  bool up = true;
  for (const Input* input : {&trigger_input_, &wheel_input_}) {
    if (!input->options.name.configured()) continue;
    up = up && input->line != nullptr;
    if (input->problem.empty()) continue;
    problem += (problem.empty() ? "" : "; ") + input->problem;
  }
  std::lock_guard lock(mutex_);
  report_.up = up;
  report_.problem = std::move(problem);
}

Status Inputs::Run(std::stop_token stop, Stage& self) {
  // Refused without the privilege: then the kernel's buffer has to do.
  const RealtimeThread realtime(RealtimePriority::kEdges);
  const std::array<std::pair<Input*, bool>, 2> inputs = {
      {{&trigger_input_, false}, {&wheel_input_, true}}};
  while (!stop.stop_requested()) {
    self.Progress();
    std::array<pollfd, 3> waiting = {{{wake_.get(), POLLIN, 0}, {-1, POLLIN, 0}, {-1, POLLIN, 0}}};
    for (std::size_t i = 0; i < inputs.size(); ++i) {
      const auto& [input, is_wheel] = inputs[i];
      if (!input->options.name.configured()) continue;
      if (!input->line && clock_.Now() >= input->try_again) Open(*input, is_wheel);
      if (input->line) waiting[i + 1].fd = input->line->fd();
    }
    Report();
    if (poll(waiting.data(), waiting.size(), kTurnMs) < 0 && errno != EINTR) {
      return FailErrno(ErrorKind::kSystem, "gpio: poll", errno);
    }
    for (std::size_t i = 0; i < inputs.size(); ++i) {
      const auto& [input, is_wheel] = inputs[i];
      if (waiting[i + 1].revents == 0) continue;
      if ((waiting[i + 1].revents & POLLIN) != 0) {
        Hear(*input, is_wheel);
      } else {
        input->line.reset();
        input->problem = fmt::format("{}: the chip has gone", input->options.name.Text());
        input->try_again = clock_.Now() + FromSeconds(options_.reconnect_s);
      }
    }
  }
  return {};
}

}  // namespace omnihdr::gpio
