#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "core/base/file.h"
#include "core/base/result.h"
#include "daemon/api/event_hub.h"
#include "daemon/api/status.h"

namespace httplib {
class Server;
}

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

struct ApiServerOptions {
  std::filesystem::path socket;
  unsigned socket_mode = 0660;
  // Requests served at the same time; a quarter of them may be event streams.
  int threads = 8;
};

// The daemon's API: HTTP over a Unix socket. Routes (all answers are JSON unless stated otherwise):
//   GET  /v1/status    state, session, counters (status.h)
//   POST /v1/arm, /v1/disarm, /v1/trigger
//   POST /v1/finish    end the session, keep serving
//   POST /v1/stop      end the session, then the daemon; body {"leave_open": true}: leave the
//   session
//                      open, as SIGTERM does
//   POST /v1/reload    read the configuration again; the answer lists every key that changed
//   GET  /v1/events    a stream, one JSON object a line; with "Accept: text/event-stream" as
//                      server-sent events. The first event is the status.
//   GET  /metrics      Prometheus text
// Errors: 400 malformed, 404, 405, 409 not in this state, 413 too large, 422 configuration refused,
// 503 busy or not ready.
class ApiServer {
 public:
  // Listens at once. A socket file left behind by a daemon that is gone is replaced; when somebody
  // listens on it, this fails with kTemporary. Paths longer than a socket address holds fail with
  // kConfig.
  static Result<std::unique_ptr<ApiServer>> Listen(const ApiServerOptions& options,
                                                   ApiBackend& backend, EventHub& hub);
  // Closes the socket, ends the streams (the hub must be closed), waits for running requests.
  ~ApiServer();
  ApiServer(const ApiServer&) = delete;
  ApiServer& operator=(const ApiServer&) = delete;

 private:
  class Impl;
  explicit ApiServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace omnihdr
