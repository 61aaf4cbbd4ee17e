// Time that passes faster, for a program that runs with this library in front of libc: its clocks,
// and how long it waits. OMNIHDR_FAST_CLOCK = "SPEED MONOTONIC_NS REALTIME_NS": the speed, and the
// moment on both clocks from which they run so. Waits in poll, epoll and select keep the usual
// time.

#include <dlfcn.h>
#include <pthread.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>

namespace {

std::int64_t g_speed = 1;
std::int64_t g_monotonic = 0;
std::int64_t g_realtime = 0;

template <typename Function>
Function Next(const char* name) {
  void* found = ::dlsym(RTLD_NEXT, name);
  Function function = nullptr;
  static_assert(sizeof function == sizeof found);
  std::memcpy(&function, &found, sizeof function);
  return function;
}
#define OMNIHDR_NEXT(function) static const auto next = Next<decltype(&::function)>(#function)

__attribute__((constructor)) void ReadEnvironment() {
  const char* text = std::getenv("OMNIHDR_FAST_CLOCK");
  if (text == nullptr) return;
  long long speed = 1;
  long long monotonic = 0;
  long long realtime = 0;
  if (std::sscanf(text, "%lld %lld %lld", &speed, &monotonic, &realtime) != 3 || speed < 1) return;
  g_speed = speed;
  g_monotonic = monotonic;
  g_realtime = realtime;
}

// Clocks that tell a time of day or since the start; those of processors stay as they are.
bool IsMonotonic(clockid_t clock) {
  return clock == CLOCK_MONOTONIC || clock == CLOCK_MONOTONIC_RAW ||
         clock == CLOCK_MONOTONIC_COARSE || clock == CLOCK_BOOTTIME;
}
bool IsRealtime(clockid_t clock) {
  return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE;
}

std::int64_t ToNs(const timespec& time) { return time.tv_sec * 1'000'000'000LL + time.tv_nsec; }
timespec FromNs(std::int64_t ns) {
  timespec time{};
  time.tv_sec = ns / 1'000'000'000;
  time.tv_nsec = ns % 1'000'000'000;
  return time;
}
std::int64_t Begin(clockid_t clock) { return IsRealtime(clock) ? g_realtime : g_monotonic; }
// A moment of the fast clock on the usual one, rounded up so that nothing wakes too early.
timespec UsualMoment(clockid_t clock, const timespec& fast) {
  const std::int64_t begin = Begin(clock);
  return FromNs(begin + (ToNs(fast) - begin + g_speed - 1) / g_speed);
}
timespec UsualTime(const timespec& fast) { return FromNs((ToNs(fast) + g_speed - 1) / g_speed); }

}  // namespace

extern "C" {

int clock_gettime(clockid_t clock, timespec* time) {
  OMNIHDR_NEXT(clock_gettime);
  const int result = next(clock, time);
  if (result != 0 || !(IsMonotonic(clock) || IsRealtime(clock))) {
    return result;
  }
  const std::int64_t begin = Begin(clock);
  *time = FromNs(begin + (ToNs(*time) - begin) * g_speed);
  return 0;
}

int nanosleep(const timespec* time, timespec* left) {
  OMNIHDR_NEXT(nanosleep);
  const timespec usual = UsualTime(*time);
  return next(&usual, left);
}

int clock_nanosleep(clockid_t clock, int flags, const timespec* time, timespec* left) {
  OMNIHDR_NEXT(clock_nanosleep);
  const timespec usual =
      (flags & TIMER_ABSTIME) != 0 ? UsualMoment(clock, *time) : UsualTime(*time);
  return next(clock, flags, &usual, left);
}

int pthread_cond_timedwait(pthread_cond_t* condition, pthread_mutex_t* mutex,
                           const timespec* until) {
  OMNIHDR_NEXT(pthread_cond_timedwait);
  const timespec usual = UsualMoment(CLOCK_REALTIME, *until);
  return next(condition, mutex, &usual);
}

int pthread_cond_clockwait(pthread_cond_t* condition, pthread_mutex_t* mutex, clockid_t clock,
                           const timespec* until) {
  OMNIHDR_NEXT(pthread_cond_clockwait);
  const timespec usual = UsualMoment(clock, *until);
  return next(condition, mutex, clock, &usual);
}

// Which clock a timer has: by its descriptor, as far as there are any here.
static std::array<clockid_t, 1024> g_timer_clocks;

int timerfd_create(clockid_t clock, int flags) {
  OMNIHDR_NEXT(timerfd_create);
  const int fd = next(clock, flags);
  if (fd >= 0 && static_cast<std::size_t>(fd) < g_timer_clocks.size()) {
    g_timer_clocks[static_cast<std::size_t>(fd)] = clock;
  }
  return fd;
}

int timerfd_settime(int fd, int flags, const itimerspec* value, itimerspec* before) {
  OMNIHDR_NEXT(timerfd_settime);
  if (fd < 0 || static_cast<std::size_t>(fd) >= g_timer_clocks.size()) {
    return next(fd, flags, value, before);
  }
  itimerspec usual = *value;
  usual.it_interval = UsualTime(value->it_interval);
  // 0 switches a timer off.
  if (ToNs(value->it_value) != 0) {
    usual.it_value =
        (flags & TFD_TIMER_ABSTIME) != 0
            ? UsualMoment(g_timer_clocks[static_cast<std::size_t>(fd)], value->it_value)
            : UsualTime(value->it_value);
  }
  return next(fd, flags, &usual, before);
}

}  // extern "C"
