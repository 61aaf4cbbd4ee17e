#include "core/photometry/response_samples.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

// A step back of this much between exposures that should rise is more than noise (8-bit units).
constexpr double kStepBack = 4.0;
// More spots than this share that step back: not a leaf that moved but the wrong data.
constexpr double kMostMoving = 0.3;
constexpr int kValueBins = 32;
// Of a value that follows the light: what a stop more adds to it (8-bit units).
constexpr double kLeastChangePerStop = 6.0;
// Of one that is certainly not the fog's.
constexpr double kRiseFromFog = 2.0;

// Reads any picture in 8-bit units.
class Reader {
 public:
  Reader(const ExposedFrame& frame, int bits) : image_(frame.image) {
    if (image_->is_16_bit()) scale_ = 255.0F / (std::exp2(static_cast<float>(bits)) - 1.0F);
  }
  float Value(int x, int y, int channel) const {
    const int c = image_->channels() == 3 ? channel : 0;
    if (const auto* narrow = std::get_if<Image<std::uint8_t>>(&image_->pixels)) {
      return narrow->pixel(x, y)[c];
    }
    return std::get<Image<std::uint16_t>>(image_->pixels).pixel(x, y)[c] * scale_;
  }

 private:
  const DecodedImage* image_;
  float scale_ = 1.0F;
};

struct Window {
  float mean = 0.0F;
  float range = 0.0F;
  bool usable = false;
  bool bright = false;
};

Window Look(const Reader& reader, int x, int y, int channel, const SampleOptions& options) {
  float low = std::numeric_limits<float>::max();
  float high = 0.0F;
  float sum = 0.0F;
  for (int dy = -options.radius; dy <= options.radius; ++dy) {
    for (int dx = -options.radius; dx <= options.radius; ++dx) {
      const float v = reader.Value(x + dx, y + dy, channel);
      low = std::min(low, v);
      high = std::max(high, v);
      sum += v;
    }
  }
  const auto side = static_cast<float>(2 * options.radius + 1);
  Window window;
  window.mean = sum / (side * side);
  window.range = high - low;
  window.bright = high > static_cast<float>(options.value_high);
  window.usable = !window.bright && low >= static_cast<float>(options.value_low);
  return window;
}

// The smoothest usable place of a cell.
struct Candidate {
  int x = -1;
  int y = -1;
  float roughness = std::numeric_limits<float>::max();
};

struct Tally {
  std::size_t looked_at = 0;
  std::size_t bright = 0;  // in every picture
  std::size_t dark = 0;    // in every picture
};

class Chooser {
 public:
  Chooser(std::span<const ExposedFrame> frames, int bits, ImageView<const std::uint8_t> mask,
          const SampleOptions& options)
      : mask_(mask), options_(options) {
    for (const ExposedFrame& frame : frames) {
      readers_.emplace_back(frame, bits);
      seconds_.push_back(frame.exposure.EffectiveSeconds());
    }
    width_ = frames.front().image->width();
    height_ = frames.front().image->height();
    // Four cells for every spot wanted: three quarters may be too rough or of no use.
    const double area = static_cast<double>(width_) * height_;
    cell_ = std::max(2, static_cast<int>(std::sqrt(area / (4.0 * options.max_spots))));
    columns_ = (width_ + cell_ - 1) / cell_;
    rows_ = (height_ + cell_ - 1) / cell_;
  }

  // The best place of every cell that has one, in the order of the cells.
  std::vector<Candidate> Candidates(Tally* tally) const {
    std::vector<Candidate> best(static_cast<std::size_t>(columns_) *
                                static_cast<std::size_t>(rows_));
    std::vector<Tally> tallies(static_cast<std::size_t>(rows_));
    ParallelFor(rows_, 1, [&](int begin, int end) {
      for (int row = begin; row < end; ++row) {
        for (int column = 0; column < columns_; ++column) {
          best[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
               static_cast<std::size_t>(column)] =
              BestOf(column, row, &tallies[static_cast<std::size_t>(row)]);
        }
      }
    });
    for (const Tally& t : tallies) {
      tally->looked_at += t.looked_at;
      tally->bright += t.bright;
      tally->dark += t.dark;
    }
    best.erase(std::remove_if(best.begin(), best.end(), [](const Candidate& c) { return c.x < 0; }),
               best.end());
    return best;
  }

