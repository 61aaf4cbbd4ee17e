#include "drivers/modbus/responder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <vector>

namespace omnihdr::responder_test {
namespace {

using namespace omnihdr::modbus;  // NOLINT(google-build-using-namespace)
using ::testing::ElementsAre;
using Bytes = std::vector<std::uint8_t>;

Bytes Ask(Responder& responder, const Bytes& request) {
  std::array<std::uint8_t, kMaxPdu> answer{};
  const std::size_t length = responder.Answer(request, answer);
  return {answer.begin(), answer.begin() + static_cast<std::ptrdiff_t>(length)};
}

ApplianceStatus Driving() {
  ApplianceStatus status;
  status.state = CaptureState::kArmed;
  status.armed = true;
  status.camera_ready = true;
  status.uptime_s = 70000.0;
  status.triggers = 0x12345678;
  status.minutes_left = 95.7;
  status.storage_level = StorageLevel::kWarning;
  status.storage_free_bytes = 0x1'0001ULL * 1'000'000 + 7;
  status.odometer_m = -1.5;
  status.last_fault = "disk é full";
  return status;
}

struct Asked {
  std::vector<ApplianceCommand> commands;
  Status answer;
  CommandHandler Handler() {
    return [this](ApplianceCommand command) {
      commands.push_back(command);
      return answer;
    };
  }
};

TEST(ModbusResponder, TheStatusStandsInTheDocumentedRegistersOfBothTables) {
  Responder responder({});
  responder.Show(Driving());
  for (const std::uint8_t function : {3, 4}) {
    EXPECT_THAT(Ask(responder, {function, 0, 0, 0, 6}),
                ElementsAre(function, 12, 0, 1, 0, 3, 0, 0b11 | 1 << 5, 0x11, 0x70, 0x12, 0x34,
                            0x56, 0x78));
    EXPECT_THAT(Ask(responder, {function, 0, 14, 0, 4}),
                ElementsAre(function, 8, 0, 95, 0, 0, 0xFF, 0xFF, 0xFA, 0x24));
    EXPECT_THAT(Ask(responder, {function, 0, 21, 0, 3}),
                ElementsAre(function, 6, 0, 1, 0, 1, 0, 1));
    EXPECT_THAT(
        Ask(responder, {function, 0, 32, 0, 6}),
        ElementsAre(function, 12, 'd', 'i', 's', 'k', ' ', '?', '?', ' ', 'f', 'u', 'l', 'l'));
  }
  EXPECT_THAT(Ask(responder, {2, 0, 0, 0, 8}), ElementsAre(2, 1, 0b00100011));
  EXPECT_THAT(Ask(responder, {1, 0, 0, 0, 2}), ElementsAre(1, 1, 0b01));
}

TEST(ModbusResponder, WhatIsNotKnownHasItsOwnValue) {
  Responder responder({});
  responder.Show(ApplianceStatus{});
  EXPECT_THAT(Ask(responder, {3, 0, 14, 0, 1}), ElementsAre(3, 2, 0xFF, 0xFF));
  EXPECT_THAT(Ask(responder, {3, 0, 16, 0, 2}), ElementsAre(3, 4, 0x80, 0, 0, 0));
}

TEST(ModbusResponder, CommandsComeByCoilsAndByTheCommandRegister) {
  Asked asked;
  Responder responder(asked.Handler());
  responder.Show(Driving());
  EXPECT_THAT(Ask(responder, {5, 0, 0, 0xFF, 0}), ElementsAre(5, 0, 0, 0xFF, 0));
  EXPECT_THAT(Ask(responder, {5, 0, 0, 0, 0}), ElementsAre(5, 0, 0, 0, 0));
  EXPECT_THAT(Ask(responder, {5, 0, 1, 0xFF, 0}), ElementsAre(5, 0, 1, 0xFF, 0));
  EXPECT_THAT(Ask(responder, {5, 0, 1, 0, 0}), ElementsAre(5, 0, 1, 0, 0));  // nothing to do
  EXPECT_THAT(Ask(responder, {15, 0, 0, 0, 2, 1, 0b11}), ElementsAre(15, 0, 0, 0, 2));
  EXPECT_THAT(Ask(responder, {6, 0, 100, 0, 2}), ElementsAre(6, 0, 100, 0, 2));
  EXPECT_THAT(Ask(responder, {16, 0, 100, 0, 1, 2, 0, 3}), ElementsAre(16, 0, 100, 0, 1));
  using enum ApplianceCommand;
  EXPECT_THAT(asked.commands,
              ElementsAre(kArm, kDisarm, kTrigger, kArm, kTrigger, kDisarm, kTrigger));
  EXPECT_THAT(Ask(responder, {3, 0, 18, 0, 3}), ElementsAre(3, 6, 0, 0, 0, 7, 0, kDone));
  EXPECT_THAT(Ask(responder, {3, 0, 100, 0, 1}), ElementsAre(3, 2, 0, 3));
}

TEST(ModbusResponder, ACommandThatIsRefusedIsAnExceptionAndStandsInTheResult) {
  Asked asked;
  asked.answer = Fail(ErrorKind::kUnavailable, "the session has ended");
  Responder responder(asked.Handler());
  EXPECT_THAT(Ask(responder, {5, 0, 0, 0xFF, 0}), ElementsAre(0x85, 4));
  EXPECT_THAT(Ask(responder, {3, 0, 20, 0, 1}), ElementsAre(3, 2, 0, kRefused));
  asked.answer = Fail(ErrorKind::kTemporary, "busy");
  EXPECT_THAT(Ask(responder, {6, 0, 100, 0, 3}), ElementsAre(0x86, 6));
}

TEST(ModbusResponder, WithoutControlNothingCanBeWritten) {
  Responder responder({});
  EXPECT_THAT(Ask(responder, {5, 0, 0, 0xFF, 0}), ElementsAre(0x85, 1));
  EXPECT_THAT(Ask(responder, {16, 0, 100, 0, 1, 2, 0, 3}), ElementsAre(0x90, 1));
}

TEST(ModbusResponder, RequestsThatMakeNoSenseAreRefusedAndDoNothing) {
  Asked asked;
  Responder responder(asked.Handler());
  const auto refused = [&](const Bytes& request, int code) {
    EXPECT_THAT(Ask(responder, request),
                ElementsAre(static_cast<std::uint8_t>(request[0] | 0x80), code))
        << ::testing::PrintToString(request);
  };
  refused({0x2B, 14, 1, 0}, 1);           // no such function
  refused({0}, 1);                        //
  refused({3}, 3);                        // too short
  refused({3, 0, 0, 0, 1, 0}, 3);         // too long
  refused({3, 0, 0, 0, 0}, 3);            // no registers
  refused({3, 0, 0, 0, 126}, 3);          // more than there may be
  refused({3, 0, 60, 0, 5}, 2);           // over the end
  refused({3, 0xFF, 0xFF, 0, 2}, 2);      //
  refused({4, 0, 101, 0, 1}, 2);          //
  refused({2, 0, 0, 0xFF, 0xFF}, 3);      // more bits than there may be
  refused({1, 0, 0, 0, 3}, 2);            //
  refused({5, 0, 0, 0, 1}, 3);            // neither on nor off
  refused({5, 0, 2, 0xFF, 0}, 2);         //
  refused({6, 0, 0, 0, 1}, 2);            // a status register
  refused({6, 0, 100, 0, 4}, 3);          // no such command
  refused({15, 0, 0, 0, 2, 2, 3, 0}, 3);  // another number of bytes than of bits
  refused({15, 0, 1, 0, 2, 1, 3}, 2);     //
  refused({15, 0, 0, 0, 1, 255}, 3);      // bytes that are not there
  refused({16, 0, 100, 0, 1, 4, 0, 1, 0, 1}, 3);
  refused({16, 0, 100, 0, 2, 4, 0, 1, 0, 1}, 2);
  EXPECT_TRUE(asked.commands.empty());
}

RC_GTEST_PROP(ModbusResponderProperty, AnyBytesGetAnAnswerAndOneThatIsRefusedChangesNothing, ()) {
  Asked asked;
  Responder responder(asked.Handler());
  Bytes request = *rc::gen::container<Bytes>(rc::gen::arbitrary<std::uint8_t>());
  if (request.empty()) request.push_back(0);
  if (request.size() > kMaxPdu) request.resize(kMaxPdu);
  if (*rc::gen::arbitrary<bool>())
    request[0] = *rc::gen::element<std::uint8_t>(1, 2, 3, 4, 5, 6, 15, 16);
  const Bytes answer = Ask(responder, request);
  RC_ASSERT(answer.size() >= 2U);
  RC_ASSERT((answer[0] & 0x7F) == (request[0] & 0x7F));
  if (answer[0] != request[0]) RC_ASSERT(asked.commands.empty());
}

Bytes Rtu(Bytes frame) {
  const std::uint16_t crc = Crc16(frame);
  frame.push_back(static_cast<std::uint8_t>(crc & 0xFF));
  frame.push_back(static_cast<std::uint8_t>(crc >> 8));
  return frame;
}

TEST(ModbusRtuFramer, TheChecksumIsThatOfTheSpecification) {
  EXPECT_THAT(Rtu({2, 7}), ElementsAre(2, 7, 0x41, 0x12));
}

TEST(ModbusRtuFramer, ARequestIsFoundAmongOthersAndNoiseHoweverItIsCut) {
  Bytes line = Rtu({9, 3, 0, 0, 0, 2});                   // another unit's request,
  const Bytes other_answer = Rtu({9, 3, 4, 1, 2, 3, 4});  // its answer,
  line.insert(line.end(), other_answer.begin(), other_answer.end());
  line.insert(line.end(), {1, 3, 0xFF});                   // noise,
  const Bytes mine = Rtu({1, 16, 0, 100, 0, 1, 2, 0, 3});  // and what is ours
  line.insert(line.end(), mine.begin(), mine.end());
  for (std::size_t chunk = 1; chunk <= line.size(); ++chunk) {
    RtuFramer framer(1);
    int found = 0;
    for (std::size_t at = 0; at < line.size(); at += chunk) {
      const std::size_t size = std::min(chunk, line.size() - at);
      if (const auto frame = framer.Take(std::span(line).subspan(at, size))) {
        ++found;
        EXPECT_EQ(frame->unit, 1);
        EXPECT_THAT(frame->pdu, ElementsAre(16, 0, 100, 0, 1, 2, 0, 3));
      }
    }
    EXPECT_EQ(found, 1) << "in pieces of " << chunk;
  }
}

TEST(ModbusRtuFramer, ADamagedFrameIsNoneAndSilenceBeginsAnew) {
  RtuFramer framer(1);
  Bytes damaged = Rtu({1, 3, 0, 0, 0, 1});
  damaged[3] ^= 1;
  EXPECT_FALSE(framer.Take(damaged));
  EXPECT_FALSE(framer.empty());
  framer.Silence();
  EXPECT_TRUE(framer.Take(Rtu({1, 3, 0, 0, 0, 1})));
}

RC_GTEST_PROP(ModbusTcpFramerProperty, RequestsComeOutWholeHoweverTheStreamIsCut, ()) {
  const auto pdus = *rc::gen::container<std::vector<Bytes>>(
      rc::gen::suchThat(rc::gen::container<Bytes>(rc::gen::arbitrary<std::uint8_t>()),
                        [](const Bytes& pdu) { return !pdu.empty() && pdu.size() <= kMaxPdu; }));
  Bytes stream;
  for (std::size_t i = 0; i < pdus.size(); ++i) {
    stream.insert(stream.end(), {static_cast<std::uint8_t>(i >> 8), static_cast<std::uint8_t>(i), 0,
                                 0, 0, static_cast<std::uint8_t>(pdus[i].size() + 1), 1});
    stream.insert(stream.end(), pdus[i].begin(), pdus[i].end());
  }
  TcpFramer framer;
  std::size_t found = 0;
  for (std::size_t at = 0; at < stream.size();) {
    const std::span<std::uint8_t> room = framer.Room();
    RC_ASSERT(!room.empty());
    const auto most = std::min(room.size(), stream.size() - at);
    const auto size = *rc::gen::inRange<std::size_t>(1, most + 1);
    std::copy_n(stream.begin() + static_cast<std::ptrdiff_t>(at), size, room.begin());
    framer.Filled(size);
    at += size;
    TcpFramer::Frame frame;
    while (framer.Next(frame) == TcpFramer::State::kFrame) {
      RC_ASSERT(found < pdus.size());
      RC_ASSERT(frame.transaction == found);
      RC_ASSERT(Bytes(frame.pdu.begin(), frame.pdu.end()) == pdus[found]);
      ++found;
    }
  }
  RC_ASSERT(found == pdus.size());
}

TEST(ModbusTcpFramer, WhatIsNoModbusIsKnownFromItsBeginning) {
  const auto state = [](const Bytes& bytes) {
    TcpFramer framer;
    std::copy(bytes.begin(), bytes.end(), framer.Room().begin());
    framer.Filled(bytes.size());
    TcpFramer::Frame frame;
    return framer.Next(frame);
  };
  EXPECT_EQ(state({'G', 'E', 'T', ' '}), TcpFramer::State::kBroken);
  EXPECT_EQ(state({0, 1, 0, 0, 0, 0}), TcpFramer::State::kBroken);
  EXPECT_EQ(state({0, 1, 0, 0, 0, 1}), TcpFramer::State::kBroken);
  EXPECT_EQ(state({0, 1, 0, 0, 1, 0}), TcpFramer::State::kBroken);
  EXPECT_EQ(state({0, 1, 0, 0, 0, 6, 1, 3}), TcpFramer::State::kNeedMore);
}

}  // namespace
}  // namespace omnihdr::responder_test
