#include "daemon/evaluation/comparison.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>
#include <string>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::comparison_test {
namespace {

namespace fs = std::filesystem;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

class ComparisonOfPictures : public ::testing::Test {
 protected:
  fs::path Path(const std::string& name) const { return directory_.path() / name; }

  fs::path WriteMap(const std::string& name, const Image<float>& radiance) const {
    const Status written = WriteExr(Path(name),
                                    {{"R", radiance, ExrPixelType::kFloat, 0},
                                     {"G", radiance, ExrPixelType::kFloat, 1},
                                     {"B", radiance, ExrPixelType::kFloat, 2}},
                                    {});
    EXPECT_TRUE(written);
    return Path(name);
  }
  fs::path WriteCodes(const std::string& name, const Image<std::uint8_t>& codes) const {
    const auto png = EncodePng(codes.view());
    EXPECT_TRUE(png && WriteFileAtomic(Path(name), *png));
    return Path(name);
  }

  testing::TemporaryDirectory directory_;
};

Image<float> Map(int width, int height, unsigned seed = 1) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<float> log_radiance(-3.0F, 3.0F);
  Image<float> map(width, height, 3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float level = std::exp(log_radiance(generator));
      map.at(x, y, 0) = level;
      map.at(x, y, 1) = 0.9F * level;
      map.at(x, y, 2) = 0.5F * level;
    }
  }
  return map;
}

TEST_F(ComparisonOfPictures, APictureIsIdenticalToItself) {
  Image<float> map = Map(40, 20);
  map.at(3, 3, 1) = kNaN;
  const fs::path file = WriteMap("a.exr", map);
  const Result<Comparison> c = ComparePictures(file, file, {});
  ASSERT_TRUE(c) << c.error().message;
  EXPECT_TRUE(c->is_identical);
  EXPECT_TRUE(c->on_sphere);
  EXPECT_EQ(c->psnr_db, std::numeric_limits<double>::infinity());
  EXPECT_NEAR(c->ssim, 1.0, 1e-12);
  EXPECT_EQ(c->radiance.log10_max, 0.0);
  EXPECT_LT(c->compared, 1.0);
  EXPECT_NE(FormatComparisonTable(*c).find("infinite"), std::string::npos);
  const auto json = nlohmann::json::parse(FormatComparisonJson(*c));
  EXPECT_TRUE(json["identical"].get<bool>());
  EXPECT_TRUE(json["psnr_db"].is_null());
}

TEST_F(ComparisonOfPictures, AFactorIsFoundAndTakenOutUnlessItIsWanted) {
  const Image<float> map = Map(30, 20);
  Image<float> doubled = map.Clone();
  for (float& value : doubled.values()) value *= 2.0F;
  const fs::path a = WriteMap("a.exr", doubled);
  const fs::path b = WriteMap("b.exr", map);
  const Result<Comparison> fitted = ComparePictures(a, b, {});
  ASSERT_TRUE(fitted) << fitted.error().message;
  EXPECT_NEAR(fitted->radiance.scale, 0.5, 1e-6);
  EXPECT_NEAR(fitted->radiance.log10_rmse, 0.0, 1e-6);
  EXPECT_NEAR(fitted->radiance.log10_rmse_unscaled, std::log10(2.0), 1e-6);
  EXPECT_FALSE(fitted->is_identical);
  ComparisonOptions as_is;
  as_is.scale = ScaleFit::kNone;
  const Result<Comparison> plain = ComparePictures(a, b, as_is);
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain->radiance.scale, 1.0);
  EXPECT_NEAR(plain->radiance.log10_rmse, std::log10(2.0), 1e-6);
  EXPECT_NEAR(plain->radiance.log10_p50, std::log10(2.0), 1e-6);
  EXPECT_LT(plain->psnr_mu_db, fitted->psnr_mu_db);
  EXPECT_LT(plain->ssim, 0.99);
}

