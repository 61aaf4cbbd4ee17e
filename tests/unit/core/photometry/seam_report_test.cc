#include "core/photometry/seam_report.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/photometry/stitch.h"
#include "tests/support/ring.h"

namespace omnihdr::seam_report_test {
namespace {

using testing::MakeRing;
using testing::ShootRing;

constexpr double kFar = 10.0;  // radius of the scene

Eigen::Vector3d Smooth(const Eigen::Vector3d& point) {
  const Eigen::Vector3d u = point.normalized();
  return {1.0 + 0.4 * u.x(), 0.9 + 0.3 * u.y() - 0.2 * u.z(), 0.8 + 0.3 * u.z()};
}

std::vector<Seam> SeamsOf(const Rig& rig, const DecodedImage& image, int bits,
                          std::vector<double> seconds = {1.0}, int width = 512) {
  Stitcher stitcher =
      Stitcher::Create(rig, Projection::Equirectangular(width, width / 2), {}).value();
  RigFrame frame{&image, {}};
  for (const double s : seconds) frame.exposures.push_back({ExposureTime::Seconds(s), GainDb{}});
  MeasureOptions options;
  options.noise.read = 0.5;
  return stitcher.Seams(std::vector{frame}, std::vector{*Response::Linear()}, bits, options)
      .value();
}

const Seam* Find(const std::vector<Seam>& seams, int first, int second) {
  for (const Seam& seam : seams) {
    if (seam.first == first && seam.second == second) return &seam;
  }
  return nullptr;
}

TEST(SeamReport, SensorsThatAgreeHaveARatioOfOne) {
  const Rig rig = MakeRing();
  for (const int bits : {8, 14}) {  // straight from the bytes, and by way of the mosaic
    const std::vector<Seam> seams = SeamsOf(rig, ShootRing(rig, Smooth, kFar, 1.0, bits), bits);
    for (const auto& [first, second] : {std::pair{0, 1}, {1, 2}, {2, 3}, {3, 4}, {0, 4}}) {
      const Seam* seam = Find(seams, first, second);
      ASSERT_NE(seam, nullptr) << first << second;
      EXPECT_GT(seam->samples, 500U);
    }
    for (const Seam& seam : seams) {
      EXPECT_LT(seam.first, seam.second);
      for (std::size_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(seam.log10_ratio[c], 0.0, bits == 8 ? 0.002 : 0.0005);
        EXPECT_LT(seam.spread[c], bits == 8 ? 0.003 : 0.0005);
      }
    }
    EXPECT_EQ(Find(seams, 0, 2), nullptr) << "they do not meet";
  }
}

TEST(SeamReport, AWrongGainIsTheRatioOfItsSensorsSeams) {
  Rig rig = MakeRing();
  const DecodedImage image = ShootRing(rig, Smooth, kFar, 1.0, 14);
  const std::array<double, 3> wrong = {1.25, 0.9, 1.1};
  for (std::size_t c = 0; c < 3; ++c) rig.sensors[2].gain[c] *= wrong[c];
  const std::vector<Seam> seams = SeamsOf(rig, image, 14);
  for (std::size_t c = 0; c < 3; ++c) {
    EXPECT_NEAR(Find(seams, 1, 2)->log10_ratio[c], -std::log10(wrong[c]), 0.001);
    EXPECT_NEAR(Find(seams, 2, 3)->log10_ratio[c], std::log10(wrong[c]), 0.001);
    EXPECT_NEAR(Find(seams, 3, 4)->log10_ratio[c], 0.0, 0.001);
    EXPECT_LT(Find(seams, 2, 3)->spread[c], 0.001);
  }
}

TEST(SeamReport, EverySensorsOwnExposureCounts) {
  const Rig rig = MakeRing();
  const DecodedImage image = ShootRing(rig, Smooth, kFar, 1.0, 14);
  const std::vector<Seam> seams = SeamsOf(rig, image, 14, {1.0, 1.0, 1.0, 0.5, 1.0, 1.0});
  EXPECT_NEAR(Find(seams, 2, 3)->log10_ratio[1], -std::log10(2.0), 0.001);
  EXPECT_NEAR(Find(seams, 3, 4)->log10_ratio[1], std::log10(2.0), 0.001);
}

TEST(SeamReport, NoiseAndParallaxWidenTheSpreadAndHardlyMoveTheRatio) {
  const testing::RadianceAt scene = [](const Eigen::Vector3d& p) {
    const Eigen::Vector3d u = p.normalized();
    const double v = 1.0 + 0.5 * std::sin(40.0 * u.x()) * std::sin(40.0 * u.y());
    return Eigen::Vector3d(v, v, v);
  };
  const Rig rig = MakeRing({.offset_m = 0.2});
  const Seam right = *Find(SeamsOf(rig, ShootRing(rig, scene, kFar, 1.0, 14), 14), 0, 1);
  const Seam near = *Find(SeamsOf(rig, ShootRing(rig, scene, 2.0, 1.0, 14), 14), 0, 1);
  EXPECT_GT(near.spread[1], 2.0 * right.spread[1]);
  const Seam noisy = *Find(SeamsOf(rig, ShootRing(rig, Smooth, kFar, 1.0, 8, 6.0), 8), 0, 1);
  EXPECT_GT(noisy.spread[1], 0.008);
  EXPECT_NEAR(noisy.log10_ratio[1], 0.0, 0.004);
}

TEST(SeamReport, ClippedPixelsDoNotEnter) {
  const testing::RadianceAt scene = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(Smooth(p) * (p.z() > 0.0 ? 6.0 : 1.0));
  };
  // A gain that is wrong, so that the sensors' clipping values differ by it.
  Rig rig = MakeRing();
  const DecodedImage all = ShootRing(rig, Smooth, kFar, 1.0);
  const DecodedImage half = ShootRing(rig, scene, kFar, 1.0);
  for (double& gain : rig.sensors[1].gain) gain *= 1.3;
  const Seam open = *Find(SeamsOf(rig, all, 8), 0, 1);
  const Seam clipped = *Find(SeamsOf(rig, half, 8), 0, 1);
  EXPECT_LT(clipped.samples, open.samples * 6 / 10);
  EXPECT_GT(clipped.samples, open.samples * 3 / 10);
  EXPECT_NEAR(clipped.log10_ratio[1], -std::log10(1.3), 0.002);
  const DecodedImage white = ShootRing(
      rig, [](const Eigen::Vector3d&) { return Eigen::Vector3d(9.0, 9.0, 9.0); }, kFar, 1.0);
  const std::vector<Seam> none = SeamsOf(rig, white, 8);
  ASSERT_NE(Find(none, 0, 1), nullptr);
  EXPECT_EQ(Find(none, 0, 1)->samples, 0U);
  EXPECT_TRUE(std::isnan(Find(none, 0, 1)->log10_ratio[1]));
}

TEST(SeamReport, AFinePanoramaIsSampledAndSaysTheSame) {
  Rig rig = MakeRing();
  const DecodedImage image = ShootRing(rig, Smooth, kFar, 1.0, 14);
  rig.sensors[1].gain[1] *= 1.2;
  const Seam coarse = *Find(SeamsOf(rig, image, 14, {1.0}, 1024), 0, 1);
  const Seam fine = *Find(SeamsOf(rig, image, 14, {1.0}, 2112), 0, 1);  // every second pixel
  EXPECT_NEAR(static_cast<double>(fine.samples),
              static_cast<double>(coarse.samples) * (1056.0 * 1056.0) / (1024.0 * 1024.0),
              0.03 * static_cast<double>(coarse.samples));
  EXPECT_NEAR(fine.log10_ratio[1], coarse.log10_ratio[1], 2e-4);
}

}  // namespace
}  // namespace omnihdr::seam_report_test
