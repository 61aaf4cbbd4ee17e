#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/base/stage.h"
#include "core/capture/appliance.h"
#include "core/ports/trigger.h"
#include "drivers/gnss/gpsd_reports.h"

namespace omnihdr::gnss {

struct GpsdOptions {
  std::string address = "127.0.0.1";  // numeric
  int port = 2947;
  double max_age_s = 2.0;      // a fix that came longer ago is none, 0.1 to 60
  bool track_heading = false;  // whether the course over ground counts as heading
  double timeout_s = 2.0;      // of connecting, 0.1 to 60
  double silent_s = 10.0;      // without any report the connection is made anew, 0.2 to 3600
  double reconnect_s = 5.0;    // longest pause between attempts, 0.1 to 3600
  Status Validate() const;     // kConfig naming key, value and range
};

// Position, time and course from a gpsd, by a thread of its own. A fix belongs to the moment its
// report came; it says itself which UTC it is for. Nothing is extrapolated.
class GpsdClient final : public PlaceSource, public VehicleLink {
 public:
  // Options must be valid; `clock` must outlive the client.
  GpsdClient(const GpsdOptions& options, const Clock& clock);
  ~GpsdClient() override;

  std::string_view name() const override { return "gnss"; }
  Status Start() override;
  LinkReport report() const override;

  // The newest fix that had come by then, not older than max_age_s, with its age; nothing when the
  // receiver had none.
  std::optional<GnssFix> Fix(HostTime at) const override;
  // The course over ground when it is asked for (track_heading), the vehicle moves at 1 m/s or
  // more, and it is not older than max_age_s.
  std::optional<double> HeadingDeg(HostTime at) const override;

 private:
  struct Known {
    HostTime received;
    Report report;
  };
  Status Run(std::stop_token stop, Stage& self);
  Status Listen(std::stop_token stop, Stage& self);
  void Take(Report report, HostTime now);
  const Known* At(HostTime at) const;

  const GpsdOptions options_;
  const Clock& clock_;
  Fd wake_;
  Fd socket_;  // the thread's own

  mutable std::mutex mutex_;  // of what follows, up to the blank line
  std::deque<Known> known_;
  LinkReport report_;

  std::unique_ptr<Stage> stage_;  // last: uses everything
};

}  // namespace omnihdr::gnss
