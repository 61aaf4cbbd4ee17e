#include "drivers/ladybug/jpeg_frame.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/image/image_io.h"

namespace omnihdr::ladybug {
namespace {

constexpr std::size_t kCycleTime = 0x000;
constexpr std::size_t kDataBytes = 0x008;
constexpr std::size_t kFingerprint = 0x010;
constexpr std::size_t kVersion = 0x014;
constexpr std::size_t kSeconds = 0x018;
constexpr std::size_t kMicroseconds = 0x01C;
constexpr std::size_t kSequence = 0x020;
constexpr std::size_t kGains = 0x028;
constexpr std::size_t kWhiteBalance = 0x040;
constexpr std::size_t kBayerMapping = 0x048;
constexpr std::size_t kHeadSerial = 0x054;
constexpr std::size_t kShutters = 0x058;

constexpr std::uint32_t kExpectedFingerprint = 0xCAFEBABE;
constexpr std::uint32_t kExpectedVersion = 2;
constexpr std::size_t kSmallestJpeg = 4;
constexpr std::string_view kChannelNames[kChannels] = {"R", "G1", "G2", "B"};
// Place of a channel in the tile, from the left and from the top: B G2 / G1 R.
constexpr std::array<std::array<int, 2>, kChannels> kChannelPlaces = {
    {{1, 1}, {0, 1}, {1, 0}, {0, 0}}};

std::uint32_t Word(std::span<const std::byte> bytes, std::size_t at) {
  std::uint32_t word = 0;
  for (std::size_t i = 0; i < 4; ++i)
    word = word << 8 | std::to_integer<std::uint32_t>(bytes[at + i]);
  return word;
}

Status CheckBlocks(std::span<const std::byte> data, const JpegFrameHeader& header) {
  struct Placed {
    JpegBlock block;
    std::string name;
  };
  std::vector<Placed> placed;
  for (int sensor = 0; sensor < kSensors; ++sensor) {
    for (int channel = 0; channel < kChannels; ++channel) {
      const JpegBlock block =
          header.blocks[static_cast<std::size_t>(sensor)][static_cast<std::size_t>(channel)];
      std::string name = fmt::format("sensor {} channel {}", sensor,
                                     kChannelNames[static_cast<std::size_t>(channel)]);
      if (block.bytes == 0) return Fail(ErrorKind::kData, "{}: not sent", name);
      const std::uint64_t end = std::uint64_t{block.offset} + block.bytes;
      if (block.offset < kJpegHeaderBytes || end > data.size()) {
        return Fail(ErrorKind::kData, "{}: bytes {} to {}: expected {} to {}", name, block.offset,
                    end, kJpegHeaderBytes, data.size());
      }
      if (block.bytes < kSmallestJpeg || data[block.offset] != std::byte{0xFF} ||
          data[block.offset + 1] != std::byte{0xD8}) {
        return Fail(ErrorKind::kData, "{}: no JPEG at byte {}", name, block.offset);
      }
      placed.push_back({block, std::move(name)});
    }
  }
  std::sort(placed.begin(), placed.end(),
            [](const Placed& a, const Placed& b) { return a.block.offset < b.block.offset; });
  for (std::size_t i = 1; i < placed.size(); ++i) {
    if (placed[i].block.offset < placed[i - 1].block.offset + placed[i - 1].block.bytes) {
      return Fail(ErrorKind::kData, "{} lies over {} at byte {}", placed[i].name,
                  placed[i - 1].name, placed[i].block.offset);
    }
  }
  return {};
}

// One channel's picture into its places of the sensor's mosaic.
Status DecodeBlock(std::span<const std::byte> frame, const JpegFrameHeader& header, int sensor,
                   int channel_number, ImageView<std::uint8_t> mosaic) {
  const auto channel = static_cast<std::size_t>(channel_number);
  const JpegBlock block = header.blocks[static_cast<std::size_t>(sensor)][channel];
  const std::string name = fmt::format("sensor {} channel {}", sensor, kChannelNames[channel]);
  if (std::uint64_t{block.offset} + block.bytes > frame.size()) {
    return Fail(ErrorKind::kData, "{}: outside the frame", name);
  }
  OMNIHDR_ASSIGN(const DecodedImage decoded,
                 DecodeImage(frame.subspan(block.offset, block.bytes), name));
  const auto* plane = std::get_if<Image<std::uint8_t>>(&decoded.pixels);
  if (plane == nullptr || plane->channels() != 1 || plane->width() != mosaic.width() / 2 ||
      plane->height() != mosaic.height() / 2) {
    return Fail(ErrorKind::kData, "{}: {}x{} in {} channels: expected {}x{} grey", name,
                decoded.width(), decoded.height(), decoded.channels(), mosaic.width() / 2,
                mosaic.height() / 2);
  }
  const auto [left, top] = kChannelPlaces[channel];
  for (int y = 0; y < plane->height(); ++y) {
    const std::uint8_t* from = plane->row(y);
    std::uint8_t* to = mosaic.row(2 * y + top) + left;
    for (int x = 0; x < plane->width(); ++x) to[2 * x] = from[x];
  }
  return {};
}

}  // namespace

bool JpegFrameHeader::IsOneExposure() const {
  const auto all_alike = [](const std::array<std::uint32_t, kSensors>& words) {
    return std::all_of(words.begin(), words.end(), [&](std::uint32_t word) {
      return (word & 0xFFF) == (words.front() & 0xFFF);
    });
  };
  return all_alike(gains) && all_alike(shutters);
}

Result<JpegFrameHeader> ParseJpegFrame(std::span<const std::byte> frame) {
  if (frame.size() < kJpegHeaderBytes) {
    return Fail(ErrorKind::kData, "compressed frame: {} bytes: expected a header of {}",
                frame.size(), kJpegHeaderBytes);
  }
  if (const std::uint32_t mark = Word(frame, kFingerprint); mark != kExpectedFingerprint) {
    return Fail(ErrorKind::kData, "compressed frame: fingerprint {:#010x}: expected {:#010x}", mark,
                kExpectedFingerprint);
  }
  JpegFrameHeader header;
  header.version = Word(frame, kVersion);
  if (header.version != kExpectedVersion) {
    return Fail(ErrorKind::kData, "compressed frame: header version {}: expected {}",
                header.version, kExpectedVersion);
  }
  header.cycle_time = Word(frame, kCycleTime);
  header.data_bytes = Word(frame, kDataBytes);
  if (header.data_bytes < kJpegHeaderBytes || header.data_bytes > frame.size()) {
    return Fail(ErrorKind::kData,
                "compressed frame: {} bytes of data, {} are there: the buffer is too small for the "
                "quality, or the frame is cut off",
                header.data_bytes, frame.size());
  }
  header.seconds = Word(frame, kSeconds);
  header.microseconds = Word(frame, kMicroseconds);
  header.sequence = Word(frame, kSequence);
  header.white_balance = Word(frame, kWhiteBalance);
  header.bayer_mapping = Word(frame, kBayerMapping);
  header.head_serial = Word(frame, kHeadSerial);
  for (std::size_t sensor = 0; sensor < kSensors; ++sensor) {
    header.gains[sensor] = Word(frame, kGains + 4 * sensor);
    header.shutters[sensor] = Word(frame, kShutters + 4 * sensor);
    for (std::size_t channel = 0; channel < kChannels; ++channel) {
      const std::size_t at = JpegTableEntry(static_cast<int>(sensor), static_cast<int>(channel));
      header.blocks[sensor][channel] = {Word(frame, at), Word(frame, at + 4)};
    }
  }
  OMNIHDR_TRY(CheckBlocks(frame.first(header.data_bytes), header).Context("compressed frame"));
  return header;
}

Result<Image<std::uint8_t>> DecodeJpegFrame(std::span<const std::byte> frame,
                                            const JpegFrameHeader& header, int width, int height) {
  if (width < 2 || height < 2 || width % 2 != 0 || height % 2 != 0 || width > 16384 ||
      height > 16384) {
    return Fail(ErrorKind::kUsage, "compressed frame: sensors of {}x{}: expected even sizes", width,
                height);
  }
  Image<std::uint8_t> stack(width, height * kSensors);
  std::array<std::optional<Error>, kSensors * kChannels> errors;
  ParallelFor(kSensors * kChannels, 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const int sensor = i / kChannels;
      if (Status decoded = DecodeBlock(frame, header, sensor, i % kChannels,
                                       stack.view().Crop(0, sensor * height, width, height));
          !decoded) {
        errors[static_cast<std::size_t>(i)] = std::move(decoded).error();
      }
    }
  });
  for (std::optional<Error>& error : errors) {
    if (error) return Forward(std::move(*error), "compressed frame");
  }
  return stack;
}

}  // namespace omnihdr::ladybug
