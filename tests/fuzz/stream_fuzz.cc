#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <variant>

#include "drivers/iidc/camera_clock.h"
#include "drivers/iidc/frame_assembler.h"
#include "drivers/iidc/picture.h"

// A bulk stream: the first bytes choose frame length and embedded items, then each chunk is a byte
// of flags, two of length, and its data. Laws: a frame is never longer than the frame's length; one
// that is not torn has exactly it; a picture has its layout's size; the clock knows the host time
// of the first frame that tells its own.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  if (size < 4) return 0;
  iidc::PictureLayout layout;
  layout.sensors = data[0] % 2 == 0 ? 1 : 6;
  layout.width = 2 + data[0] % 16;
  layout.height = layout.sensors * (2 + data[1] % 8);
  layout.embedded = (std::uint32_t{data[2]} << 2 | data[1]) & iidc::kEmbeddedAll;
  const std::size_t frame_bytes =
      static_cast<std::size_t>(layout.width) * static_cast<std::size_t>(layout.height) +
      data[3] % 7;
  iidc::FrameAssembler assembler(frame_bytes, data[3] % 2 == 0);
  iidc::CameraClock clock;
  bool first = true;
  HostTime now = HostTime::FromNanoseconds(1'000'000'000);
  std::size_t at = 4;
  while (at + 3 <= size) {
    iidc::StreamChunk chunk;
    chunk.ended_short = (data[at] & 1) != 0;
    chunk.gap = (data[at] & 2) != 0;
    if ((data[at] & 4) != 0) chunk.error = "failed";
    if ((data[at] & 8) != 0) assembler.Reset();
    const std::size_t length =
        std::min<std::size_t>((data[at + 1] << 8 | data[at + 2]) % 700, size - at - 3);
    at += 3;
    const auto* bytes = reinterpret_cast<const std::byte*>(data + at);
    chunk.bytes.assign(bytes, bytes + length);
    at += length;
    now = now + std::chrono::milliseconds(20);
    chunk.arrived = now;
    for (iidc::RawFrame& frame : assembler.Add(chunk)) {
      if (frame.bytes.size() > frame_bytes) std::abort();
      if (!frame.torn && frame.bytes.size() != frame_bytes) std::abort();
      if (frame.torn == frame.detail.empty()) std::abort();
      const auto facts = iidc::ReadFacts(frame.bytes, layout);
      if (facts && facts->info.cycle_time) {
        if (const auto cycle = iidc::CycleTimeNanoseconds(*facts->info.cycle_time)) {
          const CameraTime camera = clock.Unwrap(*cycle, now);
          clock.Add(camera, now - std::chrono::milliseconds(9), now);
          // The first frame is believed; one that contradicts what is known leaves the clock
          // unsure.
          if (first && !clock.ToHost(camera)) std::abort();
          if (clock.uncertainty(camera).count() < 0) std::abort();
          first = false;
        }
      }
      const auto picture = iidc::ReadPicture(std::move(frame.bytes), layout);
      if (!picture) std::abort();
      std::visit(
          [&](const auto& image) {
            if (image.width() != layout.width || image.height() != layout.height) std::abort();
          },
          *picture);
    }
  }
  return 0;
}
