#include "core/capture/trigger_ledger.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <vector>

namespace omnihdr::trigger_ledger_test {
namespace {

using std::chrono::milliseconds;

ExposureRequest Request(std::uint64_t number, std::int64_t at_ns = 0) {
  ExposureRequest request;
  request.trigger = TriggerId{number};
  request.trigger_time = HostTime::FromNanoseconds(at_ns);
  return request;
}

HostTime At(milliseconds ms) { return HostTime::FromNanoseconds(Nanoseconds(ms).count()); }

TEST(TriggerLedger, OutcomesWaitForThoseBeforeThem) {
  TriggerLedger ledger;
  ledger.Open(Request(0), At(milliseconds(100)), true);
  ledger.OpenFailed(Request(1), FrameStatus::kMissedTrigger, "busy");
  EXPECT_FALSE(ledger.Pop());
  ledger.Resolve(TriggerId{0}, FrameStatus::kOk, "", CameraFrame{});
  EXPECT_EQ(Value(ledger.Pop()->request.trigger), 0U);
  const auto second = ledger.Pop();
  EXPECT_EQ(Value(second->request.trigger), 1U);
  EXPECT_EQ(second->status, FrameStatus::kMissedTrigger);
  EXPECT_FALSE(ledger.Pop());
}

TEST(TriggerLedger, AnOverdueFrameIsATimeoutThatSaysHowLong) {
  TriggerLedger ledger;
  ledger.Open(Request(0), At(milliseconds(100)), true);
  ledger.Expire(At(milliseconds(99)));
  EXPECT_FALSE(ledger.Pop());
  EXPECT_EQ(ledger.NextDeadline(), At(milliseconds(100)));
  ledger.Expire(At(milliseconds(100)));
  const auto outcome = ledger.Pop();
  EXPECT_EQ(outcome->status, FrameStatus::kCameraTimeout);
  EXPECT_EQ(outcome->detail, "no frame within 100 ms of the trigger");
  EXPECT_FALSE(ledger.NextDeadline());
}

TEST(TriggerLedger, TheFirstAnswerCountsAndLaterOnesAreUnknown) {
  TriggerLedger ledger;
  ledger.Open(Request(0), At(milliseconds(100)), true);
  EXPECT_EQ(ledger.Resolve(TriggerId{7}, FrameStatus::kOk, "", {}), TriggerLedger::Match::kUnknown);
  EXPECT_EQ(ledger.Resolve(TriggerId{0}, FrameStatus::kCorrupt, "torn", {}),
            TriggerLedger::Match::kMatched);
  EXPECT_EQ(ledger.Resolve(TriggerId{0}, FrameStatus::kOk, "", {}), TriggerLedger::Match::kUnknown);
  EXPECT_EQ(ledger.Pop()->status, FrameStatus::kCorrupt);
}

TEST(TriggerLedger, ALostCameraEndsAllThatIsOpen) {
  TriggerLedger ledger;
  ledger.Open(Request(0), At(milliseconds(100)), true);
  ledger.Open(Request(1), At(milliseconds(200)), true);
  EXPECT_EQ(ledger.open(), 2U);
  ledger.FailOpen(FrameStatus::kCameraTimeout, "gone");
  EXPECT_EQ(ledger.open(), 0U);
  EXPECT_EQ(ledger.Pop()->detail, "gone");
  EXPECT_EQ(ledger.Pop()->detail, "gone");
}

RC_GTEST_PROP(TriggerLedger, EveryTriggerEndsExactlyOnceAndInOrder, ()) {
  TriggerLedger ledger;
  std::uint64_t opened = 0;
  std::uint64_t popped = 0;
  std::int64_t now_ms = 0;
  const auto drain = [&] {
    while (const auto outcome = ledger.Pop()) {
      RC_ASSERT(Value(outcome->request.trigger) == popped);
      ++popped;
    }
  };
  const auto actions = *rc::gen::container<std::vector<int>>(rc::gen::inRange(0, 6));
  for (const int action : actions) {
    switch (action) {
      case 0:
      case 1:
        ledger.Open(Request(opened++), At(milliseconds(now_ms + 50)), true);
        break;
      case 2:
        ledger.OpenFailed(Request(opened++), FrameStatus::kMissedTrigger, "busy");
        break;
      case 3:
        // Answers may be early, late, repeated or for nobody.
        ledger.Resolve(TriggerId{*rc::gen::inRange<std::uint64_t>(0, opened + 2)}, FrameStatus::kOk,
                       "", CameraFrame{});
        break;
      case 4:
        now_ms += *rc::gen::inRange(0, 80);
        ledger.Expire(At(milliseconds(now_ms)));
        break;
      default:
        ledger.FailOpen(FrameStatus::kCameraTimeout, "gone");
        break;
    }
    drain();
    RC_ASSERT(popped + ledger.size() == opened);
  }
  ledger.Expire(At(milliseconds(now_ms + 1000)));
  drain();
  RC_ASSERT(popped == opened);
  RC_ASSERT(ledger.size() == 0U);
}

}  // namespace
}  // namespace omnihdr::trigger_ledger_test
