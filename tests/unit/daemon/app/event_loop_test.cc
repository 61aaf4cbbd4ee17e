#include "daemon/event_loop.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <thread>

namespace omnihdr::event_loop_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

HostTime Now() { return SystemClock().Now(); }

TEST(EventLoop, MessagesRunOnTheLoopInOrder) {
  const auto loop = EventLoop::Create().value();
  std::vector<int> order;
  const std::thread::id here = std::this_thread::get_id();
  std::thread poster([&] {
    for (int i = 0; i < 100; ++i) {
      while (!loop->Post([&, i] {
        EXPECT_EQ(std::this_thread::get_id(), here);
        order.push_back(i);
      })) {
      }
    }
    loop->Quit();
  });
  EXPECT_TRUE(loop->Run());
  poster.join();
  ASSERT_EQ(order.size(), 100U);
  EXPECT_TRUE(std::is_sorted(order.begin(), order.end()));
}

TEST(EventLoop, ACallGivesItsValueAndALateOneIsNotRun) {
  const auto loop = EventLoop::Create().value();
  bool ran = false;
  // Nobody runs the loop yet.
  const Result<int> late = loop->Call(
      [&] {
        ran = true;
        return 1;
      },
      milliseconds(10));
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().kind, ErrorKind::kTemporary);
  std::thread caller([&] {
    EXPECT_EQ(loop->Call([] { return 42; }, seconds(30)).value(), 42);
    loop->Quit();
  });
  EXPECT_TRUE(loop->Run());
  caller.join();
  EXPECT_FALSE(ran);
  EXPECT_FALSE(loop->Post([] {}));
}

TEST(EventLoop, WaitingMessagesAreBounded) {
  const auto loop = EventLoop::Create().value();
  int posted = 0;
  while (posted < 100'000 && loop->Post([] {})) ++posted;
  EXPECT_LT(posted, 100'000);
}

TEST(EventLoop, TimersFireOnceAtTheirTimeAndCanBeMovedAndDisarmed) {
  const auto loop = EventLoop::Create().value();
  int fired = 0;
  HostTime at;
  EventLoop::Timer* never = loop->AddTimer([] { ADD_FAILURE() << "disarmed"; }).value();
  EventLoop::Timer* moved = loop->AddTimer([&] {
                                  ++fired;
                                  at = Now();
                                })
                                .value();
  EventLoop::Timer* end = loop->AddTimer([&] { loop->Quit(); }).value();
  const HostTime begin = Now();
  never->Set(begin + milliseconds(5));
  never->Disarm();
  moved->Set(begin + milliseconds(1));
  moved->Set(begin + milliseconds(20));
  end->Set(begin + milliseconds(60));
  EXPECT_TRUE(loop->Run());
  EXPECT_EQ(fired, 1);
  EXPECT_GE(at - begin, Nanoseconds(milliseconds(20)));
}

TEST(EventLoop, ADescriptorIsWatchedUntilItIsNot) {
  const auto loop = EventLoop::Create().value();
  const Fd fd(::eventfd(1, EFD_CLOEXEC | EFD_NONBLOCK));
  int calls = 0;
  EXPECT_TRUE(loop->OnReadable(fd.get(), [&] {
    // Stays readable: only the end of watching ends the calls.
    if (++calls == 3) loop->StopWatching(fd.get());
  }));
  EventLoop::Timer* end = loop->AddTimer([&] { loop->Quit(); }).value();
  end->Set(Now() + milliseconds(50));
  EXPECT_TRUE(loop->Run());
  EXPECT_EQ(calls, 3);
}

TEST(EventLoop, ADescriptorCanBeWatchedAgain) {
  const auto loop = EventLoop::Create().value();
  const Fd fd(::eventfd(1, EFD_CLOEXEC | EFD_NONBLOCK));
  EXPECT_TRUE(loop->OnReadable(fd.get(), [] { ADD_FAILURE(); }));
  loop->StopWatching(fd.get());
  EXPECT_TRUE(loop->OnReadable(fd.get(), [&] { loop->Quit(); }));
  EXPECT_TRUE(loop->Run());
}

TEST(EventLoop, ATerminationSignalIsAnEvent) {
  // Only this thread: the signal is sent to it alone.
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGTERM);
  sigaddset(&set, SIGINT);
  ASSERT_EQ(::pthread_sigmask(SIG_BLOCK, &set, nullptr), 0);
  const auto loop = EventLoop::Create().value();
  int heard = 0;
  ASSERT_TRUE(loop->OnTermination([&](int signal) {
    heard = signal;
    loop->Quit();
  }));
  ::pthread_kill(::pthread_self(), SIGTERM);
  EXPECT_TRUE(loop->Run());
  EXPECT_EQ(heard, SIGTERM);
}

}  // namespace
}  // namespace omnihdr::event_loop_test
