#include "drivers/iidc/picture.h"

#include <algorithm>
#include <cstring>

#include "drivers/ladybug/jpeg_frame.h"
#include "drivers/ladybug/raw_stack.h"

namespace omnihdr::iidc {

std::string_view ToString(PictureFormat format) {
  return format == PictureFormat::kRaw ? "raw" : "jpeg";
}

std::optional<FrameFacts> ReadFacts(std::span<const std::byte> frame, const PictureLayout& layout) {
  FrameFacts facts;
  if (layout.format == PictureFormat::kRaw) {
    const std::optional<EmbeddedInfo> info = ParseEmbeddedInfo(frame, layout.embedded);
    if (!info || layout.embedded == 0) return std::nullopt;
    facts.info = *info;
    return facts;
  }
  const Result<ladybug::JpegFrameHeader> header = ladybug::ParseJpegFrame(frame);
  if (!header) return std::nullopt;
  facts.info.cycle_time = header->cycle_time;
  facts.info.counter = header->sequence;
  facts.info.gain = header->gains.front();
  facts.info.shutter = header->shutters.front();
  facts.info.white_balance = header->white_balance;
  facts.one_exposure = header->IsOneExposure();
  return facts;
}

Result<Image<std::uint8_t>> ReadPicture(std::vector<std::byte> frame, const PictureLayout& layout) {
  const auto width = static_cast<std::size_t>(layout.width);
  const auto height = static_cast<std::size_t>(layout.height);
  if (layout.format == PictureFormat::kJpeg) {
    OMNIHDR_ASSIGN(const ladybug::JpegFrameHeader header, ladybug::ParseJpegFrame(frame));
    return ladybug::DecodeJpegFrame(frame, header, layout.width, layout.height / layout.sensors);
  }
  frame.resize(width * height);
  if (height > 2) {
    const std::size_t covered = std::min(EmbeddedBytes(layout.embedded), width);
    std::memcpy(frame.data(), frame.data() + 2 * width, covered);
  }
  if (layout.sensors == ladybug::kSensors) {
    return ladybug::StackFromRaw(frame, layout.width, layout.height / layout.sensors);
  }
  Image<std::uint8_t> image = Image<std::uint8_t>::Uninitialized(layout.width, layout.height);
  std::memcpy(image.data(), frame.data(), frame.size());
  return image;
}

}  // namespace omnihdr::iidc
