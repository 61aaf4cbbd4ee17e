#include "daemon/doctor/machine.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/gpio.h>
#include <poll.h>
#include <spawn.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/timex.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <csignal>
#include <fstream>
#include <random>
#include <sstream>
#include <system_error>

#include "core/base/file.h"
#include "drivers/gpio/lines.h"

namespace omnihdr::doctor {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;

constexpr std::size_t kMaxOutput = std::size_t{256} << 10;
constexpr std::chrono::seconds kRunTimeout(5);
constexpr std::chrono::milliseconds kDiskBudget(2000);
constexpr std::size_t kDiskBytes = std::size_t{256} << 20;
constexpr std::size_t kMaxKernelText = 4096;

std::vector<std::string> Split(const std::string& line, char separator) {
  std::vector<std::string> parts;
  std::istringstream in(line);
  for (std::string part; std::getline(in, part, separator);) parts.push_back(part);
  return parts;
}

template <typename T>
bool ReadNumber(const std::string& text, T* value) {
  const char* const end = text.data() + text.size();
  return !text.empty() && std::from_chars(text.data(), end, *value).ptr == end;
}

std::vector<std::string> Lines(const fs::path& path) {
  std::ifstream in(path);
  std::vector<std::string> lines;
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

Result<FileNode> RealNode(const fs::path& path) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) {
    return FailErrno(errno == ENOENT ? ErrorKind::kNoInput : ErrorKind::kPermission, path.string(),
                     errno);
  }
  return FileNode{status.st_uid, status.st_gid, status.st_mode};
}

Result<DiskSpace> RealSpace(const fs::path& path) {
  struct statvfs volume {};
  struct stat status {};
  if (::statvfs(path.c_str(), &volume) != 0 || ::stat(path.c_str(), &status) != 0) {
    return FailErrno(ErrorKind::kIo, path.string(), errno);
  }
  DiskSpace space;
  space.free_bytes = std::uint64_t{volume.f_bavail} * volume.f_frsize;
  space.total_bytes = std::uint64_t{volume.f_blocks} * volume.f_frsize;
  space.free_inodes = volume.f_favail;
  space.has_inodes = volume.f_files > 0;
  space.device = status.st_dev;
  return space;
}

Result<DiskSpeed> RealDiskSpeed(const fs::path& directory, std::size_t picture_bytes) {
  std::string pattern = (directory / ".omnihdr-doctor-XXXXXX").string();
  if (::mkdtemp(pattern.data()) == nullptr) {
    return FailErrno(ErrorKind::kCannotCreate, directory.string(), errno);
  }
  const fs::path folder = pattern;
  // Nothing that a file system could compress.
  std::vector<std::byte> picture(std::max<std::size_t>(picture_bytes, 4096));
  std::minstd_rand random(1);
  for (std::byte& byte : picture) byte = static_cast<std::byte>(random() >> 16U);
  DiskSpeed speed;
  Status written;
  const auto begin = SteadyClock::now();
  double seconds = 0.0;
  while (written && (speed.pictures < 3 || std::chrono::duration<double>(seconds) < kDiskBudget) &&
         static_cast<std::size_t>(speed.pictures) * picture.size() < kDiskBytes) {
    const auto start = SteadyClock::now();
    written = WriteFileAtomic(folder / fmt::format("{}.bin", speed.pictures), picture);
    const auto now = SteadyClock::now();
    speed.worst_s = std::max(speed.worst_s, std::chrono::duration<double>(now - start).count());
    seconds = std::chrono::duration<double>(now - begin).count();
    ++speed.pictures;
    if (std::chrono::duration<double>(seconds) > 5 * kDiskBudget) break;
  }
  std::error_code ignored;
  fs::remove_all(folder, ignored);
  if (!written) return Forward(written.error(), "measure the disk");
  speed.bytes_per_second =
      static_cast<double>(speed.pictures) * static_cast<double>(picture.size()) / seconds;
  return speed;
}

