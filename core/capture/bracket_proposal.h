#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image_io.h"
#include "core/photometry/response.h"

namespace omnihdr {

struct ProposalOptions {
  // Shares of the pixels that may be brighter than the bracket reaches, and darker.
  double bright_share = 0.001;
  double dark_share = 0.01;
  // Where the brightest pixels of the shortest exposure and the darkest of the longest one are put:
  // 8-bit code values.
  double bright_value = 230.0;
  double dark_value = 24.0;
  // Values beyond these tell a bound only.
  double value_low = 10.0;
  double value_high = 245.0;
  double most_stops = 1.6;  // between neighbours
  Status Validate() const;  // kConfig naming the option and its range
};

struct BracketProposal {
  ExposureTime shortest;
  Stops step{0.0};
  int count = 1;
  // The scene's radiance at the two shares, as conventions.md counts it.
  double bright = 0.0;
  double dark = 0.0;
  // Whether the pictures reached so far; else the scene goes on beyond, and more pictures are
  // needed.
  bool bright_reached = false;
  bool dark_reached = false;
  double RangeStops() const;
};

// A first look at a scene: pictures of several exposures, of one place or of many, and the bracket
// that covers the range of radiance in them. The brightest pixels are measured in the longest
// exposure that does not clip them, the darkest in the shortest one that lifts them. Values of all
// channels count as green's, which a sensor sees most of. Not thread-safe.
class SceneRange {
 public:
  SceneRange(const Response& response, int bits) : response_(response), bits_(bits) {}

  // Pixels are sampled, at most a million a picture.
  void Add(const DecodedImage& picture, const Exposure& exposure);
  // Shares of the pixels of an exposure (as given to Add) that clip and that are dark.
  double ClippedShare(const Exposure& exposure, double value_high) const;
  double DarkShare(const Exposure& exposure, double value_low) const;
  // Nothing before the first picture.
  std::optional<BracketProposal> Propose(const ProposalOptions& options) const;

 private:
  using Histogram = std::array<std::uint64_t, 256>;
  static double Share(const Histogram& histogram, int from, int to);

  const Response response_;
  const int bits_;
  std::map<double, Histogram> exposures_;  // by effective seconds
};

}  // namespace omnihdr
