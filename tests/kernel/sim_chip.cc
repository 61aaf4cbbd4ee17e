#include "tests/kernel/sim_chip.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <fstream>
#include <utility>

namespace omnihdr::kernel {
namespace {

namespace fs = std::filesystem;

constexpr const char* kConfig = "/sys/kernel/config/gpio-sim";

void Write(const fs::path& path, const std::string& text) {
  std::ofstream file(path);
  file << text << std::flush;
  EXPECT_TRUE(file.good()) << path << ": cannot write " << text;
}

std::string ReadWord(const fs::path& path) {
  std::string word;
  std::ifstream(path) >> word;
  EXPECT_FALSE(word.empty()) << path;
  return word;
}

}  // namespace

SimChip::SimChip(std::string label, const std::vector<std::string>& line_names)
    : label_(std::move(label)), config_(fs::path(kConfig) / label_) {
  const auto make = [this](const fs::path& folder) {
    std::error_code error;
    fs::create_directory(folder, error);
    EXPECT_FALSE(error) << folder << ": " << error.message();
    folders_.push_back(folder);
  };
  make(config_);
  const fs::path bank = config_ / "bank0";
  make(bank);
  Write(bank / "num_lines", fmt::format("{}", line_names.size()));
  Write(bank / "label", label_);
  for (std::size_t i = 0; i < line_names.size(); ++i) {
    const fs::path line = bank / fmt::format("line{}", i);
    make(line);
    Write(line / "name", line_names[i]);
  }
  Return();
}

SimChip::~SimChip() {
  if (!name_.empty()) Remove();
  for (auto folder = folders_.rbegin(); folder != folders_.rend(); ++folder) {
    std::error_code error;
    fs::remove(*folder, error);
    EXPECT_FALSE(error) << *folder << ": " << error.message();
  }
}

void SimChip::Remove() {
  Write(config_ / "live", "0");
  name_.clear();
}

void SimChip::Return() {
  Write(config_ / "live", "1");
  name_ = ReadWord(config_ / "bank0" / "chip_name");
  lines_ = fs::path("/sys/devices/platform") / ReadWord(config_ / "dev_name") / name_;
}

fs::path SimChip::Line(int line, const std::string& attribute) const {
  return lines_ / fmt::format("sim_gpio{}", line) / attribute;
}

void SimChip::Pull(int line, bool high) const {
  Write(Line(line, "pull"), high ? "pull-up" : "pull-down");
}

void SimChip::Pulse(int line) const {
  Pull(line, true);
  Pull(line, false);
}

bool SimChip::IsHigh(int line) const { return ReadWord(Line(line, "value")) == "1"; }

}  // namespace omnihdr::kernel
