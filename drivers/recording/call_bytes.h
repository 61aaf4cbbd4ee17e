#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"

namespace omnihdr::recording {

// The bytes of one call, little-endian; bytes and texts follow their length (32 bits).
class CallWriter {
 public:
  void Put(std::uint64_t value, int bytes);
  void Put(std::span<const std::byte> bytes);
  void Put(std::string_view text);
  void Put(const std::optional<Error>& error);
  std::vector<std::byte> Take() && { return std::move(out_); }

 private:
  std::vector<std::byte> out_;
};

// Reads what CallWriter wrote. After the first thing that does not fit everything is empty and ok()
// is false. Untrusted bytes.
class CallReader {
 public:
  explicit CallReader(std::span<const std::byte> bytes) : left_(bytes) {}
  bool ok() const { return ok_; }
  bool at_end() const { return left_.empty(); }
  void Refuse() { ok_ = false; }
  std::uint64_t Number(int bytes);
  std::vector<std::byte> Bytes();
  std::string Text();
  std::optional<Error> OptionalError();

 private:
  bool Has(std::size_t bytes);
  std::span<const std::byte> left_;
  bool ok_ = true;
};

}  // namespace omnihdr::recording
