#include "core/stereo/methods.h"

namespace omnihdr {

std::string_view ToString(StereoCost cost) {
  switch (cost) {
    case StereoCost::kInterval:
      return "interval";
    case StereoCost::kRadiometric:
      return "radiometric";
    case StereoCost::kCensus:
      return "census";
    case StereoCost::kMutualInformation:
      return "mutual-information";
  }
  return "?";
}

std::string_view ToString(StereoSearch search) {
  return search == StereoSearch::kFull ? "full" : "ranges";
}

std::string_view ToString(StereoFusion fusion) {
  switch (fusion) {
    case StereoFusion::kVotes:
      return "votes";
    case StereoFusion::kCrossCheck:
      return "cross-check";
    case StereoFusion::kStability:
      return "stability";
  }
  return "?";
}

std::string_view ToString(StereoFilter filter) {
  return filter == StereoFilter::kWavelet ? "wavelet" : "none";
}

std::string_view ToString(StereoFill fill) {
  return fill == StereoFill::kSuperpixels ? "superpixels" : "rims";
}

std::string_view ToString(MergeMovers movers) {
  return movers == MergeMovers::kRemove ? "remove" : "keep";
}

}  // namespace omnihdr