  // The usable exposures of a place. Shorter than one in which it is dark there is no light, longer
  // than one in which it is saturated there is no value, whatever noise and flare pretend.
  std::vector<ResponseObservation> Observe(const Candidate& place, int channel, float low) const {
    std::vector<ResponseObservation> spot;
    double longest_dark = 0.0;
    double shortest_bright = std::numeric_limits<double>::infinity();
    for (std::size_t j = 0; j < readers_.size(); ++j) {
      const Window window = Look(readers_[j], place.x, place.y, channel, options_);
      if (window.bright) {
        shortest_bright = std::min(shortest_bright, seconds_[j]);
      } else if (!window.usable || window.mean < low) {
        longest_dark = std::max(longest_dark, seconds_[j]);
      } else {
        spot.push_back({window.mean, static_cast<std::uint32_t>(j)});
      }
    }
    spot.erase(std::remove_if(spot.begin(), spot.end(),
                              [&](const ResponseObservation& o) {
                                return seconds_[o.exposure] <= longest_dark ||
                                       seconds_[o.exposure] >= shortest_bright;
                              }),
               spot.end());
    return spot;
  }

 private:
  bool Masked(int x, int y) const {
    if (mask_.empty()) return false;
    for (int dy = -options_.radius; dy <= options_.radius; ++dy) {
      for (int dx = -options_.radius; dx <= options_.radius; ++dx) {
        if (mask_.at(x + dx, y + dy) < 128) return true;
      }
    }
    return false;
  }

  Candidate BestOf(int column, int row, Tally* tally) const {
    constexpr int kLooksPerSide = 4;  // of a large cell
    const int step = std::max(1, cell_ / kLooksPerSide);
    const int margin = options_.radius;
    Candidate best;
    for (int y = row * cell_; y < std::min((row + 1) * cell_, height_ - margin); y += step) {
      if (y < margin) continue;
      for (int x = column * cell_; x < std::min((column + 1) * cell_, width_ - margin); x += step) {
        if (x < margin || Masked(x, y)) continue;
        ++tally->looked_at;
        const std::optional<float> roughness = Roughness(x, y, tally);
        if (roughness && *roughness < best.roughness) best = {x, y, *roughness};
      }
    }
    return best;
  }

  // Of a place that is usable twice in some channel: the largest change within a usable window.
  std::optional<float> Roughness(int x, int y, Tally* tally) const {
    float roughness = 0.0F;
    bool twice = false;
    bool all_bright = true;
    bool all_dark = true;
    for (int c = 0; c < 3; ++c) {
      int usable = 0;
      for (const Reader& reader : readers_) {
        const Window window = Look(reader, x, y, c, options_);
        all_bright = all_bright && window.bright;
        all_dark = all_dark && !window.bright && !window.usable;
        if (!window.usable) continue;
        ++usable;
        roughness = std::max(roughness, window.range);
      }
      twice = twice || usable >= 2;
    }
    tally->bright += all_bright ? 1 : 0;
    tally->dark += all_dark ? 1 : 0;
    if (!twice) return std::nullopt;
    return roughness;
  }

  std::vector<Reader> readers_;
  std::vector<double> seconds_;
  ImageView<const std::uint8_t> mask_;
  SampleOptions options_;
  int width_ = 0;
  int height_ = 0;
  int cell_ = 0;
  int columns_ = 0;
  int rows_ = 0;
};

bool StepsBack(std::span<const ResponseObservation> spot, std::span<const double> seconds) {
  for (const ResponseObservation& a : spot) {
    for (const ResponseObservation& b : spot) {
      if (seconds[b.exposure] > seconds[a.exposure] && b.value < a.value - kStepBack) return true;
    }
  }
  return false;
}

