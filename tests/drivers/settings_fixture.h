#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>

#include "core/ports/camera_settings.h"

namespace omnihdr::testing {

// What tests ask of a camera's settings, whatever its driver: the fixture opens `settings_`.
class CameraSettingsTest : public ::testing::Test {
 protected:
  // Before what a test's own fixture has below it.
  void TearDown() override { settings_.reset(); }
  CameraSetting Find(const std::string& name) {
    const auto all = settings_->List();
    EXPECT_TRUE(all);
    const auto found = std::find_if(all->begin(), all->end(),
                                    [&](const CameraSetting& each) { return each.name == name; });
    EXPECT_NE(found, all->end()) << name;
    return found == all->end() ? CameraSetting{} : *found;
  }
  CameraSettingChange Set(const std::string& name, const std::string& value) {
    const auto change = settings_->Set(name, value);
    EXPECT_TRUE(change) << change.error().message;
    return change ? *change : CameraSettingChange{};
  }
  // Why it is refused.
  std::string UsageError(const std::string& name, const std::string& value) {
    const auto set = settings_->Set(name, value);
    EXPECT_FALSE(set);
    if (set) return {};
    EXPECT_EQ(set.error().kind, ErrorKind::kUsage);
    return set.error().message;
  }

  std::unique_ptr<CameraSettings> settings_;
};

}  // namespace omnihdr::testing
