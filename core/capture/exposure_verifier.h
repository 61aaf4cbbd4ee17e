#pragma once

#include <optional>
#include <string>

#include "core/base/units.h"
#include "core/session/session.h"

namespace omnihdr {

// How far the exposure in force may be from the one asked for.
struct ExposureTolerance {
  double relative = 0.02;  // of the time
  double quantum_s = 0.0;  // one step of the camera's exposure clock is always allowed
  double gain_db = 0.1;
  // Whether a frame whose exposure nothing confirms is used (with proof "none") or refused.
  bool accept_unproven = false;
};

enum class ExposureVerdict {
  kOk,
  kMismatch,  // proved to be another than the one asked for
  kUnproven,  // the camera cannot say
};

struct ExposureCheck {
  ExposureVerdict verdict = ExposureVerdict::kUnproven;
  bool usable = false;  // whether the frame may take part in a merge
  Exposure exposure;   // what the journal says: the measured one when known, else the one asked for
  std::string detail;  // for people; empty when all is well
};

// Holds the exposure a frame really had against the one asked for. A frame recorded earlier (proof
// kFile) had its exposure fixed then: it is taken as recorded, whatever the bracket asks for now.
ExposureCheck VerifyExposure(const Exposure& asked, const std::optional<Exposure>& measured,
                             ExposureProof proof, const ExposureTolerance& tolerance);

}  // namespace omnihdr
