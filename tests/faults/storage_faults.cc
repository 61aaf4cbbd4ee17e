#include "tests/faults/storage_faults.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstring>
#include <stdexcept>

namespace omnihdr::faults {
namespace {

void CopyPath(std::array<char, 1024>& to, const std::filesystem::path& path) {
  const std::string text = path.empty() ? "" : std::filesystem::absolute(path).string();
  if (text.size() >= to.size()) throw std::runtime_error(text + ": too long a path");
  std::memcpy(to.data(), text.c_str(), text.size() + 1);
}

}  // namespace

StorageFaults::StorageFaults(const std::filesystem::path& block,
                             const std::filesystem::path& session)
    : block_(std::filesystem::absolute(block)), session_(session) {
  const int fd = ::open(block_.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  void* memory = MAP_FAILED;
  if (fd >= 0 && ::ftruncate(fd, sizeof(Control)) == 0) {
    memory = ::mmap(nullptr, sizeof(Control), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  }
  if (fd >= 0) ::close(fd);
  if (memory == MAP_FAILED) throw std::runtime_error(block_.string() + ": cannot be made");
  control_ = static_cast<Control*>(memory);  // all zero
  CopyPath(control_->session, session);
  Clear();
  control_->ready.store(1, std::memory_order_release);
}

StorageFaults::~StorageFaults() { ::munmap(control_, sizeof(Control)); }

std::vector<std::string> StorageFaults::Environment() const {
  return {"LD_PRELOAD=" OMNIHDR_STORAGE_FAULTS, "OMNIHDR_STORAGE_FAULTS=" + block_.string()};
}

void StorageFaults::ActivateHere() const { OmnihdrStorageFaults(block_.c_str()); }

void StorageFaults::Clear() {
  Control& c = *control_;
  c.kill_at = 0;
  c.kill_point = 0;
  for (auto& error : c.error) error = 0;
  c.error_files = kAllFiles;
  c.fail_at = 0;
  c.room = kEndlessRoom;
  c.slow_sync_us = 0;
  c.slow_megabyte_us = 0;
  c.record[0] = '\0';
  c.failed = 0;
  c.calls = 0;
  for (auto& of_call : c.counts) {
    for (auto& count : of_call) count = 0;
  }
}

void StorageFaults::KillAt(std::uint64_t number, Moment moment) {
  control_->kill_point = 0;
  control_->kill_moment = static_cast<std::uint32_t>(moment);
  control_->kill_at = number;
}

void StorageFaults::KillAt(Call call, File file, std::uint64_t number, Moment moment) {
  control_->kill_point =
      static_cast<std::uint32_t>(call) * kFiles + static_cast<std::uint32_t>(file) + 1;
  control_->kill_moment = static_cast<std::uint32_t>(moment);
  control_->kill_at = number;
}

void StorageFaults::Fail(std::initializer_list<Call> calls, int error, std::uint32_t files) {
  control_->error_files = files;
  for (const Call call : calls) control_->error[static_cast<std::size_t>(call)] = error;
}

void StorageFaults::FailOnce(std::uint64_t number, int error) {
  control_->fail_error = error;
  control_->fail_at = number;
}

void StorageFaults::LeaveRoom(std::int64_t bytes) { control_->room = bytes; }

void StorageFaults::Slow(std::uint32_t sync_us, std::uint32_t megabyte_us) {
  control_->slow_sync_us = sync_us;
  control_->slow_megabyte_us = megabyte_us;
}

void StorageFaults::RecordTo(const std::filesystem::path& file) {
  CopyPath(control_->record, file);
}

std::uint64_t StorageFaults::calls() const { return control_->calls; }
std::uint64_t StorageFaults::failed() const { return control_->failed; }

std::string StorageFaults::Point::Name() const {
  return fmt::format("{} {}", ToString(call), ToString(file));
}

std::vector<StorageFaults::Point> StorageFaults::points() const {
  std::vector<Point> points;
  for (std::size_t call = 0; call < kCalls; ++call) {
    for (std::size_t file = 0; file < kFiles; ++file) {
      const std::uint64_t count = control_->counts[call][file];
      if (count == 0) continue;
      points.push_back({static_cast<Call>(call), static_cast<File>(file), count});
    }
  }
  return points;
}

}  // namespace omnihdr::faults
