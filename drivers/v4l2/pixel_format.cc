#include "drivers/v4l2/pixel_format.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/image/image_io.h"
#include "drivers/v4l2/device.h"

namespace omnihdr::v4l2 {
namespace {

constexpr std::size_t kLevelSamples = 4096;
constexpr double kClippedFrom = 0.98;

constexpr PixelFormat Mosaic(std::uint32_t fourcc, Coding coding, int bits, BayerOrder order) {
  return {fourcc, coding, bits, order, 1};
}

constexpr std::array kFormats = {
    Mosaic(V4L2_PIX_FMT_SBGGR16, Coding::kBayer16, 16, BayerOrder::kBggr),
    Mosaic(V4L2_PIX_FMT_SGBRG16, Coding::kBayer16, 16, BayerOrder::kGbrg),
    Mosaic(V4L2_PIX_FMT_SGRBG16, Coding::kBayer16, 16, BayerOrder::kGrbg),
    Mosaic(V4L2_PIX_FMT_SRGGB16, Coding::kBayer16, 16, BayerOrder::kRggb),
    PixelFormat{V4L2_PIX_FMT_Y16, Coding::kY16, 16, BayerOrder::kNone, 1},
    Mosaic(V4L2_PIX_FMT_SBGGR12, Coding::kBayer12, 12, BayerOrder::kBggr),
    Mosaic(V4L2_PIX_FMT_SGBRG12, Coding::kBayer12, 12, BayerOrder::kGbrg),
    Mosaic(V4L2_PIX_FMT_SGRBG12, Coding::kBayer12, 12, BayerOrder::kGrbg),
    Mosaic(V4L2_PIX_FMT_SRGGB12, Coding::kBayer12, 12, BayerOrder::kRggb),
    PixelFormat{V4L2_PIX_FMT_Y12, Coding::kY12, 12, BayerOrder::kNone, 1},
    Mosaic(V4L2_PIX_FMT_SBGGR10, Coding::kBayer10, 10, BayerOrder::kBggr),
    Mosaic(V4L2_PIX_FMT_SGBRG10, Coding::kBayer10, 10, BayerOrder::kGbrg),
    Mosaic(V4L2_PIX_FMT_SGRBG10, Coding::kBayer10, 10, BayerOrder::kGrbg),
    Mosaic(V4L2_PIX_FMT_SRGGB10, Coding::kBayer10, 10, BayerOrder::kRggb),
    PixelFormat{V4L2_PIX_FMT_Y10, Coding::kY10, 10, BayerOrder::kNone, 1},
    Mosaic(V4L2_PIX_FMT_SBGGR8, Coding::kBayer8, 8, BayerOrder::kBggr),
    Mosaic(V4L2_PIX_FMT_SGBRG8, Coding::kBayer8, 8, BayerOrder::kGbrg),
    Mosaic(V4L2_PIX_FMT_SGRBG8, Coding::kBayer8, 8, BayerOrder::kGrbg),
    Mosaic(V4L2_PIX_FMT_SRGGB8, Coding::kBayer8, 8, BayerOrder::kRggb),
    PixelFormat{V4L2_PIX_FMT_GREY, Coding::kGrey, 8, BayerOrder::kNone, 1},
    PixelFormat{V4L2_PIX_FMT_YUYV, Coding::kYuyv, 8, BayerOrder::kNone, 3},
    PixelFormat{V4L2_PIX_FMT_MJPEG, Coding::kMjpeg, 8, BayerOrder::kNone, 3},
};

std::size_t BytesPerPixel(const PixelFormat& format) {
  return format.bits > 8 || format.coding == Coding::kYuyv ? 2 : 1;
}

std::uint16_t Word(const std::byte* at) {
  return static_cast<std::uint16_t>(std::to_integer<unsigned>(at[0]) |
                                    std::to_integer<unsigned>(at[1]) << 8);
}

std::uint8_t ToByte(double value) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0, 255.0)));
}

