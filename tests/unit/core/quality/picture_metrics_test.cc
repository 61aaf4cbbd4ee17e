#include "core/quality/picture_metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

namespace omnihdr::picture_metrics_test {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

Image<float> Noise(int width, int height, unsigned seed, float mean = 100.0F, float sigma = 30.0F) {
  std::mt19937 generator(seed);
  std::normal_distribution<float> normal(mean, sigma);
  Image<float> image(width, height, 1);
  for (float& value : image.values()) value = normal(generator);
  return image;
}

// SSIM straight from the paper's sums over one window: weighted mean, deviations from that mean
// squared, no running sums, no separable filter.
double NaiveSsim(const Image<float>& a, const Image<float>& b, double peak) {
  const double c1 = 0.01 * peak * 0.01 * peak;
  const double c2 = 0.03 * peak * 0.03 * peak;
  std::vector<double> window;
  double window_sum = 0.0;
  for (int j = -5; j <= 5; ++j) {
    for (int i = -5; i <= 5; ++i) {
      window.push_back(std::exp(-(i * i + j * j) / 4.5));
      window_sum += window.back();
    }
  }
  double total = 0.0;
  int count = 0;
  for (int y = 5; y < a.height() - 5; ++y) {
    for (int x = 5; x < a.width() - 5; ++x) {
      double mean_a = 0.0;
      double mean_b = 0.0;
      std::size_t k = 0;
      for (int j = -5; j <= 5; ++j) {
        for (int i = -5; i <= 5; ++i, ++k) {
          mean_a += window[k] / window_sum * static_cast<double>(a.at(x + i, y + j));
          mean_b += window[k] / window_sum * static_cast<double>(b.at(x + i, y + j));
        }
      }
      double variance_a = 0.0;
      double variance_b = 0.0;
      double covariance = 0.0;
      k = 0;
      for (int j = -5; j <= 5; ++j) {
        for (int i = -5; i <= 5; ++i, ++k) {
          const double da = static_cast<double>(a.at(x + i, y + j)) - mean_a;
          const double db = static_cast<double>(b.at(x + i, y + j)) - mean_b;
          variance_a += window[k] / window_sum * da * da;
          variance_b += window[k] / window_sum * db * db;
          covariance += window[k] / window_sum * da * db;
        }
      }
      const double luminance =
          (2.0 * mean_a * mean_b + c1) / (mean_a * mean_a + mean_b * mean_b + c1);
      const double structure = (2.0 * covariance + c2) / (variance_a + variance_b + c2);
      total += luminance * structure;
      ++count;
    }
  }
  return total / count;
}

TEST(Psnr, OfAKnownDifference) {
  const Image<float> a(8, 8, 1, 10.0F);
  const Image<float> b(8, 8, 1, 15.0F);
  EXPECT_NEAR(Psnr(a, b, 255.0, {}), 20.0 * std::log10(255.0 / 5.0), 1e-9);
}

TEST(Psnr, OfEqualPicturesIsInfinite) {
  const Image<float> a = Noise(8, 8, 1);
  EXPECT_EQ(Psnr(a, a, 255.0, {}), std::numeric_limits<double>::infinity());
}

TEST(Psnr, UnknownPixelsAreLeftOut) {
  const Image<float> a(8, 8, 1, 10.0F);
  Image<float> b(8, 8, 1, 15.0F);
  b.at(3, 3) = kNaN;
  EXPECT_NEAR(Psnr(a, b, 255.0, {}), 20.0 * std::log10(255.0 / 5.0), 1e-9);
  const Image<float> unknown(8, 8, 1, kNaN);
  EXPECT_TRUE(std::isnan(Psnr(a, unknown, 255.0, {})));
}

TEST(PsnrMu, FollowsTheMuLaw) {
  const Image<float> truth(4, 4, 1, 0.5F);
  const Image<float> tested(4, 4, 1, 0.25F);
  const double difference = std::log(1.0 + 5000.0 * 0.25) / std::log(5001.0) -
                            std::log(1.0 + 5000.0 * 0.125) / std::log(5001.0);
  EXPECT_NEAR(PsnrMu(tested, truth, 2.0, {}), -20.0 * std::log10(difference), 1e-5);
}

TEST(PsnrMu, AboveWhiteNothingCounts) {
  const Image<float> truth(4, 4, 1, 3.0F);
  const Image<float> tested(4, 4, 1, 9.0F);
  EXPECT_EQ(PsnrMu(tested, truth, 2.0, {}), std::numeric_limits<double>::infinity());
}

TEST(Ssim, AgreesWithTheFormulaWrittenOutPlainly) {
  const Image<float> truth = Noise(40, 31, 7);
  Image<float> tested = Noise(40, 31, 8, 0.0F, 20.0F);
  for (std::size_t i = 0; i < tested.size(); ++i) {
    tested.data()[i] += 0.8F * truth.data()[i] + 25.0F;
  }
  const double expected = NaiveSsim(tested, truth, 255.0);
  EXPECT_GT(expected, 0.3);
  EXPECT_LT(expected, 0.95);
  EXPECT_NEAR(Ssim(tested, truth, 255.0, {}), expected, 1e-9);
}

TEST(Ssim, OfEqualPicturesIsOne) {
  const Image<float> a = Noise(20, 20, 3);
  EXPECT_NEAR(Ssim(a, a, 255.0, {}), 1.0, 1e-12);
}

TEST(Ssim, OfTwoFlatPicturesIsTheLuminanceTermAlone) {
  const Image<float> a(16, 16, 1, 100.0F);
  const Image<float> b(16, 16, 1, 50.0F);
  const double c1 = 2.55 * 2.55;
  EXPECT_NEAR(Ssim(a, b, 255.0, {}), (2.0 * 100.0 * 50.0 + c1) / (100.0 * 100.0 + 50.0 * 50.0 + c1),
              1e-9);
}

TEST(Ssim, IsTheSameBothWays) {
  const Image<float> a = Noise(24, 24, 4);
  const Image<float> b = Noise(24, 24, 5);
  EXPECT_NEAR(Ssim(a, b, 255.0, {}), Ssim(b, a, 255.0, {}), 1e-12);
}

TEST(Ssim, AWindowWithAnUnknownOrMaskedPixelDoesNotCount) {
  const Image<float> truth = Noise(30, 11, 6);
  Image<float> tested = truth.Clone();
  for (int y = 0; y < 11; ++y)
    tested.at(2, y) += 200.0F;  // spoils the windows centred on columns 5..7
  EXPECT_LT(Ssim(tested, truth, 255.0, {}), 0.99);
  tested.at(2, 5) = kNaN;
  EXPECT_NEAR(Ssim(tested, truth, 255.0, {}), 1.0, 1e-12);
  tested.at(2, 5) = 0.0F;
  Image<std::uint8_t> mask(30, 11, 1, 1);
  mask.at(2, 5) = 0;
  ComparisonArea area;
  area.mask = mask.view();
  EXPECT_NEAR(Ssim(tested, truth, 255.0, area), 1.0, 1e-12);
}

TEST(Ssim, APanoramaHasNoLeftAndRightEdge) {
  // Rolling both pictures by half a turn changes nothing when the edges are neighbours.
  const Image<float> truth = Noise(32, 16, 9);
  const Image<float> tested = Noise(32, 16, 10);
  Image<float> rolled_truth(32, 16, 1);
  Image<float> rolled_tested(32, 16, 1);
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 32; ++x) {
      rolled_truth.at((x + 16) % 32, y) = truth.at(x, y);
      rolled_tested.at((x + 16) % 32, y) = tested.at(x, y);
    }
  }
  EXPECT_NEAR(Ssim(tested, truth, 255.0, {}, true),
              Ssim(rolled_tested, rolled_truth, 255.0, {}, true), 1e-12);
  EXPECT_GT(std::abs(Ssim(tested, truth, 255.0, {}) - Ssim(rolled_tested, rolled_truth, 255.0, {})),
            1e-6);
}

