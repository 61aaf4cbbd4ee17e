#include "core/pose/matching.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/base/parallel_for.h"

namespace omnihdr::matching_test {
namespace {

FeatureSet RandomSet(int count, std::mt19937& random) {
  FeatureSet set;
  set.features.resize(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) {
    double norm = 0.0;
    std::array<double, kDescriptorLength> values;
    for (double& value : values) {
      value = static_cast<double>(random() % 1000);
      value *= value;
      norm += value * value;
    }
    for (const double value : values) {
      set.descriptors.push_back(
          static_cast<std::int16_t>(std::min(255.0, value / std::sqrt(norm) * kDescriptorNorm)));
    }
  }
  return set;
}

// What the header says, in the plainest way.
std::vector<Match> Reference(const FeatureSet& a, const FeatureSet& b, float max_ratio) {
  const auto dot = [&](int i, int j) {
    int sum = 0;
    for (int k = 0; k < kDescriptorLength; ++k) {
      sum += a.descriptors[static_cast<std::size_t>(i * kDescriptorLength + k)] *
             b.descriptors[static_cast<std::size_t>(j * kDescriptorLength + k)];
    }
    return sum;
  };
  std::vector<Match> matches;
  for (int i = 0; i < a.size(); ++i) {
    int best = -1;
    int top = -1;
    int next = -1;
    for (int j = 0; j < b.size(); ++j) {
      const int d = dot(i, j);
      if (d >= top) {
        next = top;
        top = d;
        best = j;
      } else {
        next = std::max(next, d);
      }
    }
    int back = -1;
    int back_top = -1;
    for (int k = 0; k < a.size(); ++k) {
      if (const int d = dot(k, best); d >= back_top) {
        back_top = d;
        back = k;
      }
    }
    const double square = kDescriptorNorm * kDescriptorNorm;
    const double ratio = std::sqrt(std::max(1e-6, 2.0 - 2.0 * top / square)) /
                         std::sqrt(std::max(1e-6, 2.0 - 2.0 * next / square));
    if (back == i && ratio < static_cast<double>(max_ratio)) {
      matches.push_back({i, best, static_cast<float>(ratio)});
    }
  }
  return matches;
}

// Copies some of a's descriptors into b, a little changed.
void Plant(const FeatureSet& a, FeatureSet* b, int count, std::mt19937& random) {
  for (int i = 0; i < count; ++i) {
    for (int k = 0; k < kDescriptorLength; ++k) {
      const int value = a.descriptors[static_cast<std::size_t>(i * 2 * kDescriptorLength + k)];
      b->descriptors[static_cast<std::size_t>(i * 3 * kDescriptorLength + k)] =
          static_cast<std::int16_t>(std::clamp(value + static_cast<int>(random() % 9) - 4, 0, 255));
    }
  }
}

TEST(Matching, FindsWhatAPlainSearchFindsWhateverTheSizes) {
  std::mt19937 random(7);
  for (const auto& [rows, columns] :
       {std::pair(1, 2), std::pair(61, 97), std::pair(515, 130), std::pair(600, 333)}) {
    const FeatureSet a = RandomSet(rows, random);
    FeatureSet b = RandomSet(columns, random);
    Plant(a, &b, std::min(rows / 2, columns / 3), random);
    const auto expected = Reference(a, b, 0.9F);
    const auto got = MatchFeatures(a, b, 0.9F);
    ASSERT_EQ(got.size(), expected.size()) << rows << "x" << columns;
    for (std::size_t i = 0; i < got.size(); ++i) {
      EXPECT_EQ(got[i].a, expected[i].a);
      EXPECT_EQ(got[i].b, expected[i].b);
      EXPECT_NEAR(got[i].ratio, expected[i].ratio, 1e-4F);
    }
    EXPECT_GE(got.size(), rows > 60 ? 10U : 0U);
  }
}

TEST(Matching, TheNumberOfWorkersDoesNotShow) {
  std::mt19937 random(8);
  const FeatureSet a = RandomSet(2100, random);
  FeatureSet b = RandomSet(1900, random);
  Plant(a, &b, 600, random);
  SetWorkerCount(1);
  const auto one = MatchFeatures(a, b, 0.9F);
  SetWorkerCount(4);
  const auto four = MatchFeatures(a, b, 0.9F);
  SetWorkerCount(0);
  ASSERT_EQ(one.size(), four.size());
  EXPECT_GT(one.size(), 500U);
  for (std::size_t i = 0; i < one.size(); ++i) {
    EXPECT_EQ(one[i].a, four[i].a);
    EXPECT_EQ(one[i].b, four[i].b);
  }
}

TEST(Matching, NothingMatchesAnEmptySet) {
  std::mt19937 random(9);
  const FeatureSet some = RandomSet(10, random);
  EXPECT_TRUE(MatchFeatures({}, some, 0.9F).empty());
  EXPECT_TRUE(MatchFeatures(some, {}, 0.9F).empty());
  EXPECT_TRUE(MatchFeatures(some, RandomSet(1, random), 0.9F).empty());  // no second best: no ratio
}

}  // namespace
}  // namespace omnihdr::matching_test
