#pragma once

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr {

// Where a daemon answers: on its Unix socket, or over TCP with its token.
struct ApiEndpoint {
  std::filesystem::path socket;
  std::string address;  // numeric; empty = the socket
  int port = 0;
  std::string token;
  std::string name() const;  // for messages
};

// The other end of the API. One call at a time.
class ApiClient {
 public:
  explicit ApiClient(std::filesystem::path socket, Nanoseconds timeout = std::chrono::seconds(10))
      : endpoint_{std::move(socket), "", 0, ""}, timeout_(timeout) {}
  explicit ApiClient(ApiEndpoint endpoint, Nanoseconds timeout = std::chrono::seconds(10))
      : endpoint_(std::move(endpoint)), timeout_(timeout) {}

  // The JSON body of the answer. kUnavailable when nobody listens, kPermission when this user may
  // not open the socket; when the daemon refuses, its own words, as kTemporary (503), kConfig
  // (422), kUsage (other 4xx) or kSoftware.
  Result<nlohmann::json> Get(const std::string& route);
  Result<nlohmann::json> Post(const std::string& route,
                              const nlohmann::json& body = nlohmann::json::object());
  Result<std::string> GetText(const std::string& route);
  // Calls `line` for every event until it answers false or the daemon ends the stream.
  Status Events(const std::function<bool(const std::string& line)>& line);

 private:
  const ApiEndpoint endpoint_;
  const Nanoseconds timeout_;
};

}  // namespace omnihdr
