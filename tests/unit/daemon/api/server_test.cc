#include "daemon/api/server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <thread>

#include "daemon/api/client.h"

namespace omnihdr::server_test {
namespace {

using testing::HasSubstr;

class FakeBackend final : public ApiBackend {
 public:
  Result<StatusReport> GetStatus() override {
    if (busy) return Fail(ErrorKind::kTemporary, "the main loop did not answer");
    if (on_status) on_status();
    StatusReport status;
    status.version = "9";
    return status;
  }
  ApiReply Arm() override { return {200, {{"armed", true}}}; }
  ApiReply Disarm() override { return {200, {{"armed", false}}}; }
  ApiReply Trigger() override { return ApiReply::Refused(409, "disarmed: arm first"); }
  ApiReply Finish() override { return {200, {{"ending", true}}}; }
  ApiReply Stop(bool leave_session_open) override {
    return {200, {{"left_open", leave_session_open}}};
  }
  ApiReply Reload() override { return ApiReply::Refused(422, "c.toml:1: log.level: 7"); }
  std::atomic<bool> busy = false;
  std::function<void()> on_status;
};

class Server : public testing::Test {
 protected:
  Server() {
    std::string pattern = (std::filesystem::temp_directory_path() / "omnihdr-api-XXXXXX").string();
    directory_ = ::mkdtemp(pattern.data());
    options_.socket = directory_ / "api.sock";
  }
  ~Server() override {
    std::error_code ignored;
    std::filesystem::remove_all(directory_, ignored);
  }
  std::unique_ptr<ApiServer> Listen() {
    auto server = ApiServer::Listen(options_, backend_, hub_);
    EXPECT_TRUE(server) << (server ? "" : server.error().message);
    return server ? std::move(*server) : nullptr;
  }

  // Bytes sent as they are, and all that comes back.
  std::string Raw(const std::string& request, bool hang_up) {
    const Fd fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, options_.socket.c_str(), sizeof(address.sun_path) - 1);
    EXPECT_EQ(::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    EXPECT_TRUE(
        WriteAll(fd.get(), std::as_bytes(std::span(request.data(), request.size())), "socket"));
    if (hang_up) ::shutdown(fd.get(), SHUT_WR);
    std::string answer(65536, '\0');
    std::size_t size = 0;
    while (size < answer.size()) {
      const ssize_t n = ::read(fd.get(), answer.data() + size, answer.size() - size);
      if (n <= 0) break;
      size += static_cast<std::size_t>(n);
    }
    answer.resize(size);
    return answer;
  }

  std::filesystem::path directory_;
  ApiServerOptions options_;
  FakeBackend backend_;
  EventHub hub_{2, 16};
};

TEST_F(Server, AnswersOnItsSocketWithItsMode) {
  options_.socket_mode = 0600;
  const auto server = Listen();
  struct stat info {};
  ASSERT_EQ(::stat(options_.socket.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777U, 0600U);
  ApiClient client(options_.socket);
  EXPECT_EQ(client.Get("/v1/status").value()["version"], "9");
  EXPECT_EQ(client.Post("/v1/arm").value()["armed"], true);
  EXPECT_EQ(client.Post("/v1/disarm").value()["armed"], false);
  EXPECT_EQ(client.Post("/v1/finish").value()["ending"], true);
  EXPECT_THAT(client.GetText("/metrics").value(), HasSubstr("omnihdr_build_info{version=\"9\"} 1"));
}

TEST_F(Server, StopSaysWhetherTheSessionStaysOpen) {
  const auto server = Listen();
  ApiClient client(options_.socket);
  EXPECT_EQ(client.Post("/v1/stop").value()["left_open"], false);
  EXPECT_EQ(client.Post("/v1/stop", {{"leave_open", true}}).value()["left_open"], true);
  const auto wrong = client.Post("/v1/stop", {{"leave_open", "yes"}});
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().kind, ErrorKind::kUsage);
  EXPECT_THAT(wrong.error().message, HasSubstr("expected {\"leave_open\""));
}

TEST_F(Server, ARefusalComesWithItsReason) {
  const auto server = Listen();
  ApiClient client(options_.socket);
  const auto refused = client.Post("/v1/trigger");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().message, "disarmed: arm first");
  backend_.busy = true;
  EXPECT_EQ(client.Get("/v1/status").error().kind, ErrorKind::kTemporary);
  EXPECT_EQ(client.Get("/metrics").error().message, "the main loop did not answer");
}

TEST_F(Server, ARefusedConfigurationIsAnErrorOfTheConfiguration) {
  const auto server = Listen();
  const auto refused = ApiClient(options_.socket).Post("/v1/reload");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kConfig);
  EXPECT_EQ(refused.error().message, "c.toml:1: log.level: 7");
}

TEST_F(Server, WhatIsNotThereIsRefusedInJson) {
  const auto server = Listen();
  ApiClient client(options_.socket);
  EXPECT_EQ(client.Get("/v2/status").error().message, "/v2/status: no such route");
  EXPECT_EQ(client.Get("/v1/arm").error().message, "/v1/arm: expected POST");
}