Image<std::uint8_t> ReadYuyv(const std::byte* from, const FrameLayout& layout) {
  const double scale = layout.full_range ? 1.0 : 255.0 / 219.0;
  const double chroma = layout.full_range ? 1.0 : 255.0 / 224.0;
  const double black = layout.full_range ? 0.0 : 16.0;
  Image<std::uint8_t> image = Image<std::uint8_t>::Uninitialized(layout.width, layout.height, 3);
  for (int y = 0; y < layout.height; ++y) {
    const std::byte* row = from + static_cast<std::size_t>(y) * layout.bytes_per_line;
    for (int x = 0; x < layout.width; ++x) {
      const std::byte* pair = row + 4 * static_cast<std::size_t>(x / 2);
      const double luma = scale * (std::to_integer<int>(pair[x % 2 == 0 ? 0 : 2]) - black);
      const double cb = chroma * (std::to_integer<int>(pair[1]) - 128.0);
      const double cr = chroma * (std::to_integer<int>(pair[3]) - 128.0);
      std::uint8_t* pixel = image.pixel(x, y);
      pixel[0] = ToByte(luma + 1.402 * cr);
      pixel[1] = ToByte(luma - 0.344136 * cb - 0.714136 * cr);
      pixel[2] = ToByte(luma + 1.772 * cb);
    }
  }
  return image;
}

Result<Image<std::uint8_t>> ReadMjpeg(std::span<const std::byte> bytes, const FrameLayout& layout) {
  // Another size is told by the header already, before anything is allocated for it.
  OMNIHDR_ASSIGN(DecodedImage decoded, DecodeImage(bytes, "MJPEG frame"));
  if (decoded.width() != layout.width || decoded.height() != layout.height || decoded.is_16_bit()) {
    return Fail(ErrorKind::kData, "MJPEG frame: {} x {} pixels: expected {} x {} of 8 bits",
                decoded.width(), decoded.height(), layout.width, layout.height);
  }
  Image<std::uint8_t> image = std::get<Image<std::uint8_t>>(std::move(decoded.pixels));
  if (image.channels() == 3) return image;
  Image<std::uint8_t> colour = Image<std::uint8_t>::Uninitialized(layout.width, layout.height, 3);
  for (std::size_t i = 0; i < image.size(); ++i) {
    std::fill_n(colour.data() + 3 * i, 3, image.data()[i]);
  }
  return colour;
}

Status CheckBytes(std::span<const std::byte> bytes, const FrameLayout& layout) {
  OMNIHDR_TRY(CheckLayout(layout));
  if (layout.format.coding == Coding::kMjpeg) {
    if (bytes.size() >= 4 && bytes[0] == std::byte{0xFF} && bytes[1] == std::byte{0xD8}) return {};
    return Fail(ErrorKind::kData, "MJPEG frame: {} bytes that are no JPEG", bytes.size());
  }
  const std::size_t line = static_cast<std::size_t>(layout.width) * BytesPerPixel(layout.format);
  const std::size_t expected =
      static_cast<std::size_t>(layout.height - 1) * layout.bytes_per_line + line;
  if (bytes.size() >= expected) return {};
  return Fail(ErrorKind::kData, "{} frame: {} bytes: expected {}", FourCcName(layout.format.fourcc),
              bytes.size(), expected);
}

}  // namespace

std::string_view ToString(Coding coding) {
  switch (coding) {
    case Coding::kAuto:
      return "auto";
    case Coding::kGrey:
      return "grey";
    case Coding::kY10:
      return "y10";
    case Coding::kY12:
      return "y12";
    case Coding::kY16:
      return "y16";
    case Coding::kBayer8:
      return "bayer8";
    case Coding::kBayer10:
      return "bayer10";
    case Coding::kBayer12:
      return "bayer12";
    case Coding::kBayer16:
      return "bayer16";
    case Coding::kYuyv:
      return "yuyv";
    case Coding::kMjpeg:
      return "mjpeg";
  }
  return "?";
}

std::span<const PixelFormat> PixelFormats() { return kFormats; }

std::optional<PixelFormat> FindPixelFormat(std::uint32_t fourcc) {
  for (const PixelFormat& format : kFormats) {
    if (format.fourcc == fourcc) return format;
  }
  return std::nullopt;
}

