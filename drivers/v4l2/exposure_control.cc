#include "drivers/v4l2/exposure_control.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace omnihdr::v4l2 {
namespace {

constexpr double kHundredMicroseconds = 1e-4;
constexpr double kLongest = 100.0;  // seconds; what is longer nobody asks for

Result<std::int64_t> Needed(const Controls& controls, std::uint32_t id, const char* name) {
  OMNIHDR_ASSIGN(const std::optional<Control> control, controls.Find(id));
  if (!control) {
    return Fail(ErrorKind::kConfig,
                "exposure in lines, but no control {}: a line's duration is not known", name);
  }
  return controls.Get(*control);
}

}  // namespace

Result<ExposureControl> ExposureControl::Open(const Controls& controls, int width, int height,
                                              double frame_interval_s, const GainOptions& gain) {
  ExposureControl made(controls);
  OMNIHDR_ASSIGN(std::optional<Control> absolute, controls.Find(V4L2_CID_EXPOSURE_ABSOLUTE));
  if (absolute) {
    made.exposure_ = std::move(*absolute);
    made.unit_s_ = kHundredMicroseconds;
    made.longest_s_ = static_cast<double>(made.exposure_.maximum) * kHundredMicroseconds;
    // A camera that keeps its rate cuts longer exposures off without telling.
    if (frame_interval_s > 0.0) made.longest_s_ = std::min(made.longest_s_, frame_interval_s);
  } else {
    OMNIHDR_ASSIGN(std::optional<Control> lines, controls.Find(V4L2_CID_EXPOSURE));
    if (!lines) {
      return Fail(ErrorKind::kConfig,
                  "no control for the exposure: expected exposure_time_absolute or exposure");
    }
    made.exposure_ = std::move(*lines);
    OMNIHDR_TRY(made.OpenLines(width, height));
  }
  const std::int64_t least =
      made.exposure_.Nearest(std::max<std::int64_t>(made.exposure_.minimum, 1));
  made.shortest_s_ = static_cast<double>(least) * made.unit_s_;
  made.longest_s_ = std::min(made.longest_s_, kLongest);
  if (!(made.shortest_s_ > 0.0 && made.shortest_s_ < made.longest_s_) ||
      !made.exposure_.writable()) {
    return Fail(ErrorKind::kConfig,
                "control \"{}\": range {} to {}, {} to {} s: expected a range above 0 that can be "
                "written",
                made.exposure_.name, made.exposure_.minimum, made.exposure_.maximum,
                made.shortest_s_, made.longest_s_);
  }
  OMNIHDR_TRY(made.OpenGain(gain));
  return made;
}

Status ExposureControl::OpenLines(int width, int height) {
  in_lines_ = true;
  OMNIHDR_ASSIGN(const std::int64_t rate, Needed(controls_, V4L2_CID_PIXEL_RATE, "PIXEL_RATE"));
  OMNIHDR_ASSIGN(const std::int64_t hblank, Needed(controls_, V4L2_CID_HBLANK, "HBLANK"));
  if (rate <= 0 || hblank < 0 || width <= 0 || height <= 0) {
    return Fail(ErrorKind::kProtocol,
                "PIXEL_RATE {}, HBLANK {}, {} x {} pixels: expected a duration of a line", rate,
                hblank, width, height);
  }
  unit_s_ = (static_cast<double>(width) + static_cast<double>(hblank)) / static_cast<double>(rate);
  std::int64_t most = exposure_.maximum;
  OMNIHDR_ASSIGN(vblank_, controls_.Find(V4L2_CID_VBLANK));
  if (vblank_ && vblank_->writable()) {
    OMNIHDR_ASSIGN(vblank_now_, controls_.Get(*vblank_));
    vblank_least_ = vblank_now_;
    room_ = exposure_.maximum - vblank_now_;
    most = std::max(most, room_ + vblank_->maximum);
  } else {
    vblank_.reset();
  }
  longest_s_ = static_cast<double>(most) * unit_s_;
  return {};
}

Status ExposureControl::OpenGain(const GainOptions& options) {
  gain_options_ = options;
  OMNIHDR_ASSIGN(gain_, controls_.Find(V4L2_CID_ANALOGUE_GAIN));
  if (!gain_) {
    OMNIHDR_ASSIGN(gain_, controls_.Find(V4L2_CID_GAIN));
  }
  if (gain_ && !gain_->writable()) gain_.reset();
  if (!gain_) {
    if (options.unity == 0 && options.held < 0) return {};
    return Fail(ErrorKind::kConfig,
                "gain: the camera has no such control: expected gain_unity = 0 "
                "and gain = -1");
  }
  if (options.unity > 0 && (options.unity < gain_->minimum || options.unity > gain_->maximum)) {
    return Fail(ErrorKind::kConfig, "gain_unity: {}: expected {} to {}", options.unity,
                gain_->minimum, gain_->maximum);
  }
  gain_held_ = options.unity > 0  ? options.unity
               : options.held < 0 ? gain_->default_value
                                  : options.held;
  if (gain_->Nearest(gain_held_) != gain_held_) {
    return Fail(ErrorKind::kConfig, "gain: {}: expected {} to {} in steps of {}", gain_held_,
                gain_->minimum, gain_->maximum, gain_->step);
  }
  return {};
}

