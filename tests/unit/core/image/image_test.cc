#include "core/image/image.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <type_traits>
#include <utility>

namespace omnihdr::image_test {
namespace {

static_assert(!std::is_copy_constructible_v<Image<float>>, "a copy is written as Clone()");
static_assert(!std::is_convertible_v<ImageView<const float>, ImageView<float>>);

TEST(Image, StartsAtZeroOnACacheLine) {
  const Image<float> image(7, 5, 3);
  EXPECT_EQ(image.size(), 105U);
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(image.data()) % 64, 0U);
  for (const float v : image.values()) EXPECT_EQ(v, 0.0F);
}

TEST(Image, PixelsAreInterleavedRowByRow) {
  Image<int> image(3, 2, 2);
  for (std::size_t k = 0; k < image.size(); ++k) image.data()[k] = static_cast<int>(k);
  EXPECT_EQ(image.at(0, 0, 1), 1);
  EXPECT_EQ(image.at(2, 0, 0), 4);
  EXPECT_EQ(image.at(1, 1, 1), 9);
  EXPECT_EQ(image.row(1), image.data() + 6);
}

TEST(Image, ACloneIsIndependent) {
  Image<int> image(2, 2, 1, 5);
  Image<int> copy = image.Clone();
  copy.at(0, 0) = 9;
  EXPECT_EQ(image.at(0, 0), 5);
  EXPECT_EQ(copy.at(1, 1), 5);
}

TEST(Image, IsEmptyAfterItsPixelsWereMovedAway) {
  Image<int> image(2, 2, 1, 5);
  const Image<int> other = std::move(image);
  EXPECT_TRUE(image.empty());  // NOLINT(bugprone-use-after-move): that is the question
  EXPECT_EQ(image.size(), 0U);
  EXPECT_EQ(other.at(1, 1), 5);
}

TEST(ImageView, ACropKeepsTheStrideOfTheWhole) {
  Image<int> image(4, 3, 1);
  for (std::size_t k = 0; k < image.size(); ++k) image.data()[k] = static_cast<int>(k);
  const ImageView<int> crop = image.view().Crop(1, 1, 2, 2);
  EXPECT_EQ(crop.width(), 2);
  EXPECT_EQ(crop.at(0, 0), 5);
  EXPECT_EQ(crop.at(1, 1), 10);
  crop.at(1, 1) = 77;
  EXPECT_EQ(image.at(2, 2), 77);
}

}  // namespace
}  // namespace omnihdr::image_test
