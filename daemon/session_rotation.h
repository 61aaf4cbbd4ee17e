#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/session/session.h"
#include "daemon/config.h"

namespace omnihdr {

// A long survey as a series of session directories. A session ends at a position's end when one of
// its limits is reached, and the next one goes on: frames, positions and bracket are counted
// through, so that every number names one thing of the whole series and no picture lies between two
// sessions. Each session is complete by itself; what it goes on from stands in its session.json as
// {"continues": {"session": "NAME", "first_frame": N}}.

struct SessionExtent {
  std::uint64_t bytes = 0;
  std::uint64_t positions = 0;
  HostTime since;
};

// Which limit is reached, with both values; nothing when none is.
std::optional<std::string> WhyRotate(const RotationLimits& limits, const SessionExtent& extent,
                                     HostTime now);

// Where the session after `current` goes, in the same directory: named after `now` when the daemon
// named the current one, else NAME-2, NAME-3, ... kCannotCreate when all of those are taken.
Result<std::filesystem::path> NextSessionDirectory(const std::filesystem::path& current,
                                                   UtcTime now);

struct Continuation {
  std::string session;  // name of the directory
  std::uint64_t first_frame = 0;
};
std::optional<Continuation> ContinuationOf(const SessionInfo& info);
// The additive keys of session.json with that one.
std::string WithContinuation(const std::string& extra_json, const Continuation& continuation);

// The newest session of the series that `first` began: itself when nothing goes on from it.
std::filesystem::path NewestOfSeries(const std::filesystem::path& first);
// Sessions that `session` goes on from and that have not ended, oldest first: their views are to be
// finished before its own.
std::vector<std::filesystem::path> UnfinishedBefore(const std::filesystem::path& session);

// Bytes of the pixel files of a session.
std::uint64_t PixelBytes(const std::filesystem::path& session);

}  // namespace omnihdr
