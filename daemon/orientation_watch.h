#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/base/stage.h"
#include "core/photometry/rig_orientation.h"
#include "daemon/api/status.h"

namespace omnihdr {

struct OrientationWatchOptions {
  int frames = 3;                              // that say something, before a verdict
  std::size_t most_waiting = 8;                // frames that are offered while another is looked at
  int most_looks = 64;                         // at a head's frames; after that it stays undecided
  Nanoseconds rest = std::chrono::seconds(1);  // between two looks
};

// Looks whether the pictures of a head of several sensors are what its rig file says
// (OrientationCheck), in a thread of its own of the lowest priority, which reads frames that are
// stored already: capture never waits for it. `told` is called from that thread with every verdict
// but "looking".
class OrientationWatch {
 public:
  using Told = std::function<void(const OrientationState&)>;
  explicit OrientationWatch(Told told, const OrientationWatchOptions& options = {});
  ~OrientationWatch();
  OrientationWatch(const OrientationWatch&) = delete;
  OrientationWatch& operator=(const OrientationWatch&) = delete;

  // A head has been opened, with the text of its rig file; empty = what is open is none. The same
  // text as before changes nothing. Any thread, at once.
  void Begin(std::string rig_toml);
  // A frame of it is stored in that file. Left out when enough wait already, or nothing more needs
  // to be known. Any thread, at once.
  void Offer(const std::filesystem::path& file);
  OrientationState state() const;  // any thread

 private:
  Status Run(const std::stop_token& stop, Stage& self);
  void Look(const std::filesystem::path& file);
  void SetState(const OrientationState& state, std::uint64_t of);

  const Told told_;
  const OrientationWatchOptions options_;

  mutable std::mutex mutex_;  // of what follows, up to the blank line
  std::condition_variable_any changed_;
  std::string rig_toml_;
  std::uint64_t heads_ = 0;  // how often another head has come
  std::deque<std::filesystem::path> offered_;
  OrientationState state_;

  // Of the thread.
  std::uint64_t head_ = 0;
  std::optional<OrientationCheck> check_;
  int looks_ = 0;
  int frames_ = 0;

  std::unique_ptr<Stage> stage_;  // last: uses everything
};

}  // namespace omnihdr
