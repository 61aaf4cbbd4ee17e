#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace omnihdr::integration {

// One of our programs ("omnihdrd", "omnihdr"), or any by its absolute path, as a child process;
// killed by the destructor.
class Program {
 public:
  // Standard output and error go to `log`, appended. `environment` is added to ours ("NAME=value").
  Program(const std::string& name, const std::vector<std::string>& arguments,
          std::filesystem::path log, const std::vector<std::string>& environment = {});
  ~Program();
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  pid_t pid() const { return pid_; }
  void Signal(int signal) const;
  bool running();
  // The exit code; 128 + signal when it was killed; -1 when it has not ended within `timeout` (it
  // is killed then).
  int Wait(std::chrono::seconds timeout = std::chrono::seconds(60));
  // Limits the size of files the program may write from now on, in bytes; 0 = no limit.
  void LimitFileSize(std::uint64_t bytes) const;
  std::string Log() const;

 private:
  pid_t pid_ = -1;
  bool ended_ = false;
  int exit_code_ = -1;
  std::filesystem::path log_;
};

// Runs `omnihdr` to its end: exit code and output.
std::pair<int, std::string> RunOmnihdr(const std::vector<std::string>& arguments,
                                       const std::filesystem::path& directory);

// Tries again every few milliseconds until it holds or the time is over.
bool Eventually(const std::function<bool()>& holds,
                std::chrono::seconds timeout = std::chrono::seconds(60));

// Every regular file below a directory, by its relative path.
std::map<std::string, std::string> FilesBelow(const std::filesystem::path& directory);

}  // namespace omnihdr::integration