GpioChipInfo AskChip(const std::string& path) {
  GpioChipInfo chip;
  chip.path = path;
  const Fd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  gpiochip_info info{};
  if (!fd.valid() || ::ioctl(fd.get(), GPIO_GET_CHIPINFO_IOCTL, &info) != 0) {
    chip.problem = std::generic_category().message(errno);
    return chip;
  }
  chip.name = info.name;
  chip.label = info.label;
  for (std::uint32_t offset = 0; offset < info.lines; ++offset) {
    gpio_v2_line_info line{};
    line.offset = offset;
    GpioLineInfo told;
    if (::ioctl(fd.get(), GPIO_V2_GET_LINEINFO_IOCTL, &line) == 0) {
      told.name = line.name;
      told.used = (line.flags & GPIO_V2_LINE_FLAG_USED) != 0;
      told.consumer = line.consumer;
    }
    chip.lines.push_back(told);
  }
  return chip;
}

Result<std::vector<GpioChipInfo>> RealGpioChips() {
  std::vector<GpioChipInfo> chips;
  for (const std::string& path : gpio::ChipPaths()) chips.push_back(AskChip(path));
  return chips;
}

Result<bool> RealClockIsSynchronised() {
  timex state{};
  const int answer = ::adjtimex(&state);
  if (answer < 0) return FailErrno(ErrorKind::kSystem, "adjtimex", errno);
  return answer != TIME_ERROR && (state.status & STA_UNSYNC) == 0;
}

}  // namespace

std::string Machine::Text(const fs::path& absolute) const {
  // Files of /sys and /proc say a size of their own: read until the end.
  std::ifstream in(At(absolute), std::ios::binary);
  std::string text(kMaxKernelText, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(std::max<std::streamsize>(in.gcount(), 0)));
  while (!text.empty() && (text.back() == '\n' || text.back() == ' ')) text.pop_back();
  return text;
}

Result<Account> Machine::FindAccount(const std::string& name) const {
  Account account;
  account.name = name;
  bool found = false;
  for (const std::string& line : Lines(At("/etc/passwd"))) {
    const std::vector<std::string> parts = Split(line, ':');
    gid_t group = 0;
    if (parts.size() < 4 || parts[0] != name || !ReadNumber(parts[2], &account.uid) ||
        !ReadNumber(parts[3], &group)) {
      continue;
    }
    account.groups.insert(group);
    found = true;
  }
  if (!found) {
    return Fail(ErrorKind::kNoInput, "{}: no user \"{}\"", At("/etc/passwd").string(), name);
  }
  for (const std::string& line : Lines(At("/etc/group"))) {
    const std::vector<std::string> parts = Split(line, ':');
    gid_t group = 0;
    if (parts.size() < 4 || !ReadNumber(parts[2], &group)) continue;
    const std::vector<std::string> members = Split(parts[3], ',');
    if (std::find(members.begin(), members.end(), name) != members.end()) {
      account.groups.insert(group);
    }
  }
  return account;
}

std::string Machine::UserName(uid_t uid) const {
  for (const std::string& line : Lines(At("/etc/passwd"))) {
    const std::vector<std::string> parts = Split(line, ':');
    uid_t number = 0;
    if (parts.size() >= 3 && ReadNumber(parts[2], &number) && number == uid) return parts[0];
  }
  return std::to_string(uid);
}

std::string Machine::GroupName(gid_t gid) const {
  for (const std::string& line : Lines(At("/etc/group"))) {
    const std::vector<std::string> parts = Split(line, ':');
    gid_t number = 0;
    if (parts.size() >= 3 && ReadNumber(parts[2], &number) && number == gid) return parts[0];
  }
  return std::to_string(gid);
}

std::vector<pid_t> Machine::Processes(const std::string& name) const {
  std::vector<pid_t> found;
  std::error_code error;
  for (fs::directory_iterator it(At("/proc"), error), end; !error && it != end;
       it.increment(error)) {
    pid_t pid = 0;
    if (!ReadNumber(it->path().filename().string(), &pid)) continue;
    if (name.empty() || Text(fs::path("/proc") / std::to_string(pid) / "comm") == name) {
      found.push_back(pid);
    }
  }
  std::sort(found.begin(), found.end());
  return found;
}

