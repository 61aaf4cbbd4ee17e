#include "core/photometry/stitch.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/base/parallel_for.h"
#include "core/photometry/green_guide.h"
#include "core/photometry/stitch_kernels.h"

namespace omnihdr {
namespace {

constexpr int kTileWidth = 256;
constexpr int kTileHeight = 16;
constexpr std::size_t kMaxBlended = std::tuple_size_v<decltype(StitchSegment::sensors)>;

StitchScale ScaleOf(const RigSensor& sensor) {
  StitchScale scale;
  for (std::size_t c = 0; c < 3; ++c) scale.scale[c] = static_cast<float>(sensor.gain[c]);
  return scale;
}

// The noise of bilinear interpolation to that of the edge-aware one, measured in neutral even
// areas: green is interpolated from fewer values and takes the other colours' curvature in, and
// hands its noise on to them.
std::array<float, 3> GuidedNoise(const std::array<float, 3>& bilinear) {
  const float green = 0.95F * bilinear[1];
  return {0.8F * bilinear[0] + green, 2.1F * bilinear[1], 0.8F * bilinear[2] + green};
}

// Columns [begin, end) of row y.
void StitchPiece(const StitchTable& table, const StitchSource& source, int y, int begin, int end,
                 Measurement* out) {
  float* rgba = out->radiance.row(y);
  std::uint8_t* flags = out->flags.row(y);
  int done = begin;
  const auto mask = [&](int until) {
    std::fill(rgba + 4 * done, rgba + 4 * until, 0.0F);
    std::fill(flags + done, flags + until, std::uint8_t{kMasked});
  };
  alignas(64) std::array<float, 4 * kMaxBlended * kTileWidth> piece_rgba;
  alignas(64) std::array<std::uint8_t, kMaxBlended * kTileWidth> piece_flags;
  for (const StitchSegment& segment : table.rows[static_cast<std::size_t>(y)]) {
    if (segment.x1 <= begin) continue;
    if (segment.x0 >= end) break;
    const int x0 = std::max(begin, segment.x0);
    const int count = std::min(end, segment.x1) - x0;
    mask(x0);
    const auto samples = [&](std::size_t k) {
      const std::size_t first = segment.first +
                                k * static_cast<std::size_t>(segment.x1 - segment.x0) +
                                static_cast<std::size_t>(x0 - segment.x0);
      return StitchSamples{&table.block[first], &table.packed[first], &table.shade[first], count};
    };
    if (segment.count == 1) {
      source.Sample(segment.sensors[0], samples(0), rgba + 4 * x0, flags + x0);
    } else {
      std::array<const std::uint32_t*, kMaxBlended> packed{};
      for (std::size_t k = 0; k < segment.count; ++k) {
        const StitchSamples s = samples(k);
        packed[k] = s.packed;
        const std::size_t at = k * static_cast<std::size_t>(count);
        source.Sample(segment.sensors[k], s, piece_rgba.data() + 4 * at, piece_flags.data() + at);
      }
      BlendSamples(piece_rgba.data(), piece_flags.data(), packed.data(), segment.count, count,
                   rgba + 4 * x0, flags + x0);
    }
    done = x0 + count;
  }
  mask(end);
}

}  // namespace

Result<Stitcher> Stitcher::Create(Rig rig, const SphereGrid& grid, const StitchMasks& masks) {
  Stitcher stitcher;
  OMNIHDR_ASSIGN(stitcher.table_, BuildStitchTable(rig, grid, masks));
  if (stitcher.table_.covered == 0.0) {
    return Fail(ErrorKind::kData,
                "no sensor of the rig sees any of the panorama, expected lenses and masks that "
                "leave something");
  }
  OMNIHDR_ASSIGN(stitcher.rows_, StackedRows(rig));
  stitcher.rig_ = std::move(rig);
  stitcher.grid_ = grid;
  return stitcher;
}

Result<StitchSource> Stitcher::Prepare(std::span<const RigFrame> frames,
                                       std::span<const Response> responses, int bits,
                                       const MeasureOptions& options,
                                       std::vector<MosaicNoise>* noise) {
  OMNIHDR_TRY(CheckRigFrames(frames, rig_));
  if (responses.size() != 1 && responses.size() != rig_.sensors.size()) {
    return Fail(ErrorKind::kSoftware, "{} responses, expected 1 or {}", responses.size(),
                rig_.sensors.size());
  }
  StitchSource source;
  source.width = frame_width();
  const auto* bytes = std::get_if<Image<std::uint8_t>>(&frames.front().image->pixels);
  bool straight = frames.size() == 1 && bytes != nullptr && bytes->channels() == 1 &&
                  options.demosaic == Demosaic::kBilinear;
  for (const RigSensor& sensor : rig_.sensors) {
    straight = straight && sensor.bayer != BayerOrder::kNone;
    source.sensors.push_back({ScaleOf(sensor), sensor.bayer != BayerOrder::kNone});
  }
  for (const Response& response : responses) {
    straight = straight && response.model() == ResponseModel::kLinear;
  }

  if (straight) {
    source.bytes = bytes->data();
    *noise = NoiseOfRigFrames(frames, rig_, responses, bits, options);
    for (std::size_t s = 0; s < rig_.sensors.size(); ++s) {
      const Response& response = responses[responses.size() == 1 ? 0 : s];
      StitchSource::Sensor& sensor = source.sensors[s];
      const double seconds = frames.front().ExposureOf(s).EffectiveSeconds();
      for (std::size_t c = 0; c < 3; ++c) {
        sensor.scale.scale[c] = static_cast<float>(
            rig_.sensors[s].gain[c] * response.Slope(static_cast<int>(c), 128.0) / seconds);
      }
      sensor.black = static_cast<float>(response.black());
      sensor.low = static_cast<std::uint32_t>(std::ceil(options.value_low));
      sensor.high =
          static_cast<std::uint32_t>(std::floor(response.HighestUsable(options.value_high)));
    }
  } else {
    OMNIHDR_TRY(MergeMosaic(frames, rig_, responses, bits, options, &mosaic_));
    source.mosaic = &mosaic_;
    if (options.demosaic == Demosaic::kEdgeAware && mosaic_.radiance.channels() == 1) {
      GreenGuide(mosaic_, rig_, rows_, &guide_);
      source.guide = &guide_;
    }
    *noise = mosaic_.noise;
  }
  return source;
}

Result<std::vector<Seam>> Stitcher::Seams(std::span<const RigFrame> frames,
                                          std::span<const Response> responses, int bits,
                                          const MeasureOptions& options) {
  std::vector<MosaicNoise> noise;
  OMNIHDR_ASSIGN(const StitchSource source, Prepare(frames, responses, bits, options, &noise));
  return MeasureSeams(table_, source, grid_);
}

Status Stitcher::Stitch(std::span<const RigFrame> frames, std::span<const Response> responses,
                        int bits, const MeasureOptions& options, Measurement* out) {
  std::vector<MosaicNoise> noise;
  OMNIHDR_ASSIGN(const StitchSource source, Prepare(frames, responses, bits, options, &noise));
  if (out->radiance.width() != table_.width || out->radiance.height() != table_.height ||
      out->radiance.channels() != 4) {
    out->radiance = Image<float>::Uninitialized(table_.width, table_.height, 4);
    out->flags = Image<std::uint8_t>::Uninitialized(table_.width, table_.height);
  }
  // In tiles: a row of the panorama runs down the columns of sensors that lie on their sides, and
  // its neighbours need the same lines of the cache.
  const int stripes = (table_.height + kTileHeight - 1) / kTileHeight;
  ParallelFor(stripes, 1, [&](int begin, int end) {
    for (int stripe = begin; stripe < end; ++stripe) {
      const int y0 = stripe * kTileHeight;
      const int y1 = std::min(y0 + kTileHeight, table_.height);
      for (int x0 = 0; x0 < table_.width; x0 += kTileWidth) {
        for (int y = y0; y < y1; ++y) {
          StitchPiece(table_, source, y, x0, std::min(x0 + kTileWidth, table_.width), out);
        }
      }
    }
  });

  out->projection = {};
  if (grid_.kind() == SphereGridKind::kEquirectangular) {
    out->projection = Projection::Equirectangular(grid_.width(), grid_.height());
  } else if (grid_.kind() == SphereGridKind::kCylindrical) {
    out->projection =
        Projection::Cylindrical(grid_.width(), grid_.height(), grid_.z_min(), grid_.z_max());
  }
  out->saturation = {};
  out->variance_floor = {};
  out->variance_per_radiance = {};
  out->longest_exposure_s = 0.0;
  out->shortest_exposure_s = noise.front().shortest_exposure_s;
  for (std::size_t s = 0; s < noise.size(); ++s) {
    const StitchNoiseGain& gain = table_.noise_gain[s];
    out->longest_exposure_s = std::max(out->longest_exposure_s, noise[s].longest_exposure_s);
    out->shortest_exposure_s = std::min(out->shortest_exposure_s, noise[s].shortest_exposure_s);
    std::array<float, 3> floor{};
    std::array<float, 3> per_radiance{};
    for (std::size_t c = 0; c < 3; ++c) {
      floor[c] = static_cast<float>(gain.floor[c]) * noise[s].variance_floor[c];
      per_radiance[c] =
          static_cast<float>(gain.per_radiance[c]) * noise[s].variance_per_radiance[c];
    }
    if (source.guide != nullptr && source.sensors[s].is_mosaic) {
      floor = GuidedNoise(floor);
      per_radiance = GuidedNoise(per_radiance);
    }
    for (std::size_t c = 0; c < 3; ++c) {
      out->variance_floor[c] += floor[c];
      out->variance_per_radiance[c] += per_radiance[c];
      out->saturation[c] =
          std::max(out->saturation[c], noise[s].saturation[c] * table_.largest_shade[s] *
                                           static_cast<float>(rig_.sensors[s].gain[c]));
    }
  }
  const float b = out->variance_per_radiance[1];
  out->noise_floor = 0.5F * (b + std::sqrt(b * b + 4.0F * out->variance_floor[1]));
  return {};
}

int NaturalPanoramaWidth(const Rig& rig) {
  double finest = 0.0;  // pixels per radian on the axis
  bool mosaic = false;
  for (const RigSensor& sensor : rig.sensors) {
    const auto centre = sensor.lens.PixelFromRay(Eigen::Vector3d::UnitZ());
    const auto aside = sensor.lens.PixelFromRay(Eigen::Vector3d(0.01, 0.0, 1.0));
    const double density =
        centre && aside ? (*aside - *centre).norm() / 0.01 : sensor.lens.focal().x();
    finest = std::max(finest, density);
    mosaic = mosaic || sensor.bayer != BayerOrder::kNone;
  }
  const double width = 2.0 * std::numbers::pi * finest * (mosaic ? 0.8 : 1.0);
  return static_cast<int>(std::clamp(64.0 * std::round(width / 64.0), 256.0, 8192.0));
}

}  // namespace omnihdr
