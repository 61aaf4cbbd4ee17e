#include "drivers/iidc/picture.h"

#include <algorithm>
#include <cstring>
#include <utility>

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

namespace {

Result<Pixels> ReadDeep(const std::vector<std::byte>& frame, const PictureLayout& layout) {
  auto image = Image<std::uint16_t>::Uninitialized(layout.width, layout.height);
  const std::size_t count = image.size();
  std::uint32_t all = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t value = std::to_integer<std::uint32_t>(frame[2 * i]) << 8 |
                                std::to_integer<std::uint32_t>(frame[2 * i + 1]);
    all |= value;
    image.data()[i] = static_cast<std::uint16_t>(value);
  }
  const std::uint32_t meaningless = layout.depth == 0 ? 0 : (1U << (16 - layout.depth)) - 1U;
  if ((all & meaningless) != 0) {
    return Fail(ErrorKind::kData,
                "values use bits {:#06x}: expected only the upper {}, as DATA_DEPTH (0x054) says: "
                "another order of bytes, or another alignment",
                all & meaningless, layout.depth);
  }
  return Pixels(std::move(image));
}

}  // namespace

Result<Pixels> ReadPicture(std::vector<std::byte> frame, const PictureLayout& layout) {
  const auto width = static_cast<std::size_t>(layout.width);
  const auto height = static_cast<std::size_t>(layout.height);
  if (layout.format == PictureFormat::kJpeg) {
    OMNIHDR_ASSIGN(const ladybug::JpegFrameHeader header, ladybug::ParseJpegFrame(frame));
    OMNIHDR_ASSIGN(
        Image<std::uint8_t> stack,
        ladybug::DecodeJpegFrame(frame, header, layout.width, layout.height / layout.sensors));
    return Pixels(std::move(stack));
  }
  const std::size_t line = width * (layout.deep ? 2 : 1);
  frame.resize(line * height);
  if (height > 2) {
    const std::size_t covered = std::min(EmbeddedBytes(layout.embedded), line);
    std::memcpy(frame.data(), frame.data() + 2 * line, covered);
  }
  if (layout.deep) return ReadDeep(frame, layout);
  if (layout.sensors == ladybug::kSensors) {
    OMNIHDR_ASSIGN(Image<std::uint8_t> stack,
                   ladybug::StackFromRaw(frame, layout.width, layout.height / layout.sensors));
    return Pixels(std::move(stack));
  }
  Image<std::uint8_t> image = Image<std::uint8_t>::Uninitialized(layout.width, layout.height);
  std::memcpy(image.data(), frame.data(), frame.size());
  return Pixels(std::move(image));
}

}  // namespace omnihdr::iidc
