#include "daemon/api/http.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace omnihdr::http_test {
namespace {

using ::testing::HasSubstr;

HttpReader Read(std::string_view text, std::size_t piece = 100'000) {
  HttpReader reader;
  for (std::size_t at = 0; at < text.size(); at += piece) reader.Take(text.substr(at, piece));
  return reader;
}

int Refusal(std::string_view text) {
  const HttpReader reader = Read(text);
  return reader.state() == HttpReader::State::kRefused ? reader.status() : 0;
}

TEST(HttpReader, ARequestComesOutTheSameHoweverItIsCut) {
  const std::string text =
      "POST /v1/stop HTTP/1.1\r\nHost: x\r\nauthorization:  Bearer abc \r\nAccept: text/html\r\n"
      "Content-Length: 5\r\n\r\nhello";
  for (std::size_t piece = 1; piece <= text.size(); ++piece) {
    const HttpReader reader = Read(text, piece);
    ASSERT_EQ(reader.state(), HttpReader::State::kComplete) << piece;
    EXPECT_EQ(reader.request().method, "POST");
    EXPECT_EQ(reader.request().target, "/v1/stop");
    EXPECT_EQ(reader.request().authorization, "Bearer abc");
    EXPECT_EQ(reader.request().accept, "text/html");
    EXPECT_EQ(reader.request().body, "hello");
    EXPECT_TRUE(reader.request().chunks);
  }
  for (std::size_t size = 0; size < text.size(); ++size) {
    EXPECT_EQ(Read(text.substr(0, size)).state(), HttpReader::State::kNeedMore) << size;
  }
  EXPECT_FALSE(Read("GET / HTTP/1.0\r\n\r\n").request().chunks);
}

TEST(HttpReader, BytesBehindARequestAreRefusedHoweverTheyAreCut) {
  const std::string request = "POST /v1/stop HTTP/1.1\r\nContent-Length: 1\r\n\r\nx";
  const std::string text = request + "{}";
  for (std::size_t piece = 1; piece <= text.size(); ++piece) {
    EXPECT_EQ(Read(text, piece).status(), 400) << piece;
  }
  HttpReader reader = Read(request);
  EXPECT_EQ(reader.Take(""), HttpReader::State::kComplete);
  EXPECT_EQ(reader.Take("{"), HttpReader::State::kRefused);
}

TEST(HttpReader, WhatTwoReadersCouldTakeForTwoThingsIsRefused) {
  const std::string post = "POST / HTTP/1.1\r\n";
  EXPECT_EQ(Refusal(post + "Content-Length: 1\r\nContent-Length: 2\r\n\r\nx"), 400);
  EXPECT_EQ(Refusal(post + "Content-Length: +1\r\n\r\nx"), 400);
  EXPECT_EQ(Refusal(post + "Content-Length: -1\r\n\r\nx"), 400);
  EXPECT_EQ(Refusal(post + "Content-Length: 1, 1\r\n\r\nx"), 400);
  EXPECT_EQ(Refusal(post + "Content-Length: 0x1\r\n\r\nx"), 400);
  EXPECT_EQ(Refusal(post + "Content-Length:\r\n\r\n"), 400);
  EXPECT_EQ(Refusal(post + "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n"), 501);
  EXPECT_EQ(Refusal(post + "tRANSFER-eNCODING : chunked\r\n\r\n"), 400);
  EXPECT_EQ(Refusal(post + "Content-Length: 1\r\n\r\nxGET /v1/status HTTP/1.1\r\n\r\n"), 400);
  EXPECT_EQ(Refusal("GET / HTTP/1.1\nHost: x\n\n"), 400);
  EXPECT_EQ(Refusal("GET / HTTP/1.1\r\nA: b\r\n folded\r\n\r\n"), 400);
  EXPECT_EQ(Refusal("GET / HTTP/1.1\r\nAuthorization: a\r\nAuthorization: b\r\n\r\n"), 400);
  EXPECT_EQ(Refusal(std::string("GET / HTTP/1.1\r\nA: b\0c\r\n\r\n", 26)), 400);
  EXPECT_EQ(Refusal("GET / HTTP/1.1\r\nExpect: 100-continue\r\n\r\n"), 417);
}

TEST(HttpReader, EveryLimitIsRefusedWithItsOwnStatus) {
  EXPECT_EQ(Refusal("GET /" + std::string(300, 'a') + " HTTP/1.1\r\n\r\n"), 414);
  EXPECT_EQ(Refusal("GET / HTTP/1.1\r\nA: " + std::string(9000, 'a') + "\r\n\r\n"), 431);
  std::string headers = "GET / HTTP/1.1\r\n";
  for (int i = 0; i < 65; ++i) headers += "A: b\r\n";
  EXPECT_EQ(Refusal(headers), 431);
  EXPECT_EQ(Refusal("POST / HTTP/1.1\r\nContent-Length: 4097\r\n\r\n"), 413);
  EXPECT_EQ(Refusal("POST / HTTP/1.1\r\nContent-Length: 99999999999999999999999\r\n\r\n"), 413);
  EXPECT_EQ(Refusal("GET / HTTP/2.0\r\n\r\n"), 505);
  // A line that never ends is noticed before it does.
  EXPECT_EQ(Refusal(std::string(8193, 'x')), 431);
}

TEST(HttpReader, ATargetIsAPathOfVisibleCharactersAndIsNotDecoded) {
  EXPECT_EQ(Refusal("GET v1/status HTTP/1.1\r\n\r\n"), 400);
  EXPECT_EQ(Refusal("GET http://x/ HTTP/1.1\r\n\r\n"), 400);
  EXPECT_EQ(Refusal("GET /\xC3\xA9 HTTP/1.1\r\n\r\n"), 400);
  EXPECT_EQ(Refusal("GET  / HTTP/1.1\r\n\r\n"), 400);
  EXPECT_EQ(Refusal("G(T / HTTP/1.1\r\n\r\n"), 400);
  EXPECT_EQ(Read("GET /%2e%2e/../etc/passwd HTTP/1.1\r\n\r\n").request().target,
            "/%2e%2e/../etc/passwd");
}

}  // namespace
}  // namespace omnihdr::http_test
