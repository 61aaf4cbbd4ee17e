// tonemap, picture and compare, called as from the command line.
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "daemon/cli/command.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::picture_commands_test {
namespace {

namespace fs = std::filesystem;

class PictureCommands : public ::testing::Test {
 protected:
  void SetUp() override {
    Image<float> radiance(64, 32, 3);
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 64; ++x) {
        std::fill_n(radiance.pixel(x, y), 3, std::pow(10.0F, static_cast<float>(x) / 16.0F));
      }
    }
    const Image<float> origin(64, 32, 1, 1.0F);
    Image<float> disparity(64, 32, 1, 0.25F);
    disparity.at(3, 3) = std::numeric_limits<float>::quiet_NaN();
    ASSERT_TRUE(WriteExr(Path("radiance.exr"),
                         {{"R", radiance, ExrPixelType::kFloat, 0},
                          {"G", radiance, ExrPixelType::kFloat, 1},
                          {"B", radiance, ExrPixelType::kFloat, 2},
                          {"origin", origin, ExrPixelType::kHalf, 0}},
                         {}));
    ASSERT_TRUE(WriteExr(Path("disparity.exr"),
                         {{"disparity", disparity, ExrPixelType::kFloat, 0},
                          {"confidence", disparity, ExrPixelType::kHalf, 0}},
                         {}));
  }

  fs::path Path(const std::string& name) const { return directory_.path() / name; }

  // The outcome of `omnihdr WORDS`; an error of parsing is kUsage.
  static Result<int> Run(std::vector<std::string> words) {
    CLI::App app("omnihdr");
    CommandRun run;
    for (const AddCommand add : {AddToneMapCommand, AddPictureCommand, AddCompareCommand}) {
      add(app, run);
    }
    std::reverse(words.begin(), words.end());
    try {
      app.parse(std::move(words));
    } catch (const CLI::ParseError& error) {
      return Fail(ErrorKind::kUsage, "{}", error.what());
    }
    return run();
  }

  std::string Bytes(const std::string& name) const {
    std::ifstream file(Path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  testing::TemporaryDirectory directory_;
};

TEST_F(PictureCommands, ToneMapsWithEveryOperatorToPngAndToAPhotoSphere) {
  for (const std::string name : {"reinhard", "reinhard-local", "drago", "durand"}) {
    const Result<int> png = Run({"tonemap", Path("radiance.exr").string(),
                                 Path(name + ".png").string(), "--operator", name});
    ASSERT_TRUE(png) << png.error().message;
    const Result<DecodedImage> picture = ReadImage(Path(name + ".png"));
    ASSERT_TRUE(picture) << picture.error().message;
    const auto& pixels = std::get<Image<std::uint8_t>>(picture->pixels);
    EXPECT_LT(pixels.at(2, 16), pixels.at(60, 16));
    // The view's directory stands for its radiance.
    const Result<int> jpeg = Run(
        {"tonemap", directory_.path().string(), Path(name + ".jpg").string(), "--operator", name});
    ASSERT_TRUE(jpeg) << jpeg.error().message;
    EXPECT_NE(Bytes(name + ".jpg").find("GPano:ProjectionType=\"equirectangular\""),
              std::string::npos);
  }
}

TEST_F(PictureCommands, TheHeadingAndTheShapeReachTheFile) {
  ASSERT_TRUE(Run(
      {"tonemap", Path("radiance.exr").string(), Path("a.jpg").string(), "--heading", "123.5"}));
  EXPECT_NE(Bytes("a.jpg").find("GPano:PoseHeadingDegrees=\"123.500\""), std::string::npos);
  ASSERT_TRUE(Run(
      {"tonemap", Path("radiance.exr").string(), Path("b.jpg").string(), "--shape", "cylinder"}));
  EXPECT_EQ(Bytes("b.jpg").find("GPano"), std::string::npos) << "no viewer knows cylinders";
  const Result<int> both =
      Run({"tonemap", Path("radiance.exr").string(), Path("c.png").string(), "--heading", "10"});
  ASSERT_FALSE(both);
  EXPECT_EQ(both.error().kind, ErrorKind::kUsage);
}

TEST_F(PictureCommands, TheExposureMakesItBrighter) {
  const auto mean = [this](const std::string& name) {
    const Result<DecodedImage> picture = ReadImage(Path(name));
    double sum = 0.0;
    if (picture) {
      for (const std::uint8_t v : std::get<Image<std::uint8_t>>(picture->pixels).values()) sum += v;
    }
    return sum;
  };
  ASSERT_TRUE(Run({"tonemap", Path("radiance.exr").string(), Path("a.png").string()}));
  ASSERT_TRUE(
      Run({"tonemap", Path("radiance.exr").string(), Path("b.png").string(), "--exposure", "2"}));
  EXPECT_GT(mean("b.png"), 1.1 * mean("a.png"));
}

TEST_F(PictureCommands, DrawEveryMapOfAView) {
  for (const std::string what : {"radiance", "disparity", "confidence", "mask"}) {
    const Result<int> drawn = Run({"picture", directory_.path().string(), "--what", what, "--out",
                                   Path(what + ".png").string()});
    ASSERT_TRUE(drawn) << drawn.error().message;
    const Result<DecodedImage> picture = ReadImage(Path(what + ".png"));
    ASSERT_TRUE(picture);
    EXPECT_EQ(picture->width(), 64);
    EXPECT_GT(picture->height(), 32);
  }
}

TEST_F(PictureCommands, CompareWritesTheDifference) {
  const std::string view = directory_.path().string();
  ASSERT_TRUE(Run({"compare", view, view, "--diff", Path("d.png").string(), "--json"}));
  const Result<DecodedImage> picture = ReadImage(Path("d.png"));
  ASSERT_TRUE(picture);
  EXPECT_EQ(std::get<Image<std::uint8_t>>(picture->pixels).at(10, 10, 0), 255);  // equal: white
}

TEST_F(PictureCommands, AWrongCallIsOneMessageThatNamesWhatIsWrong) {
  const std::string map = Path("radiance.exr").string();
  const struct {
    std::vector<std::string> words;
    ErrorKind kind;
    std::string named;
  } calls[] = {
      {{"tonemap", map, Path("a.gif").string()}, ErrorKind::kUsage, "a.gif"},
      {{"tonemap", map, Path("a.png").string(), "--operator", "gamma"}, ErrorKind::kUsage, "gamma"},
      {{"tonemap", map, Path("a.png").string(), "--key", "0"}, ErrorKind::kUsage, "key"},
      {{"tonemap", Path("no.exr").string(), Path("a.png").string()}, ErrorKind::kNoInput, "no.exr"},
      {{"tonemap", map, Path("no/a.png").string()}, ErrorKind::kCannotCreate, "no/a.png"},
      {{"picture", map, "--what", "disparity", "--out", Path("a.png").string()},
       ErrorKind::kData,
       "disparity"},
      {{"picture", map, "--min", "5", "--max", "1", "--out", Path("a.png").string()},
       ErrorKind::kUsage,
       "min"},
      {{"compare", map, map, "--planar", "--latlong"}, ErrorKind::kUsage, "planar"},
      {{"compare", map, map, "--full", "1"}, ErrorKind::kUsage, "diff"},
  };
  for (const auto& call : calls) {
    const Result<int> result = Run(call.words);
    ASSERT_FALSE(result) << call.named;
    EXPECT_EQ(result.error().kind, call.kind) << result.error().message;
    EXPECT_NE(result.error().message.find(call.named), std::string::npos) << result.error().message;
  }
}

}  // namespace
}  // namespace omnihdr::picture_commands_test
