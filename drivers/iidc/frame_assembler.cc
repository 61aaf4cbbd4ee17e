#include "drivers/iidc/frame_assembler.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace omnihdr::iidc {

void FrameAssembler::Reset() {
  bytes_.clear();
  surplus_ = 0;
  fault_.clear();
  in_step_ = true;
  may_be_mark_ = false;
}

RawFrame FrameAssembler::Finish(HostTime arrived) {
  RawFrame frame;
  frame.arrived = arrived;
  frame.bytes = std::exchange(bytes_, {});
  if (!fault_.empty()) {
    frame.detail = std::exchange(fault_, {});
  } else if (surplus_ > 0) {
    frame.detail = fmt::format("{} bytes more than the {} of a frame", surplus_, frame_bytes_);
  } else if (frame.bytes.size() < frame_bytes_) {
    frame.detail = fmt::format("{} of {} bytes", frame.bytes.size(), frame_bytes_);
  }
  surplus_ = 0;
  frame.torn = !frame.detail.empty();
  if (frame.torn) ++torn_;
  return frame;
}

std::vector<RawFrame> FrameAssembler::Add(const StreamChunk& chunk) {
  std::vector<RawFrame> frames;
  const bool mark_only = std::exchange(may_be_mark_, false) && chunk.bytes.empty() &&
                         chunk.ended_short && chunk.error.empty() && !chunk.gap;
  if (mark_only) return frames;
  // Where bytes after a gap belong is not known.
  if (chunk.gap) fault_ = "no buffer was free: the stream is not read fast enough";
  std::span<const std::byte> left = chunk.bytes;
  while (!left.empty()) {
    const std::size_t room = fault_.empty() ? frame_bytes_ - bytes_.size() : 0;
    const std::size_t take = std::min(left.size(), room);
    if (take == 0) {
      surplus_ += left.size();
      break;
    }
    if (bytes_.empty()) bytes_.reserve(frame_bytes_);
    bytes_.insert(bytes_.end(), left.begin(), left.begin() + static_cast<std::ptrdiff_t>(take));
    left = left.subspan(take);
    if (!marked_ends_ && bytes_.size() == frame_bytes_) {
      frames.push_back(Finish(chunk.arrived));
      may_be_mark_ = left.empty();
    }
  }
  if (!chunk.error.empty()) {
    fault_ = chunk.error;
    if (marked_ends_) return frames;  // how the transfer ended says nothing about the frame's end
  }
  if (marked_ends_) {
    if (chunk.ended_short) frames.push_back(Finish(chunk.arrived));
  } else if (!fault_.empty() || (chunk.ended_short && !bytes_.empty())) {
    frames.push_back(Finish(chunk.arrived));
    // A short packet is a place to begin again; any other loss leaves the frames shifted.
    if (!chunk.ended_short || !chunk.error.empty()) in_step_ = false;
  }
  return frames;
}

}  // namespace omnihdr::iidc
