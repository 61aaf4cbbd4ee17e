#include "drivers/modbus/registers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <array>
#include <bit>
#include <cmath>

namespace omnihdr::registers_test {
namespace {

using namespace omnihdr::modbus;  // NOLINT(google-build-using-namespace)
using ::testing::HasSubstr;

HostTime At(double seconds) {
  return HostTime::FromNanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
}

TEST(ModbusNumber, EveryTypeAndWordOrderGivesTheNumberThatWasWritten) {
  const std::array<std::uint16_t, 2> words = {0xFFFE, 0x1234};
  EXPECT_EQ(DecodeRaw(words, NumberType::kU16, WordOrder::kHighFirst), 65534.0);
  EXPECT_EQ(DecodeRaw(words, NumberType::kI16, WordOrder::kHighFirst), -2.0);
  EXPECT_EQ(DecodeRaw(words, NumberType::kU32, WordOrder::kHighFirst), 4294840884.0);
  EXPECT_EQ(DecodeRaw(words, NumberType::kU32, WordOrder::kLowFirst), 305463294.0);
  EXPECT_EQ(DecodeRaw(words, NumberType::kI32, WordOrder::kHighFirst), -126412.0);
  const auto bits = std::bit_cast<std::uint32_t>(12.5F);
  const std::array<std::uint16_t, 2> real = {static_cast<std::uint16_t>(bits & 0xFFFF),
                                             static_cast<std::uint16_t>(bits >> 16)};
  EXPECT_EQ(DecodeRaw(real, NumberType::kF32, WordOrder::kLowFirst), 12.5);
}

TEST(ModbusNumber, ANumberThatDoesNotFitOrHasNoScaleIsRefusedByName) {
  NumberSpec spec;
  spec.address = 65535;
  EXPECT_TRUE(spec.Validate());
  spec.type = NumberType::kU32;
  EXPECT_THAT(spec.Validate().error().message,
              HasSubstr("register: 65535: expected at most 65534 for a number of type u32"));
  spec.address = 10;
  spec.scale = 0.0;
  EXPECT_THAT(spec.Validate().error().message, HasSubstr("scale: 0"));
}

OdometerCounterOptions Centimetres() {
  OdometerCounterOptions options;
  options.scale = 0.01;
  options.wrap = 65536.0;
  return options;
}

TEST(ModbusOdometer, AWrapIsCountedOnInBothDirections) {
  OdometerCounter counter(Centimetres());
  EXPECT_NEAR(counter.Update(At(1.0), 65500.0), 655.0, 1e-9);
  EXPECT_NEAR(counter.Update(At(2.0), 64.0), 656.0, 1e-9);
  EXPECT_NEAR(counter.Update(At(3.0), 65500.0), 655.0, 1e-9);
  EXPECT_EQ(counter.resets(), 0U);
}

TEST(ModbusOdometer, ACounterThatIsSetBackGoesOnWithoutAJump) {
  OdometerCounterOptions options;
  options.scale = 0.001;
  options.wrap = 4294967296.0;
  OdometerCounter counter(options);
  EXPECT_NEAR(counter.Update(At(1.0), 5'000'000.0), 5000.0, 1e-9);
  EXPECT_NEAR(counter.Update(At(1.1), 0.0), 5000.0, 1e-9);
  EXPECT_EQ(counter.resets(), 1U);
  EXPECT_NEAR(counter.Update(At(1.2), 1000.0), 5001.0, 1e-9);
}

TEST(ModbusOdometer, WhatWasDrivenWhileNobodyLookedIsCountedWhenItWasPossible) {
  OdometerCounter counter(Centimetres());
  counter.Update(At(1.0), 0.0);
  EXPECT_NEAR(counter.Update(At(11.0), 20000.0), 200.0, 1e-9);
  EXPECT_EQ(counter.resets(), 0U);
}

TEST(ModbusOdometer, AContinuedWayDoesNotBeginBehindItsLastPlace) {
  OdometerCounterOptions options = Centimetres();
  options.not_below_m = 1234.5;
  OdometerCounter set_back(options);
  EXPECT_NEAR(set_back.Update(At(1.0), 100.0), 1234.5, 1e-9);
  EXPECT_NEAR(set_back.Update(At(2.0), 200.0), 1235.5, 1e-9);
  options.not_below_m = 10.0;
  OdometerCounter further_on(options);
  EXPECT_NEAR(further_on.Update(At(1.0), 2000.0), 20.0, 1e-9);
}

RC_GTEST_PROP(ModbusOdometerProperty, TheWayIsTheSumOfItsStepsHoweverOftenTheCounterWraps, ()) {
  OdometerCounterOptions options;
  options.scale = 0.01;
  options.wrap = *rc::gen::element(256.0, 1000.0, 65536.0);
  OdometerCounter counter(options);
  const auto on_counter = [&](std::int64_t counts) {
    const auto wrap = static_cast<std::int64_t>(options.wrap);
    return static_cast<double>(((counts % wrap) + wrap) % wrap);
  };
  std::int64_t counts = *rc::gen::inRange(0, 1000);
  const double begin = counter.Update(At(0.0), on_counter(counts));
  const std::int64_t first = counts;
  const int steps = *rc::gen::inRange(1, 60);
  double metres = begin;
  for (int i = 1; i <= steps; ++i) {
    counts += *rc::gen::inRange(-120, 121);
    metres = counter.Update(At(i), on_counter(counts));
  }
  RC_ASSERT(counter.resets() == 0U);
  RC_ASSERT(std::abs(metres - begin - static_cast<double>(counts - first) * 0.01) < 1e-6);
}

}  // namespace
}  // namespace omnihdr::registers_test
