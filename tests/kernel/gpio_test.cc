// The GPIO driver on the kernel's own chips, through the real libgpiod.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include <array>
#include <chrono>
#include <memory>
#include <optional>
#include <thread>

#include "drivers/gpio/camera_trigger.h"
#include "drivers/gpio/inputs.h"
#include "drivers/gpio/lines.h"
#include "drivers/gpio/outputs.h"
#include "tests/integration/programs.h"
#include "tests/kernel/sim_chip.h"

namespace omnihdr::gpio_test {
namespace {

using integration::Eventually;
using kernel::SimChip;
using ::testing::HasSubstr;

constexpr int kTrigger = 0;
constexpr int kWheel = 1;
constexpr int kReady = 2;
constexpr int kBusy = 3;
constexpr int kFault = 4;
constexpr int kStrobe = 5;
constexpr int kCamera = 6;
constexpr int kPatienceMs = 30'000;

class SimulatedChip : public ::testing::Test {
 protected:
  gpio::EdgeRequest Trigger(gpio::Edge edge) const {
    gpio::EdgeRequest request;
    request.name = {chip_.label(), "trigger-in"};
    request.edge = edge;
    return request;
  }
  static bool Readable(const gpio::EdgeLine& line, int wait_ms) {
    pollfd ready{line.fd(), POLLIN, 0};
    return poll(&ready, 1, wait_ms) == 1;
  }
  // The next edge. Edges are waited for one by one: two that come before the kernel's interrupt
  // thread has run are one to it.
  static std::optional<gpio::EdgeEvent> Next(gpio::EdgeLine& line) {
    if (!Readable(line, kPatienceMs)) return std::nullopt;
    std::array<gpio::EdgeEvent, 1> event;
    const Result<std::size_t> got = line.Read(event);
    EXPECT_TRUE(got) << got.error().message;
    if (!got || *got != 1) return std::nullopt;
    return event[0];
  }
  gpio::InputsOptions InputOptions() const {
    gpio::InputsOptions options;
    options.trigger.name = {chip_.label(), "trigger-in"};
    options.wheel.name = {chip_.label(), "wheel-in"};
    options.wheel.edge = gpio::Edge::kBoth;
    options.reconnect_s = 0.1;
    return options;
  }

