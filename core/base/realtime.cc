#include "core/base/realtime.h"

#include <sched.h>

namespace omnihdr {

RealtimeThread::RealtimeThread(RealtimePriority priority) {
  sched_param wanted{};
  wanted.sched_priority = static_cast<int>(priority);
  granted_ = ::sched_setscheduler(0, SCHED_FIFO, &wanted) == 0;
}

RealtimeThread::~RealtimeThread() {
  if (granted_) LeaveRealtime();
}

void LeaveRealtime() {
  if (::sched_getscheduler(0) != SCHED_FIFO) return;
  const sched_param none{};
  ::sched_setscheduler(0, SCHED_OTHER, &none);
}

}  // namespace omnihdr
