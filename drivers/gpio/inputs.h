#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/base/stage.h"
#include "core/capture/appliance.h"
#include "drivers/gpio/edge_filter.h"
#include "drivers/gpio/edge_trigger.h"
#include "drivers/gpio/lines.h"
#include "drivers/gpio/wheel_odometer.h"

namespace omnihdr::gpio {

struct InputOptions {
  LineName name;  // not configured = there is none
  Edge edge = Edge::kRising;
  Bias bias = Bias::kAsIs;
  double debounce_s = 0.0;  // 0 to 1
  Status Validate() const;
};

struct InputsOptions {
  InputOptions trigger;
  InputOptions wheel;
  double pulses_per_metre = 100.0;  // 0.01 to 1e6
  double start_m = 0.0;             // the wheel's reading before its first pulse
  double reconnect_s = 2.0;         // longest pause between attempts to open a line
  Status Validate() const;
};

// Reads the trigger's and the wheel's line with a thread of its own, at real-time priority where
// that is allowed: the kernel keeps only 16 edges for programs of libgpiod 1, and the main loop may
// have other things to do. A line that is not there, or goes, is opened again and again.
class Inputs final : public VehicleLink {
 public:
  // Options must be valid; `clock` must outlive the inputs.
  Inputs(const InputsOptions& options, std::unique_ptr<Lines> lines, const Clock& clock);
  ~Inputs() override;

  std::string_view name() const override { return "gpio inputs"; }
  Status Start() override;
  LinkReport report() const override;

  // Null when its line is not configured.
  const std::shared_ptr<EdgeTrigger>& trigger() const { return trigger_; }
  const std::shared_ptr<WheelOdometer>& wheel() const { return wheel_; }

 private:
  struct Input {
    InputOptions options;
    std::unique_ptr<EdgeLine> line;
    std::optional<EdgeFilter> filter;
    PulseTrain train;
    HostTime try_again;
    std::string problem;
  };
  Status Run(std::stop_token stop, Stage& self);
  void Open(Input& input, bool is_wheel);
  void Hear(Input& input, bool is_wheel);
  void Report();

  const InputsOptions options_;
  const std::unique_ptr<Lines> lines_;
  const Clock& clock_;
  const std::shared_ptr<EdgeTrigger> trigger_;
  const std::shared_ptr<WheelOdometer> wheel_;
  Fd wake_;
  // The thread's own.
  Input trigger_input_;
  Input wheel_input_;

  mutable std::mutex mutex_;
  LinkReport report_;
  std::unique_ptr<Stage> stage_;  // last: uses everything
};

}  // namespace omnihdr::gpio
