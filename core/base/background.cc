#include "core/base/background.h"

#include <oneapi/tbb/task_scheduler_observer.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <charconv>
#include <filesystem>
#include <fstream>
#include <system_error>

namespace omnihdr {
namespace {

void LowerThisThread() {
  static thread_local bool is_lowered = false;
  if (is_lowered) return;
  is_lowered = true;
  const auto thread = static_cast<id_t>(::syscall(SYS_gettid));
  ::setpriority(PRIO_PROCESS, thread, 19);
  const sched_param none{};
  ::sched_setscheduler(static_cast<pid_t>(thread), SCHED_BATCH, &none);
}

}  // namespace

// Of the arena that the constructing thread's loops run in.
class BackgroundThread::Observer final : public tbb::task_scheduler_observer {
 public:
  Observer() { observe(true); }
  ~Observer() override { observe(false); }
  Observer(const Observer&) = delete;
  Observer& operator=(const Observer&) = delete;
  void on_scheduler_entry(bool is_worker) override {
    if (is_worker) LowerThisThread();
  }
};

BackgroundThread::BackgroundThread() {
  LowerThisThread();
  observer_ = std::make_unique<Observer>();
}

BackgroundThread::~BackgroundThread() = default;

Nanoseconds BackgroundWait() {
  Nanoseconds waited{0};
  std::error_code error;
  for (std::filesystem::directory_iterator it("/proc/self/task", error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = it->path().filename().string();
    pid_t thread = 0;
    std::from_chars(name.data(), name.data() + name.size(), thread);
    if (::sched_getscheduler(thread) != SCHED_BATCH) continue;
    std::ifstream statistics(it->path() / "schedstat");
    std::int64_t ran = 0;
    std::int64_t stood = 0;
    if (statistics >> ran >> stood) waited += Nanoseconds(stood);
  }
  return waited;
}

}  // namespace omnihdr
