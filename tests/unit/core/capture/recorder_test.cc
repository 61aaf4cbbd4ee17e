#include "core/capture/recorder.h"

#include <gtest/gtest.h>

#include <thread>

#include "core/image/image_io.h"
#include "tests/unit/core/capture/simulated.h"

namespace omnihdr::recorder_test {
namespace {

constexpr Nanoseconds kNow{0};

// A journal in memory with a disk that can be full for pixels, or for everything.
class FakeStore final : public FrameStore {
 public:
  Status Append(const FrameRecord& record, std::span<const std::byte> bytes) override {
    if (lines_fail) return Fail(ErrorKind::kIo, "journal: no space");
    if (record.truth_json == "nonsense") return Fail(ErrorKind::kSoftware, "truth: not JSON");
    if (pixels_fail && !bytes.empty()) {
      FrameRecord line = record;
      line.status = FrameStatus::kDiskFull;
      records.push_back(line);
      return Fail(ErrorKind::kIo, "pixels: no space");
    }
    records.push_back(record);
    files.emplace_back(bytes.begin(), bytes.end());
    return {};
  }
  std::uint64_t lines() const override { return records.size(); }

  bool pixels_fail = false;
  bool lines_fail = false;
  std::vector<FrameRecord> records;
  std::vector<std::vector<std::byte>> files;
};

CaptureLine Line(std::uint64_t number, bool pixels) {
  CaptureLine line;
  line.record.frame = FrameId{number};
  if (pixels) {
    line.pixels = Image<std::uint8_t>(8, 4, 3, static_cast<std::uint8_t>(number));
    line.holds_buffer = true;
  } else {
    line.record.status = FrameStatus::kMissedTrigger;
  }
  return line;
}

struct Bench {
  explicit Bench(RecorderOptions options = {.buffers = 2, .max_waiting_lines = 4})
      : recorder(options,
                 RecorderEvents{
                     .journaled = [this](const FrameRecord& r) { journaled.push_back(r); },
                     .storage_failed = [this](const Error& e) { failures.push_back(e.message); },
                     .storage_recovered = [this] { ++recoveries; }}) {}
  void Give(std::uint64_t number, bool pixels) {
    ASSERT_TRUE(recorder.TryReserveLine());
    ASSERT_TRUE(!pixels || recorder.TryReserveBuffer());
    recorder.Submit(Line(number, pixels));
  }
  FakeStore store;
  std::vector<FrameRecord> journaled;
  std::vector<std::string> failures;
  int recoveries = 0;
  Recorder recorder;
};

TEST(Recorder, PixelsBecomeAPngThatReadsBackTheSame) {
  Bench bench;
  bench.Give(7, true);
  EXPECT_EQ(bench.recorder.Step(bench.store, kNow), Recorder::Turn::kStored);
  ASSERT_EQ(bench.store.records.size(), 1U);
  EXPECT_EQ(bench.store.records[0].file, "raw/000007.png");
  const DecodedImage image = DecodeImage(bench.store.files[0], "frame").value();
  EXPECT_EQ(std::get<Image<std::uint8_t>>(image.pixels).at(3, 2, 1), 7);
  EXPECT_EQ(bench.journaled.size(), 1U);
  EXPECT_EQ(bench.recorder.free_buffers(), 2U);
  EXPECT_EQ(bench.recorder.reserved_lines(), 0U);
}

TEST(Recorder, SixteenBitPixelsKeepTheirBits) {
  Bench bench;
  ASSERT_TRUE(bench.recorder.TryReserveLine());
  CaptureLine line = Line(0, false);
  line.record.status = FrameStatus::kOk;
  line.pixels = Image<std::uint16_t>(3, 2, 1, 4095);
  bench.recorder.Submit(std::move(line));
  bench.recorder.Step(bench.store, kNow);
  const DecodedImage image = DecodeImage(bench.store.files[0], "frame").value();
  ASSERT_TRUE(image.is_16_bit());
  EXPECT_EQ(std::get<Image<std::uint16_t>>(image.pixels).at(2, 1), 4095);
}

TEST(Recorder, ALineWithoutPixelsHasNoFile) {
  Bench bench;
  bench.Give(0, false);
  bench.recorder.Step(bench.store, kNow);
  EXPECT_TRUE(bench.store.records[0].file.empty());
  EXPECT_TRUE(bench.store.files[0].empty());
  EXPECT_EQ(bench.recorder.Step(bench.store, kNow), Recorder::Turn::kIdle);
}

TEST(Recorder, BuffersAndLinesAreAFixedPool) {
  Bench bench;
  EXPECT_TRUE(bench.recorder.TryReserveBuffer());
  EXPECT_TRUE(bench.recorder.TryReserveBuffer());
  EXPECT_FALSE(bench.recorder.TryReserveBuffer());
  bench.recorder.ReleaseBuffer();
  EXPECT_TRUE(bench.recorder.TryReserveBuffer());
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(bench.recorder.TryReserveLine());
  EXPECT_FALSE(bench.recorder.TryReserveLine());
}

TEST(Recorder, PixelsThatDoNotFitLeaveADiskFullLine) {
  Bench bench;
  bench.store.pixels_fail = true;
  bench.Give(0, true);
  EXPECT_EQ(bench.recorder.Step(bench.store, kNow), Recorder::Turn::kStored);
  ASSERT_EQ(bench.journaled.size(), 1U);
  EXPECT_EQ(bench.journaled[0].status, FrameStatus::kDiskFull);
  EXPECT_EQ(bench.journaled[0].detail, "pixels: no space");
  EXPECT_EQ(bench.failures, (std::vector<std::string>{"pixels: no space"}));
  EXPECT_EQ(bench.recorder.free_buffers(), 2U);
}

TEST(Recorder, OnlyStoredPixelsEndTheAlarmOfLostPixels) {
  Bench bench;
  bench.store.pixels_fail = true;
  bench.Give(0, true);
  bench.recorder.Step(bench.store, kNow);
  bench.store.pixels_fail = false;
  bench.Give(1, false);
  bench.recorder.Step(bench.store, kNow);
  EXPECT_EQ(bench.recoveries, 0);
  bench.Give(2, true);
  bench.recorder.Step(bench.store, kNow);
  EXPECT_EQ(bench.recoveries, 1);
}

TEST(Recorder, ALineTheDiskDoesNotTakeIsKeptAndTheOrderStays) {
  Bench bench;
  bench.store.lines_fail = true;
  bench.Give(0, true);
  bench.Give(1, false);
  bench.Give(2, true);
  EXPECT_EQ(bench.recorder.Step(bench.store, kNow), Recorder::Turn::kFailed);
  EXPECT_EQ(bench.recorder.Step(bench.store, kNow), Recorder::Turn::kFailed);
  EXPECT_EQ(bench.recorder.waiting(), 3U);
  EXPECT_FALSE(bench.recorder.TryReserveBuffer());
  bench.store.lines_fail = false;
  while (bench.recorder.Step(bench.store, kNow) == Recorder::Turn::kStored) {
  }
  ASSERT_EQ(bench.store.records.size(), 3U);
  for (std::uint64_t i = 0; i < 3; ++i) EXPECT_EQ(Value(bench.store.records[i].frame), i);
  // Nothing was lost: the pixels were kept with the line.
  EXPECT_EQ(bench.store.records[0].status, FrameStatus::kOk);
  EXPECT_FALSE(bench.store.files[0].empty());
  EXPECT_EQ(bench.recoveries, 1);
  EXPECT_EQ(bench.recorder.free_buffers(), 2U);
}

TEST(Recorder, ARecordThatCannotBeWrittenShrinksToABareLine) {
  Bench bench;
  ASSERT_TRUE(bench.recorder.TryReserveLine());
  CaptureLine line = Line(3, false);
  line.record.status = FrameStatus::kOk;
  line.record.truth_json = "nonsense";
  line.pixels = Image<std::uint8_t>(8, 4, 3);
  bench.recorder.Submit(std::move(line));
  EXPECT_EQ(bench.recorder.Step(bench.store, kNow), Recorder::Turn::kFailed);
  EXPECT_EQ(bench.recorder.Step(bench.store, kNow), Recorder::Turn::kStored);
  ASSERT_EQ(bench.store.records.size(), 1U);
  EXPECT_EQ(Value(bench.store.records[0].frame), 3U);
  EXPECT_EQ(bench.store.records[0].status, FrameStatus::kCorrupt);
  EXPECT_EQ(bench.store.records[0].detail, "truth: not JSON");
  EXPECT_TRUE(bench.store.files[0].empty());
}

TEST(Recorder, ALineWaitsUntilItHasBeenToldOf) {
  std::size_t reserved = 0;
  std::size_t free_buffers = 0;
  Recorder* told = nullptr;
  Recorder recorder({.buffers = 2, .max_waiting_lines = 4},
                    {.journaled =
                         [&](const FrameRecord&) {
                           reserved = told->reserved_lines();
                           free_buffers = told->free_buffers();
                         },
                     .storage_failed = {},
                     .storage_recovered = {}});
  told = &recorder;
  FakeStore store;
  ASSERT_TRUE(recorder.TryReserveLine());
  ASSERT_TRUE(recorder.TryReserveBuffer());
  recorder.Submit(Line(0, true));
  EXPECT_EQ(recorder.Step(store, kNow), Recorder::Turn::kStored);
  EXPECT_EQ(reserved, 1U) << "a stop must not overtake the event of the last line";
  EXPECT_EQ(free_buffers, 2U) << "the next frame need not wait for the event";
  EXPECT_EQ(recorder.reserved_lines(), 0U);
}

TEST(Recorder, SubmitsWhileItStores) {
  Bench bench({.buffers = 4, .max_waiting_lines = 64});
  constexpr std::uint64_t kLines = 500;
  std::jthread capture([&] {
    for (std::uint64_t i = 0; i < kLines; ++i) {
      while (!bench.recorder.TryReserveLine()) std::this_thread::yield();
      const bool buffer = bench.recorder.TryReserveBuffer();
      bench.recorder.Submit(Line(i, buffer));
    }
  });
  while (bench.store.records.size() < kLines) {
    bench.recorder.Step(bench.store, std::chrono::seconds(10));
  }
  for (std::uint64_t i = 0; i < kLines; ++i) {
    ASSERT_EQ(Value(bench.store.records[i].frame), i);
  }
  EXPECT_EQ(bench.recorder.free_buffers(), 4U);
}

}  // namespace
}  // namespace omnihdr::recorder_test
