// Real lenses: what two neighbours of an eight-lens camera see must meet on the sphere. Fails when
// a rotation is read the wrong way round, a picture is turned or mirrored, or the lens model is not
// the maker's.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "core/image/image_io.h"
#include "core/session/rig_file.h"

namespace omnihdr::vuze_overlap_test {
namespace {

namespace fs = std::filesystem;

const fs::path kData = fs::path(OMNIHDR_SOURCE_DIR) / ".." / "shared" / "data" / "vuze";
constexpr double kDegree = std::numbers::pi / 180.0;
constexpr int kPixelsPerDegree = 4;
constexpr int kColumns = 24 * kPixelsPerDegree;
constexpr int kRows = 44 * kPixelsPerDegree;
constexpr int kHalfPatch = 14;
constexpr int kSearch = 12;  // 3 degrees
constexpr double kDistanceM = 8.0;

struct Offsets {
  double correlation = 0.0;  // median over patches of the best one
  double across_deg = 0.0;   // median
  double down_deg = 0.0;
  int patches = 0;
};

// A window of the lat-long picture round an azimuth at the horizon, as one lens sees it.
Image<float> Window(const RigSensor& sensor, const Image<std::uint8_t>& picture,
                    double azimuth_deg) {
  Image<float> window(kColumns, kRows, 1, std::nanf(""));
  for (int y = 0; y < kRows; ++y) {
    const double elevation = (0.5 * kRows - y - 0.5) / kPixelsPerDegree * kDegree;
    for (int x = 0; x < kColumns; ++x) {
      const double azimuth =
          (azimuth_deg + (0.5 * kColumns - x - 0.5) / kPixelsPerDegree) * kDegree;
      const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth),
                                std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      const auto pixel = SensorPixelFromRay(sensor, ray, kDistanceM);
      if (!pixel) continue;
      const int cx = static_cast<int>(pixel->x());
      const int cy = static_cast<int>(pixel->y());
      if (cx < 1 || cy < 1 || cx >= picture.width() - 1 || cy >= picture.height() - 1) continue;
      float sum = 0.0F;
      for (int j = -1; j <= 1; ++j) {
        for (int i = -1; i <= 1; ++i) sum += picture.at(cx + i, cy + j, 1);
      }
      window.at(x, y) = sum / 9.0F;
    }
  }
  return window;
}

// Normalised cross correlation of two patches; NaN where either is not whole.
double Correlation(const Image<float>& a, int ax, int ay, const Image<float>& b, int bx, int by) {
  double sa = 0.0;
  double sb = 0.0;
  double saa = 0.0;
  double sbb = 0.0;
  double sab = 0.0;
  int n = 0;
  for (int j = -kHalfPatch; j <= kHalfPatch; j += 2) {
    for (int i = -kHalfPatch; i <= kHalfPatch; i += 2) {
      const double p = a.at(ax + i, ay + j);
      const double q = b.at(bx + i, by + j);
      sa += p;
      sb += q;
      saa += p * p;
      sbb += q * q;
      sab += p * q;
      ++n;
    }
  }
  return (sab - sa * sb / n) / std::sqrt((saa - sa * sa / n) * (sbb - sb * sb / n));
}

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

Offsets Compare(const Image<float>& a, const Image<float>& b) {
  std::vector<double> best_ones;
  std::vector<double> across;
  std::vector<double> down;
  constexpr int kMargin = kHalfPatch + kSearch;
  for (int y = kMargin; y < kRows - kMargin; y += 12) {
    for (int x = kMargin; x < kColumns - kMargin; x += 12) {
      double best = -2.0;
      int best_i = 0;
      int best_j = 0;
      for (int j = -kSearch; j <= kSearch; ++j) {
        for (int i = -kSearch; i <= kSearch; ++i) {
          const double c = Correlation(a, x, y, b, x + i, y + j);
          if (!(c > best)) continue;
          best = c;
          best_i = i;
          best_j = j;
        }
      }
      if (best < -1.5) continue;
      best_ones.push_back(best);
      across.push_back(static_cast<double>(best_i) / kPixelsPerDegree);
      down.push_back(static_cast<double>(best_j) / kPixelsPerDegree);
    }
  }
  if (best_ones.empty()) return {};
  return {Median(best_ones), Median(across), Median(down), static_cast<int>(best_ones.size())};
}

class VuzeOverlap : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!fs::exists(kData)) GTEST_SKIP() << "SKIPPED: no pictures of the camera at " << kData;
    const Result<Rig> rig = ReadRig(fs::path(OMNIHDR_SOURCE_DIR) / "config" / "rigs" / "vuze.toml");
    ASSERT_TRUE(rig) << rig.error().message;
    rig_ = *rig;
    for (const char* lens : {"4", "5"}) {
      Result<DecodedImage> image = ReadImage(kData / ("HET_0014_" + std::string(lens) + ".JPG"));
      ASSERT_TRUE(image) << image.error().message;
      pictures_.push_back(std::move(std::get<Image<std::uint8_t>>(image->pixels)));
    }
  }

  // Lens 4 looks right, lens 5 back: they meet at -135 degrees.
  Offsets Measure(const RigSensor& right, const RigSensor& back) const {
    return Compare(Window(right, pictures_[0], -135.0), Window(back, pictures_[1], -135.0));
  }

  Rig rig_;
  std::vector<Image<std::uint8_t>> pictures_;
};

TEST_F(VuzeOverlap, NeighboursMeetToAboutADegreeWithTheFactorysNumbers) {
  const Offsets offsets = Measure(rig_.sensors[3], rig_.sensors[4]);
  RecordProperty("correlation", std::to_string(offsets.correlation));
  RecordProperty("across_deg", std::to_string(offsets.across_deg));
  RecordProperty("down_deg", std::to_string(offsets.down_deg));
  EXPECT_GT(offsets.patches, 20);
  EXPECT_GT(offsets.correlation, 0.75);
  EXPECT_LT(std::abs(offsets.across_deg), 1.3);
  EXPECT_LT(std::abs(offsets.down_deg), 0.5);
}

TEST_F(VuzeOverlap, InverseRotationsOrPicturesUpsideDownDoNotMeet) {
  Rig twin = rig_;
  for (RigSensor& sensor : twin.sensors) {
    sensor.camera_from_sensor.rotation *= Eigen::Quaterniond(0, 0, 0, 1);
  }
  EXPECT_LT(Measure(twin.sensors[3], twin.sensors[4]).correlation, 0.6);
  // The neighbours taken for each other.
  EXPECT_LT(Measure(rig_.sensors[4], rig_.sensors[3]).correlation, 0.6);
}

}  // namespace
}  // namespace omnihdr::vuze_overlap_test
