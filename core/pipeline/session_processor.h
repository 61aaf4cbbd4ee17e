#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/pipeline/options.h"
#include "core/pipeline/quality.h"
#include "core/session/session.h"

namespace omnihdr {

struct ViewDone {
  PositionId position{};
  bool already_complete = false;  // found on disk, not made again
  double pose_s = 0.0;
  double stereo_s = 0.0;
  double merge_s = 0.0;
  double write_s = 0.0;
  int quality_level = 0;  // 0 = full
  std::vector<std::string> warnings;
};

struct ProcessorCallbacks {
  std::function<void(const ViewDone&)> view_done;           // may be empty
  std::function<void(const std::string& message)> warning;  // may be empty
  // The level from now on, and how many positions wait; may be empty.
  std::function<void(int quality_level, int backlog)> quality_changed;
  // How much of the journal is durable, in bytes: no more of it is read. Empty = all of it, which
  // is right unless somebody is writing it. Any thread.
  std::function<std::uint64_t()> durable_bytes;
};

// How a session is gone through; none of it decides what a view of a given quality level looks
// like.
struct ProcessorOptions {
  OverloadOptions overload;  // spatiotemporal mode; a temporal merge is always in full
  // Makes the complete views anew that are of reduced quality, and no others: each gets the bytes
  // of a run that was never overloaded, in one rename. Ending midway loses nothing; the next
  // upgrade goes on.
  bool upgrade = false;
};

// Turns a session directory into views, position by position, whoever is (or is not any more)
// writing it. The daemon steps it while capturing; `omnihdr process` steps it to the end: the same
// object, so the same bytes. State that matters is on disk: a processor opened on a half-processed
// session goes on where the views end and gives the bytes an uninterrupted run would have given.
// What is used follows from the order of the journal's lines alone, never from when they are read:
// a line whose position lies before the newest one's, and one beyond the session's
// frames_per_position (1 unless session.json says otherwise), are told of and not used. In temporal
// mode, unless that number is given, a position is open until the next one begins. View i is
// complete when position i+2 has been pushed, or at Finish. Views of reduced quality (overload =
// degrade) say so in view.json; which those are follows from how fast positions came, and nothing
// else does. Not thread-safe; uses the worker pool inside.
class SessionProcessor {
 public:
  // `output` is the directory that gets views/ (the session itself by default, when empty).
  // An upgrade's own error (kConfig): the views to be made anew were made with other options,
  // another mask or another rig than now.
  static Result<std::unique_ptr<SessionProcessor>> Open(const std::filesystem::path& session,
                                                        const std::filesystem::path& output,
                                                        const PipelineOptions& options,
                                                        ProcessorCallbacks callbacks,
                                                        const ProcessorOptions& how = {});
  virtual ~SessionProcessor() = default;

  enum class Progress { kNothingNew, kWorked };
  // Reads what the journal has gained and does at most one position's work. A frame that cannot be
  // used (unreadable, wrong size) is reported through `warning` and costs that frame, not the
  // session. An error is a reason to stop: disk full, session unreadable. Calling again retries.
  virtual Result<Progress> Step() = 0;
  // The journal will not grow any more: completes the views that were waiting for neighbours.
  virtual Status Finish() = 0;

  struct Counts {
    int positions_seen = 0;  // with usable pixels
    int positions_without_pixels = 0;
    int views_complete = 0;  // on disk, those found at Open included
    int views_written = 0;   // by this object
    int views_reduced = 0;   // of those complete, with a quality level above 0
    int backlog = 0;         // positions journaled but not yet pushed
    int quality_level = 0;   // of the next view
  };
  virtual Counts counts() const = 0;
};

}  // namespace omnihdr
