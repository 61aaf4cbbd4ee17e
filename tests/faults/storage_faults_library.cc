// The library: functions of libc that change files, in front of libc's own. Everything that is not
// below the session's directory goes straight through.

#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <string>
#include <string_view>

#include "tests/faults/storage_faults.h"

namespace omnihdr::faults {
namespace {

Control* g_control = nullptr;

template <typename Function>
Function Next(const char* name) {
  void* found = ::dlsym(RTLD_NEXT, name);
  Function function = nullptr;
  static_assert(sizeof function == sizeof found);
  std::memcpy(&function, &found, sizeof function);
  return function;
}
// libc's own function of this name.
#define OMNIHDR_NEXT(function) \
  static const auto next = ::omnihdr::faults::Next<decltype(&::function)>(#function)

Control* Attach(const char* block) {
  const int fd = static_cast<int>(::syscall(SYS_openat, AT_FDCWD, block, O_RDWR | O_CLOEXEC));
  if (fd < 0) return nullptr;
  void* memory = ::mmap(nullptr, sizeof(Control), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  ::syscall(SYS_close, fd);
  return memory == MAP_FAILED ? nullptr : static_cast<Control*>(memory);
}

// When the program is loaded.
__attribute__((constructor)) void AttachByEnvironment() {
  if (const char* block = std::getenv("OMNIHDR_STORAGE_FAULTS")) g_control = Attach(block);
}

Control* control() {
  return g_control != nullptr && g_control->ready.load(std::memory_order_acquire) != 0 ? g_control
                                                                                       : nullptr;
}

[[noreturn]] void Die() {
  ::kill(::getpid(), SIGKILL);
  while (true) ::pause();
}

std::string PathOf(int fd) {
  char link[64];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  char path[2048];
  const ssize_t length = ::syscall(SYS_readlinkat, AT_FDCWD, link, path, sizeof path);
  return length > 0 ? std::string(path, static_cast<std::size_t>(length)) : std::string();
}

std::string PathAt(int directory, const char* path) {
  if (path == nullptr || path[0] == '/') return path == nullptr ? "" : path;
  std::string base = PathOf(directory);
  if (directory == AT_FDCWD) {
    char here[2048];
    base = ::syscall(SYS_getcwd, here, sizeof here) > 0 ? here : "";
  }
  return base + "/" + path;
}

// The path below the session's directory, "." for itself, nothing for all others.
std::string_view Below(const Control& c, const std::string& path) {
  const std::string_view session(c.session.data());
  std::string_view rest(path);
  while (rest.size() > 1 && rest.ends_with('/')) rest.remove_suffix(1);
  if (!rest.starts_with(session)) return {};
  rest.remove_prefix(session.size());
  if (rest.empty()) return ".";
  return rest.front() == '/' ? rest.substr(1) : std::string_view{};
}

std::mutex g_recording;

void Record(const Control& c, RecordedCall header, std::string_view path, std::string_view other,
            const void* data) {
  header.path_bytes = static_cast<std::uint32_t>(path.size());
  header.other_path_bytes = static_cast<std::uint32_t>(other.size());
  const int fd = static_cast<int>(::syscall(SYS_openat, AT_FDCWD, c.record.data(),
                                            O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644));
  if (fd < 0) return;
  std::string bytes(reinterpret_cast<const char*>(&header), sizeof header);
  bytes.append(path).append(other);
  if (data != nullptr) bytes.append(static_cast<const char*>(data), header.data_bytes);
  ::syscall(SYS_write, fd, bytes.data(), bytes.size());
  ::syscall(SYS_close, fd);
}

// One call that changes something.
struct Doing {
  RecordedCall header;
  std::string path;
  std::string other;
  const void* data = nullptr;
};

// Counts the call, and does to it what the block says. `real` does the call itself; `half` does
// half of it, where there is one, and tells how much that was.
template <typename Real, typename Half>
auto Do(const Doing& doing, const Real& real, const Half& half) -> decltype(real()) {
  Control* c = control();
  if (c == nullptr) return real();
  const std::string_view below = Below(*c, doing.path);
  const std::string_view other = doing.other.empty() ? "" : Below(*c, doing.other);
  if (below.empty()) return real();
  const Call call = doing.header.call;
  // A view that appears is meant by its final name.
  const File file = FileOf(other.empty() ? below : other);
  const auto call_index = static_cast<std::size_t>(call);
  const auto file_index = static_cast<std::size_t>(file);
  const std::uint64_t of_all = ++c->calls;
  const std::uint64_t of_point = ++c->counts[call_index][file_index];
  const std::uint64_t at = c->kill_at;
  const std::uint32_t point = c->kill_point;
  const bool dies =
      at != 0 &&
      (point == 0 ? of_all == at : point == call_index * kFiles + file_index + 1 && of_point == at);
  const auto moment = static_cast<Moment>(c->kill_moment.load());
  if (dies && moment == Moment::kBefore) Die();
  if (dies && moment == Moment::kHalf) {
    half();
    Die();
  }
  if (call == Call::kSync || call == Call::kSyncDirectory) {
    if (const std::uint32_t slow = c->slow_sync_us) ::usleep(slow);
  } else if (call == Call::kWrite) {
    const std::uint64_t slow = c->slow_megabyte_us;
    if (slow != 0) ::usleep(static_cast<useconds_t>(slow * doing.header.data_bytes / 1'000'000));
  }
  if ((c->error_files & 1U << file_index) != 0) {
    int error = c->error[call_index];
    if (c->fail_at != 0 && c->fail_at == of_all) error = c->fail_error;
    if (error == 0 && call == Call::kWrite) {
      const auto bytes = static_cast<std::int64_t>(doing.header.data_bytes);
      const std::int64_t room = c->room.fetch_sub(bytes);
      if (room < bytes) {
        c->room = 0;
        error = ENOSPC;
        // The last write that finds some room is a short one.
        if (room >= bytes / 2) {
          if (const auto done = half(); done > 0) return done;
        }
      }
    }
    if (error != 0) {
      ++c->failed;
      errno = error;
      return -1;
    }
  }
  decltype(real()) result{};
  if (c->record[0] != '\0') {
    std::lock_guard lock(g_recording);
    result = real();
    if (result >= 0) {
      RecordedCall header = doing.header;
      if (call == Call::kWrite) header.data_bytes = static_cast<std::uint64_t>(result);
      Record(*c, header, below, other, doing.data);
    }
  } else {
    result = real();
  }
  if (dies) Die();
  return result;
}

template <typename Real>
auto Do(const Doing& doing, const Real& real) -> decltype(real()) {
  return Do(doing, real, [] { return decltype(real()){}; });
}

Doing On(Call call, std::string path) {
  Doing doing;
  doing.header.call = call;
  doing.path = std::move(path);
  return doing;
}

bool ToWrite(int flags) {
  return (flags & O_ACCMODE) != O_RDONLY || (flags & (O_CREAT | O_TRUNC)) != 0;
}

Doing Opening(int directory, const char* path, bool empties) {
  Doing doing = On(Call::kOpen, PathAt(directory, path));
  doing.header.offset = empties ? 1 : 0;
  return doing;
}

// `offset` < 0: where the file is now.
Doing Writing(int fd, const void* data, std::size_t bytes, off_t offset) {
  Doing doing = On(Call::kWrite, PathOf(fd));
  if (offset < 0) {
    struct stat status {};
    const int flags = ::fcntl(fd, F_GETFL);
    offset = flags >= 0 && (flags & O_APPEND) != 0 && ::fstat(fd, &status) == 0
                 ? status.st_size
                 : static_cast<off_t>(::syscall(SYS_lseek, fd, 0, SEEK_CUR));
  }
  doing.header.offset = static_cast<std::uint64_t>(std::max<off_t>(offset, 0));
  doing.header.data_bytes = bytes;
  doing.data = data;
  return doing;
}

Doing Syncing(int fd) {
  struct stat status {};
  const bool directory = ::fstat(fd, &status) == 0 && S_ISDIR(status.st_mode);
  return On(directory ? Call::kSyncDirectory : Call::kSync, PathOf(fd));
}

}  // namespace
}  // namespace omnihdr::faults

using namespace omnihdr::faults;  // NOLINT(google-build-using-namespace)

extern "C" {

void OmnihdrStorageFaults(const char* block) { g_control = Attach(block); }

#define OMNIHDR_MODE_OF(flags, last)              \
  mode_t mode = 0;                                \
  if (((flags) & (O_CREAT | __O_TMPFILE)) != 0) { \
    va_list arguments;                            \
    va_start(arguments, last);                    \
    mode = va_arg(arguments, mode_t);             \
    va_end(arguments);                            \
  }

int open(const char* path, int flags, ...) {
  OMNIHDR_MODE_OF(flags, flags)
  OMNIHDR_NEXT(open);
  if (control() == nullptr || !ToWrite(flags)) return next(path, flags, mode);
  return Do(Opening(AT_FDCWD, path, (flags & O_TRUNC) != 0),
            [&] { return next(path, flags, mode); });
}

int open64(const char* path, int flags, ...) {
  OMNIHDR_MODE_OF(flags, flags)
  OMNIHDR_NEXT(open64);
  if (control() == nullptr || !ToWrite(flags)) return next(path, flags, mode);
  return Do(Opening(AT_FDCWD, path, (flags & O_TRUNC) != 0),
            [&] { return next(path, flags, mode); });
}

int openat(int directory, const char* path, int flags, ...) {
  OMNIHDR_MODE_OF(flags, flags)
  OMNIHDR_NEXT(openat);
  if (control() == nullptr || !ToWrite(flags)) return next(directory, path, flags, mode);
  return Do(Opening(directory, path, (flags & O_TRUNC) != 0),
            [&] { return next(directory, path, flags, mode); });
}

int openat64(int directory, const char* path, int flags, ...) {
  OMNIHDR_MODE_OF(flags, flags)
  OMNIHDR_NEXT(openat64);
  if (control() == nullptr || !ToWrite(flags)) return next(directory, path, flags, mode);
  return Do(Opening(directory, path, (flags & O_TRUNC) != 0),
            [&] { return next(directory, path, flags, mode); });
}

// How the streams of the C++ library open their files.
static FILE* OpenStream(FILE* (*next)(const char*, const char*), const char* path,
                        const char* mode) {
  if (control() == nullptr || mode == nullptr || std::strpbrk(mode, "wa+") == nullptr) {
    return next(path, mode);
  }
  FILE* file = nullptr;
  Do(Opening(AT_FDCWD, path, mode[0] == 'w'), [&] {
    file = next(path, mode);
    return file == nullptr ? -1 : 0;
  });
  return file;
}

FILE* fopen(const char* path, const char* mode) {
  OMNIHDR_NEXT(fopen);
  return OpenStream(next, path, mode);
}

FILE* fopen64(const char* path, const char* mode) {
  OMNIHDR_NEXT(fopen64);
  return OpenStream(next, path, mode);
}

ssize_t write(int fd, const void* data, size_t bytes) {
  OMNIHDR_NEXT(write);
  if (control() == nullptr) return next(fd, data, bytes);
  return Do(
      Writing(fd, data, bytes, -1), [&] { return next(fd, data, bytes); },
      [&] { return next(fd, data, bytes / 2); });
}

ssize_t writev(int fd, const iovec* parts, int count) {
  OMNIHDR_NEXT(writev);
  if (control() == nullptr) return next(fd, parts, count);
  std::string joined;
  for (int i = 0; i < count; ++i) {
    joined.append(static_cast<const char*>(parts[i].iov_base), parts[i].iov_len);
  }
  return Do(
      Writing(fd, joined.data(), joined.size(), -1), [&] { return next(fd, parts, count); },
      [&] { return ::syscall(SYS_write, fd, joined.data(), joined.size() / 2); });
}

ssize_t pwrite(int fd, const void* data, size_t bytes, off_t offset) {
  OMNIHDR_NEXT(pwrite);
  if (control() == nullptr) return next(fd, data, bytes, offset);
  return Do(
      Writing(fd, data, bytes, offset), [&] { return next(fd, data, bytes, offset); },
      [&] { return next(fd, data, bytes / 2, offset); });
}

ssize_t pwrite64(int fd, const void* data, size_t bytes, off64_t offset) {
  OMNIHDR_NEXT(pwrite64);
  if (control() == nullptr) return next(fd, data, bytes, offset);
  return Do(
      Writing(fd, data, bytes, offset), [&] { return next(fd, data, bytes, offset); },
      [&] { return next(fd, data, bytes / 2, offset); });
}

int fsync(int fd) {
  OMNIHDR_NEXT(fsync);
  if (control() == nullptr) return next(fd);
  return Do(Syncing(fd), [&] { return next(fd); });
}

int fdatasync(int fd) {
  OMNIHDR_NEXT(fdatasync);
  if (control() == nullptr) return next(fd);
  return Do(Syncing(fd), [&] { return next(fd); });
}

int rename(const char* from, const char* to) {
  OMNIHDR_NEXT(rename);
  if (control() == nullptr) return next(from, to);
  Doing doing = On(Call::kRename, PathAt(AT_FDCWD, from));
  doing.other = PathAt(AT_FDCWD, to);
  return Do(doing, [&] { return next(from, to); });
}

int renameat2(int from_directory, const char* from, int to_directory, const char* to,
              unsigned int flags) {
  OMNIHDR_NEXT(renameat2);
  if (control() == nullptr) return next(from_directory, from, to_directory, to, flags);
  Doing doing = On(Call::kRename, PathAt(from_directory, from));
  doing.other = PathAt(to_directory, to);
  doing.header.exchange = (flags & RENAME_EXCHANGE) != 0 ? 1 : 0;
  return Do(doing, [&] { return next(from_directory, from, to_directory, to, flags); });
}

int mkdir(const char* path, mode_t mode) {
  OMNIHDR_NEXT(mkdir);
  if (control() == nullptr) return next(path, mode);
  return Do(On(Call::kMakeDirectory, PathAt(AT_FDCWD, path)), [&] { return next(path, mode); });
}

int unlink(const char* path) {
  OMNIHDR_NEXT(unlink);
  if (control() == nullptr) return next(path);
  return Do(On(Call::kRemove, PathAt(AT_FDCWD, path)), [&] { return next(path); });
}

int rmdir(const char* path) {
  OMNIHDR_NEXT(rmdir);
  if (control() == nullptr) return next(path);
  return Do(On(Call::kRemove, PathAt(AT_FDCWD, path)), [&] { return next(path); });
}

int remove(const char* path) {
  OMNIHDR_NEXT(remove);
  if (control() == nullptr) return next(path);
  return Do(On(Call::kRemove, PathAt(AT_FDCWD, path)), [&] { return next(path); });
}

int unlinkat(int directory, const char* path, int flags) {
  OMNIHDR_NEXT(unlinkat);
  if (control() == nullptr) return next(directory, path, flags);
  return Do(On(Call::kRemove, PathAt(directory, path)),
            [&] { return next(directory, path, flags); });
}

static Doing Truncating(int fd, off_t length) {
  Doing doing = On(Call::kTruncate, PathOf(fd));
  doing.header.data_bytes = static_cast<std::uint64_t>(length);
  return doing;
}

int ftruncate(int fd, off_t length) {
  OMNIHDR_NEXT(ftruncate);
  if (control() == nullptr) return next(fd, length);
  return Do(Truncating(fd, length), [&] { return next(fd, length); });
}

int ftruncate64(int fd, off64_t length) {
  OMNIHDR_NEXT(ftruncate64);
  if (control() == nullptr) return next(fd, length);
  return Do(Truncating(fd, length), [&] { return next(fd, length); });
}

int fallocate(int fd, int mode, off_t offset, off_t length) {
  OMNIHDR_NEXT(fallocate);
  if (control() == nullptr) return next(fd, mode, offset, length);
  return Do(On(Call::kAllocate, PathOf(fd)), [&] { return next(fd, mode, offset, length); });
}

int fallocate64(int fd, int mode, off64_t offset, off64_t length) {
  OMNIHDR_NEXT(fallocate64);
  if (control() == nullptr) return next(fd, mode, offset, length);
  return Do(On(Call::kAllocate, PathOf(fd)), [&] { return next(fd, mode, offset, length); });
}

}  // extern "C"
