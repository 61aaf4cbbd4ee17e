#include "drivers/gpio/inputs.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include "drivers/trigger/odometer_trigger.h"
#include "tests/drivers/gpio/fake_lines.h"

namespace omnihdr::inputs_test {
namespace {

using ::testing::HasSubstr;
using testing_gpio::Eventually;
using testing_gpio::FakeChip;
using testing_gpio::FakeLines;

gpio::InputsOptions Both() {
  gpio::InputsOptions options;
  options.trigger.name = {"chip", "button"};
  options.wheel.name = {"chip", "wheel"};
  options.pulses_per_metre = 10.0;
  options.reconnect_s = 0.1;
  return options;
}

struct Bench {
  explicit Bench(const gpio::InputsOptions& options)
      : inputs(options, std::make_unique<FakeLines>(chip), clock) {}
  gpio::EdgeEvent Edge(std::uint64_t lost = 0, bool full = false) const {
    return {clock.Now(), true, lost, full};
  }
  // The next trigger; fails the test when there is none.
  TriggerEvent Next() {
    std::optional<TriggerEvent> event;
    EXPECT_TRUE(Eventually([&] {
      event = *inputs.trigger()->Poll();
      return event.has_value();
    }));
    return event.value_or(TriggerEvent{});
  }
  FakeChip chip;
  const SystemClock clock{};
  gpio::Inputs inputs;
};

TEST(GpioInputs, AnEdgeOfTheTriggerLineIsATriggerWithTheKernelsTime) {
  Bench bench(Both());
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(bench.inputs.trigger()->Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  const gpio::EdgeEvent edge = bench.Edge();
  bench.chip.Push("button", {edge});
  pollfd ready{bench.inputs.trigger()->fd(), POLLIN, 0};
  ASSERT_EQ(poll(&ready, 1, 5000), 1);
  EXPECT_EQ(bench.Next().time, edge.time);
  EXPECT_FALSE(*bench.inputs.trigger()->Poll());
}

TEST(GpioInputs, EdgesLostInTheKernelComeWithTheNextOneAndTheirReason) {
  Bench bench(Both());
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(bench.inputs.trigger()->Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  bench.chip.Push("button", {bench.Edge(), bench.Edge(4)});
  EXPECT_EQ(bench.Next().lost_before, 0U);
  const TriggerEvent counted = bench.Next();
  EXPECT_EQ(counted.lost_before, 4U);
  EXPECT_THAT(counted.lost_reason, HasSubstr("the kernel lost this edge"));
  bench.chip.Push("button", {bench.Edge(0, true), bench.Edge()});
  EXPECT_EQ(bench.Next().lost_before, 0U);
  const TriggerEvent doubtful = bench.Next();
  EXPECT_EQ(doubtful.lost_before, 1U);
  EXPECT_THAT(doubtful.lost_reason, HasSubstr("may be lost here, one or more"));
  EXPECT_EQ(bench.inputs.report().lost, 5U);
}

TEST(GpioInputs, MoreEdgesThanMayWaitAreLostWithTheirReason) {
  Bench bench(Both());
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(bench.inputs.trigger()->Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  const std::size_t most = gpio::EdgeTrigger::kMaxWaiting;
  bench.chip.Push("button", std::vector(most + 3, bench.Edge()));
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().messages == most + 3; }));
  for (std::size_t i = 0; i < most; ++i) EXPECT_EQ(bench.Next().lost_before, 0U);
  bench.chip.Push("button", {bench.Edge()});
  const TriggerEvent next = bench.Next();
  EXPECT_EQ(next.lost_before, 3U);
  EXPECT_THAT(next.lost_reason, HasSubstr("64 edges of the trigger line waited already"));
}

TEST(GpioInputs, LostEdgesThatNoEdgeTellsOfAreTakenOnce) {
  Bench bench(Both());
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(bench.inputs.trigger()->Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  const std::size_t most = gpio::EdgeTrigger::kMaxWaiting;
  bench.chip.Push("button", std::vector(most + 2, bench.Edge()));
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().messages == most + 2; }));
  for (std::size_t i = 0; i < most; ++i) bench.Next();
  const LostEvents lost = bench.inputs.trigger()->TakeLost();
  EXPECT_EQ(lost.count, 2U);
  EXPECT_THAT(lost.reason, HasSubstr("waited already"));
  EXPECT_EQ(bench.inputs.trigger()->TakeLost().count, 0U);
}

TEST(GpioInputs, EdgesWhileTheTriggerIsStoppedAreIgnored) {
  Bench bench(Both());
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  bench.chip.Push("button", {bench.Edge(5)});
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().messages == 1; }));
  ASSERT_TRUE(bench.inputs.trigger()->Start());
  bench.chip.Push("button", {bench.Edge()});
  EXPECT_EQ(bench.Next().lost_before, 0U);
}