TEST_F(ComparisonOfPictures, OnASphereTheEquatorCountsMore) {
  // Wrong by a factor of ten in the top sixth of the rows: by area 6.7 % of the sphere.
  const Image<float> map = Map(120, 60);
  Image<float> wrong = map.Clone();
  for (int y = 0; y < 10; ++y) {
    for (int i = 0; i < 3 * 120; ++i) wrong.row(y)[i] *= 10.0F;
  }
  const fs::path a = WriteMap("a.exr", wrong);
  const fs::path b = WriteMap("b.exr", map);
  const Result<Comparison> sphere = ComparePictures(a, b, {});
  ComparisonOptions planar;
  planar.area = ComparisonOptions::Area::kPlane;
  const Result<Comparison> plane = ComparePictures(a, b, planar);
  ASSERT_TRUE(sphere && plane);
  EXPECT_NEAR(sphere->radiance.log10_rmse, std::sqrt((1.0 - std::cos(M_PI / 6.0)) / 2.0), 1e-4);
  EXPECT_NEAR(plane->radiance.log10_rmse, std::sqrt(1.0 / 6.0), 1e-4);
}

TEST_F(ComparisonOfPictures, OnlyTheMaskedInPartCounts) {
  const Image<float> map = Map(40, 30);
  Image<float> wrong = map.Clone();
  for (int y = 0; y < 15; ++y) {
    for (int i = 0; i < 3 * 40; ++i) wrong.row(y)[i] *= 5.0F;
  }
  Image<std::uint8_t> mask(40, 30, 1, 0);
  for (int y = 15; y < 30; ++y) std::fill_n(mask.row(y), 40, std::uint8_t{255});
  ComparisonOptions options;
  options.mask = WriteCodes("mask.png", mask);
  const Result<Comparison> c =
      ComparePictures(WriteMap("a.exr", wrong), WriteMap("b.exr", map), options);
  ASSERT_TRUE(c) << c.error().message;
  EXPECT_EQ(c->radiance.log10_max, 0.0);
  EXPECT_EQ(c->compared, 1.0);
}

TEST_F(ComparisonOfPictures, CodeValuesAreComparedOnTheirOwnScale) {
  const Image<std::uint8_t> a(20, 20, 3, 100);
  const Image<std::uint8_t> b(20, 20, 3, 110);
  const Result<Comparison> c = ComparePictures(WriteCodes("a.png", a), WriteCodes("b.png", b), {});
  ASSERT_TRUE(c) << c.error().message;
  EXPECT_FALSE(c->is_radiance);
  EXPECT_NEAR(c->psnr_db, 20.0 * std::log10(255.0 / 10.0), 1e-9);
  const double c1 = 2.55 * 2.55;
  EXPECT_NEAR(c->ssim, (2.0 * 100.0 * 110.0 + c1) / (100.0 * 100.0 + 110.0 * 110.0 + c1), 1e-9);
  EXPECT_NEAR(c->difference.at(5, 5), -10.0F / 255.0F, 1e-6F);
  const Image<std::uint8_t> picture = DifferencePicture(*c, 10.0 / 255.0);
  EXPECT_EQ(picture.at(5, 5, 2), 255);  // darker: blue
  EXPECT_EQ(picture.at(5, 5, 0), 0);
}

TEST_F(ComparisonOfPictures, AViewsDirectoryIsItsRadianceAndDisparity) {
  const Image<float> map = Map(40, 20);
  const Image<float> disparity(40, 20, 1, 0.5F);
  const Image<float> nearer(40, 20, 1, 0.6F);
  for (const auto& [name, values] :
       {std::pair<std::string, const Image<float>&>{"one", disparity}, {"two", nearer}}) {
    fs::create_directories(Path(name));
    WriteMap(name + "/radiance.exr", map);
    ASSERT_TRUE(WriteExr(Path(name) / "disparity.exr",
                         {{"disparity", values, ExrPixelType::kFloat, 0}}, {}));
  }
  const Result<Comparison> c = ComparePictures(Path("two"), Path("one"), {});
  ASSERT_TRUE(c) << c.error().message;
  ASSERT_TRUE(c->disparity);
  EXPECT_NEAR(c->disparity->median_relative, 0.2, 1e-5);
}

