#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <thread>
#include <vector>

#include "core/base/file.h"
#include "core/base/tcp.h"
#include "daemon/api/client.h"
#include "daemon/api/server.h"

// Who gets in over TCP, and what those who should not can do.
namespace omnihdr::access_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::HasSubstr;

constexpr const char* kToken = "a-token-of-the-test-0123456789";

class CountingBackend final : public ApiBackend {
 public:
  Result<StatusReport> GetStatus() override {
    StatusReport status;
    status.version = "9";
    return status;
  }
  ApiReply Arm() override { return Command(); }
  ApiReply Disarm() override { return Command(); }
  ApiReply Trigger() override { return Command(); }
  ApiReply Finish() override { return Command(); }
  ApiReply Stop(bool) override { return Command(); }
  ApiReply Reload() override { return Command(); }
  std::atomic<int> commands = 0;

 private:
  ApiReply Command() {
    ++commands;
    return {200, {{"done", true}}};
  }
};

class Access : public testing::Test {
 protected:
  Access() {
    std::string pattern = (std::filesystem::temp_directory_path() / "omnihdr-api-XXXXXX").string();
    directory_ = ::mkdtemp(pattern.data());
    options_.socket = directory_ / "api.sock";
    options_.tcp.address = "127.0.0.1";
    options_.tcp.token = kToken;
    options_.tcp.requests_per_s = 1000.0;
    options_.tcp.burst = 1000.0;
    options_.request_deadline = milliseconds(500);
    options_.answer_deadline = seconds(2);
  }
  ~Access() override {
    std::error_code ignored;
    std::filesystem::remove_all(directory_, ignored);
  }
  void Listen() {
    auto server = ApiServer::Listen(options_, backend_, hub_);
    ASSERT_TRUE(server) << server.error().message;
    server_ = std::move(*server);
  }
  ApiClient Tcp(const std::string& token = kToken) const {
    return ApiClient(ApiEndpoint{"", "127.0.0.1", server_->tcp_port(), token});
  }
  Fd Connect() const { return ConnectTcp("127.0.0.1", server_->tcp_port(), seconds(5)).value(); }
  // What comes back until the other end closes, or for ten seconds.
  static std::string Answer(int fd) {
    timeval timeout{10, 0};
    EXPECT_EQ(::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout), 0);
    // The connection was made without blocking.
    EXPECT_EQ(::fcntl(fd, F_SETFL, 0), 0);
    std::string answer;
    char piece[4096];
    for (ssize_t n = 0; (n = ::recv(fd, piece, sizeof piece, 0)) > 0;) {
      answer.append(piece, static_cast<std::size_t>(n));
    }
    return answer;
  }
  static bool Send(int fd, const std::string& text) {
    return ::send(fd, text.data(), text.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(text.size());
  }
  std::string Ask(const std::string& request) const {
    const Fd fd = Connect();
    EXPECT_TRUE(Send(fd.get(), request));
    return Answer(fd.get());
  }

  std::filesystem::path directory_;
  ApiServerOptions options_;
  CountingBackend backend_;
  EventHub hub_{4, 16};
  std::unique_ptr<ApiServer> server_;
};

TEST_F(Access, OverTcpTheTokenOpensEverythingAndNothingElseDoes) {
  Listen();
  EXPECT_EQ(Tcp().Get("/v1/status").value()["version"], "9");
  EXPECT_TRUE(Tcp().Post("/v1/arm"));
  EXPECT_EQ(backend_.commands, 1);
  for (const std::string& wrong : {std::string("wrong"), std::string(kToken) + "x",
                                   std::string(kToken).substr(1), std::string()}) {
    const auto refused = Tcp(wrong).Post("/v1/stop");
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().kind, ErrorKind::kPermission);
  }
  EXPECT_THAT(Ask("GET /metrics HTTP/1.1\r\n\r\n"), HasSubstr("HTTP/1.1 401 "));
  EXPECT_THAT(Ask("GET /v1/events HTTP/1.1\r\n\r\n"), HasSubstr("WWW-Authenticate: Bearer"));
  EXPECT_THAT(Ask(std::string("GET /v1/status HTTP/1.1\r\nAuthorization: ") + kToken + "\r\n\r\n"),
              HasSubstr("HTTP/1.1 401 "));
  EXPECT_EQ(backend_.commands, 1);
  EXPECT_EQ(server_->counts().unauthorized, 7U);
}

