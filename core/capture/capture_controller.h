#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/capture/bracket_plan.h"
#include "core/capture/edge_pairing.h"
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
  virtual void ReleaseLine() = 0;  // one that was reserved and is not needed
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
  // How often in a row a step is taken again whose exposure was not proved; 0 = never.
  int retake = 0;
  // Triggers by which steps taken again have put off the bracket of a session that is continued.
  std::uint64_t retakes = 0;
  // An event takes a whole position: as many triggers as it has frames, commanded one after the
  // other as soon as the camera accepts them.
  bool burst = false;
  // How long a trigger waits for a camera that is busy with the picture before, one at a time; its
  // line then has the metres of the exposure, not of the event. 0 = it is missed at once.
  Nanoseconds busy_patience{0};
  // How soon a busy camera is asked again, of a burst or of a trigger that waits.
  Nanoseconds busy_retry = std::chrono::milliseconds(2);
  // The camera hangs on the trigger's wire and exposes by itself: edges are observed, and frames
  // are paired with them.
  bool wired = false;
  // How far from its edge an exposure may begin, beside what the camera's own time may be off.
  Nanoseconds edge_tolerance = std::chrono::milliseconds(10);
  // How long a frame waits for an edge that has not been told yet.
  Nanoseconds edge_patience = std::chrono::milliseconds(300);
};

// Why a trigger got no exposure (FrameStatus::kMissedTrigger).
enum class MissReason {
  kNoCamera,     // it had not come yet, or was away
  kCameraBusy,   // with the picture before
  kCameraError,  // it refused, or failed at its registers
  kNoBuffer,     // the storage is slower than the triggers
  kStorageStop,  // a limit of the storage is reached: nothing more is put on it
  kSourceLost,   // the trigger source lost the event before it was read
  kNotExposed,   // a wired camera took no picture at this edge
};
inline constexpr std::size_t kMissReasonCount = 7;
std::string_view ToString(MissReason reason);

