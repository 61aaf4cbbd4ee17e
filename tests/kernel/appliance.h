#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/session/session_reader.h"
#include "drivers/modbus/connection.h"
#include "tests/integration/programs.h"
#include "tests/kernel/sim_chip.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::kernel {

// Lines of the vehicle's chip.
inline constexpr int kTrigger = 0;
inline constexpr int kReady = 1;
inline constexpr int kFault = 2;
inline constexpr int kWheel = 3;
inline constexpr int kCamera = 4;

// Registers of drivers/modbus/README.md.
inline constexpr std::size_t kMapVersion = 0;
inline constexpr std::size_t kState = 1;
inline constexpr std::size_t kTriggers = 4;
inline constexpr std::size_t kRecorded = 6;
inline constexpr std::size_t kLost = 8;
inline constexpr std::size_t kOdometerMm = 16;
inline constexpr std::uint16_t kWaitingForCamera = 1;
inline constexpr std::uint16_t kArmed = 3;
inline constexpr std::uint16_t kCapturing = 8;

// omnihdrd as on a vehicle: a trigger and lamps on the kernel's GPIO, a Modbus master that watches,
// and a camera that the test brings.
class ApplianceTest : public ::testing::Test {
 protected:
  // What a configuration has that differs from test to test.
  struct Setup {
    std::string camera;         // its sections, from the driver's name on
    std::string exposures;      // of the bracket, and what else belongs to it
    std::string trigger;        // empty: the edges of a line
    std::string modbus_server;  // empty: TCP
    std::string pipeline = "enabled = false\n";
    std::string outputs;  // further lines of [gpio.outputs]
  };
  void Launch(const Setup& setup);
  // Launched, and ready.
  void Start(const Setup& setup);
  void Stop();
  std::string TriggerLine() const;
  bool LinksAreUp() const;

  std::filesystem::path path(const std::string& name) const { return directory_.path() / name; }
  bool StatusHolds(const std::function<bool(const nlohmann::json&)>& holds) const;
  bool Becomes(const std::string& state) const;
  // An edge, and its line in the journal.
  bool Shoot();
  // Every edge so far has been taken for a trigger, and every trigger has been answered.
  bool Answered() const;
  std::vector<FrameRecord> Journal() const;
  // Gives `edges` edges, each as soon as the one before has been accepted; then waits until all are
  // answered. Every edge is a line of the journal, in order, and some are lost: the camera is
  // slower. `expect_frame` judges the good ones.
  void OutrunTheCamera(std::size_t edges,
                       const std::function<void(const FrameRecord&, std::size_t)>& expect_frame);

  // A camera is unplugged in the third exposure of a bracket, and comes back: the first two and two
  // more are frames of the exposures `ladder`, between them the third is a line without one.
  struct Cable {
    std::function<void()> unplug;
    std::function<void()> plug_in;
    std::function<void()> before_the_third = [] {};  // what makes it last as long as it takes
    modbus::Endpoint master = TcpEndpoint();         // who reads the state meanwhile
  };
  void UnplugInABracket(const Cable& cable, const std::array<double, 2>& ladder,
                        const std::function<void(const FrameRecord&, double)>& expect_frame);

  // What a Modbus master sees, by TCP unless another end of the line is given.
  using Registers = std::array<std::uint16_t, 20>;
  static Registers ReadModbus(const modbus::Endpoint& endpoint = TcpEndpoint());
  static modbus::Endpoint TcpEndpoint();
  static std::uint32_t Long(const Registers& registers, std::size_t at) {
    return std::uint32_t{registers[at]} << 16 | registers[at + 1];
  }

  const SystemClock clock_;
  testing::TemporaryDirectory directory_;
  SimChip chip_{"vehicle", {"trigger-in", "ready-out", "fault-out", "wheel-in", "camera-out"}};
  std::unique_ptr<integration::Program> daemon_;
  std::uint64_t edges_ = 0;
};

}  // namespace omnihdr::kernel
