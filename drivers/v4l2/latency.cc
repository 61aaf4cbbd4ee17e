#include "drivers/v4l2/latency.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "drivers/v4l2/exposure_log.h"

namespace omnihdr::v4l2 {
namespace {

constexpr double kDarkest = 0.02;
constexpr double kBrightest = 0.7;
constexpr double kMostClipped = 0.1;
constexpr double kLeastFollowed = 0.3;  // of the step; codings with a gamma follow by half of it
constexpr double kUnmoved = 0.15;
constexpr int kTries = 10;
constexpr int kSteps = 4;
constexpr double kStepStops = 2.0;
constexpr int kMaxFramesAWait = 64;

bool IsUsable(const Level& level) {
  return level.mean >= kDarkest && level.mean <= kBrightest && level.clipped <= kMostClipped;
}

// The frames of a running stream, each with its brightness.
class Watcher {
 public:
  Watcher(Stream& stream, const FrameLayout& layout, const Clock& clock, Nanoseconds longest_wait,
          HostTime deadline)
      : stream_(stream),
        layout_(layout),
        clock_(clock),
        longest_wait_(longest_wait),
        deadline_(deadline) {}

  struct Seen {
    std::uint32_t sequence = 0;
    std::optional<Level> level;  // of a good frame
  };
  // Nothing when no frame came.
  Result<std::optional<Seen>> Next() {
    const Nanoseconds left = std::min(longest_wait_, deadline_ - clock_.Now());
    if (left <= Nanoseconds(0)) return std::optional<Seen>();
    return Take(left);
  }
  // The newest frame completed now, `last` when none has been since.
  Result<std::uint32_t> Drain(std::uint32_t last) {
    for (int i = 0; i < kMaxFramesAWait; ++i) {
      OMNIHDR_ASSIGN(const std::optional<Seen> seen, Take(Nanoseconds(0)));
      if (!seen) break;
      last = seen->sequence;
    }
    return last;
  }

 private:
  Result<std::optional<Seen>> Take(Nanoseconds timeout) {
    OMNIHDR_ASSIGN(const std::optional<Filled> filled, stream_.Next(timeout));
    if (!filled) return std::optional<Seen>();
    Seen seen{filled->sequence, std::nullopt};
    if (!filled->damaged) {
      if (const Result<Level> level = MeasureLevel(filled->bytes, layout_)) seen.level = *level;
    }
    OMNIHDR_TRY(stream_.Recycle(*filled));
    return std::optional<Seen>(seen);
  }

