#pragma once

#include <cstddef>
#include <functional>
#include <mutex>
#include <string>
#include <string_view>

namespace omnihdr {

// What the appliance is doing, one word for a person and a light for the driver.
enum class CaptureState {
  kStarting,
  kWaitingForCamera,  // triggers are accounted for, but no picture can be taken
  kIdle,              // ready, disarmed: triggers are ignored
  kArmed,             // ready, every trigger takes a picture
  kDegraded,          // armed, but something is being lost or late
  kStorageFull,       // pictures cannot be stored; triggers are journaled as long as lines can be
  kFault,             // something only a person or a restart can cure
  kStopping,
  kCapturing,  // armed, and pictures are being taken
};
inline constexpr std::size_t kCaptureStateCount = 9;
std::string_view ToString(CaptureState state);

// What is known about the parts; the state follows from it. An empty text = no such condition.
struct CaptureConditions {
  bool started = false;
  bool camera_ready = false;
  bool armed = false;
  bool capturing = false;  // a trigger came within the last moments
  std::string stopping;    // why it is stopping
  std::string fault;
  std::string storage;        // what the storage said, when out of space
  std::string waiting;        // why there is no camera
  std::string frames_lost;    // recent triggers without a usable frame
  std::string views_stalled;  // what keeps the pipeline from working
  std::string storage_low;    // that it nears its end, or cannot be read
  std::string links;          // what connection to the vehicle is not there
  std::string orientation;    // that the head's pictures contradict its rig file
  std::string idle;           // why it is disarmed; "disarmed" when empty
  bool ended = false;         // the session has ended, or is being ended: it is not armed again
};

struct StateReport {
  CaptureState state = CaptureState::kStarting;
  std::string reason;  // never empty
  std::string remedy;  // what a person can do about it, or that there is nothing to do; never empty
  bool operator==(const StateReport&) const = default;
};

// The law: the gravest condition names the state - stopping, fault, storage full, no camera,
// disarmed, degraded, capturing, armed, in this order; a state is left as soon as its condition is
// gone.
StateReport EvaluateState(const CaptureConditions& conditions);

// Keeps the conditions and tells a listener of every change of state or reason. Thread-safe; the
// listener is called without the lock, from the thread that made the change.
class CaptureStateMachine {
 public:
  using Listener = std::function<void(const StateReport&)>;
  explicit CaptureStateMachine(Listener listener = {}) : listener_(std::move(listener)) {}

  void Update(const std::function<void(CaptureConditions&)>& change);
  StateReport report() const;
  CaptureConditions conditions() const;

 private:
  mutable std::mutex mutex_;
  CaptureConditions conditions_;
  StateReport report_ = EvaluateState(CaptureConditions{});
  const Listener listener_;
};

}  // namespace omnihdr
