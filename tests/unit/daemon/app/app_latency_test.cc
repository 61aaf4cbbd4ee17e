#include <gtest/gtest.h>

#include "tests/unit/daemon/app/app_fixture.h"

namespace omnihdr::app_latency_test {
namespace {

class AppLatency : public testing_app::AppFixture {};

TEST_F(AppLatency, EveryStageOfADriveIsTimed) {
  Start();
  ASSERT_TRUE(InState("armed"));
  EXPECT_TRUE(Client().Get("/v1/status").value()["last_frame_age_s"].is_null());
  Trigger(3);
  ASSERT_TRUE(
      StatusHolds([](const auto& s) { return s["latency"]["trigger_to_view"]["count"] == 3; }));
  const nlohmann::json status = Client().Get("/v1/status").value();
  for (const char* stage : {"edge_to_command", "command_to_frame", "frame_to_durable", "view_pose",
                            "view_stereo", "view_merge", "view_write"}) {
    EXPECT_EQ(status["latency"][stage]["count"], 3) << stage;
    EXPECT_GE(status["latency"][stage]["mean_s"].get<double>(), 0.0) << stage;
    EXPECT_LT(status["latency"][stage]["mean_s"].get<double>(), 60.0) << stage;
  }
  EXPECT_GE(status["last_frame_age_s"].get<double>(), 0.0);
}

}  // namespace
}  // namespace omnihdr::app_latency_test
