#include "core/photometry/color_chart.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "tests/support/chart_scene.h"

namespace omnihdr::color_chart_test {
namespace {

Pose Turned(double roll_deg, double yaw_deg, double pitch_deg, const Eigen::Vector3d& at) {
  constexpr double kRadians = 0.017453292519943295;
  return {Eigen::Quaterniond(Eigen::AngleAxisd(roll_deg * kRadians, Eigen::Vector3d::UnitZ()) *
                             Eigen::AngleAxisd(yaw_deg * kRadians, Eigen::Vector3d::UnitY()) *
                             Eigen::AngleAxisd(pitch_deg * kRadians, Eigen::Vector3d::UnitX())),
          at};
}

SensorPicture PictureOf(const RenderedChart& rendered, const ChartScene& scene) {
  return *MakeSensorPicture(rendered.image, scene.bits, scene.bayer, 0, scene.height);
}

double WorstError(const ChartDetection& found, const RenderedChart& truth) {
  double worst = 0.0;
  for (int p = 0; p < kChartPatches; ++p) {
    worst = std::max(
        worst, (found.geometry.PatchCentre(p) - truth.centres[static_cast<std::size_t>(p)]).norm());
  }
  return worst / truth.patch_side;
}

struct Case {
  const char* name;
  ChartScene scene;
};

std::vector<Case> Cases() {
  std::vector<Case> cases;
  ChartScene plain;
  plain.noise = 1.0;
  cases.push_back({"straight", plain});
  ChartScene dark = plain;
  dark.exposure = 0.12;
  dark.camera_from_chart = Turned(200.0, 20.0, -15.0, {0.05, -0.03, 0.8});
  cases.push_back({"dark and upside down", dark});
  ChartScene bright = plain;
  bright.exposure = 1.8;
  bright.srgb = true;
  bright.camera_from_chart = Turned(95.0, -25.0, 20.0, {0.0, 0.0, 0.7});
  cases.push_back({"overexposed white patches", bright});
  ChartScene slanted = plain;
  slanted.gain = {0.55, 1.0, 0.7};
  slanted.crosstalk = 0.25;
  slanted.shading = 0.4;
  slanted.noise = 3.0;
  slanted.camera_from_chart = Turned(-40.0, 40.0, 30.0, {0.1, 0.05, 0.8});
  cases.push_back({"slanted, unbalanced, shaded and noisy", slanted});
  ChartScene fisheye = plain;
  fisheye.fisheye = true;
  fisheye.focal = 225.0;
  fisheye.camera_from_chart = Turned(30.0, -20.0, 25.0, {0.08, 0.06, 0.35});
  cases.push_back({"fisheye", fisheye});
  ChartScene bayer = plain;
  bayer.bayer = BayerOrder::kGbrg;
  bayer.bits = 12;
  bayer.camera_from_chart = Turned(-75.0, 15.0, 10.0, {0.0, 0.02, 0.6});
  cases.push_back({"Bayer of 12 bits", bayer});
  ChartScene mirrored = slanted;
  mirrored.mirrored = true;
  cases.push_back({"mirrored", mirrored});
  return cases;
}

class ColorChartViews : public ::testing::TestWithParam<std::size_t> {};

TEST_P(ColorChartViews, IsFoundToATenthOfAPatch) {
  const Case c = Cases()[GetParam()];
  const RenderedChart rendered = RenderChart(c.scene);
  const Result<ChartDetection> found = DetectColorChart(PictureOf(rendered, c.scene), {});
  ASSERT_TRUE(found) << c.name << ": " << found.error().message;
  EXPECT_LT(WorstError(*found, rendered), 0.1) << c.name;
  EXPECT_EQ(found->mirrored, c.scene.mirrored) << c.name;
  EXPECT_GT(found->agreement, 0.9) << c.name;
  EXPECT_FALSE(found->from_corners);
}

INSTANTIATE_TEST_SUITE_P(ColorChart, ColorChartViews,
                         ::testing::Range(std::size_t{0}, Cases().size()));

TEST(ColorChart, ReportsHowItIsTurned) {
  for (const double roll : {0.0, 90.0, 180.0, 270.0}) {
    ChartScene scene;
    scene.camera_from_chart = Turned(roll, 0.0, 0.0, {0.0, 0.0, 0.9});
    const Result<ChartDetection> found = DetectColorChart(PictureOf(RenderChart(scene), scene), {});
    ASSERT_TRUE(found) << found.error().message;
    const double off = std::remainder(found->rotation_deg - roll, 360.0);
    EXPECT_NEAR(off, 0.0, 0.5) << roll;
  }
}

TEST(ColorChart, IsNotFoundWhereThereIsNoneAndTheErrorSaysWhatWasSeen) {
  ChartScene scene;
  scene.chart = false;
  for (const std::uint32_t seed : {1U, 2U, 3U}) {
    scene.seed = seed;
    const Result<ChartDetection> found = DetectColorChart(PictureOf(RenderChart(scene), scene), {});
    ASSERT_FALSE(found);
    EXPECT_EQ(found.error().kind, ErrorKind::kData);
    EXPECT_NE(found.error().message.find("even areas"), std::string::npos);
    EXPECT_NE(found.error().message.find("--corners"), std::string::npos);
  }
}

// A checkerboard of the chart's own shape but of other colours.
TEST(ColorChart, AGridOfOtherColoursIsNone) {
  ChartScene scene;
  RenderedChart rendered = RenderChart(scene);
  auto& pixels = std::get<Image<std::uint8_t>>(rendered.image.pixels);
  for (int y = 0; y < pixels.height(); ++y) {
    for (int x = 0; x < pixels.width(); ++x) std::swap(pixels.at(x, y, 0), pixels.at(x, y, 1));
  }
  EXPECT_FALSE(DetectColorChart(PictureOf(rendered, scene), {}));
}

TEST(ColorChart, IsNotFoundInRealPicturesWithoutOne) {
  const std::filesystem::path data = OMNIHDR_SOURCE_DIR "/../shared/data";
  if (!std::filesystem::is_directory(data)) GTEST_SKIP() << data << " is not there";
  for (const char* name : {"memorial/memorial0068.png", "middlebury/Art/view1.png",
                           "middlebury/Cones/im2.png", "360sdnet/image_up/room.png"}) {
    const Result<DecodedImage> image = ReadImage(data / name);
    ASSERT_TRUE(image) << image.error().message;
    const SensorPicture picture =
        *MakeSensorPicture(*image, 8, BayerOrder::kNone, 0, image->height());
    EXPECT_FALSE(DetectColorChart(picture, {})) << name;
  }
}

TEST(ColorChart, RoughCornersAreDrawnToThePatchesEdges) {
  ChartScene scene;
  scene.fisheye = true;
  scene.focal = 225.0;
  scene.camera_from_chart = Turned(30.0, -20.0, 25.0, {0.08, 0.06, 0.35});
  const RenderedChart rendered = RenderChart(scene);
  std::array<Eigen::Vector2d, 4> corners = {rendered.centres[0], rendered.centres[5],
                                            rendered.centres[23], rendered.centres[18]};
  for (Eigen::Vector2d& corner : corners) corner += Eigen::Vector2d(2.0, -2.0);
  const Result<ChartDetection> found = ColorChartAtCorners(PictureOf(rendered, scene), corners, {});
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_TRUE(found->from_corners);
  EXPECT_LT(WorstError(*found, rendered), 0.1);
}

TEST(ColorChart, CornersInAnotherOrderOrOutsideAreRefusedWithTheReason) {
  ChartScene scene;
  const RenderedChart rendered = RenderChart(scene);
  const SensorPicture picture = PictureOf(rendered, scene);
  const auto& c = rendered.centres;
  const Result<ChartDetection> turned =
      ColorChartAtCorners(picture, {c[23], c[18], c[0], c[5]}, {});
  ASSERT_FALSE(turned);
  EXPECT_NE(turned.error().message.find("dark skin"), std::string::npos);
  const Result<ChartDetection> crossed =
      ColorChartAtCorners(picture, {c[0], c[23], c[5], c[18]}, {});
  ASSERT_FALSE(crossed);
  EXPECT_EQ(crossed.error().kind, ErrorKind::kUsage);
  const Result<ChartDetection> outside =
      ColorChartAtCorners(picture, {Eigen::Vector2d(-5.0, 3.0), c[5], c[23], c[18]}, {});
  ASSERT_FALSE(outside);
  EXPECT_EQ(outside.error().kind, ErrorKind::kUsage);
}

TEST(ColorChart, PatchesReadTheLightThatFellOnThem) {
  ChartScene scene;
  scene.gain = {0.6, 1.0, 0.75};
  scene.noise = 1.0;
  for (const BayerOrder bayer : {BayerOrder::kNone, BayerOrder::kRggb, BayerOrder::kBggr}) {
    scene.bayer = bayer;
    const RenderedChart rendered = RenderChart(scene);
    const SensorPicture picture = PictureOf(rendered, scene);
    const Result<ChartDetection> found = DetectColorChart(picture, {});
    ASSERT_TRUE(found) << found.error().message;
    const Result<ChartMeasurement> measured =
        MeasureChart(picture, found->geometry, *Response::Linear(), {});
    ASSERT_TRUE(measured) << measured.error().message;
    for (int p = 0; p < kChartPatches; ++p) {
      const std::array<double, 3> light = ChartLinearLight(p);
      for (std::size_t c = 0; c < 3; ++c) {
        const PatchChannel& patch = (*measured)[static_cast<std::size_t>(p)][c];
        const double value = 255.0 * scene.exposure * scene.gain[c] * light[c];
        EXPECT_NEAR(patch.mean, value, 0.01 * value + 0.3) << p << " channel " << c;
        EXPECT_NEAR(patch.exposure, patch.mean / 128.0, 1e-9);
      }
    }
    EXPECT_GT((*measured)[18][1].noise, 0.4);
    EXPECT_LT((*measured)[18][1].noise, 2.5);
  }
}

TEST(ColorChart, ClippedAndDarkPatchesAreNotUsable) {
  ChartScene scene;
  scene.exposure = 1.5;  // white clips: 255 · 1.5 · 0.9
  const RenderedChart rendered = RenderChart(scene);
  const SensorPicture picture = PictureOf(rendered, scene);
  const Result<ChartDetection> found = DetectColorChart(picture, {});
  ASSERT_TRUE(found) << found.error().message;
  const ChartMeasurement bright = *MeasureChart(picture, found->geometry, *Response::Linear(), {});
  EXPECT_FALSE(bright[18][1].usable);
  EXPECT_GT(bright[18][1].clipped, 0.99);
  EXPECT_TRUE(bright[20][1].usable);
  scene.exposure = 0.1;  // black reads below one code value
  const RenderedChart dark_picture = RenderChart(scene);
  const ChartMeasurement dark =
      *MeasureChart(PictureOf(dark_picture, scene), found->geometry, *Response::Linear(), {});
  EXPECT_FALSE(dark[23][1].usable);
  EXPECT_TRUE(dark[18][1].usable);
}

TEST(ColorChart, AChartTooSmallToMeasureIsRefused) {
  ChartScene scene;
  const RenderedChart rendered = RenderChart(scene);
  std::vector<Eigen::Vector2d> chart;
  std::vector<Eigen::Vector2d> pixels;
  for (const auto& [u, v] : {std::pair{0.0, 0.0}, {6.0, 0.0}, {6.0, 4.0}, {0.0, 4.0}}) {
    chart.emplace_back(u, v);
    pixels.emplace_back(100.0 + 4.0 * u, 100.0 + 4.0 * v);
  }
  const auto geometry = ChartGeometry::Fit(chart, pixels, scene.width, scene.height, false);
  ASSERT_TRUE(geometry);
  const Result<ChartMeasurement> measured =
      MeasureChart(PictureOf(rendered, scene), *geometry, *Response::Linear(), {});
  ASSERT_FALSE(measured);
  EXPECT_NE(measured.error().message.find("too small"), std::string::npos);
}

TEST(ChartGeometry, RecoversPerspectiveAndDistortion) {
  ChartScene scene;
  scene.fisheye = true;
  scene.focal = 225.0;
  scene.camera_from_chart = Turned(30.0, -20.0, 25.0, {0.08, 0.06, 0.35});
  scene.width = scene.height = 64;  // only the geometry is of interest
  scene.focal = 30.0;
  const RenderedChart rendered = RenderChart(scene);
  std::vector<Eigen::Vector2d> chart;
  for (int p = 0; p < kChartPatches; ++p) {
    chart.emplace_back(p % kChartColumns + 0.5, p / kChartColumns + 0.5);
  }
  const std::vector<Eigen::Vector2d> pixels(rendered.centres.begin(), rendered.centres.end());
  const auto with = ChartGeometry::Fit(chart, pixels, 64, 64, true);
  const auto without = ChartGeometry::Fit(chart, pixels, 64, 64, false);
  ASSERT_TRUE(with && without);
  double worst_with = 0.0;
  double worst_without = 0.0;
  for (std::size_t p = 0; p < kChartPatches; ++p) {
    worst_with = std::max(worst_with, (with->PixelFromChart(chart[p]) - pixels[p]).norm());
    worst_without = std::max(worst_without, (without->PixelFromChart(chart[p]) - pixels[p]).norm());
  }
  EXPECT_LT(worst_with, 0.02 * rendered.patch_side);
  EXPECT_LT(worst_with, 0.5 * worst_without);
  EXPECT_LT(with->lambda(), -0.01);
}

TEST(ChartGeometry, PointsOnALineFitNoChart) {
  const std::vector<Eigen::Vector2d> line = {{0.5, 0.5}, {1.5, 0.5}, {2.5, 0.5}, {3.5, 0.5}};
  EXPECT_FALSE(ChartGeometry::Fit(line, line, 100, 100, false));
}

}  // namespace
}  // namespace omnihdr::color_chart_test
