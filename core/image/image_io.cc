#include "core/image/image_io.h"

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <array>
#include <cstring>
#include <optional>

#include "core/base/file.h"

namespace omnihdr {
namespace {

using Bytes = std::span<const std::byte>;

std::uint32_t At(Bytes bytes, std::size_t offset) {
  return static_cast<std::uint32_t>(bytes[offset]);
}
std::uint32_t BigEndian32(Bytes b, std::size_t o) {
  return At(b, o) << 24 | At(b, o + 1) << 16 | At(b, o + 2) << 8 | At(b, o + 3);
}
std::uint32_t BigEndian16(Bytes b, std::size_t o) { return At(b, o) << 8 | At(b, o + 1); }

enum class FileType { kPng, kJpeg, kTiff };

std::optional<FileType> Sniff(Bytes b) {
  static constexpr std::array<unsigned char, 8> kPngMagic = {0x89, 'P', 'N', 'G', 13, 10, 26, 10};
  if (b.size() >= 24 && std::memcmp(b.data(), kPngMagic.data(), 8) == 0) return FileType::kPng;
  if (b.size() >= 4 && At(b, 0) == 0xFF && At(b, 1) == 0xD8 && At(b, 2) == 0xFF) {
    return FileType::kJpeg;
  }
  if (b.size() >= 8 && ((At(b, 0) == 'I' && At(b, 1) == 'I' && At(b, 2) == 42 && At(b, 3) == 0) ||
                        (At(b, 0) == 'M' && At(b, 1) == 'M' && At(b, 2) == 0 && At(b, 3) == 42))) {
    return FileType::kTiff;
  }
  return std::nullopt;
}

struct Size {
  std::size_t width = 0;
  std::size_t height = 0;
};

std::optional<Size> JpegSize(Bytes b) {
  std::size_t o = 2;
  while (o + 9 < b.size()) {
    if (At(b, o) != 0xFF) return std::nullopt;
    const std::uint32_t marker = At(b, o + 1);
    if (marker == 0xFF) {  // fill byte
      ++o;
      continue;
    }
    const bool is_frame =
        marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (is_frame) return Size{BigEndian16(b, o + 7), BigEndian16(b, o + 5)};
    o += 2 + BigEndian16(b, o + 2);
  }
  return std::nullopt;
}

std::optional<Size> TiffSize(Bytes b) {
  const bool little = At(b, 0) == 'I';
  const auto u16 = [&](std::size_t o) {
    return little ? At(b, o) | At(b, o + 1) << 8 : BigEndian16(b, o);
  };
  const auto u32 = [&](std::size_t o) {
    return little ? u16(o) | u16(o + 2) << 16 : BigEndian32(b, o);
  };
  const std::size_t directory = u32(4);
  if (directory + 2 > b.size()) return std::nullopt;
  const std::size_t entries = u16(directory);
  Size size;
  for (std::size_t i = 0; i < entries; ++i) {
    const std::size_t o = directory + 2 + 12 * i;
    if (o + 12 > b.size()) return std::nullopt;
    const std::uint32_t tag = u16(o);
    const std::size_t value = u16(o + 2) == 3 ? u16(o + 8) : u32(o + 8);  // SHORT or LONG
    if (tag == 256) size.width = value;
    if (tag == 257) size.height = value;
  }
  if (size.width == 0 || size.height == 0) return std::nullopt;
  return size;
}

// A JPEG decoder fills the missing rows of a truncated file with grey; the end marker tells.
bool HasJpegEnd(Bytes b) {
  std::size_t end = b.size();
  while (end > 0 && At(b, end - 1) == 0) --end;  // some writers pad with zeros
  return end >= 2 && At(b, end - 2) == 0xFF && At(b, end - 1) == 0xD9;
}

template <typename T>
Image<T> FromMat(const cv::Mat& mat) {
  Image<T> image(mat.cols, mat.rows, mat.channels());
  cv::Mat target(mat.rows, mat.cols, mat.type(), image.data());
  if (mat.channels() == 3) {
    cv::cvtColor(mat, target, cv::COLOR_BGR2RGB);
  } else {
    mat.copyTo(target);
  }
  return image;
}

template <typename T>
cv::Mat ToBgrMat(ImageView<const T> image) {
  const int depth = sizeof(T) == 1 ? CV_8U : CV_16U;
  // OpenCV has no type for constant pixels; the header is only read from.
  const cv::Mat source(
      image.height(), image.width(), CV_MAKETYPE(depth, image.channels()),
      const_cast<T*>(image.row(0)),  // NOLINT(cppcoreguidelines-pro-type-const-cast)
      static_cast<std::size_t>(image.stride()) * sizeof(T));
  cv::Mat bgr;
  if (image.channels() == 3) {
    cv::cvtColor(source, bgr, cv::COLOR_RGB2BGR);
  } else {
    source.copyTo(bgr);
  }
  return bgr;
}

Result<std::vector<std::byte>> Encode(const char* extension, const cv::Mat& mat,
                                      const std::vector<int>& parameters) {
  try {
    std::vector<unsigned char> buffer;
    if (!cv::imencode(extension, mat, buffer, parameters)) {
      return Fail(ErrorKind::kSoftware, "encoding a {}x{} picture as {} failed", mat.cols, mat.rows,
                  extension);
    }
    std::vector<std::byte> bytes(buffer.size());
    std::memcpy(bytes.data(), buffer.data(), buffer.size());
    return bytes;
  } catch (const std::exception& e) {
    return Fail(ErrorKind::kSoftware, "encoding a {}x{} picture as {}: {}", mat.cols, mat.rows,
                extension, e.what());
  }
}

template <typename T>
Result<std::vector<std::byte>> EncodeLossless(const char* extension, ImageView<const T> image,
                                              const std::vector<int>& parameters) {
  if (image.empty() || (image.channels() != 1 && image.channels() != 3)) {
    return Fail(ErrorKind::kSoftware, "{}: {}x{} with {} channels, expected 1 or 3 channels",
                extension, image.width(), image.height(), image.channels());
  }
  return Encode(extension, ToBgrMat(image), parameters);
}

bool Holds(const PhotoSphere& sphere, int width, int height) {
  const auto within = [](const std::optional<double>& angle, double low, double high) {
    return !angle || (*angle >= low && *angle <= high);
  };
  return sphere.left >= 0 && sphere.top >= 0 && sphere.left + width <= sphere.full_width &&
         sphere.top + height <= sphere.full_height && within(sphere.heading_deg, 0.0, 360.0) &&
         sphere.heading_deg != 360.0 && within(sphere.pitch_deg, -90.0, 90.0) &&
         within(sphere.roll_deg, -180.0, 180.0);
}

// XMP packet of a spherical panorama (Google Photo Sphere XMP metadata), as an APP1 segment.
std::vector<std::byte> PanoramaSegment(int width, int height, const PhotoSphere& sphere) {
  std::optional<double> heading = sphere.heading_deg;
  if (heading && *heading >= 359.9995) heading = 0.0;  // would be written as 360.000
  std::string pose;
  for (const auto& [name, angle] :
       {std::pair{"Heading", heading}, std::pair{"Pitch", sphere.pitch_deg},
        std::pair{"Roll", sphere.roll_deg}}) {
    if (angle) pose += fmt::format(" GPano:Pose{}Degrees=\"{:.3f}\"", name, *angle);
  }
  const std::string xml = fmt::format(
      "<?xpacket begin=\"\xEF\xBB\xBF\" id=\"W5M0MpCehiHzreSzNTczkc9d\"?>"
      "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\">"
      "<rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">"
      "<rdf:Description rdf:about=\"\" xmlns:GPano=\"http://ns.google.com/photos/1.0/panorama/\""
      " GPano:UsePanoramaViewer=\"True\" GPano:ProjectionType=\"equirectangular\""
      " GPano:StitchingSoftware=\"omnihdr " OMNIHDR_VERSION
      "\""
      " GPano:CroppedAreaImageWidthPixels=\"{}\" GPano:CroppedAreaImageHeightPixels=\"{}\""
      " GPano:FullPanoWidthPixels=\"{}\" GPano:FullPanoHeightPixels=\"{}\""
      " GPano:CroppedAreaLeftPixels=\"{}\" GPano:CroppedAreaTopPixels=\"{}\"{}/>"
      "</rdf:RDF></x:xmpmeta><?xpacket end=\"w\"?>",
      width, height, sphere.full_width, sphere.full_height, sphere.left, sphere.top, pose);
  static constexpr char kNamespace[] = "http://ns.adobe.com/xap/1.0/";
  const std::size_t length = 2 + sizeof(kNamespace) + xml.size();
  std::vector<std::byte> segment = {std::byte{0xFF}, std::byte{0xE1},
                                    static_cast<std::byte>(length >> 8),
                                    static_cast<std::byte>(length & 0xFF)};
  const auto append = [&segment](const char* text, std::size_t size) {
    const auto* first = reinterpret_cast<const std::byte*>(text);
    segment.insert(segment.end(), first, first + size);
  };
  append(kNamespace, sizeof(kNamespace));  // with its terminating zero
  append(xml.data(), xml.size());
  return segment;
}

}  // namespace

int DecodedImage::width() const {
  return std::visit([](const auto& image) { return image.width(); }, pixels);
}
int DecodedImage::height() const {
  return std::visit([](const auto& image) { return image.height(); }, pixels);
}
int DecodedImage::channels() const {
  return std::visit([](const auto& image) { return image.channels(); }, pixels);
}

Result<DecodedImage> ReadImage(const std::filesystem::path& path) {
  OMNIHDR_ASSIGN(const std::vector<std::byte> bytes, ReadFile(path));
  return DecodeImage(bytes, path.string());
}

Result<DecodedImage> DecodeImage(std::span<const std::byte> bytes, const std::string& name) {
  const std::optional<FileType> type = Sniff(bytes);
  if (!type) return Fail(ErrorKind::kData, "{}: not a PNG, JPEG or TIFF file", name);
  std::optional<Size> size;
  switch (*type) {
    case FileType::kPng:
      size = Size{BigEndian32(bytes, 16), BigEndian32(bytes, 20)};
      break;
    case FileType::kJpeg:
      size = JpegSize(bytes);
      break;
    case FileType::kTiff:
      size = TiffSize(bytes);
      break;
  }
  if (!size || size->width == 0 || size->height == 0) {
    return Fail(ErrorKind::kData, "{}: damaged header, no image size found", name);
  }
  if (size->width > kMaxImagePixels || size->height > kMaxImagePixels / size->width) {
    return Fail(ErrorKind::kData, "{}: {}x{} pixels, expected at most {} pixels", name, size->width,
                size->height, kMaxImagePixels);
  }
  if (*type == FileType::kJpeg && !HasJpegEnd(bytes)) {
    return Fail(ErrorKind::kData, "{}: truncated JPEG (no end marker)", name);
  }
  try {
    // OpenCV has no type for constant input; imdecode only reads it.
    const cv::Mat buffer(1, static_cast<int>(bytes.size()), CV_8U,
                         const_cast<std::byte*>(bytes.data()));  // NOLINT
    const cv::Mat mat = cv::imdecode(
        buffer, cv::IMREAD_ANYDEPTH | cv::IMREAD_ANYCOLOR | cv::IMREAD_IGNORE_ORIENTATION);
    if (mat.empty()) return Fail(ErrorKind::kData, "{}: damaged or truncated image file", name);
    if (mat.channels() != 1 && mat.channels() != 3) {
      return Fail(ErrorKind::kData, "{}: {} channels, expected 1 or 3", name, mat.channels());
    }
    if (mat.depth() == CV_8U) return DecodedImage{FromMat<std::uint8_t>(mat)};
    if (mat.depth() == CV_16U) return DecodedImage{FromMat<std::uint16_t>(mat)};
    return Fail(ErrorKind::kData, "{}: neither 8 nor 16 bits per value", name);
  } catch (const std::exception& e) {
    return Fail(ErrorKind::kData, "{}: {}", name, e.what());
  }
}

namespace {

// Level 1 is what a camera's rate needs: differences to the left and run lengths, a third of the
// time and a seventh more bytes than level 1 with the best filter chosen row by row.
std::vector<int> PngParameters(int compression) {
  if (compression == 1) return {};
  return {cv::IMWRITE_PNG_COMPRESSION, compression};
}

}  // namespace

Result<std::vector<std::byte>> EncodePng(ImageView<const std::uint8_t> image, int compression) {
  return EncodeLossless(".png", image, PngParameters(compression));
}

Result<std::vector<std::byte>> EncodePng(ImageView<const std::uint16_t> image, int compression) {
  return EncodeLossless(".png", image, PngParameters(compression));
}

Result<std::vector<std::byte>> EncodeTiff(ImageView<const std::uint8_t> image) {
  return EncodeLossless(".tiff", image, {});
}

Result<std::vector<std::byte>> EncodeTiff(ImageView<const std::uint16_t> image) {
  return EncodeLossless(".tiff", image, {});
}

namespace {

Result<std::vector<std::byte>> EncodeJpegOf(ImageView<const std::uint8_t> image, int quality,
                                            const PhotoSphere* sphere) {
  if (image.empty() || (image.channels() != 1 && image.channels() != 3)) {
    return Fail(ErrorKind::kSoftware, "JPEG: {}x{} with {} channels, expected 1 or 3 channels",
                image.width(), image.height(), image.channels());
  }
  if (sphere != nullptr && !Holds(*sphere, image.width(), image.height())) {
    return Fail(
        ErrorKind::kSoftware,
        "JPEG: {}x{} at column {}, row {} of a sphere of {}x{}: does not fit, or the angles "
        "of its centre are out of range",
        image.width(), image.height(), sphere->left, sphere->top, sphere->full_width,
        sphere->full_height);
  }
  OMNIHDR_ASSIGN(std::vector<std::byte> jpeg,
                 Encode(".jpg", ToBgrMat(image), {cv::IMWRITE_JPEG_QUALITY, quality}));
  if (sphere != nullptr) {
    const std::vector<std::byte> segment = PanoramaSegment(image.width(), image.height(), *sphere);
    // After SOI and the JFIF segment, which must stay first.
    std::size_t where = 2;
    if (jpeg.size() > 6 && jpeg[2] == std::byte{0xFF} && jpeg[3] == std::byte{0xE0}) {
      where += 2 + BigEndian16(jpeg, 4);
    }
    if (where > jpeg.size()) where = 2;
    jpeg.insert(jpeg.begin() + static_cast<std::ptrdiff_t>(where), segment.begin(), segment.end());
  }
  return jpeg;
}

}  // namespace

Result<std::vector<std::byte>> EncodeJpeg(ImageView<const std::uint8_t> image, int quality,
                                          bool panorama) {
  const PhotoSphere whole{.full_width = image.width(), .full_height = image.height()};
  return EncodeJpegOf(image, quality, panorama ? &whole : nullptr);
}

Result<std::vector<std::byte>> EncodeJpeg(ImageView<const std::uint8_t> image, int quality,
                                          const PhotoSphere& sphere) {
  return EncodeJpegOf(image, quality, &sphere);
}

}  // namespace omnihdr
