#pragma once

#include <cstdint>
#include <optional>

#include "core/base/result.h"
#include "core/base/units.h"
#include "drivers/v4l2/controls.h"

namespace omnihdr::v4l2 {

struct GainOptions {
  // Code at which the gain is 0 dB, amplification being proportional to the code; 0 = the gain is
  // not used, and held at `held`.
  int unity = 0;
  int held = -1;  // code; -1 = the control's default
};

// An exposure as set and read back.
struct SetExposure {
  Exposure asked;
  Exposure measured;
  std::int64_t exposure_raw = 0;
  std::int64_t gain_raw = 0;
  std::optional<std::int64_t> vblank;
  bool clamped = false;  // something else than the nearest value asked for came back
};

// Exposure and gain of a camera in seconds and decibels, whichever unit its driver has: steps of
// 100 µs (V4L2_CID_EXPOSURE_ABSOLUTE) or lines (V4L2_CID_EXPOSURE; a line lasts (width + HBLANK) /
// PIXEL_RATE seconds, and VBLANK is made longer first when it bounds the exposure). Seconds are
// rounded to the nearest step.
class ExposureControl {
 public:
  // `width` and `height` of the sensor's picture; `frame_interval_s` bounds an exposure in steps of
  // 100 µs, 0 = not known. kConfig when the device has neither control, or not what they need.
  static Result<ExposureControl> Open(const Controls& controls, int width, int height,
                                      double frame_interval_s, const GainOptions& gain);
  ExposureTime shortest() const { return ExposureTime::Seconds(shortest_s_); }
  ExposureTime longest() const { return ExposureTime::Seconds(longest_s_); }
  double quantum_s() const { return unit_s_ * static_cast<double>(exposure_.step); }
  bool in_lines() const { return in_lines_; }
  double unit_s() const { return unit_s_; }
  bool has_gain() const { return gain_ && gain_options_.unity > 0; }
  static constexpr double kGainGraceDb = 0.01;  // what was read back may be asked for again
  // Of the gains that can be asked for; both 0 when there is none.
  GainDb least_gain() const;
  GainDb most_gain() const;
  bool AllowsGain(GainDb gain) const;
  // Whether setting it makes VBLANK another one first, which acts on frames by itself.
  bool MovesBlanking(const Exposure& exposure) const;
  // Sets exposure and gain together and reads them back. kUsage when out of range.
  Result<SetExposure> Set(const Exposure& exposure);

 private:
  explicit ExposureControl(const Controls& controls) : controls_(controls) {}
  Status OpenLines(int width, int height);
  Status OpenGain(const GainOptions& options);
  std::int64_t BlankingFor(std::int64_t lines) const;
  Status MakeRoom(std::int64_t lines);

  Controls controls_;
  Control exposure_;
  std::optional<Control> gain_;
  std::optional<Control> vblank_;
  GainOptions gain_options_;
  std::int64_t gain_held_ = 0;
  bool in_lines_ = false;
  double unit_s_ = 1e-4;
  double shortest_s_ = 0.0;
  double longest_s_ = 0.0;
  std::int64_t vblank_now_ = 0;
  std::int64_t vblank_least_ = 0;
  std::int64_t room_ = 0;  // most lines of exposure less VBLANK: constant
};

}  // namespace omnihdr::v4l2
