#include "core/pipeline/response_session.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/pose/feature_image.h"
#include "core/pose/features.h"
#include "core/pose/link.h"

namespace omnihdr {
namespace {

constexpr double kEqualExposure = 0.01;

struct Frame {
  const FrameRecord* record = nullptr;
  DecodedImage image;
};

template <typename T>
Image<T> HalfSize(const Image<T>& mosaic, BayerOrder order) {
  Image<T> colour(mosaic.width() / 2, mosaic.height() / 2, 3);
  for (int y = 0; y < colour.height(); ++y) {
    for (int x = 0; x < colour.width(); ++x) {
      std::array<std::uint32_t, 3> sum = {0, 1, 0};  // green's 1 rounds
      for (int k = 0; k < 4; ++k) {
        sum[static_cast<std::size_t>(BayerChannel(order, k % 2, k / 2))] +=
            mosaic.at(2 * x + k % 2, 2 * y + k / 2);
      }
      T* out = colour.pixel(x, y);
      out[0] = static_cast<T>(sum[0]);
      out[1] = static_cast<T>(sum[1] / 2);
      out[2] = static_cast<T>(sum[2]);
    }
  }
  return colour;
}

// kNone also where the frames are no mosaics.
BayerOrder BayerOf(const CameraDescription& camera) {
  if (camera.layout != Layout::kRig) return BayerOrder::kNone;
  return BayerOrderFromString(camera.bayer).value_or(BayerOrder::kNone);
}

Result<DecodedImage> Load(const std::filesystem::path& directory, const FrameRecord& record,
                          const CameraDescription& camera) {
  const std::filesystem::path path = directory / record.file;
  Result<DecodedImage> image = ReadImage(path);
  if (!image) return image;
  if (image->width() != camera.width || image->height() != camera.height) {
    return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as session.json says", path.string(),
                image->width(), image->height(), camera.width, camera.height);
  }
  const BayerOrder order = BayerOf(camera);
  if (order != BayerOrder::kNone && image->channels() == 1) return HalfSizeColour(*image, order);
  return image;
}

// The exposure's place in samples->seconds, a new one if there is none like it.
std::uint32_t ExposureIndex(double seconds, const std::string& name, ResponseSamples* samples) {
  for (std::size_t k = 0; k < samples->seconds.size(); ++k) {
    if (std::abs(samples->seconds[k] / seconds - 1.0) < kEqualExposure) {
      return static_cast<std::uint32_t>(k);
    }
  }
  samples->seconds.push_back(seconds);
  samples->names.push_back(name);
  return static_cast<std::uint32_t>(samples->seconds.size() - 1);
}

bool DifferentExposures(const std::vector<const FrameRecord*>& frames) {
  double shortest = frames.front()->exposure.EffectiveSeconds();
  double longest = shortest;
  for (const FrameRecord* frame : frames) {
    shortest = std::min(shortest, frame->exposure.EffectiveSeconds());
    longest = std::max(longest, frame->exposure.EffectiveSeconds());
  }
  return longest >= kLeastExposureRatio * shortest;
}

// A bracket's spots into the session's, their exposures renumbered.
void Append(const ResponseSamples& bracket, ResponseSamples* all) {
  std::vector<std::uint32_t> place;
  for (std::size_t k = 0; k < bracket.seconds.size(); ++k) {
    place.push_back(ExposureIndex(bracket.seconds[k], bracket.names[k], all));
  }
  std::vector<ResponseObservation> spot;
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::size_t i = 0; i < bracket.channels[c].size(); ++i) {
      const auto from = bracket.channels[c].spot(i);
      spot.assign(from.begin(), from.end());
      for (ResponseObservation& o : spot) o.exposure = place[o.exposure];
      all->channels[c].Add(spot);
    }
    all->floor[c] = std::max(all->floor[c], bracket.floor[c]);
  }
  all->moving += bracket.moving;
}

Result<SessionSamples> FromBrackets(const std::filesystem::path& directory,
                                    const SessionContents& contents,
                                    std::vector<std::vector<const FrameRecord*>> positions,
                                    ImageView<const std::uint8_t> mask,
                                    const SessionSampleOptions& options) {
  SessionSamples result;
  const auto count = std::min(positions.size(), static_cast<std::size_t>(options.max_positions));
  SampleOptions each = options.samples;
  each.max_spots =
      std::max(each.max_spots / static_cast<int>(count), std::min(each.max_spots, 400));
  std::optional<Error> first_error;
  for (std::size_t n = 0; n < count; ++n) {
    const auto& records = positions[n * positions.size() / count];
    std::vector<DecodedImage> images;
    std::vector<ExposedFrame> frames;
    std::vector<std::string> names;
    for (const FrameRecord* record : records) {
      Result<DecodedImage> image = Load(directory, *record, contents.info.camera);
      if (!image) {
        result.warnings.push_back(image.error().message);
        continue;
      }
      images.push_back(std::move(*image));
      frames.push_back({nullptr, record->exposure});
      names.push_back(record->file);
    }
    for (std::size_t k = 0; k < frames.size(); ++k) frames[k].image = &images[k];
    const Result<ResponseSamples> bracket =
        SamplesFromBracket(frames, names, contents.info.camera.bits, mask, each);
    if (!bracket) {
      result.warnings.push_back(fmt::format("position {}: {}", Value(records.front()->position),
                                            bracket.error().message));
      if (!first_error) first_error = bracket.error();
      continue;
    }
    result.frames += static_cast<int>(frames.size());
    Append(*bracket, &result.samples);
  }
  if (result.samples.seconds.empty() && first_error) return Forward(*first_error);
  OMNIHDR_TRY(CheckSamples(result.samples));
  return result;
}

