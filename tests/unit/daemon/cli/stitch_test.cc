// omnihdr stitch, called as from the command line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/session/rig_file.h"
#include "core/sphere/sphere_grid.h"
#include "daemon/cli/command.h"
#include "tests/support/ring.h"
#include "tests/support/temporary_directory.h"
#include "tests/unit/daemon/cli/run_command.h"

namespace omnihdr::stitch_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr double kFar = 10.0;

Eigen::Vector3d Smooth(const Eigen::Vector3d& point) {
  const Eigen::Vector3d u = point.normalized();
  return {1.0 + 0.4 * u.x() + 0.2 * std::sin(3.0 * u.y()), 0.9 + 0.3 * u.y() - 0.2 * u.z(),
          0.8 + 0.3 * u.z() + 0.2 * std::cos(4.0 * u.x())};
}

struct Errors {
  double largest = 0.0;
  int seen = 0;
  int unseen = 0;
};

class StitchCommand : public ::testing::Test {
 protected:
  void SetUp() override {
    rig_ = testing::MakeRing();
    WriteRig(rig_);
    Shoot("all", rig_, Smooth, 1.0);
  }

  std::string Path(const std::string& name) const { return (directory_.path() / name).string(); }
  void WriteRig(const Rig& rig) const {
    ASSERT_TRUE(WriteFileAtomic(Path("rig.toml"), FormatRig(rig)));
  }

  template <typename T>
  void WritePng(const std::string& name, ImageView<T> image) const {
    const auto bytes = EncodePng(ImageView<const std::remove_const_t<T>>(image));
    ASSERT_TRUE(bytes);
    ASSERT_TRUE(WriteFileAtomic(Path(name), *bytes));
  }

  // NAME.png, the stacked frame, and NAME0.png ... for each sensor.
  void Shoot(const std::string& name, const Rig& rig, const testing::RadianceAt& scene,
             double seconds, int bits = 8) const {
    const DecodedImage image = testing::ShootRing(rig, scene, kFar, seconds, bits);
    std::visit(
        [&](const auto& pixels) {
          WritePng(name + ".png", pixels.view());
          for (int s = 0; s < 6; ++s) {
            WritePng(name + std::to_string(s) + ".png",
                     pixels.view().Crop(0, 96 * s, pixels.width(), 96));
          }
        },
        image.pixels);
  }

  std::vector<std::string> Sensors(const std::string& name) const {
    std::vector<std::string> files;
    for (int s = 0; s < 6; ++s) files.push_back(Path(name + std::to_string(s) + ".png"));
    return files;
  }

  // The outcome of `omnihdr stitch WORDS --rig RIG --out OUT`; an error of parsing is kUsage.
  Result<int> Run(std::vector<std::string> words, const std::string& out = "pano.exr") {
    words.insert(words.begin(), "stitch");
    words.insert(words.end(), {"--rig", Path("rig.toml"), "--out", Path(out)});
    return testing::RunCommand({AddStitchCommand}, std::move(words), &printed_);
  }
  std::string ErrorOf(std::vector<std::string> words, ErrorKind kind) {
    const Result<int> result = Run(std::move(words));
    if (result) return "no error";
    EXPECT_EQ(result.error().kind, kind) << result.error().message;
    return result.error().message;
  }

