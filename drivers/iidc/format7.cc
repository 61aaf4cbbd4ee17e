#include "drivers/iidc/format7.h"

#include <algorithm>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

// Offsets in the mode's own registers.
constexpr std::uint32_t kMaxSize = 0x000;
constexpr std::uint32_t kUnitSize = 0x004;
constexpr std::uint32_t kPosition = 0x008;
constexpr std::uint32_t kSize = 0x00C;
constexpr std::uint32_t kCoding = 0x010;
constexpr std::uint32_t kCodingInquiry = 0x014;
constexpr std::uint32_t kTotalBytesHigh = 0x038;
constexpr std::uint32_t kTotalBytesLow = 0x03C;
constexpr std::uint32_t kPacketRange = 0x040;
constexpr std::uint32_t kPacketBytes = 0x044;
constexpr std::uint32_t kPacketsPerFrame = 0x048;
constexpr std::uint32_t kUnitPosition = 0x04C;
constexpr std::uint32_t kDataDepth = 0x054;
constexpr std::uint32_t kBayerOrder = 0x058;
constexpr std::uint32_t kValueSetting = 0x07C;

constexpr std::uint32_t kFormat7 = 7;
constexpr int kModes = 8;
constexpr int kPacketSearch = 64;  // units looked at on either side

constexpr std::uint32_t Pair(int high, int low) {
  return static_cast<std::uint32_t>(high) << 16 | static_cast<std::uint32_t>(low);
}

// Tells the camera to take the values written, waits until it has, and looks at its verdict.
Status Handshake(const Registers& mode, std::string_view what) {
  OMNIHDR_ASSIGN(const std::uint32_t before, mode.Read(kValueSetting, "VALUE_SETTING"));
  if ((before & Bit(31)) == 0) return {};  // this camera has no handshake
  OMNIHDR_TRY(mode.Write(kValueSetting, Bit(30), "VALUE_SETTING"));
  Result<std::uint32_t> after = mode.WaitFor(kValueSetting, Bit(30), 0, "VALUE_SETTING");
  if (!after) return Forward(std::move(after).error(), what);
  if ((*after & Bit(23)) != 0) {
    return Fail(ErrorKind::kConfig,
                "{}: VALUE_SETTING (0x07c): {:#010x}: the camera refuses size, "
                "position or coding",
                what, *after);
  }
  if ((*after & Bit(22)) != 0) {
    return Fail(ErrorKind::kConfig,
                "{}: VALUE_SETTING (0x07c): {:#010x}: the camera refuses the "
                "packet size",
                what, *after);
  }
  return {};
}

Status CheckExtent(const char* name, int position, int extent, std::uint32_t most,
                   std::uint32_t position_unit, std::uint32_t size_unit) {
  if (extent <= 0 || position < 0 ||
      static_cast<std::int64_t>(position) + extent > static_cast<std::int64_t>(most)) {
    return Fail(ErrorKind::kConfig, "{}: {} from {}: the mode has {}", name, extent, position,
                most);
  }
  if (size_unit > 0 && static_cast<std::uint32_t>(extent) % size_unit != 0) {
    return Fail(ErrorKind::kConfig, "{}: {}: expected a multiple of {}", name, extent, size_unit);
  }
  if (position_unit > 0 && static_cast<std::uint32_t>(position) % position_unit != 0) {
    return Fail(ErrorKind::kConfig, "{}: position {}: expected a multiple of {}", name, position,
                position_unit);
  }
  return {};
}

Status SelectMode(const Registers& registers, int mode) {
  OMNIHDR_ASSIGN(const std::uint32_t formats, registers.Read(kFormatInquiry, "V_FORMAT_INQ"));
  OMNIHDR_ASSIGN(const std::uint32_t modes, registers.Read(kFormat7ModeInquiry, "V_MODE_INQ_7"));
  if ((formats & Bit(31 - kFormat7)) == 0) {
    return Fail(ErrorKind::kConfig, "V_FORMAT_INQ (0x100): {:#010x}: no scalable format (7)",
                formats);
  }
  if (mode < 0 || mode >= kModes || (modes & Bit(31 - mode)) == 0) {
    return Fail(ErrorKind::kConfig,
                "Format7 mode {}: V_MODE_INQ_7 (0x19c): {:#010x}: the camera "
                "does not have it",
                mode, modes);
  }
  OMNIHDR_TRY(
      registers.WriteChecked(kVideoFormat, kFormat7 << 29, Field(~0U, 31, 29) << 29, "V_FORMAT"));
  OMNIHDR_TRY(registers.WriteChecked(kVideoMode, static_cast<std::uint32_t>(mode) << 29,
                                     Field(~0U, 31, 29) << 29, "V_MODE"));
  return {};
}

}  // namespace

