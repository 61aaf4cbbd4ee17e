#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "core/base/clock.h"
#include "core/base/stage.h"
#include "core/capture/appliance.h"
#include "drivers/gpio/lines.h"

namespace omnihdr::gpio {

struct OutputsOptions {
  std::string chip;
  std::string ready;   // line names; empty = there is none
  std::string busy;    //
  std::string fault;   //
  std::string strobe;  //
  bool active_low = false;
  double strobe_s = 0.001;   // 1e-5 to 1
  double reconnect_s = 2.0;  // between attempts to open a line
  bool configured() const {
    return !(ready.empty() && busy.empty() && fault.empty() && strobe.empty());
  }
  Status Validate() const;
};

// Lamps for the driver and a pulse with every picture:
//   ready   pictures are taken when triggered (armed or degraded)
//   busy    a picture is being taken
//   fault   no picture can be taken, or some are being lost (fault, storage full, no camera,
//           degraded)
//   strobe  a pulse of strobe_s when the camera is commanded
// All are inactive when the daemon has ended. A thread of its own opens the lines and ends the
// pulses.
class Outputs final : public StatusOutput, public StrobeOutput, public VehicleLink {
 public:
  Outputs(const OutputsOptions& options, std::unique_ptr<Lines> lines, const Clock& clock);
  ~Outputs() override;

  std::string_view name() const override { return "gpio outputs"; }
  Status Start() override;
  LinkReport report() const override;
  void Show(const ApplianceStatus& status) override;
  // kUnavailable when there is no such line (yet), kTemporary while the pulse before lasts.
  Status Pulse() override;

 private:
  enum Which { kReady, kBusy, kFault, kStrobe, kCount };
  struct Output {
    LineName name;
    std::unique_ptr<OutputLine> line;
    bool active = false;
    std::string problem;
  };
  Status Run(std::stop_token stop, Stage& self);
  void Set(Output& output, bool active);
  void OpenMissing();
  void EndPulse();

  const OutputsOptions options_;
  const std::unique_ptr<Lines> lines_;
  const Clock& clock_;

  mutable std::mutex mutex_;  // of what follows, up to the blank line
  std::condition_variable_any pulse_begun_;
  std::array<Output, kCount> outputs_;
  std::optional<HostTime> pulse_end_;
  LinkReport report_;

  std::unique_ptr<Stage> stage_;  // last: uses everything
};

}  // namespace omnihdr::gpio