Status CheckLayout(const FrameLayout& layout) {
  if (layout.width < 1 || layout.height < 1 || layout.width > kMaxSide ||
      layout.height > kMaxSide) {
    return Fail(ErrorKind::kProtocol, "{} x {} pixels: expected 1 to {} each", layout.width,
                layout.height, kMaxSide);
  }
  const std::size_t pixels =
      static_cast<std::size_t>(layout.width) * static_cast<std::size_t>(layout.height);
  if (layout.image_bytes > kMaxImageBytes || pixels * 3 > kMaxImageBytes) {
    return Fail(ErrorKind::kProtocol, "{} x {} pixels, {} bytes: expected at most {} bytes",
                layout.width, layout.height, layout.image_bytes, kMaxImageBytes);
  }
  if (layout.format.coding == Coding::kMjpeg) return {};
  if (layout.format.coding == Coding::kYuyv && layout.width % 2 != 0) {
    return Fail(ErrorKind::kProtocol, "YUYV: {} columns: expected an even number", layout.width);
  }
  const std::size_t line = static_cast<std::size_t>(layout.width) * BytesPerPixel(layout.format);
  if (layout.bytes_per_line < line || layout.bytes_per_line > kMaxImageBytes ||
      layout.bytes_per_line * static_cast<std::size_t>(layout.height) > kMaxImageBytes ||
      layout.image_bytes <
          layout.bytes_per_line * static_cast<std::size_t>(layout.height - 1) + line) {
    return Fail(ErrorKind::kProtocol, "{}: {} bytes a line, {} in all: expected room for {} x {}",
                FourCcName(layout.format.fourcc), layout.bytes_per_line, layout.image_bytes,
                layout.width, layout.height);
  }
  return {};
}

Result<Pixels> ReadPixels(std::span<const std::byte> bytes, const FrameLayout& layout) {
  OMNIHDR_TRY(CheckBytes(bytes, layout));
  const PixelFormat& format = layout.format;
  if (format.coding == Coding::kMjpeg) {
    OMNIHDR_ASSIGN(Image<std::uint8_t> image, ReadMjpeg(bytes, layout));
    return Pixels(std::move(image));
  }
  if (format.coding == Coding::kYuyv) return Pixels(ReadYuyv(bytes.data(), layout));
  if (format.bits == 8) {
    auto image = Image<std::uint8_t>::Uninitialized(layout.width, layout.height);
    for (int y = 0; y < layout.height; ++y) {
      std::memcpy(image.row(y), bytes.data() + static_cast<std::size_t>(y) * layout.bytes_per_line,
                  static_cast<std::size_t>(layout.width));
    }
    return Pixels(std::move(image));
  }
  const auto most = static_cast<std::uint16_t>((1U << format.bits) - 1U);
  auto image = Image<std::uint16_t>::Uninitialized(layout.width, layout.height);
  for (int y = 0; y < layout.height; ++y) {
    const std::byte* row = bytes.data() + static_cast<std::size_t>(y) * layout.bytes_per_line;
    std::uint16_t* to = image.row(y);
    for (int x = 0; x < layout.width; ++x) {
      to[x] = std::min(Word(row + 2 * static_cast<std::size_t>(x)), most);
    }
  }
  return Pixels(std::move(image));
}

Pixels BlackPixels(const FrameLayout& layout) {
  if (layout.format.bits > 8) return Image<std::uint16_t>(layout.width, layout.height);
  return Image<std::uint8_t>(layout.width, layout.height, layout.format.channels);
}

Result<Level> MeasureLevel(std::span<const std::byte> bytes, const FrameLayout& layout) {
  OMNIHDR_TRY(CheckBytes(bytes, layout));
  const PixelFormat& format = layout.format;
  std::optional<Image<std::uint8_t>> decoded;
  if (format.coding == Coding::kMjpeg) {
    OMNIHDR_ASSIGN(decoded, ReadMjpeg(bytes, layout));
  }
  const bool video = format.coding == Coding::kYuyv && !layout.full_range;
  const double black = video ? 16.0 : 0.0;
  const double white = video ? 235.0 : static_cast<double>((1U << format.bits) - 1U);
  const auto width = static_cast<std::size_t>(layout.width);
  const std::size_t pixels = width * static_cast<std::size_t>(layout.height);
  // Odd, so that samples of a mosaic are of every colour.
  const std::size_t step = std::max<std::size_t>(pixels / kLevelSamples, 1) | 1U;
  double sum = 0.0;
  std::size_t count = 0;
  std::size_t clipped = 0;
  for (std::size_t i = 0; i < pixels; i += step) {
    const std::size_t at = i / width * layout.bytes_per_line + i % width * BytesPerPixel(format);
    const double value = decoded           ? decoded->data()[3 * i + 1]
                         : format.bits > 8 ? Word(bytes.data() + at)
                                           : std::to_integer<int>(bytes[at]);
    const double share = std::clamp((value - black) / (white - black), 0.0, 1.0);
    sum += share;
    ++count;
    if (share >= kClippedFrom) ++clipped;
  }
  return Level{sum / static_cast<double>(count),
               static_cast<double>(clipped) / static_cast<double>(count)};
}

}  // namespace omnihdr::v4l2
