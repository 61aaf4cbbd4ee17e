#include "core/capture/scene_look.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <thread>
#include <utility>

namespace omnihdr {
namespace {

constexpr double kFirstExposure = 0.004;
constexpr double kStepOfTheLook = 8.0;
constexpr Nanoseconds kAskAgain = std::chrono::milliseconds(2);

class Look {
 public:
  Look(Camera& camera, const CameraInfo& info, const SceneLookOptions& options,
       const std::function<bool()>& go_on)
      : camera_(camera),
        options_(options),
        go_on_(go_on),
        look_{SceneRange(info.response, info.description.bits), 0} {}

  // Adds a picture; the exposure it had.
  Result<Exposure> Take(double seconds) {
    if (!go_on_()) return Fail(ErrorKind::kTemporary, "the look at the scene was broken off");
    ExposureRequest request;
    request.trigger =
        TriggerId{Value(kFirstLookTrigger) + static_cast<std::uint64_t>(look_.pictures)};
    request.exposure = {ExposureTime::Seconds(seconds), options_.gain};
    request.trigger_time = clock_.Now();
    request.odometer_m = options_.odometer_m;
    OMNIHDR_ASSIGN(CameraFrame frame, Picture(request));
    if (frame.status != FrameStatus::kOk) {
      return Fail(ErrorKind::kData, "picture with {:.6g} s: {}: {}", seconds,
                  ToString(frame.status), frame.detail);
    }
    const Exposure exposure = frame.measured_exposure.value_or(request.exposure);
    DecodedImage image;
    image.pixels = std::move(frame.pixels);
    look_.scene.Add(image, exposure);
    ++look_.pictures;
    return exposure;
  }
  bool MayGoOn() const { return look_.pictures < kMostLookPictures; }
  const SceneRange& scene() const { return look_.scene; }
  SceneLook Finish() && { return std::move(look_); }

 private:
  Result<CameraFrame> Picture(const ExposureRequest& request) {
    const HostTime until = clock_.Now() + options_.frame_timeout +
                           Nanoseconds(std::llround(request.exposure.time.seconds() * 1e9));
    while (true) {
      const Status commanded = camera_.Trigger(request);
      if (commanded) break;
      if (commanded.error().kind != ErrorKind::kTemporary || clock_.Now() >= until) {
        return Forward(commanded.error());
      }
      std::this_thread::sleep_for(kAskAgain);
    }
    while (true) {
      OMNIHDR_ASSIGN(CameraFrame frame,
                     camera_.Receive(std::max(until - clock_.Now(), Nanoseconds(0))));
      // What was on its way before belongs to nobody any more.
      if (frame.trigger == request.trigger) return frame;
    }
  }

  Camera& camera_;
  const SceneLookOptions& options_;
  const std::function<bool()>& go_on_;
  const SystemClock clock_;
  SceneLook look_;
};

}  // namespace

Result<SceneLook> LookAtScene(Camera& camera, const CameraInfo& info,
                              const SceneLookOptions& options, const std::function<bool()>& go_on) {
  OMNIHDR_TRY(options.proposal.Validate());
  const ProposalOptions& want = options.proposal;
  const double shortest_s = info.shortest.seconds();
  const double longest_s =
      std::max(shortest_s, std::min(info.longest.seconds(), options.longest_s));
  Look look(camera, info, options, go_on);
  double shorter_s = std::clamp(kFirstExposure, shortest_s, longest_s);
  double longer_s = shorter_s;
  OMNIHDR_ASSIGN(Exposure taken, look.Take(shorter_s));
  const Exposure first = taken;
  while (look.scene().ClippedShare(taken, want.value_high) > want.bright_share &&
         shorter_s > shortest_s && look.MayGoOn()) {
    shorter_s = std::max(shorter_s / kStepOfTheLook, shortest_s);
    OMNIHDR_ASSIGN(taken, look.Take(shorter_s));
  }
  taken = first;
  while (look.scene().DarkShare(taken, want.value_low) > want.dark_share && longer_s < longest_s &&
         look.MayGoOn()) {
    longer_s = std::min(longer_s * kStepOfTheLook, longest_s);
    OMNIHDR_ASSIGN(taken, look.Take(longer_s));
  }
  return std::move(look).Finish();
}

Result<AllowedBracket> AllowBracket(const BracketProposal& proposal, const BracketOptions& options,
                                    const ExposureLimits& limits) {
  AllowedBracket allowed;
  if (!proposal.dark_reached) {
    allowed.notes.emplace_back(
        "the darkest parts are dark in every picture: the scene goes on beyond");
  }
  if (!proposal.bright_reached) {
    allowed.notes.emplace_back(
        "the brightest parts clip in every picture: the scene goes on beyond");
  }
  std::vector<ExposureTime> steps;
  for (int i = 0; i < std::min(proposal.count, BracketPlan::kMaxSteps); ++i) {
    ExposureTime step = proposal.shortest + Stops{proposal.step.value * i};
    step = std::max(step, limits.shortest);
    if (step > limits.longest) {
      allowed.notes.push_back(
          fmt::format("the camera's longest exposure is {:.6g} s: the darkest parts stay dark",
                      limits.longest.seconds()));
      step = limits.longest;
    }
    if (!steps.empty() && !(steps.back() < step)) continue;
    steps.push_back(step);
  }
  std::string last_refusal;
  while (!steps.empty()) {
    BracketOptions tried = options;
    tried.exposures = steps;
    const Result<BracketPlan> plan = BracketPlan::Make(tried, limits);
    if (plan) {
      allowed.exposures = plan->exposures();
      for (const std::string& change : plan->changes()) allowed.notes.push_back(change);
      if (!last_refusal.empty()) allowed.notes.push_back("left out: " + last_refusal);
      return allowed;
    }
    last_refusal = plan.error().message;
    steps.pop_back();
  }
  return Fail(ErrorKind::kConfig, "no bracket is allowed: {}", last_refusal);
}

}  // namespace omnihdr