  Stream& stream_;
  const FrameLayout& layout_;
  const Clock& clock_;
  const Nanoseconds longest_wait_;
  const HostTime deadline_;
};

struct Watched {
  std::vector<StepSample> samples;
  std::optional<Level> last;
};

// Writes an exposure right after a frame and watches those that follow.
Result<std::optional<Watched>> Step(Watcher& watcher, ExposureControl& control,
                                    ExposureTime exposure) {
  OMNIHDR_ASSIGN(const auto first, watcher.Next());
  if (!first) return std::optional<Watched>();
  OMNIHDR_ASSIGN(const std::uint32_t before, watcher.Drain(first->sequence));
  OMNIHDR_TRY(control.Set({exposure, GainDb{}}));
  Watched watched;
  for (int i = 0; i < kMaxFramesAWait; ++i) {
    OMNIHDR_ASSIGN(const auto seen, watcher.Next());
    if (!seen) return std::optional<Watched>();
    const std::int32_t number = SequenceDistance(before, seen->sequence);
    if (seen->level && number > 0) {
      watched.samples.push_back({number, seen->level->mean});
      watched.last = seen->level;
    }
    if (number >= kMaxLatency + 2) break;
  }
  if (!watched.last) return std::optional<Watched>();
  return std::optional<Watched>(std::move(watched));
}

ExposureTime Within(const ExposureControl& control, double seconds) {
  return ExposureTime::Seconds(
      std::clamp(seconds, control.shortest().seconds(), control.longest().seconds()));
}

// An exposure between which and one two stops shorter brightness can be told apart.
struct Found {
  std::optional<ExposureTime> bright;
  Level level;
  bool frames = true;
};
Result<Found> FindExposure(Watcher& watcher, ExposureControl& control) {
  const double shortest = control.shortest().seconds();
  const double longest = control.longest().seconds();
  Found found;
  double low = std::min(shortest * std::exp2(kStepStops), longest);
  double high = longest;
  for (int i = 0; i < kTries; ++i) {
    const double seconds = std::sqrt(low * high);
    OMNIHDR_ASSIGN(const auto watched, Step(watcher, control, Within(control, seconds)));
    if (!watched) {
      found.frames = false;
      return found;
    }
    found.level = *watched->last;
    if (IsUsable(found.level) && found.level.mean >= 8 * kDarkest) {
      found.bright = ExposureTime::Seconds(seconds);
      return found;
    }
    (found.level.mean < 8 * kDarkest ? low : high) = seconds;
  }
  return found;
}

}  // namespace

std::optional<int> FindLatency(double level_before, std::span<const StepSample> after,
                               double stops) {
  if (after.size() < 2 || stops == 0.0 || level_before <= 0.0 || after.back().level <= 0.0) {
    return std::nullopt;
  }
  const double moved = std::log2(after.back().level / level_before);
  if (moved / stops < kLeastFollowed) return std::nullopt;
  std::optional<int> first;
  for (auto sample = after.rbegin(); sample != after.rend(); ++sample) {
    if (sample->level <= 0.0) break;
    const double share = std::log2(sample->level / level_before) / moved;
    if (share < 0.7 || share > 1.3) break;
    first = sample->frame;
  }
  // Half-way values in between are frames that had neither.
  if (!first || *first > kMaxLatency) return std::nullopt;
  return first;
}

std::optional<bool> BrightnessFollowed(const Level& before, const Level& after, double stops) {
  if (std::abs(stops) < 1.0 || before.mean < kDarkest || after.mean < kDarkest / 4 ||
      before.clipped > kMostClipped || after.clipped > kMostClipped) {
    return std::nullopt;
  }
  return std::log2(after.mean / before.mean) / stops >= kUnmoved;
}

Result<LatencyMeasurement> MeasureLatency(Stream& stream, const FrameLayout& layout,
                                          ExposureControl& control, const Clock& clock,
                                          Nanoseconds longest_wait, HostTime deadline) {
  Watcher watcher(stream, layout, clock, longest_wait, deadline);
  LatencyMeasurement measured;
  OMNIHDR_ASSIGN(const Found found, FindExposure(watcher, control));
  if (!found.frames) {
    measured.why_not = "frames do not come in time";
    return measured;
  }
  if (!found.bright) {
    measured.why_not = fmt::format(
        "no exposure shows the scene: brightness {:.3f} of the range, {:.0f} % clipped, at the "
        "last "
        "one tried",
        found.level.mean, 100.0 * found.level.clipped);
    return measured;
  }
  const double bright = found.bright->seconds();
  const double dark = Within(control, bright / std::exp2(kStepStops)).seconds();
  const double stops = std::log2(bright / dark);
  Level level = found.level;
  int most = 0;
  int least = kMaxLatency;
  for (int i = 0; i < kSteps; ++i) {
    const bool down = i % 2 == 0;
    OMNIHDR_ASSIGN(const auto watched,
                   Step(watcher, control, Within(control, down ? dark : bright)));
    if (!watched) {
      measured.why_not = "frames do not come in time";
      return measured;
    }
    const std::optional<int> frames =
        FindLatency(level.mean, watched->samples, down ? -stops : stops);
    if (!frames) {
      measured.why_not = fmt::format(
          "brightness went from {:.3f} to {:.3f} of the range after a step of {:.1f} stops",
          level.mean, watched->last->mean, down ? -stops : stops);
      return measured;
    }
    most = std::max(most, *frames);
    least = std::min(least, *frames);
    level = *watched->last;
    ++measured.steps;
  }
  if (most - least > 2) {
    measured.why_not = fmt::format("brightness followed after {} to {} frames", least, most);
    return measured;
  }
  measured.frames = most;
  measured.least = least;
  return measured;
}

}  // namespace omnihdr::v4l2
