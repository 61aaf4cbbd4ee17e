#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <mutex>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/base/file.h"
#include "core/base/result.h"

namespace omnihdr::recording {

struct RecordingOptions {
  std::filesystem::path file;
  // No more is recorded when the file has grown to this; what is in it stays usable.
  std::uint64_t max_bytes = std::uint64_t{1} << 30;
};

// A recording that is being made. Thread-safe.
class RecordingFile {
 public:
  // `magic`: the line, with its end, that says what the file is; lives as long as the program.
  RecordingFile(RecordingOptions options, std::string_view magic);
  // Makes the file anew, the first time; kCannotCreate.
  Status Begin();
  // A call. What cannot be written ends the recording and nothing else.
  void Write(std::span<const std::byte> call);

 private:
  const RecordingOptions options_;
  const std::string_view magic_;
  std::mutex mutex_;
  Fd fd_;
  std::uint64_t written_ = 0;
  bool ended_ = false;
};

// The calls of a recording, one after the other. Untrusted bytes.
class RecordedCalls {
 public:
  // kData "no recording of WHAT" without the magic.
  static Result<RecordedCalls> Read(std::vector<std::byte> bytes, std::string_view magic,
                                    std::string_view what);
  // Nothing at the end, and where the file is cut. Valid as long as this object.
  std::optional<std::span<const std::byte>> Next();

 private:
  RecordedCalls(std::vector<std::byte> bytes, std::size_t at) : bytes_(std::move(bytes)), at_(at) {}
  std::vector<std::byte> bytes_;
  std::size_t at_ = 0;
};

}  // namespace omnihdr::recording
