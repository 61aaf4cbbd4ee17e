// Every state of the appliance as each of its surfaces shows it: API, command line, metrics, lamps,
// Modbus.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <set>
#include <string>

#include "core/capture/appliance.h"
#include "core/capture/capture_state.h"
#include "daemon/api/status.h"
#include "drivers/gpio/outputs.h"
#include "drivers/modbus/responder.h"
#include "tests/drivers/gpio/fake_lines.h"

namespace omnihdr::state_surfaces_test {
namespace {

using ::testing::HasSubstr;

struct Row {
  CaptureState state;
  CaptureConditions conditions;
  bool ready;  // the lamps
  bool fault;
};

std::array<Row, kCaptureStateCount> AllStates() {
  CaptureConditions armed;
  armed.started = true;
  armed.camera_ready = true;
  armed.armed = true;
  CaptureConditions waiting = armed;
  waiting.camera_ready = false;
  waiting.waiting = "no camera is \"plugged in\"";
  CaptureConditions idle = armed;
  idle.armed = false;
  CaptureConditions degraded = armed;
  degraded.links = "gnss: no answer";
  CaptureConditions full = armed;
  full.storage = "No space left on device";
  CaptureConditions fault = armed;
  fault.fault = "the camera's longest is 0.002 s";
  CaptureConditions stopping = armed;
  stopping.stopping = "asked to stop";
  CaptureConditions capturing = armed;
  capturing.capturing = true;
  return {{{CaptureState::kStarting, {}, false, false},
           {CaptureState::kWaitingForCamera, waiting, false, true},
           {CaptureState::kIdle, idle, false, false},
           {CaptureState::kArmed, armed, true, false},
           {CaptureState::kDegraded, degraded, true, true},
           {CaptureState::kStorageFull, full, false, true},
           {CaptureState::kFault, fault, false, true},
           {CaptureState::kStopping, stopping, false, false},
           {CaptureState::kCapturing, capturing, true, false}}};
}

// What a Modbus master reads: registers, function 4.
std::vector<std::uint16_t> Registers(modbus::Responder& responder, int first, int count) {
  std::array<std::uint8_t, modbus::kMaxPdu> answer{};
  const std::array<std::uint8_t, 5> request = {4, static_cast<std::uint8_t>(first >> 8),
                                               static_cast<std::uint8_t>(first & 0xFF), 0,
                                               static_cast<std::uint8_t>(count)};
  const std::size_t length = responder.Answer(request, answer);
  std::vector<std::uint16_t> registers;
  for (std::size_t i = 2; i + 1 < length; i += 2) {
    registers.push_back(static_cast<std::uint16_t>(answer[i] << 8 | answer[i + 1]));
  }
  return registers;
}

std::string Text(const std::vector<std::uint16_t>& registers) {
  std::string text;
  for (const std::uint16_t word : registers) {
    for (const int shift : {8, 0}) {
      const char letter = static_cast<char>(word >> shift & 0xFF);
      if (letter == 0) return text;
      text += letter;
    }
  }
  return text;
}

TEST(StateSurfaces, EveryStateIsTheSameWithItsReasonAndItsRemedyOnAllFiveSurfaces) {
  testing_gpio::FakeChip chip;
  gpio::OutputsOptions lamps;
  lamps.chip = "chip";
  lamps.ready = "green";
  lamps.fault = "red";
  const SystemClock clock;
  gpio::Outputs outputs(lamps, std::make_unique<testing_gpio::FakeLines>(chip), clock);
  ASSERT_TRUE(outputs.Start());
  ASSERT_TRUE(testing_gpio::Eventually([&] { return outputs.report().up; }));
  modbus::Responder responder({});
  std::set<std::string> names;
  for (const Row& row : AllStates()) {
    const StateReport report = EvaluateState(row.conditions);
    const std::string name(ToString(row.state));
    SCOPED_TRACE(name);
    ASSERT_EQ(report.state, row.state);
    ASSERT_FALSE(report.reason.empty());
    ASSERT_FALSE(report.remedy.empty());
    names.insert(name);

    StatusReport status;
    status.state = report;
    const nlohmann::json json = StatusToJson(status);  // API
    EXPECT_EQ(json["state"], name);
    EXPECT_EQ(json["reason"], report.reason);
    EXPECT_EQ(json["remedy"], report.remedy);

    const std::string people = StatusForPeople(json);  // omnihdr status
    EXPECT_THAT(people, HasSubstr(fmt::format("{} ({})", name, report.reason)));
    EXPECT_THAT(people, HasSubstr(report.remedy));

    const std::string metrics = StatusToMetrics(status);
    for (const Row& other : AllStates()) {
      EXPECT_THAT(metrics,
                  HasSubstr(fmt::format("omnihdr_state{{state=\"{}\"}} {}\n", ToString(other.state),
                                        other.state == row.state ? 1 : 0)));
    }
    std::string reason;
    for (const char c : report.reason) {
      if (c == '"') reason.push_back('\\');
      reason.push_back(c);
    }
    EXPECT_THAT(metrics, HasSubstr(fmt::format(
                             "omnihdr_state_info{{state=\"{}\",reason=\"{}\",remedy=\"{}\"}} 1\n",
                             name, reason, report.remedy)));

    ApplianceStatus shown;
    shown.state = report.state;
    shown.reason = report.reason;
    shown.remedy = report.remedy;
    outputs.Show(shown);  // lamps
    EXPECT_EQ(chip.Values("green").back(), row.ready);
    EXPECT_EQ(chip.Values("red").back(), row.fault);

    responder.Show(shown);  // Modbus
    EXPECT_EQ(Registers(responder, 1, 1).at(0), static_cast<std::uint16_t>(row.state));
    EXPECT_EQ(Registers(responder, 2, 1).at(0) >> 3 & 1, row.fault ? 1 : 0);
    EXPECT_EQ(Text(Registers(responder, 128, 64)), report.reason.substr(0, 128));
    EXPECT_EQ(Text(Registers(responder, 192, 64)), report.remedy.substr(0, 128));
  }
  EXPECT_EQ(names.size(), kCaptureStateCount) << "each state has a name of its own";
}

}  // namespace
}  // namespace omnihdr::state_surfaces_test
