// The parts below the camera.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <array>
#include <filesystem>
#include <fstream>

#include "core/image/image_io.h"
#include "drivers/v4l2/controls.h"
#include "drivers/v4l2/exposure_log.h"
#include "drivers/v4l2/kernel_device.h"
#include "drivers/v4l2/latency.h"
#include "drivers/v4l2/pixel_format.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::parts_test {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using v4l2::StepSample;

v4l2::SetExposure Set(double seconds) {
  v4l2::SetExposure set;
  set.measured.time = ExposureTime::Seconds(seconds);
  return set;
}

v4l2::FrameLayout LayoutOf(std::uint32_t fourcc, int width, int height, std::size_t line) {
  v4l2::FrameLayout layout;
  layout.format = v4l2::FindPixelFormat(fourcc).value();
  layout.width = width;
  layout.height = height;
  layout.bytes_per_line = line;
  layout.image_bytes = line * static_cast<std::size_t>(height);
  return layout;
}

TEST(V4l2Control, TheNearestValueKeepsRangeAndStep) {
  v4l2::Control control;
  control.minimum = -5;
  control.maximum = 21;
  control.step = 10;
  EXPECT_EQ(control.Nearest(-100), -5);
  EXPECT_EQ(control.Nearest(3), 5);
  EXPECT_EQ(control.Nearest(9), 5);
  EXPECT_EQ(control.Nearest(10), 15);
  EXPECT_EQ(control.Nearest(100), 15);
  control.minimum = INT64_MIN;
  control.maximum = INT64_MAX;
  control.step = INT64_MAX;
  EXPECT_LE(control.Nearest(INT64_MAX), INT64_MAX);
}

TEST(V4l2ExposureLog, BeforeTheFirstFrameThatAWriteMayActOnTheOneBeforeIsInForce) {
  v4l2::ExposureLog log;
  log.Reset(4, 3);
  v4l2::SetExposure first;
  first.exposure_raw = 1;
  v4l2::SetExposure second;
  second.exposure_raw = 2;
  log.Wrote(10, first);
  log.Wrote(13, second);
  EXPECT_FALSE(log.InForce(12));
  EXPECT_FALSE(log.InForce(13));
  EXPECT_EQ(log.InForce(14)->exposure_raw, 1);
  EXPECT_EQ(log.InForce(15)->exposure_raw, 1);
  EXPECT_FALSE(log.InForce(16));
  EXPECT_EQ(log.InForce(17)->exposure_raw, 2);
}

TEST(V4l2ExposureLog, TellsOnlyWhatIsCertain) {
  v4l2::ExposureLog log;
  log.Reset(3);
  log.Wrote(0xFFFFFFFE, Set(0.001));
  EXPECT_FALSE(log.InForce(0xFFFFFFFE));
  EXPECT_FALSE(log.InForce(0));  // two frames later
  EXPECT_EQ(log.InForce(1)->measured.time.seconds(), 0.001);
  log.Wrote(5, Set(0.004));
  EXPECT_EQ(log.InForce(5)->measured.time.seconds(), 0.001);
  EXPECT_FALSE(log.InForce(6));
  EXPECT_FALSE(log.InForce(7));
  EXPECT_EQ(log.InForce(8)->measured.time.seconds(), 0.004);
  for (std::uint32_t i = 0; i < 40; ++i) log.Wrote(100 + 10 * i, Set(0.1));
  EXPECT_FALSE(log.InForce(50));  // forgotten
}

TEST(V4l2Latency, IsTheFirstFrameOfTheNewBrightness) {
  for (int lag = 1; lag <= 8; ++lag) {
    std::vector<StepSample> after;
    for (int frame = 1; frame <= 10; ++frame) {
      if (frame == 3 && lag != 3) continue;  // lost
      after.push_back({frame, frame >= lag ? 0.1 + 0.001 * frame : 0.4});
    }
    EXPECT_EQ(v4l2::FindLatency(0.4, after, -2.0), lag);
  }
}

TEST(V4l2Latency, IsNotKnownWhenBrightnessDoesNotFollowOrGoesTheOtherWay) {
  const std::vector<StepSample> still{{1, 0.4}, {2, 0.4}, {3, 0.41}};
  EXPECT_FALSE(v4l2::FindLatency(0.4, still, -2.0));
  const std::vector<StepSample> up{{1, 0.4}, {2, 0.8}, {3, 0.8}};
  EXPECT_FALSE(v4l2::FindLatency(0.4, up, -2.0));
  EXPECT_TRUE(v4l2::FindLatency(0.4, up, 1.0));
  EXPECT_FALSE(v4l2::FindLatency(0.4, {}, 1.0));
  EXPECT_FALSE(v4l2::FindLatency(0.0, up, 1.0));
}

TEST(V4l2Latency, ASmallStepAndAClippedPictureSayNothing) {
  EXPECT_FALSE(v4l2::BrightnessFollowed({0.2, 0.0}, {0.2, 0.0}, 0.5));
  EXPECT_FALSE(v4l2::BrightnessFollowed({0.2, 0.0}, {0.9, 0.6}, 3.0));
  EXPECT_EQ(v4l2::BrightnessFollowed({0.2, 0.0}, {0.2, 0.0}, 2.0), false);
  EXPECT_EQ(v4l2::BrightnessFollowed({0.1, 0.0}, {0.3, 0.0}, 2.0), true);
}

