#pragma once

#include <cstdint>
#include <mutex>
#include <string_view>
#include <vector>

namespace omnihdr {

// Where time goes: wall clock and CPU by part. A thread records into a profile while it holds a
// ProfileRecording; scopes on threads that do not cost one read of a thread-local pointer. Nothing
// is shared between threads but the profile itself, which locks.
class Profile {
 public:
  struct Part {
    std::string_view name;
    double wall_s = 0.0;  // without the scopes inside
    double cpu_s = 0.0;   // of all the process's threads; of a task: of its own thread
    std::int64_t calls = 0;
    bool is_task = false;  // ran beside others: contained in the part that waited for it
  };
  struct Report {
    std::vector<Part> parts;  // in the order of their first beginning
    double wall_s = 0.0;      // of the recordings
    double cpu_s = 0.0;
  };
  Report report() const;  // any thread

 private:
  friend class ProfileRecording;
  friend class ProfileScope;
  friend class ProfileTask;
  // `name` must outlive the profile: a literal.
  void Add(std::string_view name, bool is_task, double wall_s, double cpu_s, int calls);

  mutable std::mutex mutex_;
  Report report_;
};

struct ProfileInstant {
  double wall_s = 0.0;
  double cpu_s = 0.0;
};

// The calling thread records into `profile` until this ends; recordings of one thread do not nest.
class ProfileRecording {
 public:
  explicit ProfileRecording(Profile& profile);
  ~ProfileRecording();
  ProfileRecording(const ProfileRecording&) = delete;
  ProfileRecording& operator=(const ProfileRecording&) = delete;

 private:
  ProfileInstant begin_;
};

// The time from here to the end of the block, less that of scopes inside, counts for `name`. For
// the thread that coordinates: outside of parallel loops, whose time is then its CPU time. CPU time
// is the whole process's: meaningful where nothing else runs in it.
class ProfileScope {
 public:
  explicit ProfileScope(std::string_view name) {
    if (recording() != nullptr) Begin(name);
  }
  ~ProfileScope() {
    if (profile_ != nullptr) End();
  }
  ProfileScope(const ProfileScope&) = delete;
  ProfileScope& operator=(const ProfileScope&) = delete;

  // The profile this thread records into, or null.
  static Profile* recording() { return recording_; }

 private:
  friend class ProfileRecording;
  friend class ProfileTask;
  void Begin(std::string_view name);
  void End();

  static constinit inline thread_local Profile* recording_ = nullptr;
  static constinit inline thread_local ProfileScope* innermost_ = nullptr;

  Profile* profile_ = nullptr;
  ProfileScope* outer_ = nullptr;
  std::string_view name_;
  ProfileInstant resumed_;
  ProfileInstant spent_;
};

// One of several tasks that run side by side, on any thread: `profile` is what recording() was on
// the thread that waits for them, null = not recorded. While a worker that waits in one task does
// another, the first one's time stands still.
class ProfileTask {
 public:
  ProfileTask(Profile* profile, std::string_view name) {
    if (profile != nullptr) Begin(profile, name);
  }
  ~ProfileTask() {
    if (profile_ != nullptr) End();
  }
  ProfileTask(const ProfileTask&) = delete;
  ProfileTask& operator=(const ProfileTask&) = delete;

 private:
  friend class ProfileScope;
  void Begin(Profile* profile, std::string_view name);
  void End();

  static constinit inline thread_local ProfileTask* innermost_ = nullptr;

  Profile* profile_ = nullptr;
  ProfileTask* outer_ = nullptr;
  std::string_view name_;
  ProfileInstant resumed_;
  ProfileInstant spent_;
};

}  // namespace omnihdr
