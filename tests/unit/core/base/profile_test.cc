#include "core/base/profile.h"

#include <gtest/gtest.h>

#include <chrono>
#include <ctime>
#include <optional>
#include <string_view>
#include <thread>

#include "core/base/parallel_for.h"

namespace omnihdr::profile_test {
namespace {

using std::chrono::milliseconds;

std::optional<Profile::Part> PartOf(const Profile& profile, std::string_view name) {
  for (const Profile::Part& part : profile.report().parts) {
    if (part.name == name) return part;
  }
  return std::nullopt;
}

void Rest(int ms) { std::this_thread::sleep_for(milliseconds(ms)); }

// Uses the processor for so long.
void Work(double cpu_s) {
  const auto used = [] {
    timespec now{};
    ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  };
  const double end = used() + cpu_s;
  while (used() < end) {
  }
}

TEST(Profile, WithoutARecordingNothingIsCounted) {
  const Profile profile;
  { const ProfileScope scope("a"); }
  EXPECT_TRUE(profile.report().parts.empty());
  EXPECT_EQ(ProfileScope::recording(), nullptr);
}

TEST(Profile, TimeInsideAnInnerScopeIsTheInnerScopesAlone) {
  Profile profile;
  {
    const ProfileRecording recording(profile);
    const ProfileScope outer("outer");
    Rest(20);
    {
      const ProfileScope inner("inner");
      Rest(60);
    }
    {
      const ProfileScope inner("inner");
      Rest(60);
    }
    Rest(20);
  }
  const auto outer = PartOf(profile, "outer");
  const auto inner = PartOf(profile, "inner");
  ASSERT_TRUE(outer && inner);
  EXPECT_EQ(outer->calls, 1);
  EXPECT_EQ(inner->calls, 2);
  EXPECT_GE(inner->wall_s, 0.12);
  EXPECT_GE(outer->wall_s, 0.04);
  const Profile::Report report = profile.report();
  EXPECT_LE(outer->wall_s + inner->wall_s, report.wall_s + 1e-9);
  EXPECT_EQ(report.parts.front().name, "outer") << "in the order in which they begin";
}

TEST(Profile, CpuTimeIsNotWallTimeAndCountsAllThreads) {
  Profile profile;
  {
    const ProfileRecording recording(profile);
    {
      const ProfileScope scope("rest");
      Rest(50);
    }
    {
      const ProfileScope scope("work");
      std::thread other([] { Work(0.05); });
      Work(0.05);
      other.join();
    }
  }
  EXPECT_LT(PartOf(profile, "rest")->cpu_s, 0.02);
  EXPECT_GE(PartOf(profile, "work")->cpu_s, 0.1);
}

TEST(Profile, TasksOfOneScopeAreContainedInItAndItsTimeRunsOn) {
  Profile profile;
  {
    const ProfileRecording recording(profile);
    const ProfileScope scope("write");
    ParallelFor(3, 1, [&, into = ProfileScope::recording()](int begin, int end) {
      for (int k = begin; k < end; ++k) {
        const ProfileTask task(into, "file");
        const ProfileScope inside("inside a task nothing is told apart");
        Work(0.02);
      }
    });
  }
  const auto task = PartOf(profile, "file");
  ASSERT_TRUE(task);
  EXPECT_TRUE(task->is_task);
  EXPECT_EQ(task->calls, 3);
  EXPECT_GE(task->cpu_s, 0.06);
  const auto scope = PartOf(profile, "write");
  EXPECT_FALSE(scope->is_task);
  EXPECT_GE(scope->cpu_s, 0.06);
  EXPECT_EQ(PartOf(profile, "inside a task nothing is told apart"), std::nullopt);
}

TEST(Profile, ATaskDoneWhileAnotherWaitsIsNotCountedTwice) {
  Profile profile;
  {
    const ProfileTask first(&profile, "first");
    Rest(10);
    const ProfileTask second(&profile, "second");
    Rest(300);
  }
  EXPECT_LT(PartOf(profile, "first")->wall_s, 0.25);
  EXPECT_GE(PartOf(profile, "second")->wall_s, 0.3);
}

TEST(Profile, OtherThreadsRecordNothingIntoIt) {
  Profile profile;
  {
    const ProfileRecording recording(profile);
    std::thread other([] { const ProfileScope scope("elsewhere"); });
    other.join();
  }
  EXPECT_TRUE(profile.report().parts.empty());
  EXPECT_GT(profile.report().wall_s, 0.0);
}

TEST(Profile, AScopeThatIsNotRecordedCostsNextToNothing) {
  const auto begin = std::chrono::steady_clock::now();
  for (int k = 0; k < 1'000'000; ++k) const ProfileScope scope("a");
  const double each =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count() / 1e6;
  EXPECT_LT(each, 200e-9);  // two clock readings, let alone a lock, take longer than that
}

}  // namespace
}  // namespace omnihdr::profile_test
