#include "tests/emulators/ladybug_frame.h"

#include <string_view>

#include "core/image/image_io.h"

namespace omnihdr::emulators {
namespace {

constexpr int kSensors = 6;

void Put(std::vector<std::byte>& bytes, std::size_t at, std::uint32_t word) {
  for (std::size_t i = 0; i < 4; ++i) {
    bytes[at + i] = static_cast<std::byte>(word >> (24 - 8 * i) & 0xFF);
  }
}

}  // namespace

std::vector<std::byte> BuildLadybugFrame(const Image<std::uint8_t>& stack,
                                         const LadybugWords& words, int quality) {
  const int width = stack.width();
  const int height = stack.height() / kSensors;
  std::vector<std::byte> frame(0x400);
  Put(frame, 0x000, words.cycle_time);
  Put(frame, 0x010, 0xCAFEBABE);
  Put(frame, 0x014, 2);
  Put(frame, 0x018, words.seconds);
  Put(frame, 0x01C, words.microseconds);
  Put(frame, 0x020, words.sequence);
  Put(frame, 0x048, 0x42474752);
  Put(frame, 0x054, words.head_serial);
  // In the tile, row by row: B, G2, G1, R; the table counts R first, from its far end.
  constexpr std::size_t kEntryOfPlace[4] = {0, 1, 2, 3};
  for (std::size_t sensor = 0; sensor < kSensors; ++sensor) {
    Put(frame, 0x028 + 4 * sensor, words.gain);
    Put(frame, 0x058 + 4 * sensor, words.shutter);
    for (std::size_t place = 0; place < 4; ++place) {
      Image<std::uint8_t> plane(width / 2, height / 2);
      for (int y = 0; y < plane.height(); ++y) {
        for (int x = 0; x < plane.width(); ++x) {
          plane.at(x, y) =
              stack.at(2 * x + static_cast<int>(place % 2),
                       static_cast<int>(sensor) * height + 2 * y + static_cast<int>(place / 2));
        }
      }
      const std::vector<std::byte> jpeg = EncodeJpeg(plane, quality).value();
      const std::size_t entry = 0x340 + 32 * sensor + 8 * kEntryOfPlace[place];
      Put(frame, entry, static_cast<std::uint32_t>(frame.size()));
      Put(frame, entry + 4, static_cast<std::uint32_t>(jpeg.size()));
      frame.insert(frame.end(), jpeg.begin(), jpeg.end());
    }
  }
  frame.resize((frame.size() + 511) / 512 * 512);
  Put(frame, 0x008, static_cast<std::uint32_t>(frame.size()));
  return frame;
}

std::vector<std::byte> BuildPgrStream(const std::vector<std::vector<std::byte>>& frames,
                                      std::uint32_t version, std::uint32_t head_serial,
                                      bool closed) {
  constexpr std::string_view kMagic = "PGRLADYBUGSTREAM";
  constexpr std::string_view kCalibration = "calibration of an emulated head\n";
  std::vector<std::byte> file(3072);
  for (std::size_t i = 0; i < kMagic.size(); ++i) file[i] = static_cast<std::byte>(kMagic[i]);
  const auto put = [&file](std::size_t at, std::size_t word) {
    for (std::size_t i = 0; i < 4; ++i) {
      file[16 + at + i] = static_cast<std::byte>(word >> (8 * i) & 0xFF);
    }
  };
  put(0x00, version);
  put(0x04, 15);
  put(0x08, 5100);
  put(0x0C, head_serial);
  put(0x84, kCalibration.size());
  put(0x88, closed ? frames.size() : 0);
  put(0x90, 50);
  for (const char c : kCalibration) file.push_back(static_cast<std::byte>(c));
  file.resize((file.size() + 511) / 512 * 512);
  put(0x94, file.size());
  if (closed) put(0xBEC, file.size());  // the index is filled from its far end
  for (const std::vector<std::byte>& frame : frames) {
    file.insert(file.end(), frame.begin(), frame.end());
    file.resize((file.size() + 511) / 512 * 512);
  }
  if (closed) {
    for (const char c : std::string_view("GPSSUMMARY_00001")) {
      file.push_back(static_cast<std::byte>(c));
    }
  }
  return file;
}

}  // namespace omnihdr::emulators