  // Largest relative error of a panorama's measured pixels.
  Errors Compare(const std::string& name, const SphereGrid& grid,
                 const testing::RadianceAt& scene = Smooth) const {
    Errors errors;
    const Result<ExrImage> exr = ReadExr(Path(name));
    if (!exr || exr->width != grid.width() || exr->height != grid.height()) {
      ADD_FAILURE() << name << (exr ? ": another size" : exr.error().message);
      return errors;
    }
    for (int y = 0; y < grid.height(); ++y) {
      for (int x = 0; x < grid.width(); ++x) {
        const auto ray = grid.RayFromPixel(x + 0.5, y + 0.5);
        const float origin = exr->channels.at("origin").at(x, y);
        if (!ray) {
          EXPECT_EQ(origin, 0.0F);
          continue;
        }
        if (origin != 1.0F) {
          errors.unseen += static_cast<int>(origin == 0.0F);
          continue;
        }
        ++errors.seen;
        const Eigen::Vector3d truth = scene(*ray * kFar);
        for (int c = 0; c < 3; ++c) {
          const double value = exr->channels.at(std::string(1, "RGB"[c])).at(x, y);
          errors.largest = std::max(errors.largest, std::abs(value / truth[c] - 1.0));
        }
      }
    }
    return errors;
  }

