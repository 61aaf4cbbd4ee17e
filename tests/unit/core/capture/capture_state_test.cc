#include "core/capture/capture_state.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace omnihdr::capture_state_test {
namespace {

CaptureConditions Ready() {
  CaptureConditions c;
  c.started = true;
  c.camera_ready = true;
  c.armed = true;
  return c;
}

// State and reason; what to do is text for people.
std::pair<CaptureState, std::string> Told(const CaptureConditions& c) {
  const StateReport report = EvaluateState(c);
  EXPECT_FALSE(report.reason.empty());
  EXPECT_FALSE(report.remedy.empty());
  return {report.state, report.reason};
}

TEST(CaptureState, TheGravestConditionNamesTheState) {
  CaptureConditions c = Ready();
  EXPECT_EQ(EvaluateState(c).state, CaptureState::kArmed);
  c.capturing = true;
  EXPECT_EQ(EvaluateState(c).state, CaptureState::kCapturing);
  c.frames_lost = "2 of 16 lost";
  EXPECT_EQ(Told(c),
            (std::pair<CaptureState, std::string>{CaptureState::kDegraded, "2 of 16 lost"}));
  c.views_stalled = "views: disk full";
  EXPECT_EQ(EvaluateState(c).reason, "2 of 16 lost; views: disk full");
  c.armed = false;
  EXPECT_EQ(Told(c), (std::pair<CaptureState, std::string>{CaptureState::kIdle, "disarmed"}));
  c.camera_ready = false;
  c.waiting = "no such device";
  EXPECT_EQ(Told(c), (std::pair<CaptureState, std::string>{CaptureState::kWaitingForCamera,
                                                           "no such device"}));
  c.storage = "no space";
  EXPECT_EQ(Told(c),
            (std::pair<CaptureState, std::string>{CaptureState::kStorageFull, "no space"}));
  c.fault = "broken";
  EXPECT_EQ(Told(c), (std::pair<CaptureState, std::string>{CaptureState::kFault, "broken"}));
  c.stopping = "asked to";
  EXPECT_EQ(Told(c), (std::pair<CaptureState, std::string>{CaptureState::kStopping, "asked to"}));
}

TEST(CaptureState, AConnectionThatIsMissingDegradesAndEveryReasonIsTold) {
  CaptureConditions c = Ready();
  c.links = "modbus vehicle: no answer";
  EXPECT_EQ(Told(c), (std::pair<CaptureState, std::string>{CaptureState::kDegraded,
                                                           "modbus vehicle: no answer"}));
  c.frames_lost = "2 lost";
  EXPECT_EQ(EvaluateState(c).reason, "2 lost; modbus vehicle: no answer");
}

TEST(CaptureState, EveryStateHasAReasonAndSaysWhatToDo) {
  for (const bool started : {false, true}) {
    for (const bool camera : {false, true}) {
      for (const bool armed : {false, true}) {
        CaptureConditions c;
        c.started = started;
        c.camera_ready = camera;
        c.armed = armed;
        Told(c);
      }
    }
  }
}

TEST(CaptureState, EveryConditionThatDegradesBringsItsRemedy) {
  CaptureConditions c = Ready();
  c.views_stalled = "views: disk full";
  const std::string views = EvaluateState(c).remedy;
  c.links = "gnss: no answer";
  EXPECT_EQ(EvaluateState(c).remedy.substr(0, views.size() + 2), views + "; ");
  EXPECT_GT(EvaluateState(c).remedy.size(), views.size() + 2);
}

TEST(CaptureState, AStateIsLeftWhenItsConditionIsGone) {
  CaptureConditions c = Ready();
  c.storage = "no space";
  EXPECT_EQ(EvaluateState(c).state, CaptureState::kStorageFull);
  c.storage.clear();
  EXPECT_EQ(EvaluateState(c).state, CaptureState::kArmed);
}

TEST(CaptureState, TheListenerHearsChangesOnly) {
  std::vector<CaptureState> heard;
  CaptureStateMachine machine([&](const StateReport& report) { heard.push_back(report.state); });
  machine.Update([](CaptureConditions& c) { c = Ready(); });
  machine.Update([](CaptureConditions& c) { c.armed = true; });
  machine.Update([](CaptureConditions& c) { c.armed = false; });
  EXPECT_EQ(heard, (std::vector{CaptureState::kArmed, CaptureState::kIdle}));
  EXPECT_EQ(machine.report().state, CaptureState::kIdle);
}

}  // namespace
}  // namespace omnihdr::capture_state_test