std::vector<std::string> Machine::HoldersOf(const fs::path& absolute) const {
  std::vector<std::string> holders;
  for (const pid_t pid : Processes("")) {
    const fs::path process = fs::path("/proc") / std::to_string(pid);
    std::error_code error;
    for (fs::directory_iterator it(At(process / "fd"), error), end; !error && it != end;
         it.increment(error)) {
      std::error_code ignored;
      if (fs::read_symlink(it->path(), ignored) != absolute) continue;
      holders.push_back(fmt::format("{} ({})", pid, Text(process / "comm")));
      break;
    }
  }
  return holders;
}

Result<std::string> RunProgram(const std::vector<std::string>& words, Nanoseconds timeout) {
  std::array<int, 2> ends{};
  if (::pipe2(ends.data(), O_CLOEXEC) != 0) return FailErrno(ErrorKind::kSystem, "pipe", errno);
  const Fd out(ends[0]);
  Fd in(ends[1]);
  std::vector<std::string> copies = words;
  std::vector<char*> argv;
  for (std::string& word : copies) argv.push_back(word.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, in.get(), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, in.get(), STDERR_FILENO);
  pid_t pid = -1;
  const int error = ::posix_spawnp(&pid, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  in.Close();
  if (error != 0) return FailErrno(ErrorKind::kUnavailable, words[0], error);
  std::string text;
  const auto deadline = SteadyClock::now() + timeout;
  bool ended = false;
  while (!ended && text.size() < kMaxOutput) {
    const auto left =
        std::chrono::duration_cast<std::chrono::milliseconds>(deadline - SteadyClock::now());
    pollfd ready{out.get(), POLLIN, 0};
    if (left.count() <= 0 || ::poll(&ready, 1, static_cast<int>(left.count())) <= 0) break;
    std::array<char, 4096> piece{};
    const ssize_t n = ::read(out.get(), piece.data(), piece.size());
    if (n > 0) text.append(piece.data(), static_cast<std::size_t>(n));
    ended = n <= 0;
  }
  if (!ended) ::kill(pid, SIGKILL);
  int status = 0;
  ::waitpid(pid, &status, 0);
  if (!ended && text.size() < kMaxOutput) {
    return Fail(ErrorKind::kTemporary, "{}: no end within {} ms", words[0],
                timeout.count() / 1'000'000);
  }
  return text;
}

Machine RealMachine() {
  Machine machine;
  machine.node = RealNode;
  machine.space = RealSpace;
  machine.measure_disk = RealDiskSpeed;
  machine.gpio_chips = RealGpioChips;
  machine.clock_is_synchronised = RealClockIsSynchronised;
  machine.utc = [] { return SystemClock().NowUtc(); };
  machine.run = [](const std::vector<std::string>& words) {
    return RunProgram(words, kRunTimeout);
  };
  return machine;
}

Account CallingAccount() {
  Account account;
  account.uid = ::geteuid();
  account.name = RealMachine().UserName(account.uid);
  account.groups.insert(::getegid());
  std::vector<gid_t> groups(static_cast<std::size_t>(std::max(::getgroups(0, nullptr), 0)));
  const int count = ::getgroups(static_cast<int>(groups.size()), groups.data());
  if (count > 0) account.groups.insert(groups.begin(), groups.begin() + count);
  return account;
}

bool MayOpen(const Account& account, const FileNode& node, bool write) {
  if (account.uid == 0) return true;
  const mode_t wanted = write ? 06 : 04;
  if (node.uid == account.uid) return (node.mode >> 6U & wanted) == wanted;
  if (account.groups.contains(node.gid)) return (node.mode >> 3U & wanted) == wanted;
  return (node.mode & wanted) == wanted;
}

std::string DescribeNode(const Machine& machine, const FileNode& node) {
  std::string text = S_ISCHR(node.mode)    ? "c"
                     : S_ISBLK(node.mode)  ? "b"
                     : S_ISDIR(node.mode)  ? "d"
                     : S_ISSOCK(node.mode) ? "s"
                                           : "-";
  constexpr std::string_view kLetters = "rwxrwxrwx";
  for (std::size_t k = 0; k < kLetters.size(); ++k) {
    text += (node.mode >> (8 - k) & 1U) != 0 ? kLetters[k] : '-';
  }
  return fmt::format("{} {}:{}", text, machine.UserName(node.uid), machine.GroupName(node.gid));
}

}  // namespace omnihdr::doctor