TEST(GpioInputs, PulsesOfTheWheelAreMetresAndLostOnesCountAsWay) {
  gpio::InputsOptions options = Both();
  options.start_m = 100.0;
  Bench bench(options);
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  EXPECT_NEAR(*bench.inputs.wheel()->OdometerMetres(bench.clock.Now()), 100.0, 1e-9);
  bench.chip.Push("wheel", {bench.Edge(), bench.Edge(), bench.Edge(2)});
  ASSERT_TRUE(Eventually([&] { return bench.inputs.wheel()->pulses() == 5; }));
  EXPECT_NEAR(*bench.inputs.wheel()->OdometerMetres(bench.clock.Now()), 100.5, 1e-9);
  EXPECT_EQ(bench.inputs.wheel()->lost(), 2U);
  EXPECT_EQ(bench.inputs.wheel()->estimated(), 0U);
}

TEST(GpioInputs, PulsesThatAFullBufferLostAreEstimatedFromTheTrain) {
  Bench bench(Both());
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  const HostTime begin = bench.clock.Now();
  std::vector<gpio::EdgeEvent> train;
  for (int i = 0; i < 16; ++i) {
    train.push_back({begin + std::chrono::milliseconds(2 * (i + 1)), true, 0, i == 15});
  }
  train.push_back({begin + std::chrono::milliseconds(2 * 25), true, 0, false});
  bench.chip.Push("wheel", train);
  ASSERT_TRUE(Eventually([&] { return bench.inputs.wheel()->pulses() == 25; }));
  EXPECT_EQ(bench.inputs.wheel()->estimated(), 8U);
}

TEST(GpioInputs, MarksOnTheWheelsWayTrigger) {
  Bench bench(Both());
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  OdometerTriggerOptions marks;
  marks.distance_m = 0.5;
  OdometerTrigger trigger(marks, bench.inputs.wheel(), bench.clock);
  ASSERT_TRUE(trigger.Start());
  EXPECT_TRUE(trigger.Poll()->has_value());  // where it stands
  for (int i = 0; i < 12; ++i) {
    bench.chip.Push("wheel", {bench.Edge()});
    ASSERT_TRUE(Eventually(
        [&] { return bench.inputs.wheel()->pulses() == static_cast<std::uint64_t>(i + 1); }));
  }
  std::vector<double> places;
  while (const auto event = *trigger.Poll()) places.push_back(*event->odometer_m);
  EXPECT_EQ(places, (std::vector{0.5, 1.0}));
}

TEST(GpioInputs, ADebouncedLineAsksForBothEdgesUnlessTheKernelDebounces) {
  gpio::InputsOptions options = Both();
  options.trigger.debounce_s = 0.02;
  {
    Bench bench(options);
    ASSERT_TRUE(bench.inputs.Start());
    ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
    EXPECT_EQ(bench.chip.requests["button"].edge, gpio::Edge::kBoth);
    EXPECT_EQ(bench.chip.requests["wheel"].edge, gpio::Edge::kRising);
  }
  Bench bench(options);
  bench.chip.kernel_debounces = true;
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  EXPECT_EQ(bench.chip.requests["button"].edge, gpio::Edge::kRising);
  EXPECT_EQ(bench.chip.requests["button"].debounce, std::chrono::milliseconds(20));
}

TEST(GpioInputs, AChipThatComesLaterOrGoesAndReturnsIsOpenedAgain) {
  Bench bench(Both());
  bench.chip.present = false;
  ASSERT_TRUE(bench.inputs.Start());
  ASSERT_TRUE(bench.inputs.trigger()->Start());
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().errors > 0; }));
  ASSERT_TRUE(Eventually(
      [&] { return bench.inputs.report().problem.find("no such chip") != std::string::npos; }));
  {
    std::lock_guard lock(bench.chip.mutex);
    bench.chip.present = true;
  }
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  bench.chip.Break();
  ASSERT_TRUE(Eventually([&] { return !bench.inputs.report().up; }));
  {
    std::lock_guard lock(bench.chip.mutex);
    bench.chip.broken = false;
  }
  ASSERT_TRUE(Eventually([&] { return bench.inputs.report().up; }));
  bench.chip.Push("button", {bench.Edge()});
  bench.Next();
}

TEST(GpioInputs, OptionsOutOfRangeAreNamed) {
  gpio::InputsOptions options = Both();
  options.trigger.name.chip.clear();
  EXPECT_THAT(options.Validate().error().message, HasSubstr("trigger: chip: \"\""));
  options = Both();
  options.wheel.debounce_s = 2.0;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("wheel: debounce_s: 2"));
  options = Both();
  options.pulses_per_metre = 0.0;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("pulses_per_metre: 0"));
}

}  // namespace
}  // namespace omnihdr::inputs_test
