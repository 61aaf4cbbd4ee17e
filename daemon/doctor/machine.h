#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr::doctor {

// Who would use the devices: access is decided by their owner, group and mode, as the kernel does
// for files without access lists.
struct Account {
  std::string name;
  uid_t uid = 0;
  std::set<gid_t> groups;
};

struct FileNode {
  uid_t uid = 0;
  gid_t gid = 0;
  mode_t mode = 0;  // with the type
};

struct GpioLineInfo {
  std::string name;
  bool used = false;
  std::string consumer;  // who uses it
};
struct GpioChipInfo {
  std::string path;  // "/dev/gpiochip0"
  std::string name;
  std::string label;
  std::vector<GpioLineInfo> lines;  // by offset
  std::string problem;              // why it could not be asked
};

struct DiskSpace {
  std::uint64_t free_bytes = 0;  // for this user
  std::uint64_t total_bytes = 0;
  std::uint64_t free_inodes = 0;
  bool has_inodes = true;  // whether the file system counts them
  dev_t device = 0;
};

struct DiskSpeed {
  double bytes_per_second = 0.0;  // of whole pictures, each durable
  double worst_s = 0.0;           // the slowest of them
  int pictures = 0;
};

// The machine as the checks see it: files below `root`, and what no file tells. Tests put their own
// in place of any of it. Every call ends within seconds.
struct Machine {
  std::filesystem::path root = "/";  // of /dev, /etc, /proc, /run, /sys, /lib, /usr
  std::function<Result<FileNode>(const std::filesystem::path&)> node;
  std::function<Result<DiskSpace>(const std::filesystem::path&)> space;
  // Writes pictures of so many bytes into a directory as the recorder does, and removes them.
  std::function<Result<DiskSpeed>(const std::filesystem::path&, std::size_t)> measure_disk;
  std::function<Result<std::vector<GpioChipInfo>>()> gpio_chips;
  // Whether the kernel says that something keeps its clock.
  std::function<Result<bool>()> clock_is_synchronised;
  std::function<UtcTime()> utc;
  // What a program prints (at most 256 kB), ended after 5 s; kUnavailable when there is none.
  std::function<Result<std::string>(const std::vector<std::string>&)> run;

  // `absolute` ("/dev/video0") below the root.
  std::filesystem::path At(const std::filesystem::path& absolute) const {
    return root / absolute.relative_path();
  }
  // The text of a file of the kernel's, without the newline at its end; "" when it is not there.
  std::string Text(const std::filesystem::path& absolute) const;
  // From /etc/passwd and /etc/group below the root.
  Result<Account> FindAccount(const std::string& name) const;
  std::string UserName(uid_t uid) const;   // its number when it has none
  std::string GroupName(gid_t gid) const;  // the same
  // "1234 (firefox)" for every process that has the file open.
  std::vector<std::string> HoldersOf(const std::filesystem::path& absolute) const;
  // Processes by the name that the kernel has for them (15 characters of it).
  std::vector<pid_t> Processes(const std::string& name) const;
};

// What a program prints, at most 256 kB of it; ended when it has not ended in time (kTemporary).
Result<std::string> RunProgram(const std::vector<std::string>& words, Nanoseconds timeout);

// This machine.
Machine RealMachine();
// Who calls.
Account CallingAccount();
bool MayOpen(const Account& account, const FileNode& node, bool write = true);
// "crw-rw---- root:plugdev"
std::string DescribeNode(const Machine& machine, const FileNode& node);

}  // namespace omnihdr::doctor
