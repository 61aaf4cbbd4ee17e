#include "core/pipeline/view_files.h"

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "core/base/file.h"
#include "core/base/parallel_for.h"
#include "core/base/profile.h"
#include "core/base/simd.h"
#include "core/image/exif.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/photometry/clipped.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/quality.h"
#include "core/session/utc_text.h"

namespace omnihdr {
namespace {

struct RadianceStatistics {
  double least = 0.0;
  double largest = 0.0;  // over everything written, clipped pixels included
  double valid_fraction = 0.0;
};

// `is_latlong`: rows count by their solid angle.
RadianceStatistics Statistics(const MergedView& view, bool is_latlong) {
  RadianceStatistics s;
  bool any = false;
  double valid = 0.0;
  double total = 0.0;
  const int width = view.radiance.width();
  const int height = view.radiance.height();
  for (int y = 0; y < height; ++y) {
    const double weight = is_latlong ? std::sin(std::numbers::pi * (y + 0.5) / height) : 1.0;
    int valid_in_row = 0;
    for (int x = 0; x < width; ++x) {
      const auto origin = static_cast<PixelOrigin>(view.origin.at(x, y));
      if (origin == PixelOrigin::kNoData) continue;
      const float* rgb = view.radiance.pixel(x, y);
      const double luminance = Luminance(rgb);
      s.largest = std::max({s.largest, double{rgb[0]}, double{rgb[1]}, double{rgb[2]}});
      if (origin == PixelOrigin::kClipped) continue;
      s.least = any ? std::min(s.least, luminance) : luminance;
      any = true;
      ++valid_in_row;
    }
    valid += weight * valid_in_row;
    total += weight * width;
  }
  s.valid_fraction = total > 0.0 ? valid / total : 0.0;
  return s;
}

// Bits of the fraction that are kept of a disparity: a step of 1.2e-4 of it, a hundredth of what
// matching can tell, where the rest would be noise that does not compress.
constexpr unsigned kDisparityBits = 12;
constexpr float kConfidenceStep = 1.0F / 256.0F;

OMNIHDR_SIMD_CLONES
void RoundFractions(const float* __restrict in, int count, float* __restrict out) {
  constexpr unsigned kDropped = 23U - kDisparityBits;
  constexpr std::uint32_t kHalf = 1U << (kDropped - 1U);
  constexpr std::uint32_t kKept = ~((1U << kDropped) - 1U);
  for (int i = 0; i < count; ++i) {
    const auto bits = std::bit_cast<std::uint32_t>(in[i]);
    // NaN stays one.
    const std::uint32_t rounded = in[i] == in[i] ? (bits + kHalf) & kKept : bits;
    out[i] = std::bit_cast<float>(rounded);
  }
}

OMNIHDR_SIMD_CLONES
void RoundToSteps(const float* __restrict in, int count, float step, float* __restrict out) {
  for (int i = 0; i < count; ++i) out[i] = step * std::floor(in[i] / step + 0.5F);
}

// `view`'s disparity and confidence as they are written.
std::pair<Image<float>, Image<float>> RoundedDisparity(const MergedView& view) {
  const int width = view.disparity.width();
  const int height = view.disparity.height();
  std::pair<Image<float>, Image<float>> rounded = {Image<float>::Uninitialized(width, height),
                                                   Image<float>::Uninitialized(width, height)};
  ParallelFor(height, 64, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      RoundFractions(view.disparity.row(y), width, rounded.first.row(y));
      RoundToSteps(view.confidence.row(y), width, kConfidenceStep, rounded.second.row(y));
    }
  });
  return rounded;
}

// OpenEXR's capDate, "YYYY:MM:DD hh:mm:ss".
std::string CaptureDate(UtcTime utc) {
  namespace chrono = std::chrono;
  const auto second =
      chrono::floor<chrono::seconds>(chrono::sys_time<Nanoseconds>(Nanoseconds(utc.ns())));
  const auto day = chrono::floor<chrono::days>(second);
  const chrono::year_month_day date(day);
  const chrono::hh_mm_ss time(second - day);
  return fmt::format("{:04}:{:02}:{:02} {:02}:{:02}:{:02}", static_cast<int>(date.year()),
                     static_cast<unsigned>(date.month()), static_cast<unsigned>(date.day()),
                     time.hours().count(), time.minutes().count(), time.seconds().count());
}

