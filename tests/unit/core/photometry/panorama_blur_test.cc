#include "core/photometry/panorama_blur.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <random>

namespace omnihdr::panorama_blur_test {
namespace {

constexpr double kPi = std::numbers::pi;

Image<float> Noise(int width, int height, unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<float> uniform(0.0F, 1.0F);
  Image<float> image(width, height, 1);
  for (float& value : image.values()) value = uniform(generator);
  return image;
}

// The two-dimensional sum of the definition, edges repeated or wrapped.
double DirectBlur(const Image<float>& image, int x, int y, double sigma, bool wraps) {
  const int radius = static_cast<int>(std::ceil(3.0 * sigma));
  double sum = 0.0;
  double weights = 0.0;
  for (int j = -radius; j <= radius; ++j) {
    for (int i = -radius; i <= radius; ++i) {
      const double weight = std::exp(-(i * i + j * j) / (2.0 * sigma * sigma));
      const int column = wraps ? (x + i + 10 * image.width()) % image.width()
                               : std::clamp(x + i, 0, image.width() - 1);
      const int row = std::clamp(y + j, 0, image.height() - 1);
      sum += weight * static_cast<double>(image.at(column, row));
      weights += weight;
    }
  }
  return sum / weights;
}

Image<float> Rolled(const Image<float>& image, int by) {
  Image<float> rolled(image.width(), image.height(), 1);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      rolled.at((x + by) % image.width(), y) = image.at(x, y);
    }
  }
  return rolled;
}

TEST(GaussianBlur, IsTheSumOfTheDefinition) {
  const Image<float> image = Noise(23, 17, 1);
  for (const bool wraps : {false, true}) {
    for (const double sigma : {0.25, 0.8, 2.3, 4.0}) {
      Image<float> blurred;
      GaussianBlur(image, sigma, wraps ? PictureShape::kCylinder : PictureShape::kPlane, &blurred);
      for (int y = 0; y < 17; ++y) {
        for (int x = 0; x < 23; ++x) {
          ASSERT_NEAR(blurred.at(x, y), DirectBlur(image, x, y, sigma, wraps), 2e-6)
              << x << " " << y << " sigma " << sigma << " wraps " << wraps;
        }
      }
    }
  }
}

TEST(GaussianBlur, AConstantStaysItself) {
  const Image<float> image(31, 16, 1, 3.0F);
  for (const PictureShape shape :
       {PictureShape::kPlane, PictureShape::kCylinder, PictureShape::kSphere}) {
    for (const double sigma : {0.0, 0.5, 3.0, 20.0}) {
      Image<float> blurred;
      GaussianBlur(image, sigma, shape, &blurred);
      for (const float value : blurred.values()) EXPECT_NEAR(value, 3.0F, 1e-5F);
    }
  }
}

TEST(GaussianBlur, APanoramaHasNoSeam) {
  const Image<float> image = Noise(64, 32, 2);
  for (const PictureShape shape : {PictureShape::kCylinder, PictureShape::kSphere}) {
    Image<float> blurred;
    Image<float> of_rolled;
    GaussianBlur(image, 3.0, shape, &blurred);
    GaussianBlur(Rolled(image, 29), 3.0, shape, &of_rolled);
    const Image<float> expected = Rolled(blurred, 29);
    for (std::size_t i = 0; i < expected.size(); ++i) {
      EXPECT_NEAR(of_rolled.data()[i], expected.data()[i], 1e-6F);
    }
  }
}

// A linear function of direction is an eigenfunction of blurring on the sphere: it shrinks by
// exp(−sigma²), the same everywhere and in every orientation, poles included.
TEST(GaussianBlur, TreatsThePolesAsAnyOtherPlaceOfTheSphere) {
  constexpr int kHeight = 128;
  constexpr int kWidth = 256;
  constexpr double kSigma = 4.0;
  const double shrink = std::exp(-std::pow(kSigma * kPi / kHeight, 2.0));
  for (int axis = 0; axis < 3; ++axis) {
    Image<float> image(kWidth, kHeight, 1);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double theta = kPi - 2.0 * kPi * (x + 0.5) / kWidth;
        const double phi = kPi * (y + 0.5) / kHeight;
        const double v[3] = {std::sin(phi) * std::cos(theta), std::sin(phi) * std::sin(theta),
                             std::cos(phi)};
        image.at(x, y) = static_cast<float>(v[axis]);
      }
    }
    Image<float> blurred;
    GaussianBlur(image, kSigma, PictureShape::kSphere, &blurred);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; x += 7) {
        // One pixel is 0.025 of the function; a cylinder's blur is off by 0.038 near the pole.
        ASSERT_NEAR(blurred.at(x, y), shrink * static_cast<double>(image.at(x, y)), 0.025)
            << "axis " << axis << " at " << x << ", " << y;
      }
    }
  }
}

TEST(GaussianBlur, TinyPicturesAreBlurredToo) {
  for (const auto& [width, height] : {std::pair{1, 1}, {1, 9}, {9, 1}, {2, 1}}) {
    const Image<float> image(width, height, 1, 2.0F);
    Image<float> blurred;
    GaussianBlur(image, 5.0, PictureShape::kSphere, &blurred);
    ASSERT_EQ(blurred.width(), width);
    for (const float value : blurred.values()) EXPECT_NEAR(value, 2.0F, 1e-5F);
  }
  Image<float> nothing;
  GaussianBlur(Image<float>(0, 0, 1), 1.0, PictureShape::kPlane, &nothing);
  EXPECT_TRUE(nothing.empty());
}

}  // namespace
}  // namespace omnihdr::panorama_blur_test
