#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <cstddef>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include "core/base/file.h"
#include "daemon/watchdog.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/app/app_fixture.h"

// Whoever stands still, the service manager is not told that all is well.
namespace omnihdr::watchdog_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class Watchdog : public testing_app::AppFixture {
 protected:
  Watchdog() {
    const std::string path = (directory_.path() / "notify").string();
    manager_ = Fd(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
    EXPECT_EQ(::bind(manager_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)),
              0);
    ::setenv("NOTIFY_SOCKET", path.c_str(), 1);
    ::setenv("WATCHDOG_USEC", "200000", 1);  // fed every 100 ms
    // Read all the time: a full socket takes no message.
    reader_ = std::jthread([this](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        std::string message(4096, '\0');
        const ssize_t n = ::recv(manager_.get(), message.data(), message.size(), 0);
        if (n <= 0) {
          std::this_thread::sleep_for(milliseconds(5));
        } else if (message.find("WATCHDOG=1") != std::string::npos) {
          ++fed_;
        }
      }
    });
    patience_ = {milliseconds(1500), milliseconds(1500), milliseconds(1500)};
  }
  ~Watchdog() override {
    EXPECT_TRUE(Join(true));
    ::unsetenv("NOTIFY_SOCKET");
    ::unsetenv("WATCHDOG_USEC");
  }
  // How often the watchdog was fed within a time.
  int Fed(milliseconds time) {
    const int before = fed_;
    std::this_thread::sleep_for(time);
    return fed_ - before;
  }
  // Whether there is a second in which it is not fed at all.
  bool Starves() {
    for (int i = 0; i < 20; ++i) {
      if (Fed(seconds(1)) == 0) return true;
    }
    return false;
  }
  void StartDriving() {
    Start();
    ASSERT_TRUE(InState("armed"));
    Trigger();
    ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
    EXPECT_GT(Fed(seconds(2)), 3);
  }
  void IsStuck(const std::string& stage) {
    ASSERT_TRUE(InState("fault"));
    // On a busy machine another stage may be slow before it.
    EXPECT_TRUE(StatusHolds([&](const auto& s) {
      return s["reason"].template get<std::string>().find(stage + " has made no progress") !=
             std::string::npos;
    }));
    EXPECT_TRUE(Starves());
  }
  void GoesOn() {
    ASSERT_TRUE(StatusHolds([](const auto& s) { return s["state"] != "fault"; }));
    EXPECT_GT(Fed(seconds(2)), 3);
  }

  Fd manager_;
  std::atomic<int> fed_ = 0;
  std::jthread reader_;
};

TEST_F(Watchdog, IsNotFedWhileTheCameraIsStuck) {
  StartDriving();
  camera_->stuck = true;
  IsStuck("camera");
  camera_->stuck = false;
  GoesOn();
}

TEST_F(Watchdog, IsNotFedWhileTheRecorderIsStuck) {
  StartDriving();
  // A write that does not come back: a pipe that nobody reads, in the next picture's place.
  const std::string pipe = (session() / "raw" / "000001.png.tmp").string();
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  Trigger();
  IsStuck("recorder");
  const Fd reader(::open(pipe.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC));
  GoesOn();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
}

TEST_F(Watchdog, IsNotFedWhileThePipelineIsStuck) {
  StartDriving();
  views_stuck_ = true;
  IsStuck("pipeline");
  views_stuck_ = false;
  GoesOn();
}

TEST_F(Watchdog, IsNotFedWhileTheMainLoopIsStuck) {
  vehicle_ = std::make_shared<testing_app::FakeVehicle>();
  vehicle_->Report(true, "");
  StartDriving();
  vehicle_->stuck = true;
  EXPECT_TRUE(Starves());
  vehicle_->stuck = false;
  EXPECT_GT(Fed(seconds(2)), 3);
}

TEST_F(Watchdog, IsFedWhileThereIsNoCamera) {
  camera_->SetPresent(false);
  Start();
  ASSERT_TRUE(InState("waiting-for-camera"));
  EXPECT_GT(Fed(seconds(4)), 10);
}

// A manager that is busy or stopped itself: its socket takes some hundred messages at most.
TEST(ServiceNotifier, WaitsForNobodyAndSendsLaterWhatThereWasNoRoomFor) {
  const testing::TemporaryDirectory directory;
  const std::string path = (directory.path() / "notify").string();
  Fd manager(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
  ASSERT_EQ(::bind(manager.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  ::setenv("NOTIFY_SOCKET", path.c_str(), 1);
  ServiceNotifier notifier;
  ::unsetenv("NOTIFY_SOCKET");
  std::atomic<bool> done = false;
  std::jthread talker([&] {
    for (int i = 0; i < 5000; ++i) notifier.StatusText(fmt::format("text {}", i));
    notifier.Ready();
    notifier.FeedWatchdog();
    done = true;
  });
  for (int i = 0; i < 1000 && !done; ++i) std::this_thread::sleep_for(milliseconds(10));
  EXPECT_TRUE(done);
  std::vector<std::string> heard;
  const auto listen = [&] {
    heard.clear();
    std::string message(4096, '\0');
    for (ssize_t n = 0;
         (n = ::recv(manager.get(), message.data(), message.size(), MSG_DONTWAIT)) > 0;) {
      heard.push_back(message.substr(0, static_cast<std::size_t>(n)));
    }
  };
  listen();
  if (!done) manager.Close();  // lets a talker go that waits for room
  talker.join();
  ASSERT_GT(heard.size(), 1U);
  EXPECT_LT(heard.size(), 5000U);
  EXPECT_EQ(heard.front(), "STATUS=text 0");
  notifier.FeedWatchdog();
  listen();
  EXPECT_EQ(heard, (std::vector<std::string>{"READY=1", "STATUS=text 4999", "WATCHDOG=1"}));
}

TEST(ServiceNotifier, FindsAManagerWhoseSocketIsNoFile) {
  const std::string name = fmt::format("omnihdr-notify-{}", ::getpid());
  const Fd manager(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path + 1, name.data(), name.size());
  const auto length = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + name.size());
  ASSERT_EQ(::bind(manager.get(), reinterpret_cast<const sockaddr*>(&address), length), 0);
  ::setenv("NOTIFY_SOCKET", ("@" + name).c_str(), 1);
  ServiceNotifier notifier;
  ::unsetenv("NOTIFY_SOCKET");
  notifier.Stopping();
  std::string message(64, '\0');
  const ssize_t n = ::recv(manager.get(), message.data(), message.size(), 0);
  ASSERT_GT(n, 0);
  EXPECT_EQ(message.substr(0, static_cast<std::size_t>(n)), "STOPPING=1");
}

}  // namespace
}  // namespace omnihdr::watchdog_test
