#pragma once

namespace omnihdr {

// Real-time priorities (SCHED_FIFO) of the threads between a trigger and its exposure: at them, no
// program of usual scheduling and no thread of ours that stores or fuses delays an exposure. The
// service's LimitRTPRIO allows the highest.
enum class RealtimePriority {
  kCamera = 14,     // gives the exposure command, takes the picture over
  kTriggers = 15,   // the main loop: from a trigger source to the camera
  kTransfers = 17,  // completes what the camera's thread waits for
  kEdges = 20,      // reads lines
};

// While this lives the calling thread runs at `priority`; when the kernel refuses (no privilege, no
// LimitRTPRIO), as before. A thread that the caller makes meanwhile inherits it; a Stage does not
// keep it. Not for a thread that may compute for a second without ever waiting: LimitRTTIME ends
// the service then.
class RealtimeThread {
 public:
  explicit RealtimeThread(RealtimePriority priority);
  ~RealtimeThread();
  RealtimeThread(const RealtimeThread&) = delete;
  RealtimeThread& operator=(const RealtimeThread&) = delete;
  bool granted() const { return granted_; }

 private:
  bool granted_ = false;
};

// Usual scheduling for a calling thread that has a real-time priority.
void LeaveRealtime();

}  // namespace omnihdr