// A position of a moving session: its frame and what was found in it.
struct Seen {
  const FrameRecord* record = nullptr;
  DecodedImage image;
  FeatureSet features;
  std::uint32_t exposure = 0;
};

// Mean value of a channel over the core of a feature; nothing where it is not usable.
class CoreReader {
 public:
  CoreReader(const Projection& projection, int bits, ImageView<const std::uint8_t> mask,
             const SampleOptions& options)
      : projection_(projection), bits_(bits), mask_(mask), options_(options) {}

  std::optional<double> Mean(const DecodedImage& image, const Feature& feature, int channel) const {
    return std::visit([&](const auto& pixels) { return MeanOf(pixels, feature, channel); },
                      image.pixels);
  }

 private:
  template <typename T>
  std::optional<double> MeanOf(const Image<T>& pixels, const Feature& feature, int channel) const {
    const Eigen::Vector2d at = projection_.PixelFromRay(feature.ray);
    const auto row = static_cast<int>(at.y());
    if (row < 0 || row >= pixels.height()) return std::nullopt;
    // The core: half the blob's standard deviation, at least a pixel. Rows are angles of one size;
    // columns narrow towards the poles.
    const double row_angle = std::sqrt(projection_.PixelSolidAngle(row) *
                                       std::sqrt(1.0 - feature.ray.z() * feature.ray.z()));
    const double radius = std::clamp(0.5 * feature.sigma_rad / row_angle, 1.0, 12.0);
    const double scale = sizeof(T) == 1 ? 1.0 : 255.0 / (std::exp2(bits_) - 1.0);
    const int c = pixels.channels() == 3 ? channel : 0;
    double sum = 0.0;
    double weight = 0.0;
    const int reach = static_cast<int>(std::ceil(radius));
    for (int dy = -reach; dy <= reach; ++dy) {
      for (int dx = -reach; dx <= reach; ++dx) {
        const int y = static_cast<int>(std::floor(at.y())) + dy;
        const int x =
            (static_cast<int>(std::floor(at.x())) + dx + 2 * pixels.width()) % pixels.width();
        const double ox = std::floor(at.x()) + dx + 0.5 - at.x();
        const double oy = y + 0.5 - at.y();
        const double inside = std::clamp(radius + 0.5 - std::hypot(ox, oy), 0.0, 1.0);
        if (inside == 0.0) continue;
        if (y < 0 || y >= pixels.height()) return std::nullopt;
        if (!mask_.empty() && mask_.at(x, y) < 128) return std::nullopt;
        const double value = pixels.pixel(x, y)[c] * scale;
        if (value < options_.value_low || value > options_.value_high) return std::nullopt;
        sum += inside * value;
        weight += inside;
      }
    }
    if (weight == 0.0) return std::nullopt;
    return sum / weight;
  }

  Projection projection_;
  int bits_;
  ImageView<const std::uint8_t> mask_;
  SampleOptions options_;
};

