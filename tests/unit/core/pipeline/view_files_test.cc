#include "core/pipeline/view_files.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::view_files_test {
namespace {

// A lat-long view without anything special.
FinishedView PlainView(float radiance) {
  FinishedView view;
  view.pose.position = PositionId{3};
  view.merged.radiance = Image<float>(16, 8, 3, radiance);
  view.merged.disparity = Image<float>(16, 8, 1, 0.5F);
  view.merged.confidence = Image<float>(16, 8, 1, 1.0F);
  view.merged.origin =
      Image<std::uint8_t>(16, 8, 1, static_cast<std::uint8_t>(PixelOrigin::kMeasured));
  return view;
}

ViewContext PlainContext() {
  ViewContext context;
  context.mode = "spatiotemporal";
  context.reference_exposure_s = 0.004;
  context.camera = "sim 1";
  return context;
}

class ViewFiles : public ::testing::Test {
 protected:
  ExrImage Written(const FinishedView& view, const ViewContext& context,
                   const char* file = "radiance.exr") {
    const Status status = WriteViewFiles(directory_.path(), view, context);
    EXPECT_TRUE(status) << status.error().message;
    Result<ExrImage> image = ReadExr(directory_.path() / file);
    EXPECT_TRUE(image) << image.error().message;
    return image ? std::move(*image) : ExrImage{};
  }
  std::string ViewJson() const { return *ReadTextFile(directory_.path() / "view.json"); }

