#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/capture/bracket_plan.h"
#include "core/capture/exposure_verifier.h"
#include "core/capture/trigger_ledger.h"
#include "core/ports/camera.h"
#include "core/ports/trigger.h"
#include "core/session/session.h"

namespace omnihdr {

// What one trigger leaves behind: a journal line, and pixels when all went well.
struct CaptureLine {
  FrameRecord record;  // without file and crc32c
  std::variant<std::monostate, Image<std::uint8_t>, Image<std::uint16_t>> pixels;
  bool holds_buffer = false;
};

// Where lines go. Room is reserved before a trigger is accepted, so Submit cannot fail. Any thread;
// nothing here waits for a disk.
class CaptureSink {
 public:
  virtual ~CaptureSink() = default;
  // Room for one line. Every reserved line is submitted exactly once.
  virtual bool TryReserveLine() = 0;
  // One of the fixed pool of pixel buffers, until the line that holds it is stored.
  virtual bool TryReserveBuffer() = 0;
  virtual void ReleaseBuffer() = 0;
  virtual void Submit(CaptureLine line) = 0;
};

struct CaptureOptions {
  // How long after the exposure's end a frame may take to arrive.
  Nanoseconds frame_timeout = std::chrono::seconds(2);
  ExposureTolerance tolerance;
  // Most triggers that a source may report lost at once and still get a line each.
  std::uint64_t max_lost_lines = 256;
};

// Why a trigger got no exposure (FrameStatus::kMissedTrigger).
enum class MissReason {
  kNoCamera,     // it had not come yet, or was away
  kCameraBusy,   // with the picture before
  kCameraError,  // it refused, or failed at its registers
  kNoBuffer,     // the storage is slower than the triggers
  kStorageStop,  // a limit of the storage is reached: nothing more is put on it
  kSourceLost,   // the trigger source lost the event before it was read
};
inline constexpr std::size_t kMissReasonCount = 6;
std::string_view ToString(MissReason reason);

struct CaptureCounts {
  std::uint64_t triggers = 0;       // accepted since this process started; each gives one line
  std::uint64_t refused = 0;        // not accepted: there was no room even for a line
  std::uint64_t late_frames = 0;    // came after their trigger had ended; thrown away
  std::uint64_t camera_gaps = 0;    // frames the camera's own counter says were lost
  std::uint64_t lost_unlisted = 0;  // reported lost by the source beyond max_lost_lines
  std::array<std::uint64_t, kMissReasonCount> missed{};  // lines by MissReason
};

struct AcceptedTrigger {
  TriggerId trigger{};
  PositionId position{};
  int step = 0;
  Exposure exposure;
  HostTime time;
  std::optional<double> odometer_m;
};

// From trigger to journal line: numbers the trigger, picks the exposure, commands the camera, waits
// for the frame, proves its exposure, and submits the line. Laws: every accepted trigger submits
// exactly one line; lines are submitted in trigger order; the frame number of a line is its
// trigger's number. So the number of lines in the journal is the number of the next trigger after a
// restart. Thread-safe: OnTrigger comes from the event loop, OnFrame from the camera's thread.
class CaptureController {
 public:
  // Commands the camera; same law and errors as Camera::Trigger, and kCannotCreate when there is no
  // storage for its frame.
  using CommandCamera = std::function<Status(const ExposureRequest&)>;

  // `description` is that of the session: frames of another size or depth are corrupt. `next` is
  // the first trigger's number. `positions` and `place` may be null. Before the first camera has
  // come, the plan is what the configuration asks for, and the description may be empty.
  CaptureController(BracketPlan plan, CameraDescription description, const CaptureOptions& options,
                    TriggerId next, CaptureSink& sink, CommandCamera command,
                    const PositionSource* positions, const Clock& clock,
                    const PlaceSource* place = nullptr);

  // A camera has been opened: from the next trigger on its plan, its frames' description and what
  // proves their exposure are in force.
  void SetCamera(BracketPlan plan, CameraDescription description,
                 const ExposureTolerance& tolerance);
  bool camera_known() const;  // SetCamera was called

  // Accepts a trigger, whatever becomes of its frame: a busy or absent camera or an empty buffer
  // pool end in a missed-trigger line. kTemporary when not even a line has room.
  Result<AcceptedTrigger> OnTrigger(const TriggerEvent& event);
  // Events that no trigger will tell of: a missed line each, up to max_lost_lines.
  void OnLost(const LostEvents& lost);
  void OnFrame(CameraFrame frame);
  // All frames on their way are lost with the camera.
  void OnCameraLost(const std::string& reason);
  // Ends triggers whose frame is overdue. Call at NextDeadline().
  void OnTime();
  std::optional<HostTime> NextDeadline() const;

  TriggerId next_trigger() const;
  // Commanded exposures without an answer yet.
  std::size_t open_triggers() const;
  CaptureCounts counts() const;
  // How many of the last 16 lines submitted have no usable frame; the newest one's reason.
  struct RecentLosses {
    int lost = 0;
    int of = 0;
    std::string last_reason;
  };
  RecentLosses recent_losses() const;
  BracketPlan plan() const;
  // Exposures from the next trigger on; triggers on their way keep theirs. kConfig when the plan
  // has another number of frames per position: positions would be counted anew.
  Status SetPlan(BracketPlan plan);

 private:
  void AddLost(const LostEvents& lost, HostTime time);
  void OpenMissed(const ExposureRequest& request, MissReason reason, std::string detail);
  ExposureRequest NextRequest(const TriggerEvent& event);
  void SubmitEnded();
  CaptureLine MakeLine(TriggerOutcome outcome) const;

  CaptureSink& sink_;
  const CommandCamera command_;
  const PositionSource* const positions_;
  const PlaceSource* const place_;
  const Clock& clock_;

  mutable std::mutex mutex_;
  BracketPlan plan_;
  CameraDescription description_;
  CaptureOptions options_;
  bool camera_known_ = false;
  TriggerId next_;
  TriggerLedger ledger_;
  CaptureCounts counts_;
  std::deque<bool> recent_lost_;
  std::string last_reason_;
  std::optional<std::uint64_t> last_camera_counter_;
};

}  // namespace omnihdr
