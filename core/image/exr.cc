#include "core/image/exr.h"

#include <ImathBox.h>
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfChromaticitiesAttribute.h>
#include <OpenEXR/ImfEnvmapAttribute.h>
#include <OpenEXR/ImfFloatAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <OpenEXR/openexr.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include "core/base/parallel_for.h"
#include "core/image/half_row.h"
#include "core/image/image_io.h"

namespace omnihdr {
namespace {

constexpr std::size_t kMaxExrValues = 4 * kMaxImagePixels;  // over all channels: 4 GiB of floats

// A file whose floats need more than the first number holds at least their size by the second:
// black pictures of 8192 x 4096 shrink by 408 (PIZ), 1012 (ZIP), 33298 (DWAB, the most of all
// compressions).
constexpr std::size_t kUnquestionedBytes = std::size_t{1} << 28;
constexpr std::size_t kMaxCompression = 1 << 16;

Imf::Compression ToImf(ExrCompression compression) {
  switch (compression) {
    case ExrCompression::kNone:
      return Imf::NO_COMPRESSION;
    case ExrCompression::kZips:
      return Imf::ZIPS_COMPRESSION;
    case ExrCompression::kZip:
      return Imf::ZIP_COMPRESSION;
    case ExrCompression::kPiz:
      return Imf::PIZ_COMPRESSION;
  }
  return Imf::ZIPS_COMPRESSION;
}

Imf::PixelType ToImf(ExrPixelType type) {
  switch (type) {
    case ExrPixelType::kHalf:
      return Imf::HALF;
    case ExrPixelType::kFloat:
      return Imf::FLOAT;
    case ExrPixelType::kUint:
      return Imf::UINT;
  }
  return Imf::FLOAT;
}

ExrPixelType FromImf(Imf::PixelType type) {
  if (type == Imf::HALF) return ExrPixelType::kHalf;
  return type == Imf::UINT ? ExrPixelType::kUint : ExrPixelType::kFloat;
}

std::uint32_t WholeNumber(float value) {
  constexpr float kEnd = 4294967296.0F;
  if (!(value > 0.0F)) return 0;
  return value < kEnd ? static_cast<std::uint32_t>(value) : 0xFFFFFFFFU;
}

// The channel's values as they are stored; `convert`: as HalfRow.
template <typename T, typename Convert>
Image<T> Stored(const ExrChannel& channel, const Convert& convert) {
  Image<T> out = Image<T>::Uninitialized(channel.pixels.width(), channel.pixels.height());
  ParallelFor(out.height(), 32, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      convert(channel.pixels.row(y) + channel.channel, channel.pixels.channels(), out.width(),
              out.row(y));
    }
  });
  return out;
}
void CopyRow(const float* values, int stride, int count, float* out) {
  for (int i = 0; i < count; ++i) out[i] = values[i * stride];
}
void WholeRow(const float* values, int stride, int count, std::uint32_t* out) {
  for (int i = 0; i < count; ++i) out[i] = WholeNumber(values[i * stride]);
}

template <typename T>
Imf::Slice SliceOf(Imf::PixelType type, Image<T>* pixels) {
  return {type, reinterpret_cast<char*>(pixels->data()), sizeof(T),
          sizeof(T) * static_cast<std::size_t>(pixels->width())};
}

Imf::Chromaticities ToImf(const Chromaticities& c) {
  const auto xy = [&c](std::size_t i) {
    return Imath::V2f(static_cast<float>(c[i]), static_cast<float>(c[i + 1]));
  };
  return {xy(0), xy(2), xy(4), xy(6)};
}

// Attributes of type string or float that describe the form of the file they were read from.
bool IsAboutTheFile(std::string_view name) {
  return name == "type" || name == "name" || name == "pixelAspectRatio" ||
         name == "screenWindowWidth";
}

