#include "daemon/session_choice.h"

#include <fmt/chrono.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <nlohmann/json.hpp>
#include <string_view>
#include <system_error>
#include <vector>

#include "core/base/file.h"
#include "daemon/session_rotation.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

std::string FormatUtc(UtcTime time, fmt::format_string<const std::tm&> format) {
  const std::tm parts = fmt::gmtime(static_cast<std::time_t>(time.ns() / 1'000'000'000));
  return fmt::format(format, parts);
}

// The nearest directory that exists above a new one must let us write.
Status CheckCreatable(const fs::path& directory) {
  fs::path existing = fs::absolute(directory);
  std::error_code error;
  while (!fs::exists(existing, error) && existing.has_parent_path() &&
         existing.parent_path() != existing) {
    existing = existing.parent_path();
  }
  if (!fs::is_directory(existing, error)) {
    return Fail(ErrorKind::kCannotCreate, "session {}: {} is not a directory", directory.string(),
                existing.string());
  }
  if (::access(existing.c_str(), W_OK | X_OK) != 0) {
    return FailErrno(
        ErrorKind::kCannotCreate,
        fmt::format("session {}: write into {}", directory.string(), existing.string()), errno);
  }
  return {};
}

}  // namespace

bool IsOwnSessionName(std::string_view name) {
  constexpr std::string_view kPattern = "ddddddddTddddddZ";
  return name.size() == kPattern.size() &&
         std::equal(name.begin(), name.end(), kPattern.begin(), [](char c, char expected) {
           return expected == 'd' ? c >= '0' && c <= '9' : c == expected;
         });
}

bool HoldsSession(const fs::path& directory) {
  std::error_code error;
  return fs::exists(directory / "session.json", error);
}

std::string CompactUtc(UtcTime time) { return FormatUtc(time, "{:%Y%m%dT%H%M%SZ}"); }
std::string IsoUtc(UtcTime time) { return FormatUtc(time, "{:%Y-%m-%dT%H:%M:%SZ}"); }

bool SessionEnded(const fs::path& session) {
  std::error_code error;
  return fs::exists(session / kEndedFile, error);
}

Status MarkSessionEnded(const fs::path& session, std::uint64_t frames, UtcTime now) {
  const nlohmann::json json = {{"format", "omnihdr-session-end"},
                               {"version", 1},
                               {"ended", IsoUtc(now)},
                               {"frames", frames}};
  return WriteFileAtomic(session / kEndedFile, json.dump() + "\n");
}

Result<SessionChoice> ChooseSession(const SessionConfig& config, const std::string& wanted,
                                    UtcTime now) {
  SessionChoice choice;
  const std::string& name = wanted.empty() ? config.name : wanted;
  if (!name.empty()) {
    choice.directory =
        name.find('/') != std::string::npos ? fs::path(name) : fs::path(config.directory) / name;
  } else if (config.on_existing == OnExistingSession::kResume) {
    std::vector<std::string> open;
    std::error_code error;
    for (fs::directory_iterator it(config.directory, error), end; !error && it != end;
         it.increment(error)) {
      const std::string candidate = it->path().filename().string();
      if (IsOwnSessionName(candidate) && HoldsSession(it->path()) && !SessionEnded(it->path())) {
        open.push_back(candidate);
      }
    }
    if (!open.empty()) {
      choice.directory = fs::path(config.directory) / *std::max_element(open.begin(), open.end());
    }
  }
  if (choice.directory.empty()) choice.directory = fs::path(config.directory) / CompactUtc(now);
  if (!choice.directory.has_filename()) choice.directory = choice.directory.parent_path();

  choice.exists = HoldsSession(choice.directory);
  if (!choice.exists) {
    OMNIHDR_TRY(CheckCreatable(choice.directory));
    return choice;
  }
  if (config.on_existing == OnExistingSession::kRefuse) {
    return Fail(ErrorKind::kCannotCreate,
                "session {}: exists already, and session.on_existing is \"refuse\"",
                choice.directory.string());
  }
  choice.directory = NewestOfSeries(choice.directory);
  choice.ended = SessionEnded(choice.directory);
  return choice;
}

}  // namespace omnihdr
