#include "core/pipeline/position_set.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <set>
#include <vector>

namespace omnihdr::position_set_test {
namespace {

std::vector<std::int64_t> All(const PositionSet& set) {
  std::vector<std::int64_t> all;
  set.ForEach([&](std::int64_t position) {
    all.push_back(position);
    return true;
  });
  return all;
}

TEST(PositionSet, ItIsTheSetThatItsInsertionsAndErasuresMake) {
  std::mt19937 random(7);
  PositionSet set;
  std::set<std::int64_t> truth;
  for (int i = 0; i < 4000; ++i) {
    const auto position = static_cast<std::int64_t>(random() % 60);
    if (random() % 3 == 0) {
      set.Erase(position);
      truth.erase(position);
    } else {
      set.Insert(position);
      truth.insert(position);
    }
    ASSERT_EQ(set.size(), truth.size());
    for (std::int64_t p = -1; p <= 60; ++p) ASSERT_EQ(set.Covers(p), truth.contains(p)) << p;
  }
  EXPECT_THAT(All(set), ::testing::ElementsAreArray(truth));
}

TEST(PositionSet, ASurveyOfAnyLengthWhoseLostPositionsAreSettledIsOneRun) {
  PositionSet set;
  for (std::int64_t position = 0; position < 100'000; ++position) {
    if (position % 7 == 3) {
      set.Settle(position);
    } else {
      set.Insert(position);
    }
  }
  EXPECT_EQ(set.runs(), 1U);
  EXPECT_EQ(set.size(), 85'714U);
}

TEST(PositionSet, AWalkThroughItCanBeEnded) {
  PositionSet set;
  for (std::int64_t position = 0; position < 10; ++position) set.Insert(position);
  int seen = 0;
  set.ForEach([&](std::int64_t) { return ++seen < 3; });
  EXPECT_EQ(seen, 3);
}

}  // namespace
}  // namespace omnihdr::position_set_test
