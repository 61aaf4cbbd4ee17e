#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "core/pose/feature_image.h"

namespace omnihdr {

inline constexpr int kDescriptorLength = 128;

struct Feature {
  Eigen::Vector3d ray;     // unit, camera frame
  double sigma_rad = 0.0;  // size: standard deviation of the blob, as an angle
  float x = 0.0F;          // in the feature image, pixel centres at +0.5
  float y = 0.0F;
  float scale = 0.0F;     // in pixels of the feature image
  float angle = 0.0F;     // orientation in the image, radians
  float response = 0.0F;  // contrast, in ln units
};

// Features of one panorama, in an order that depends on the picture alone.
struct FeatureSet {
  std::vector<Feature> features;
  // One row of kDescriptorLength a feature: RootSIFT (Arandjelovic and Zisserman 2012) in fixed
  // point, of length about kDescriptorNorm, so that a scalar product is a similarity.
  std::vector<std::int16_t> descriptors;
  int size() const { return static_cast<int>(features.size()); }
};
inline constexpr int kDescriptorNorm = 500;

struct FeatureOptions {
  int max_features = 3000;
  float min_contrast = 0.01F;  // of the difference of Gaussians, ln units
  float min_contrast_over_noise = 3.0F;
  float edge_ratio = 10.0F;       // principal curvatures further apart than this are an edge
  float clearance_sigmas = 1.0F;  // distance to saturated and masked pixels, in units of the scale
  bool upright = false;           // no orientation: descriptors aligned with the image's vertical
};

// Finds blobs as extrema of the difference of Gaussians over position and scale and describes them
// by gradient histograms (SIFT; Lowe 2004), on a picture whose left and right borders meet. The
// strongest of each of 512 cells of equal solid angle come first, until max_features are found.
// Keeps its pictures between calls, so that a call allocates little; not thread-safe, uses the
// worker pool inside. The result does not depend on the number of workers.
class FeatureFinder {
 public:
  explicit FeatureFinder(const FeatureOptions& options) : options_(options) {}
  FeatureSet Find(const FeatureImage& image);

 private:
  static constexpr int kLevels = 3;  // scales an octave
  struct Octave {
    std::array<Image<float>, kLevels + 3> gaussian;
    std::array<Image<float>, kLevels + 2> difference;
  };
  struct Candidate {
    int octave = 0;
    int level = 0;   // of the Gaussian picture nearest in scale
    float x = 0.0F;  // in the octave's picture, pixel centres at integers
    float y = 0.0F;
    float sigma = 0.0F;  // in the octave's pixels
    float response = 0.0F;
  };

  void BuildPyramid(const FeatureImage& image);
  std::vector<Candidate> FindExtrema(const FeatureImage& image) const;
  bool Localise(const FeatureImage& image, int octave, int level, int x, int y,
                Candidate* candidate) const;
  std::vector<Candidate> Spread(const FeatureImage& image, std::vector<Candidate> candidates) const;
  std::vector<float> Orientations(const Candidate& candidate) const;
  void Describe(const Candidate& candidate, float angle, std::int16_t* descriptor) const;

  FeatureOptions options_;
  std::vector<Octave> octaves_;
};

}  // namespace omnihdr
