#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "daemon/api/event_hub.h"
#include "daemon/api/routes.h"

namespace omnihdr {

// TCP, for clients that are not on this machine or not in the socket's group.
struct ApiTcpOptions {
  std::string address;  // numeric; empty = no TCP
  int port = 0;         // 0 = any free one
  std::string token;    // what "Authorization: Bearer ..." must have; required
  // Requests a second in the long run, and at once; beyond them the answer is 429.
  double requests_per_s = 20.0;
  double burst = 40.0;
};

struct ApiServerOptions {
  std::filesystem::path socket;
  unsigned socket_mode = 0660;
  std::string socket_group;  // its group's name; empty = the process's
  ApiTcpOptions tcp;
  // From the connection to the whole request, and from the answer to its last byte; for an event
  // stream: for each of its pieces.
  Nanoseconds request_deadline = std::chrono::seconds(5);
  Nanoseconds answer_deadline = std::chrono::seconds(5);
};

// What was refused before it was a request.
struct ApiServerCounts {
  std::uint64_t requests = 0;      // answered, whatever the answer
  std::uint64_t malformed = 0;     // refused by the reader (http.h)
  std::uint64_t late = 0;          // not whole within the deadline
  std::uint64_t unauthorized = 0;  // without the token
  std::uint64_t too_many = 0;      // beyond the rate
};

// The daemon's API: HTTP over a Unix socket, whose permissions say who may do everything, and over
// TCP when configured, where a token does. Routes (all answers are JSON unless stated otherwise):
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
// Errors: 400 malformed, 401 no token, 404, 405, 408 too slow, 409 not in this state, 413 too
// large, 422 configuration refused, 429 too many requests, 503 busy or not ready.
// Bounds: one request a connection; for each of the two ways in, kThreads requests at a time and
// kWaiting connections that wait, further ones wait in the kernel's line of kBacklog. Nobody on TCP
// can keep the Unix socket from answering. No request reaches a file.
class ApiServer {
 public:
  static constexpr int kUnixThreads = 8;
  static constexpr int kTcpThreads = 4;
  static constexpr std::size_t kWaiting = 32;
  static constexpr int kBacklog = 16;

  // Listens at once. A socket file left behind by a daemon that is gone is replaced; when somebody
  // listens on it, this fails with kTemporary. Paths longer than a socket address holds, a group
  // that does not exist and TCP without a token fail with kConfig.
  static Result<std::unique_ptr<ApiServer>> Listen(const ApiServerOptions& options,
                                                   ApiBackend& backend, EventHub& hub);
  // Closes the sockets, ends the streams (the hub must be closed), waits for running requests.
  ~ApiServer();
  ApiServer(const ApiServer&) = delete;
  ApiServer& operator=(const ApiServer&) = delete;

  ApiServerCounts counts() const;  // any thread
  int tcp_port() const;            // 0 = no TCP

 private:
  class Impl;
  explicit ApiServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace omnihdr