  std::string Bytes(const std::string& name) const {
    std::ifstream file(Path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  testing::TemporaryDirectory directory_;
  Rig rig_;
  std::string printed_;
};

const SphereGrid kLatLong = SphereGrid::Equirectangular(256, 128);

TEST_F(StitchCommand, AStackedFrameBecomesTheSceneItsSensorsSaw) {
  const Result<int> done =
      Run({Path("all.png"), "--seconds", "1", "--size", "256", "--preview", Path("p.jpg")});
  ASSERT_TRUE(done) << done.error().message;
  const Errors errors = Compare("pano.exr", kLatLong);
  EXPECT_LT(errors.largest, 0.02);  // half a step at the dark corners
  EXPECT_GT(errors.seen, 256 * 128 * 6 / 10);
  EXPECT_GT(errors.unseen, 1000);  // below the head
  EXPECT_THAT(printed_, HasSubstr("latlong 256x128 from 6 sensors, 1 exposure"));
  EXPECT_THAT(printed_, HasSubstr("sensor0 - sensor1"));
  EXPECT_THAT(Bytes("p.jpg"), HasSubstr("GPano:ProjectionType=\"equirectangular\""));
}

TEST_F(StitchCommand, TheSensorsPicturesGiveWhatTheStackedFrameGives) {
  ASSERT_TRUE(Run({Path("all.png"), "--seconds", "1/2", "--size", "256"}, "a.exr"));
  std::vector<std::string> words = Sensors("all");
  for (std::string& word : words) word += "@0.5";
  const Result<int> done = Run(
      [&] {
        std::vector<std::string> all = words;
        all.insert(all.end(), {"--size", "256"});
        return all;
      }(),
      "b.exr");
  ASSERT_TRUE(done) << done.error().message;
  EXPECT_EQ(Bytes("a.exr"), Bytes("b.exr"));
}

TEST_F(StitchCommand, EveryPictureHasItsOwnExposureAndTheOthersTheCommonOne) {
  Shoot("short", rig_, Smooth, 0.5);
  std::vector<std::string> words = Sensors("all");
  words[2] = Path("short2.png") + "@1/2";
  words.insert(words.end(), {"--seconds", "1", "--size", "256"});
  ASSERT_TRUE(Run(words));
  EXPECT_LT(Compare("pano.exr", kLatLong).largest, 0.04);
}

TEST_F(StitchCommand, ASensorWithoutAPictureTakesNoPart) {
  std::vector<std::string> words = Sensors("all");
  words[1] = "-";
  words[5] = "-";
  words.insert(words.end(), {"--seconds", "1", "--size", "256", "--json"});
  const Result<int> done = Run(words);
  ASSERT_TRUE(done) << done.error().message;
  const Errors errors = Compare("pano.exr", kLatLong);
  EXPECT_LT(errors.largest, 0.02);
  const nlohmann::json json = nlohmann::json::parse(printed_);
  EXPECT_EQ(json["left_out"], (nlohmann::json{"sensor1", "sensor5"}));
  EXPECT_EQ(json["sensors"].size(), 4U);
  // Sensor 1 looks 72 degrees to the right, sensor 5 up.
  const ExrImage exr = ReadExr(Path("pano.exr")).value();
  EXPECT_EQ(exr.channels.at("origin").at(128 + 51, 64), 0.0F);
  EXPECT_EQ(exr.channels.at("origin").at(128, 2), 0.0F);
  EXPECT_EQ(exr.channels.at("origin").at(128, 64), 1.0F);
  for (const nlohmann::json& seam : json["seams"]) {
    EXPECT_NE(seam["first"], "sensor1");
    EXPECT_NE(seam["second"], "sensor5");
  }
  EXPECT_EQ(json["seams"].size(), 3U) << json["seams"];  // 0-4, 2-3, 3-4
}

TEST_F(StitchCommand, TheSharesAndSeamsToldAreThoseOfTheSphere) {
  Rig wrong = rig_;
  for (double& gain : wrong.sensors[3].gain) gain *= 1.5;
  WriteRig(wrong);
  ASSERT_TRUE(Run({Path("all.png"), "--seconds", "1", "--size", "256", "--json"}));
  const nlohmann::json json = nlohmann::json::parse(printed_);
  double covered = 0.0;
  const ExrImage exr = ReadExr(Path("pano.exr")).value();
  for (int y = 0; y < 128; ++y) {
    for (int x = 0; x < 256; ++x) {
      if (exr.channels.at("origin").at(x, y) != 0.0F) covered += kLatLong.PixelSolidAngle(x, y);
    }
  }
  EXPECT_NEAR(json["covered"].get<double>(), covered / (4.0 * 3.14159265358979), 1e-6);
  for (const nlohmann::json& seam : json["seams"]) {
    const double expected = seam["first"] == "sensor3"    ? std::log10(1.5)
                            : seam["second"] == "sensor3" ? -std::log10(1.5)
                                                          : 0.0;
    EXPECT_NEAR(seam["log10_ratio"][1].get<double>(), expected, 0.004) << seam;
    EXPECT_GT(seam["samples"].get<int>(), 0);
  }
}

TEST_F(StitchCommand, DevelopedPicturesAreUndoneByTheirResponse) {
  Rig developed = rig_;
  for (RigSensor& sensor : developed.sensors) sensor.bayer = BayerOrder::kNone;
  // As a camera stores it: value 128 of sRGB for radiance 1.
  const auto linear = testing::ShootRing(developed, Smooth, kFar, 1.0, 16);
  const auto& words = std::get<Image<std::uint16_t>>(linear.pixels);
  Image<std::uint8_t> srgb(words.width(), words.height(), 3);
  for (std::size_t i = 0; i < words.size(); ++i) {
    const double radiance = words.data()[i] / 65535.0 * 255.0 / 128.0;
    const double light = radiance * std::pow((128.0 / 255.0 + 0.055) / 1.055, 2.4);
    const double code =
        light <= 0.0031308 ? 12.92 * light : 1.055 * std::pow(light, 1 / 2.4) - 0.055;
    srgb.data()[i] = static_cast<std::uint8_t>(std::lround(255.0 * std::min(code, 1.0)));
  }
  WritePng("srgb.png", srgb.view());
  // The rig's Bayer order is that of its raw frames.
  ASSERT_TRUE(Run({Path("srgb.png"), "--seconds", "1", "--size", "256", "--response", "srgb"}));
  EXPECT_LT(Compare("pano.exr", kLatLong).largest, 0.03);
  ASSERT_TRUE(Run({Path("srgb.png"), "--seconds", "1", "--size", "256"}));
  EXPECT_GT(Compare("pano.exr", kLatLong).largest, 0.2) << "linear is not what they are";
}

TEST_F(StitchCommand, TheWhiteBalanceComesOnTopOfTheRigsGains) {
  ASSERT_TRUE(
      Run({Path("all.png"), "--seconds", "1", "--size", "256", "--white-balance", "2,1,0.5"}));
  const auto scene = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(Smooth(p).cwiseProduct(Eigen::Vector3d(2.0, 1.0, 0.5)));
  };
  EXPECT_LT(Compare("pano.exr", kLatLong, scene).largest, 0.02);
}

TEST_F(StitchCommand, MosaicsMayBeInterpolatedAlongEdges) {
  ASSERT_TRUE(Run({Path("all.png"), "--seconds", "1", "--size", "256"}, "a.exr"));
  ASSERT_TRUE(Run({Path("all.png"), "--seconds", "1", "--size", "256", "--demosaic", "edge-aware"},
                  "b.exr"));
  EXPECT_NE(Bytes("a.exr"), Bytes("b.exr"));
  EXPECT_LT(Compare("b.exr", kLatLong).largest, 0.03);
}

TEST_F(StitchCommand, SeveralExposuresReachFartherThanOne) {
  const testing::RadianceAt scene = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(Smooth(p) * (p.x() > 0.0 ? 8.0 : 0.3));
  };
  Shoot("long", rig_, scene, 1.0, 12);
  Shoot("short", rig_, scene, 1.0 / 16.0, 12);
  const auto run = [&](const std::string& out, bool both) {
    std::vector<std::string> words = Sensors("long");
    for (std::string& word : words) word += "@1";
    if (both) {
      for (const std::string& file : Sensors("short")) words.push_back(file + "@1/16");
    }
    words.insert(words.end(), {"--size", "256", "--bits", "12"});
    return Run(words, out);
  };
  ASSERT_TRUE(run("one.exr", false));
  const Result<int> two = run("two.exr", true);
  ASSERT_TRUE(two) << two.error().message;
  EXPECT_THAT(printed_, HasSubstr("2 exposures"));
  const Errors one = Compare("one.exr", kLatLong, scene);
  const Errors both = Compare("two.exr", kLatLong, scene);
  EXPECT_GT(both.seen, one.seen + 8000);
  const Result<int> stacked =
      Run({Path("long.png") + "@1", Path("short.png") + "@1/16", "--size", "256", "--bits", "12"},
          "stacked.exr");
  ASSERT_TRUE(stacked) << stacked.error().message;
  EXPECT_EQ(Bytes("stacked.exr"), Bytes("two.exr"));
}

