#include "daemon/retention.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <ctime>
#include <filesystem>
#include <fstream>

#include "daemon/session_choice.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::retention_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr std::int64_t kDay = 86'400;

class RetentionTest : public ::testing::Test {
 protected:
  // A session of `bytes` in its views that ended so many days ago; fewer than 0 = it has not ended.
  void MakeSession(const std::string& name, double days_ago, std::size_t bytes = 100'000) {
    const fs::path session = root() / name;
    fs::create_directories(session / "views" / "000000");
    fs::create_directories(session / "raw");
    std::ofstream(session / "session.json") << "{}";
    std::ofstream(session / "frames.jsonl") << "";
    std::ofstream(session / "views" / "000000" / "radiance.exr") << std::string(bytes, 'x');
    if (days_ago < 0) return;
    const fs::path ended = session / "ended.json";
    std::ofstream(ended.string()) << "{}";
    const auto seconds = kNow - static_cast<std::int64_t>(days_ago * kDay);
    const timespec times[2] = {{seconds, 0}, {seconds, 0}};
    ASSERT_EQ(::utimensat(AT_FDCWD, ended.c_str(), times, 0), 0);
  }
  std::vector<std::string> Plan(const RetentionOptions& options,
                                const std::vector<fs::path>& keep = {}) {
    plan_ = PlanRetention(root(), options, UtcTime::FromNanoseconds(kNow * 1'000'000'000), keep)
                .value();
    std::vector<std::string> paths;
    for (const Deletion& deletion : plan_) {
      paths.push_back(fs::relative(deletion.path, root()).string());
    }
    return paths;
  }
  fs::path root() const { return directory_.path(); }

  static constexpr std::int64_t kNow = 1'900'000'000;
  std::vector<Deletion> plan_;

 private:
  testing::TemporaryDirectory directory_;
};

TEST_F(RetentionTest, NothingIsDeletedUnlessAsked) {
  MakeSession("a", 1000);
  EXPECT_THAT(Plan({}), ElementsAre());
  EXPECT_THAT(Plan({Retention::kNothing, 1.0, 0.00001}), ElementsAre());
  EXPECT_THAT(Plan({Retention::kSessions, 0.0, 0.0}), ElementsAre());
}

TEST_F(RetentionTest, ByAgeOnlyWhatHasEndedGoesOldestFirst) {
  MakeSession("young", 1);
  MakeSession("old", 31);
  MakeSession("older", 60);
  MakeSession("open", -1);
  MakeSession("in use", 90);
  fs::create_directories(root() / "something else" / "views");
  EXPECT_THAT(Plan({Retention::kViews, 30.0, 0.0}, {root() / "in use"}),
              ElementsAre("older/views", "old/views"));
  EXPECT_THAT(plan_[0].why, HasSubstr("ended 60.0 days ago, storage.retention_days is 30"));
  EXPECT_THAT(Plan({Retention::kSessions, 30.0, 0.0}, {root() / "in use"}),
              ElementsAre("older", "old"));
}

TEST_F(RetentionTest, BySizeNoMoreGoesThanNeeded) {
  MakeSession("a", 3, 400'000);
  MakeSession("b", 2, 400'000);
  MakeSession("c", 1, 400'000);
  EXPECT_THAT(Plan({Retention::kViews, 0.0, 0.0009}), ElementsAre("a/views"));
  EXPECT_THAT(plan_[0].why, HasSubstr("storage.retention_gb is 0.0009"));
  EXPECT_THAT(Plan({Retention::kViews, 0.0, 0.0005}), ElementsAre("a/views", "b/views"));
  EXPECT_THAT(Plan({Retention::kViews, 0.0, 0.002}), ElementsAre());
}

TEST_F(RetentionTest, DeletedViewsLeaveTheSessionAndLinksAreNotFollowed) {
  MakeSession("a", 10);
  fs::create_directories(root() / "b");
  fs::create_directory_symlink(root() / "a", root() / "link");
  ASSERT_THAT(Plan({Retention::kViews, 1.0, 0.0}), ElementsAre("a/views"));
  ASSERT_TRUE(Delete(plan_[0]));
  EXPECT_FALSE(fs::exists(root() / "a" / "views"));
  EXPECT_TRUE(HoldsSession(root() / "a"));
  EXPECT_TRUE(fs::exists(root() / "a" / "frames.jsonl"));
  EXPECT_THAT(Plan({Retention::kViews, 1.0, 0.0}), ElementsAre());
  ASSERT_THAT(Plan({Retention::kSessions, 1.0, 0.0}), ElementsAre("a"));
  ASSERT_TRUE(Delete(plan_[0]));
  EXPECT_FALSE(fs::exists(root() / "a"));
}

}  // namespace
}  // namespace omnihdr::retention_test
