#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/sphere/sphere_grid.h"
#include "daemon/cli/command.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::convert_test {
namespace {

namespace fs = std::filesystem;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// Smooth over the whole sphere.
double Scene(const Eigen::Vector3d& v, int channel) {
  return 120.0 + 60.0 * v.x() * v.y() + 30.0 * v.z() * (channel - 1) + 20.0 * v.y();
}

template <typename T>
Image<T> PictureOf(const SphereGrid& grid, double scale) {
  Image<T> picture(grid.width(), grid.height(), 3);
  for (int y = 0; y < grid.height(); ++y) {
    for (int x = 0; x < grid.width(); ++x) {
      const auto ray = grid.RayFromPixel(x + 0.5, y + 0.5);
      for (int c = 0; c < 3 && ray; ++c) {
        picture.at(x, y, c) = static_cast<T>(std::lround(scale * Scene(*ray, c)));
      }
    }
  }
  return picture;
}

// Largest difference to the scene over the pixels that show it.
template <typename T>
double WorstError(const SphereGrid& grid, const Image<T>& picture, double scale) {
  double worst = 0.0;
  for (int y = 0; y < grid.height(); ++y) {
    for (int x = 0; x < grid.width(); ++x) {
      const auto ray = grid.RayFromPixel(x + 0.5, y + 0.5);
      for (int c = 0; c < 3; ++c) {
        const double expected = ray ? scale * Scene(*ray, c) : 0.0;
        worst = std::max(worst, std::abs(picture.at(x, y, c) - expected) / scale);
      }
    }
  }
  return worst;
}

class Convert : public ::testing::Test {
 protected:
  // Empty when it succeeded.
  std::string Run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "convert");
    std::reverse(arguments.begin(), arguments.end());  // as CLI11 wants them
    CLI::App app;
    CommandRun run;
    AddConvertCommand(app, run);
    try {
      app.parse(arguments);
    } catch (const CLI::ParseError& error) {
      return std::string("usage: ") + error.what();
    }
    const Result<int> result = run();
    return result ? "" : result.error().message;
  }
  std::string File(const std::string& name) const { return (directory_.path() / name).string(); }
  void Write(const std::string& name, const Result<std::vector<std::byte>>& bytes) {
    ASSERT_TRUE(bytes);
    ASSERT_TRUE(WriteFileAtomic(File(name), *bytes));
  }
  void WriteLatLongExr(const std::string& name) {
    const SphereGrid grid = SphereGrid::Equirectangular(96, 48);
    const Image<float> rgb = PictureOf<float>(grid, 1.0);
    Image<float> origin(96, 48, 1, 1.0F);
    for (int y = 0; y < 48; ++y) {
      for (int x = 48; x < 96; ++x) origin.at(x, y) = 3.0F;
    }
    Image<float> disparity(96, 48, 1, 0.25F);
    for (int y = 0; y < 24; ++y) {
      for (int x = 0; x < 96; ++x) disparity.at(x, y) = kNan;
    }
    ExrAttributes attributes;
    attributes.strings["omnihdrCamera"] = "a camera";
    attributes.floats["expTime"] = 0.5;
    attributes.chromaticities = kRec709;
    ASSERT_TRUE(WriteExr(File(name),
                         {{"R", rgb, ExrPixelType::kHalf, 0},
                          {"G", rgb, ExrPixelType::kHalf, 1},
                          {"B", rgb, ExrPixelType::kHalf, 2},
                          {"disparity", disparity, ExrPixelType::kFloat, 0},
                          {"id", origin, ExrPixelType::kUint, 0},
                          {"origin", origin, ExrPixelType::kHalf, 0},
                          {"sources", origin, ExrPixelType::kHalf, 0}},
                         attributes));
  }
  testing::TemporaryDirectory directory_;
};