  testing::TemporaryDirectory directory_;
};

TEST_F(ViewFiles, DisparityIsRoundedToWhatItIsWorth) {
  FinishedView view = PlainView(2.0F);
  for (int x = 0; x < 16; ++x) {
    view.merged.disparity.at(x, 2) = 0.3F * static_cast<float>(x) / 7.0F;
    view.merged.confidence.at(x, 2) = static_cast<float>(x) / 15.0F;
  }
  view.merged.disparity.at(5, 3) = std::numeric_limits<float>::quiet_NaN();
  const ExrImage image = Written(view, PlainContext(), "disparity.exr");
  const Image<float>& disparity = image.channels.at("disparity");
  for (int x = 0; x < 16; ++x) {
    const float expected = view.merged.disparity.at(x, 2);
    EXPECT_NEAR(disparity.at(x, 2), expected, 1.3e-4F * expected);
    EXPECT_NEAR(image.channels.at("confidence").at(x, 2), view.merged.confidence.at(x, 2), 0.0021F);
  }
  EXPECT_EQ(disparity.at(0, 2), 0.0F);
  EXPECT_TRUE(std::isnan(disparity.at(5, 3)));
}

TEST_F(ViewFiles, RadianceSaysWhatOtherProgramsLookFor) {
  ViewContext context = PlainContext();
  // 2026-02-03T04:05:06.9Z
  context.utc = UtcTime::FromNanoseconds(1'770'091'506'900'000'000);
  context.gnss = GnssFix{45.5, 284.25, 61.0, "", 1};
  context.white_luminance = 179.0;
  const ExrImage image = Written(PlainView(2.0F), context);
  const ExrAttributes& a = image.attributes;
  EXPECT_EQ(a.envmap, ExrEnvmap::kLatLong);
  ASSERT_TRUE(a.chromaticities);
  for (std::size_t i = 0; i < 8; ++i) EXPECT_NEAR((*a.chromaticities)[i], kRec709[i], 1e-6) << i;
  EXPECT_NEAR(a.floats.at("expTime"), 0.004, 1e-9);
  EXPECT_EQ(a.strings.at("capDate"), "2026:02:03 04:05:06");
  EXPECT_EQ(a.floats.at("utcOffset"), 0.0);
  EXPECT_EQ(a.floats.at("latitude"), 45.5);
  EXPECT_EQ(a.floats.at("longitude"), -75.75);
  EXPECT_EQ(a.floats.at("altitude"), 61.0);
  EXPECT_EQ(a.floats.at("whiteLuminance"), 179.0);
  EXPECT_EQ(a.strings.at("software").rfind("omnihdr ", 0), 0U);
  EXPECT_EQ(a.strings.at("omnihdrPosition"), "3");
  EXPECT_EQ(image.types.at("R"), ExrPixelType::kHalf);
}

TEST_F(ViewFiles, WhatIsNotKnownIsNotSaid) {
  ViewContext context = PlainContext();
  context.gnss = GnssFix{45.5, 284.25, 61.0, "", 0};  // the receiver had no fix
  const ExrAttributes attributes = Written(PlainView(2.0F), context).attributes;
  for (const char* name : {"whiteLuminance", "latitude", "longitude", "altitude", "utcOffset"}) {
    EXPECT_FALSE(attributes.floats.contains(name)) << name;
  }
  EXPECT_FALSE(attributes.strings.contains("capDate"));
}

TEST_F(ViewFiles, DisparityTellsWhereAndWhenAndNothingOfLight) {
  ViewContext context = PlainContext();
  context.gnss = GnssFix{45.5, 10.0, 61.0, "", 1};
  const ExrAttributes attributes = Written(PlainView(2.0F), context, "disparity.exr").attributes;
  EXPECT_EQ(attributes.envmap, ExrEnvmap::kLatLong);
  EXPECT_TRUE(attributes.floats.contains("latitude"));
  EXPECT_FALSE(attributes.floats.contains("expTime"));
  EXPECT_FALSE(attributes.chromaticities);
}

TEST_F(ViewFiles, RadianceThatHalfCannotHoldIsStoredAsFloatAndSaidSo) {
  FinishedView view = PlainView(2.0F);
  view.merged.radiance.at(5, 4, 1) = 70'000.0F;
  const ExrImage image = Written(view, PlainContext());
  EXPECT_EQ(image.types.at("G"), ExrPixelType::kFloat);
  EXPECT_EQ(image.types.at("R"), ExrPixelType::kFloat);
  EXPECT_EQ(image.channels.at("G").at(5, 4), 70'000.0F);
  EXPECT_NE(ViewJson().find("radiance up to 70000 exceeds half precision: stored as float"),
            std::string::npos)
      << ViewJson();
}

TEST_F(ViewFiles, TheLargestHalfIsStillHalf) {
  FinishedView view = PlainView(2.0F);
  view.merged.radiance.at(5, 4, 1) = 65'504.0F;
  const ExrImage image = Written(view, PlainContext());
  EXPECT_EQ(image.types.at("G"), ExrPixelType::kHalf);
  EXPECT_EQ(image.channels.at("G").at(5, 4), 65'504.0F);
  EXPECT_EQ(ViewJson().find("half precision"), std::string::npos);
}

TEST_F(ViewFiles, FloatAndOtherPrimariesOnRequest) {
  ViewContext context = PlainContext();
  context.exr_type = ExrPixelType::kFloat;
  context.chromaticities = {0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290};
  const float value = 1.0F + 1.0F / 65536.0F;  // needs more than half's 11 bits
  const ExrImage image = Written(PlainView(value), context);
  EXPECT_EQ(image.types.at("B"), ExrPixelType::kFloat);
  EXPECT_EQ(image.channels.at("B").at(0, 0), value);
  ASSERT_TRUE(image.attributes.chromaticities);
  EXPECT_NEAR((*image.attributes.chromaticities)[0], 0.708, 1e-6);
  EXPECT_EQ(ViewJson().find("half precision"), std::string::npos);
}

TEST(PipelineOptions, RefuseWhatTheExrFilesCannotSay) {
  PipelineOptions options;
  ASSERT_TRUE(options.Validate());
  options.chromaticities[6] = 0.9;
  ASSERT_FALSE(options.Validate());
  EXPECT_EQ(options.Validate().error().message,
            "output.chromaticities: white (0.9, 0.329), expected inside the triangle of red, green "
            "and blue");
  options.chromaticities = kRec709;
  options.chromaticities[3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(options.Validate());
  options.chromaticities = kRec709;
  options.white_luminance = -1.0;
  EXPECT_FALSE(options.Validate());
  options.white_luminance = 179.0;
  EXPECT_TRUE(options.Validate());
  options.exr_type = ExrPixelType::kUint;
  EXPECT_FALSE(options.Validate());
}

}  // namespace
}  // namespace omnihdr::view_files_test
