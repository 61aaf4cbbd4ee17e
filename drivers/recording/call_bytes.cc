#include "drivers/recording/call_bytes.h"

#include <algorithm>

namespace omnihdr::recording {

void CallWriter::Put(std::uint64_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out_.push_back(static_cast<std::byte>(value >> (8 * i) & 0xFF));
}

void CallWriter::Put(std::span<const std::byte> bytes) {
  Put(bytes.size(), 4);
  out_.insert(out_.end(), bytes.begin(), bytes.end());
}

void CallWriter::Put(std::string_view text) { Put(std::as_bytes(std::span(text))); }

void CallWriter::Put(const std::optional<Error>& error) {
  Put(error ? 1 : 0, 1);
  if (!error) return;
  Put(static_cast<std::uint64_t>(error->kind), 1);
  Put(std::string_view(error->message));
}

bool CallReader::Has(std::size_t bytes) {
  ok_ = ok_ && left_.size() >= bytes;
  return ok_;
}

std::uint64_t CallReader::Number(int bytes) {
  std::uint64_t value = 0;
  if (!Has(static_cast<std::size_t>(bytes))) return 0;
  for (int i = bytes; i-- > 0;) {
    value = value << 8 | std::to_integer<std::uint64_t>(left_[static_cast<std::size_t>(i)]);
  }
  left_ = left_.subspan(static_cast<std::size_t>(bytes));
  return value;
}

std::vector<std::byte> CallReader::Bytes() {
  const std::size_t size = Number(4);
  if (!Has(size)) return {};
  std::vector<std::byte> bytes(left_.begin(), left_.begin() + static_cast<std::ptrdiff_t>(size));
  left_ = left_.subspan(size);
  return bytes;
}

std::string CallReader::Text() {
  const std::vector<std::byte> bytes = Bytes();
  std::string text(bytes.size(), '\0');
  std::transform(bytes.begin(), bytes.end(), text.begin(),
                 [](std::byte b) { return static_cast<char>(b); });
  return text;
}

std::optional<Error> CallReader::OptionalError() {
  if (Number(1) == 0) return std::nullopt;
  const std::uint64_t kind = Number(1);
  if (kind > static_cast<std::uint64_t>(ErrorKind::kConfig)) ok_ = false;
  std::string message = Text();
  if (!ok_) return std::nullopt;
  return Error{static_cast<ErrorKind>(kind), std::move(message)};
}

}  // namespace omnihdr::recording
