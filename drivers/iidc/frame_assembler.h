#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// Bytes of one frame as they came.
struct RawFrame {
  std::vector<std::byte> bytes;  // the frame's length, or fewer when it is torn
  bool torn = false;
  std::string detail;  // why it is torn
  HostTime arrived;    // of its last byte
};

// Cuts the stream into frames. Laws: bytes of two frames are never in one; a frame that has lost
// bytes or has too many is torn, and the next one begins after the next short packet, wherever that
// comes; no more than one frame's length is kept. Where no frame has a visible end (Format7Setup::
// marked_ends is false) frames are cut by their length; after a loss in_step() is then false, and
// only a stream begun anew helps. One thread.
class FrameAssembler {
 public:
  FrameAssembler(std::size_t frame_bytes, bool marked_ends)
      : frame_bytes_(frame_bytes), marked_ends_(marked_ends) {}

  // The frames that the chunk ends; at most one where ends are marked.
  std::vector<RawFrame> Add(const StreamChunk& chunk);
  // Forgets what has come of a frame: the stream is known to be between two frames.
  void Reset();
  bool in_step() const { return in_step_; }
  std::uint64_t torn() const { return torn_; }

 private:
  RawFrame Finish(HostTime arrived);

  const std::size_t frame_bytes_;
  const bool marked_ends_;
  std::vector<std::byte> bytes_;
  std::size_t surplus_ = 0;  // bytes thrown away
  std::string fault_;        // what follows is thrown away up to the next short packet
  bool in_step_ = true;
  bool may_be_mark_ = false;  // an empty packet would be the end of the frame just finished
  std::uint64_t torn_ = 0;
};

}  // namespace omnihdr::iidc
