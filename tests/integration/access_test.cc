#include <gmock/gmock.h>
#include <sys/stat.h>

#include <fstream>

#include "core/base/tcp.h"
#include "tests/integration/daemon_fixture.h"

namespace omnihdr::access_test {
namespace {

using integration::Eventually;
using integration::RunOmnihdr;
using ::testing::HasSubstr;

class Access : public integration::DaemonFixture {};

TEST_F(Access, TheCommandLineAsksOverTcpWithTheToken) {
  int port = 0;
  {
    const Fd any = ListenTcp("127.0.0.1", 0).value();
    port = LocalPort(any.get());
  }
  const std::string token = (directory() / "token").string();
  std::ofstream(token) << "the-token-of-this-test\n";
  ASSERT_EQ(::chmod(token.c_str(), 0600), 0);
  const std::string tcp = fmt::format("127.0.0.1:{}", port);
  std::ofstream(directory() / "c.toml") << fmt::format(
      "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
      "tcp = \"{}\"\ntoken_file = \"token\"\n{}\n{}",
      tcp, SimCamera(), integration::kAnyStorage);
  {
    ASSERT_EQ(::chmod(token.c_str(), 0644), 0);
    const auto refused = Start();
    EXPECT_EQ(refused->Wait(), 77);
    EXPECT_THAT(refused->Log(), HasSubstr("mode 0644, expected a token that its owner alone"));
    ASSERT_EQ(::chmod(token.c_str(), 0600), 0);
  }
  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  const auto [code, output] =
      RunOmnihdr({"trigger", "--tcp", tcp, "--token-file", token}, directory());
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("trigger 0: position 0"));
  std::ofstream(token) << "another-token-than-that\n";
  EXPECT_EQ(RunOmnihdr({"status", "--tcp", tcp, "--token-file", token}, directory()).first, 77);
  EXPECT_EQ(RunOmnihdr({"status", "--tcp", "localhost:1"}, directory()).first, 64);
  EXPECT_EQ(StatusNow()["api"]["refused"]["unauthorized"], 1);
}

TEST_F(Access, AnAddressThatOthersReachIsRefusedUnlessItIsSaid) {
  std::ofstream(directory() / "remote.toml")
      << "[api]\nsocket = \"api.sock\"\ntcp = \"0.0.0.0:8787\"\n";
  const auto [code, output] =
      RunOmnihdr({"config", "check", (directory() / "remote.toml").string()}, directory());
  EXPECT_EQ(code, 78);
  EXPECT_THAT(output, HasSubstr("expected a loopback address unless api.tcp_remote = true"));
}

}  // namespace
}  // namespace omnihdr::access_test
