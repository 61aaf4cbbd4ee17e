#include "daemon/session_rotation.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>
#include <string_view>
#include <system_error>

#include "core/base/file.h"
#include "core/session/limits.h"
#include "core/session/session_reader.h"
#include "daemon/session_choice.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

constexpr int kMostNames = 100'000;
constexpr int kMostSecondsAhead = 60;

std::optional<Continuation> ReadContinuation(const fs::path& session) {
  const fs::path file = session / "session.json";
  const Result<std::string> text = ReadTextFile(file, session_limits::kMaxInfoBytes);
  if (!text) return std::nullopt;
  const Result<SessionInfo> info = ParseSessionInfo(*text, file.string());
  return info ? ContinuationOf(*info) : std::nullopt;
}

// "survey-7" = survey, 7; a name without a number is the first.
std::pair<std::string, int> SplitName(const std::string& name) {
  const std::size_t dash = name.rfind('-');
  int number = 0;
  if (dash != std::string::npos && dash > 0 && dash + 1 < name.size()) {
    const char* const end = name.data() + name.size();
    const auto [stop, error] = std::from_chars(name.data() + dash + 1, end, number);
    if (error == std::errc() && stop == end && number >= 2) return {name.substr(0, dash), number};
  }
  return {name, 1};
}

}  // namespace

std::optional<std::string> WhyRotate(const RotationLimits& limits, const SessionExtent& extent,
                                     HostTime now) {
  const double gb = static_cast<double>(extent.bytes) * 1e-9;
  if (limits.gb > 0.0 && gb >= limits.gb) {
    return fmt::format("{:.3f} GB of pictures, session.rotate_gb is {:g}", gb, limits.gb);
  }
  if (limits.positions > 0 && extent.positions >= static_cast<std::uint64_t>(limits.positions)) {
    return fmt::format("{} positions, session.rotate_positions is {}", extent.positions,
                       limits.positions);
  }
  const double hours = static_cast<double>((now - extent.since).count()) * 1e-9 / 3600.0;
  if (limits.hours > 0.0 && hours >= limits.hours) {
    return fmt::format("{:.3f} hours, session.rotate_hours is {:g}", hours, limits.hours);
  }
  return std::nullopt;
}

Result<fs::path> NextSessionDirectory(const fs::path& current, UtcTime now) {
  std::error_code error;
  const std::string name = current.filename().string();
  if (IsOwnSessionName(name)) {
    for (int ahead = 0; ahead < kMostSecondsAhead; ++ahead) {
      const fs::path next =
          current.parent_path() / CompactUtc(now + Nanoseconds(std::chrono::seconds(ahead)));
      if (!fs::exists(next, error) && !error) return next;
    }
  } else {
    // A name that ends in a number by itself only counts on where it goes on from another.
    auto [base, number] = SplitName(name);
    if (number > 1 && !ReadContinuation(current)) {
      base = name;
      number = 1;
    }
    for (int i = number + 1; i < kMostNames; ++i) {
      const fs::path next = current.parent_path() / fmt::format("{}-{}", base, i);
      if (!fs::exists(next, error) && !error) return next;
    }
  }
  return Fail(ErrorKind::kCannotCreate, "session {}: no free name for the one after it",
              current.string());
}

std::optional<Continuation> ContinuationOf(const SessionInfo& info) {
  const auto json = nlohmann::json::parse(info.extra_json, nullptr, false);
  if (!json.is_object() || !json.contains("continues")) return std::nullopt;
  const nlohmann::json& continues = json["continues"];
  if (!continues.is_object() || !continues.contains("session") ||
      !continues["session"].is_string() || !continues.contains("first_frame") ||
      !continues["first_frame"].is_number_unsigned()) {
    return std::nullopt;
  }
  Continuation continuation;
  continuation.session = continues["session"].get<std::string>();
  continuation.first_frame = continues["first_frame"].get<std::uint64_t>();
  // It is to lie beside this one.
  if (continuation.session.empty() || continuation.session.find('/') != std::string::npos ||
      continuation.session.starts_with('.')) {
    return std::nullopt;
  }
  return continuation;
}

std::string WithContinuation(const std::string& extra_json, const Continuation& continuation) {
  auto json = nlohmann::json::parse(extra_json, nullptr, false);
  if (!json.is_object()) json = nlohmann::json::object();
  json["continues"] = {{"session", continuation.session},
                       {"first_frame", continuation.first_frame}};
  return json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

fs::path NewestOfSeries(const fs::path& first) {
  fs::path newest = first;
  for (int i = 2; i < kMostNames; ++i) {
    const fs::path next = first.parent_path() / fmt::format("{}-{}", first.filename().string(), i);
    if (!HoldsSession(next)) break;
    const std::optional<Continuation> continuation = ReadContinuation(next);
    if (!continuation || continuation->session != newest.filename().string()) break;
    newest = next;
  }
  return newest;
}

std::vector<fs::path> UnfinishedBefore(const fs::path& session) {
  std::vector<fs::path> unfinished;
  fs::path at = session;
  for (int i = 0; i < kMostNames; ++i) {
    const std::optional<Continuation> continuation = ReadContinuation(at);
    if (!continuation) break;
    at = session.parent_path() / continuation->session;
    // Sessions end in their order: what lies before one that has ended has ended.
    if (!HoldsSession(at) || SessionEnded(at) || at == session) break;
    unfinished.insert(unfinished.begin(), at);
  }
  return unfinished;
}

std::uint64_t PixelBytes(const fs::path& session) {
  std::uint64_t bytes = 0;
  std::error_code error;
  fs::directory_iterator it(session / "raw", error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    const std::uintmax_t size = it->file_size(ignored);
    if (!ignored) bytes += size;
  }
  return bytes;
}

}  // namespace omnihdr