TEST_F(Server, ABodyThatIsTooLargeIsRefused) {
  const auto server = Listen();
  ApiClient client(options_.socket);
  const auto refused = client.Post("/v1/stop", {{"padding", std::string(100'000, 'x')}});
  ASSERT_FALSE(refused);
  EXPECT_EQ(client.Get("/v1/status").value()["version"], "9");
}

TEST_F(Server, NonsenseOnTheSocketHurtsNobody) {
  const auto server = Listen();
  for (const std::string& nonsense :
       {std::string("\0\xff\x01garbage\r\n\r\n", 14), std::string("GET"),
        std::string("GET /v1/status HTTP/9.9\r\n\r\n"),
        std::string("GET /") + std::string(20'000, 'a'),
        std::string("POST /v1/stop HTTP/1.1\r\nContent-Length: -5\r\n\r\n"),
        std::string("POST /v1/stop HTTP/1.1\r\nContent-Length: 99999999999999999999\r\n\r\nx")}) {
    Raw(nonsense, true);
  }
  EXPECT_EQ(ApiClient(options_.socket).Get("/v1/status").value()["version"], "9");
}

TEST_F(Server, TheEventStreamBeginsWithTheStatus) {
  const auto server = Listen();
  ApiClient client(options_.socket);
  std::vector<std::string> lines;
  const Status ended = client.Events([&](const std::string& line) {
    lines.push_back(line);
    if (lines.size() == 1) hub_.Publish({{"event", "frame"}, {"frame", 1}});
    return lines.size() < 2;
  });
  EXPECT_TRUE(ended);
  ASSERT_EQ(lines.size(), 2U);
  EXPECT_EQ(nlohmann::json::parse(lines[0])["event"], "status");
  EXPECT_EQ(lines[1], R"({"event":"frame","frame":1})");
}

TEST_F(Server, ServerSentEventsAreFramedAsSuch) {
  const auto server = Listen();
  // The listener is there when its first event, the status, is made.
  backend_.on_status = [this] {
    hub_.Publish({{"event", "frame"}, {"frame", 1}});
    hub_.Close();
  };
  const std::string answer =
      Raw("GET /v1/events HTTP/1.1\r\nAccept: text/event-stream\r\n\r\n", false);
  EXPECT_THAT(answer, HasSubstr("Content-Type: text/event-stream"));
  EXPECT_THAT(answer, HasSubstr("data: {\"api\""));
  EXPECT_THAT(answer, HasSubstr("data: {\"event\":\"frame\",\"frame\":1}\n\n"));
}

TEST_F(Server, AClosedHubTakesNoMoreListeners) {
  const auto server = Listen();
  hub_.Close();
  EXPECT_THAT(Raw("GET /v1/events HTTP/1.1\r\n\r\n", false), HasSubstr("too many listeners"));
}

TEST_F(Server, ListenersAreLimitedAndOthersStillServed) {
  const auto server = Listen();
  const auto first = hub_.Subscribe();
  const auto second = hub_.Subscribe();
  ApiClient client(options_.socket);
  const Status refused = client.Events([](const std::string&) { return true; });
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kTemporary);
  EXPECT_TRUE(client.Get("/v1/status"));
}

TEST_F(Server, ClosingTheHubEndsTheStreams) {
  auto server = Listen();
  std::atomic<bool> began = false;
  std::thread listener([&] {
    ApiClient client(options_.socket);
    EXPECT_TRUE(client.Events([&](const std::string&) {
      began = true;
      return true;
    }));
  });
  while (!began) std::this_thread::yield();
  hub_.Close();
  server.reset();
  listener.join();
  EXPECT_FALSE(std::filesystem::exists(options_.socket));
}

TEST_F(Server, ASocketFileLeftBehindIsReplaced) {
  {
    const Fd fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, options_.socket.c_str(), sizeof(address.sun_path) - 1);
    ASSERT_EQ(::bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  }
  ASSERT_TRUE(std::filesystem::exists(options_.socket));
  const auto server = Listen();
  EXPECT_TRUE(ApiClient(options_.socket).Get("/v1/status"));
}

TEST_F(Server, ASecondDaemonIsRefusedAndTheFirstGoesOn) {
  const auto server = Listen();
  const auto second = ApiServer::Listen(options_, backend_, hub_);
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().kind, ErrorKind::kTemporary);
  EXPECT_TRUE(ApiClient(options_.socket).Get("/v1/status"));
}

TEST_F(Server, AnotherProgramsSocketIsLeftAlone) {
  const Fd fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, options_.socket.c_str(), sizeof(address.sun_path) - 1);
  ASSERT_EQ(::bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  ASSERT_EQ(::listen(fd.get(), 1), 0);
  const auto server = ApiServer::Listen(options_, backend_, hub_);
  ASSERT_FALSE(server);
  EXPECT_THAT(server.error().message, HasSubstr("another program is listening here"));
}

TEST_F(Server, AFileThatIsNoSocketIsLeftAlone) {
  std::ofstream(options_.socket) << "precious";
  const auto server = ApiServer::Listen(options_, backend_, hub_);
  ASSERT_FALSE(server);
  EXPECT_EQ(server.error().kind, ErrorKind::kCannotCreate);
  EXPECT_EQ(ReadTextFile(options_.socket).value(), "precious");
}

TEST_F(Server, APathLongerThanASocketAddressIsAConfigurationError) {
  options_.socket = directory_ / std::string(120, 'a');
  const auto server = ApiServer::Listen(options_, backend_, hub_);
  ASSERT_FALSE(server);
  EXPECT_EQ(server.error().kind, ErrorKind::kConfig);
}

TEST_F(Server, NobodyThereIsSaidInPlainWords) {
  ApiClient client(options_.socket);
  const auto answer = client.Get("/v1/status");
  ASSERT_FALSE(answer);
  EXPECT_EQ(answer.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(answer.error().message, HasSubstr("is it running?"));
}

}  // namespace
}  // namespace omnihdr::server_test
