#include "daemon/api/routes.h"

#include <fmt/format.h>

#include <array>
#include <exception>
#include <utility>

namespace omnihdr {
namespace {

struct Command {
  std::string_view target;
  ApiReply (ApiBackend::*method)();
};
constexpr std::array<Command, 5> kCommands = {{{"/v1/arm", &ApiBackend::Arm},
                                               {"/v1/disarm", &ApiBackend::Disarm},
                                               {"/v1/trigger", &ApiBackend::Trigger},
                                               {"/v1/finish", &ApiBackend::Finish},
                                               {"/v1/reload", &ApiBackend::Reload}}};
constexpr std::string_view kStop = "/v1/stop";
constexpr std::string_view kStatus = "/v1/status";
constexpr std::string_view kMetrics = "/metrics";

HttpAnswer Refused(int status, const std::string& message) {
  return ToAnswer(ApiReply::Refused(status, message));
}

HttpAnswer Expected(const HttpRequest& request, std::string_view method) {
  return Refused(405, fmt::format("{}: expected {}", request.target, method));
}

HttpAnswer Stop(const HttpRequest& request, ApiBackend& backend) {
  bool leave_open = false;
  if (!request.body.empty()) {
    const auto body = nlohmann::json::parse(request.body, nullptr, false);
    if (!body.is_object() || (body.contains("leave_open") && !body["leave_open"].is_boolean())) {
      return Refused(400, "body: expected {\"leave_open\": true or false}");
    }
    leave_open = body.value("leave_open", false);
  }
  return ToAnswer(backend.Stop(leave_open));
}

HttpAnswer Route(const HttpRequest& request, ApiBackend& backend) {
  const bool post = request.method == "POST";
  const bool get = request.method == "GET";
  for (const Command& command : kCommands) {
    if (request.target != command.target) continue;
    return post ? ToAnswer((backend.*command.method)()) : Expected(request, "POST");
  }
  if (request.target == kStop) return post ? Stop(request, backend) : Expected(request, "POST");
  if (request.target != kStatus && request.target != kMetrics && request.target != kEventsRoute) {
    return Refused(404, fmt::format("{}: no such route", request.target));
  }
  if (!get) return Expected(request, "GET");
  const Result<StatusReport> status = backend.GetStatus();
  if (!status) return Refused(503, status.error().message);
  if (request.target == kMetrics) {
    return {200, "text/plain; version=0.0.4; charset=utf-8", StatusToMetrics(*status)};
  }
  return ToAnswer({200, StatusToJson(*status)});
}

}  // namespace

HttpAnswer ToAnswer(const ApiReply& reply) {
  return {reply.http_status, "application/json",
          reply.body.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n"};
}

HttpAnswer AnswerRequest(const HttpRequest& request, ApiBackend& backend) {
  try {
    return Route(request, backend);
  } catch (const std::exception& thrown) {
    return Refused(500, thrown.what());
  }
}

}  // namespace omnihdr
