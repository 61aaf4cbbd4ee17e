// Cutting the stream into frames, and the camera's clock.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "drivers/iidc/camera_clock.h"
#include "drivers/iidc/frame_assembler.h"
#include "drivers/iidc/frame_info.h"

namespace omnihdr::stream_test {
namespace {

using iidc::CameraClock;
using iidc::FrameAssembler;
using iidc::RawFrame;
using iidc::StreamChunk;

StreamChunk Chunk(std::size_t bytes, int value, bool ended_short) {
  StreamChunk chunk;
  chunk.bytes.assign(bytes, static_cast<std::byte>(value));
  chunk.ended_short = ended_short;
  return chunk;
}

TEST(FrameAssembler, AFrameCutIntoTransfersOfAnySizeIsWholeAgain) {
  constexpr std::size_t kFrame = 1000;
  for (std::size_t transfer = 1; transfer < 1200; ++transfer) {
    if (kFrame % transfer == 0) continue;  // no short transfer would end it
    FrameAssembler assembler(kFrame, true);
    std::vector<RawFrame> frames;
    for (int number = 1; number <= 2; ++number) {
      for (std::size_t at = 0; at < kFrame; at += transfer) {
        const std::size_t bytes = std::min(transfer, kFrame - at);
        for (RawFrame& frame : assembler.Add(Chunk(bytes, number, bytes < transfer))) {
          frames.push_back(std::move(frame));
        }
      }
    }
    ASSERT_EQ(frames.size(), 2U) << transfer;
    EXPECT_FALSE(frames[1].torn);
    EXPECT_EQ(frames[1].bytes, std::vector<std::byte>(kFrame, std::byte{2}));
  }
}

TEST(FrameAssembler, AShortPacketBeforeTheEndTearsOneFrameAndTheNextIsGood) {
  FrameAssembler assembler(1000, true);
  const auto torn = assembler.Add(Chunk(300, 1, true));
  ASSERT_EQ(torn.size(), 1U);
  EXPECT_TRUE(torn[0].torn);
  EXPECT_EQ(torn[0].detail, "300 of 1000 bytes");
  const auto good = assembler.Add(Chunk(1000, 2, true));
  ASSERT_EQ(good.size(), 1U);
  EXPECT_FALSE(good[0].torn);
}

TEST(FrameAssembler, AnEmptyPacketWhereAFrameWasDueIsATornFrame) {
  FrameAssembler assembler(1000, true);
  const auto frames = assembler.Add(Chunk(0, 0, true));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_TRUE(frames[0].torn);
}

TEST(FrameAssembler, BytesBehindTheEndTearTheFrame) {
  FrameAssembler assembler(1000, true);
  EXPECT_TRUE(assembler.Add(Chunk(600, 1, false)).empty());
  const auto frames = assembler.Add(Chunk(500, 1, true));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].detail, "100 bytes more than the 1000 of a frame");
  EXPECT_EQ(frames[0].bytes.size(), 1000U);
}

TEST(FrameAssembler, AfterAGapOrAFailedTransferTheNextShortPacketBeginsAnew) {
  FrameAssembler assembler(1000, true);
  StreamChunk gap = Chunk(400, 1, false);
  gap.gap = true;
  EXPECT_TRUE(assembler.Add(gap).empty());
  auto frames = assembler.Add(Chunk(100, 1, true));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_TRUE(frames[0].torn);
  EXPECT_TRUE(frames[0].bytes.empty());
  StreamChunk failed = Chunk(400, 2, true);
  failed.error = "the endpoint stalled";
  EXPECT_TRUE(assembler.Add(failed).empty());
  frames = assembler.Add(Chunk(600, 2, true));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].detail, "the endpoint stalled");
  frames = assembler.Add(Chunk(1000, 3, true));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_FALSE(frames[0].torn);
}

TEST(FrameAssembler, FramesWithoutAVisibleEndAreCutByLengthAndAnEmptyPacketIsTheirMark) {
  FrameAssembler assembler(1000, false);
  auto frames = assembler.Add(Chunk(1000, 1, false));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_TRUE(assembler.Add(Chunk(0, 0, true)).empty());
  frames = assembler.Add(Chunk(2500, 2, false));
  EXPECT_EQ(frames.size(), 2U);
  EXPECT_TRUE(assembler.in_step());
  StreamChunk gap = Chunk(100, 3, false);
  gap.gap = true;
  frames = assembler.Add(gap);
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_TRUE(frames[0].torn);
  EXPECT_FALSE(assembler.in_step());
}

