#include "tests/kernel/appliance.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <signal.h>

#include <fstream>

#include "daemon/api/client.h"

namespace omnihdr::kernel {

using integration::Eventually;

namespace {
constexpr int kModbusPort = 1502;
}

void ApplianceTest::Launch(const Setup& setup) {
  std::ofstream(path("c.toml")) << fmt::format(
      "[session]\ndirectory = \"sessions\"\nname = \"s\"\n[api]\nsocket = \"api.sock\"\n"
      "[storage]\nallow_root = true\nwarn_free_mb = 0\nstop_free_mb = 0\nwarn_minutes = 0\n"
      "[camera]\nreconnect_s = 0.2\nframe_timeout_s = 20.0\n"
      // The emulated head's sensors see no common world. And where a pulse on the camera's wire is
      // made at the camera and at the line one after the other, work that goes on in the background
      // pulls the two apart by more than frames and edges are paired over.
      "check_orientation = false\n{}\n[bracket]\n{}\n"
      "[trigger]\narmed_at_start = true\n{}\n"
      "[gpio.outputs]\nchip = \"{}\"\nready = \"ready-out\"\nfault = \"fault-out\"\n{}\n"
      "[modbus.server]\n{}\n[pipeline]\n{}\n",
      setup.camera, setup.exposures, setup.trigger.empty() ? TriggerLine() : setup.trigger,
      chip_.label(), setup.outputs,
      setup.modbus_server.empty() ? fmt::format("connection = \"tcp\"\nport = {}", kModbusPort)
                                  : setup.modbus_server,
      setup.pipeline);
  daemon_ = std::make_unique<integration::Program>(
      "omnihdrd", std::vector<std::string>{"--config", path("c.toml").string()}, path("log"));
}

void ApplianceTest::Start(const Setup& setup) {
  Launch(setup);
  ASSERT_TRUE(Becomes("armed")) << daemon_->Log();
  ASSERT_TRUE(LinksAreUp()) << daemon_->Log();
}

std::string ApplianceTest::TriggerLine() const {
  return fmt::format("source = \"gpio\"\n[gpio.trigger]\nchip = \"{}\"\nline = \"trigger-in\"",
                     chip_.label());
}

bool ApplianceTest::LinksAreUp() const {
  return StatusHolds([](const auto& s) {
    for (const auto& link : s["links"]) {
      if (!link["up"].template get<bool>()) return false;
    }
    return s["links"].size() >= 2;
  });
}

void ApplianceTest::Stop() {
  daemon_->Signal(SIGTERM);
  EXPECT_EQ(daemon_->Wait(), 0) << daemon_->Log();
  EXPECT_FALSE(chip_.IsHigh(kReady));
  EXPECT_FALSE(chip_.IsHigh(kFault));
}

bool ApplianceTest::StatusHolds(const std::function<bool(const nlohmann::json&)>& holds) const {
  return Eventually([&] {
    ApiClient client(path("api.sock"));
    const auto status = client.Get("/v1/status");
    return status && holds(*status);
  });
}

bool ApplianceTest::Becomes(const std::string& state) const {
  return StatusHolds([&](const auto& s) { return s["state"] == state; });
}

bool ApplianceTest::Shoot() {
  ++edges_;
  chip_.Pulse(kTrigger);
  return Answered();
}

bool ApplianceTest::Answered() const {
  return StatusHolds([this](const auto& s) {
    return s["triggers"]["accepted"] == edges_ && s["triggers"]["in_flight"] == 0;
  });
}

std::vector<FrameRecord> ApplianceTest::Journal() const {
  auto contents = ReadSession(path("sessions") / "s");
  EXPECT_TRUE(contents) << contents.error().message;
  return contents ? contents->journal.frames : std::vector<FrameRecord>{};
}

void ApplianceTest::UnplugInABracket(
    const Cable& cable, const std::array<double, 2>& ladder,
    const std::function<void(const FrameRecord&, double)>& expect_frame) {
  ASSERT_TRUE(Shoot());
  ASSERT_TRUE(Shoot());
  cable.before_the_third();
  ++edges_;
  chip_.Pulse(kTrigger);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 1; }));
  cable.unplug();
  ASSERT_TRUE(Becomes("waiting-for-camera")) << daemon_->Log();
  EXPECT_TRUE(Eventually([&] { return ReadModbus(cable.master)[kState] == kWaitingForCamera; }));
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kFault) && !chip_.IsHigh(kReady); }));
  ASSERT_TRUE(Answered());
  cable.plug_in();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }))
      << daemon_->Log();
  EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kReady); }));
  ASSERT_TRUE(Shoot());
  ASSERT_TRUE(Shoot());
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 5U);
  for (const std::size_t i : {0U, 1U}) {
    expect_frame(journal[i], ladder[i]);
    expect_frame(journal[3 + i], ladder[i]);
  }
  EXPECT_EQ(journal[2].status, FrameStatus::kCameraTimeout);
  EXPECT_THAT(journal[2].detail, ::testing::HasSubstr("the camera has gone"));
  EXPECT_TRUE(journal[2].file.empty());
}

void ApplianceTest::OutrunTheCamera(
    std::size_t edges, const std::function<void(const FrameRecord&, std::size_t)>& expect_frame) {
  // As fast as they are taken. Faster ones the kernel itself would take for one (see gpio_test.cc).
  while (edges_ < edges) {
    ++edges_;
    chip_.Pulse(kTrigger);
    ASSERT_TRUE(StatusHolds([&](const auto& s) { return s["triggers"]["accepted"] == edges_; }))
        << daemon_->Log();
  }
  ASSERT_TRUE(Answered()) << daemon_->Log();
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), edges);
  std::uint32_t taken = 0;
  HostTime before;
  for (std::size_t i = 0; i < journal.size(); ++i) {
    EXPECT_EQ(Value(journal[i].frame), i);
    EXPECT_GT(journal[i].trigger_time, before);
    before = journal[i].trigger_time;
    if (journal[i].status == FrameStatus::kOk) {
      ++taken;
      expect_frame(journal[i], i);
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
}

modbus::Endpoint ApplianceTest::TcpEndpoint() {
  modbus::Endpoint endpoint;
  endpoint.port = kModbusPort;
  return endpoint;
}

ApplianceTest::Registers ApplianceTest::ReadModbus(const modbus::Endpoint& endpoint) {
  modbus::Client client(endpoint);
  Registers registers{};
  Status read = client.Open(std::chrono::seconds(10));
  if (read) read = client.Read(modbus::Table::kInput, 0, registers);
  EXPECT_TRUE(read) << read.error().message;
  return registers;
}

}  // namespace omnihdr::kernel