// Where the values begin to follow the light: below, film fog, flare or black clipping hide it. The
// lowest value from which on a stop changes the next brighter exposure's value by
// kLeastChangePerStop.
float FloorOf(const Chooser& chooser, std::span<const Candidate> candidates, int channel,
              std::span<const double> seconds, const SampleOptions& options) {
  constexpr int kHighestFloor = 100;
  constexpr int kRun = 8;
  constexpr double kEnough = 10.0;
  std::array<double, 256> change{};
  std::array<double, 256> count{};
  const auto lowest = static_cast<float>(options.value_low);
  for (const Candidate& place : candidates) {
    std::vector<ResponseObservation> spot = chooser.Observe(place, channel, lowest);
    std::sort(spot.begin(), spot.end(), [&](const auto& a, const auto& b) {
      return seconds[a.exposure] < seconds[b.exposure];
    });
    for (std::size_t k = 0; k + 1 < spot.size(); ++k) {
      const double stops = std::log2(seconds[spot[k + 1].exposure] / seconds[spot[k].exposure]);
      if (stops < std::log2(kLeastExposureRatio)) continue;
      const auto bin = static_cast<std::size_t>(std::lround(spot[k].value));
      change[bin] += static_cast<double>(spot[k + 1].value - spot[k].value) / stops;
      ++count[bin];
    }
  }
  // Eight values in a row with data of which all follow.
  int run = 0;
  int first = 0;
  for (int z = static_cast<int>(std::ceil(options.value_low)); z < kHighestFloor; ++z) {
    const auto bin = static_cast<std::size_t>(z);
    if (count[bin] < kEnough) continue;
    if (change[bin] < kLeastChangePerStop * count[bin]) {
      run = 0;
      continue;
    }
    if (run++ == 0) first = z;
    if (run == kRun) return std::max(lowest, static_cast<float>(first) - 0.5F);
  }
  return lowest;
}

// The fog differs over a picture: where a spot's shortest exposures show one value and not the
// light, that value and what hardly stands out from it say nothing.
void DropFog(std::span<const double> seconds, std::vector<ResponseObservation>* spot) {
  std::sort(spot->begin(), spot->end(), [&](const auto& a, const auto& b) {
    return seconds[a.exposure] < seconds[b.exposure];
  });
  float fog = -1.0F;
  for (std::size_t k = 0; k + 1 < spot->size(); ++k) {
    const double stops = std::log2(seconds[(*spot)[k + 1].exposure] / seconds[(*spot)[k].exposure]);
    const auto rise = static_cast<double>((*spot)[k + 1].value - (*spot)[k].value);
    if (rise >= kRiseFromFog * stops) break;
    if (stops >= std::log2(kLeastExposureRatio)) fog = (*spot)[k].value;
  }
  if (fog < 0.0F) return;
  const float least = fog + static_cast<float>(2.0 * kRiseFromFog);
  spot->erase(std::remove_if(spot->begin(), spot->end(),
                             [&](const ResponseObservation& o) { return o.value < least; }),
              spot->end());
}

// From the smoothest on, the spots that are wanted: `quota` for each range of values of each
// exposure.
void Pick(const Chooser& chooser, std::span<const Candidate> by_roughness, int channel,
          const SampleOptions& options, ResponseSamples* samples, ResponseSamples* suspect) {
  ResponseSamples::Channel& out = samples->channels[static_cast<std::size_t>(channel)];
  const float low = FloorOf(chooser, by_roughness, channel, samples->seconds, options);
  samples->floor[static_cast<std::size_t>(channel)] = static_cast<double>(low);
  const std::size_t exposures = samples->seconds.size();
  std::vector<int> filled(exposures * kValueBins, 0);
  // Several times an even share: the pictures decide which values there are.
  const int quota = std::max(8, 6 * options.max_spots / (kValueBins * static_cast<int>(exposures)));
  for (const Candidate& place : by_roughness) {
    if (out.size() >= static_cast<std::size_t>(options.max_spots)) break;
    std::vector<ResponseObservation> spot = chooser.Observe(place, channel, low);
    if (spot.size() < 2) continue;
    const auto bin = [](const ResponseObservation& o) {
      return static_cast<std::size_t>(o.exposure) * kValueBins +
             static_cast<std::size_t>(o.value * (kValueBins / 256.0F));
    };
    const bool wanted = std::any_of(spot.begin(), spot.end(), [&](const ResponseObservation& o) {
      return filled[bin(o)] < quota;
    });
    if (!wanted) continue;
    if (StepsBack(spot, samples->seconds)) {
      ++samples->moving;
      suspect->channels[static_cast<std::size_t>(channel)].Add(spot);
      continue;
    }
    DropFog(samples->seconds, &spot);
    if (spot.size() < 2) continue;
    for (const ResponseObservation& o : spot) ++filled[bin(o)];
    out.Add(spot);
  }
}

