#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace omnihdr::kernel {

// A GPIO chip of the kernel's gpio-sim: its device is /dev/gpiochipN, and what lies outside a chip,
// voltages on its inputs and lamps at its outputs, is in /sys. Needs the module, configfs and root.
class SimChip {
 public:
  // One line a name. What goes wrong is a test failure.
  SimChip(std::string label, const std::vector<std::string>& line_names);
  ~SimChip();
  SimChip(const SimChip&) = delete;
  SimChip& operator=(const SimChip&) = delete;

  const std::string& label() const { return label_; }
  const std::string& name() const { return name_; }  // "gpiochip0"
  // The voltage on an input line.
  void Pull(int line, bool high) const;
  // A pulse: up, then down.
  void Pulse(int line) const;
  bool IsHigh(int line) const;
  // Takes the chip away, and brings it back.
  void Remove();
  void Return();

 private:
  std::filesystem::path Line(int line, const std::string& attribute) const;

  const std::string label_;
  std::filesystem::path config_;
  std::vector<std::filesystem::path> folders_;  // of configfs, in the order in which they were made
  std::string name_;
  std::filesystem::path lines_;
};

}  // namespace omnihdr::kernel