TEST_F(Convert, APictureGoesThroughEveryProjectionAndComesBack) {
  const SphereGrid grid = SphereGrid::Equirectangular(256, 128);
  Write("a.png", EncodePng(PictureOf<std::uint8_t>(grid, 1.0)));
  ASSERT_EQ(Run({File("a.png"), File("r.png"), "--to", "rdmap"}), "");
  ASSERT_EQ(Run({File("r.png"), File("c.png"), "--from", "rdmap", "--to", "cube"}), "");
  ASSERT_EQ(Run({File("c.png"), File("s.tif"), "--from", "cube", "--to", "cube-strip"}), "");
  ASSERT_EQ(Run({File("s.tif"), File("b.png"), "--to", "latlong", "--size", "256"}), "");
  const Result<DecodedImage> rd = ReadImage(File("r.png"));
  ASSERT_TRUE(rd);
  const auto rd_grid =
      SphereGrid::OfPicture(SphereGridKind::kRhombicDodecahedron, rd->width(), rd->height());
  ASSERT_TRUE(rd_grid) << rd_grid.error().message;
  EXPECT_LT(WorstError(*rd_grid, std::get<0>(rd->pixels), 1.0), 1.3);
  const Result<DecodedImage> cross = ReadImage(File("c.png"));
  ASSERT_TRUE(cross);
  const auto cross_grid =
      SphereGrid::OfPicture(SphereGridKind::kCubeCross, cross->width(), cross->height());
  ASSERT_TRUE(cross_grid) << cross_grid.error().message;
  EXPECT_LT(WorstError(*cross_grid, std::get<0>(cross->pixels), 1.0), 2.0);
  const Result<DecodedImage> back = ReadImage(File("b.png"));
  ASSERT_TRUE(back);
  EXPECT_LT(WorstError(grid, std::get<0>(back->pixels), 1.0), 3.0);
}

TEST_F(Convert, SixteenBitsStaySixteenBits) {
  const SphereGrid grid = SphereGrid::Equirectangular(256, 128);
  Write("a.png", EncodePng(PictureOf<std::uint16_t>(grid, 200.0)));
  ASSERT_EQ(Run({File("a.png"), File("r.tif"), "--to", "rdmap", "--size", "40"}), "");
  const Result<DecodedImage> rd = ReadImage(File("r.tif"));
  ASSERT_TRUE(rd);
  ASSERT_TRUE(rd->is_16_bit());
  EXPECT_LT(WorstError(SphereGrid::RhombicDodecahedron(40), std::get<1>(rd->pixels), 200.0), 0.1);
  EXPECT_NE(Run({File("a.png"), File("r.jpg"), "--to", "rdmap"})
                .find("JPEG holds 8 bits, expected .png or .tif"),
            std::string::npos);
}

TEST_F(Convert, AnExrKeepsItsChannelsTypesAndAttributes) {
  WriteLatLongExr("a.exr");
  ASSERT_EQ(Run({File("a.exr"), File("c.exr"), "--to", "cube", "--size", "20"}), "");
  const Result<ExrImage> cube = ReadExr(File("c.exr"));
  ASSERT_TRUE(cube) << cube.error().message;
  EXPECT_EQ(cube->width, 20);
  EXPECT_EQ(cube->height, 120);
  EXPECT_EQ(cube->attributes.envmap, ExrEnvmap::kCube);
  EXPECT_EQ(cube->attributes.strings.at("omnihdrCamera"), "a camera");
  EXPECT_EQ(cube->attributes.floats.at("expTime"), 0.5);
  EXPECT_TRUE(cube->attributes.chromaticities);
  EXPECT_EQ(cube->channels.size(), 7U);
  EXPECT_EQ(cube->types.at("R"), ExrPixelType::kHalf);
  EXPECT_EQ(cube->types.at("disparity"), ExrPixelType::kFloat);
  EXPECT_EQ(cube->types.at("id"), ExrPixelType::kUint);
  const SphereGrid grid = SphereGrid::CubeStrip(20);
  for (int y = 0; y < 120; ++y) {
    for (int x = 0; x < 20; ++x) {
      const Eigen::Vector3d ray = *grid.RayFromPixel(x + 0.5, y + 0.5);
      ASSERT_NEAR(cube->channels.at("G").at(x, y), Scene(ray, 1), 1.0);
      const float disparity = cube->channels.at("disparity").at(x, y);
      if (ray.z() > 0.05) {
        ASSERT_TRUE(std::isnan(disparity));
      } else if (ray.z() < -0.05) {
        ASSERT_FLOAT_EQ(disparity, 0.25F);
      }
      for (const char* labels : {"id", "origin", "sources"}) {
        const float label = cube->channels.at(labels).at(x, y);
        ASSERT_TRUE(label == 1.0F || label == 3.0F) << labels << " " << label;
      }
    }
  }
}