  const SystemClock clock_;
  SimChip chip_{
      "trigger-board",
      {"trigger-in", "wheel-in", "ready-out", "busy-out", "fault-out", "strobe-out", "camera-out"}};
  std::unique_ptr<gpio::Lines> lines_ = gpio::MakeLines();
};

TEST_F(SimulatedChip, ALineIsFoundByLabelOrNameOfItsChipAndByItsNameOrOffset) {
  for (const std::string& chip : {chip_.label(), chip_.name(), "/dev/" + chip_.name()}) {
    for (const char* line : {"trigger-in", "0"}) {
      gpio::EdgeRequest request;
      request.name = {chip, line};
      const auto edges = lines_->RequestEdges(request);
      EXPECT_TRUE(edges) << request.name.Text() << ": " << edges.error().message;
    }
  }
  gpio::EdgeRequest request;
  request.name = {chip_.label(), "no-such-line"};
  EXPECT_EQ(lines_->RequestEdges(request).error().kind, ErrorKind::kUnavailable);
  request.name = {chip_.label(), "7"};
  EXPECT_EQ(lines_->RequestEdges(request).error().kind, ErrorKind::kUnavailable);
}

TEST_F(SimulatedChip, EveryEdgeComesInOrderWithTheKernelsTime) {
  auto edges = lines_->RequestEdges(Trigger(gpio::Edge::kBoth));
  ASSERT_TRUE(edges) << edges.error().message;
  for (int i = 0; i < 12; ++i) {
    const HostTime before = clock_.Now();
    chip_.Pull(kTrigger, i % 2 == 0);
    ASSERT_TRUE(Readable(**edges, kPatienceMs)) << "edge " << i;
    const HostTime after = clock_.Now();
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const auto event = Next(**edges);
    ASSERT_TRUE(event);
    EXPECT_EQ(event->rising, i % 2 == 0);
    EXPECT_EQ(event->lost_before, 0U);
    // Taken when it happened, not when it was read.
    EXPECT_GT(event->time, before);
    EXPECT_LT(event->time, after);
  }
  EXPECT_FALSE(Readable(**edges, 200));
}

TEST_F(SimulatedChip, OnlyTheEdgesThatWereAskedForCome) {
  for (const bool rising : {true, false}) {
    auto edges = lines_->RequestEdges(Trigger(rising ? gpio::Edge::kRising : gpio::Edge::kFalling));
    ASSERT_TRUE(edges) << edges.error().message;
    for (int i = 0; i < 3; ++i) {
      chip_.Pulse(kTrigger);
      const auto event = Next(**edges);
      ASSERT_TRUE(event);
      EXPECT_EQ(event->rising, rising);
    }
    EXPECT_FALSE(Readable(**edges, 200));
  }
}

TEST_F(SimulatedChip, EdgesBeyondTheKernelsBufferAreKnownToBeMissing) {
  auto edges = lines_->RequestEdges(Trigger(gpio::Edge::kRising));
  ASSERT_TRUE(edges) << edges.error().message;
  if (lines_->library() != "libgpiod 1") GTEST_SKIP() << "its buffer holds more than are sent";
  for (int i = 0; i < 100; ++i) {
    chip_.Pulse(kTrigger);
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  // The kernel's buffer drops the newest and counts nothing: that it was full is what is known.
  std::array<gpio::EdgeEvent, gpio::kMostEvents> events;
  const Result<std::size_t> got = (*edges)->Read(events);
  ASSERT_TRUE(got) << got.error().message;
  ASSERT_EQ(*got, 16U);
  EXPECT_TRUE(events[15].buffer_was_full);
  EXPECT_FALSE(events[14].buffer_was_full);
  chip_.Pulse(kTrigger);
  const auto next = Next(**edges);
  ASSERT_TRUE(next);
  EXPECT_FALSE(next->buffer_was_full);
  EXPECT_GT(next->time, events[15].time);
}

TEST_F(SimulatedChip, ALineInUseIsRefusedAndFreeAgainAfterwards) {
  auto edges = lines_->RequestEdges(Trigger(gpio::Edge::kRising));
  ASSERT_TRUE(edges) << edges.error().message;
  const auto second = lines_->RequestEdges(Trigger(gpio::Edge::kRising));
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(second.error().message, HasSubstr("in use by another program"));
  edges->reset();
  EXPECT_TRUE(lines_->RequestEdges(Trigger(gpio::Edge::kRising)));
}

TEST_F(SimulatedChip, AnOutputDrivesItsLineAndLeavesItInactive) {
  for (const bool active_low : {false, true}) {
    auto output = lines_->RequestOutput({{chip_.label(), "ready-out"}, active_low});
    ASSERT_TRUE(output) << output.error().message;
    EXPECT_EQ(chip_.IsHigh(kReady), active_low);
    ASSERT_TRUE((*output)->Set(true));
    EXPECT_EQ(chip_.IsHigh(kReady), !active_low);
    ASSERT_TRUE((*output)->Set(false));
    EXPECT_EQ(chip_.IsHigh(kReady), active_low);
  }
}

TEST_F(SimulatedChip, EveryPulseOfTheTriggerLineIsATriggerAndEveryEdgeOfTheWheelIsWay) {
  gpio::Inputs inputs(InputOptions(), gpio::MakeLines(), clock_);
  ASSERT_TRUE(inputs.Start());
  ASSERT_TRUE(inputs.trigger()->Start());
  ASSERT_TRUE(Eventually([&] { return inputs.report().up; })) << inputs.report().problem;
  constexpr int kPulses = 20;
  HostTime last = clock_.Now();
  std::uint64_t heard = 0;
  const auto heard_one_more = [&] {
    ++heard;
    return Eventually([&] { return inputs.report().messages == heard; });
  };
  for (int i = 0; i < kPulses; ++i) {
    chip_.Pulse(kTrigger);
    ASSERT_TRUE(heard_one_more()) << "pulse " << i;
    for (const bool high : {true, false}) {
      chip_.Pull(kWheel, high);
      ASSERT_TRUE(heard_one_more()) << "pulse " << i << " of the wheel";
    }
  }
  for (int i = 0; i < kPulses; ++i) {
    const auto event = inputs.trigger()->Poll();
    ASSERT_TRUE(event && event->has_value()) << "trigger " << i;
    EXPECT_GT((*event)->time, last);
    EXPECT_EQ((*event)->lost_before, 0U);
    last = (*event)->time;
  }
  EXPECT_FALSE(inputs.trigger()->Poll()->has_value());
  EXPECT_EQ(inputs.wheel()->pulses(), 2U * kPulses);
  EXPECT_EQ(inputs.report().lost, 0U);
}

TEST_F(SimulatedChip, AChipThatGoesAndReturnsIsOpenedAgain) {
  gpio::Inputs inputs(InputOptions(), gpio::MakeLines(), clock_);
  ASSERT_TRUE(inputs.Start());
  ASSERT_TRUE(inputs.trigger()->Start());
  ASSERT_TRUE(Eventually([&] { return inputs.report().up; })) << inputs.report().problem;
  chip_.Remove();
  ASSERT_TRUE(Eventually([&] { return !inputs.report().up; }));
  chip_.Return();
  ASSERT_TRUE(Eventually([&] { return inputs.report().up; })) << inputs.report().problem;
  chip_.Pulse(kTrigger);
  EXPECT_TRUE(Eventually([&] { return inputs.trigger()->Poll()->has_value(); }));
}

TEST_F(SimulatedChip, APulseThatReleasesACameraStandsOnItsLineAndEnds) {
  for (const bool active_low : {false, true}) {
    gpio::CameraTriggerOptions options;
    options.name = {chip_.label(), "camera-out"};
    options.active_low = active_low;
    options.pulse_s = 0.5;
    options.spacing_s = 1.0;
    gpio::CameraTrigger trigger(options, gpio::MakeLines(), clock_);
    ASSERT_TRUE(trigger.Start());
    ASSERT_TRUE(Eventually([&] { return trigger.report().up; })) << trigger.report().problem;
    EXPECT_EQ(chip_.IsHigh(kCamera), active_low);
    ASSERT_TRUE(trigger.Release(Nanoseconds(0)));
    EXPECT_EQ(chip_.IsHigh(kCamera), !active_low);
    EXPECT_EQ(trigger.Release(Nanoseconds(0)).error().kind, ErrorKind::kTemporary);
    EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kCamera) == active_low; }));
    EXPECT_TRUE(trigger.Release(std::chrono::seconds(30)));
  }
}

