#pragma once

#include <array>
#include <string>
#include <vector>

#include "core/base/result.h"

namespace omnihdr {

enum class ResponseModel { kLinear, kLogLinear, kTable };

// Inverse camera response: from pixel value Z to exposure E·t, per channel (R, G, B), normalised so
// that green value 128 gives 1.0 (conventions: radiance 1.0 is value 128 at 1 s and 0 dB). Monotone
// increasing above the black level. Value type; thread-safe to read.
//   linear      Z − black proportional to E·t
//   loglinear   ln(E·t) = a·Z + b (thesis figs. 3.13, 3.14)
//   table       ln(E·t) given for every 8-bit value
class Response {
 public:
  // Z in 8-bit units; `black` in [0, 128).
  static Result<Response> Linear(double black = 0.0);
  // a > 0 per channel.
  static Result<Response> LogLinear(const std::array<std::array<double, 2>, 3>& a_b);
  // Three rows of 256, non-decreasing, finite.
  static Result<Response> Table(const std::array<std::vector<double>, 3>& ln_exposure);

  // The same curve of a sensor that clips at `white`, in 8-bit units, [64, 255].
  Result<Response> WithWhite(double white) const;

  ResponseModel model() const { return model_; }
  // Value at which the sensor clips: 255, or less where its full well ends before its samples do.
  double white() const { return white_; }
  // Up to which value a sample is usable, given that of a sensor that clips at 255
  // (MeasureOptions).
  double HighestUsable(double value_high) const { return value_high * white_ / 255.0; }
  double black() const { return black_; }
  const std::array<std::array<double, 2>, 3>& loglinear() const { return loglinear_; }
  const std::array<std::vector<double>, 3>& table() const { return ln_exposure_; }

  // E·t of a pixel value in 8-bit units; fractional values (16-bit input scaled to 0..255) allowed,
  // interpolated between table entries. Never negative.
  double ExposureFromValue(int channel, double value) const;
  // Pixel value (8-bit units, not rounded, not clipped above 255 for linear) of E·t: the
  // simulator's direction.
  double ValueFromExposure(int channel, double exposure) const;
  // d(E·t)/dZ at a value: turns pixel noise into radiance noise.
  double Slope(int channel, double value) const;
  // 256 entries of ExposureFromValue, for 8-bit frames.
  std::array<float, 256> Lookup(int channel) const;

 private:
  Response() = default;
  ResponseModel model_ = ResponseModel::kLinear;
  double black_ = 0.0;
  double white_ = 255.0;
  std::array<std::array<double, 2>, 3> loglinear_{};
  std::array<std::vector<double>, 3> ln_exposure_;
  double scale_ = 1.0;  // multiplies the raw model so that green 128 gives 1.0
};

}  // namespace omnihdr
