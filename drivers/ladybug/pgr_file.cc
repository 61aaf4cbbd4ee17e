#include "drivers/ladybug/pgr_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string_view>
#include <utility>

#include "core/base/file.h"

namespace omnihdr::ladybug {
namespace {

constexpr std::string_view kMagic = "PGRLADYBUGSTREAM";
// Behind the magic.
constexpr std::size_t kVersion = 0x00;
constexpr std::size_t kBaseSerial = 0x08;
constexpr std::size_t kHeadSerial = 0x0C;
constexpr std::size_t kDataFormat = 0x78;
constexpr std::size_t kConfigBytes = 0x84;
constexpr std::size_t kImages = 0x88;
constexpr std::size_t kFirstImage = 0x94;

constexpr std::uint32_t kOldestVersion = 4;
constexpr std::uint32_t kNewestVersion = 7;
constexpr std::uint64_t kBlock = 512;
constexpr std::size_t kMarkAt = 0x10;
constexpr std::uint32_t kMark = 0xCAFEBABE;
constexpr std::size_t kMaxFrameBytes = std::size_t{64} << 20;
// Read at once while the next mark is looked for.
constexpr std::size_t kWindow = std::size_t{1} << 16;

std::uint32_t LittleWord(std::span<const std::byte> bytes, std::size_t at) {
  std::uint32_t word = 0;
  for (std::size_t i = 4; i-- > 0;)
    word = word << 8 | std::to_integer<std::uint32_t>(bytes[at + i]);
  return word;
}
std::uint32_t BigWord(std::span<const std::byte> bytes, std::size_t at) {
  std::uint32_t word = 0;
  for (std::size_t i = 0; i < 4; ++i)
    word = word << 8 | std::to_integer<std::uint32_t>(bytes[at + i]);
  return word;
}
std::uint64_t RoundUp(std::uint64_t bytes) { return (bytes + kBlock - 1) / kBlock * kBlock; }

class FileSource final : public PgrSource {
 public:
  FileSource(Fd fd, std::uint64_t size, std::string name)
      : fd_(std::move(fd)), size_(size), name_(std::move(name)) {}
  std::uint64_t size() const override { return size_; }
  Status Read(std::uint64_t offset, std::span<std::byte> bytes) const override {
    while (!bytes.empty()) {
      const ssize_t read =
          ::pread(fd_.get(), bytes.data(), bytes.size(), static_cast<off_t>(offset));
      if (read < 0 && errno == EINTR) continue;
      if (read < 0) return FailErrno(ErrorKind::kIo, name_, errno);
      if (read == 0) return Fail(ErrorKind::kData, "{}: became shorter while it was read", name_);
      bytes = bytes.subspan(static_cast<std::size_t>(read));
      offset += static_cast<std::uint64_t>(read);
    }
    return {};
  }

 private:
  const Fd fd_;
  const std::uint64_t size_;
  const std::string name_;
};

}  // namespace

Result<PgrHeader> ParsePgrHeader(std::span<const std::byte> bytes) {
  if (bytes.size() < kPgrHeaderBytes) {
    return Fail(ErrorKind::kData, "stream of {} bytes: expected a header of {}", bytes.size(),
                kPgrHeaderBytes);
  }
  if (std::memcmp(bytes.data(), kMagic.data(), kMagic.size()) != 0) {
    return Fail(ErrorKind::kData, "no Ladybug stream: expected it to begin \"{}\"", kMagic);
  }
  const std::span<const std::byte> words = bytes.subspan(kMagic.size());
  PgrHeader header;
  header.version = LittleWord(words, kVersion);
  if (header.version < kOldestVersion || header.version > kNewestVersion) {
    return Fail(ErrorKind::kData, "stream version {}: expected {} to {}", header.version,
                kOldestVersion, kNewestVersion);
  }
  header.base_serial = LittleWord(words, kBaseSerial);
  header.head_serial = LittleWord(words, kHeadSerial);
  header.data_format = LittleWord(words, kDataFormat);
  header.config_bytes = LittleWord(words, kConfigBytes);
  header.images = LittleWord(words, kImages);
  header.first_image = LittleWord(words, kFirstImage);
  return header;
}

Result<std::unique_ptr<PgrSource>> OpenPgrFile(const std::filesystem::path& path) {
  Fd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!fd.valid()) return FailErrno(ErrorKind::kNoInput, path.string(), errno);
  struct stat about {};
  if (::fstat(fd.get(), &about) != 0) return FailErrno(ErrorKind::kNoInput, path.string(), errno);
  if (!S_ISREG(about.st_mode)) {
    return Fail(ErrorKind::kNoInput, "{}: not a regular file", path.string());
  }
  return std::unique_ptr<PgrSource>(std::make_unique<FileSource>(
      std::move(fd), static_cast<std::uint64_t>(about.st_size), path.string()));
}

PgrReader::PgrReader(std::unique_ptr<PgrSource> source, PgrHeader header)
    : source_(std::move(source)), header_(header) {
  at_ = RoundUp(std::max<std::uint64_t>(header_.first_image, kPgrHeaderBytes));
  // A header that points nowhere does not hide the frames.
  if (at_ > source_->size()) at_ = kPgrHeaderBytes;
}

Result<PgrReader> PgrReader::Open(std::unique_ptr<PgrSource> source) {
  std::vector<std::byte> bytes(std::min<std::uint64_t>(kPgrHeaderBytes, source->size()));
  OMNIHDR_TRY(source->Read(0, bytes));
  OMNIHDR_ASSIGN(const PgrHeader header, ParsePgrHeader(bytes));
  return PgrReader(std::move(source), header);
}

Result<std::optional<PgrReader::Frame>> PgrReader::Next() {
  std::vector<std::byte> window;
  while (at_ + kJpegHeaderBytes <= source_->size()) {
    window.resize(std::min<std::uint64_t>(kWindow, source_->size() - at_));
    OMNIHDR_TRY(source_->Read(at_, window));
    // Whole headers within the window.
    std::size_t in_window = 0;
    while (in_window + kJpegHeaderBytes <= window.size() &&
           BigWord(window, in_window + kMarkAt) != kMark) {
      in_window += kBlock;
    }
    at_ += in_window;
    if (in_window + kJpegHeaderBytes > window.size()) continue;

    const std::uint32_t bytes = BigWord(window, in_window + 0x008);
    Frame frame;
    frame.offset = at_;
    const std::uint64_t left = source_->size() - at_;
    // One that claims too much is read as far as it can be: what is wrong with it is then told.
    frame.bytes.resize(std::min<std::uint64_t>(
        {std::max<std::uint64_t>(bytes, kJpegHeaderBytes), left, kMaxFrameBytes}));
    OMNIHDR_TRY(source_->Read(at_, frame.bytes));
    Result<JpegFrameHeader> header = ParseJpegFrame(frame.bytes);
    if (header) {
      frame.header = *header;
      at_ += RoundUp(frame.bytes.size());
      return std::optional<Frame>(std::move(frame));
    }
    ++damaged_;
    last_damage_ = fmt::format("byte {}: {}", at_, header.error().message);
    at_ += kBlock;
  }
  return std::optional<Frame>();
}

}  // namespace omnihdr::ladybug
