#include "core/capture/bracket_proposal.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <variant>

namespace omnihdr {
namespace {

constexpr std::size_t kMostSamples = 1'000'000;
constexpr int kGreen = 1;

Status CheckRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

}  // namespace

Status ProposalOptions::Validate() const {
  OMNIHDR_TRY(CheckRange("bright_share", bright_share, 0.0, 0.2));
  OMNIHDR_TRY(CheckRange("dark_share", dark_share, 0.0, 0.2));
  OMNIHDR_TRY(CheckRange("most_stops", most_stops, 0.1, 10.0));
  OMNIHDR_TRY(CheckRange("dark_value", dark_value, value_low, 128.0));
  return CheckRange("bright_value", bright_value, 128.0, value_high);
}

double BracketProposal::RangeStops() const {
  return dark > 0.0 ? std::log2(std::max(bright / dark, 1.0)) : 0.0;
}

void SceneRange::Add(const DecodedImage& picture, const Exposure& exposure) {
  Histogram& histogram = exposures_[exposure.EffectiveSeconds()];
  std::visit(
      [&](const auto& pixels) {
        const auto values = pixels.values();
        const std::size_t stride = values.size() / kMostSamples + 1;
        const int shift = std::max(bits_ - 8, 0);
        for (std::size_t i = 0; i < values.size(); i += stride) {
          const int value = static_cast<int>(values[i]) >> shift;
          ++histogram[static_cast<std::size_t>(std::clamp(value, 0, 255))];
        }
      },
      picture.pixels);
}

double SceneRange::Share(const Histogram& histogram, int from, int to) {
  const auto all = std::accumulate(histogram.begin(), histogram.end(), std::uint64_t{0});
  if (all == 0) return 0.0;
  const auto some =
      std::accumulate(histogram.begin() + from, histogram.begin() + to + 1, std::uint64_t{0});
  return static_cast<double>(some) / static_cast<double>(all);
}

double SceneRange::ClippedShare(const Exposure& exposure, double value_high) const {
  const auto found = exposures_.find(exposure.EffectiveSeconds());
  if (found == exposures_.end()) return 0.0;
  return Share(found->second, static_cast<int>(std::ceil(value_high)), 255);
}

double SceneRange::DarkShare(const Exposure& exposure, double value_low) const {
  const auto found = exposures_.find(exposure.EffectiveSeconds());
  if (found == exposures_.end()) return 0.0;
  return Share(found->second, 0, static_cast<int>(std::floor(value_low)));
}

std::optional<BracketProposal> SceneRange::Propose(const ProposalOptions& options) const {
  if (exposures_.empty()) return std::nullopt;
  const int high = static_cast<int>(options.value_high);
  const int low = static_cast<int>(options.value_low);
  BracketProposal proposal;
  // Longest first: the first one in which so few pixels clip measures them best.
  for (auto it = exposures_.rbegin(); it != exposures_.rend() && !proposal.bright_reached; ++it) {
    int value = 255;
    while (value > 0 && Share(it->second, value, 255) <= options.bright_share) --value;
    proposal.bright_reached = value < high;
    proposal.bright = response_.ExposureFromValue(kGreen, std::min(value + 1, high)) / it->first;
  }
  for (auto it = exposures_.begin(); it != exposures_.end() && !proposal.dark_reached; ++it) {
    int value = 0;
    while (value < 255 && Share(it->second, 0, value) <= options.dark_share) ++value;
    proposal.dark_reached = value > low;
    proposal.dark = response_.ExposureFromValue(kGreen, std::max(value, low)) / it->first;
  }
  proposal.dark = std::min(proposal.dark, proposal.bright);
  const double shortest_s =
      response_.ExposureFromValue(kGreen, options.bright_value) / proposal.bright;
  const double longest_s = response_.ExposureFromValue(kGreen, options.dark_value) / proposal.dark;
  proposal.shortest = ExposureTime::Seconds(shortest_s);
  const double stops = std::max(0.0, std::log2(longest_s / shortest_s));
  proposal.count = 1 + static_cast<int>(std::ceil(stops / options.most_stops - 1e-9));
  if (proposal.count > 1) proposal.step = Stops{stops / (proposal.count - 1)};
  return proposal;
}

}  // namespace omnihdr
