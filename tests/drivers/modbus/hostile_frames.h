#pragma once

#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <random>
#include <span>
#include <vector>

#include "drivers/modbus/responder.h"

namespace omnihdr::testing_modbus {

using Bytes = std::vector<std::uint8_t>;

inline Bytes WithCrc(Bytes frame) {
  const std::uint16_t crc = modbus::Crc16(frame);
  frame.push_back(static_cast<std::uint8_t>(crc & 0xFF));
  frame.push_back(static_cast<std::uint8_t>(crc >> 8));
  return frame;
}

// What comes over a serial line and is no request to unit 1 that may do anything: cut short, with
// wrong checksums, contradicting themselves, for others, or no frames at all.
inline std::vector<Bytes> HostileRequests() {
  std::vector<Bytes> all = {
      {1},
      {1, 3, 0, 0, 0},
      {1, 3, 0, 0, 0, 2, 0xDE, 0xAD},
      WithCrc({1, 3, 0, 0, 0, 0}),                    // no registers
      WithCrc({1, 3, 0, 0, 0xFF, 0xFF}),              // more than an answer holds
      WithCrc({1, 4, 0xFF, 0xFF, 0, 2}),              // beyond the last address
      WithCrc({1, 0}),                                // functions that there are not
      WithCrc({1, 0x2B, 0x0E, 1, 0}),                 //
      WithCrc({1, 0x83, 2}),                          // an answer of our own
      WithCrc({1, 5, 0, 0, 0x12, 0x34}),              // a coil that is neither on nor off
      WithCrc({1, 6, 0, 5, 0, 1}),                    // a register that cannot be written
      WithCrc({1, 15, 0, 0, 0, 2, 9, 3}),             // eight bytes fewer than it says
      WithCrc({1, 16, 0, 100, 0, 1, 4, 0, 1, 0, 1}),  // two registers where it says one
      WithCrc({0, 3, 0, 0, 0, 2}),                    // a read of all units
      WithCrc({9, 5, 0, 0, 0xFF, 0}),                 // another unit's command
      WithCrc({9, 3, 4, 1, 5, 0, 0}),                 // and what looks like one in its answer
      Bytes(256, 0xFF),
      Bytes(600, 0x01),
  };
  Bytes longest = {1, 16, 0, 100, 0, 127, 255};
  longest.resize(7 + 255, 1);
  all.push_back(WithCrc(longest));
  std::mt19937 random(20260301);
  for (int i = 0; i < 8; ++i) {
    Bytes noise(1 + random() % 500);
    for (std::uint8_t& byte : noise) byte = static_cast<std::uint8_t>(random());
    all.push_back(noise);
  }
  return all;
}

// What comes within `patience` and until the line is silent for `gap`.
inline Bytes ReadUntilSilent(int fd, std::chrono::milliseconds patience,
                             std::chrono::milliseconds gap = std::chrono::milliseconds(100)) {
  Bytes all;
  auto wait = patience;
  while (true) {
    pollfd ready{fd, POLLIN, 0};
    if (poll(&ready, 1, static_cast<int>(wait.count())) <= 0) return all;
    std::array<std::uint8_t, 256> some{};
    const ssize_t got = read(fd, some.data(), some.size());
    if (got <= 0) return all;
    all.insert(all.end(), some.begin(), some.begin() + got);
    wait = gap;
  }
}

inline void WriteAll(int fd, std::span<const std::uint8_t> bytes) {
  while (!bytes.empty()) {
    pollfd ready{fd, POLLOUT, 0};
    ASSERT_EQ(poll(&ready, 1, 10'000), 1);
    const ssize_t written = write(fd, bytes.data(), bytes.size());
    ASSERT_GT(written, 0);
    bytes = bytes.subspan(static_cast<std::size_t>(written));
  }
}

// `line` is the other end of a status server's serial line, whose unit is 1: after each of the
// hostile requests the next good one is answered, whole and with the right checksum.
inline void ExpectServesBetweenHostileRequests(int line) {
  const Bytes request = WithCrc({1, 3, 0, 0, 0, 1});
  const Bytes expected = WithCrc({1, 3, 2, 0, modbus::kMapVersion});
  int number = 0;
  for (const Bytes& hostile : HostileRequests()) {
    ASSERT_NO_FATAL_FAILURE(WriteAll(line, hostile));
    ReadUntilSilent(line, std::chrono::milliseconds(100));
    ASSERT_NO_FATAL_FAILURE(WriteAll(line, request));
    EXPECT_EQ(ReadUntilSilent(line, std::chrono::seconds(10)), expected) << number;
    ++number;
  }
  // Right behind one that was cut short, too.
  ASSERT_NO_FATAL_FAILURE(WriteAll(line, Bytes{1, 3, 0, 0, 0}));
  ASSERT_NO_FATAL_FAILURE(WriteAll(line, request));
  EXPECT_EQ(ReadUntilSilent(line, std::chrono::seconds(10)), expected);
}

// Answers to a request for two holding registers of unit 1 that are none.
inline std::vector<Bytes> HostileAnswers() {
  Bytes flood(2000, 0x55);
  return {
      {},
      {1, 3, 4, 0, 0},
      {1, 3, 4, 0, 0, 0, 7, 0xDE, 0xAD},
      WithCrc({2, 3, 4, 0, 0, 0, 7}),        // another unit's
      WithCrc({1, 4, 4, 0, 0, 0, 7}),        // of another function
      WithCrc({1, 3, 2, 0, 7}),              // half of what was asked for
      WithCrc({1, 3, 6, 0, 0, 0, 7, 0, 7}),  // more
      WithCrc({1, 3, 0}),
      WithCrc({1, 0x83, 0xFF}),  // an exception that there is not
      WithCrc({1, 0x84, 2}),
      flood,
  };
}

}  // namespace omnihdr::testing_modbus