Status CheckExposures(std::span<const double> seconds) {
  const auto [shortest, longest] = std::minmax_element(seconds.begin(), seconds.end());
  if (*longest < kLeastExposureRatio * *shortest) {
    return Fail(ErrorKind::kData,
                "exposures of {:.6g} to {:.6g} s are equal: they say nothing about the response, "
                "expected a ratio of at least {}",
                *shortest, *longest, kLeastExposureRatio);
  }
  return {};
}

Status CheckPictures(std::span<const ExposedFrame> frames, std::span<const std::string> names,
                     ImageView<const std::uint8_t> mask) {
  if (frames.size() < 2) {
    return Fail(ErrorKind::kData,
                "{} picture{}, expected at least two of one place under "
                "different exposures",
                frames.size(), frames.size() == 1 ? "" : "s");
  }
  const DecodedImage& first = *frames.front().image;
  for (std::size_t j = 0; j < frames.size(); ++j) {
    const DecodedImage& image = *frames[j].image;
    if (image.width() != first.width() || image.height() != first.height() ||
        image.channels() != first.channels()) {
      return Fail(ErrorKind::kData, "{}: {}x{} with {} channels, expected {}x{} with {} as {}",
                  names[j], image.width(), image.height(), image.channels(), first.width(),
                  first.height(), first.channels(), names[0]);
    }
    if (!frames[j].exposure.IsValid()) {
      return Fail(ErrorKind::kData, "{}: exposure {} s at {} dB, expected a positive finite time",
                  names[j], frames[j].exposure.time.seconds(), frames[j].exposure.gain.value);
    }
  }
  if (first.channels() != 1 && first.channels() != 3) {
    return Fail(ErrorKind::kData, "{}: {} channels, expected 1 or 3", names[0], first.channels());
  }
  if (!mask.empty() && (mask.width() != first.width() || mask.height() != first.height())) {
    return Fail(ErrorKind::kData, "mask of {}x{} for pictures of {}x{}, expected the same size",
                mask.width(), mask.height(), first.width(), first.height());
  }
  return {};
}

// Between exposures next to each other, the median spot must get brighter.
Status CheckRising(const ResponseSamples& samples) {
  std::vector<std::size_t> order(samples.seconds.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return samples.seconds[a] < samples.seconds[b]; });
  constexpr std::size_t kEnough = 20;
  for (std::size_t k = 0; k + 1 < order.size(); ++k) {
    const std::size_t dark = order[k];
    const std::size_t bright = order[k + 1];
    if (samples.seconds[bright] < kLeastExposureRatio * samples.seconds[dark]) continue;
    std::vector<double> change;
    for (const ResponseSamples::Channel& channel : samples.channels) {
      for (std::size_t i = 0; i < channel.size(); ++i) {
        double before = -1.0;
        double after = -1.0;
        for (const ResponseObservation& o : channel.spot(i)) {
          if (o.exposure == dark) before = static_cast<double>(o.value);
          if (o.exposure == bright) after = static_cast<double>(o.value);
        }
        if (before >= 0.0 && after >= 0.0) change.push_back(after - before);
      }
    }
    if (change.size() < kEnough) continue;
    const auto middle = change.begin() + static_cast<std::ptrdiff_t>(change.size() / 2);
    std::nth_element(change.begin(), middle, change.end());
    if (*middle <= 0.0) {
      return Fail(
          ErrorKind::kData,
          "{} at {:.6g} s is not brighter than {} at {:.6g} s (median change {:.1f} over {} "
          "spots): values must rise with exposure; are the times right?",
          samples.names[bright], samples.seconds[bright], samples.names[dark],
          samples.seconds[dark], *middle, change.size());
    }
  }
  return {};
}

}  // namespace