TEST_F(Access, WithoutATokenTcpIsNotOpened) {
  options_.tcp.token.clear();
  const auto server = ApiServer::Listen(options_, backend_, hub_);
  ASSERT_FALSE(server);
  EXPECT_EQ(server.error().kind, ErrorKind::kConfig);
  EXPECT_FALSE(std::filesystem::exists(options_.socket));
}

TEST_F(Access, NoTargetReachesAFile) {
  Listen();
  const std::string authorization = std::string("Authorization: Bearer ") + kToken + "\r\n\r\n";
  for (const char* target : {"/etc/passwd", "/../../etc/passwd", "/v1/../../etc/passwd",
                             "/%2e%2e/%2e%2e/etc/passwd", "/v1/status/../../../etc/passwd",
                             "//etc/passwd", "/v1/status?file=/etc/passwd", "/v1/status/"}) {
    const std::string answer = Ask(std::string("GET ") + target + " HTTP/1.1\r\n" + authorization);
    EXPECT_THAT(answer, HasSubstr("HTTP/1.1 404 ")) << target;
    EXPECT_EQ(answer.find("root:"), std::string::npos) << target;
  }
}

TEST_F(Access, ASlowHeadAndASlowBodyAreEndedByTheDeadline) {
  Listen();
  for (const std::string& begin :
       {std::string("GET /v1/sta"), std::string("POST /v1/stop HTTP/1.1\r\nContent-Length: 99\r\n"
                                                "\r\n{")}) {
    const HostTime start = SystemClock().Now();
    const Fd fd = Connect();
    ASSERT_TRUE(Send(fd.get(), begin));
    // A byte now and then keeps no connection alive.
    std::thread dripping([&] {
      for (int i = 0; i < 40 && Send(fd.get(), "x"); ++i) {
        std::this_thread::sleep_for(milliseconds(50));
      }
    });
    char byte = 0;
    ::fcntl(fd.get(), F_SETFL, 0);
    EXPECT_GE(::recv(fd.get(), &byte, 1, 0), 0);
    EXPECT_LT(SystemClock().Now() - start, seconds(30));
    dripping.join();
  }
  EXPECT_EQ(server_->counts().late, 2U);
  EXPECT_EQ(backend_.commands, 0);
}

TEST_F(Access, ManyIdleConnectionsDoNotKeepTheUnixSocketFromAnswering) {
  options_.request_deadline = seconds(30);
  Listen();
  std::vector<Fd> idle;
  for (int i = 0; i < 100; ++i) {
    Result<Fd> fd = ConnectTcp("127.0.0.1", server_->tcp_port(), milliseconds(200));
    if (!fd) break;  // the line is full
    idle.push_back(std::move(*fd));
  }
  EXPECT_GE(idle.size(), static_cast<std::size_t>(ApiServer::kTcpThreads));
  EXPECT_TRUE(ApiClient(options_.socket).Get("/v1/status"));
  // Nor does it wait for them to close.
  const HostTime start = SystemClock().Now();
  server_.reset();
  EXPECT_LT(SystemClock().Now() - start, seconds(20));
}

TEST_F(Access, BeyondTheRateRequestsAreRefusedAndCountedButNotOnTheUnixSocket) {
  options_.tcp.requests_per_s = 0.001;
  options_.tcp.burst = 3.0;
  Listen();
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(Tcp().Post("/v1/trigger"));
  const auto refused = Tcp().Post("/v1/trigger");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kTemporary);
  // Guessing is as slow.
  EXPECT_FALSE(Tcp("a-token-that-is-only-guessed").Post("/v1/trigger"));
  EXPECT_EQ(server_->counts().too_many, 2U);
  EXPECT_EQ(server_->counts().unauthorized, 0U);
  EXPECT_EQ(backend_.commands, 3);
  for (int i = 0; i < 10; ++i) EXPECT_TRUE(ApiClient(options_.socket).Get("/v1/status"));
}

