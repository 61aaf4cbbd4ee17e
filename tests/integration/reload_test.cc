#include <gmock/gmock.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <cstring>

#include "core/base/file.h"
#include "tests/integration/daemon_fixture.h"

namespace omnihdr::reload_test {
namespace {

using integration::Eventually;
using integration::RunOmnihdr;
using ::testing::HasSubstr;

class Reload : public integration::DaemonFixture {
 protected:
  void Rewrite(const std::string& more) { WriteConfig(SimCamera(), more); }
};

// What a service manager is told, datagram by datagram.
class Notifications {
 public:
  explicit Notifications(const std::filesystem::path& path)
      : fd_(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
    EXPECT_EQ(::bind(fd_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  }
  // Whether a message with that text comes; those before it are thrown away.
  bool Comes(const std::string& text) {
    return Eventually([&] {
      std::string message(4096, '\0');
      const ssize_t n = ::recv(fd_.get(), message.data(), message.size(), MSG_DONTWAIT);
      return n > 0 &&
             message.substr(0, static_cast<std::size_t>(n)).find(text) != std::string::npos;
    });
  }

 private:
  Fd fd_;
};

TEST_F(Reload, SighupAppliesWhatTheFileSaysAndTellsTheServiceManager) {
  Rewrite("");
  Notifications notifications(directory() / "notify");
  const auto daemon = Start({}, {"NOTIFY_SOCKET=" + (directory() / "notify").string()});
  ASSERT_TRUE(notifications.Comes("READY=1"));
  ASSERT_TRUE(Armed());
  Rewrite("[log]\nlevel = \"debug\"\n[recorder]\nqueue_frames = 5\n");
  daemon->Signal(SIGHUP);
  EXPECT_TRUE(notifications.Comes("RELOADING=1\nMONOTONIC_USEC="));
  EXPECT_TRUE(notifications.Comes("READY=1"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["config"]["reloads"] == 1; }));
  EXPECT_THAT(daemon->Log(), HasSubstr("reload: log.level: \"info\" -> \"debug\", at once"));
  EXPECT_THAT(daemon->Log(), HasSubstr("reload: recorder.queue_frames: 8 -> 5, at restart"));
  EXPECT_TRUE(Client().Post("/v1/disarm"));
  EXPECT_TRUE(Eventually([&] { return daemon->Log().find("state idle") != std::string::npos; }));
  EXPECT_TRUE(Client().Post("/v1/arm"));
  Rewrite("[log]\nlevel = \"loud\"\n");
  daemon->Signal(SIGHUP);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["config"]["reloads_refused"] == 1; }));
  EXPECT_THAT(daemon->Log(), HasSubstr("log.level: \"loud\", expected"));
  EXPECT_TRUE(Trigger());
}

TEST_F(Reload, TheCommandLineShowsEveryChangeAndEndsWith78WhenItIsRefused) {
  Rewrite("");
  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  const std::string socket = (directory() / "api.sock").string();
  EXPECT_EQ(RunOmnihdr({"reload", "--socket", socket}, directory()),
            std::make_pair(0, std::string("nothing has changed\n")));
  Rewrite("[log]\nlevel = \"error\"\n");
  EXPECT_EQ(RunOmnihdr({"reload", "--socket", socket}, directory()),
            std::make_pair(0, std::string("log.level: \"info\" -> \"error\" (at once)\n")));
  Rewrite("[recorder]\nqueue_frames = 0\n");
  const auto [code, output] = RunOmnihdr({"reload", "--socket", socket}, directory());
  EXPECT_EQ(code, 78);
  EXPECT_THAT(output, HasSubstr("recorder.queue_frames: 0, expected"));
}

}  // namespace
}  // namespace omnihdr::reload_test
