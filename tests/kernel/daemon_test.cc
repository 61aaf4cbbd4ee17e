// omnihdrd as on a vehicle: a camera on the kernel's USB, a trigger and lamps on the kernel's GPIO,
// a Modbus master that watches.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <array>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>

#include "core/image/image_io.h"
#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "drivers/modbus/connection.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/iidc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/integration/programs.h"
#include "tests/kernel/sim_chip.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::daemon_test {
namespace {

using integration::Eventually;
using integration::Program;
using ::testing::HasSubstr;

constexpr int kTrigger = 0;
constexpr int kReady = 1;
constexpr int kFault = 2;
constexpr int kWheel = 3;
constexpr int kModbusPort = 1502;

// Registers of drivers/modbus/README.md.
constexpr std::size_t kMapVersion = 0;
constexpr std::size_t kState = 1;
constexpr std::size_t kTriggers = 4;
constexpr std::size_t kRecorded = 6;
constexpr std::size_t kLost = 8;
constexpr std::size_t kOdometerMm = 16;
constexpr std::uint16_t kWaitingForCamera = 1;
constexpr std::uint16_t kArmed = 3;

class Appliance : public ::testing::Test {
 protected:
  // With the exposures of a bracket and what triggers.
  void Launch(const std::string& exposures, const std::string& trigger) {
    const emulators::IidcDeviceOptions& device = device_->options();
    std::ofstream(path("head.toml"))
        << emulators::EmulatedRig(6, device.max_width, device.rows_per_sensor, device.bayer);
    std::ofstream(path("c.toml")) << fmt::format(
        "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
        "[camera]\ndriver = \"iidc\"\nreconnect_s = 0.2\nframe_timeout_s = 20.0\n"
        "[camera.iidc]\nrig = \"head.toml\"\n[bracket]\nexposures_s = {}\n"
        "[trigger]\narmed_at_start = true\n{}\n"
        "[gpio.outputs]\nchip = \"{}\"\nready = \"ready-out\"\nfault = \"fault-out\"\n"
        "[modbus.server]\nconnection = \"tcp\"\nport = {}\n[pipeline]\nenabled = false\n",
        exposures, trigger, chip_.label(), kModbusPort);
    daemon_ = std::make_unique<Program>(
        "omnihdrd", std::vector<std::string>{"--config", path("c.toml").string()}, path("log"));
  }
  // Triggered by the edges of a line, and ready.
  void Start(const std::string& exposures) {
    Launch(exposures, TriggerLine());
    ASSERT_TRUE(Becomes("armed")) << daemon_->Log();
    ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
  }
  std::string TriggerLine() const {
    return fmt::format("source = \"gpio\"\n[gpio.trigger]\nchip = \"{}\"\nline = \"trigger-in\"",
                       chip_.label());
  }
  bool LinksAreUp() const {
    return StatusHolds([](const auto& s) {
      for (const auto& link : s["links"]) {
        if (!link["up"].template get<bool>()) return false;
      }
      return s["links"].size() >= 2;
    });
  }
  void Stop() {
    daemon_->Signal(SIGTERM);
    EXPECT_EQ(daemon_->Wait(), 0) << daemon_->Log();
    EXPECT_FALSE(chip_.IsHigh(kReady));
    EXPECT_FALSE(chip_.IsHigh(kFault));
  }

  std::filesystem::path path(const std::string& name) const { return directory_.path() / name; }
  bool StatusHolds(const std::function<bool(const nlohmann::json&)>& holds) const {
    return Eventually([&] {
      ApiClient client(path("api.sock"));
      const auto status = client.Get("/v1/status");
      return status && holds(*status);
    });
  }
  bool Becomes(const std::string& state) const {
    return StatusHolds([&](const auto& s) { return s["state"] == state; });
  }
  // An edge, and its line in the journal.
  bool Shoot() {
    ++edges_;
    chip_.Pulse(kTrigger);
    return Answered();
  }
  // Every edge so far has been taken for a trigger, and every trigger has been answered.
  bool Answered() const {
    return StatusHolds([this](const auto& s) {
      return s["triggers"]["accepted"] == edges_ && s["triggers"]["in_flight"] == 0;
    });
  }
  std::vector<FrameRecord> Journal() const {
    auto contents = ReadSession(path("sessions") / "s");
    EXPECT_TRUE(contents) << contents.error().message;
    return contents ? contents->journal.frames : std::vector<FrameRecord>{};
  }
  // A good frame: its exposure, proved by itself, and pixels of that exposure.
  void ExpectFrame(const FrameRecord& record, double exposure_s) const {
    ASSERT_EQ(record.status, FrameStatus::kOk) << record.detail;
    EXPECT_EQ(record.proof, ExposureProof::kEmbedded);
    const double seconds = record.exposure.time.seconds();
    EXPECT_NEAR(seconds / exposure_s, 1.0, 0.01);
    const auto image = ReadImage(path("sessions") / "s" / record.file);
    ASSERT_TRUE(image) << image.error().message;
    EXPECT_EQ(std::get<Image<std::uint8_t>>(image->pixels).at(20, 100),
              device_->PixelAt(20, 100, seconds, 0.0));
  }

