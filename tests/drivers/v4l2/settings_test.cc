// Controls set by hand.

#include "drivers/v4l2/settings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "tests/drivers/settings_fixture.h"
#include "tests/drivers/v4l2/emulated.h"

namespace omnihdr::v4l2_settings_test {
namespace {

using ::testing::HasSubstr;

class V4l2SettingsTest : public testing::CameraSettingsTest {
 protected:
  void SetUp() override {
    system_ = emulators::MakeEmulatedV4l2({emulated_.model});
    auto opened = v4l2::OpenSettings(*system_, {});
    ASSERT_TRUE(opened) << opened.error().message;
    ASSERT_EQ(opened->size(), 1U);
    settings_ = std::move(opened->front());
  }

  testing::EmulatedV4l2 emulated_;
  std::unique_ptr<v4l2::V4l2System> system_;
};

TEST_F(V4l2SettingsTest, EveryControlIsListedWithItsValueAndWhatItTakes) {
  EXPECT_EQ(settings_->camera(), "/dev/video2 Emulated Camera (serial 0001)");
  const CameraSetting exposure = Find("exposure_time_absolute");
  EXPECT_EQ(exposure.value, "10");
  EXPECT_EQ(exposure.allowed, "1 to 5000 in steps of 1, default 10");
  EXPECT_EQ(Find("auto_exposure").allowed,
            "1 (Manual Mode), 3 (Aperture Priority Mode), default 3");
  EXPECT_EQ(Find("white_balance_automatic").allowed, "0 or 1, default 1");
}

TEST_F(V4l2SettingsTest, AControlIsSetAndReadBackByNumberByMenuNameAndToItsDefault) {
  auto change = settings_->Set("exposure_time_absolute", "123");
  ASSERT_TRUE(change) << change.error().message;
  EXPECT_TRUE(change->as_asked);
  EXPECT_EQ(change->value, "123");
  EXPECT_EQ(emulated_.model->ControlNow(V4L2_CID_EXPOSURE_ABSOLUTE), 123);
  change = settings_->Set("auto_exposure", "Manual Mode");
  ASSERT_TRUE(change);
  EXPECT_EQ(change->value, "1");
  change = settings_->Set("power_line_frequency", "default");
  ASSERT_TRUE(change);
  EXPECT_EQ(emulated_.model->ControlNow(V4L2_CID_POWER_LINE_FREQUENCY), 1);
}

TEST_F(V4l2SettingsTest, AValueThatReadsBackDifferentlyIsTold) {
  emulators::V4l2CameraModel::Faults faults;
  faults.stuck[V4L2_CID_GAIN] = 16;
  emulated_.model->SetFaults(faults);
  const auto change = settings_->Set("gain", "40");
  ASSERT_TRUE(change);
  EXPECT_FALSE(change->as_asked);
  EXPECT_EQ(change->value, "16");
}

TEST_F(V4l2SettingsTest, WhatDoesNotExistOrIsOutOfRangeIsRefusedWithWhatIsAllowed) {
  EXPECT_THAT(UsageError("gamma", "1"), HasSubstr("expected one of "));
  EXPECT_THAT(UsageError("gamma", "1"), HasSubstr("white_balance_temperature"));
  EXPECT_EQ(UsageError("gain", "256"), "gain=256: expected 0 to 255 in steps of 1, default 16");
  EXPECT_THAT(UsageError("auto_exposure", "0"), HasSubstr("1 (Manual Mode), 3 (Aperture"));
  EXPECT_THAT(UsageError("gain", "much"), HasSubstr("expected 0 to 255"));
  EXPECT_EQ(emulated_.model->writes().size(), 0U);
}

TEST_F(V4l2SettingsTest, ReadOnlyControlsAreMarkedAndNotWritten) {
  emulators::V4l2ModelOptions lines;
  lines.in_lines = true;
  lines.formats = {V4L2_PIX_FMT_SRGGB10};
  testing::EmulatedV4l2 sensor(lines, BayerOrder::kRggb);
  const auto system = emulators::MakeEmulatedV4l2({sensor.model});
  auto opened = v4l2::OpenSettings(*system, {});
  ASSERT_TRUE(opened);
  settings_ = std::move(opened->front());
  EXPECT_EQ(Find("horizontal_blanking").note, "read only");
  EXPECT_THAT(UsageError("horizontal_blanking", "16"), HasSubstr("it is read only"));
}

TEST_F(V4l2SettingsTest, EachCameraOfARigHasItsSettings) {
  emulators::V4l2ModelOptions other;
  other.path = "/dev/video0";
  other.serial = "0002";
  const auto second = std::make_shared<emulators::V4l2CameraModel>(other, emulated_.clock);
  const auto system = emulators::MakeEmulatedV4l2({emulated_.model, second});
  v4l2::V4l2CameraOptions options;
  options.devices = {"0002", "0001"};
  const auto opened = v4l2::OpenSettings(*system, options);
  ASSERT_TRUE(opened) << opened.error().message;
  ASSERT_EQ(opened->size(), 2U);
  EXPECT_THAT(opened->front()->camera(), HasSubstr("/dev/video0"));
}

}  // namespace
}  // namespace omnihdr::v4l2_settings_test
