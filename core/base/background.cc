#include "core/base/background.h"

#include <oneapi/tbb/task_scheduler_observer.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

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

}  // namespace omnihdr
