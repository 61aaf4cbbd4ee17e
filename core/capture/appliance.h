#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "core/base/result.h"
#include "core/capture/capture_state.h"

namespace omnihdr {

// How the storage of the pictures does.
enum class StorageLevel { kEnough, kWarning, kStop, kUnreadable };

// The appliance as lamps, displays and field buses show it.
struct ApplianceStatus {
  CaptureState state = CaptureState::kStarting;
  std::string reason;  // why it is in that state
  std::string remedy;  // what to do about it
  bool armed = false;
  bool camera_ready = false;
  bool busy = false;  // a picture is being taken
  bool session_ended = false;
  double uptime_s = 0.0;
  std::uint64_t triggers = 0;  // of the session
  std::uint64_t frames_recorded = 0;
  std::uint64_t frames_lost = 0;
  std::uint64_t views_finished = 0;
  std::uint64_t views_waiting = 0;
  int quality_level = 0;
  std::optional<double> minutes_left;  // until the storage is full, at the present rate
  StorageLevel storage_level = StorageLevel::kEnough;
  std::optional<std::uint64_t> storage_free_bytes;
  std::optional<double> odometer_m;
  bool gnss_fix = false;
  std::string last_fault;  // the newest reason of a fault, a full storage or lost frames
};

// Where the status is shown. Show never blocks; any thread, but one at a time.
class StatusOutput {
 public:
  virtual ~StatusOutput() = default;
  virtual void Show(const ApplianceStatus& status) = 0;
};

// A line that tells others of every picture, or makes a camera take it. Any thread.
class StrobeOutput {
 public:
  virtual ~StrobeOutput() = default;
  // Begins a pulse; its end comes by itself. Never blocks longer than the line needs.
  virtual Status Pulse() = 0;
};

// What may be asked of the appliance from outside. Answers within a fraction of a second, from any
// thread; an error says why not.
enum class ApplianceCommand { kArm, kDisarm, kTrigger };
using CommandHandler = std::function<Status(ApplianceCommand)>;

// How a connection to the vehicle does.
struct LinkReport {
  bool up = false;
  std::string problem;         // what is wrong; empty when nothing is
  std::uint64_t opened = 0;    // how often the connection was made
  std::uint64_t messages = 0;  // understood
  std::uint64_t errors = 0;    // time-outs, refusals, broken messages
  std::uint64_t lost = 0;      // events or readings known to be missing
};

// A connection to the vehicle with a thread of its own, which opens it, watches it, and opens it
// again with growing pauses when it breaks. Start once; the destructor ends and joins the thread.
class VehicleLink {
 public:
  virtual ~VehicleLink() = default;
  virtual std::string_view name() const = 0;
  virtual Status Start() = 0;
  virtual LinkReport report() const = 0;  // any thread
};

}  // namespace omnihdr