TEST_F(Access, WhatIsMalformedIsAnsweredWithItsStatusAndChangesNothing) {
  Listen();
  EXPECT_THAT(Ask("POST /v1/stop HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 1\r\n\r\nx"),
              HasSubstr("HTTP/1.1 400 "));
  EXPECT_THAT(Ask("POST /v1/stop HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n"),
              HasSubstr("HTTP/1.1 501 "));
  EXPECT_THAT(Ask("GET / HTTP/1.1\r\nA: " + std::string(10'000, 'b') + "\r\n\r\n"),
              HasSubstr("HTTP/1.1 431 "));
  EXPECT_THAT(
      Ask("POST /v1/stop HTTP/1.1\r\nContent-Length: 5000\r\n\r\n" + std::string(5000, 'x')),
      HasSubstr("HTTP/1.1 413 "));
  EXPECT_THAT(
      Ask("BREW /v1/stop HTTP/1.1\r\nAuthorization: Bearer " + std::string(kToken) + "\r\n\r\n"),
      HasSubstr("HTTP/1.1 405 "));
  EXPECT_EQ(server_->counts().malformed, 4U);
  EXPECT_EQ(backend_.commands, 0);
}

TEST_F(Access, TheEventStreamComesOverTcpToo) {
  Listen();
  std::vector<std::string> lines;
  EXPECT_TRUE(Tcp().Events([&](const std::string& line) {
    lines.push_back(line);
    if (lines.size() == 1) hub_.Publish({{"event", "frame"}, {"frame", 1}});
    return lines.size() < 2;
  }));
  ASSERT_EQ(lines.size(), 2U);
  EXPECT_THAT(lines[1], HasSubstr("\"frame\":1"));
}

TEST_F(Access, WhoMayNotOpenTheSocketIsToldWhichGroupMay) {
  options_.tcp.address.clear();
  if (::geteuid() == 0) options_.socket_group = "daemon";
  Listen();
  std::vector<std::string> told;
  // The credentials of this thread alone: root would be let in.
  std::thread stranger([&] {
    if (::geteuid() == 0) {
      ASSERT_EQ(::syscall(SYS_setgroups, 0, nullptr), 0);
      ASSERT_EQ(::syscall(SYS_setresgid, 65534, 65534, 65534), 0);
      ASSERT_EQ(::syscall(SYS_setresuid, 65534, 65534, 65534), 0);
    } else {
      ASSERT_EQ(::chmod(options_.socket.c_str(), 0), 0);
    }
    const auto answer = ApiClient(options_.socket).Get("/v1/status");
    if (answer) return;
    EXPECT_EQ(answer.error().kind, ErrorKind::kPermission);
    told.push_back(answer.error().message);
  });
  stranger.join();
  ASSERT_EQ(told.size(), 1U) << "it was let in";
  EXPECT_THAT(told[0], HasSubstr("this user may not connect: expected one of group "));
  // Not theirs to open, not absent.
  EXPECT_EQ(ApiClient(directory_ / "none.sock").Get("/v1/status").error().kind,
            ErrorKind::kUnavailable);
}

TEST_F(Access, TheSocketBelongsToTheGroupThatIsConfigured) {
  options_.tcp.address.clear();
  options_.socket_group = "no-such-group-of-omnihdr";
  EXPECT_EQ(ApiServer::Listen(options_, backend_, hub_).error().kind, ErrorKind::kConfig);
  if (::geteuid() != 0) GTEST_SKIP() << "only root may give a socket to any group";
  options_.socket_group = "daemon";
  Listen();
  struct stat info {};
  ASSERT_EQ(::stat(options_.socket.c_str(), &info), 0);
  EXPECT_NE(info.st_gid, 0U);
  EXPECT_EQ(info.st_mode & 0777U, 0660U);
}

}  // namespace
}  // namespace omnihdr::access_test
