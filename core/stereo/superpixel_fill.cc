#include "core/stereo/superpixel_fill.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/photometry/sampler.h"
#include "core/photometry/tonemap.h"
#include "core/sphere/latlong_grid.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kChromaCodesPerLn = 80.0F;
constexpr float kSkyConfidence = 0.5F;

std::uint8_t Code(float value) {
  return static_cast<std::uint8_t>(std::clamp(value + 0.5F, 0.0F, 255.0F));
}

// Pixels by superpixel: those of s are order[begin[s]] to order[begin[s + 1]].
struct Members {
  std::vector<std::size_t> begin;
  std::vector<std::int32_t> order;
};
Members MembersOf(const Superpixels& superpixels) {
  Members members;
  members.begin.assign(static_cast<std::size_t>(superpixels.count) + 1, 0);
  for (const std::int32_t s : superpixels.label.values()) {
    ++members.begin[static_cast<std::size_t>(s) + 1];
  }
  for (std::size_t s = 1; s < members.begin.size(); ++s) members.begin[s] += members.begin[s - 1];
  std::vector<std::size_t> next = members.begin;
  members.order.resize(superpixels.label.size());
  const auto pixels = static_cast<std::int32_t>(superpixels.label.size());
  for (std::int32_t k = 0; k < pixels; ++k) {
    const auto s = static_cast<std::size_t>(superpixels.label.data()[k]);
    members.order[next[s]++] = k;
  }
  return members;
}

}  // namespace

Image<float> MapRadiance(const Measurement& measurement,
                         const Eigen::Quaterniond& world_from_camera, int width) {
  if (measurement.radiance.width() > width + width / 2) {
    return MapRadiance(HalveMeasurement(measurement), world_from_camera, width);
  }
  const int height = width / 2;
  const LatLongGrid grid(width, height);
  const PanoramaSampler sampler(measurement);
  const Eigen::Matrix3f camera_from_world =
      world_from_camera.conjugate().toRotationMatrix().cast<float>();
  Image<float> radiance(width, height, 3, kNan);
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const RadianceSample sample = sampler.Sample(camera_from_world * grid.Ray(x, y));
        if ((sample.flags & kMasked) != 0) continue;
        for (std::size_t c = 0; c < 3; ++c) radiance.pixel(x, y)[c] = sample.rgb[c];
      }
    }
  });
  return radiance;
}

Image<std::uint8_t> LogColours(const Image<float>& radiance, const LogScale& scale) {
  Image<std::uint8_t> colours(radiance.width(), radiance.height(), 3);
  ParallelFor(radiance.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < radiance.width(); ++x) {
        const float* rgb = radiance.pixel(x, y);
        std::uint8_t* out = colours.pixel(x, y);
        out[1] = out[2] = 128;
        if (std::isnan(rgb[0])) continue;
        const auto ln = [&](float e) { return std::log(std::max(e, 0.0F) + scale.floor); };
        const float green = ln(rgb[1]);
        out[0] = Code(1.0F + (ln(Luminance(rgb)) - scale.ln_black) * scale.codes_per_ln);
        out[1] = Code(128.0F + kChromaCodesPerLn * (ln(rgb[0]) - green));
        out[2] = Code(128.0F + kChromaCodesPerLn * (ln(rgb[2]) - green));
      }
    }
  });
  return colours;
}

void FillSuperpixels(const Superpixels& superpixels, DisparityMap* map) {
  const int width = map->disparity.width();
  const int height = map->disparity.height();
  const Members members = MembersOf(superpixels);
  std::vector<float> row_scale;
  for (int y = 0; y < height; ++y) {
    row_scale.push_back(static_cast<float>(std::sin(std::numbers::pi * (y + 0.5) / height)));
  }
  float* disparity = map->disparity.data();
  float* confidence = map->confidence.data();
  ParallelFor(superpixels.count, 8, [&](int begin, int end) {
    std::vector<std::int32_t> known;
    std::vector<std::int32_t> holes;
    for (int s = begin; s < end; ++s) {
      known.clear();
      holes.clear();
      for (std::size_t k = members.begin[static_cast<std::size_t>(s)];
           k < members.begin[static_cast<std::size_t>(s) + 1]; ++k) {
        const std::int32_t at = members.order[k];
        (disparity[at] >= 0.0F ? known : holes).push_back(at);
      }
      for (const std::int32_t hole : holes) confidence[hole] = 0.0F;
      if (known.empty()) continue;
      std::vector<float> filled;
      for (const std::int32_t hole : holes) {
        const int x = hole % width;
        const int y = hole / width;
        const float x_scale = row_scale[static_cast<std::size_t>(y)];
        float sum = 0.0F;
        float weight = 0.0F;
        for (const std::int32_t at : known) {
          int dx = std::abs(at % width - x);
          dx = std::min(dx, width - dx);
          const int rows = at / width - y;
          const auto dy = static_cast<float>(rows);
          const float along = x_scale * static_cast<float>(dx);
          const float w = 1.0F / std::max(along * along + dy * dy, 1e-4F);
          sum += w * disparity[at];
          weight += w;
        }
        filled.push_back(sum / weight);
      }
      for (std::size_t k = 0; k < holes.size(); ++k) disparity[holes[k]] = filled[k];
    }
  });
}

Image<std::uint8_t> FindSky(const Image<float>& radiance) {
  const int width = radiance.width();
  const int height = radiance.height();
  double sum = 0.0;
  double area = 0.0;
  for (int y = 0; y < height; ++y) {
    const double row_area = std::sin(std::numbers::pi * (y + 0.5) / height);
    for (int x = 0; x < width; ++x) {
      const float luminance = Luminance(radiance.pixel(x, y));
      if (std::isnan(luminance)) continue;
      sum += row_area * luminance;
      area += row_area;
    }
  }
  const double mean = area > 0.0 ? sum / area : 0.0;
  Image<std::uint8_t> sky(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float* rgb = radiance.pixel(x, y);
      const float total = rgb[0] + rgb[1] + rgb[2];
      if (!(total > 0.0F)) continue;
      const float r = rgb[0] / total;
      const float g = rgb[1] / total;
      const float b = rgb[2] / total;
      const bool is_sky = static_cast<double>(Luminance(rgb)) > mean && r < g && r < b &&
                          r > 0.25F && r < 0.32F && std::abs(g - b) < 0.04F;
      sky.at(x, y) = is_sky ? 1 : 0;
    }
  }
  return sky;
}

int PutSkyAtInfinity(const Superpixels& superpixels, const Image<std::uint8_t>& sky,
                     double least_share, DisparityMap* map) {
  std::vector<int> count(static_cast<std::size_t>(superpixels.count), 0);
  std::vector<int> sky_count(count.size(), 0);
  for (std::size_t k = 0; k < sky.size(); ++k) {
    const auto s = static_cast<std::size_t>(superpixels.label.values()[k]);
    ++count[s];
    sky_count[s] += sky.values()[k];
  }
  const auto is_sky = [&](std::size_t s) { return sky_count[s] >= least_share * count[s]; };
  for (std::size_t k = 0; k < sky.size(); ++k) {
    if (!is_sky(static_cast<std::size_t>(superpixels.label.values()[k]))) continue;
    map->disparity.values()[k] = 0.0F;
    map->confidence.values()[k] = kSkyConfidence;
  }
  int superpixels_of_sky = 0;
  for (std::size_t s = 0; s < count.size(); ++s) superpixels_of_sky += is_sky(s) ? 1 : 0;
  return superpixels_of_sky;
}

}  // namespace omnihdr
