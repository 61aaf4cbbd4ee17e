#include "core/capture/exposure_verifier.h"

#include <fmt/format.h>

#include <cmath>

namespace omnihdr {

ExposureCheck VerifyExposure(const Exposure& asked, const std::optional<Exposure>& measured,
                             ExposureProof proof, const ExposureTolerance& tolerance) {
  ExposureCheck check;
  if (!measured || proof == ExposureProof::kNone) {
    check.verdict = ExposureVerdict::kUnproven;
    check.usable = tolerance.accept_unproven;
    check.exposure = measured && measured->IsValid() ? *measured : asked;
    check.detail =
        fmt::format("nothing confirms that the exposure was {:.9g} s", asked.time.seconds());
    return check;
  }
  if (!measured->IsValid()) {
    check.verdict = ExposureVerdict::kMismatch;
    check.exposure = asked;
    check.detail = fmt::format("the camera reports an exposure of {} s at {} dB",
                               measured->time.seconds(), measured->gain.value);
    return check;
  }
  check.exposure = *measured;
  const double difference_s = std::abs(measured->time.seconds() - asked.time.seconds());
  const bool time_agrees = difference_s <= tolerance.relative * asked.time.seconds() ||
                           difference_s <= tolerance.quantum_s * (1.0 + 1e-6);
  const bool gain_agrees = std::abs(measured->gain.value - asked.gain.value) <= tolerance.gain_db;
  if (proof == ExposureProof::kFile || (time_agrees && gain_agrees)) {
    check.verdict = ExposureVerdict::kOk;
    check.usable = true;
    return check;
  }
  check.verdict = ExposureVerdict::kMismatch;
  check.detail = fmt::format("asked for {:.9g} s at {:g} dB, the frame had {:.9g} s at {:g} dB",
                             asked.time.seconds(), asked.gain.value, measured->time.seconds(),
                             measured->gain.value);
  return check;
}

}  // namespace omnihdr
