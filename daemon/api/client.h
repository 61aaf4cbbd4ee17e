#pragma once

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr {

// The other end of the API. One call at a time.
class ApiClient {
 public:
  explicit ApiClient(std::filesystem::path socket, Nanoseconds timeout = std::chrono::seconds(10))
      : socket_(std::move(socket)), timeout_(timeout) {}

  // The JSON body of the answer. kUnavailable when nobody listens; when the daemon refuses, its own
  // words, as kTemporary (503), kConfig (422), kUsage (other 4xx) or kSoftware.
  Result<nlohmann::json> Get(const std::string& route);
  Result<nlohmann::json> Post(const std::string& route,
                              const nlohmann::json& body = nlohmann::json::object());
  Result<std::string> GetText(const std::string& route);
  // Calls `line` for every event until it answers false or the daemon ends the stream.
  Status Events(const std::function<bool(const std::string& line)>& line);

 private:
  const std::filesystem::path socket_;
  const Nanoseconds timeout_;
};

}  // namespace omnihdr
