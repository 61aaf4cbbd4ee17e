#include "drivers/iidc/find_camera.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

// Whether `id` is this camera's GUID or serial number.
bool IsCalled(const std::string& id, std::uint64_t guid, std::uint32_t serial) {
  std::string lower = id;
  std::transform(lower.begin(), lower.end(), lower.begin(), [](char c) {
    return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  });
  return lower == FormatGuid(guid) || lower == fmt::format("{}", serial);
}

Result<FoundCamera> Identify(const LinkFinder::Candidate& candidate,
                             const RegisterTimeouts& timeouts) {
  FoundCamera found;
  OMNIHDR_ASSIGN(found.link, candidate.open());
  OMNIHDR_ASSIGN(const std::vector<std::uint32_t> quadlets,
                 ReadConfigRom(*found.link, timeouts.settle + timeouts.access));
  OMNIHDR_ASSIGN(found.rom, ParseConfigRom(quadlets).Context("configuration ROM"));
  const Registers registers(*found.link, found.rom.command_base, timeouts);
  // Not every model has the register; the low half of the GUID serves as well.
  const Result<std::uint32_t> serial = registers.Read(kSerialNumber, "SERIAL_NUMBER");
  found.serial = serial ? *serial : static_cast<std::uint32_t>(found.rom.guid);
  return found;
}

}  // namespace

Result<FoundCamera> FindCamera(LinkFinder& finder, const std::string& id,
                               const RegisterTimeouts& timeouts) {
  OMNIHDR_ASSIGN(const std::vector<LinkFinder::Candidate> candidates, finder.Find());
  if (candidates.empty()) return Fail(ErrorKind::kUnavailable, "no camera is plugged in");
  std::optional<FoundCamera> chosen;
  std::string seen;
  std::optional<Error> failure;
  int matching = 0;
  for (const LinkFinder::Candidate& candidate : candidates) {
    if (!seen.empty()) seen += ", ";
    Result<FoundCamera> found = Identify(candidate, timeouts).Context(candidate.name);
    if (!found) {
      seen += found.error().message;
      failure = std::move(found).error();
      continue;
    }
    seen += fmt::format("{} {} (serial {})", candidate.name, FormatGuid(found->rom.guid),
                        found->serial);
    if (!id.empty() && !IsCalled(id, found->rom.guid, found->serial)) continue;
    ++matching;
    if (!chosen) chosen = std::move(*found);
  }
  if (matching == 1) return std::move(*chosen);
  if (matching > 1) {
    return Fail(ErrorKind::kUnavailable, "{} cameras and none chosen (camera.iidc.id): {}",
                matching, seen);
  }
  if (failure && candidates.size() == 1) return Forward(std::move(*failure));
  return Fail(ErrorKind::kUnavailable, "no camera \"{}\" among: {}", id, seen);
}

}  // namespace omnihdr::iidc
