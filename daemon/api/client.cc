#include "daemon/api/client.h"

#include <fcntl.h>
#include <grp.h>
#include <httplib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <string_view>
#include <vector>

namespace omnihdr {
namespace {

constexpr std::size_t kMaxLineBytes = std::size_t{1} << 20;

httplib::Client Connect(const ApiEndpoint& endpoint, Nanoseconds timeout) {
  const bool tcp = !endpoint.address.empty();
  httplib::Client client(tcp ? endpoint.address : endpoint.socket.string(),
                         tcp ? endpoint.port : 80);
  if (!tcp) {
    client.set_address_family(AF_UNIX);
    client.set_socket_options([](socket_t) {});
  } else {
    client.set_bearer_token_auth(endpoint.token);
  }
  client.set_connection_timeout(timeout);
  client.set_read_timeout(timeout);
  client.set_write_timeout(timeout);
  client.set_default_headers({{"Host", "localhost"}, {"Accept-Encoding", "identity"}});
  return client;
}

// The group whose members may open the socket, when this user may not; empty when it may, or nobody
// can tell.
std::string GroupThatMay(const std::filesystem::path& socket) {
  if (::faccessat(AT_FDCWD, socket.c_str(), W_OK, AT_EACCESS) == 0 || errno != EACCES) return {};
  struct stat info {};
  // Of what keeps this user out: the socket, or its folder.
  if (::stat(socket.c_str(), &info) != 0 && ::stat(socket.parent_path().c_str(), &info) != 0) {
    return {};
  }
  std::vector<char> room(std::size_t{1} << 16);
  group found{};
  group* result = nullptr;
  ::getgrgid_r(info.st_gid, &found, room.data(), room.size(), &result);
  return result == nullptr ? std::to_string(info.st_gid) : found.gr_name;
}

tl::unexpected<Error> NoAnswer(const ApiEndpoint& endpoint, httplib::Error error) {
  if (const std::string group = endpoint.address.empty() ? GroupThatMay(endpoint.socket) : "";
      !group.empty()) {
    return Fail(ErrorKind::kPermission, "{}: this user may not connect: expected one of group {}{}",
                endpoint.name(), group,
                group == "root"
                    ? ""
                    : fmt::format(" (sudo usermod -aG {} USER, then log in again)", group));
  }
  if (error == httplib::Error::Connection || error == httplib::Error::ConnectionTimeout) {
    return Fail(ErrorKind::kUnavailable, "{}: no omnihdrd answers here: is it running?",
                endpoint.name());
  }
  return Fail(ErrorKind::kUnavailable, "{}: the daemon did not answer ({})", endpoint.name(),
              httplib::to_string(error));
}

tl::unexpected<Error> Refusal(int http_status, const std::string& body) {
  const auto json = nlohmann::json::parse(body, nullptr, false);
  std::string message = json.is_object() && json.contains("error") && json["error"].is_string()
                            ? json["error"].get<std::string>()
                            : fmt::format("the daemon answered HTTP {}", http_status);
  ErrorKind kind = ErrorKind::kSoftware;
  if (http_status == 503 || http_status == 429 || http_status == 408) kind = ErrorKind::kTemporary;
  if (http_status == 401) kind = ErrorKind::kPermission;
  if (http_status == 422) kind = ErrorKind::kConfig;
  if (http_status == 409) kind = ErrorKind::kUnavailable;
  if (http_status == 400 || http_status == 404 || http_status == 405 || http_status == 413) {
    kind = ErrorKind::kUsage;
  }
  return tl::unexpected<Error>(Error{kind, std::move(message)});
}

Result<std::string> Body(const ApiEndpoint& endpoint, const httplib::Result& result) {
  if (!result) return NoAnswer(endpoint, result.error());
  if (result->status != 200) return Refusal(result->status, result->body);
  return result->body;
}

Result<nlohmann::json> AsJson(const std::string& body) {
  auto json = nlohmann::json::parse(body, nullptr, false);
  if (!json.is_object()) {
    return Fail(ErrorKind::kProtocol, "the daemon's answer is not a JSON object");
  }
  return json;
}

}  // namespace

std::string ApiEndpoint::name() const {
  return address.empty() ? socket.string() : fmt::format("{}:{}", address, port);
}

Result<std::string> ApiClient::GetText(const std::string& route) {
  httplib::Client client = Connect(endpoint_, timeout_);
  return Body(endpoint_, client.Get(route));
}

Result<nlohmann::json> ApiClient::Get(const std::string& route) {
  OMNIHDR_ASSIGN(const std::string body, GetText(route));
  return AsJson(body);
}

Result<nlohmann::json> ApiClient::Post(const std::string& route, const nlohmann::json& body) {
  httplib::Client client = Connect(endpoint_, timeout_);
  OMNIHDR_ASSIGN(const std::string answer,
                 Body(endpoint_, client.Post(route, body.dump(), "application/json")));
  return AsJson(answer);
}

Status ApiClient::Events(const std::function<bool(const std::string&)>& line) {
  httplib::Client client = Connect(endpoint_, timeout_);
  std::string pending;
  bool enough = false;
  int status = 0;
  const httplib::Result result = client.Get(
      "/v1/events",
      [&](const httplib::Response& response) {
        status = response.status;
        return true;
      },
      [&](const char* data, std::size_t size) {
        pending.append(data, size);
        if (status != 200) return pending.size() <= kMaxLineBytes;
        for (std::size_t end = pending.find('\n'); end != std::string::npos;
             end = pending.find('\n')) {
          const std::string event = pending.substr(0, end);
          pending.erase(0, end + 1);
          if (!event.empty() && !line(event)) {
            enough = true;
            return false;
          }
        }
        return pending.size() <= kMaxLineBytes;
      });
  if (enough) return {};
  if (status != 0 && status != 200) return Refusal(status, pending);
  // The daemon's end may cut the stream anywhere: once it has begun, that is its end, not a
  // failure.
  if (!result && status == 0) return NoAnswer(endpoint_, result.error());
  return {};
}

}  // namespace omnihdr
