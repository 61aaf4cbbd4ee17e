#include "tests/integration/programs.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <sstream>

#include "tests/support/eventually.h"

namespace omnihdr::integration {
namespace {

std::string Slurp(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

}  // namespace

Program::Program(const std::string& name, const std::vector<std::string>& arguments,
                 std::filesystem::path log, const std::vector<std::string>& environment)
    : log_(std::move(log)) {
  std::vector<std::string> words = {
      (std::filesystem::path(OMNIHDR_BINARY_DIR) / "bin" / name).string()};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<std::string> variables = environment;
  for (char** variable = environ; *variable != nullptr; ++variable) {
    variables.emplace_back(*variable);
  }
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::vector<char*> envp;
  for (std::string& variable : variables) envp.push_back(variable.data());
  envp.push_back(nullptr);

  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, log_.c_str(),
                                   O_WRONLY | O_CREAT | O_APPEND, 0644);
  posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
  const int error =
      ::posix_spawn(&pid_, words[0].c_str(), &actions, nullptr, argv.data(), envp.data());
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) {
    ADD_FAILURE() << words[0] << ": cannot be started, error " << error;
    ended_ = true;
  }
}

Program::~Program() {
  if (running()) {
    ::kill(pid_, SIGKILL);
    Wait();
  }
}

void Program::Signal(int signal) const {
  if (!ended_) ::kill(pid_, signal);
}

bool Program::running() {
  if (ended_) return false;
  int status = 0;
  if (::waitpid(pid_, &status, WNOHANG) != pid_) return true;
  ended_ = true;
  exit_code_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return false;
}

int Program::Wait(std::chrono::seconds timeout) {
  if (Eventually([this] { return !running(); }, timeout)) return exit_code_;
  ::kill(pid_, SIGKILL);
  int status = 0;
  ::waitpid(pid_, &status, 0);
  ended_ = true;
  return -1;
}

void Program::LimitFileSize(std::uint64_t bytes) const {
  rlimit limit{};
  limit.rlim_cur = bytes == 0 ? RLIM_INFINITY : bytes;
  limit.rlim_max = RLIM_INFINITY;
  EXPECT_EQ(::prlimit(pid_, RLIMIT_FSIZE, &limit, nullptr), 0);
}

std::string Program::Log() const { return Slurp(log_); }

std::pair<int, std::string> RunOmnihdr(const std::vector<std::string>& arguments,
                                       const std::filesystem::path& directory) {
  const std::filesystem::path log = directory / "omnihdr.out";
  std::filesystem::remove(log);
  Program program("omnihdr", arguments, log);
  const int code = program.Wait(std::chrono::seconds(120));
  return {code, Slurp(log)};
}

bool Eventually(const std::function<bool()>& holds, std::chrono::seconds timeout) {
  return testing::Eventually(holds, timeout);
}

std::map<std::string, std::string> FilesBelow(const std::filesystem::path& directory) {
  std::map<std::string, std::string> files;
  std::error_code error;
  for (std::filesystem::recursive_directory_iterator it(directory, error), end; !error && it != end;
       it.increment(error)) {
    if (it->is_regular_file()) {
      files[std::filesystem::relative(it->path(), directory).string()] = Slurp(it->path());
    }
  }
  return files;
}

}  // namespace omnihdr::integration
