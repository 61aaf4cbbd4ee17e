// preview.jpg of a written view.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <string>
#include <variant>

#include "core/image/image_io.h"
#include "core/pipeline/view_files.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::preview_test {
namespace {

class Preview : public ::testing::Test {
 protected:
  static MergedView Merged() {
    MergedView merged;
    merged.radiance = Image<float>(64, 32, 3);
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 64; ++x) {
        std::fill_n(merged.radiance.pixel(x, y), 3, std::pow(10.0F, static_cast<float>(x) / 16.0F));
      }
    }
    merged.disparity = Image<float>(64, 32, 1, 0.5F);
    merged.confidence = Image<float>(64, 32, 1, 1.0F);
    merged.origin = Image<std::uint8_t>(64, 32, 1, 1);
    return merged;
  }
  // The written file's bytes.
  std::string Temporal(const ViewContext& context, bool is_latlong) const {
    TemporalView view;
    view.merged = Merged();
    view.is_latlong = is_latlong;
    const Status written = WriteTemporalViewFiles(directory_.path(), view, context);
    EXPECT_TRUE(written);
    return Bytes();
  }
  std::string Bytes() const {
    std::ifstream file(directory_.path() / "preview.jpg", std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  testing::TemporaryDirectory directory_;
};

TEST_F(Preview, ALatLongViewOpensAsA360PhotoAndAPerspectiveOneDoesNot) {
  ViewContext context;
  context.mode = "temporal";
  EXPECT_NE(Temporal(context, true).find("GPano:FullPanoWidthPixels=\"64\""), std::string::npos);
  EXPECT_EQ(Temporal(context, true).find("PoseHeading"), std::string::npos) << "not known";
  EXPECT_EQ(Temporal(context, false).find("GPano"), std::string::npos);
}

TEST_F(Preview, SaysWhereItsMiddleLooksWhenTheHeadingIsKnown) {
  ViewContext context;
  context.mode = "temporal";
  context.heading_deg = 350.0;
  EXPECT_NE(Temporal(context, true).find("GPano:PoseHeadingDegrees=\"350.000\""),
            std::string::npos);
  // The output's forward is the camera's right: a quarter clockwise of its heading, over north.
  FinishedView view;
  view.merged = Merged();
  view.camera_from_output =
      Eigen::Quaterniond(Eigen::AngleAxisd(-0.5 * std::numbers::pi, Eigen::Vector3d::UnitZ()));
  ASSERT_TRUE(WriteViewFiles(directory_.path(), view, context));
  EXPECT_NE(Bytes().find("GPano:PoseHeadingDegrees=\"80.000\""), std::string::npos);
}

TEST_F(Preview, IsMadeByTheOperatorAndExposureAskedFor) {
  ViewContext context;
  context.mode = "temporal";
  const std::string usual = Temporal(context, true);
  EXPECT_EQ(Temporal(context, true), usual);
  context.preview.tone_operator = ToneOperator::kDrago;
  EXPECT_NE(Temporal(context, true), usual);
  context.preview = {};
  context.preview.exposure_stops = -4.0;
  Temporal(context, true);
  const Result<DecodedImage> dark = ReadImage(directory_.path() / "preview.jpg");
  ASSERT_TRUE(dark);
  EXPECT_LT(std::get<Image<std::uint8_t>>(dark->pixels).at(32, 16), 60);
}

}  // namespace
}  // namespace omnihdr::preview_test
