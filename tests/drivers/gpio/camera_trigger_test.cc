#include "drivers/gpio/camera_trigger.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/drivers/gpio/fake_lines.h"

namespace omnihdr::camera_trigger_test {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing_gpio::Eventually;
using testing_gpio::FakeChip;
using testing_gpio::FakeLines;

constexpr Nanoseconds kPatience = std::chrono::seconds(5);

gpio::CameraTriggerOptions Options() {
  gpio::CameraTriggerOptions options;
  options.name = {"chip", "shutter"};
  options.pulse_s = 0.01;
  options.spacing_s = 0.1;
  options.reconnect_s = 0.05;
  return options;
}

struct Bench {
  explicit Bench(const gpio::CameraTriggerOptions& options = Options())
      : trigger(std::make_unique<gpio::CameraTrigger>(options, std::make_unique<FakeLines>(chip),
                                                      clock)) {}
  void Open() {
    ASSERT_TRUE(trigger->Start());
    ASSERT_TRUE(Eventually([&] { return trigger->report().up; }));
  }
  FakeChip chip;
  const SystemClock clock{};
  std::unique_ptr<gpio::CameraTrigger> trigger;
};

TEST(CameraTrigger, APulseBeginsAtOnceSaysWhenAndEndsByItself) {
  Bench bench;
  ASSERT_NO_FATAL_FAILURE(bench.Open());
  const HostTime before = bench.clock.Now();
  const auto moment = bench.trigger->Release(Nanoseconds(0));
  ASSERT_TRUE(moment) << moment.error().message;
  EXPECT_GE(moment->before, before);
  EXPECT_GE(moment->after, moment->before);
  EXPECT_LE(moment->after, bench.clock.Now());
  ASSERT_TRUE(Eventually([&] { return bench.chip.Values("shutter").size() == 2; }));
  EXPECT_GE(bench.clock.Now() - moment->after, milliseconds(10));
  EXPECT_THAT(bench.chip.Values("shutter"), ElementsAre(true, false));
  EXPECT_EQ(bench.trigger->report().messages, 1U);
}

TEST(CameraTrigger, PulsesKeepTheirSpacingWhetherTheyAreWaitedForOrRefused) {
  Bench bench;
  ASSERT_NO_FATAL_FAILURE(bench.Open());
  const auto first = bench.trigger->Release(Nanoseconds(0));
  ASSERT_TRUE(first);
  const auto refused = bench.trigger->Release(Nanoseconds(0));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kTemporary);
  EXPECT_THAT(refused.error().message, HasSubstr("less than 0.1 s ago"));
  HostTime last = first->after;
  for (int i = 0; i < 3; ++i) {
    const auto next = bench.trigger->Release(kPatience);
    ASSERT_TRUE(next) << next.error().message;
    EXPECT_GE(next->after - last, bench.trigger->spacing());
    last = next->after;
  }
  EXPECT_TRUE(Eventually([&] { return bench.chip.Values("shutter").size() == 8; }));
  EXPECT_THAT(bench.chip.Values("shutter"),
              ElementsAre(true, false, true, false, true, false, true, false));
  EXPECT_EQ(bench.trigger->report().lost, 1U);
}

TEST(CameraTrigger, WithoutItsLineNoPulseIsGivenAndTheReasonIsTold) {
  Bench bench;
  bench.chip.present = false;
  EXPECT_EQ(bench.trigger->Release(kPatience).error().kind, ErrorKind::kUnavailable);
  ASSERT_TRUE(bench.trigger->Start());
  ASSERT_TRUE(Eventually([&] { return bench.trigger->report().errors > 0; }));
  const auto absent = bench.trigger->Release(kPatience);
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(absent.error().message, HasSubstr("chip line shutter is not open"));
  EXPECT_THAT(absent.error().message, HasSubstr("no such chip or line"));
  {
    std::lock_guard lock(bench.chip.mutex);
    bench.chip.present = true;
  }
  ASSERT_TRUE(Eventually([&] { return bench.trigger->report().up; }));
  EXPECT_TRUE(bench.trigger->Release(kPatience));
}

TEST(CameraTrigger, AChipThatGoesIsToldAndOpenedAgain) {
  Bench bench;
  ASSERT_NO_FATAL_FAILURE(bench.Open());
  bench.chip.Break();
  EXPECT_EQ(bench.trigger->Release(kPatience).error().kind, ErrorKind::kUnavailable);
  {
    std::lock_guard lock(bench.chip.mutex);
    bench.chip.broken = false;
  }
  ASSERT_TRUE(Eventually([&] { return bench.trigger->report().up; }));
  EXPECT_EQ(bench.trigger->report().opened, 2U);
  EXPECT_TRUE(bench.trigger->Release(kPatience));
}

TEST(CameraTrigger, TheLineIsInactiveAtTheEndEvenInThePulse) {
  gpio::CameraTriggerOptions options = Options();
  options.pulse_s = 1.0;
  options.spacing_s = 2.0;
  Bench bench(options);
  ASSERT_NO_FATAL_FAILURE(bench.Open());
  ASSERT_TRUE(bench.trigger->Release(Nanoseconds(0)));
  bench.trigger.reset();
  EXPECT_FALSE(bench.chip.Values("shutter").back());
}

TEST(CameraTrigger, APulseThatIsNotShorterThanTheSpacingIsRefused) {
  gpio::CameraTriggerOptions options = Options();
  options.pulse_s = options.spacing_s;
  EXPECT_THAT(options.Validate().error().message,
              HasSubstr("camera_trigger_spacing_s: 0.1: expected more than the pulse"));
  options = Options();
  options.name.chip.clear();
  EXPECT_THAT(options.Validate().error().message, HasSubstr("outputs.chip"));
}

}  // namespace
}  // namespace omnihdr::camera_trigger_test
