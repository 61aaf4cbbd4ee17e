#include "core/photometry/sensor_picture.h"

#include <variant>

namespace omnihdr {

Result<SensorPicture> MakeSensorPicture(const DecodedImage& image, int bits, BayerOrder bayer,
                                        int first_row, int height) {
  if (first_row < 0 || height <= 0 || first_row > image.height() - height) {
    return Fail(ErrorKind::kData, "rows {}..{} of a picture of {} rows", first_row,
                first_row + height, image.height());
  }
  if (bits < 8 || bits > 16) {
    return Fail(ErrorKind::kData, "{} significant bits, expected 8..16", bits);
  }
  SensorPicture picture;
  const int values_per_row = image.width() * image.channels();
  picture.values = Image<float>(image.width(), height, image.channels());
  if (image.channels() == 1) picture.bayer = bayer;
  const float scale = image.is_16_bit() ? 255.0F / static_cast<float>((1 << bits) - 1) : 1.0F;
  std::visit(
      [&](const auto& pixels) {
        for (int y = 0; y < height; ++y) {
          const auto* source = pixels.row(first_row + y);
          float* target = picture.values.row(y);
          for (int i = 0; i < values_per_row; ++i) {
            target[i] = scale * static_cast<float>(source[i]);
          }
        }
      },
      image.pixels);
  return picture;
}

}  // namespace omnihdr
