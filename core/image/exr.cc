#include "core/image/exr.h"

#include <ImathBox.h>
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfEnvmapAttribute.h>
#include <OpenEXR/ImfFloatAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <half.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/base/parallel_for.h"
#include "core/image/image_io.h"

namespace omnihdr {
namespace {

constexpr float kLargestHalf = 65504.0F;
constexpr std::size_t kMaxExrValues = 4 * kMaxImagePixels;  // over all channels: 4 GiB of floats

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

}  // namespace

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
    if (attributes.latlong) Imf::addEnvmap(header, Imf::ENVMAP_LATLONG);
    for (const auto& [name, value] : attributes.strings) {
      header.insert(name, Imf::StringAttribute(value));
    }
    for (const auto& [name, value] : attributes.floats) {
      header.insert(name, Imf::FloatAttribute(static_cast<float>(value)));
    }
    Imf::FrameBuffer frame_buffer;
    std::vector<Image<std::uint16_t>> halves(channels.size());
    std::vector<Image<float>> floats(channels.size());
    for (std::size_t k = 0; k < channels.size(); ++k) {
      const ExrChannel& channel = channels[k];
      if (channel.pixels.width() != width || channel.pixels.height() != height) {
        return Fail(ErrorKind::kSoftware, "{}: channel {} is {}x{}, expected {}x{}", path.string(),
                    channel.name, channel.pixels.width(), channel.pixels.height(), width, height);
      }
      const bool is_half = channel.type == ExrPixelType::kHalf;
      header.channels().insert(channel.name, Imf::Channel(is_half ? Imf::HALF : Imf::FLOAT));
      char* base = nullptr;
      std::size_t value_bytes = 0;
      if (is_half) {
        halves[k] = Image<std::uint16_t>(width, height);
        ParallelFor(height, 32, [&](int begin, int end) {
          for (int y = begin; y < end; ++y) {
            std::uint16_t* out = halves[k].row(y);
            for (int x = 0; x < width; ++x) {
              const float value = channel.pixels.at(x, y, channel.channel);
              out[x] =
                  half(std::isnan(value) ? value : std::clamp(value, -kLargestHalf, kLargestHalf))
                      .bits();
            }
          }
        });
        base = reinterpret_cast<char*>(halves[k].data());
        value_bytes = sizeof(std::uint16_t);
      } else {
        floats[k] = Image<float>(width, height);
        for (int y = 0; y < height; ++y) {
          for (int x = 0; x < width; ++x) {
            floats[k].at(x, y) = channel.pixels.at(x, y, channel.channel);
          }
        }
        base = reinterpret_cast<char*>(floats[k].data());
        value_bytes = sizeof(float);
      }
      frame_buffer.insert(channel.name,
                          Imf::Slice(is_half ? Imf::HALF : Imf::FLOAT, base, value_bytes,
                                     value_bytes * static_cast<std::size_t>(width)));
    }
    Imf::OutputFile file(path.c_str(), header, WorkerCount());
    file.setFrameBuffer(frame_buffer);
    file.writePixels(height);
  } catch (const std::exception& e) {
    return Fail(ErrorKind::kIo, "{}: {}", path.string(), e.what());
  }
  return {};
}

Result<ExrImage> ReadExr(const std::filesystem::path& path) {
  try {
    Imf::InputFile file(path.c_str());
    const Imath::Box2i window = file.header().dataWindow();
    const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
    const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
    if (width <= 0 || height <= 0 ||
        static_cast<std::size_t>(width) > kMaxImagePixels / static_cast<std::size_t>(height)) {
      return Fail(ErrorKind::kData, "{}: {}x{} pixels, expected at most {} pixels", path.string(),
                  width, height, kMaxImagePixels);
    }
    std::size_t channel_count = 0;
    for (auto it = file.header().channels().begin(); it != file.header().channels().end(); ++it) {
      ++channel_count;
    }
    const std::size_t pixels_allowed = kMaxExrValues / std::max(channel_count, std::size_t{1});
    if (static_cast<std::size_t>(width) > pixels_allowed / static_cast<std::size_t>(height)) {
      return Fail(ErrorKind::kData, "{}: {} channels of {}x{} pixels, expected at most {} values",
                  path.string(), channel_count, width, height, kMaxExrValues);
    }
    // Before a small file with a large header makes us allocate what it does not hold.
    if (!file.isComplete()) return Fail(ErrorKind::kData, "{}: truncated EXR file", path.string());
    ExrImage image;
    image.width = static_cast<int>(width);
    image.height = static_cast<int>(height);
    Imf::FrameBuffer frame_buffer;
    for (auto it = file.header().channels().begin(); it != file.header().channels().end(); ++it) {
      if (it.channel().xSampling != 1 || it.channel().ySampling != 1) {
        return Fail(ErrorKind::kData, "{}: channel {} is subsampled, expected full resolution",
                    path.string(), it.name());
      }
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
    for (auto it = file.header().begin(); it != file.header().end(); ++it) {
      if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&it.attribute())) {
        image.strings[it.name()] = text->value();
      }
    }
    return image;
  } catch (const std::exception& e) {
    return Fail(ErrorKind::kData, "{}: {}", path.string(), e.what());
  }
}

}  // namespace omnihdr
