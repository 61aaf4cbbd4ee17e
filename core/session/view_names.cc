#include "core/session/view_names.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <string_view>

#include "core/session/view_writer.h"

namespace omnihdr {
namespace {

constexpr std::string_view kTemporarySuffix = ".tmp";

}  // namespace

std::optional<PositionId> PositionFromName(const std::string& name) {
  if (name.size() < 6 || name.size() > 9 ||
      !std::all_of(name.begin(), name.end(), [](char c) { return c >= '0' && c <= '9'; })) {
    return std::nullopt;
  }
  std::int64_t number = 0;
  for (const char c : name) number = number * 10 + (c - '0');
  const PositionId position{number};
  if (ViewDirectoryName(position) != name) return std::nullopt;
  return position;
}

std::filesystem::path TemporaryViewName(const std::filesystem::path& views, PositionId position) {
  return views / fmt::format(".{}{}", ViewDirectoryName(position), kTemporarySuffix);
}

bool IsTemporaryViewName(const std::string& name) {
  return name.size() > 1 + kTemporarySuffix.size() && name.front() == '.' &&
         name.ends_with(kTemporarySuffix) &&
         std::all_of(name.begin() + 1,
                     name.end() - static_cast<std::ptrdiff_t>(kTemporarySuffix.size()),
                     [](char c) { return c >= '0' && c <= '9'; });
}

}  // namespace omnihdr
