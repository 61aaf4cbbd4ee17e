#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "core/photometry/response_samples.h"

// The parts that the methods of response calibration share. Private to response_calibration.cc and
// response_fit.cc.
namespace omnihdr::response_fit {

inline constexpr int kReferenceValue = 128;  // where g is 0

// Pixel values that have data: nodes of the curve.
struct Support {
  int low = 0;
  int high = 255;
  int size() const { return high - low + 1; }
  bool Contains(float value) const {
    return value >= static_cast<float>(low) && value <= static_cast<float>(high);
  }
};
// From the value with a few observations below it to the one with a few above.
Support SupportOf(const ResponseSamples::Channel& channel);

// Scatter of observations about a curve as a function of the pixel value: robust (median absolute
// deviation) over ranges of values, interpolated.
class Scatter {
 public:
  Scatter() { sigma_.fill(1.0); }
  // `residuals` belong to `values`; those of a spot already corrected for its own mean.
  Scatter(std::span<const float> values, std::span<const double> residuals);
  double At(float value) const;

 private:
  static constexpr int kBins = 16;
  std::array<double, kBins> sigma_{};
};

// Tukey's biweight of a residual in units of its standard deviation.
double Tukey(double normalised);

// The normal equations of g over the support, without penalty.
struct CurveSystem {
  Support support;
  Eigen::MatrixXd a;
  Eigen::VectorXd b;
  explicit CurveSystem(const Support& s)
      : support(s),
        a(Eigen::MatrixXd::Zero(s.size(), s.size())),
        b(Eigen::VectorXd::Zero(s.size())) {}
};

struct Curve {
  std::array<double, 256> g{};
  std::array<double, 256> standard_error{};
};
// Solves `system`, which is in units of 1/σ², with a penalty on the second derivative of ln g' by
// ln Z. It is 0 for every linear, gamma and log-linear curve, so that smoothing pulls towards none
// of them; a penalty on g'' (Debevec and Malik) bends a linear camera's curve, and leaves waves of
// the period of the exposures' ratio, which the data cannot see (Grossberg and Nayar 2003), to
// chance. The curve rises everywhere. Beyond the support it goes on as E ∝ Z^p, exact for linear
// and gamma curves. g(128) = 0. `start`: a curve about right, or null.
Curve SolveCurve(const CurveSystem& system, double bend, const Curve* start);

// g at a fractional value.
double Interpolate(const std::array<double, 256>& g, float value);

Curve FitDebevec(const ResponseSamples::Channel& channel, std::span<const double> seconds,
                 double bend, int turns);
Curve FitRobertson(const ResponseSamples::Channel& channel, std::span<const double> seconds,
                   double bend, int turns);

// Z = black + E·t over all channels; black and its standard error.
struct Fitted {
  double value = 0.0;
  double standard_error = 0.0;
};
Fitted FitBlack(const ResponseSamples& samples, int turns);
// Z = slope·ln t + of the spot; the slope of one channel.
Fitted FitLogSlope(const ResponseSamples::Channel& channel, std::span<const double> seconds,
                   int turns);

}  // namespace omnihdr::response_fit
