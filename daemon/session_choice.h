#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "daemon/config.h"

namespace omnihdr {

// Which session directory the daemon writes, and whether there is one already.
//
// A session lives across runs of the daemon: whatever ends the process - SIGTERM, SIGKILL, a power
// cut - the next start goes on with the next trigger number, the bracket in phase, and the pipeline
// where its views end. Views whose neighbours have not come yet are left waiting, so that the
// result is the same, byte for byte, as without the interruption. A session is ended on purpose
// only: by `omnihdr stop` or `finish`, or by the end of a limited series of triggers. Then the last
// views are finished without the neighbours that will never come, and the file ended.json is
// written; from then on nothing is added.
struct SessionChoice {
  std::filesystem::path directory;
  bool exists = false;
  bool ended = false;
};

// A session that another one goes on from (session_rotation.h) is followed to the newest of them.
// `wanted` is the command line's --session: a path when it holds a '/', else a name in
// session.directory; empty = session.name. Without any name: the newest session there that the
// daemon named itself and that has not ended (on_existing = "resume"), else a new one named after
// `now` as 20260102T030405Z. kCannotCreate when the session exists and on_existing = "refuse", or
// when a new one could not be written.
Result<SessionChoice> ChooseSession(const SessionConfig& config, const std::string& wanted,
                                    UtcTime now);

// The file of a session that has ended.
inline constexpr std::string_view kEndedFile = "ended.json";

bool HoldsSession(const std::filesystem::path& directory);
bool SessionEnded(const std::filesystem::path& session);
// Durable. `frames` is the number of journal lines.
Status MarkSessionEnded(const std::filesystem::path& session, std::uint64_t frames, UtcTime now);

// Whether the daemon named a session itself, by CompactUtc.
bool IsOwnSessionName(std::string_view name);
// "20260102T030405Z" and "2026-01-02T03:04:05Z".
std::string CompactUtc(UtcTime time);
std::string IsoUtc(UtcTime time);

}  // namespace omnihdr
