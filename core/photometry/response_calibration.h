#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/response.h"
#include "core/photometry/response_samples.h"

namespace omnihdr {

enum class ResponseMethod {
  // Debevec and Malik 1997, eq. 3: the 256 values of g(Z) = ln E + ln t and every spot's ln E, by
  // least squares with a penalty for roughness. Here every spot's ln E is eliminated exactly, so
  // that thousands of spots cost no more than one 256×256 system, the weights follow the scatter
  // measured at each value, and moving things are weighted down (Tukey).
  kDebevec,
  // Robertson, Borman and Stevenson 2003: maximum likelihood in linear light, the curve and the
  // spots' E in turns.
  kRobertson,
  kLinear,     // Z − black proportional to E·t, one black level for all channels
  kLogLinear,  // ln(E·t) = a·Z + b per channel (thesis figs. 3.13, 3.14)
};
std::string_view ToString(ResponseMethod method);
std::optional<ResponseMethod> ResponseMethodFromString(std::string_view name);

struct ResponseCalibrationOptions {
  ResponseMethod method = ResponseMethod::kDebevec;
  // How much a curve may bend: the standard deviation expected of the second derivative of ln g' by
  // ln Z (over a unit of ln Z), 0.001 to 1000. It is 0 for linear, gamma and log-linear curves.
  // Less is smoother.
  double bend = 0.5;
  // Turns: of the weights (Debevec, linear, log-linear), and of the curve (Robertson).
  int weight_turns = 6;
  int curve_turns = 300;
  Status Validate() const;
};

// What is known about one channel's curve. All per 8-bit pixel value.
struct ResponseCurve {
  std::array<double, 256> ln_exposure{};  // g(Z), 0 at value 128
  // Standard deviation of the curve itself, relative to value 128 (0 there).
  std::array<double, 256> standard_error{};
  // Standard deviation of ln E of one spot seen at this value, about the curve: noise,
  // quantisation, what the pictures disagree by.
  std::array<double, 256> spread{};
  // Values at which there was data; outside the curve is continued.
  int measured_low = 0;
  int measured_high = 255;
  double r_squared = 0.0;  // of the pixel values, as the curve and the spots' E predict them
  double residual_stops = 0.0;
  std::size_t spots = 0;
  std::size_t observations = 0;
  std::size_t outliers = 0;  // observations that disagree by far: moving things, dust
};

struct ResponseCalibration {
  Response response = *Response::Linear();
  std::array<ResponseCurve, 3> curves;
  // How far the exposures of one spot disagree about its light: root mean square of
  // ln E_ij − mean_j ln E_ij in stops, over the observations that were kept; over all of them,
  // outliers included; and over all of every fifth spot by a fit to the other four.
  double residual_stops = 0.0;
  double all_stops = 0.0;
  double held_out_stops = 0.0;
  // Mean of the same by exposure: a shutter that is not what it says, film that fails to add up.
  std::vector<double> exposure_bias_stops;
};

// Recovers the response. Law: monotone; the order of spots and exposures does not matter (to
// rounding). Errors (kData): as CheckSamples; values that cover too little of the range; a linear
// fit whose black level is far below 0.
Result<ResponseCalibration> CalibrateResponse(const ResponseSamples& samples,
                                              const ResponseCalibrationOptions& options);

// The residual over all observations, as defined above, of any response on any samples, one channel
// or all (-1). Observations below the black level are left out.
double ResidualStops(const Response& response, const ResponseSamples& samples, int channel = -1);

}  // namespace omnihdr
