#include "core/base/profile.h"

#include <algorithm>
#include <cassert>
#include <ctime>

namespace omnihdr {
namespace {

double Seconds(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

ProfileInstant Now(clockid_t cpu_clock) {
  return {.wall_s = Seconds(CLOCK_MONOTONIC), .cpu_s = Seconds(cpu_clock)};
}

void Count(const ProfileInstant& from, const ProfileInstant& to, ProfileInstant* spent) {
  spent->wall_s += to.wall_s - from.wall_s;
  spent->cpu_s += to.cpu_s - from.cpu_s;
}

}  // namespace

Profile::Report Profile::report() const {
  std::lock_guard lock(mutex_);
  return report_;
}

void Profile::Add(std::string_view name, bool is_task, double wall_s, double cpu_s, int calls) {
  std::lock_guard lock(mutex_);
  auto part = std::find_if(report_.parts.begin(), report_.parts.end(),
                           [&](const Part& p) { return p.name == name && p.is_task == is_task; });
  if (part == report_.parts.end()) {
    report_.parts.push_back({.name = name, .is_task = is_task});
    part = report_.parts.end() - 1;
  }
  part->wall_s += wall_s;
  part->cpu_s += cpu_s;
  part->calls += calls;
}

ProfileRecording::ProfileRecording(Profile& profile) : begin_(Now(CLOCK_PROCESS_CPUTIME_ID)) {
  assert(ProfileScope::recording_ == nullptr);
  ProfileScope::recording_ = &profile;
}

ProfileRecording::~ProfileRecording() {
  const ProfileInstant end = Now(CLOCK_PROCESS_CPUTIME_ID);
  Profile* profile = ProfileScope::recording_;
  ProfileScope::recording_ = nullptr;
  std::lock_guard lock(profile->mutex_);
  profile->report_.wall_s += end.wall_s - begin_.wall_s;
  profile->report_.cpu_s += end.cpu_s - begin_.cpu_s;
}

void ProfileScope::Begin(std::string_view name) {
  if (ProfileTask::innermost_ != nullptr) return;  // inside a task: its time is the task's
  const ProfileInstant now = Now(CLOCK_PROCESS_CPUTIME_ID);
  profile_ = recording_;
  name_ = name;
  outer_ = innermost_;
  if (outer_ != nullptr) Count(outer_->resumed_, now, &outer_->spent_);
  profile_->Add(name_, false, 0.0, 0.0, 0);  // takes its place in the table
  resumed_ = now;
  innermost_ = this;
}

void ProfileScope::End() {
  const ProfileInstant now = Now(CLOCK_PROCESS_CPUTIME_ID);
  Count(resumed_, now, &spent_);
  profile_->Add(name_, false, spent_.wall_s, spent_.cpu_s, 1);
  innermost_ = outer_;
  if (outer_ != nullptr) outer_->resumed_ = now;
}

void ProfileTask::Begin(Profile* profile, std::string_view name) {
  const ProfileInstant now = Now(CLOCK_THREAD_CPUTIME_ID);
  profile_ = profile;
  name_ = name;
  outer_ = innermost_;
  if (outer_ != nullptr) Count(outer_->resumed_, now, &outer_->spent_);
  profile_->Add(name_, true, 0.0, 0.0, 0);
  resumed_ = now;
  innermost_ = this;
}

void ProfileTask::End() {
  const ProfileInstant now = Now(CLOCK_THREAD_CPUTIME_ID);
  Count(resumed_, now, &spent_);
  profile_->Add(name_, true, spent_.wall_s, spent_.cpu_s, 1);
  innermost_ = outer_;
  if (outer_ != nullptr) outer_->resumed_ = now;
}

}  // namespace omnihdr
