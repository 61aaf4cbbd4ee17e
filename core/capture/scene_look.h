#pragma once

#include <functional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/capture/bracket_plan.h"
#include "core/capture/bracket_proposal.h"
#include "core/ports/camera.h"

namespace omnihdr {

struct SceneLookOptions {
  ProposalOptions proposal;
  double longest_s = 1.0;  // longest exposure that is tried
  GainDb gain;
  // Where the vehicle is, for cameras that are simulated.
  double odometer_m = 0.0;
  // From the end of an exposure to its frame.
  Nanoseconds frame_timeout = std::chrono::seconds(2);
};

struct SceneLook {
  SceneRange scene;
  int pictures = 0;
};

// A first look at the scene through a camera that is open and started, and triggered by nobody
// else: from a middle exposure shorter ones until nothing clips, then longer ones until nothing is
// dark, at most kMostLookPictures. Triggers have numbers from kFirstLookTrigger on: no frame of a
// look is taken for another's. `go_on` is asked before every picture; when it answers false, and
// when a picture does not come or is not good, that is the error. Takes as long as the exposures
// do, and no more than frame_timeout beside each.
inline constexpr int kMostLookPictures = 12;
inline constexpr TriggerId kFirstLookTrigger{std::uint64_t{1} << 62};
Result<SceneLook> LookAtScene(Camera& camera, const CameraInfo& info,
                              const SceneLookOptions& options, const std::function<bool()>& go_on);

// The longest part of a proposal that the camera and the configuration (its `exposures` are not
// asked) allow, from its shortest exposure on; what is changed or left out, and where the scene
// goes on beyond the pictures, is said. kConfig when nothing is allowed.
struct AllowedBracket {
  std::vector<ExposureTime> exposures;
  std::vector<std::string> notes;
};
Result<AllowedBracket> AllowBracket(const BracketProposal& proposal, const BracketOptions& options,
                                    const ExposureLimits& limits);

}  // namespace omnihdr
