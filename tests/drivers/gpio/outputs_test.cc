#include "drivers/gpio/outputs.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/drivers/gpio/fake_lines.h"

namespace omnihdr::outputs_test {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing_gpio::Eventually;
using testing_gpio::FakeChip;
using testing_gpio::FakeLines;

gpio::OutputsOptions All() {
  gpio::OutputsOptions options;
  options.chip = "chip";
  options.ready = "green";
  options.busy = "yellow";
  options.fault = "red";
  options.strobe = "flash";
  options.strobe_s = 0.02;
  options.reconnect_s = 0.1;
  return options;
}

struct Bench {
  explicit Bench(const gpio::OutputsOptions& options)
      : outputs(
            std::make_unique<gpio::Outputs>(options, std::make_unique<FakeLines>(chip), clock)) {}
  void Show(CaptureState state, bool busy = false) {
    ApplianceStatus status;
    status.state = state;
    status.busy = busy;
    outputs->Show(status);
  }
  bool Last(const std::string& line) {
    const std::vector<bool> values = chip.Values(line);
    return !values.empty() && values.back();
  }
  FakeChip chip;
  const SystemClock clock{};
  std::unique_ptr<gpio::Outputs> outputs;
};

TEST(GpioOutputs, TheLampsShowTheState) {
  Bench bench(All());
  ASSERT_TRUE(bench.outputs->Start());
  ASSERT_TRUE(Eventually([&] { return bench.outputs->report().up; }));
  struct Row {
    CaptureState state;
    bool ready, fault;
  };
  for (const Row row : {Row{CaptureState::kStarting, false, false},
                        {CaptureState::kWaitingForCamera, false, true},
                        {CaptureState::kIdle, false, false},
                        {CaptureState::kArmed, true, false},
                        {CaptureState::kCapturing, true, false},
                        {CaptureState::kDegraded, true, true},
                        {CaptureState::kStorageFull, false, true},
                        {CaptureState::kFault, false, true},
                        {CaptureState::kStopping, false, false}}) {
    bench.Show(row.state, row.ready);
    EXPECT_EQ(bench.Last("green"), row.ready) << ToString(row.state);
    EXPECT_EQ(bench.Last("yellow"), row.ready) << ToString(row.state);
    EXPECT_EQ(bench.Last("red"), row.fault) << ToString(row.state);
  }
}

TEST(GpioOutputs, APulseLastsAsLongAsAskedAndASecondOneWaitsForItsEnd) {
  Bench bench(All());
  EXPECT_EQ(bench.outputs->Pulse().error().kind, ErrorKind::kUnavailable);
  ASSERT_TRUE(bench.outputs->Start());
  ASSERT_TRUE(Eventually([&] { return bench.outputs->report().up; }));
  const HostTime begin = bench.clock.Now();
  ASSERT_TRUE(bench.outputs->Pulse());
  EXPECT_THAT(bench.chip.Values("flash"), ElementsAre(true));
  EXPECT_EQ(bench.outputs->Pulse().error().kind, ErrorKind::kTemporary);
  ASSERT_TRUE(Eventually([&] { return bench.chip.Values("flash").size() == 2; }));
  EXPECT_GE((bench.clock.Now() - begin).count(), 20'000'000);
  EXPECT_FALSE(bench.Last("flash"));
  EXPECT_TRUE(bench.outputs->Pulse());
}

TEST(GpioOutputs, AllAreInactiveAtTheEndEvenInThePulse) {
  gpio::OutputsOptions options = All();
  options.strobe_s = 1.0;
  Bench bench(options);
  ASSERT_TRUE(bench.outputs->Start());
  ASSERT_TRUE(Eventually([&] { return bench.outputs->report().up; }));
  bench.Show(CaptureState::kDegraded, true);
  ASSERT_TRUE(bench.outputs->Pulse());
  bench.outputs.reset();
  for (const char* line : {"green", "yellow", "red", "flash"}) EXPECT_FALSE(bench.Last(line));
}

TEST(GpioOutputs, AChipThatComesLaterShowsWhatWasMeantAllAlong) {
  Bench bench(All());
  bench.chip.present = false;
  ASSERT_TRUE(bench.outputs->Start());
  bench.Show(CaptureState::kArmed);
  ASSERT_TRUE(Eventually([&] { return bench.outputs->report().errors > 0; }));
  EXPECT_THAT(bench.outputs->report().problem, HasSubstr("no such chip or line"));
  {
    std::lock_guard lock(bench.chip.mutex);
    bench.chip.present = true;
  }
  ASSERT_TRUE(Eventually([&] { return bench.Last("green"); }));
}

TEST(GpioOutputs, OneLineForTwoPurposesIsRefused) {
  gpio::OutputsOptions options = All();
  options.busy = "green";
  EXPECT_THAT(options.Validate().error().message, HasSubstr("line green twice"));
}

}  // namespace
}  // namespace omnihdr::outputs_test