// What every EXR file of a view says.
ExrAttributes AttributesOf(const ViewContext& context, PositionId position, bool is_latlong) {
  ExrAttributes attributes;
  attributes.envmap = is_latlong ? ExrEnvmap::kLatLong : ExrEnvmap::kNone;
  attributes.strings["software"] = "omnihdr " OMNIHDR_VERSION;
  attributes.strings["omnihdrPosition"] = fmt::format("{}", Value(position));
  if (!context.camera.empty()) attributes.strings["omnihdrCamera"] = context.camera;
  if (context.utc) {
    attributes.strings["capDate"] = CaptureDate(*context.utc);
    attributes.floats["utcOffset"] = 0.0;
  }
  if (context.gnss && context.gnss->fix > 0) {
    attributes.floats["longitude"] = std::remainder(context.gnss->lon_deg, 360.0);
    attributes.floats["latitude"] = context.gnss->lat_deg;
    attributes.floats["altitude"] = context.gnss->alt_m;
  }
  return attributes;
}

Image<float> AsFloat(const Image<std::uint8_t>& image) {
  Image<float> out(image.width(), image.height());
  std::transform(image.values().begin(), image.values().end(), out.values().begin(),
                 [](std::uint8_t v) { return static_cast<float>(v); });
  return out;
}

// What is known of where and when, for programs that order pictures by that. A frame without a fix
// has no place.
ExifInfo ExifOf(const ViewContext& context, std::optional<double> bearing_deg) {
  ExifInfo info;
  info.utc = context.utc;
  info.bearing_deg = bearing_deg;
  if (context.reference_exposure_s > 0.0) info.exposure_s = context.reference_exposure_s;
  info.model = context.camera;
  info.software = "omnihdr " OMNIHDR_VERSION;
  if (context.gnss && context.gnss->fix > 0) {
    const GnssFix& fix = *context.gnss;
    ExifPlace& place = info.place.emplace();
    place.lat_deg = fix.lat_deg;
    place.lon_deg = std::remainder(fix.lon_deg, 360.0);
    if (fix.dimensions != 2) place.alt_m = fix.alt_m;
    place.error_m = fix.error_m;
    place.utc = UtcFromText(fix.time);
    place.differential = fix.fix == 2 || fix.fix == 4 || fix.fix == 5;
  }
  return info;
}

// Compass bearing of the picture's middle, in [0, 360).
std::optional<double> BearingOfMiddle(const Eigen::Quaterniond& camera_from_output,
                                      const ViewContext& context) {
  if (!context.heading_deg || !std::isfinite(*context.heading_deg)) return std::nullopt;
  // The picture's middle looks along the output's X axis, turned against the camera's: a bearing
  // grows clockwise, an azimuth counter-clockwise.
  const Eigen::Vector3d middle = camera_from_output * Eigen::Vector3d::UnitX();
  const double azimuth_deg = std::atan2(middle.y(), middle.x()) * 180.0 / std::numbers::pi;
  double bearing = std::fmod(*context.heading_deg - azimuth_deg, 360.0);
  if (bearing < 0.0) bearing += 360.0;
  return bearing >= 360.0 ? 0.0 : bearing;
}