// A header that the C library has read.
class ExrHeader {
 public:
  explicit ExrHeader(const std::filesystem::path& path) {
    reason_.clear();
    exr_context_initializer_t wishes = EXR_DEFAULT_CONTEXT_INITIALIZER;
    wishes.error_handler_fn = [](exr_const_context_t, exr_result_t, const char* message) {
      if (reason_.empty()) reason_ = message;
    };
    wishes.flags = EXR_CONTEXT_FLAG_STRICT_HEADER;  // else it stops at an end in the wrong place
    const exr_result_t result = exr_start_read(&context_, path.c_str(), &wishes);
    if (result != EXR_ERR_SUCCESS && reason_.empty()) {
      reason_ = exr_get_default_error_message(result);
    }
    std::erase_if(reason_, [](char c) { return static_cast<unsigned char>(c) < ' '; });
  }
  ExrHeader(const ExrHeader&) = delete;
  ExrHeader& operator=(const ExrHeader&) = delete;
  ~ExrHeader() { exr_finish(&context_); }

  // What is wrong with it, or "". An attribute that does not fit is told, skipped, and no failure
  // of the whole; here it is one.
  static const std::string& reason() { return reason_; }

  exr_attr_box2i_t DataWindow() const {
    exr_attr_box2i_t window = {};
    exr_get_data_window(context_, 0, &window);
    return window;
  }
  std::size_t ChannelCount() const {
    const exr_attr_chlist_t* channels = nullptr;
    exr_get_channels(context_, 0, &channels);
    return channels == nullptr ? 0 : static_cast<std::size_t>(channels->num_channels);
  }

 private:
  inline static thread_local std::string reason_;  // the handler is told of nothing of ours
  exr_context_t context_ = nullptr;
};

struct ExrSize {
  std::int64_t width = 0;
  std::int64_t height = 0;
  std::size_t channels = 0;
  bool operator==(const ExrSize&) const = default;
};

ExrSize SizeOf(const Imf::Header& header) {
  const Imath::Box2i& window = header.dataWindow();
  ExrSize size{std::int64_t{window.max.x} - window.min.x + 1,
               std::int64_t{window.max.y} - window.min.y + 1, 0};
  for (auto it = header.channels().begin(); it != header.channels().end(); ++it) ++size.channels;
  return size;
}

// What a file says it is, if it may be that, before anything of that size is made. OpenEXR's C
// library holds every size in a header against the file's; the C++ library believes them, and gives
// an attribute of a small file up to 2 GiB before it reads it.
Result<ExrSize> CheckedSize(const std::filesystem::path& path) {
  const ExrHeader header(path);
  if (!ExrHeader::reason().empty()) {
    return Fail(ErrorKind::kData, "{}: {}", path.string(), ExrHeader::reason());
  }
  const exr_attr_box2i_t window = header.DataWindow();
  const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
  const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
  if (width <= 0 || height <= 0 ||
      static_cast<std::size_t>(width) > kMaxImagePixels / static_cast<std::size_t>(height)) {
    return Fail(ErrorKind::kData, "{}: {}x{} pixels, expected at most {} pixels", path.string(),
                width, height, kMaxImagePixels);
  }
  const std::size_t channels = header.ChannelCount();
  const std::size_t pixels_allowed = kMaxExrValues / std::max(channels, std::size_t{1});
  if (static_cast<std::size_t>(width) > pixels_allowed / static_cast<std::size_t>(height)) {
    return Fail(ErrorKind::kData, "{}: {} channels of {}x{} pixels, expected at most {} values",
                path.string(), channels, width, height, kMaxExrValues);
  }
  // Lines are read in blocks of up to so many, whole ones even of a picture that has fewer.
  constexpr std::int64_t kMostLinesOfABlock = 256;
  const std::size_t bytes = sizeof(float) * channels *
                            static_cast<std::size_t>(width * std::max(height, kMostLinesOfABlock));
  std::error_code error;
  const std::uintmax_t stored = std::filesystem::file_size(path, error);
  if (!error && bytes > kUnquestionedBytes && bytes / kMaxCompression > stored) {
    return Fail(ErrorKind::kData,
                "{}: {} bytes for {} channels of {}x{} pixels, expected at least {}", path.string(),
                stored, channels, width, height, bytes / kMaxCompression);
  }
  return ExrSize{width, height, channels};
}

