// Features and registers set by hand.

#include "drivers/iidc/settings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "tests/drivers/iidc/emulated.h"
#include "tests/drivers/settings_fixture.h"

namespace omnihdr::iidc_settings_test {
namespace {

using ::testing::HasSubstr;

class IidcSettingsTest : public testing::CameraSettingsTest {
 protected:
  void SetUp() override {
    const auto finder = emulators::MakeEmulatedFinder({emulated_.device});
    auto opened = iidc::OpenSettings(*finder, "", testing::EmulatedIidc::Timeouts());
    ASSERT_TRUE(opened) << opened.error().message;
    settings_ = std::move(*opened);
  }

  testing::EmulatedIidc emulated_;
};

TEST_F(IidcSettingsTest, AnAbsoluteValueIsSetInItsUnitAndReadBackAsTheCameraQuantisesIt) {
  const CameraSettingChange change = Set("shutter", "0.0123");
  EXPECT_TRUE(change.as_asked);
  EXPECT_NEAR(std::stod(change.value), 0.0123, 0.0003);
  EXPECT_THAT(change.allowed, HasSubstr(" s, raw:"));
  EXPECT_EQ(emulated_.device->Register(iidc::kShutter) & 0xFFF,
            emulators::IidcDevice::ShutterRaw(0.0123));
  EXPECT_EQ(Find("shutter").value, change.value);
}

TEST_F(IidcSettingsTest, ARawValueIsTheRegistersOwn) {
  EXPECT_TRUE(Set("shutter", "raw:100").as_asked);
  EXPECT_EQ(emulated_.device->Register(iidc::kShutter) & 0xFFF, 100U);
}

TEST_F(IidcSettingsTest, AFeatureIsSwitchedOffAndBackToItsOwnRule) {
  EXPECT_EQ(Set("gamma", "off").value, "off");
  EXPECT_EQ(Find("gamma").value, "off");
  EXPECT_THAT(Set("auto_exposure", "auto").value, HasSubstr("auto ("));
  EXPECT_EQ(Set("white_balance", "600,500").value, "600,500");
}

TEST_F(IidcSettingsTest, ARegisterIsWrittenAndReadBack) {
  const CameraSettingChange change = Set("0x818", "0x80000000");
  EXPECT_THAT(change.value, HasSubstr("0x"));
  EXPECT_THAT(UsageError("0x81a", "1"), HasSubstr("an offset of a quadlet"));
  EXPECT_THAT(UsageError("0x818", "what"), HasSubstr("0x818=what: expected 0x00000000 to"));
}

TEST_F(IidcSettingsTest, WhatDoesNotExistOrIsOutOfRangeIsRefusedWithWhatIsAllowed) {
  const std::uint32_t before = emulated_.device->Register(iidc::kShutter);
  EXPECT_THAT(UsageError("shutter", "1000"), HasSubstr("shutter=1000: expected 1e-05 to "));
  EXPECT_THAT(UsageError("shutter", "raw:5000"), HasSubstr("expected"));
  EXPECT_THAT(UsageError("shutter", "nan"), HasSubstr("expected"));
  EXPECT_THAT(UsageError("white_balance", "600"), HasSubstr("BLUE,RED"));
  EXPECT_THAT(UsageError("colour", "1"), HasSubstr("one of brightness, auto_exposure"));
  EXPECT_EQ(emulated_.device->Register(iidc::kShutter), before);
}

}  // namespace
}  // namespace omnihdr::iidc_settings_test