std::string_view ToString(Coding coding) {
  switch (coding) {
    case Coding::kMono8:
      return "mono8";
    case Coding::kMono16:
      return "mono16";
    case Coding::kRaw8:
      return "raw8";
    case Coding::kRaw16:
      return "raw16";
  }
  return "?";
}

std::uint32_t ChoosePacketBytes(std::size_t image_bytes, std::uint32_t unit, std::uint32_t maximum,
                                std::uint32_t wanted, std::size_t link_packet) {
  const std::uint32_t most = maximum / unit * unit;
  const std::uint32_t start = std::clamp(wanted / unit * unit, unit, most);
  if (link_packet == 0) return start;
  const auto ends_marked = [&](std::uint32_t packet) {
    return (image_bytes + packet - 1) / packet * packet % link_packet != 0;
  };
  for (int step = 0; step <= kPacketSearch; ++step) {
    const auto away = static_cast<std::uint32_t>(step) * unit;
    if (start >= unit + away && ends_marked(start - away)) return start - away;
    if (most - start >= away && ends_marked(start + away)) return start + away;
  }
  return start;
}

Result<Format7Setup> SetUpFormat7(const Registers& registers, Format7Request request) {
  OMNIHDR_TRY(SelectMode(registers, request.mode));
  OMNIHDR_ASSIGN(const std::uint32_t pointer,
                 registers.Read(kFormat7Pointers + 4 * static_cast<std::uint32_t>(request.mode),
                                "V_CSR_INQ_7"));
  const Registers mode = registers.At(pointer);

  OMNIHDR_ASSIGN(const std::uint32_t max_size, mode.Read(kMaxSize, "MAX_IMAGE_SIZE"));
  OMNIHDR_ASSIGN(const std::uint32_t unit_size, mode.Read(kUnitSize, "UNIT_SIZE"));
  OMNIHDR_ASSIGN(std::uint32_t unit_position, mode.Read(kUnitPosition, "UNIT_POSITION"));
  if (unit_position == 0) unit_position = unit_size;  // as the standard has it
  if (request.width == 0 && request.height == 0) {
    request.width = static_cast<int>(max_size >> 16);
    request.height = static_cast<int>(max_size & 0xFFFF);
  }
  OMNIHDR_TRY(CheckExtent("width", request.left, request.width, max_size >> 16, unit_position >> 16,
                          unit_size >> 16));
  OMNIHDR_TRY(CheckExtent("height", request.top, request.height, max_size & 0xFFFF,
                          unit_position & 0xFFFF, unit_size & 0xFFFF));
  OMNIHDR_ASSIGN(const std::uint32_t codings, mode.Read(kCodingInquiry, "COLOR_CODING_INQ"));
  const auto coding = static_cast<std::uint32_t>(request.coding);
  if ((codings & Bit(31 - static_cast<int>(coding))) == 0) {
    return Fail(ErrorKind::kConfig, "coding {}: COLOR_CODING_INQ (0x014): {:#010x}: not in mode {}",
                ToString(request.coding), codings, request.mode);
  }

  OMNIHDR_TRY(mode.WriteChecked(kCoding, coding << 24, 0xFFU << 24, "COLOR_CODING_ID"));
  OMNIHDR_TRY(Handshake(mode, "coding"));
  // A size that does not fit at the position before would be refused.
  OMNIHDR_TRY(mode.Write(kPosition, 0, "IMAGE_POSITION"));
  OMNIHDR_TRY(mode.WriteChecked(kSize, Pair(request.width, request.height), ~0U, "IMAGE_SIZE"));
  OMNIHDR_TRY(mode.WriteChecked(kPosition, Pair(request.left, request.top), ~0U, "IMAGE_POSITION"));
  OMNIHDR_TRY(Handshake(mode, "size and position"));

  Format7Setup setup;
  setup.width = request.width;
  setup.height = request.height;
  setup.image_bytes = static_cast<std::size_t>(request.width) *
                      static_cast<std::size_t>(request.height) * (IsDeep(request.coding) ? 2 : 1);
  OMNIHDR_ASSIGN(const std::uint32_t range, mode.Read(kPacketRange, "PACKET_PARA_INQ"));
  const std::uint32_t unit = range >> 16;
  const std::uint32_t most = range & 0xFFFF;
  if (unit == 0 || most < unit) {
    return Fail(ErrorKind::kProtocol,
                "PACKET_PARA_INQ (0x040): {:#010x}: expected a unit (high) and "
                "a maximum (low) of bytes",
                range);
  }
  OMNIHDR_ASSIGN(const std::uint32_t recommended, mode.Read(kPacketBytes, "BYTE_PER_PACKET"));
  std::uint32_t wanted = request.packet_bytes;
  if (wanted == 0) wanted = recommended & 0xFFFF;
  if (wanted == 0) wanted = most;
  if (request.packet_bytes > most) {
    return Fail(ErrorKind::kConfig, "packet of {} bytes: expected at most {}", request.packet_bytes,
                most);
  }
  const std::uint32_t packet =
      ChoosePacketBytes(setup.image_bytes, unit, most, wanted, request.link_packet_bytes);
  OMNIHDR_ASSIGN(const std::uint32_t set,
                 mode.WriteChecked(kPacketBytes, packet << 16, 0xFFFFU << 16, "BYTE_PER_PACKET"));
  OMNIHDR_TRY(Handshake(mode, "packet size"));
  setup.packet_bytes = set >> 16;

  OMNIHDR_ASSIGN(const std::uint32_t high, mode.Read(kTotalBytesHigh, "TOTAL_BYTES_HI"));
  OMNIHDR_ASSIGN(const std::uint32_t low, mode.Read(kTotalBytesLow, "TOTAL_BYTES_LO"));
  OMNIHDR_ASSIGN(const std::uint32_t packets, mode.Read(kPacketsPerFrame, "PACKET_PER_FRAME"));
  const std::uint64_t total = std::uint64_t{high} << 32 | low;
  // What is sent are whole packets; cameras differ in whether the total counts the padding.
  const std::uint64_t sent =
      packets > 0 ? std::uint64_t{packets} * setup.packet_bytes
                  : (std::max<std::uint64_t>(total, setup.image_bytes) + setup.packet_bytes - 1) /
                        setup.packet_bytes * setup.packet_bytes;
  if (sent < setup.image_bytes || sent > kMaxFrameBytes) {
    return Fail(ErrorKind::kProtocol,
                "{} packets of {} bytes for a picture of {} bytes: expected at "
                "least the picture and at most {}",
                packets, setup.packet_bytes, setup.image_bytes, kMaxFrameBytes);
  }
  setup.frame_bytes = sent;
  setup.marked_ends =
      request.link_packet_bytes == 0 || setup.frame_bytes % request.link_packet_bytes != 0;
  if (IsDeep(request.coding)) {
    OMNIHDR_ASSIGN(const std::uint32_t depth, mode.Read(kDataDepth, "DATA_DEPTH"));
    // What no value of 16 bits can have is as good as not told.
    if (depth >> 24 >= 8 && depth >> 24 <= 16) setup.depth = static_cast<int>(depth >> 24);
  }
  if (request.coding == Coding::kRaw8 || request.coding == Coding::kRaw16) {
    constexpr BayerOrder kOrders[] = {BayerOrder::kRggb, BayerOrder::kGbrg, BayerOrder::kGrbg,
                                      BayerOrder::kBggr};
    OMNIHDR_ASSIGN(const std::uint32_t order, mode.Read(kBayerOrder, "BAYER_ID"));
    if (order >> 24 < std::size(kOrders)) setup.bayer = kOrders[order >> 24];
  }

  OMNIHDR_ASSIGN(const std::uint32_t basic, registers.Read(kBasicInquiry, "BASIC_FUNC_INQ"));
  if ((basic & Bit(30)) != 0) {
    OMNIHDR_ASSIGN(const std::uint32_t error,
                   registers.Read(kVideoModeError, "VMODE_ERROR_STATUS"));
    if ((error & Bit(31)) != 0) {
      return Fail(ErrorKind::kConfig,
                  "VMODE_ERROR_STATUS (0x628): {:#010x}: mode {} with {}x{} at "
                  "{},{} cannot stream",
                  error, request.mode, request.width, request.height, request.left, request.top);
    }
  }
  return setup;
}

}  // namespace omnihdr::iidc
