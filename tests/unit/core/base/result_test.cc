#include "core/base/result.h"

#include <gtest/gtest.h>

#include <cerrno>
#include <memory>

namespace omnihdr::result_test {
namespace {

Result<int> Half(int value) {
  if (value % 2 != 0) return Fail(ErrorKind::kData, "{} is odd", value);
  return value / 2;
}

Result<int> Quarter(int value) {
  OMNIHDR_ASSIGN(const int half, Half(value));
  return Half(half).Context("second half");
}

Status BothEven(int a, int b) {
  OMNIHDR_TRY(Half(a));
  OMNIHDR_TRY(Half(b));
  return {};
}

TEST(Result, AnErrorTellsTheWayItCame) {
  const Result<int> result = Quarter(6).Context("quarter of 6");
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().message, "quarter of 6: second half: 3 is odd");
  EXPECT_EQ(result.error().kind, ErrorKind::kData);
}

TEST(Result, ContextLeavesAValueAlone) {
  const Result<int> result = Quarter(8).Context("quarter of 8");
  ASSERT_TRUE(result);
  EXPECT_EQ(*result, 2);
}

TEST(Result, TryReturnsTheFirstErrorOnly) {
  EXPECT_TRUE(BothEven(2, 4));
  const Status status = BothEven(3, 5);
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().message, "3 is odd");
}

TEST(Result, AssignMovesValuesThatCannotBeCopied) {
  const auto make = []() -> Result<std::unique_ptr<int>> { return std::make_unique<int>(7); };
  const auto use = [&]() -> Result<int> {
    OMNIHDR_ASSIGN(const std::unique_ptr<int> value, make());
    return *value;
  };
  EXPECT_EQ(use().value(), 7);
}

TEST(Result, ForwardKeepsTheKindAndPutsTheActivityInFront) {
  const Error error = Forward(Error{ErrorKind::kConfig, "line 3"}, "reading a.toml").value();
  EXPECT_EQ(error.message, "reading a.toml: line 3");
  EXPECT_EQ(error.kind, ErrorKind::kConfig);
}

TEST(Result, AnErrnoBecomesItsText) {
  const Status status = FailErrno(ErrorKind::kIo, "disk", ENOSPC);
  EXPECT_EQ(status.error().message, "disk: No space left on device");
}

TEST(Result, ExitCodesAreThoseOfSysexits) {
  EXPECT_EQ(ExitCode(ErrorKind::kUsage), 64);
  EXPECT_EQ(ExitCode(ErrorKind::kData), 65);
  EXPECT_EQ(ExitCode(ErrorKind::kNoInput), 66);
  EXPECT_EQ(ExitCode(ErrorKind::kUnavailable), 69);
  EXPECT_EQ(ExitCode(ErrorKind::kSoftware), 70);
  EXPECT_EQ(ExitCode(ErrorKind::kSystem), 71);
  EXPECT_EQ(ExitCode(ErrorKind::kCannotCreate), 73);
  EXPECT_EQ(ExitCode(ErrorKind::kIo), 74);
  EXPECT_EQ(ExitCode(ErrorKind::kTemporary), 75);
  EXPECT_EQ(ExitCode(ErrorKind::kProtocol), 76);
  EXPECT_EQ(ExitCode(ErrorKind::kPermission), 77);
  EXPECT_EQ(ExitCode(ErrorKind::kConfig), 78);
}

}  // namespace
}  // namespace omnihdr::result_test