TEST_F(ComparisonOfPictures, WhatCannotBeComparedIsAnErrorThatSaysWhy) {
  const fs::path map = WriteMap("a.exr", Map(40, 20));
  const fs::path small = WriteMap("b.exr", Map(20, 20));
  const fs::path codes = WriteCodes("c.png", Image<std::uint8_t>(40, 20, 3));
  const auto message = [](const Result<Comparison>& c) {
    EXPECT_FALSE(c);
    return c ? std::string() : c.error().message;
  };
  EXPECT_NE(message(ComparePictures(map, small, {})).find("40x20, expected 20x20"),
            std::string::npos);
  EXPECT_NE(message(ComparePictures(map, codes, {})).find("expected 8-bit code values"),
            std::string::npos);
  EXPECT_NE(message(ComparePictures(Path("nowhere.exr"), map, {})).find("nowhere.exr"),
            std::string::npos);
  ComparisonOptions options;
  options.mask = WriteCodes("mask.png", Image<std::uint8_t>(7, 7, 1));
  EXPECT_NE(message(ComparePictures(map, map, options)).find("expected an 8-bit picture of 40x20"),
            std::string::npos);
  std::ofstream(Path("text.exr")) << "hello";
  EXPECT_NE(message(ComparePictures(Path("text.exr"), map, {})).find("nor an EXR"),
            std::string::npos);
}

TEST_F(ComparisonOfPictures, NothingInCommonIsNoNumberAndNoCrash) {
  const fs::path unknown = WriteMap("a.exr", Image<float>(20, 20, 3, kNaN));
  const fs::path black = WriteMap("b.exr", Image<float>(20, 20, 3, 0.0F));
  for (const auto& [a, b] : {std::pair{unknown, black}, {black, black}}) {
    const Result<Comparison> c = ComparePictures(a, b, {});
    ASSERT_TRUE(c) << c.error().message;
    EXPECT_TRUE(std::isnan(c->psnr_mu_db));
    EXPECT_FALSE(FormatComparisonTable(*c).empty());
    EXPECT_TRUE(nlohmann::json::parse(FormatComparisonJson(*c))["ssim"].is_null());
    EXPECT_FALSE(DifferencePicture(*c, 0.3).empty());
  }
}

// scikit-image is another implementation of the same paper. It is no dependency: the test is
// skipped where it is not installed (Debian: python3-skimage).
TEST_F(ComparisonOfPictures, SsimAgreesWithScikitImageOnRealPictures) {
  const fs::path data = fs::path(OMNIHDR_SOURCE_DIR) / ".." / "shared" / "data";
  const std::array<std::pair<fs::path, fs::path>, 2> pairs = {
      std::pair{data / "memorial/memorial0064.png", data / "memorial/memorial0065.png"},
      std::pair{data / "360sdnet/image_up/room.png", data / "360sdnet/image_down/room.png"}};
  const std::string python = "/usr/bin/python3";
  if (std::system((python + " -c 'import skimage.metrics, skimage.io' 2>&1").c_str()) != 0) {
    GTEST_SKIP() << "SKIPPED: no scikit-image (python3-skimage) to compare SSIM with";
  }
  std::ofstream(Path("ssim.py")) << R"(
import sys
import numpy
from skimage.io import imread
from skimage.metrics import structural_similarity
def luma(name):
    p = imread(name)[..., :3].astype(numpy.float64)
    # Rounded to single precision, as the tested program keeps its pictures.
    return (p @ numpy.array([0.299, 0.587, 0.114])).astype(numpy.float32).astype(numpy.float64)
print('%.12f' % structural_similarity(luma(sys.argv[1]), luma(sys.argv[2]), data_range=255.0,
      gaussian_weights=True, sigma=1.5, use_sample_covariance=False))
)";
  int compared = 0;
  for (const auto& [a, b] : pairs) {
    if (!fs::exists(a) || !fs::exists(b)) continue;
    const std::string output = Path("ssim.txt").string();
    const std::string command = python + " '" + Path("ssim.py").string() + "' '" + a.string() +
                                "' '" + b.string() + "' > '" + output + "'";
    ASSERT_EQ(std::system(command.c_str()), 0) << command;
    double expected = 0.0;
    std::ifstream(output) >> expected;
    ComparisonOptions options;
    options.area = ComparisonOptions::Area::kPlane;
    const Result<Comparison> c = ComparePictures(a, b, options);
    ASSERT_TRUE(c) << c.error().message;
    EXPECT_GT(expected, 0.1);
    EXPECT_LT(expected, 0.999);
    EXPECT_NEAR(c->ssim, expected, 1e-9) << a;
    RecordProperty("ssim_" + std::to_string(compared), std::to_string(c->ssim));
    ++compared;
  }
  if (compared == 0) GTEST_SKIP() << "SKIPPED: no recorded pictures at " << data.lexically_normal();
}

}  // namespace
}  // namespace omnihdr::comparison_test