void ResponseSamples::Channel::Add(std::span<const ResponseObservation> spot) {
  observations.insert(observations.end(), spot.begin(), spot.end());
  begin.push_back(static_cast<std::uint32_t>(observations.size()));
}

Status SampleOptions::Validate() const {
  if (!(value_low >= 0.0 && value_low < value_high && value_high <= 255.0)) {
    return Fail(ErrorKind::kConfig, "usable values {} to {}, expected 0 <= low < high <= 255",
                value_low, value_high);
  }
  if (max_spots < 16 || max_spots > 100000) {
    return Fail(ErrorKind::kConfig, "{} spots, expected 16 to 100000", max_spots);
  }
  if (radius < 0 || radius > 8) {
    return Fail(ErrorKind::kConfig, "a window of radius {}, expected 0 to 8", radius);
  }
  return {};
}

Status CheckSamples(const ResponseSamples& samples) {
  OMNIHDR_TRY(CheckExposures(samples.seconds));
  for (std::size_t c = 0; c < 3; ++c) {
    if (samples.channels[c].size() < kLeastSpots) {
      return Fail(ErrorKind::kData,
                  "channel {}: {} spots are usable under two exposures, expected at least {}: "
                  "exposures too far apart, too rough or too small a picture",
                  "RGB"[c], samples.channels[c].size(), kLeastSpots);
    }
  }
  return CheckRising(samples);
}

Result<ResponseSamples> SamplesFromBracket(std::span<const ExposedFrame> frames,
                                           std::span<const std::string> names, int bits,
                                           ImageView<const std::uint8_t> mask,
                                           const SampleOptions& options) {
  OMNIHDR_TRY(options.Validate());
  OMNIHDR_TRY(CheckPictures(frames, names, mask));
  ResponseSamples samples;
  for (const ExposedFrame& frame : frames) {
    samples.seconds.push_back(frame.exposure.EffectiveSeconds());
  }
  samples.names.assign(names.begin(), names.end());
  OMNIHDR_TRY(CheckExposures(samples.seconds));
  const Chooser chooser(frames, bits, mask, options);
  Tally tally;
  std::vector<Candidate> candidates = chooser.Candidates(&tally);
  if (tally.looked_at == 0) {
    return Fail(ErrorKind::kData, "the mask leaves no pixel to calibrate from");
  }
  if (candidates.empty() && tally.bright * 2 > tally.looked_at) {
    return Fail(ErrorKind::kData,
                "saturated throughout: {} of {} places are above {} in every picture; expected "
                "shorter exposures",
                tally.bright, tally.looked_at, options.value_high);
  }
  if (candidates.empty() && tally.dark * 2 > tally.looked_at) {
    return Fail(ErrorKind::kData,
                "dark throughout: {} of {} places are below {} in every picture; expected longer "
                "exposures",
                tally.dark, tally.looked_at, options.value_low);
  }
  std::stable_sort(
      candidates.begin(), candidates.end(),
      [](const Candidate& a, const Candidate& b) { return a.roughness < b.roughness; });
  ResponseSamples suspect;
  suspect.seconds = samples.seconds;
  suspect.names = samples.names;
  for (int c = 0; c < 3; ++c) Pick(chooser, candidates, c, options, &samples, &suspect);
  std::size_t kept = 0;
  for (const ResponseSamples::Channel& channel : samples.channels) kept += channel.size();
  if (samples.moving > kLeastSpots &&
      static_cast<double>(samples.moving) >
          kMostMoving * static_cast<double>(kept + samples.moving)) {
    OMNIHDR_TRY(CheckRising(suspect));
    return Fail(ErrorKind::kData,
                "values fall while the exposure grows at {} of {} spots: the exposure times are "
                "not those of the pictures, or the camera moved between them",
                samples.moving, kept + samples.moving);
  }
  OMNIHDR_TRY(CheckSamples(samples));
  return samples;
}

}  // namespace omnihdr