TEST_F(StitchCommand, EveryProjectionShowsTheScene) {
  const double z = 0.75 * 3.14159265358979323846;
  const std::vector<std::pair<std::string, SphereGrid>> grids = {
      {"rdmap", SphereGrid::RhombicDodecahedron(48)},
      {"cube", SphereGrid::CubeStrip(48)},
      {"cylinder", GridOfSize(SphereGridKind::kCylindrical, 256, -z, z)}};
  for (const auto& [name, grid] : grids) {
    const int size = name == "cylinder" ? 256 : 48;
    const Result<int> done = Run({Path("all.png"), "--seconds", "1", "--to", name, "--size",
                                  std::to_string(size), "--preview", Path(name + ".jpg")});
    ASSERT_TRUE(done) << done.error().message;
    const Errors errors = Compare("pano.exr", grid);
    EXPECT_LT(errors.largest, 0.02) << name;
    EXPECT_GT(errors.seen, 5000) << name;
    const ExrImage exr = ReadExr(Path("pano.exr")).value();
    EXPECT_EQ(exr.attributes.envmap, name == "cube" ? ExrEnvmap::kCube : ExrEnvmap::kNone);
    EXPECT_THAT(Bytes(name + ".jpg"), ::testing::Not(HasSubstr("GPano")));
  }
}

