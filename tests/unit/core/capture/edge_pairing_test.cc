#include "core/capture/edge_pairing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>

namespace omnihdr::edge_pairing_test {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

HostTime At(std::int64_t ms) { return HostTime::FromNanoseconds(ms * 1'000'000); }

struct Wire {
  void Edge(std::uint64_t number, std::int64_t ms) {
    pairing.AddEdge(TriggerId{number}, At(ms), At(ms));
  }
  EdgePairing pairing{milliseconds(10)};
};

TEST(EdgePairing, AFrameBelongsToTheEdgeAtWhichItsExposureBegan) {
  Wire wire;
  for (std::uint64_t i = 0; i < 5; ++i) wire.Edge(i, 100 * static_cast<std::int64_t>(i));
  const auto match = wire.pairing.Take(At(204), milliseconds(1));
  ASSERT_TRUE(match);
  EXPECT_EQ(match->trigger, TriggerId{2});
  EXPECT_EQ(match->off, milliseconds(4));
  EXPECT_THAT(match->passed, ElementsAre(TriggerId{0}, TriggerId{1}));
  EXPECT_EQ(wire.pairing.size(), 2U);
}

TEST(EdgePairing, AFrameFarFromEveryEdgeHasNoneAndCostsNone) {
  Wire wire;
  wire.Edge(0, 0);
  wire.Edge(1, 100);
  EXPECT_FALSE(wire.pairing.Take(At(50), milliseconds(1)));
  EXPECT_EQ(wire.pairing.size(), 2U);
  EXPECT_EQ(wire.pairing.Take(At(50), milliseconds(45))->trigger, TriggerId{0})
      << "what its time may be off counts";
}

TEST(EdgePairing, AnEdgeStartsOneFrameAtMost) {
  Wire wire;
  wire.Edge(0, 0);
  EXPECT_THAT(wire.pairing.Take(At(1), milliseconds(0))->passed, IsEmpty());
  EXPECT_FALSE(wire.pairing.Take(At(1), milliseconds(0)));
}

TEST(EdgePairing, AnEdgeThatWasLostHasTheFrameThatLiesInItsSpanAndNoStampedEdgesFrame) {
  Wire wire;
  wire.Edge(0, 0);
  wire.pairing.AddEdge(TriggerId{1}, At(0), At(200));
  wire.Edge(2, 200);
  EXPECT_EQ(wire.pairing.Take(At(1), milliseconds(0))->trigger, TriggerId{0});
  EXPECT_EQ(wire.pairing.Take(At(100), milliseconds(0))->trigger, TriggerId{1});
  EXPECT_EQ(wire.pairing.Take(At(199), milliseconds(0))->trigger, TriggerId{2});
}

TEST(EdgePairing, EdgesThatNobodyAsksForAreForgotten) {
  Wire wire;
  for (std::uint64_t i = 0; i < 2 * EdgePairing::kMostEdges; ++i) {
    wire.Edge(i, static_cast<std::int64_t>(i));
  }
  EXPECT_EQ(wire.pairing.size(), EdgePairing::kMostEdges);
}

}  // namespace
}  // namespace omnihdr::edge_pairing_test