TEST(V4l2Pixels, RowsMayHaveGapsAndWordsAreLittleEndian) {
  const std::array<std::uint8_t, 12> bytes{0x01, 0x02, 0xFF, 0xFF, 9, 9, 0x03, 0x00, 0x04, 0x00};
  const auto pixels =
      v4l2::ReadPixels(std::as_bytes(std::span(bytes)), LayoutOf(V4L2_PIX_FMT_Y10, 2, 2, 6));
  ASSERT_TRUE(pixels) << pixels.error().message;
  const auto& image = std::get<Image<std::uint16_t>>(*pixels);
  EXPECT_THAT(std::vector<std::uint16_t>(image.values().begin(), image.values().end()),
              ElementsAre(0x201, 1023, 3, 4));  // what exceeds ten bits is cut to them
}

TEST(V4l2Pixels, AMjpegFrameIsAPictureOfTheSizeSet) {
  const Image<std::uint8_t> grey(16, 8, 1, 100);
  const std::vector<std::byte> jpeg = EncodeJpeg(grey, 90).value();
  auto layout = LayoutOf(V4L2_PIX_FMT_MJPEG, 16, 8, 0);
  layout.image_bytes = 4096;
  const auto pixels = v4l2::ReadPixels(jpeg, layout);
  ASSERT_TRUE(pixels) << pixels.error().message;
  EXPECT_EQ(std::get<Image<std::uint8_t>>(*pixels).channels(), 3);
  EXPECT_NEAR(v4l2::MeasureLevel(jpeg, layout)->mean, 100.0 / 255.0, 0.01);
  layout.width = 8;
  EXPECT_THAT(v4l2::ReadPixels(jpeg, layout).error().message,
              HasSubstr("16 x 8 pixels: expected 8 x 8"));
  EXPECT_FALSE(v4l2::ReadPixels(std::span(jpeg).first(jpeg.size() / 2), layout));
}

TEST(V4l2Pixels, ALayoutThatContradictsItselfIsAnError) {
  EXPECT_FALSE(v4l2::CheckLayout(LayoutOf(V4L2_PIX_FMT_GREY, 64, 4, 63)));
  EXPECT_FALSE(v4l2::CheckLayout(LayoutOf(V4L2_PIX_FMT_YUYV, 3, 4, 16)));
  EXPECT_FALSE(v4l2::CheckLayout(LayoutOf(V4L2_PIX_FMT_GREY, 65536, 65536, 65536)));
  EXPECT_FALSE(v4l2::CheckLayout(LayoutOf(V4L2_PIX_FMT_GREY, 0, 4, 4)));
  EXPECT_TRUE(v4l2::CheckLayout(LayoutOf(V4L2_PIX_FMT_GREY, 64, 4, 64)));
}

TEST(V4l2Kernel, NodesAreListedByNumberWithTheirNamesAndSerial) {
  namespace fs = std::filesystem;
  const testing::TemporaryDirectory folder;
  const v4l2::KernelRoots roots{folder.path() / "dev", folder.path() / "sys"};
  const fs::path usb = roots.sys / "devices/usb1/1-2";
  const fs::path interface = usb / "1-2:1.0";
  fs::create_directories(interface);
  std::ofstream(usb / "idVendor") << "046d\n";
  std::ofstream(usb / "serial") << "ABC123\n";
  const fs::path list = roots.sys / "class/video4linux";
  for (const char* name : {"video10", "video2", "v4l-subdev0"}) {
    fs::create_directories(list / name);
    fs::create_symlink(interface, list / name / "device");
  }
  fs::create_directories(roots.dev / "v4l/by-id");
  fs::create_symlink("../../video2", roots.dev / "v4l/by-id/usb-Maker_Camera-index0");
  const auto nodes = v4l2::MakeKernelSystem(roots)->List();
  ASSERT_EQ(nodes.size(), 2U);
  EXPECT_EQ(nodes[0].path, (roots.dev / "video2").string());
  EXPECT_THAT(nodes[0].names, ElementsAre("usb-Maker_Camera-index0"));
  EXPECT_EQ(nodes[0].serial, "ABC123");
  EXPECT_EQ(nodes[1].path, (roots.dev / "video10").string());
}

TEST(V4l2Kernel, ANodeThatIsNoDeviceSaysSo) {
  const testing::TemporaryDirectory folder;
  std::ofstream(folder.path() / "file") << "x";
  auto device = v4l2::MakeKernelSystem()->MakeDevice();
  EXPECT_EQ(device->Open((folder.path() / "missing").string()), -ENOENT);
  ASSERT_EQ(device->Open((folder.path() / "file").string()), 0);
  v4l2_capability told{};
  EXPECT_EQ(device->Ioctl(VIDIOC_QUERYCAP, &told), -ENOTTY);
  EXPECT_EQ(v4l2::KindOf(-ENODEV), ErrorKind::kUnavailable);
  EXPECT_EQ(v4l2::KindOf(-EACCES), ErrorKind::kPermission);
}

}  // namespace
}  // namespace omnihdr::parts_test