TEST_F(StitchCommand, TheRigsLensMasksAreHonoured) {
  ASSERT_TRUE(Run({Path("all.png"), "--seconds", "1", "--size", "256"}));
  const int before = Compare("pano.exr", kLatLong).seen;
  Rig masked = rig_;
  masked.sensors[0].mask_file = "lens.png";
  WriteRig(masked);
  EXPECT_THAT(ErrorOf({Path("all.png"), "--seconds", "1"}, ErrorKind::kNoInput),
              HasSubstr("lens.png"));
  Image<std::uint8_t> mask(128, 96, 1, 255);
  for (int y = 30; y < 66; ++y) std::fill_n(mask.row(y) + 40, 48, std::uint8_t{0});
  WritePng("lens.png", mask.view());
  ASSERT_TRUE(Run({Path("all.png"), "--seconds", "1", "--size", "256"}));
  EXPECT_LT(Compare("pano.exr", kLatLong).seen, before - 500);
  const ExrImage exr = ReadExr(Path("pano.exr")).value();
  EXPECT_EQ(exr.channels.at("origin").at(128, 64), 0.0F) << "ahead";
  // A mask of a sensor that takes no part is not asked for.
  std::vector<std::string> words = Sensors("all");
  words[0] = "-";
  words.insert(words.end(), {"--seconds", "1", "--size", "256"});
  fs::remove(Path("lens.png"));
  EXPECT_TRUE(Run(words));
}

TEST_F(StitchCommand, APanoramasMaskCutsTheSkyInAnyProjection) {
  Image<std::uint8_t> mask(512, 256, 1, 255);  // of another size than the panorama
  for (int y = 0; y < 128; ++y) std::fill_n(mask.row(y), 512, std::uint8_t{0});
  WritePng("sky.png", mask.view());
  for (const auto& [name, grid] :
       {std::pair{std::string("latlong"), kLatLong},
        std::pair{std::string("rdmap"), SphereGrid::RhombicDodecahedron(48)}}) {
    const Result<int> done = Run({Path("all.png"), "--seconds", "1", "--to", name, "--size",
                                  name == "latlong" ? "256" : "48", "--mask", Path("sky.png")});
    ASSERT_TRUE(done) << done.error().message;
    const ExrImage exr = ReadExr(Path("pano.exr")).value();
    int below = 0;
    for (int y = 0; y < grid.height(); ++y) {
      for (int x = 0; x < grid.width(); ++x) {
        const auto ray = grid.RayFromPixel(x + 0.5, y + 0.5);
        if (!ray || std::abs(ray->z()) < 0.02) continue;
        const bool seen = exr.channels.at("origin").at(x, y) != 0.0F;
        if (ray->z() > 0.0) {
          ASSERT_FALSE(seen) << name << " " << x << "," << y;
        }
        below += static_cast<int>(ray->z() < 0.0 && seen);
      }
    }
    EXPECT_GT(below, 3000) << name;
  }
}

TEST_F(StitchCommand, AStackedMaskIsThatOfTheWholeRigAlsoWhenSensorsAreLeftOut) {
  // Sensor 2 hidden.
  Image<std::uint8_t> mask(128, 6 * 96, 1, 255);
  for (int y = 2 * 96; y < 3 * 96; ++y) std::fill_n(mask.row(y), 128, std::uint8_t{0});
  WritePng("mask.png", mask.view());
  std::vector<std::string> words = Sensors("all");
  words[0] = "-";
  words.insert(words.end(), {"--seconds", "1", "--size", "256", "--mask", Path("mask.png")});
  ASSERT_TRUE(Run(words));
  const ExrImage exr = ReadExr(Path("pano.exr")).value();
  const auto origin = [&](double degrees_right) {
    return exr.channels.at("origin").at(static_cast<int>(128 + degrees_right / 360.0 * 256), 64);
  };
  EXPECT_EQ(origin(0.0), 0.0F);
  EXPECT_EQ(origin(72.0), 1.0F);
  EXPECT_EQ(origin(144.0), 0.0F);
  EXPECT_EQ(origin(-72.0), 1.0F);
}

