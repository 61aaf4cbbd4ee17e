#pragma once

#include <vector>

#include "core/pose/features.h"

namespace omnihdr {

struct Match {
  int a = 0;           // index in the first set
  int b = 0;           // index in the second
  float ratio = 1.0F;  // distance to the best over distance to the second best: small is distinct
};

// Largest set that can be matched: a similarity and an index share one 32-bit word.
inline constexpr int kMaxMatchableFeatures = 8000;

// Pairs that are each other's nearest neighbour and whose nearest distance is below `max_ratio`
// times the second nearest, ordered by a. Exact and exhaustive, in integers: the same on every
// machine. Sets larger than kMaxMatchableFeatures are cut. Uses the worker pool.
std::vector<Match> MatchFeatures(const FeatureSet& a, const FeatureSet& b, float max_ratio);

// Scalar product of two descriptors, and the distance of two unit vectors that have it.
int DescriptorSimilarity(const FeatureSet& a, int index_a, const FeatureSet& b, int index_b);
float DescriptorDistance(int similarity);

}  // namespace omnihdr
