#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/bounded_queue.h"
#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/capture/capture_controller.h"
#include "core/session/journal.h"

namespace omnihdr {

// Where the recorder puts things: SessionWriter, or a double in tests. Same laws as SessionWriter.
class FrameStore {
 public:
  virtual ~FrameStore() = default;
  virtual Status Append(const FrameRecord& record, std::span<const std::byte> file_bytes) = 0;
  // Lines in the journal: tells whether a failed Append still got its line in.
  virtual std::uint64_t lines() const = 0;
};

class SessionFrameStore final : public FrameStore {
 public:
  explicit SessionFrameStore(SessionWriter writer) : writer_(std::move(writer)) {}
  Status Append(const FrameRecord& record, std::span<const std::byte> file_bytes) override {
    return writer_.Append(record, file_bytes);
  }
  std::uint64_t lines() const override { return writer_.next_frame(); }
  void SetDurability(Durability durability) { writer_.SetDurability(durability); }
  Status Sync() { return writer_.Sync(); }
  std::size_t unsynced() const { return writer_.unsynced(); }
  const SessionWriter& writer() const { return writer_; }

 private:
  SessionWriter writer_;
};

struct RecorderOptions {
  // Frames between the trigger and the disk, at most: bounds memory.
  std::size_t buffers = 8;
  // Lines (without pixels) that may wait when the disk does not take them.
  std::size_t max_waiting_lines = 4096;
  int png_compression = 1;  // 0..9
};

struct RecorderEvents {
  // A line is durable. Its status may now be disk-full.
  std::function<void(const FrameRecord&)> journaled;
  // Storing failed (every time it is tried).
  std::function<void(const Error&)> storage_failed;
  // Pixels were stored after a failure.
  std::function<void()> storage_recovered;
};

// The stage between capture and disk. Submit never waits; Step, from the recorder's own thread,
// encodes one frame and stores it. A line that the disk does not take is kept and tried again, so
// the order never changes; what comes meanwhile fills the fixed pool of buffers, then new triggers
// are journaled as missed, then (no room for lines either) refused.
class Recorder final : public CaptureSink {
 public:
  Recorder(const RecorderOptions& options, RecorderEvents events);

  bool TryReserveLine() override;
  void ReleaseLine() override;
  bool TryReserveBuffer() override;
  void ReleaseBuffer() override;
  void Submit(CaptureLine line) override;

  enum class Turn {
    kIdle,    // nothing came within the timeout
    kStored,  // one line is in the journal
    kFailed,  // the line could not be written and is kept: rest a little, then Step again
  };
  // One thread only.
  Turn Step(FrameStore& store, Nanoseconds timeout);

  // Lines submitted that are not in the journal yet, or not told of (RecorderEvents::journaled).
  std::size_t waiting() const;
  std::size_t free_buffers() const;
  // Lines that are reserved or waiting: 0 when everything accepted is in the journal, and told of.
  std::size_t reserved_lines() const;

 private:
  struct Held {
    CaptureLine line;
    std::vector<std::byte> encoded;
  };
  void Done(const Held& held);

  const RecorderOptions options_;
  const RecorderEvents events_;
  BoundedQueue<CaptureLine> queue_;
  mutable std::mutex mutex_;
  std::size_t free_buffers_;
  std::size_t reserved_lines_ = 0;
  std::size_t waiting_ = 0;
  // Recorder thread only.
  std::optional<Held> held_;
  enum class Failing { kNot, kPixels, kLines };
  Failing failing_ = Failing::kNot;
};

// Name of the file of a frame, relative to the session: "raw/000004.png".
std::string FrameFileName(FrameId frame);

}  // namespace omnihdr
