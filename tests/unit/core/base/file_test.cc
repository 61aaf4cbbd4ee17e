#include "core/base/file.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <fstream>

namespace omnihdr::file_test {
namespace {

class File : public testing::Test {
 protected:
  File() {
    std::string pattern = (std::filesystem::temp_directory_path() / "omnihdr-file-XXXXXX").string();
    directory_ = ::mkdtemp(pattern.data());
  }
  ~File() override {
    std::error_code ignored;
    std::filesystem::remove_all(directory_, ignored);
  }
  std::filesystem::path directory_;
};

TEST_F(File, WhatIsWrittenIsReadBack) {
  const auto path = directory_ / "a.txt";
  ASSERT_TRUE(WriteFileAtomic(path, "first"));
  ASSERT_TRUE(WriteFileAtomic(path, "second, longer"));
  EXPECT_EQ(ReadTextFile(path).value(), "second, longer");
  EXPECT_EQ(ReadFile(path).value().size(), 14U);
}

TEST_F(File, NoTemporaryFileStaysBehind) {
  ASSERT_TRUE(WriteFileAtomic(directory_ / "a.txt", "x"));
  int entries = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(directory_))
    ++entries;
  EXPECT_EQ(entries, 1);
}

TEST_F(File, AFailedWriteLeavesTheOldContent) {
  const auto path = directory_ / "a.txt";
  ASSERT_TRUE(WriteFileAtomic(path, "old"));
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit small = before;
  small.rlim_cur = 4096;
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
  const Status written = WriteFileAtomic(path, std::string(100'000, 'x'));
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, handler);
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().kind, ErrorKind::kIo);
  EXPECT_EQ(ReadTextFile(path).value(), "old");
  EXPECT_FALSE(std::filesystem::exists(directory_ / "a.txt.tmp"));
}

TEST_F(File, AMissingFileIsNamed) {
  const auto result = ReadFile(directory_ / "missing.png");
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, ErrorKind::kNoInput);
  EXPECT_NE(result.error().message.find("missing.png"), std::string::npos);
}

TEST_F(File, ADirectoryIsNotAFile) {
  const auto result = ReadFile(directory_);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, ErrorKind::kNoInput);
}

TEST_F(File, AFileLargerThanAllowedIsRefused) {
  ASSERT_TRUE(WriteFileAtomic(directory_ / "big", "12345"));
  const auto result = ReadTextFile(directory_ / "big", 4);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, ErrorKind::kData);
}

TEST_F(File, AnFdIsClosedOnce) {
  const int raw = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
  ASSERT_GE(raw, 0);
  {
    Fd first(raw);
    Fd second(std::move(first));
    EXPECT_EQ(second.get(), raw);
    EXPECT_EQ(::fcntl(raw, F_GETFD) & FD_CLOEXEC, FD_CLOEXEC);
  }
  EXPECT_EQ(::fcntl(raw, F_GETFD), -1);
}

}  // namespace
}  // namespace omnihdr::file_test
