#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/units.h"
#include "core/ports/camera.h"
#include "core/session/session.h"

namespace omnihdr {

inline constexpr std::size_t kFrameStatusCount = 6;

// How many triggers ended how.
struct OutcomeCounts {
  std::array<std::uint64_t, kFrameStatusCount> by_status{};

  void Add(FrameStatus status) { ++by_status[static_cast<std::size_t>(status)]; }
  std::uint64_t operator[](FrameStatus status) const {
    return by_status[static_cast<std::size_t>(status)];
  }
  std::uint64_t total() const;
};

// How one trigger ended.
struct TriggerOutcome {
  ExposureRequest request;
  FrameStatus status = FrameStatus::kOk;
  std::string detail;                // why the status is not ok
  bool reserved_buffer = false;      // as given to Open
  std::optional<CameraFrame> frame;  // pixels and measurements, when there are any
};

// Book of the triggers on their way. Law: every trigger opened is handed out by Pop exactly once,
// in the order of opening, with exactly one outcome - whatever order the answers come in, however
// often they come, and if they never come (deadline). Not thread-safe.
class TriggerLedger {
 public:
  // A trigger that was commanded and whose frame should be there by `deadline`.
  void Open(const ExposureRequest& request, HostTime deadline, bool reserved_buffer);
  // A trigger that ends at once without a frame.
  void OpenFailed(const ExposureRequest& request, FrameStatus status, std::string detail);

  // An open trigger is commanded, or to be commanded again: when its frame should be there.
  void Await(TriggerId trigger, HostTime deadline, bool reserved_buffer);

  enum class Match { kMatched, kUnknown };
  // The outcome of an open trigger; kUnknown when there is no such trigger or it has ended already
  // (a late frame).
  Match Resolve(TriggerId trigger, FrameStatus status, std::string detail,
                std::optional<CameraFrame> frame);
  // Ends all open triggers whose deadline has passed, as kCameraTimeout.
  void Expire(HostTime now);
  // Ends all open triggers (the camera has gone).
  void FailOpen(FrameStatus status, const std::string& detail);

  // The oldest trigger when it has ended.
  std::optional<TriggerOutcome> Pop();

  // The request of an open trigger, null when it is not open.
  const ExposureRequest* FindOpen(TriggerId trigger) const;
  std::size_t size() const { return entries_.size(); }
  std::size_t open() const;
  // When Expire has something to do at the earliest.
  std::optional<HostTime> NextDeadline() const;

 private:
  struct Entry {
    TriggerOutcome outcome;
    HostTime deadline;
    bool ended = false;
  };
  Entry* Find(TriggerId trigger);
  std::deque<Entry> entries_;
};

}  // namespace omnihdr