  // What a Modbus master sees.
  using Registers = std::array<std::uint16_t, 20>;
  static Registers ReadModbus() {
    modbus::Endpoint endpoint;
    endpoint.port = kModbusPort;
    modbus::Client client(endpoint);
    Registers registers{};
    Status read = client.Open(std::chrono::seconds(10));
    if (read) read = client.Read(modbus::Table::kInput, 0, registers);
    EXPECT_TRUE(read) << read.error().message;
    return registers;
  }
  static std::uint32_t Long(const Registers& registers, std::size_t at) {
    return std::uint32_t{registers[at]} << 16 | registers[at + 1];
  }

  const SystemClock clock_;
  testing::TemporaryDirectory directory_;
  kernel::SimChip chip_{"vehicle", {"trigger-in", "ready-out", "fault-out", "wheel-in"}};
  std::shared_ptr<emulators::IidcDevice> device_ =
      std::make_shared<emulators::IidcDevice>(emulators::IidcDeviceOptions{}, clock_);
  emulators::VhciUsb plug_{std::make_shared<emulators::IidcUsbFunction>(device_)};
  std::unique_ptr<Program> daemon_;
  std::uint64_t edges_ = 0;
};

TEST_F(Appliance, ABracketIsRecordedEdgeByEdgeAndAMasterReadsAlong) {
  Start("[0.001, 0.004, 0.016]");
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kReady); }));
  EXPECT_FALSE(chip_.IsHigh(kFault));
  std::vector<HostTime> around = {clock_.Now()};
  for (std::uint32_t i = 0; i < 6; ++i) {
    ASSERT_TRUE(Shoot()) << daemon_->Log();
    around.push_back(clock_.Now());
    Registers seen{};
    EXPECT_TRUE(Eventually([&] { return Long(seen = ReadModbus(), kRecorded) == i + 1; }));
    EXPECT_EQ(seen[kMapVersion], 1);
    EXPECT_EQ(seen[kState], kArmed);
    EXPECT_EQ(Long(seen, kTriggers), i + 1);
    EXPECT_EQ(Long(seen, kLost), 0U);
  }
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 6U);
  const double ladder[] = {0.001, 0.004, 0.016};
  for (std::size_t i = 0; i < journal.size(); ++i) {
    ExpectFrame(journal[i], ladder[i % 3]);
    // The kernel's time of the edge, on the clock of this machine; the exposure after it.
    EXPECT_GE(journal[i].trigger_time, around[i]);
    EXPECT_LE(journal[i].trigger_time, around[i + 1]);
    EXPECT_GE(journal[i].timestamp, journal[i].trigger_time);
    EXPECT_LE(journal[i].timestamp, around[i + 1]);
  }
  const auto contents = ReadSession(path("sessions") / "s");
  ASSERT_TRUE(contents);
  EXPECT_EQ(contents->info.camera.model, "Six-Eyed Test Head");
  Stop();
}

TEST_F(Appliance, UnpluggedInTheMiddleOfABracketItGoesOnWhenTheCameraReturns) {
  Start("[0.001, 0.004, 4.0]");
  ASSERT_TRUE(Shoot());
  ASSERT_TRUE(Shoot());
  ++edges_;
  chip_.Pulse(kTrigger);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 1; }));
  plug_.Unplug();
  ASSERT_TRUE(Becomes("waiting-for-camera")) << daemon_->Log();
  EXPECT_TRUE(Eventually([&] { return ReadModbus()[kState] == kWaitingForCamera; }));
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kFault) && !chip_.IsHigh(kReady); }));
  ASSERT_TRUE(Answered());
  plug_.PlugIn();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }))
      << daemon_->Log();
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kReady); }));
  ASSERT_TRUE(Shoot());
  ASSERT_TRUE(Shoot());
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 5U);
  ExpectFrame(journal[0], 0.001);
  ExpectFrame(journal[1], 0.004);
  EXPECT_EQ(journal[2].status, FrameStatus::kCameraTimeout);
  EXPECT_THAT(journal[2].detail, HasSubstr("the camera has gone"));
  EXPECT_TRUE(journal[2].file.empty());
  ExpectFrame(journal[3], 0.001);
  ExpectFrame(journal[4], 0.004);
  Stop();
}