TEST_F(Convert, AnExrSaysItsProjectionAndIsReadBackWithoutBeingTold) {
  WriteLatLongExr("a.exr");
  const SphereGrid grid = SphereGrid::Equirectangular(96, 48);
  for (const char* kind : {"rdmap", "cube", "cube-cross", "cylinder"}) {
    ASSERT_EQ(Run({File("a.exr"), File("x.exr"), "--to", kind}), "") << kind;
    ASSERT_EQ(Run({File("x.exr"), File("b.exr"), "--to", "latlong", "--size", "96"}), "") << kind;
    const Result<ExrImage> back = ReadExr(File("b.exr"));
    ASSERT_TRUE(back);
    EXPECT_EQ(back->attributes.envmap, ExrEnvmap::kLatLong);
    EXPECT_FALSE(back->attributes.strings.contains("omnihdrProjection"));
    int missing = 0;
    for (int y = 0; y < 48; ++y) {
      for (int x = 0; x < 96; ++x) {
        const float got = back->channels.at("B").at(x, y);
        missing += std::isnan(got) ? 1 : 0;
        if (!std::isnan(got)) {
          ASSERT_NEAR(got, Scene(*grid.RayFromPixel(x + 0.5, y + 0.5), 2), 3.0) << kind;
        }
      }
    }
    // Only the cylinder, from −67° to 67°, does not show everything.
    const bool is_cylinder = std::string(kind) == "cylinder";
    EXPECT_NEAR(missing, is_cylinder ? 96 * 12 : 0, is_cylinder ? 96 * 2 : 0) << kind;
  }
}

TEST_F(Convert, ACylindersBandIsKept) {
  WriteLatLongExr("a.exr");
  ASSERT_EQ(Run({File("a.exr"), File("c.exr"), "--to", "cylinder", "--size", "120", "--z-range",
                 "-0.5", "1.5"}),
            "");
  const Result<ExrImage> cylinder = ReadExr(File("c.exr"));
  ASSERT_TRUE(cylinder);
  EXPECT_EQ(cylinder->width, 120);
  EXPECT_EQ(cylinder->height, 38);  // 120 · 2 / 2π
  EXPECT_EQ(cylinder->attributes.envmap, ExrEnvmap::kNone);
  EXPECT_EQ(cylinder->attributes.floats.at("omnihdrZMin"), -0.5);
  EXPECT_EQ(cylinder->attributes.floats.at("omnihdrZMax"), 1.5);
  const SphereGrid grid = SphereGrid::Cylindrical(120, 38, -0.5, 1.5);
  for (int y = 1; y < 37; ++y) {
    ASSERT_NEAR(cylinder->channels.at("R").at(30, y), Scene(*grid.RayFromPixel(30.5, y + 0.5), 0),
                1.0);
  }
}

TEST_F(Convert, WhatIsWrongIsSaidWithWhatWasExpected) {
  WriteLatLongExr("a.exr");
  Write("square.png", EncodePng(Image<std::uint8_t>(64, 64, 3)));
  Write("wide.png", EncodePng(Image<std::uint8_t>(64, 48, 3)));
  const auto expect = [this](const std::vector<std::string>& arguments, const std::string& text) {
    const std::string message = Run(arguments);
    EXPECT_NE(message.find(text), std::string::npos) << message;
  };
  expect({File("square.png"), File("o.png"), "--to", "rdmap"},
         "square.png: 64x64 pixels do not tell the projection, expected --from");
  expect({File("square.png"), File("o.png"), "--to", "rdmap", "--from", "latlong"},
         "square.png: as latlong: 64x64 pixels, expected a lat-long panorama of 2NxN");
  expect({File("a.exr"), File("o.png"), "--to", "rdmap"}, "o.png: expected .exr");
  expect({File("wide.png"), File("o.exr"), "--to", "rdmap"}, "o.exr: expected .png, .jpg or .tif");
  expect({File("wide.png"), File("o.webp"), "--to", "rdmap"}, "suffix \".webp\", expected .exr");
  expect({File("wide.png"), File("o.png"), "--from", "rdmap", "--to", "latlong", "--size", "5"},
         "--size: 5, expected an even width");
  expect({File("wide.png"), File("o.png"), "--from", "rdmap", "--to", "cube", "--size", "65536"},
         "expected at most");
  expect(
      {File("wide.png"), File("o.png"), "--from", "rdmap", "--to", "cube", "--z-range", "0", "1"},
      "--z-range: with --to cube, expected --to cylinder");
  expect({File("wide.png"), File("o.png"), "--from", "cylinder", "--to", "cube", "--from-z-range",
          "1", "0"},
         "--from-z-range: 1 0, expected two rising numbers");
  expect({File("missing.png"), File("o.png"), "--to", "cube"}, "missing.png");
  expect({File("wide.png"), File("o.png"), "--to", "mercator"}, "usage");
  expect({File("wide.png"), File("o.png")}, "usage");
  EXPECT_FALSE(fs::exists(File("o.png")));
}

}  // namespace
}  // namespace omnihdr::convert_test