struct CaptureCounts {
  std::uint64_t triggers = 0;       // accepted since this process started; each gives one line
  std::uint64_t refused = 0;        // not accepted: there was no room even for a line
  std::uint64_t late_frames = 0;    // came after their trigger had ended; thrown away
  std::uint64_t camera_gaps = 0;    // frames the camera's own counter says were lost
  std::uint64_t lost_unlisted = 0;  // reported lost by the source beyond max_lost_lines
  std::array<std::uint64_t, kMissReasonCount> missed{};  // lines by MissReason
  std::uint64_t waited = 0;       // triggers whose exposure a busy camera put off
  std::uint64_t retaken = 0;      // steps taken again because their exposure was not proved
  std::uint64_t clock_jumps = 0;  // of the camera's clock against the host's
  // Of a wired camera: edges that got no frame, frames that no edge was seen for (a line each), and
  // frames it took while disarmed.
  std::uint64_t edges_without_frame = 0;
  std::uint64_t frames_without_edge = 0;
  std::uint64_t frames_disarmed = 0;
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
//
// A step whose exposure was not proved is taken again (CaptureOptions::retake): while driving, one
// frame a position, by the next trigger, and the bracket goes on behind it, put off by the triggers
// that this took; in a burst at once, at the same position and for the same trigger. The frame that
// was not proved is journaled in the first case and replaced in the second.
//
// A trigger that finds the camera busy with the picture before waits for it, one at a time
// (CaptureOptions::busy_patience): its exposure comes late, which its line's times say.
//
// A wired camera (CaptureOptions::wired) is commanded nothing: a trigger is an edge that was seen,
// and a frame belongs to the edge at which its exposure began (EdgePairing). An edge before one
// that has its frame ends without one, and the camera's counter says why: no gap = the camera took
// no picture, a gap = the frame was lost on its way. A frame that no edge was told for within
// edge_patience gets a trigger of its own, as do edges that the source knows to have lost. Nobody
// chooses when such a camera exposes, so its exposure is proved against every step of the bracket:
// one of another step than planned is a good picture of that step, and the planned one is taken
// again as above. So is a frame of a cycle of the camera's own (CameraFrame::cycled), unless it is
// of a burst; a wired camera with one goes on behind it whatever is planned, and the plan follows.
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
                    const PlaceSource* place = nullptr, const UtcReference* utc = nullptr);

  // A camera has been opened: from the next trigger on its plan, its frames' description and what
  // proves their exposure are in force.
  void SetCamera(BracketPlan plan, CameraDescription description,
                 const ExposureTolerance& tolerance);
  bool camera_known() const;  // SetCamera was called

  // Whether frames without an edge are pictures that somebody wants. Wired cameras only.
  void SetArmed(bool armed);

  // Accepts a trigger, whatever becomes of its frame: a busy or absent camera or an empty buffer
  // pool end in a missed-trigger line. kTemporary when not even a line has room.
  Result<AcceptedTrigger> OnTrigger(const TriggerEvent& event);
  // Events that no trigger will tell of: a missed line each, up to max_lost_lines.
  void OnLost(const LostEvents& lost);
  // The trigger that the frame belongs to, as far as that is known when it comes.
  std::optional<TriggerId> OnFrame(CameraFrame frame);
  // All frames on their way are lost with the camera.
  void OnCameraLost(const std::string& reason);
  // Ends triggers whose frame is overdue, and asks a busy camera again. Call at NextDeadline().
  void OnTime();
  std::optional<HostTime> NextDeadline() const;

  TriggerId next_trigger() const;
  // Commanded exposures without an answer yet.
  std::size_t open_triggers() const;
  CaptureCounts counts() const;
  // Triggers in a row that the camera left without a frame although it had nothing else on its way.
  std::uint64_t frameless() const;
  // What the next trigger takes; step is an index into the plan's exposures.
  struct Upcoming {
    int step = 0;
    Exposure exposure;
  };
  Upcoming upcoming() const;
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
  bool ReserveLines(int lines);
  int FramesOfAnEvent() const;
  // A session may have been left in the middle of a burst: its position is filled up with missed
  // lines, so that the next burst is a position of its own.
  void EndBrokenBurst(const TriggerEvent& event);
  void CommandNow(const ExposureRequest& request);
  bool WaitFor(const ExposureRequest& request, const Error& refusal);
  void BeginBurst(const ExposureRequest& request);
  void CommandWaiting();
  void GiveUpWaiting();
  bool TakeAgain(const ExposureRequest& request);
  void TakeFrame(CameraFrame frame);
  // Wired cameras (capture_wired.cc).
  void ObserveEdge(const ExposureRequest& request, HostTime earliest);
  void ObserveLostEdge(HostTime time, const std::string& reason);
  std::optional<TriggerId> OnWiredFrame(CameraFrame frame, std::uint64_t gap);
  void PairWaitingFrames();
  void TakePaired(CameraFrame frame, const EdgePairing::Match& match, std::uint64_t gap);
  void TakeWithoutEdge(CameraFrame frame);
  void GiveUpWaitingFrames(HostTime until);
  void FollowCycle(const ExposureRequest& request, int step);
  bool TakeAsAnotherStep(const ExposureRequest& request, const CameraFrame& frame);
  HostTime FrameDeadline(const ExposureRequest& request) const;
  static MissReason ReasonOf(ErrorKind refusal);
  void CountCameraMiss(ErrorKind kind);
  void SubmitEnded();
  CaptureLine MakeLine(TriggerOutcome outcome);

  CaptureSink& sink_;
  const CommandCamera command_;
  const PositionSource* const positions_;
  const PlaceSource* const place_;
  const UtcReference* const utc_;
  const Clock& clock_;

  mutable std::mutex mutex_;
  BracketPlan plan_;
  CameraDescription description_;
  CaptureOptions options_;
  bool camera_known_ = false;
  TriggerId next_;
  std::uint64_t retakes_ = 0;  // the next trigger takes step (its number − retakes_) of the order
  TriggerLedger ledger_;
  // Of every trigger in the ledger, in its order.
  struct Planned {
    std::uint64_t index = 0;  // in the order of the bracket
    std::uint64_t retakes = 0;
    int step = 0;
    bool waited = false;  // for a busy camera: exposed later than at its event
  };
  Planned* FindPlanned(TriggerId trigger);
  std::deque<Planned> planned_;
  // Of the bracket's order, the place that was last taken again, and how often.
  std::optional<std::uint64_t> retaken_index_;
  int retaken_times_ = 0;
  // Triggers of a burst, or the one that waits for a busy camera, that the camera has not accepted
  // yet; in the ledger already.
  struct Waiting {
    ExposureRequest request;
    bool holds_buffer = false;
  };
  std::deque<Waiting> waiting_;
  HostTime waiting_until_;
  HostTime ask_again_;
  MissReason waits_for_ = MissReason::kCameraBusy;
  std::map<TriggerId, int> burst_retakes_;
  // Of a wired camera.
  struct WaitingFrame {
    CameraFrame frame;
    std::uint64_t gap = 0;
    HostTime until;
  };
  EdgePairing edges_;
  std::deque<WaitingFrame> waiting_frames_;  // for their edge
  HostTime last_edge_;
  std::optional<HostTime> armed_since_;
  std::uint64_t frameless_ = 0;
  std::uint64_t camera_jumps_ = 0;  // as the camera counts them
  CaptureCounts counts_;
  std::deque<bool> recent_lost_;
  std::string last_reason_;
  std::optional<std::uint64_t> last_camera_counter_;
};

}  // namespace omnihdr