TEST_F(Appliance, EdgesFasterThanTheCameraAreAllInTheJournal) {
  Start("[0.001, 0.004, 1.0]");
  // As fast as they are taken. Faster ones the kernel itself would take for one (see gpio_test.cc).
  constexpr std::size_t kEdges = 60;
  while (edges_ < kEdges) {
    ++edges_;
    chip_.Pulse(kTrigger);
    ASSERT_TRUE(StatusHolds([&](const auto& s) { return s["triggers"]["accepted"] == edges_; }))
        << daemon_->Log();
  }
  ASSERT_TRUE(Answered()) << daemon_->Log();
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), kEdges);
  const double ladder[] = {0.001, 0.004, 1.0};
  std::uint32_t taken = 0;
  HostTime before;
  for (std::size_t i = 0; i < journal.size(); ++i) {
    EXPECT_EQ(Value(journal[i].frame), i);
    EXPECT_GT(journal[i].trigger_time, before);
    before = journal[i].trigger_time;
    if (journal[i].status == FrameStatus::kOk) {
      ++taken;
      ExpectFrame(journal[i], ladder[i % 3]);
    } else {
      EXPECT_EQ(journal[i].status, FrameStatus::kMissedTrigger) << journal[i].detail;
      EXPECT_FALSE(journal[i].detail.empty());
      EXPECT_TRUE(journal[i].file.empty());
    }
  }
  EXPECT_GT(taken, 0U);
  EXPECT_LT(taken, journal.size());
  const auto lost = static_cast<std::uint32_t>(journal.size()) - taken;
  EXPECT_TRUE(Eventually([&] { return Long(ReadModbus(), kLost) == lost; }));
  EXPECT_EQ(Long(ReadModbus(), kRecorded), taken);
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kFault); }));
  Stop();
}

TEST_F(Appliance, ACameraAndAChipThatComeAfterItAreFound) {
  plug_.Unplug();
  chip_.Remove();
  Launch("[0.001, 0.004, 0.016]", TriggerLine());
  ASSERT_TRUE(Becomes("waiting-for-camera")) << daemon_->Log();
  plug_.PlugIn();
  chip_.Return();
  ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
  ASSERT_TRUE(Becomes("armed")) << daemon_->Log();
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kReady); }));
  ASSERT_TRUE(Shoot());
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 1U);
  ExpectFrame(journal[0], 0.001);
  Stop();
}

TEST_F(Appliance, PulsesOfAWheelAreWayAndMarksOnItAreFrames) {
  Launch("[0.001, 0.004, 0.016]",
         fmt::format("source = \"distance\"\nodometer = \"wheel\"\ndistance_m = 0.0625\n"
                     "[gpio.wheel]\nchip = \"{}\"\nline = \"wheel-in\"\nedge = \"both\"\n"
                     "pulses_per_metre = 64.0",
                     chip_.label()));
  ASSERT_TRUE(Becomes("armed")) << daemon_->Log();
  ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
  edges_ = 1;  // where it stands, which may have been told before the camera was there
  ASSERT_TRUE(Answered()) << daemon_->Log();
  // Numbers that are exact, so that a mark is passed with a pulse and not with the next one.
  for (int pulse = 1; pulse <= 24; ++pulse) {
    chip_.Pull(kWheel, pulse % 2 == 1);
    if (pulse % 4 == 0) ++edges_;
    ASSERT_TRUE(StatusHolds([&](const auto& s) { return s["odometer_m"] == pulse / 64.0; }))
        << "pulse " << pulse;
    ASSERT_TRUE(Answered()) << "pulse " << pulse << "\n" << daemon_->Log();
  }
  EXPECT_TRUE(Eventually([] { return Long(ReadModbus(), kOdometerMm) == 375; }));
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 7U);
  const double ladder[] = {0.001, 0.004, 0.016};
  for (std::size_t i = 0; i < journal.size(); ++i) {
    if (i == 0 && journal[i].status == FrameStatus::kMissedTrigger) {
      EXPECT_THAT(journal[i].detail, HasSubstr("no camera"));
    } else {
      ExpectFrame(journal[i], ladder[i % 3]);
    }
    ASSERT_TRUE(journal[i].odometer_m);
    EXPECT_EQ(*journal[i].odometer_m, 0.0625 * static_cast<double>(i));
  }
  Stop();
}

}  // namespace
}  // namespace omnihdr::daemon_test
