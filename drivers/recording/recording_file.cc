#include "drivers/recording/recording_file.h"

#include <fcntl.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

namespace omnihdr::recording {
namespace {

constexpr std::size_t kLengthBytes = 4;
constexpr std::size_t kLongestCall = 0xFFFFFFFF;

}  // namespace

RecordingFile::RecordingFile(RecordingOptions options, std::string_view magic)
    : options_(std::move(options)), magic_(magic), written_(magic.size()) {}

Status RecordingFile::Begin() {
  std::lock_guard lock(mutex_);
  if (fd_.valid()) return {};
  Fd fd(::open(options_.file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0640));
  if (!fd.valid()) return FailErrno(ErrorKind::kCannotCreate, options_.file.string(), errno);
  OMNIHDR_TRY(WriteAll(fd.get(), std::as_bytes(std::span(magic_)), options_.file.string()));
  fd_ = std::move(fd);
  return {};
}

void RecordingFile::Write(std::span<const std::byte> call) {
  std::lock_guard lock(mutex_);
  if (ended_ || !fd_.valid()) return;
  if (call.size() > kLongestCall || written_ + call.size() + kLengthBytes > options_.max_bytes) {
    ended_ = true;
    return;
  }
  std::array<std::byte, kLengthBytes> length;
  for (std::size_t i = 0; i < length.size(); ++i) {
    length[i] = static_cast<std::byte>(call.size() >> (8 * i) & 0xFF);
  }
  ended_ = !WriteAll(fd_.get(), length, options_.file.string()) ||
           !WriteAll(fd_.get(), call, options_.file.string());
  written_ += call.size() + length.size();
}

Result<RecordedCalls> RecordedCalls::Read(std::vector<std::byte> bytes, std::string_view magic,
                                          std::string_view what) {
  const auto begin = std::as_bytes(std::span(magic));
  if (bytes.size() < begin.size() || !std::equal(begin.begin(), begin.end(), bytes.begin())) {
    return Fail(ErrorKind::kData, "no recording of {}", what);
  }
  return RecordedCalls(std::move(bytes), begin.size());
}

std::optional<std::span<const std::byte>> RecordedCalls::Next() {
  if (bytes_.size() - at_ < kLengthBytes) return std::nullopt;
  std::size_t length = 0;
  for (std::size_t i = kLengthBytes; i-- > 0;) {
    length = length << 8 | std::to_integer<std::size_t>(bytes_[at_ + i]);
  }
  if (length > bytes_.size() - at_ - kLengthBytes) return std::nullopt;
  const auto call = std::span<const std::byte>(bytes_).subspan(at_ + kLengthBytes, length);
  at_ += kLengthBytes + length;
  return call;
}

}  // namespace omnihdr::recording