ExrAttributes ReadAttributes(const Imf::Header& header) {
  ExrAttributes attributes;
  attributes.envmap = ExrEnvmap::kNone;
  for (auto it = header.begin(); it != header.end(); ++it) {
    const Imf::Attribute* attribute = &it.attribute();
    if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(attribute)) {
      if (!IsAboutTheFile(it.name())) attributes.strings[it.name()] = text->value();
    } else if (const auto* number = dynamic_cast<const Imf::FloatAttribute*>(attribute)) {
      if (!IsAboutTheFile(it.name())) attributes.floats[it.name()] = number->value();
    } else if (const auto* envmap = dynamic_cast<const Imf::EnvmapAttribute*>(attribute)) {
      if (envmap->value() == Imf::ENVMAP_LATLONG) attributes.envmap = ExrEnvmap::kLatLong;
      if (envmap->value() == Imf::ENVMAP_CUBE) attributes.envmap = ExrEnvmap::kCube;
    } else if (const auto* colour = dynamic_cast<const Imf::ChromaticitiesAttribute*>(attribute)) {
      const Imf::Chromaticities& c = colour->value();
      attributes.chromaticities = Chromaticities{c.red.x,  c.red.y,  c.green.x, c.green.y,
                                                 c.blue.x, c.blue.y, c.white.x, c.white.y};
    }
  }
  return attributes;
}

}  // namespace

ExrPixelType SmallestType(ImageView<const float> pixels) {
  for (int y = 0; y < pixels.height(); ++y) {
    const float* row = pixels.row(y);
    for (int i = 0; i < pixels.width() * pixels.channels(); ++i) {
      const float magnitude = std::abs(row[i]);
      if (magnitude > kLargestHalf && std::isfinite(magnitude)) return ExrPixelType::kFloat;
    }
  }
  return ExrPixelType::kHalf;
}

std::string WhyNotChromaticities(const Chromaticities& c) {
  for (const double value : c) {
    if (!(value >= -1.0 && value <= 2.0)) return fmt::format("{:g}, expected -1 to 2", value);
  }
  if (c[7] <= 0.0) return fmt::format("y of white {:g}, expected more than 0", c[7]);
  // On which side of the line from one primary to the next white lies.
  const auto side = [&c](std::size_t from, std::size_t to) {
    return (c[to] - c[from]) * (c[7] - c[from + 1]) - (c[to + 1] - c[from + 1]) * (c[6] - c[from]);
  };
  const double red_green = side(0, 2);
  const double green_blue = side(2, 4);
  const double blue_red = side(4, 0);
  const bool is_inside = (red_green > 0.0 && green_blue > 0.0 && blue_red > 0.0) ||
                         (red_green < 0.0 && green_blue < 0.0 && blue_red < 0.0);
  if (is_inside) return {};
  return fmt::format("white ({:g}, {:g}), expected inside the triangle of red, green and blue",
                     c[6], c[7]);
}

Status WriteExr(const std::filesystem::path& path, const std::vector<ExrChannel>& channels,
                const ExrAttributes& attributes, ExrCompression compression) {
  if (channels.empty() || channels.front().pixels.empty()) {
    return Fail(ErrorKind::kSoftware, "{}: no pixels to write", path.string());
  }
  const int width = channels.front().pixels.width();
  const int height = channels.front().pixels.height();
  try {
    Imf::Header header(width, height);
    header.compression() = ToImf(compression);
    header.zipCompressionLevel() = 2;  // level 4 and up cost twice the time for 2 % of the size
    if (attributes.envmap == ExrEnvmap::kLatLong) Imf::addEnvmap(header, Imf::ENVMAP_LATLONG);
    if (attributes.envmap == ExrEnvmap::kCube) Imf::addEnvmap(header, Imf::ENVMAP_CUBE);
    if (attributes.chromaticities) {
      Imf::addChromaticities(header, ToImf(*attributes.chromaticities));
    }
    for (const auto& [name, value] : attributes.strings) {
      header.insert(name, Imf::StringAttribute(value));
    }
    for (const auto& [name, value] : attributes.floats) {
      header.insert(name, Imf::FloatAttribute(static_cast<float>(value)));
    }
    Imf::FrameBuffer frame_buffer;
    std::vector<Image<std::uint16_t>> halves(channels.size());
    std::vector<Image<float>> floats(channels.size());
    std::vector<Image<std::uint32_t>> numbers(channels.size());
    for (std::size_t k = 0; k < channels.size(); ++k) {
      const ExrChannel& channel = channels[k];
      if (channel.pixels.width() != width || channel.pixels.height() != height) {
        return Fail(ErrorKind::kSoftware, "{}: channel {} is {}x{}, expected {}x{}", path.string(),
                    channel.name, channel.pixels.width(), channel.pixels.height(), width, height);
      }
      const Imf::PixelType type = ToImf(channel.type);
      header.channels().insert(channel.name, Imf::Channel(type));
      switch (channel.type) {
        case ExrPixelType::kHalf:
          halves[k] = Stored<std::uint16_t>(channel, HalfRow);
          frame_buffer.insert(channel.name, SliceOf(type, &halves[k]));
          break;
        case ExrPixelType::kFloat:
          floats[k] = Stored<float>(channel, CopyRow);
          frame_buffer.insert(channel.name, SliceOf(type, &floats[k]));
          break;
        case ExrPixelType::kUint:
          numbers[k] = Stored<std::uint32_t>(channel, WholeRow);
          frame_buffer.insert(channel.name, SliceOf(type, &numbers[k]));
          break;
      }
    }
    Imf::OutputFile file(path.c_str(), header, WorkerCount());
    file.setFrameBuffer(frame_buffer);
    file.writePixels(height);
  } catch (const std::exception& e) {
    return Fail(ErrorKind::kIo, "{}: {}", path.string(), e.what());
  }
  return {};
}

