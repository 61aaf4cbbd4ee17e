#include "core/base/stage.h"

#include <pthread.h>

#include <exception>
#include <utility>

#include "core/base/realtime.h"

namespace omnihdr {

Stage::Stage(std::string name, Body body)
    : name_(std::move(name)), thread_([this, body = std::move(body)](std::stop_token stop) {
        pthread_setname_np(pthread_self(), name_.substr(0, 15).c_str());
        LeaveRealtime();
        try {
          outcome_ = body(stop, *this);
        } catch (const std::exception& e) {
          outcome_ = Fail(ErrorKind::kSoftware, "stage {}: {}", name_, e.what());
        } catch (...) {
          outcome_ = Fail(ErrorKind::kSoftware, "stage {}: unknown exception", name_);
        }
        finished_.store(true, std::memory_order_release);
      }) {}

Stage::~Stage() = default;

Status Stage::Join() {
  if (thread_.joinable()) thread_.join();
  return outcome_;
}

}  // namespace omnihdr
