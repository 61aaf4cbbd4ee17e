#include "core/capture/recorder.h"

#include <fmt/format.h>

#include <cassert>
#include <utility>

#include "core/image/image_io.h"

namespace omnihdr {
namespace {

// What every journal can hold: who, where, when, and why there are no pixels.
void StripToBareLine(FrameRecord& record, const std::string& why) {
  FrameRecord bare;
  bare.frame = record.frame;
  bare.position = record.position;
  bare.exposure = record.exposure;
  bare.trigger_time = record.trigger_time;
  bare.timestamp = record.timestamp;
  bare.odometer_m = record.odometer_m;
  bare.utc = record.utc;
  bare.status = FrameStatus::kCorrupt;
  bare.detail = why;
  record = std::move(bare);
}

}  // namespace

std::string FrameFileName(FrameId frame) { return fmt::format("raw/{:06}.png", Value(frame)); }

Recorder::Recorder(const RecorderOptions& options, RecorderEvents events)
    : options_(options),
      events_(std::move(events)),
      queue_(options.max_waiting_lines),
      free_buffers_(options.buffers) {}

bool Recorder::TryReserveLine() {
  std::lock_guard lock(mutex_);
  if (reserved_lines_ >= options_.max_waiting_lines) return false;
  ++reserved_lines_;
  return true;
}

void Recorder::ReleaseLine() {
  std::lock_guard lock(mutex_);
  assert(reserved_lines_ > waiting_);
  --reserved_lines_;
}

bool Recorder::TryReserveBuffer() {
  std::lock_guard lock(mutex_);
  if (free_buffers_ == 0) return false;
  --free_buffers_;
  return true;
}

void Recorder::ReleaseBuffer() {
  std::lock_guard lock(mutex_);
  ++free_buffers_;
  assert(free_buffers_ <= options_.buffers);
}

void Recorder::Submit(CaptureLine line) {
  {
    std::lock_guard lock(mutex_);
    ++waiting_;
    assert(waiting_ <= reserved_lines_);
  }
  [[maybe_unused]] const PushResult pushed = queue_.TryPush(std::move(line));
  // The queue has a place for every line that can be reserved.
  assert(pushed == PushResult::kAccepted);
}

Recorder::Turn Recorder::Step(FrameStore& store, Nanoseconds timeout) {
  if (!held_) {
    std::optional<CaptureLine> line = queue_.Pop(timeout);
    if (!line) return Turn::kIdle;
    held_.emplace();
    held_->line = std::move(*line);
    FrameRecord& record = held_->line.record;
    auto encoded = std::visit(
        [&](const auto& image) -> Result<std::vector<std::byte>> {
          if constexpr (std::is_same_v<std::remove_cvref_t<decltype(image)>, std::monostate>) {
            return std::vector<std::byte>();
          } else {
            return EncodePng(image.view(), options_.png_compression);
          }
        },
        held_->line.pixels);
    held_->line.pixels = std::monostate();
    if (!encoded) {
      record.status = FrameStatus::kCorrupt;
      record.detail = encoded.error().message;
    } else if (!encoded->empty()) {
      held_->encoded = std::move(*encoded);
      record.file = FrameFileName(record.frame);
    }
  }
  const std::uint64_t lines_before = store.lines();
  const Status appended = store.Append(held_->line.record, held_->encoded);
  const bool line_is_in = store.lines() > lines_before;
  if (!appended) {
    failing_ = line_is_in ? Failing::kPixels : Failing::kLines;
    if (events_.storage_failed) events_.storage_failed(appended.error());
    if (!line_is_in) {
      // Not the disk's fault but the record's: without its optional parts it can be written.
      if (appended.error().kind == ErrorKind::kSoftware) {
        StripToBareLine(held_->line.record, appended.error().message);
        held_->encoded.clear();
      }
      return Turn::kFailed;
    }
    FrameRecord& record = held_->line.record;
    record.status = FrameStatus::kDiskFull;
    record.file.clear();
    record.detail = appended.error().message;
  } else if (failing_ == Failing::kLines ||
             (failing_ == Failing::kPixels && !held_->encoded.empty())) {
    // A line alone may fit where pixels do not: that is no recovery from lost pixels.
    failing_ = Failing::kNot;
    if (events_.storage_recovered) events_.storage_recovered();
  }
  Done(*held_);
  held_.reset();
  return Turn::kStored;
}

void Recorder::Done(const Held& held) {
  if (held.line.holds_buffer) ReleaseBuffer();
  if (events_.journaled) events_.journaled(held.line.record);
  // Only then: whoever waits for the last line may leave when it is no longer waiting.
  std::lock_guard lock(mutex_);
  --reserved_lines_;
  --waiting_;
}

std::size_t Recorder::waiting() const {
  std::lock_guard lock(mutex_);
  return waiting_;
}

std::size_t Recorder::free_buffers() const {
  std::lock_guard lock(mutex_);
  return free_buffers_;
}

std::size_t Recorder::reserved_lines() const {
  std::lock_guard lock(mutex_);
  return reserved_lines_;
}

}  // namespace omnihdr
