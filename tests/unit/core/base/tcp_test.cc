#include "core/base/tcp.h"

#include <gtest/gtest.h>
#include <sys/socket.h>

#include <chrono>

namespace omnihdr::tcp_test {
namespace {

TEST(Tcp, AConnectionGoesThroughByNumericAddress) {
  const Result<Fd> listener = ListenTcp("127.0.0.1", 0);
  ASSERT_TRUE(listener) << listener.error().message;
  ASSERT_GT(LocalPort(listener->get()), 0);
  const Result<Fd> client =
      ConnectTcp("127.0.0.1", LocalPort(listener->get()), std::chrono::seconds(2));
  ASSERT_TRUE(client) << client.error().message;
}

TEST(Tcp, ANameIsRefusedForItsLookUpHasNoDeadline) {
  EXPECT_FALSE(IsNumericAddress("localhost"));
  EXPECT_TRUE(IsNumericAddress("192.0.2.1"));
  EXPECT_TRUE(IsNumericAddress("::1"));
  EXPECT_EQ(ConnectTcp("localhost", 1, std::chrono::seconds(1)).error().kind, ErrorKind::kConfig);
  EXPECT_EQ(ListenTcp("localhost", 0).error().kind, ErrorKind::kConfig);
}

TEST(Tcp, NobodyListeningIsToldWithTheAddress) {
  Result<Fd> listener = ListenTcp("127.0.0.1", 0);
  ASSERT_TRUE(listener);
  const int port = LocalPort(listener->get());
  listener->Close();
  const Result<Fd> client = ConnectTcp("127.0.0.1", port, std::chrono::seconds(2));
  ASSERT_FALSE(client);
  EXPECT_EQ(client.error().message,
            "connect to 127.0.0.1:" + std::to_string(port) + ": Connection refused");
}

}  // namespace
}  // namespace omnihdr::tcp_test
