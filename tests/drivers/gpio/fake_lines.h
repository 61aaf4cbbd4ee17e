#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "drivers/gpio/lines.h"
#include "tests/support/eventually.h"

namespace omnihdr::testing_gpio {

using testing::Eventually;

// A chip whose lines a test wiggles. Any thread; outlives the lines it gives.
struct FakeChip {
  std::mutex mutex;
  bool present = true;
  bool kernel_debounces = false;
  std::map<std::string, std::deque<gpio::EdgeEvent>> events;
  std::map<std::string, int> fds;
  std::map<std::string, gpio::EdgeRequest> requests;
  std::map<std::string, std::vector<bool>> outputs;  // every value set
  bool broken = false;                               // reading and setting fails

  void Push(const std::string& line, std::vector<gpio::EdgeEvent> more) {
    std::lock_guard lock(mutex);
    events[line].insert(events[line].end(), more.begin(), more.end());
    Signal(line);
  }
  void Break() {
    std::lock_guard lock(mutex);
    broken = true;
    for (const auto& each : fds) Signal(each.first);
  }
  bool Requested(const std::string& line) {
    std::lock_guard lock(mutex);
    return fds.contains(line);
  }
  std::vector<bool> Values(const std::string& line) {
    std::lock_guard lock(mutex);
    return outputs[line];
  }

 private:
  void Signal(const std::string& line) {
    const std::uint64_t one = 1;
    if (fds.contains(line)) {
      [[maybe_unused]] const ssize_t written = write(fds[line], &one, sizeof one);
    }
  }
};

class FakeEdgeLine final : public gpio::EdgeLine {
 public:
  FakeEdgeLine(FakeChip& chip, std::string name)
      : chip_(chip), name_(std::move(name)), fd_(eventfd(0, EFD_NONBLOCK)) {
    chip_.fds[name_] = fd_.get();
  }
  ~FakeEdgeLine() override {
    std::lock_guard lock(chip_.mutex);
    chip_.fds.erase(name_);
  }
  int fd() const override { return fd_.get(); }
  bool debounced() const override { return chip_.kernel_debounces; }
  Result<std::size_t> Read(std::span<gpio::EdgeEvent> events) override {
    std::lock_guard lock(chip_.mutex);
    if (chip_.broken) return Fail(ErrorKind::kUnavailable, "{}: the chip has gone", name_);
    std::deque<gpio::EdgeEvent>& waiting = chip_.events[name_];
    std::size_t count = 0;
    while (count < events.size() && !waiting.empty()) {
      events[count++] = waiting.front();
      waiting.pop_front();
    }
    std::uint64_t value = 0;
    if (waiting.empty()) {
      [[maybe_unused]] const ssize_t got = read(fd_.get(), &value, sizeof value);
    }
    return count;
  }

 private:
  FakeChip& chip_;
  const std::string name_;
  const Fd fd_;
};

class FakeOutputLine final : public gpio::OutputLine {
 public:
  FakeOutputLine(FakeChip& chip, std::string name) : chip_(chip), name_(std::move(name)) {}
  Status Set(bool active) override {
    std::lock_guard lock(chip_.mutex);
    if (chip_.broken) return Fail(ErrorKind::kUnavailable, "{}: the chip has gone", name_);
    chip_.outputs[name_].push_back(active);
    return {};
  }

 private:
  FakeChip& chip_;
  const std::string name_;
};

class FakeLines final : public gpio::Lines {
 public:
  explicit FakeLines(FakeChip& chip) : chip_(chip) {}
  std::string_view library() const override { return "fake"; }
  Result<std::unique_ptr<gpio::EdgeLine>> RequestEdges(const gpio::EdgeRequest& request) override {
    std::lock_guard lock(chip_.mutex);
    if (!chip_.present) return Fail(ErrorKind::kUnavailable, "there is no such chip or line");
    chip_.requests[request.name.line] = request;
    return std::make_unique<FakeEdgeLine>(chip_, request.name.line);
  }
  Result<std::unique_ptr<gpio::OutputLine>> RequestOutput(
      const gpio::OutputRequest& request) override {
    std::lock_guard lock(chip_.mutex);
    if (!chip_.present) return Fail(ErrorKind::kUnavailable, "there is no such chip or line");
    return std::make_unique<FakeOutputLine>(chip_, request.name.line);
  }

 private:
  FakeChip& chip_;
};

}  // namespace omnihdr::testing_gpio
