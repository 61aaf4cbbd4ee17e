#include "core/photometry/response.h"

#include <algorithm>
#include <cmath>

namespace omnihdr {
namespace {

constexpr int kGreen = 1;
constexpr double kReferenceValue = 128.0;
constexpr double kLeastWhite = 64.0;

}  // namespace

Result<Response> Response::Linear(double black) {
  if (!std::isfinite(black) || black < 0.0 || black >= kReferenceValue) {
    return Fail(ErrorKind::kData, "response black level {}, expected 0 <= black < 128", black);
  }
  Response r;
  r.model_ = ResponseModel::kLinear;
  r.black_ = black;
  r.scale_ = 1.0 / (kReferenceValue - black);
  return r;
}

Result<Response> Response::LogLinear(const std::array<std::array<double, 2>, 3>& a_b) {
  for (const auto& [a, b] : a_b) {
    if (!std::isfinite(a) || !std::isfinite(b) || a <= 0.0 || a > 10.0 || std::abs(b) > 500.0) {
      return Fail(
          ErrorKind::kData,
          "response loglinear [{}, {}], expected ln X = a·Z + b with 0 < a <= 10, |b| <= 500", a,
          b);
    }
  }
  Response r;
  r.model_ = ResponseModel::kLogLinear;
  r.loglinear_ = a_b;
  r.scale_ = 1.0 / std::exp(a_b[kGreen][0] * kReferenceValue + a_b[kGreen][1]);
  return r;
}

Result<Response> Response::Table(const std::array<std::vector<double>, 3>& ln_exposure) {
  for (std::size_t c = 0; c < 3; ++c) {
    const std::vector<double>& g = ln_exposure[c];
    if (g.size() != 256) {
      return Fail(ErrorKind::kData, "response ln_exposure channel {} has {} values, expected 256",
                  c, g.size());
    }
    for (std::size_t z = 0; z < g.size(); ++z) {
      if (!std::isfinite(g[z]) || std::abs(g[z]) > 500.0) {
        return Fail(
            ErrorKind::kData,
            "response ln_exposure channel {} value {} is {}, expected a finite number within "
            "±500",
            c, z, g[z]);
      }
      if (z > 0 && g[z] < g[z - 1]) {
        return Fail(ErrorKind::kData,
                    "response ln_exposure channel {} falls from {} to {} at value {}, expected a "
                    "curve that never falls",
                    c, g[z - 1], g[z], z);
      }
    }
  }
  Response r;
  r.model_ = ResponseModel::kTable;
  r.ln_exposure_ = ln_exposure;
  r.scale_ = 1.0 / std::exp(ln_exposure[kGreen][128]);
  return r;
}

Result<Response> Response::WithWhite(double white) const {
  if (!(white >= kLeastWhite && white <= 255.0)) {
    return Fail(ErrorKind::kData, "response white level {}, expected {} <= white <= 255", white,
                kLeastWhite);
  }
  Response r = *this;
  r.white_ = white;
  return r;
}

double Response::ExposureFromValue(int channel, double value) const {
  const auto c = static_cast<std::size_t>(channel);
  switch (model_) {
    case ResponseModel::kLinear:
      return std::max(0.0, (value - black_) * scale_);
    case ResponseModel::kLogLinear:
      return scale_ * std::exp(loglinear_[c][0] * value + loglinear_[c][1]);
    case ResponseModel::kTable: {
      const double v = std::clamp(value, 0.0, 255.0);
      const auto below = static_cast<std::size_t>(std::min(v, 254.0));
      const double f = v - static_cast<double>(below);
      const std::vector<double>& g = ln_exposure_[c];
      return scale_ * std::exp(g[below] * (1.0 - f) + g[below + 1] * f);
    }
  }
  return 0.0;
}

double Response::ValueFromExposure(int channel, double exposure) const {
  const auto c = static_cast<std::size_t>(channel);
  switch (model_) {
    case ResponseModel::kLinear:
      return exposure / scale_ + black_;
    case ResponseModel::kLogLinear:
      return (std::log(std::max(exposure / scale_, 1e-300)) - loglinear_[c][1]) / loglinear_[c][0];
    case ResponseModel::kTable: {
      const double ln = std::log(std::max(exposure / scale_, 1e-300));
      const std::vector<double>& g = ln_exposure_[c];
      if (ln <= g.front()) return 0.0;
      if (ln >= g.back()) return 255.0;
      const auto above = std::upper_bound(g.begin(), g.end(), ln);
      const auto k = static_cast<double>(above - g.begin());
      const double low = *(above - 1);
      return k - 1.0 + (ln - low) / (*above - low);
    }
  }
  return 0.0;
}

double Response::Slope(int channel, double value) const {
  if (model_ == ResponseModel::kLinear) return scale_;
  constexpr double kHalfStep = 0.5;
  return ExposureFromValue(channel, value + kHalfStep) -
         ExposureFromValue(channel, value - kHalfStep);
}

std::array<float, 256> Response::Lookup(int channel) const {
  std::array<float, 256> table{};
  for (std::size_t z = 0; z < table.size(); ++z) {
    table[z] = static_cast<float>(ExposureFromValue(channel, static_cast<double>(z)));
  }
  return table;
}

}  // namespace omnihdr