Result<std::vector<std::byte>> Preview(const Image<float>& radiance,
                                       const Eigen::Quaterniond& camera_from_output,
                                       bool is_latlong, const ViewContext& context) {
  ToneMapOptions options = context.preview;
  options.shape = is_latlong ? PictureShape::kSphere : PictureShape::kPlane;
  const Image<std::uint8_t> preview = ToneMap(radiance, options);
  const std::optional<double> bearing = BearingOfMiddle(camera_from_output, context);
  const PhotoSphere sphere{
      .full_width = preview.width(), .full_height = preview.height(), .heading_deg = bearing};
  OMNIHDR_ASSIGN(std::vector<std::byte> jpeg,
                 is_latlong ? EncodeJpeg(preview, context.preview_quality, sphere)
                            : EncodeJpeg(preview, context.preview_quality));
  return WithExif(std::move(jpeg), ExifOf(context, bearing));
}

Status WritePictures(const std::filesystem::path& directory, const MergedView& view,
                     PositionId position, bool is_latlong, bool with_disparity,
                     const ViewContext& context, ViewRecord* record) {
  const RadianceStatistics statistics = Statistics(view, is_latlong);
  record->radiance_min = statistics.least;
  record->radiance_max = statistics.largest;
  record->valid_fraction = statistics.valid_fraction;
  ExrPixelType type = context.exr_type;
  if (type == ExrPixelType::kHalf && SmallestType(view.radiance) != type) {
    type = ExrPixelType::kFloat;
    record->warnings.push_back(fmt::format(
        "radiance up to {:.0f} exceeds half precision: stored as float", statistics.largest));
  }
  const ExrAttributes attributes = AttributesOf(context, position, is_latlong);
  ExrAttributes radiance_attributes = attributes;
  radiance_attributes.chromaticities = context.chromaticities;
  radiance_attributes.floats["expTime"] = context.reference_exposure_s;
  if (context.white_luminance > 0.0) {
    radiance_attributes.floats["whiteLuminance"] = context.white_luminance;
  }
  radiance_attributes.strings["omnihdrOrigin"] = kOriginMeaning;
  Image<float> sources;
  if (!view.sources.empty()) {
    sources = AsFloat(view.sources);
    radiance_attributes.strings["omnihdrSources"] = kSourcesMeaning;
  }
  const Image<float> origin = AsFloat(view.origin);
  Image<float> marked;
  if (context.nan != NanPixels::kNever) {
    marked = view.radiance.Clone();
    MarkNan(view.origin, context.nan, &marked);
  }
  const Image<float>& radiance = marked.empty() ? view.radiance : marked;
  const auto write_radiance = [&]() -> Status {
    std::vector<ExrChannel> channels = {{"R", radiance, type, 0},
                                        {"G", radiance, type, 1},
                                        {"B", radiance, type, 2},
                                        {"origin", origin, ExrPixelType::kHalf, 0}};
    if (!sources.empty()) channels.push_back({"sources", sources, ExrPixelType::kHalf, 0});
    return WriteExr(directory / "radiance.exr", channels, radiance_attributes,
                    ExrCompression::kPiz);
  };
  const auto write_disparity = [&]() -> Status {
    if (!with_disparity) return {};
    const auto [disparity, confidence] = RoundedDisparity(view);
    return WriteExr(directory / "disparity.exr",
                    {{"disparity", disparity, ExrPixelType::kFloat, 0},
                     {"confidence", confidence, ExrPixelType::kHalf, 0}},
                    attributes, ExrCompression::kPiz);
  };
  const auto write_preview = [&]() -> Status {
    OMNIHDR_ASSIGN(const std::vector<std::byte> jpeg,
                   Preview(view.radiance, record->orientation, is_latlong, context));
    return WriteFileAtomic(directory / "preview.jpg", jpeg);
  };
  // Compressing takes longer than merging: side by side.
  static constexpr std::array<std::string_view, 3> kNames = {"disparity.exr", "radiance.exr",
                                                             "preview.jpg"};
  std::array<Status, 3> written;
  ParallelFor(3, 1, [&, profile = ProfileScope::recording()](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const auto index = static_cast<std::size_t>(k);
      const ProfileTask task(profile, kNames[index]);
      written[index] = k == 0 ? write_disparity() : k == 1 ? write_radiance() : write_preview();
    }
  });
  for (Status& status : written) OMNIHDR_TRY(std::move(status));
  return WriteFileAtomic(directory / "view.json", FormatViewRecord(*record));
}

