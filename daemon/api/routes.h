#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "core/base/result.h"
#include "daemon/api/http.h"
#include "daemon/api/status.h"

namespace omnihdr {

// What a request gets: an HTTP status code and a JSON body ({"error": "..."} when it is not 200).
struct ApiReply {
  int http_status = 200;
  nlohmann::json body = nlohmann::json::object();

  static ApiReply Refused(int http_status, const std::string& message) {
    return {http_status, {{"error", message}}};
  }
};

// What the API can ask of the daemon. Called from the API's threads; every call answers within its
// own deadline.
class ApiBackend {
 public:
  virtual ~ApiBackend() = default;
  virtual Result<StatusReport> GetStatus() = 0;
  virtual ApiReply Arm() = 0;
  virtual ApiReply Disarm() = 0;
  virtual ApiReply Trigger() = 0;
  // Ends the session: no more triggers; the views that wait for neighbours are finished.
  virtual ApiReply Finish() = 0;
  // Ends the daemon; before that the session, unless it is to be left open for the next start.
  virtual ApiReply Stop(bool leave_session_open) = 0;
  // Reads the configuration again: 422 when it is refused, whole, with the reason.
  virtual ApiReply Reload() = 0;
};

// The bytes of an answer's body and what they are.
struct HttpAnswer {
  int status = 200;
  std::string type = "application/json";
  std::string body;
};
HttpAnswer ToAnswer(const ApiReply& reply);

inline constexpr std::string_view kEventsRoute = "/v1/events";

// Answers a complete request, but for GET /v1/events, which is a stream (server.h). Law: a target
// is compared whole with the list of routes and nothing else is done with it; what is not a POST
// changes nothing.
HttpAnswer AnswerRequest(const HttpRequest& request, ApiBackend& backend);

}  // namespace omnihdr
