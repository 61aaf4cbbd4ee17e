#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

#include "core/sphere/rig.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// How a pixel is sent.
enum class Coding : std::uint32_t { kMono8 = 0, kMono16 = 5, kRaw8 = 9, kRaw16 = 10 };
std::string_view ToString(Coding coding);
// 16-bit values, the high byte first, whatever the sensor's depth.
constexpr bool IsDeep(Coding coding) {
  return coding == Coding::kMono16 || coding == Coding::kRaw16;
}

// What to ask of a scalable mode.
struct Format7Request {
  int mode = 0;
  int left = 0;
  int top = 0;
  int width = 0;  // both 0: all that the mode has
  int height = 0;
  Coding coding = Coding::kRaw8;
  // Bytes of one of the camera's packets; 0 = what the camera recommends.
  std::uint32_t packet_bytes = 0;
  // See Link::packet_bytes: the frame's length is kept off its multiples where the camera's packet
  // sizes allow that; 0 = of no interest.
  std::size_t link_packet_bytes = 0;
};

// What the camera made of it.
struct Format7Setup {
  int width = 0;
  int height = 0;
  std::uint32_t packet_bytes = 0;
  std::size_t frame_bytes = 0;  // as sent: the picture, then padding
  std::size_t image_bytes = 0;
  BayerOrder bayer = BayerOrder::kNone;  // as register 058 says; kNone: monochrome or not told
  int depth = 0;             // bits of a value that mean something (register 054); 0: not told
  bool marked_ends = false;  // every frame ends in a short packet
};

// Largest frame that is believed, in bytes.
inline constexpr std::size_t kMaxFrameBytes = std::size_t{256} << 20;

// Selects the mode, checks that it exists, sets size, position, coding and packet size in an order
// every camera accepts, each with its handshake (with a deadline), and reads everything back. The
// camera must not be streaming. kConfig: the camera cannot do what is asked; the message says what
// it can.
Result<Format7Setup> SetUpFormat7(const Registers& registers, Format7Request request);

// The packet size to use: a multiple of `unit` from it to `maximum`, near `wanted`, with which the
// frame's length (image rounded up to whole packets) is no multiple of `link_packet`, if there is
// one within reach. Requires unit > 0 and maximum >= unit.
std::uint32_t ChoosePacketBytes(std::size_t image_bytes, std::uint32_t unit, std::uint32_t maximum,
                                std::uint32_t wanted, std::size_t link_packet);

}  // namespace omnihdr::iidc
