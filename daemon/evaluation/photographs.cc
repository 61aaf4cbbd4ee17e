#include "daemon/evaluation/photographs.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/base/parallel_for.h"
#include "core/image/image_io.h"

namespace omnihdr {
namespace {

// A photograph is trusted below this value in every channel.
constexpr int kClipped = 250;

struct How {
  double k = 0.0;
  double contrast = 1.0;
  std::vector<double> gain;
};

Result<How> ReadHow(const std::filesystem::path& path) {
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(path, std::size_t{1} << 20));
  const auto json = nlohmann::json::parse(text, nullptr, false);
  if (!json.is_object()) {
    return Fail(ErrorKind::kData, "{}: not a JSON object", path.string());
  }
  How how;
  for (const auto& [key, value] : {std::pair<const char*, double*>{"k", &how.k},
                                   std::pair<const char*, double*>{"contrast", &how.contrast}}) {
    if (!json.contains(key) || !json[key].is_number() || !(json[key].get<double>() > 0.0)) {
      return Fail(ErrorKind::kData, "{}: {}: {}, expected a positive number", path.string(), key,
                  json.contains(key) ? json[key].dump() : "missing");
    }
    *value = json[key].get<double>();
  }
  if (!json.contains("gain") || !json["gain"].is_array()) {
    return Fail(ErrorKind::kData, "{}: gain: expected one positive number a frame", path.string());
  }
  for (const auto& gain : json["gain"]) {
    if (!gain.is_number() || !(gain.get<double>() > 0.0)) {
      return Fail(ErrorKind::kData, "{}: gain: {}, expected a positive number", path.string(),
                  gain.dump());
    }
    how.gain.push_back(gain.get<double>());
  }
  return how;
}

double SrgbToLinear(double v) {
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

class Photographs final : public Reference {
 public:
  Photographs(std::filesystem::path directory, CameraDescription camera, How how)
      : directory_(std::move(directory)), camera_(std::move(camera)), how_(std::move(how)) {}

  std::string_view name() const override { return "photographs"; }
  Result<std::optional<Pose>> TruePose(const FrameRecord& frame) const override {
    return frame.pose;
  }

  Result<Picture> Render(const FrameRecord& frame, const Projection& output,
                         const Eigen::Quaterniond& camera_from_output) const override {
    const std::size_t number = Value(frame.frame);
    const std::filesystem::path path = directory_ / fmt::format("{:06}.jpg", number);
    if (number >= how_.gain.size()) {
      return Fail(ErrorKind::kData, "{}: gain: {} numbers, expected one for frame {} too",
                  (directory_ / "how.json").string(), how_.gain.size(), number);
    }
    OMNIHDR_ASSIGN(const DecodedImage decoded, ReadImage(path));
    if (decoded.is_16_bit() || decoded.channels() != 3) {
      return Fail(ErrorKind::kData, "{}: expected an 8-bit colour picture", path.string());
    }
    const auto& photo = std::get<0>(decoded.pixels);
    const Projection projection =
        camera_.PanoramaProjection().Resized(photo.width(), photo.height());

    // Our radiance 1.0 is value 128 at 1 s, and value = 255·k·radiance·t.
    std::array<float, 256> radiance_of_value{};
    for (int v = 0; v < 256; ++v) {
      radiance_of_value[static_cast<std::size_t>(v)] =
          static_cast<float>(255.0 * how_.k / 128.0 * how_.gain[number] *
                             std::pow(SrgbToLinear(v / 255.0), how_.contrast));
    }
    const Eigen::Matrix3d rotation = camera_from_output.toRotationMatrix();
    Picture picture;
    picture.radiance =
        Image<float>(output.width(), output.height(), 3, std::numeric_limits<float>::quiet_NaN());
    ParallelFor(output.height(), 8, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < output.width(); ++x) {
          const Eigen::Vector3d ray = rotation * output.RayFromPixel(x + 0.5, y + 0.5);
          Sample(photo, projection.PixelFromRay(ray), radiance_of_value,
                 picture.radiance.pixel(x, y));
        }
      }
    });
    return picture;
  }

 private:
  // Bilinear, in linear light; leaves `out` alone where one of the four pixels is clipped or
  // outside.
  static void Sample(const Image<std::uint8_t>& photo, const Eigen::Vector2d& at,
                     const std::array<float, 256>& radiance_of_value, float* out) {
    const double fx = at.x() - 0.5;
    const double fy = std::clamp(at.y() - 0.5, 0.0, photo.height() - 1.0);
    if (std::abs(fy - (at.y() - 0.5)) > 0.5) return;
    const int x0 = static_cast<int>(std::floor(fx));
    const int y0 = std::min(static_cast<int>(fy), photo.height() - 2);
    const auto ax = static_cast<float>(fx - x0);
    const auto ay = static_cast<float>(fy - y0);
    std::array<float, 3> sum{};
    for (int j = 0; j < 2; ++j) {
      for (int i = 0; i < 2; ++i) {
        const int x = (x0 + i + photo.width()) % photo.width();
        const std::uint8_t* value = photo.pixel(x, y0 + j);
        if (*std::max_element(value, value + 3) >= kClipped) return;
        const float weight = (i == 0 ? 1.0F - ax : ax) * (j == 0 ? 1.0F - ay : ay);
        for (std::size_t c = 0; c < 3; ++c) sum[c] += weight * radiance_of_value[value[c]];
      }
    }
    std::copy(sum.begin(), sum.end(), out);
  }

  std::filesystem::path directory_;
  CameraDescription camera_;
  How how_;
};

}  // namespace

Result<std::unique_ptr<Reference>> OpenPhotographs(const std::filesystem::path& directory,
                                                   const CameraDescription& camera) {
  OMNIHDR_ASSIGN(How how, ReadHow(directory / "how.json"));
  return std::make_unique<Photographs>(directory, camera, std::move(how));
}

}  // namespace omnihdr