TEST(Ssim, APictureSmallerThanAWindowReadsNaN) {
  const Image<float> a = Noise(20, 10, 1);
  EXPECT_TRUE(std::isnan(Ssim(a, a, 255.0, {})));
}

TEST(ReinhardDisplay, TheLogAverageShowsAsTheKeyAndTheBrightestAsWhite) {
  Image<float> luminance(2, 2, 1, 1.0F);
  luminance.at(0, 0) = 100.0F;
  luminance.at(1, 1) = 0.01F;
  const ReinhardParameters parameters = ReinhardParametersOf(luminance, {});
  EXPECT_NEAR(parameters.log_average, 1.0, 1e-6);
  const Image<float> display = ReinhardDisplay(luminance, parameters);
  EXPECT_NEAR(display.at(0, 0), 1.0F, 1e-6F);
  EXPECT_NEAR(display.at(1, 0), 0.18F * (1.0F + 0.18F / (18.0F * 18.0F)) / 1.18F, 1e-6F);
  EXPECT_GT(display.at(1, 0), display.at(1, 1));
}

TEST(ReinhardDisplay, UnknownStaysUnknown) {
  Image<float> luminance(2, 2, 1, 1.0F);
  luminance.at(0, 0) = kNaN;
  const Image<float> display = ReinhardDisplay(luminance, ReinhardParametersOf(luminance, {}));
  EXPECT_TRUE(std::isnan(display.at(0, 0)));
  EXPECT_TRUE(std::isfinite(display.at(1, 1)));
}

}  // namespace
}  // namespace omnihdr::picture_metrics_test
