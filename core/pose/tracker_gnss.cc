// The scale by satellites.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/pose/gnss_scale.h"
#include "core/pose/tracker.h"

namespace omnihdr {
namespace {

constexpr std::size_t kMostFixes = 48;

std::string Support(const GnssScale& scale) {
  return fmt::format("one sigma {:.1f} %, {} fixes agree, {} do not",
                     100.0 * scale.sigma / scale.metres_per_unit, scale.fixes, scale.outliers);
}

}  // namespace

void Tracker::Rescale(double scale, Keyframe* keyframe) {
  keyframe->world_from_camera.translation *= scale;
  keyframe->path *= scale;
  keyframe->median_inverse_distance /= scale;
  for (double& inverse : keyframe->inverse_distance) inverse /= scale;
}

// Adds the position whose pose is final to the chain's fixes and asks them for the scale.
void Tracker::CompareWithGnss() {
  constexpr std::size_t kBack = PoseTracker::kFinalAfter + 1;
  if (size() < kBack) return;
  const std::size_t final = size() - kBack;
  const int chain_id = estimate(final).chain;
  Chain& chain = state_.chains.at(chain_id);
  if (!chain.scaled || chain.given) return;
  const TrackedPosition& tracked = state_.window[final];
  if (tracked.gnss && estimate(final).dead_reckoned.empty()) {
    if (chain.fixes_seen++ % chain.fix_spacing == 0) {
      chain.fixes.push_back({estimate(final).world_from_camera.translation, *tracked.gnss});
    }
    if (chain.fixes.size() > kMostFixes) {
      std::vector<GnssSample> kept;
      for (std::size_t i = 0; i < chain.fixes.size(); i += 2) kept.push_back(chain.fixes[i]);
      chain.fixes = std::move(kept);
      chain.fix_spacing *= 2;
    }
    chain.gnss_scale = EstimateGnssScale(chain.fixes);
  }
  if (!chain.gnss_scale) return;
  const GnssScale scale = *chain.gnss_scale;
  if (!chain.metric && IsScaleKnown(scale)) {
    GoOnInMetres(chain_id, scale);
  } else if (chain.metric) {
    const bool contradicts = IsScaleKnown(scale) && ContradictsMetres(scale);
    if (contradicts && !chain.contradicted) {
      state_.window[final].estimate.scale_note = fmt::format(
          "scale: by satellites lengths are {:+.1f} % of what {} has ({}); they are kept",
          100.0 * (scale.metres_per_unit - 1.0),
          chain.source == ScaleSource::kOdometer ? "the odometer" : "the chain", Support(scale));
    }
    chain.contradicted = contradicts;
  }
  for (std::size_t i = final; i < size(); ++i) {
    PoseEstimate& e = state_.window[i].estimate;
    e.gnss_scale = state_.chains.at(e.chain).gnss_scale;
  }
}

// Ends a chain without scale and goes on in metres: same frame, another unit, another number, since
// the views written before cannot change.
void Tracker::GoOnInMetres(int chain_id, const GnssScale& scale) {
  const double factor = scale.metres_per_unit;
  Chain chain = state_.chains.at(chain_id);
  const int next = state_.next_chain++;
  chain.metric = true;
  chain.source = ScaleSource::kGnss;
  chain.unit_length *= factor;
  chain.path *= factor;
  for (GnssSample& sample : chain.fixes) sample.translation *= factor;
  // What is known of the new unit, which is a metre.
  chain.gnss_scale->metres_per_unit = 1.0;
  chain.gnss_scale->sigma /= factor;
  state_.chains[next] = std::move(chain);
  Reexpress(chain_id, next, Pose{}, Pose{}, factor);
  for (KeyframeEntry& entry : state_.keyframes) {
    if (entry.chain != chain_id) continue;
    entry.chain = next;
    entry.scale *= factor;
    if (const auto held = keyframes_.find(entry.position); held != keyframes_.end()) {
      held->second.chain = next;
      Rescale(factor, &held->second);
    }
  }
  PoseEstimate& first = state_.window[size() - PoseTracker::kFinalAfter - 1].estimate;
  first.chain_reason =
      fmt::format("lengths are metres from here on, by satellites: chain {} times {:.6g} ({})",
                  chain_id, factor, Support(scale));
}

}  // namespace omnihdr
