#include "core/session/toml.h"

#include <gtest/gtest.h>

#include <map>

namespace omnihdr::toml_test {
namespace {

TEST(Toml, TheTablesOfAnArrayAreCountedAndKeepTheirLines) {
  const TomlDocument document = ParseToml(
      "a = 1\n"
      "[[sensor]]\n"
      "name = \"x\"\n"
      "[sensor.grid]\n"
      "points = [1, nan]\n"
      "\n"
      "[[sensor]]\n"
      "name = \"y\"\n");
  ASSERT_EQ(document.error, "");
  std::map<std::string, std::pair<int, std::string>> seen;
  for (const TomlEntry& entry : document.entries) {
    seen[entry.key] = {entry.line, entry.value ? ShownToml(*entry.value) : "heading"};
  }
  const std::map<std::string, std::pair<int, std::string>> expected = {
      {"a", {1, "1"}},
      {"sensor[0]", {2, "heading"}},
      {"sensor[0].name", {3, "\"x\""}},
      {"sensor[0].grid", {4, "heading"}},
      {"sensor[0].grid.points", {5, "[1, nan]"}},
      {"sensor[1]", {7, "heading"}},
      {"sensor[1].name", {8, "\"y\""}},
  };
  EXPECT_EQ(seen, expected);
}

TEST(Toml, AnArrayOfOtherThingsIsAValue) {
  const TomlDocument document = ParseToml("empty = []\nmixed = [{a = 1}, 2]\n");
  ASSERT_EQ(document.error, "");
  ASSERT_EQ(document.entries.size(), 2U);
  EXPECT_EQ(document.entries[0].value->items.size(), 0U);
  EXPECT_EQ(ShownToml(*document.entries[1].value), "[a section, 2]");
}

TEST(Toml, TablesNestedTooDeepAreAValueThatNobodyExpects) {
  const std::string text = "[[a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a]]\nb = 1\n";
  const TomlDocument document = ParseToml(text);
  ASSERT_EQ(document.error, "");
  ASSERT_FALSE(document.entries.empty());
  ASSERT_TRUE(document.entries.back().value);
  EXPECT_EQ(document.entries.back().value->text, "sections nested too deep");
}

TEST(Toml, ATextOverTheLimitIsRefused) {
  const std::string text(101, '#');
  EXPECT_EQ(ParseToml(text, 101).error, "");
  EXPECT_EQ(ParseToml(text, 100).error, "101 bytes, expected at most 100");
}

}  // namespace
}  // namespace omnihdr::toml_test