TEST(FrameAssembler, BytesOfTwoFramesAreNeverInOneWhateverIsLost) {
  std::mt19937 random(3);
  constexpr std::size_t kPacket = 64;
  constexpr std::size_t kFrame = 10 * kPacket + 7;
  for (int round = 0; round < 300; ++round) {
    FrameAssembler assembler(kFrame, true);
    for (int number = 1; number < 20; ++number) {
      std::size_t left = kFrame;
      while (left > 0) {
        const std::size_t bytes = std::min(left, kPacket);
        left -= bytes;
        // A packet in the middle may be lost; the short one that ends a frame is what is relied on.
        if (bytes == kPacket && random() % 20 == 0) continue;
        for (const RawFrame& frame : assembler.Add(Chunk(bytes, number, bytes < kPacket))) {
          EXPECT_LE(frame.bytes.size(), kFrame);
          for (const std::byte value : frame.bytes) ASSERT_EQ(value, std::byte(number));
          EXPECT_EQ(frame.torn, frame.bytes.size() != kFrame);
        }
      }
    }
  }
}

TEST(CameraClock, TimeGoesOnWhereTheCyclesWrap) {
  CameraClock clock;
  const HostTime start = HostTime::FromNanoseconds(5'000'000'000);
  const CameraTime first = clock.Unwrap(127'000'000'000, start);
  const CameraTime second = clock.Unwrap(1'000'000'000, start + std::chrono::seconds(2));
  EXPECT_EQ((second - first).count(), 2'000'000'000);
  // Several whole turns without a frame.
  const CameraTime third = clock.Unwrap(2'000'000'000, start + std::chrono::seconds(2 + 1 + 384));
  EXPECT_EQ((third - second).count(), 385'000'000'000);
}

TEST(CameraClock, TheErrorStaysWithinTheUncertaintyWhileTheClocksDrift) {
  std::mt19937 random(11);
  for (const double ppm : {-150.0, 0.0, 150.0}) {
    CameraClock clock;
    const auto host_of = [ppm](std::int64_t camera_ns) {
      return HostTime::FromNanoseconds(
          40'000'000'000 +
          static_cast<std::int64_t>(static_cast<double>(camera_ns) * (1.0 + ppm * 1e-6)));
    };
    for (std::int64_t camera = 0; camera < 600'000'000'000; camera += 700'000'000) {
      const HostTime truth = host_of(camera);
      const auto before = Nanoseconds(random() % 3'000'000);
      const auto after = Nanoseconds(random() % 60'000'000);
      clock.Add(CameraTime::FromNanoseconds(camera), truth - before, truth + after);
      const CameraTime now = CameraTime::FromNanoseconds(camera);
      const std::optional<HostTime> told = clock.ToHost(now);
      ASSERT_TRUE(told);
      const std::int64_t error = std::abs((*told - truth).count());
      EXPECT_LE(error, clock.uncertainty(now).count() + 1);
    }
    EXPECT_LT(clock.uncertainty(CameraTime::FromNanoseconds(599'900'000'000)),
              std::chrono::milliseconds(3));
  }
}

TEST(CameraClock, AClockThatWasSetAnewBeginsANewFitOnceThreeFramesAgree) {
  CameraClock clock;
  const auto add = [&clock](std::int64_t camera, std::int64_t host) {
    clock.Add(CameraTime::FromNanoseconds(camera), HostTime::FromNanoseconds(host),
              HostTime::FromNanoseconds(host + 10));
  };
  add(1000, 2000);
  for (const std::int64_t camera : {1100, 1200}) {
    add(camera, 9'000'000 + camera);
    EXPECT_FALSE(clock.ToHost(CameraTime::FromNanoseconds(camera)));
  }
  EXPECT_EQ(clock.jumps(), 0U);
  add(1300, 9'001'300);
  EXPECT_EQ(clock.ToHost(CameraTime::FromNanoseconds(1300)), HostTime::FromNanoseconds(9'001'305));
  EXPECT_EQ(clock.jumps(), 1U);
  EXPECT_EQ(clock.outliers(), 0U);
}

TEST(CameraClock, AFrameThatContradictsTheOthersIsAnOutlierAndChangesNothing) {
  CameraClock clock;
  const auto add = [&clock](std::int64_t camera, std::int64_t host) {
    clock.Add(CameraTime::FromNanoseconds(camera), HostTime::FromNanoseconds(host),
              HostTime::FromNanoseconds(host + 10));
  };
  add(1000, 2000);
  add(2000, 3000);
  add(3000, 70'000);   // stamped far too late
  add(4000, 500'000);  // and so is this, by another amount
  add(5000, 6000);
  EXPECT_EQ(clock.ToHost(CameraTime::FromNanoseconds(5000)), HostTime::FromNanoseconds(6005));
  EXPECT_EQ(clock.outliers(), 2U);
  EXPECT_EQ(clock.jumps(), 0U);
}

}  // namespace
}  // namespace omnihdr::stream_test
