#include "daemon/config_reload.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <regex>
#include <set>
#include <string>
#include <vector>

#include "core/base/file.h"

namespace omnihdr::config_reload_test {
namespace {

namespace fs = std::filesystem;

const fs::path kConfigFolder = fs::path(OMNIHDR_SOURCE_DIR) / "config";

// The keys that are named at the head of config/omnihdr.toml in the paragraph that begins with
// `heading`.
std::set<std::string> KeysAtTheHead(const std::string& heading) {
  const std::string text = ReadTextFile(kConfigFolder / "omnihdr.toml").value();
  std::size_t begin = text.find(heading);
  EXPECT_NE(begin, std::string::npos) << heading;
  begin = text.find('\n', begin);
  const std::size_t end = text.find("\n\n", begin);
  std::set<std::string> keys;
  const std::string list = text.substr(begin, end - begin);
  const std::regex name("[a-z_0-9]+(\\.[a-z_0-9]+)+");
  for (std::sregex_iterator it(list.begin(), list.end(), name), none; it != none; ++it) {
    keys.insert(it->str());
  }
  return keys;
}

TEST(ConfigReload, TheFilesHeadListsTheKeysThatApplyAtOnce) {
  std::set<std::string> live;
  for (const std::string& key : ConfigKeyNames()) {
    if (ConfigKeyApplies(key) == Applies::kLive) live.insert(key);
  }
  EXPECT_EQ(KeysAtTheHead("These keys apply at once"), live);
}

TEST(ConfigReload, EveryDifferenceIsFoundWithBothValuesAndWhenItApplies) {
  const DaemonConfig before;
  DaemonConfig after = before;
  after.log.level = LogLevel::kDebug;
  after.recorder.queue_frames = 3;
  const std::vector<ConfigChange> changes = CompareConfig(before, after);
  ASSERT_EQ(changes.size(), 2U);
  EXPECT_EQ(changes[0].key, "recorder.queue_frames");
  EXPECT_EQ(changes[0].old_value, "8");
  EXPECT_EQ(changes[0].new_value, "3");
  EXPECT_EQ(changes[0].applies, Applies::kRestart);
  EXPECT_EQ(changes[1].key, "log.level");
  EXPECT_EQ(changes[1].old_value, "\"info\"");
  EXPECT_EQ(changes[1].new_value, "\"debug\"");
  EXPECT_EQ(changes[1].applies, Applies::kLive);
  EXPECT_TRUE(CompareConfig(before, before).empty());
}

TEST(ConfigReload, AKeyIsAdoptedAndNoOtherIsTouched) {
  for (const char* file : {"demo.toml", "thesis.toml"}) {
    const DaemonConfig from = ConfigOrError(LoadConfig(kConfigFolder / file)).value();
    DaemonConfig config;
    std::vector<ConfigChange> left = CompareConfig(config, from);
    ASSERT_FALSE(left.empty());
    while (!left.empty()) {
      const std::string key = left.front().key;
      ASSERT_TRUE(AdoptConfigKey(config, from, key)) << key;
      const std::vector<ConfigChange> rest = CompareConfig(config, from);
      EXPECT_EQ(rest.size(), left.size() - 1) << key;
      left = rest;
    }
  }
  DaemonConfig config;
  EXPECT_FALSE(AdoptConfigKey(config, config, "no.such_key"));
}

}  // namespace
}  // namespace omnihdr::config_reload_test
