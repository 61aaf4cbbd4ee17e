#pragma once

#include <cstdint>
#include <string_view>

namespace omnihdr {

// The parts of the way from views to a filled disparity map and its merge that can be exchanged.
// The first of each is ours and the default; the others are those of Zhou, "Omnidirectional High
// Dynamic Range Imaging with a Moving Camera", 2014, and its peers. README.md beside this file
// tells what each choice costs.
enum class StereoCost : std::uint8_t {
  kInterval,           // absolute log radiance as intervals, all pairs of views (sweep.h)
  kRadiometric,        // value less local mean, and gradient (pairwise_costs.h)
  kCensus,             // census transform (pairwise_costs.h)
  kMutualInformation,  // pixelwise mutual information (mutual_information.h)
};
enum class StereoSearch : std::uint8_t {
  kRanges,  // what a map of half the size leaves in question (cost_volume.h)
  kFull,    // every label at every pixel
};
enum class StereoFusion : std::uint8_t {
  kVotes,       // supporters less half the violations (fuse.h)
  kCrossCheck,  // only what a neighbour's map confirms (stability.h)
  kStability,   // cross-checked maps, nearest stable candidate (stability.h)
};
enum class StereoFilter : std::uint8_t {
  kNone,
  kWavelet,  // wavelet_filter.h
};
enum class StereoFill : std::uint8_t {
  kRims,         // from the rims in eight directions (fuse.h)
  kSuperpixels,  // inverse distance within a superpixel; what has no value stays a hole
                 // (superpixel_fill.h)
};
// What a merged view shows where something moved while the views were taken.
enum class MergeMovers : std::uint8_t {
  kKeep,    // the view's own instant
  kRemove,  // the background, where other views saw it
};
std::string_view ToString(StereoCost cost);      // "interval", "radiometric", "census", ...
std::string_view ToString(StereoSearch search);  // "ranges", "full"
std::string_view ToString(StereoFusion fusion);  // "votes", "cross-check", "stability"
std::string_view ToString(StereoFilter filter);  // "none", "wavelet"
std::string_view ToString(StereoFill fill);      // "rims", "superpixels"
std::string_view ToString(MergeMovers movers);   // "keep", "remove"

}  // namespace omnihdr