TEST_F(SimulatedChip, LampsAndStrobeStandOnTheLines) {
  gpio::OutputsOptions options;
  options.chip = chip_.label();
  options.ready = "ready-out";
  options.busy = "busy-out";
  options.fault = "fault-out";
  options.strobe = "strobe-out";
  options.strobe_s = 1.0;
  {
    gpio::Outputs outputs(options, gpio::MakeLines(), clock_);
    ASSERT_TRUE(outputs.Start());
    ASSERT_TRUE(Eventually([&] { return outputs.report().up; })) << outputs.report().problem;
    ApplianceStatus status;
    status.state = CaptureState::kArmed;
    status.busy = true;
    outputs.Show(status);
    EXPECT_TRUE(chip_.IsHigh(kReady));
    EXPECT_TRUE(chip_.IsHigh(kBusy));
    EXPECT_FALSE(chip_.IsHigh(kFault));
    status.state = CaptureState::kWaitingForCamera;
    status.busy = false;
    outputs.Show(status);
    EXPECT_FALSE(chip_.IsHigh(kReady));
    EXPECT_FALSE(chip_.IsHigh(kBusy));
    EXPECT_TRUE(chip_.IsHigh(kFault));
    ASSERT_TRUE(outputs.Pulse());
    EXPECT_TRUE(Eventually([&] { return chip_.IsHigh(kStrobe); }));
    EXPECT_TRUE(Eventually([&] { return !chip_.IsHigh(kStrobe); }));
  }
  EXPECT_FALSE(chip_.IsHigh(kFault));
}

}  // namespace
}  // namespace omnihdr::gpio_test