GainDb ExposureControl::least_gain() const {
  if (!has_gain()) return {};
  const auto code = static_cast<double>(std::max<std::int64_t>(gain_->minimum, 1));
  return GainDb{20.0 * std::log10(code / gain_options_.unity)};
}

GainDb ExposureControl::most_gain() const {
  if (!has_gain()) return {};
  return GainDb{20.0 * std::log10(static_cast<double>(gain_->maximum) / gain_options_.unity)};
}

bool ExposureControl::AllowsGain(GainDb gain) const {
  return gain.value >= least_gain().value - kGainGraceDb &&
         gain.value <= most_gain().value + kGainGraceDb;
}

std::int64_t ExposureControl::BlankingFor(std::int64_t lines) const {
  return std::min(std::max(vblank_least_, lines - room_), std::int64_t{vblank_->maximum});
}

bool ExposureControl::MovesBlanking(const Exposure& exposure) const {
  if (!vblank_) return false;
  return BlankingFor(std::llround(exposure.time.seconds() / unit_s_)) != vblank_now_;
}

// VBLANK alone and first: the exposure's range follows from it.
Status ExposureControl::MakeRoom(std::int64_t lines) {
  if (!vblank_) return {};
  const std::int64_t wanted = BlankingFor(lines);
  if (wanted == vblank_now_) return {};
  const Wanted set{*vblank_, wanted};
  OMNIHDR_ASSIGN(const std::vector<Applied> applied, controls_.Set({&set, 1}));
  vblank_now_ = applied.front().read;
  OMNIHDR_ASSIGN(std::optional<Control> range, controls_.Find(exposure_.id));
  if (range) exposure_ = std::move(*range);
  return {};
}

Result<SetExposure> ExposureControl::Set(const Exposure& exposure) {
  // Half a step of grace: what was read back may be asked for again.
  const double grace = 0.5 * quantum_s();
  if (!exposure.IsValid() || exposure.time.seconds() < shortest_s_ - grace ||
      exposure.time.seconds() > longest_s_ + grace) {
    return Fail(ErrorKind::kUsage, "exposure {} s: expected {} to {} s", exposure.time.seconds(),
                shortest_s_, longest_s_);
  }
  if (!AllowsGain(exposure.gain)) {
    return Fail(ErrorKind::kUsage, "gain {} dB: expected {} to {} dB{}", exposure.gain.value,
                least_gain().value, most_gain().value,
                has_gain() ? "" : " (camera.v4l2.gain_unity is not set)");
  }
  const auto units = static_cast<std::int64_t>(std::llround(exposure.time.seconds() / unit_s_));
  OMNIHDR_TRY(MakeRoom(units));
  std::vector<Wanted> group{{exposure_, units}};
  if (gain_) {
    std::int64_t code = gain_held_;
    if (has_gain()) {
      code = static_cast<std::int64_t>(std::llround(gain_options_.unity * exposure.gain.Factor()));
    }
    group.push_back({*gain_, code});
  }
  OMNIHDR_ASSIGN(const std::vector<Applied> applied, controls_.Set(group));
  SetExposure set;
  set.asked = exposure;
  set.exposure_raw = applied.front().read;
  set.clamped = applied.front().written != applied.front().read;
  set.measured.time = ExposureTime::Seconds(static_cast<double>(set.exposure_raw) * unit_s_);
  if (gain_) {
    set.gain_raw = applied.back().read;
    set.clamped = set.clamped || applied.back().written != applied.back().read;
    if (has_gain() && set.gain_raw > 0) {
      set.measured.gain.value =
          20.0 * std::log10(static_cast<double>(set.gain_raw) / gain_options_.unity);
    }
    if (!has_gain() && set.gain_raw != gain_held_) {
      return Fail(ErrorKind::kProtocol, "control \"{}\": {} read back, expected {}", gain_->name,
                  set.gain_raw, gain_held_);
    }
  }
  if (vblank_) set.vblank = vblank_now_;
  if (!set.measured.IsValid()) {
    return Fail(ErrorKind::kProtocol, "control \"{}\": {} read back, expected above 0",
                exposure_.name, set.exposure_raw);
  }
  return set;
}

}  // namespace omnihdr::v4l2
