#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "core/base/clock.h"
#include "core/base/stage.h"
#include "core/capture/appliance.h"
#include "core/ports/camera_release.h"
#include "drivers/gpio/lines.h"

namespace omnihdr::gpio {

struct CameraTriggerOptions {
  LineName name;
  bool active_low = false;
  double pulse_s = 0.001;    // 1e-5 to 1
  double spacing_s = 0.02;   // from a pulse's begin to the next one's, above pulse_s, at most 10
  double reconnect_s = 2.0;  // between attempts to open the line
  bool configured() const { return name.configured(); }
  Status Validate() const;
};

// The line whose pulses make a camera expose. It is inactive until the first pulse and again when
// this has ended. Law: a pulse lasts pulse_s at least, and begins spacing_s or more after the begin
// of the one before and after its end. A thread of its own opens the line and ends the pulses; a
// pulse that cannot be ended, for the chip has gone, is reported and the line opened anew.
class CameraTrigger final : public CameraRelease, public VehicleLink {
 public:
  CameraTrigger(const CameraTriggerOptions& options, std::unique_ptr<Lines> lines,
                const Clock& clock);
  ~CameraTrigger() override;
  CameraTrigger(const CameraTrigger&) = delete;
  CameraTrigger& operator=(const CameraTrigger&) = delete;

  std::string_view name() const override { return "gpio camera trigger"; }
  Status Start() override;
  // messages = pulses given, lost = pulses asked for that were not given.
  LinkReport report() const override;
  Result<Moment> Release(Nanoseconds patience) override;
  Nanoseconds spacing() const override;

 private:
  Status Run(std::stop_token stop, Stage& self);
  void Open();
  void EndPulse();                           // with mutex_
  void Break(const Error& error);            // with mutex_
  std::optional<HostTime> WaitsFor() const;  // with mutex_: when the next pulse may begin, if later

  const CameraTriggerOptions options_;
  const std::unique_ptr<Lines> lines_;
  const Clock& clock_;

  mutable std::mutex mutex_;  // of what follows, up to the blank line
  std::condition_variable_any changed_;
  std::unique_ptr<OutputLine> line_;
  std::optional<HostTime> pulse_end_;  // the line is active
  std::optional<HostTime> next_begin_;
  LinkReport report_;

  std::unique_ptr<Stage> stage_;  // last: uses everything
};

}  // namespace omnihdr::gpio
