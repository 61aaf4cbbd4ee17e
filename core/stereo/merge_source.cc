#include "core/stereo/merge_source.h"

#include "core/stereo/fuse.h"

namespace omnihdr {

Image<float> NearestSurface(const DisparityMap& reference, const MergeSource& source,
                            const Eigen::Vector3f& offset) {
  Image<float> nearest = WarpDisparity(reference, offset);
  if (source.disparity != nullptr && source.disparity->disparity.width() == nearest.width()) {
    for (int y = 0; y < nearest.height(); ++y) {
      for (int x = 0; x < nearest.width(); ++x) {
        if (source.disparity->confidence.at(x, y) < 0.3F) continue;
        const float d = source.disparity->disparity.at(x, y);
        float& n = nearest.at(x, y);
        if (d >= 0.0F && !(n >= d)) n = d;
      }
    }
  }
  return nearest;
}

}  // namespace omnihdr