Result<SessionSamples> FromMotion(const std::filesystem::path& directory,
                                  const SessionContents& contents,
                                  const std::vector<const FrameRecord*>& records,
                                  ImageView<const std::uint8_t> mask,
                                  const SessionSampleOptions& options) {
  const CameraDescription& camera = contents.info.camera;
  if (camera.layout != Layout::kPanorama) {
    return Fail(
        ErrorKind::kData,
        "layout \"{}\" with one exposure a position: the response needs frames of different "
        "exposure at one position, or the layout panorama",
        ToString(camera.layout));
  }
  SessionSamples result;
  result.moving = true;
  const Projection projection = camera.PanoramaProjection();
  const CoreReader reader(projection, camera.bits, mask, options.samples);
  const PoseOptions pose;
  FeatureOptions feature_options;
  feature_options.max_features = pose.max_features;
  FeatureFinder finder(feature_options);
  std::vector<Seen> window;
  for (const FrameRecord* record : records) {
    if (result.frames == options.max_frames) break;
    Result<DecodedImage> image = Load(directory, *record, camera);
    if (!image) {
      result.warnings.push_back(image.error().message);
      continue;
    }
    Seen seen;
    seen.record = record;
    seen.image = std::move(*image);
    const ExposedFrame frame{&seen.image, record->exposure};
    // The session's own response serves to find features only: they are found at the same places
    // with any curve that is about right.
    OMNIHDR_ASSIGN(const Measurement measurement,
                   Measure(std::span(&frame, 1), projection, contents.info.response, camera.bits,
                           mask, MeasureOptions{}));
    seen.features = finder.Find(MakeFeatureImage(measurement, pose.feature_image_width));
    seen.exposure =
        ExposureIndex(record->exposure.EffectiveSeconds(), record->file, &result.samples);
    ++result.frames;
    for (const Seen& before : window) {
      if (before.exposure == seen.exposure) continue;
      const Link link = LinkPositions(before.record->position, before.features, record->position,
                                      seen.features, pose);
      if (!link.ok()) continue;
      ++result.links;
      for (const auto& [from, to] : link.inliers) {
        const Feature& a = before.features.features[static_cast<std::size_t>(from)];
        const Feature& b = seen.features.features[static_cast<std::size_t>(to)];
        for (int c = 0; c < 3; ++c) {
          const std::optional<double> value_a = reader.Mean(before.image, a, c);
          const std::optional<double> value_b = reader.Mean(seen.image, b, c);
          if (!value_a || !value_b) continue;
          const std::array<ResponseObservation, 2> spot = {
              ResponseObservation{static_cast<float>(*value_a), before.exposure},
              ResponseObservation{static_cast<float>(*value_b), seen.exposure}};
          result.samples.channels[static_cast<std::size_t>(c)].Add(spot);
        }
      }
    }
    window.push_back(std::move(seen));
    if (window.size() > static_cast<std::size_t>(options.reach)) window.erase(window.begin());
  }
  if (result.links == 0) {
    return Fail(ErrorKind::kData,
                "no two neighbouring positions of different exposure could be matched ({} frames)",
                result.frames);
  }
  OMNIHDR_TRY(CheckSamples(result.samples));
  return result;
}

}  // namespace

Status SessionSampleOptions::Validate() const {
  OMNIHDR_TRY(samples.Validate());
  if (max_positions < 1 || max_frames < 2 || reach < 1 || reach > 8) {
    return Fail(ErrorKind::kConfig,
                "{} positions, {} frames, reach {}: expected at least 1, at least 2, 1 to 8",
                max_positions, max_frames, reach);
  }
  return {};
}

Result<SessionSamples> SamplesFromSession(const std::filesystem::path& directory,
                                          const SessionContents& contents,
                                          ImageView<const std::uint8_t> mask,
                                          const SessionSampleOptions& options) {
  OMNIHDR_TRY(options.Validate());
  std::map<PositionId, std::vector<const FrameRecord*>> by_position;
  std::vector<const FrameRecord*> usable;
  for (const FrameRecord& record : contents.journal.frames) {
    if (record.status != FrameStatus::kOk || !record.exposure.IsValid()) continue;
    by_position[record.position].push_back(&record);
    usable.push_back(&record);
  }
  if (usable.size() < 2) {
    return Fail(ErrorKind::kData, "{} usable frames, expected at least two of different exposure",
                usable.size());
  }
  if (!DifferentExposures(usable)) {
    const double seconds = usable.front()->exposure.EffectiveSeconds();
    return Fail(ErrorKind::kData,
                "all {} frames have one exposure, {:.6g} s: they say nothing about the response",
                usable.size(), seconds);
  }
  std::vector<std::vector<const FrameRecord*>> brackets;
  std::vector<const FrameRecord*> single;
  for (auto& [position, frames] : by_position) {
    single.push_back(frames.front());
    if (DifferentExposures(frames)) brackets.push_back(std::move(frames));
  }
  if (!brackets.empty()) {
    if (BayerOf(contents.info.camera) != BayerOrder::kNone && !mask.empty()) {
      const Image<std::uint8_t> half = HalfSizeMask(mask);
      return FromBrackets(directory, contents, std::move(brackets), half.view(), options);
    }
    return FromBrackets(directory, contents, std::move(brackets), mask, options);
  }
  return FromMotion(directory, contents, single, mask, options);
}

DecodedImage HalfSizeColour(const DecodedImage& mosaic, BayerOrder order) {
  return std::visit([order](const auto& pixels) { return DecodedImage{HalfSize(pixels, order)}; },
                    mosaic.pixels);
}

Image<std::uint8_t> HalfSizeMask(ImageView<const std::uint8_t> mask) {
  Image<std::uint8_t> half(mask.width() / 2, mask.height() / 2);
  for (int y = 0; y < half.height(); ++y) {
    for (int x = 0; x < half.width(); ++x) {
      half.at(x, y) = std::min({mask.at(2 * x, 2 * y), mask.at(2 * x + 1, 2 * y),
                                mask.at(2 * x, 2 * y + 1), mask.at(2 * x + 1, 2 * y + 1)});
    }
  }
  return half;
}

}  // namespace omnihdr
