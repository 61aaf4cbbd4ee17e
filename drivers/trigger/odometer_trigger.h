#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/ports/trigger.h"

namespace omnihdr {

struct OdometerTriggerOptions {
  double distance_m = 0.3;  // 0.001 to 10000
  // A mark that the odometer tells of later than this is lost: the picture would be of elsewhere.
  Nanoseconds max_late = std::chrono::seconds(1);
  Status Validate() const;
};

// An event at every multiple of the distance that an odometer reaches, the starting place included
// when it is one (TriggerEvent::standing). Every mark counts once, however often the vehicle goes
// to and fro over it. Marks are passed unseen while the trigger is stopped or before the odometer
// has a reading.
class OdometerTrigger final : public TriggerSource {
 public:
  // Both must outlive the trigger.
  OdometerTrigger(const OdometerTriggerOptions& options, std::shared_ptr<Odometer> odometer,
                  const Clock& clock);
  ~OdometerTrigger() override;
  std::string_view kind() const override { return "distance"; }
  Status Start() override;
  void Stop() override;
  Result<std::optional<TriggerEvent>> Poll() override;
  // The distance between marks, counted from where the vehicle is.
  Status SetDistance(double distance_m);
  int fd() const override { return fd_.get(); }
  std::optional<HostTime> NextDeadline() const override;
  LostEvents TakeLost() override;

 private:
  double NextMark() const { return static_cast<double>(next_) * options_.distance_m; }
  void Synchronise();
  // Passes marks that are too late for a picture; how many.
  std::uint64_t SkipLate(HostTime now);
  std::string LateReason();

  OdometerTriggerOptions options_;
  const std::shared_ptr<Odometer> odometer_;
  const Clock& clock_;
  Fd fd_;
  std::optional<HostTime> counting_since_;
  bool counted_before_ = false;
  std::int64_t next_ = 0;                 // number of the next mark
  std::optional<std::int64_t> standing_;  // the mark that it stood at when counting began
  std::uint64_t odometer_lost_ = 0;
};

}  // namespace omnihdr
