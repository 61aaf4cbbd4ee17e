#include "core/pipeline/mover_masks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::mover_masks_test {
namespace {

constexpr int kWidth = 64;
constexpr int kHeight = 32;

class MoverMasks : public ::testing::Test {
 protected:
  MoverMasks() {
    measurement_.flags = Image<std::uint8_t>(kWidth, kHeight, 1, kDarkR);
    frame_.file = "raw/000007.png";
  }
  void Write(const Image<std::uint8_t>& mask) {
    const auto png = EncodePng(mask.view());
    ASSERT_TRUE(png);
    ASSERT_TRUE(WriteFileAtomic(directory_.path() / "000007.png", *png));
  }
  std::ptrdiff_t Marked() const {
    return std::ranges::count_if(measurement_.flags.values(),
                                 [](std::uint8_t f) { return (f & kMover) != 0; });
  }

  omnihdr::testing::TemporaryDirectory directory_;
  Measurement measurement_;
  FrameRecord frame_;
};

TEST_F(MoverMasks, WhiteMarksAndWhatElseIsKnownOfThePixelStays) {
  Image<std::uint8_t> mask(kWidth, kHeight);
  mask.at(10, 20) = 255;
  Write(mask);
  ASSERT_TRUE(MarkMovers(directory_.path(), frame_, &measurement_));
  EXPECT_EQ(Marked(), 1);
  EXPECT_EQ(measurement_.flags.at(10, 20), kMover | kDarkR);
}

TEST_F(MoverMasks, AMaskOfAnotherSizeAndTheSameShapeIsTakenAtItsNearestPixels) {
  Image<std::uint8_t> mask(kWidth / 4, kHeight / 4);
  mask.at(0, 1) = 200;
  Write(mask);
  ASSERT_TRUE(MarkMovers(directory_.path(), frame_, &measurement_));
  EXPECT_EQ(Marked(), 16);
  EXPECT_NE(measurement_.flags.at(3, 7) & kMover, 0);
}

TEST_F(MoverMasks, AFrameWithoutAMaskHasNothingMarked) {
  EXPECT_TRUE(MarkMovers(directory_.path(), frame_, &measurement_));
  EXPECT_EQ(Marked(), 0);
}

TEST_F(MoverMasks, AnotherShapeIsRefusedByName) {
  Write(Image<std::uint8_t>(kWidth, kWidth));
  const Status status = MarkMovers(directory_.path(), frame_, &measurement_);
  ASSERT_FALSE(status);
  EXPECT_NE(status.error().message.find("000007.png: 64x64, expected the shape of the panorama"),
            std::string::npos)
      << status.error().message;
  ASSERT_TRUE(WriteFileAtomic(directory_.path() / "000007.png", std::string_view("no picture")));
  EXPECT_FALSE(MarkMovers(directory_.path(), frame_, &measurement_));
}

}  // namespace
}  // namespace omnihdr::mover_masks_test