std::vector<std::uint64_t> Numbers(const std::vector<FrameId>& frames) {
  std::vector<std::uint64_t> numbers;
  for (const FrameId frame : frames) numbers.push_back(Value(frame));
  return numbers;
}

}  // namespace

ViewRecord RecordOfView(const FinishedView& view, const std::string& mode) {
  ViewRecord record;
  record.position = view.pose.position;
  record.pose = view.pose.world_from_camera;
  record.metric_scale = view.pose.metric;
  record.scale_source = view.pose.scale_source;
  record.gnss_scale = view.pose.gnss_scale;
  record.chain = view.pose.chain;
  record.chain_reason = view.pose.chain_reason;
  record.sigma = view.pose.sigma;
  record.dead_reckoned = view.pose.dead_reckoned;
  record.relocalised = view.pose.relocalised;
  record.loop = view.pose.loop;
  record.orientation = view.camera_from_output;
  record.frames = Numbers(view.frames);
  record.reference = Value(view.reference);
  record.mode = mode;
  record.warnings = view.warnings;
  record.quality_level = view.quality_level;
  record.quality = DescribeQuality(view.quality_level);
  record.resume_json = view.resume_json;
  return record;
}

Status WriteViewFiles(const std::filesystem::path& directory, const FinishedView& view,
                      const ViewContext& context) {
  ViewRecord record = RecordOfView(view, context.mode);
  record.made_with = context.made_with;
  if (!view.keyframe.empty()) {
    OMNIHDR_TRY(WriteFileAtomic(directory / kKeyframeFile, view.keyframe));
  }
  return WritePictures(directory, view.merged, record.position, true, true, context, &record);
}

Status WriteTemporalViewFiles(const std::filesystem::path& directory, const TemporalView& view,
                              const ViewContext& context) {
  ViewRecord record;
  record.position = view.position;
  record.frames = Numbers(view.frames);
  record.reference = Value(view.reference);
  record.mode = context.mode;
  record.warnings = view.warnings;
  record.quality = DescribeQuality(0);
  record.made_with = context.made_with;
  return WritePictures(directory, view.merged, view.position, view.is_latlong, false, context,
                       &record);
}

void MarkNan(const Image<std::uint8_t>& origin, NanPixels nan, Image<float>* radiance) {
  if (nan == NanPixels::kNever) return;
  for (int y = 0; y < origin.height(); ++y) {
    for (int x = 0; x < origin.width(); ++x) {
      const auto why = static_cast<PixelOrigin>(origin.at(x, y));
      const bool is_nan = why == PixelOrigin::kNoData ||
                          (nan == NanPixels::kUnmeasured && why != PixelOrigin::kMeasured);
      if (is_nan) {
        std::fill_n(radiance->pixel(x, y), radiance->channels(),
                    std::numeric_limits<float>::quiet_NaN());
      }
    }
  }
}

MergedView ViewOfMeasurement(const Measurement& m) {
  MergedView view;
  const int width = m.radiance.width();
  const int height = m.radiance.height();
  view.radiance = Image<float>::Uninitialized(width, height, 3);
  view.origin = Image<std::uint8_t>::Uninitialized(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      std::copy_n(m.radiance.pixel(x, y), 3, view.radiance.pixel(x, y));
      const std::uint8_t flags = m.flags.at(x, y);
      NeutraliseClipped(flags, view.radiance.pixel(x, y));
      PixelOrigin origin = PixelOrigin::kMeasured;
      if ((flags & kMasked) != 0) {
        origin = PixelOrigin::kNoData;
      } else if ((flags & kSaturatedAny) != 0) {
        origin = PixelOrigin::kClipped;
      } else if ((flags & kDarkAny) == kDarkAny) {
        origin = PixelOrigin::kDark;
      }
      view.origin.at(x, y) = static_cast<std::uint8_t>(origin);
    }
  }
  return view;
}

}  // namespace omnihdr
