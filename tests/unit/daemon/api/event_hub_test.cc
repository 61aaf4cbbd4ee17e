#include "daemon/api/event_hub.h"

#include <gtest/gtest.h>

namespace omnihdr::event_hub_test {
namespace {

constexpr Nanoseconds kNow{0};

TEST(EventHub, EveryListenerHearsEveryEvent) {
  EventHub hub(2, 4);
  const auto first = hub.Subscribe();
  const auto second = hub.Subscribe();
  hub.Publish({{"event", "frame"}, {"frame", 3}});
  EXPECT_EQ(first->Next(kNow), R"({"event":"frame","frame":3})");
  EXPECT_EQ(second->Next(kNow), R"({"event":"frame","frame":3})");
  EXPECT_EQ(first->Next(kNow), std::nullopt);
}

TEST(EventHub, ASlowListenerLosesTheOldestAndIsToldHowMany) {
  EventHub hub(1, 2);
  const auto slow = hub.Subscribe();
  for (int i = 0; i < 5; ++i) hub.Publish({{"event", "n"}, {"i", i}});
  EXPECT_EQ(slow->Next(kNow), R"({"event":"lost","count":3})");
  EXPECT_EQ(slow->Next(kNow), R"({"event":"n","i":3})");
  EXPECT_EQ(slow->Next(kNow), R"({"event":"n","i":4})");
  EXPECT_EQ(slow->Next(kNow), std::nullopt);
}

TEST(EventHub, ListenersAreLimitedAndTheirPlacesReused) {
  EventHub hub(1, 2);
  auto first = hub.Subscribe();
  EXPECT_EQ(hub.Subscribe(), nullptr);
  first.reset();
  EXPECT_NE(hub.Subscribe(), nullptr);
}

TEST(EventHub, TextThatIsNotUtf8IsMadeSo) {
  EventHub hub(1, 2);
  const auto listener = hub.Subscribe();
  hub.Publish({{"event", "n"}, {"text", "a\xff"}});
  EXPECT_EQ(listener->Next(kNow), "{\"event\":\"n\",\"text\":\"a\xEF\xBF\xBD\"}");
}

TEST(EventHub, AClosedHubEndsItsListeners) {
  EventHub hub(1, 2);
  const auto listener = hub.Subscribe();
  hub.Close();
  EXPECT_EQ(listener->Next(std::chrono::seconds(30)), std::nullopt);
  EXPECT_TRUE(listener->closed());
  EXPECT_EQ(hub.Subscribe(), nullptr);
}

}  // namespace
}  // namespace omnihdr::event_hub_test
