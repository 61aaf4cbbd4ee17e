// Features, Format7, trigger and frame information against the emulated registers.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>

#include "drivers/iidc/exposure_table.h"
#include "drivers/iidc/model_table.h"
#include "drivers/iidc/trigger_mode.h"
#include "drivers/iidc/usb_link.h"
#include "tests/drivers/iidc/emulated.h"

namespace omnihdr::registers_test {
namespace {

using iidc::Feature;
using ::testing::HasSubstr;

TEST(IidcFeatures, EverythingAutomaticIsOffOrManualAfterwards) {
  testing::EmulatedRegisters camera;
  const auto settled = iidc::SettleFeatures(camera.registers, {});
  ASSERT_TRUE(settled) << settled.error().message;
  EXPECT_GE(settled->size(), 8U);
  for (const std::uint32_t offset :
       {iidc::kAutoExposure, iidc::kSharpness, iidc::kHue, iidc::kSaturation, iidc::kGamma}) {
    const iidc::FeatureValue value =
        iidc::ParseFeatureValue(camera.emulated.device->Register(offset));
    EXPECT_FALSE(value.on) << std::hex << offset;
    EXPECT_FALSE(value.automatic) << std::hex << offset;
  }
  for (const std::uint32_t offset : {iidc::kBrightness, iidc::kWhiteBalance}) {
    EXPECT_FALSE(iidc::ParseFeatureValue(camera.emulated.device->Register(offset)).automatic)
        << std::hex << offset;
  }
}

TEST(IidcFeatures, WhiteBalanceIsWhatTheConfigurationSays) {
  testing::EmulatedRegisters camera;
  ASSERT_TRUE(iidc::SettleFeatures(camera.registers, {700, 450}));
  const iidc::FeatureValue value =
      iidc::ParseFeatureValue(camera.emulated.device->Register(iidc::kWhiteBalance));
  EXPECT_EQ(value.value_u, 700U);
  EXPECT_EQ(value.value, 450U);
}

TEST(IidcFeatures, AGammaThatStaysOnIsAnErrorNamingTheRegister) {
  testing::EmulatedRegisters camera({.keeps_gamma = true});
  const auto settled = iidc::SettleFeatures(camera.registers, {});
  ASSERT_FALSE(settled);
  EXPECT_EQ(settled.error().kind, ErrorKind::kProtocol);
  EXPECT_THAT(settled.error().message, HasSubstr("GAMMA (0x818): wrote"));
}

TEST(IidcFeatures, AnAbsoluteValueIsReadBackAsTheCameraQuantisedIt) {
  testing::EmulatedRegisters camera;
  const Result<Feature> shutter = Feature::Open(camera.registers, iidc::kShutter, "SHUTTER");
  ASSERT_TRUE(shutter);
  ASSERT_TRUE(shutter->SetManual());
  const Result<Feature::Set> set = shutter->SetAbsolute(0.0123);
  ASSERT_TRUE(set) << set.error().message;
  EXPECT_NE(set->value, 0.0123);
  EXPECT_NEAR(set->value, 0.0123, 0.0123 * 0.002);
  EXPECT_EQ(set->raw, emulators::IidcDevice::ShutterRaw(0.0123));
  const Result<iidc::AbsoluteRange> range = shutter->ReadRange();
  ASSERT_TRUE(range);
  EXPECT_FLOAT_EQ(static_cast<float>(range->maximum), 4.0F);
}

TEST(IidcFeatures, FloatsAreBitPatterns) {
  for (const float value : {0.0F, 1.0F, -3.5F, 1e-5F, 3.4e38F}) {
    EXPECT_EQ(iidc::FloatFromQuadlet(iidc::QuadletFromFloat(value)), value);
  }
  EXPECT_EQ(iidc::QuadletFromFloat(1.0F), 0x3F800000U);
}

TEST(IidcFeatures, ARefusedRegisterSaysItsNameAndAddress) {
  testing::EmulatedRegisters camera;
  camera.emulated.device->Set({.stall_registers = 1});
  const Result<Feature> gain = Feature::Open(camera.registers, iidc::kGain, "GAIN");
  ASSERT_FALSE(gain);
  EXPECT_THAT(gain.error().message, HasSubstr("GAIN inquiry"));
  EXPECT_THAT(gain.error().message, HasSubstr("0xfffff0f00520"));
}

TEST(IidcFormat7, GivesThePictureAskedForAndFramesWithAnEnd) {
  testing::EmulatedRegisters camera;
  iidc::Format7Request request;
  request.width = 64;
  request.height = 288;
  request.link_packet_bytes = 512;
  const auto setup = iidc::SetUpFormat7(camera.registers, request);
  ASSERT_TRUE(setup) << setup.error().message;
  EXPECT_EQ(setup->image_bytes, 64U * 288U);
  EXPECT_GE(setup->frame_bytes, setup->image_bytes);
  EXPECT_EQ(setup->frame_bytes % setup->packet_bytes, 0U);
  EXPECT_NE(setup->frame_bytes % 512, 0U);
  EXPECT_TRUE(setup->marked_ends);
  EXPECT_EQ(setup->bayer, BayerOrder::kBggr);
}

TEST(IidcFormat7, WhatTheModeCannotDoIsRefusedWithWhatItCan) {
  testing::EmulatedRegisters camera;
  iidc::Format7Request request;
  request.width = 64;
  request.height = 400;
  auto setup = iidc::SetUpFormat7(camera.registers, request);
  ASSERT_FALSE(setup);
  EXPECT_EQ(setup.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(setup.error().message, HasSubstr("the mode has 288"));
  request.height = 288;
  request.width = 62;
  setup = iidc::SetUpFormat7(camera.registers, request);
  ASSERT_FALSE(setup);
  EXPECT_THAT(setup.error().message, HasSubstr("multiple of 4"));
  request.width = 64;
  request.mode = 3;
  setup = iidc::SetUpFormat7(camera.registers, request);
  ASSERT_FALSE(setup);
  EXPECT_THAT(setup.error().message, HasSubstr("mode 3"));
  request.mode = 0;
  request.packet_bytes = 8192;
  setup = iidc::SetUpFormat7(camera.registers, request);
  ASSERT_FALSE(setup);
  EXPECT_THAT(setup.error().message, HasSubstr("8192"));
}

TEST(IidcFormat7, AHandshakeThatNeverEndsHasADeadline) {
  testing::EmulatedRegisters camera({.handshake_never_ends = true});
  iidc::Format7Request request;
  request.width = 64;
  request.height = 288;
  const SystemClock clock;
  const HostTime before = clock.Now();
  const auto setup = iidc::SetUpFormat7(camera.registers, request);
  ASSERT_FALSE(setup);
  EXPECT_EQ(setup.error().kind, ErrorKind::kTemporary);
  EXPECT_THAT(setup.error().message, HasSubstr("VALUE_SETTING (0x07c)"));
  EXPECT_LT(clock.Now() - before, std::chrono::seconds(5));
}

TEST(IidcFormat7, ThePacketSizeIsAMultipleOfTheUnitAndLetsFramesEndWhereOneDoes) {
  for (const std::uint32_t unit : {4U, 8U, 512U}) {
    for (const std::size_t image :
         {std::size_t{1}, std::size_t{512}, std::size_t{4718592}, std::size_t{1228800}}) {
      for (const std::uint32_t wanted : {1U, 512U, 1000U, 4096U}) {
        const std::uint32_t packet = iidc::ChoosePacketBytes(image, unit, 4096, wanted, 512);
        EXPECT_EQ(packet % unit, 0U);
        EXPECT_GE(packet, unit);
        EXPECT_LE(packet, 4096U);
        const std::size_t frame = (image + packet - 1) / packet * packet;
        EXPECT_TRUE(unit == 512 || frame % 512 != 0) << image << " " << unit << " " << wanted;
      }
    }
  }
  EXPECT_EQ(iidc::ChoosePacketBytes(4718592, 8, 4096, 2048, 0), 2048U);
}

TEST(IidcTrigger, InquiryBitsAreModesAndSources) {
  const iidc::TriggerInquiry inquiry = iidc::ParseTriggerInquiry(0x8F818003);
  EXPECT_TRUE(inquiry.present);
  EXPECT_TRUE(inquiry.software);
  EXPECT_EQ(inquiry.sources, 1U);
  EXPECT_EQ(inquiry.modes, 1U | 1U << 14 | 1U << 15);
}

TEST(IidcTrigger, ModesThatTheCameraHasAreSetAndOthersRefused) {
  testing::EmulatedRegisters camera;
  for (const int mode : {0, 14, 15}) {
    ASSERT_TRUE(iidc::SetUpSoftwareTrigger(camera.registers, mode)) << mode;
    const std::uint32_t value = camera.emulated.device->Register(iidc::kTriggerMode);
    EXPECT_EQ(iidc::Field(value, 19, 16), static_cast<std::uint32_t>(mode));
    EXPECT_EQ(iidc::Field(value, 23, 21), iidc::kSoftwareSource);
  }
  ASSERT_TRUE(iidc::SwitchTriggerOff(camera.registers));
  EXPECT_EQ(camera.emulated.device->Register(iidc::kTriggerMode) & iidc::Bit(25), 0U);
  EXPECT_EQ(iidc::SetUpSoftwareTrigger(camera.registers, 3).error().kind, ErrorKind::kConfig);
}

TEST(IidcFrameInfo, EverySetOfItemsIsFoundInItsPlaceAndShorterFramesAreNot) {
  for (std::uint32_t enabled = 0; enabled <= iidc::kEmbeddedAll; ++enabled) {
    std::vector<std::byte> frame;
    std::vector<std::uint32_t> words;
    for (int item = 0; item < iidc::kEmbeddedItems; ++item) {
      if ((enabled & iidc::Bit(item)) == 0) continue;
      words.push_back(0x01020300U + static_cast<std::uint32_t>(item));
      for (int shift = 24; shift >= 0; shift -= 8) {
        frame.push_back(static_cast<std::byte>(words.back() >> shift & 0xFF));
      }
    }
    ASSERT_EQ(frame.size(), iidc::EmbeddedBytes(enabled));
    for (std::size_t length = 0; length < frame.size(); ++length) {
      EXPECT_FALSE(iidc::ParseEmbeddedInfo(std::span(frame).first(length), enabled));
    }
    const auto info = iidc::ParseEmbeddedInfo(frame, enabled);
    ASSERT_TRUE(info);
    std::vector<std::uint32_t> found;
    for (const auto& item :
         {info->cycle_time, info->gain, info->shutter, info->brightness, info->auto_exposure,
          info->white_balance, info->counter, info->strobe, info->pins, info->position}) {
      if (item) found.push_back(*item);
    }
    EXPECT_EQ(found, words) << enabled;
  }
}

TEST(IidcFrameInfo, CycleTimeIsSecondsCyclesAndTicks) {
  EXPECT_EQ(iidc::CycleTimeNanoseconds(0), 0);
  EXPECT_EQ(iidc::CycleTimeNanoseconds(5U << 25 | 8U << 12 | 1536), 5'001'062'500);
  EXPECT_EQ(iidc::CycleTimeNanoseconds(127U << 25 | 7999U << 12 | 3071), 127'999'999'959);
  EXPECT_FALSE(iidc::CycleTimeNanoseconds(8000U << 12));
  EXPECT_FALSE(iidc::CycleTimeNanoseconds(3072));
}

TEST(IidcExposureTable, AValueThatStandsForSeveralExposuresProvesNone) {
  iidc::ExposureTable table;
  table.Learn(100, 0.01);
  table.Learn(100, 0.01);
  EXPECT_EQ(table.Find(100), 0.01);
  EXPECT_FALSE(table.Find(101));
  table.Learn(100, 0.02);
  EXPECT_FALSE(table.Find(100));
  EXPECT_TRUE(table.ambiguous(100));
}

TEST(IidcModels, EveryModelIsThereOnce) {
  for (const iidc::CameraModel& model : iidc::CameraModels()) {
    EXPECT_EQ(iidc::FindModel(model.product)->name, model.name);
  }
  EXPECT_FALSE(iidc::FindModel(0x1234));
}

TEST(IidcUsb, AnAddressBecomesARequestItsLowBitsValueAndIndex) {
  const auto setup = iidc::SetupForAddress(0xFFFF'F0F0'0614);
  ASSERT_TRUE(setup);
  EXPECT_EQ(setup->request, 0x7F);
  EXPECT_EQ(setup->value, 0x0614);
  EXPECT_EQ(setup->index, 0xF0F0);
  EXPECT_EQ(iidc::SetupForAddress(0xD000'0000'1000)->request, 0x80);
  EXPECT_EQ(iidc::SetupForAddress(0x1234'0000'0000).error().kind, ErrorKind::kUsage);
}

TEST(IidcTileMapping, FourLettersAreTheColours) {
  EXPECT_EQ(iidc::ParseTileMapping(0x42474752), BayerOrder::kBggr);
  EXPECT_EQ(iidc::ParseTileMapping(0x59595959), BayerOrder::kNone);
  EXPECT_FALSE(iidc::ParseTileMapping(0));
  EXPECT_FALSE(iidc::ParseTileMapping(0x6E6F6E65));  // "none"
}

}  // namespace
}  // namespace omnihdr::registers_test