TEST_F(StitchCommand, EveryBadInputHasItsMessage) {
  const std::string all = Path("all.png");
  EXPECT_THAT(ErrorOf({all}, ErrorKind::kUsage), HasSubstr("how long was it exposed?"));
  EXPECT_THAT(ErrorOf({all, "--seconds", "0"}, ErrorKind::kUsage),
              HasSubstr("--seconds: 0, expected a number above 0"));
  EXPECT_THAT(ErrorOf({all, "--seconds", "1/x"}, ErrorKind::kUsage), HasSubstr("--seconds: 1/x"));
  EXPECT_THAT(ErrorOf({"-", "-", "-", "-", "-", "-", "--seconds", "1"}, ErrorKind::kUsage),
              HasSubstr("no picture named"));
  EXPECT_THAT(ErrorOf({Path("all0.png"), Path("all1.png"), "--seconds", "1"}, ErrorKind::kUsage),
              HasSubstr("2 pictures, expected 6, one for each sensor of"));
  EXPECT_THAT(ErrorOf({all, "-", "--seconds", "1"}, ErrorKind::kUsage),
              HasSubstr("\"-\" among stacked frames of 128x576"));
  EXPECT_THAT(ErrorOf({all, Path("all0.png"), "--seconds", "1"}, ErrorKind::kData),
              HasSubstr("all0.png: 128x96 pixels, expected a stacked frame of 128x576"));
  std::vector<std::string> words = Sensors("all");
  words.insert(words.end(), {"--seconds", "1"});
  words[4] = Path("missing.png");
  EXPECT_THAT(ErrorOf(words, ErrorKind::kNoInput), HasSubstr("missing.png"));
  words[4] = all;
  EXPECT_THAT(
      ErrorOf(words, ErrorKind::kData),
      HasSubstr("all.png: 128x576 pixels, expected the size of sensor \"sensor4\", 128x96"));
  WritePng("colour.png", Image<std::uint8_t>(128, 96, 3, 9).view());
  words[4] = Path("colour.png");
  EXPECT_THAT(ErrorOf(words, ErrorKind::kData),
              HasSubstr("colour.png: 3 channels of 8 bits, expected 1 channel of 8 bits as "));
  words[4] = Path("all4.png");
  for (const std::string& file : Sensors("all")) words.insert(words.begin() + 6, file);
  words[8] = "-";
  EXPECT_THAT(ErrorOf(words, ErrorKind::kUsage),
              HasSubstr("sensor \"sensor2\" has a picture of some exposures only"));
  EXPECT_THAT(ErrorOf({all, "--seconds", "1", "--size", "255"}, ErrorKind::kUsage),
              HasSubstr("--size: 255, expected an even width"));
  EXPECT_THAT(ErrorOf({all, "--seconds", "1", "--to", "fisheye"}, ErrorKind::kUsage),
              HasSubstr("fisheye"));
  EXPECT_THAT(ErrorOf({all, "--seconds", "1", "--white-balance", "1,1,99"}, ErrorKind::kUsage),
              HasSubstr("--white-balance: 1,1,99"));
  EXPECT_THAT(ErrorOf({all, "--seconds", "1", "--mask", Path("all0.png")}, ErrorKind::kData),
              HasSubstr("all0.png: 128x96 pixels, expected the stacked frames' size 128x576 or a "
                        "lat-long picture"));
  EXPECT_THAT(
      ErrorOf({all, "--seconds", "1", "--response", Path("none.json")}, ErrorKind::kNoInput),
      HasSubstr("none.json"));
  WritePng("black.png", Image<std::uint8_t>(128, 576, 1, 0).view());
  EXPECT_THAT(ErrorOf({all, "--seconds", "1", "--mask", Path("black.png")}, ErrorKind::kData),
              HasSubstr("no sensor of the rig sees any of the panorama"));
  EXPECT_FALSE(fs::exists(Path("pano.exr")));
}

}  // namespace
}  // namespace omnihdr::stitch_test
