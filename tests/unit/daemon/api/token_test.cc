#include "daemon/api/token.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>

namespace omnihdr::token_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Token : public testing::Test {
 protected:
  Token() {
    std::string pattern = (fs::temp_directory_path() / "omnihdr-token-XXXXXX").string();
    directory_ = ::mkdtemp(pattern.data());
  }
  ~Token() override {
    std::error_code ignored;
    fs::remove_all(directory_, ignored);
  }
  fs::path File(const std::string& text, mode_t mode, const std::string& name = "token") {
    const fs::path file = directory_ / name;
    std::ofstream(file) << text;
    EXPECT_EQ(::chmod(file.c_str(), mode), 0);
    return file;
  }
  fs::path directory_;
};

constexpr const char* kGood = "0123456789abcdef";

TEST_F(Token, AFileThatOnlyItsOwnerReadsHoldsTheToken) {
  EXPECT_EQ(ReadToken(File("0123456789abcdef\n", 0600), false).value(), kGood);
  EXPECT_EQ(ReadToken(File(kGood, 0400), false).value(), kGood);
}

TEST_F(Token, AFileThatOthersReadIsRefused) {
  for (const mode_t mode : {0640, 0604, 0620, 0602, 0610}) {
    const auto token = ReadToken(File(kGood, mode), false);
    ASSERT_FALSE(token) << mode;
    EXPECT_EQ(token.error().kind, ErrorKind::kPermission);
    EXPECT_THAT(token.error().message, HasSubstr("chmod 600"));
  }
  // The service manager hands credentials over by an access list, which shows as the group's.
  EXPECT_TRUE(ReadToken(File(kGood, 0440), true));
  EXPECT_FALSE(ReadToken(File(kGood, 0444), true));
}

TEST_F(Token, WhatIsNoTokenIsRefused) {
  for (const std::string& text :
       {std::string("short"), std::string("with a space in it"), std::string(513, 'a'),
        std::string("0123456789abcdef\n\n"), std::string("0123456789abcde\0", 16)}) {
    EXPECT_FALSE(ReadToken(File(text, 0600), false)) << text;
  }
  EXPECT_FALSE(ReadToken(directory_, false));
  EXPECT_FALSE(ReadToken(directory_ / "missing", false));
}

TEST_F(Token, WithoutAFileTheServicesCredentialCounts) {
  ::setenv("CREDENTIALS_DIRECTORY", directory_.c_str(), 1);
  EXPECT_EQ(FindToken("").error().kind, ErrorKind::kConfig);
  File("credential-of-the-unit", 0400, "api-token");
  EXPECT_EQ(FindToken("").value(), "credential-of-the-unit");
  EXPECT_EQ(FindToken(File(kGood, 0600).string()).value(), kGood);
  ::unsetenv("CREDENTIALS_DIRECTORY");
  EXPECT_FALSE(FindToken(""));
}

TEST_F(Token, OnlyTheWholeTokenIsTheToken) {
  EXPECT_TRUE(SameToken(kGood, kGood));
  for (const char* wrong : {"", "0", "0123456789abcde", "0123456789abcdeg", "1123456789abcdef",
                            "0123456789abcdef0", "0123456789abcdef0123456789abcdef"}) {
    EXPECT_FALSE(SameToken(wrong, kGood)) << wrong;
  }
  EXPECT_FALSE(SameToken("", ""));
}

}  // namespace
}  // namespace omnihdr::token_test
