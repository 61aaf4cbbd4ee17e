#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "drivers/ladybug/jpeg_frame.h"

namespace omnihdr::ladybug {

// A recorded stream (.pgr): a header of little-endian words, the head's calibration as text, and
// frames that each begin at a multiple of 512 bytes.
struct PgrHeader {
  std::uint32_t version = 0;
  std::uint32_t base_serial = 0;
  std::uint32_t head_serial = 0;
  std::uint32_t data_format = 0;  // the maker's code
  std::uint32_t config_bytes = 0;
  std::uint32_t images = 0;  // as the recorder wrote at its end; 0 when it did not get there
  std::uint32_t first_image = 0;
};
inline constexpr std::size_t kPgrHeaderBytes = 3072;

// Untrusted bytes from the file's first on. kData: too few, no stream, a version that is not known.
Result<PgrHeader> ParsePgrHeader(std::span<const std::byte> bytes);

// Where a stream's bytes are.
class PgrSource {
 public:
  virtual ~PgrSource() = default;
  virtual std::uint64_t size() const = 0;
  // Requires offset + bytes.size() <= size().
  virtual Status Read(std::uint64_t offset, std::span<std::byte> bytes) const = 0;
};
Result<std::unique_ptr<PgrSource>> OpenPgrFile(const std::filesystem::path& path);

// The frames of a stream, in order. Its index and its number of images are not used: they are
// written when a recording ends, and recordings do not always. What is no whole frame is passed
// over and counted, and the next frame is found by its mark.
class PgrReader {
 public:
  static Result<PgrReader> Open(std::unique_ptr<PgrSource> source);
  const PgrHeader& header() const { return header_; }

  struct Frame {
    std::uint64_t offset = 0;
    std::vector<std::byte> bytes;
    JpegFrameHeader header;
  };
  // Nothing after the last one.
  Result<std::optional<Frame>> Next();

  std::uint64_t damaged() const { return damaged_; }  // begun, but not whole
  const std::string& last_damage() const { return last_damage_; }

 private:
  PgrReader(std::unique_ptr<PgrSource> source, PgrHeader header);
  std::unique_ptr<PgrSource> source_;
  PgrHeader header_;
  std::uint64_t at_ = 0;
  std::uint64_t damaged_ = 0;
  std::string last_damage_;
};

}  // namespace omnihdr::ladybug