Status WriteExrAtomic(const std::filesystem::path& path, const std::vector<ExrChannel>& channels,
                      const ExrAttributes& attributes, ExrCompression compression) {
  std::filesystem::path temporary = path;
  temporary += ".tmp";
  Status written = WriteExr(temporary, channels, attributes, compression);
  std::error_code error;
  if (written) std::filesystem::rename(temporary, path, error);
  if (written && !error) return {};
  std::error_code ignored;
  std::filesystem::remove(temporary, ignored);
  OMNIHDR_TRY(std::move(written));
  return Fail(ErrorKind::kCannotCreate, "{}: {}", path.string(), error.message());
}

Result<ExrImage> ReadExr(const std::filesystem::path& path) {
  OMNIHDR_ASSIGN(const ExrSize checked, CheckedSize(path));
  try {
    Imf::InputFile file(path.c_str());
    // Two libraries read it: what one has checked must be what the other goes by.
    const ExrSize size = SizeOf(file.header());
    if (size != checked) {
      return Fail(ErrorKind::kData,
                  "{}: a header that reads as {} channels of {}x{} pixels and as {} of {}x{}, "
                  "expected one that reads in one way",
                  path.string(), checked.channels, checked.width, checked.height, size.channels,
                  size.width, size.height);
    }
    const Imath::Box2i& window = file.header().dataWindow();
    const std::int64_t width = size.width;
    if (!file.isComplete()) return Fail(ErrorKind::kData, "{}: truncated EXR file", path.string());
    ExrImage image;
    image.width = static_cast<int>(size.width);
    image.height = static_cast<int>(size.height);
    Imf::FrameBuffer frame_buffer;
    for (auto it = file.header().channels().begin(); it != file.header().channels().end(); ++it) {
      if (it.channel().xSampling != 1 || it.channel().ySampling != 1) {
        return Fail(ErrorKind::kData, "{}: channel {} is subsampled, expected full resolution",
                    path.string(), it.name());
      }
      image.types[it.name()] = FromImf(it.channel().type);
      Image<float>& pixels =
          image.channels.emplace(it.name(), Image<float>(image.width, image.height)).first->second;
      const std::ptrdiff_t offset =
          static_cast<std::ptrdiff_t>(window.min.y) * width + window.min.x;
      frame_buffer.insert(
          it.name(), Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(pixels.data() - offset),
                                sizeof(float), sizeof(float) * static_cast<std::size_t>(width)));
    }
    file.setFrameBuffer(frame_buffer);
    file.readPixels(window.min.y, window.max.y);
    image.attributes = ReadAttributes(file.header());
    return image;
  } catch (const std::exception& e) {
    return Fail(ErrorKind::kData, "{}: {}", path.string(), e.what());
  }
}

}  // namespace omnihdr
