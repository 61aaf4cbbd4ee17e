#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>

#include <filesystem>
#include <limits>

#include "core/image/exr.h"
#include "core/pipeline/session_processor.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::bad_input_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::ProcessAll;
using testing::Processed;
using testing::Said;
using testing::SameBytes;
using testing::SessionPlan;
using testing::TemporaryDirectory;
using testing::ViewBytes;

using Frames = std::vector<std::vector<std::byte>>;

SessionPlan Plan(int positions = 5) {
  SessionPlan plan;
  plan.room.balls.push_back({{2.5, 1.6, 0.0}, 0.6, 1.0F});
  plan.poses = testing::GentleBend(positions, 0.2);
  plan.with_prior_poses = true;
  return plan;
}

// A session written frame by frame, in whatever order and shape a test wants.
class BadInput : public ::testing::Test {
 protected:
  static const Frames& FiveFrames() {
    static const Frames frames = testing::RenderFrames(Plan());
    return frames;
  }
  void Create(const SessionPlan& plan) {
    Result<SessionWriter> writer = SessionWriter::Create(path(), InfoOf(plan));
    ASSERT_TRUE(writer) << writer.error().message;
    writer_ = std::make_unique<SessionWriter>(std::move(*writer));
  }
  void Append(const FrameRecord& record, std::span<const std::byte> png) {
    const Status status = writer_->Append(record, png);
    ASSERT_TRUE(status) << status.error().message;
  }
  void CreateWhole() {
    Create(Plan());
    for (std::size_t k = 0; k < 5; ++k) Append(RecordOf(Plan(), k), FiveFrames()[k]);
  }
  // A journal line as another program could have written it.
  void AppendLine(const std::string& line) {
    testing::WriteText(path() / "frames.jsonl",
                       testing::FileText(path() / "frames.jsonl") + line + "\n");
  }
  std::vector<std::int64_t> Views() const {
    std::vector<std::int64_t> positions;
    const Result<std::vector<PositionId>> views = CompleteViews(path() / "views");
    EXPECT_TRUE(views) << views.error().message;
    for (const PositionId p : *views) positions.push_back(Value(p));
    return positions;
  }
  ViewRecord RecordOfView(int position) const {
    Result<ViewRecord> record = ReadViewRecord(path() / "views", PositionId{position});
    EXPECT_TRUE(record) << record.error().message;
    return record ? *record : ViewRecord{};
  }
  // Every number of every view can be worked with.
  void ExpectSoundViews() const {
    for (const std::int64_t position : Views()) {
      const fs::path view = path() / "views" / ViewDirectoryName(PositionId{position});
      const Result<ExrImage> radiance = ReadExr(view / "radiance.exr");
      ASSERT_TRUE(radiance) << radiance.error().message;
      for (const char* channel : {"R", "G", "B"}) {
        for (const float e : radiance->channels.at(channel).values()) {
          ASSERT_TRUE(std::isfinite(e));
          ASSERT_GE(e, 0.0F);
        }
      }
      EXPECT_TRUE(ReadImage(view / "preview.jpg"));
    }
  }
  bool AllDisparityUnknown(int position) const {
    const Result<ExrImage> disparity =
        ReadExr(path() / "views" / ViewDirectoryName(PositionId{position}) / "disparity.exr");
    EXPECT_TRUE(disparity) << disparity.error().message;
    for (const float d : disparity->channels.at("disparity").values()) {
      if (!std::isnan(d)) return false;
    }
    return true;
  }
  const fs::path& path() const { return directory_.path(); }

  TemporaryDirectory directory_;
  std::unique_ptr<SessionWriter> writer_;
};

bool Mentions(const std::vector<std::string>& warnings, const std::string& text) {
  return std::any_of(warnings.begin(), warnings.end(),
                     [&text](const std::string& w) { return w.find(text) != std::string::npos; });
}

TEST_F(BadInput, ADirectoryWithoutASessionIsAnErrorThatNamesTheFile) {
  const auto processor = SessionProcessor::Open(path(), {}, testing::QuickOptions(), {});
  ASSERT_FALSE(processor);
  EXPECT_EQ(processor.error().kind, ErrorKind::kNoInput);
  EXPECT_THAT(processor.error().message, HasSubstr("session.json"));
}

TEST_F(BadInput, AnEmptySessionGivesNoViewsAndNoError) {
  Create(Plan());
  const Processed done = ProcessAll(path());
  EXPECT_EQ(done.counts.positions_seen, 0);
  EXPECT_EQ(done.counts.views_complete, 0);
  EXPECT_THAT(Views(), IsEmpty());
}

TEST_F(BadInput, OnePositionIsAViewWithoutDisparityThatSaysSo) {
  Create(Plan());
  Append(RecordOf(Plan(), 0), FiveFrames()[0]);
  ProcessAll(path());
  ASSERT_THAT(Views(), ElementsAre(0));
  ExpectSoundViews();
  EXPECT_TRUE(AllDisparityUnknown(0));
  EXPECT_TRUE(Mentions(RecordOfView(0).warnings, "disparity unknown"));
  EXPECT_THAT(RecordOfView(0).frames, ElementsAre(0U));
}

TEST_F(BadInput, TwoPositionsHelpEachOther) {
  Create(Plan());
  for (std::size_t k = 0; k < 2; ++k) Append(RecordOf(Plan(), k), FiveFrames()[k]);
  ProcessAll(path());
  ASSERT_THAT(Views(), ElementsAre(0, 1));
  ExpectSoundViews();
  EXPECT_FALSE(AllDisparityUnknown(0));
  EXPECT_THAT(RecordOfView(0).frames, ElementsAre(0U, 1U));
  EXPECT_THAT(RecordOfView(1).frames, ElementsAre(0U, 1U));
}

TEST_F(BadInput, AFrameOfAnotherSizeCostsThatFrameOnly) {
  Create(Plan());
  const std::vector<std::byte> small =
      EncodePng(Image<std::uint8_t>(128, 64, 3, std::uint8_t{90}).view()).value();
  for (std::size_t k = 0; k < 5; ++k) {
    Append(RecordOf(Plan(), k), k == 2 ? small : FiveFrames()[k]);
  }
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 1, 3, 4));
  EXPECT_TRUE(done.said.Warned("128x64"));
  EXPECT_TRUE(done.said.Warned("256x128"));
  EXPECT_EQ(done.counts.positions_without_pixels, 1);
  ExpectSoundViews();
}

TEST_F(BadInput, AMissingPictureCostsThatFrameOnly) {
  CreateWhole();
  fs::remove(path() / "raw" / "000003.png");
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 1, 2, 4));
  EXPECT_TRUE(done.said.Warned("000003.png"));
}

TEST_F(BadInput, ATruncatedPictureCostsThatFrameOnly) {
  CreateWhole();
  const std::string png = testing::FileText(path() / "raw" / "000001.png");
  testing::WriteText(path() / "raw" / "000001.png", png.substr(0, png.size() / 2));
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 2, 3, 4));
  EXPECT_TRUE(done.said.Warned("000001.png"));
}

TEST_F(BadInput, ATruncatedPictureWithoutAChecksumIsNoticedAllTheSame) {
  Create(Plan());
  for (std::size_t k = 0; k < 3; ++k) {
    const auto& png = FiveFrames()[k];
    Append(RecordOf(Plan(), k), k == 1 ? std::span(png).first(png.size() / 2) : std::span(png));
  }
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 2));
  EXPECT_TRUE(done.said.Warned("000001.png"));
}

TEST_F(BadInput, APictureThatIsNotTheOneJournaledIsNotUsed) {
  CreateWhole();
  // A whole PNG, but another one.
  fs::copy_file(path() / "raw" / "000000.png", path() / "raw" / "000002.png",
                fs::copy_options::overwrite_existing);
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 1, 3, 4));
  EXPECT_TRUE(done.said.Warned("crc32c"));
}

TEST_F(BadInput, AllFramesUnusableIsNoViewsAndManyWords) {
  CreateWhole();
  fs::remove_all(path() / "raw");
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), IsEmpty());
  EXPECT_EQ(done.counts.positions_without_pixels, 5);
  EXPECT_GE(done.said.warnings.size(), 5U);
}

TEST_F(BadInput, AnImpossibleExposureCostsItsLine) {
  CreateWhole();
  for (const char* exposure : {"0", "-0.5", "null", "\"short\"", "1e300"}) {
    AppendLine(fmt::format(
        R"({{"frame": {}, "position": {}, "file": "raw/000000.png", "exposure_s": {}, "gain_db": 0, )"
        R"("trigger_ns": 1, "timestamp_ns": 2, "status": "ok"}})",
        5, 5, exposure));
  }
  AppendLine(R"({"frame": 6, "position": 6, "file": "raw/000000.png", "exposure_s": NaN})");
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 1, 2, 3, 4));
  EXPECT_TRUE(done.said.Warned("exposure_s"));
  EXPECT_TRUE(done.said.Warned("frames.jsonl:6"));
}

TEST_F(BadInput, TriggersWithoutFramesAreStepsWithoutViews) {
  Create(Plan());
  for (std::size_t k = 0; k < 5; ++k) {
    FrameRecord record = RecordOf(Plan(), k);
    if (k != 1 && k != 2) {
      Append(record, FiveFrames()[k]);
      continue;
    }
    record.status = k == 1 ? FrameStatus::kMissedTrigger : FrameStatus::kCameraTimeout;
    record.file.clear();
    Append(record, {});
  }
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 3, 4));
  EXPECT_EQ(done.counts.positions_without_pixels, 2);
  ExpectSoundViews();
  // The neighbours that are there help each other across the gap.
  EXPECT_THAT(RecordOfView(0).frames, ElementsAre(0U, 3U, 4U));
}

// Follows `records` line by line with a processor that steps after each.
std::map<std::string, std::string> Live(const fs::path& directory, const SessionPlan& plan,
                                        const std::vector<FrameRecord>& records,
                                        const Frames& frames,
                                        const PipelineOptions& options = testing::QuickOptions()) {
  Result<SessionWriter> writer = SessionWriter::Create(directory, InfoOf(plan));
  EXPECT_TRUE(writer);
  Said said;
  const auto processor = testing::OpenProcessor(directory, &said, {}, options);
  for (std::size_t k = 0; k < records.size(); ++k) {
    EXPECT_TRUE(writer->Append(records[k], frames[k]));
    while (processor->Step().value() == SessionProcessor::Progress::kWorked) {
    }
  }
  EXPECT_TRUE(processor->Finish());
  return ViewBytes(directory);
}

// Processes the same journal at once.
std::map<std::string, std::string> Later(const fs::path& directory, const SessionPlan& plan,
                                         const std::vector<FrameRecord>& records,
                                         const Frames& frames, Said* said,
                                         const PipelineOptions& options = testing::QuickOptions()) {
  Result<SessionWriter> writer = SessionWriter::Create(directory, InfoOf(plan));
  EXPECT_TRUE(writer);
  for (std::size_t k = 0; k < records.size(); ++k) {
    EXPECT_TRUE(writer->Append(records[k], frames[k]));
  }
  *said = ProcessAll(directory, {}, options).said;
  return ViewBytes(directory);
}

// Journal lines in the given order of positions; line number k is frame k.
std::vector<FrameRecord> RecordsInOrder(const SessionPlan& plan,
                                        const std::vector<std::size_t>& positions) {
  std::vector<FrameRecord> records;
  for (std::size_t k = 0; k < positions.size(); ++k) {
    FrameRecord record = RecordOf(plan, positions[k]);
    record.frame = FrameId{k};
    record.file = fmt::format("raw/{:06}.png", k);
    records.push_back(record);
  }
  return records;
}

class Order : public BadInput {
 protected:
  // The views must not depend on whether they were made while the journal grew.
  std::vector<std::int64_t> ProcessBothWays(
      const std::vector<std::size_t>& positions, Said* said, int frames_per_position = 1,
      const PipelineOptions& options = testing::QuickOptions()) {
    SessionPlan plan = Plan();
    plan.frames_per_position = frames_per_position;
    const std::vector<FrameRecord> records = RecordsInOrder(plan, positions);
    Frames frames;
    for (const std::size_t p : positions) frames.push_back(FiveFrames()[p]);
    const TemporaryDirectory live;
    const auto live_bytes = Live(live.path(), plan, records, frames, options);
    EXPECT_TRUE(SameBytes(live_bytes, Later(path(), plan, records, frames, said, options)));
    ExpectSoundViews();
    return Views();
  }
};

TEST_F(Order, PositionsOutOfOrderAreToldOfAndSurvived) {
  Said said;
  const std::vector<std::int64_t> views = ProcessBothWays({0, 1, 3, 2, 4}, &said);
  EXPECT_THAT(views, ElementsAre(0, 1, 3, 4));
  EXPECT_TRUE(said.Warned("position 2"));
}

TEST_F(Order, ADuplicatePositionIsToldOfAndSurvived) {
  Said said;
  const std::vector<std::int64_t> views = ProcessBothWays({0, 1, 1, 2, 3}, &said);
  EXPECT_THAT(views, ElementsAre(0, 1, 2, 3));
  EXPECT_TRUE(said.Warned("position 1"));
  EXPECT_EQ(RecordOfView(1).reference, 1U);
}

TEST_F(Order, APositionSeenLongAgoIsToldOf) {
  Said said;
  const std::vector<std::int64_t> views = ProcessBothWays({0, 1, 2, 3, 0}, &said);
  EXPECT_THAT(views, ElementsAre(0, 1, 2, 3));
  EXPECT_TRUE(said.Warned("position 0"));
}

TEST_F(Order, GapsInTheNumbersDoNotMatter) {
  SessionPlan plan = Plan();
  std::vector<FrameRecord> records;
  const std::array<std::int64_t, 5> numbers = {3, 10, 11, 500, 501};
  for (std::size_t k = 0; k < 5; ++k) {
    records.push_back(RecordOf(plan, k));
    records.back().position = PositionId{numbers[k]};
  }
  const TemporaryDirectory live;
  Said said;
  const auto live_bytes = Live(live.path(), plan, records, FiveFrames());
  EXPECT_TRUE(SameBytes(live_bytes, Later(path(), plan, records, FiveFrames(), &said)));
  EXPECT_THAT(Views(), ElementsAre(3, 10, 11, 500, 501));
}

TEST_F(Order, WithoutABracketAPositionHasOneFrame) {
  Said said;
  const std::vector<std::int64_t> views = ProcessBothWays({0, 1, 1, 2, 3}, &said, 0);
  EXPECT_THAT(views, ElementsAre(0, 1, 2, 3));
  EXPECT_TRUE(said.Warned("frames_per_position"));
  EXPECT_EQ(RecordOfView(1).reference, 1U);
}

TEST_F(Order, AsManyFramesAsTheSessionSaysAreMergedAtAPosition) {
  Said said;
  const std::vector<std::int64_t> views = ProcessBothWays({0, 0, 1, 1, 2, 2, 2, 3, 4, 4}, &said, 2);
  EXPECT_THAT(views, ElementsAre(0, 1, 2, 3, 4));
  EXPECT_THAT(RecordOfView(0).frames, ElementsAre(0U, 1U, 2U, 3U, 4U, 5U));
  EXPECT_THAT(said.warnings, ::testing::SizeIs(1)) << "the third of position 2 is too many";
}

TEST_F(Order, InTemporalModeAPositionIsOpenUntilTheNext) {
  Said said;
  PipelineOptions options = testing::QuickOptions();
  options.mode = ProcessMode::kTemporal;
  const std::vector<std::int64_t> views = ProcessBothWays({0, 0, 0, 1, 1, 4}, &said, 1, options);
  EXPECT_THAT(views, ElementsAre(0, 1, 4));
  EXPECT_THAT(RecordOfView(0).frames, ElementsAre(0U, 1U, 2U));
  EXPECT_THAT(RecordOfView(1).frames, ElementsAre(3U, 4U));
  EXPECT_THAT(said.warnings, IsEmpty());
}

TEST_F(BadInput, AllBlackAndAllWhiteFramesAreSurvived) {
  SessionPlan plan = Plan();
  plan.with_prior_poses = false;
  Create(plan);
  const std::vector<std::byte> black =
      EncodePng(Image<std::uint8_t>(256, 128, 3, std::uint8_t{0}).view()).value();
  const std::vector<std::byte> white =
      EncodePng(Image<std::uint8_t>(256, 128, 3, std::uint8_t{255}).view()).value();
  for (std::size_t k = 0; k < 5; ++k) {
    Append(RecordOf(plan, k), k == 1 ? black : (k == 3 ? white : FiveFrames()[k]));
  }
  ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 1, 2, 3, 4));
  ExpectSoundViews();
  for (int k = 0; k < 5; ++k) EXPECT_LE(RecordOfView(k).valid_fraction, 1.0);
}

TEST_F(BadInput, NothingButBlackAndNothingButWhiteAreSurvived) {
  for (const std::uint8_t value : {std::uint8_t{0}, std::uint8_t{255}}) {
    const TemporaryDirectory directory;
    SessionPlan plan = Plan();
    plan.with_prior_poses = false;
    const std::vector<std::byte> png =
        EncodePng(Image<std::uint8_t>(256, 128, 3, value).view()).value();
    testing::WriteSession(directory.path(), plan, Frames(5, png));
    const Processed done = ProcessAll(directory.path());
    EXPECT_EQ(done.counts.views_written, 5);
    const Result<ViewRecord> record = ReadViewRecord(directory.path() / "views", PositionId{2});
    ASSERT_TRUE(record);
    EXPECT_FALSE(record->warnings.empty());
    if (value == 255) {
      EXPECT_EQ(record->valid_fraction, 0.0);
    }
  }
}

TEST_F(BadInput, APureRotationMergesByRotationAndKnowsNoDisparity) {
  SessionPlan plan = Plan();
  plan.with_prior_poses = false;
  plan.with_odometer = false;
  plan.projection = Projection::Equirectangular(512, 256);
  plan.room.detail_m = 0.5;
  plan.poses.resize(3);
  for (std::size_t k = 0; k < 3; ++k) {
    plan.poses[k].translation.setZero();
    plan.poses[k].rotation =
        Eigen::AngleAxisd(0.15 * static_cast<double>(k), Eigen::Vector3d::UnitZ());
  }
  testing::WriteSession(path(), plan, testing::RenderFrames(plan));
  ProcessAll(path());
  ASSERT_THAT(Views(), ElementsAre(0, 1, 2));
  ExpectSoundViews();
  for (int k = 0; k < 3; ++k) {
    EXPECT_TRUE(AllDisparityUnknown(k)) << "position " << k;
    EXPECT_THAT(RecordOfView(k).frames, ElementsAre(0U, 1U, 2U));
    EXPECT_TRUE(Mentions(RecordOfView(k).warnings, "disparity unknown"));
    const double angle = RecordOfView(k).pose.rotation.angularDistance(
        plan.poses[static_cast<std::size_t>(k)].rotation);
    EXPECT_LT(angle, 0.01);
  }
}

TEST_F(BadInput, TexturelessWallsAreSurvived) {
  SessionPlan plan = Plan();
  plan.with_prior_poses = false;
  plan.room.textured = false;
  plan.room.balls.clear();
  testing::WriteSession(path(), plan, testing::RenderFrames(plan));
  const Processed done = ProcessAll(path());
  EXPECT_EQ(done.counts.views_written, 5);
  ExpectSoundViews();
  // The one thing there is to measure is right.
  const Result<ExrImage> radiance = ReadExr(path() / "views" / "000002" / "radiance.exr");
  ASSERT_TRUE(radiance);
  EXPECT_NEAR(radiance->channels.at("G").at(100, 60), plan.room.brightness,
              0.05F * plan.room.brightness);
}

TEST_F(BadInput, AJumpWithNoOverlapStartsANewChainThatSaysWhy) {
  SessionPlan plan = Plan(6);
  plan.with_prior_poses = false;
  plan.projection = Projection::Equirectangular(512, 256);
  plan.room.detail_m = 0.5;
  Frames frames = testing::RenderFrames(plan);
  SessionPlan elsewhere = plan;
  elsewhere.room.texture_shift = 500.0;
  elsewhere.room.low = {-3.0, -6.0, -1.0};
  const Frames other = testing::RenderFrames(elsewhere);
  for (std::size_t k = 3; k < 6; ++k) frames[k] = other[k];
  testing::WriteSession(path(), plan, frames);
  ProcessAll(path());
  ASSERT_THAT(Views(), ElementsAre(0, 1, 2, 3, 4, 5));
  ExpectSoundViews();
  for (int k = 0; k < 3; ++k) EXPECT_EQ(RecordOfView(k).chain, RecordOfView(0).chain);
  for (int k = 3; k < 6; ++k) EXPECT_EQ(RecordOfView(k).chain, RecordOfView(3).chain);
  EXPECT_NE(RecordOfView(3).chain, RecordOfView(0).chain);
  EXPECT_FALSE(RecordOfView(3).chain_reason.empty());
  EXPECT_TRUE(Mentions(RecordOfView(3).warnings, "new chain"));
  // Nothing of the other place is mixed in.
  EXPECT_THAT(RecordOfView(2).frames, ElementsAre(0U, 1U, 2U));
  EXPECT_THAT(RecordOfView(3).frames, ElementsAre(3U, 4U, 5U));
}

TEST_F(BadInput, ATornLastLineIsDroppedWithAWord) {
  CreateWhole();
  testing::WriteText(path() / "frames.jsonl", testing::FileText(path() / "frames.jsonl") +
                                                  "{\"frame\": 5, \"position\": 5, \"fi");
  const Processed done = ProcessAll(path());
  EXPECT_THAT(Views(), ElementsAre(0, 1, 2, 3, 4));
  EXPECT_TRUE(done.said.Warned("torn"));
}

TEST_F(BadInput, AMaskOfTheWrongSizeIsRefusedWithBothSizes) {
  CreateWhole();
  const std::vector<std::byte> png =
      EncodePng(Image<std::uint8_t>(100, 50, 1, std::uint8_t{255}).view()).value();
  testing::WriteText(path() / "mask.png", {reinterpret_cast<const char*>(png.data()), png.size()});
  PipelineOptions options = testing::QuickOptions();
  options.mask_file = (path() / "mask.png").string();
  const auto processor = SessionProcessor::Open(path(), {}, options, {});
  ASSERT_FALSE(processor);
  EXPECT_THAT(processor.error().message, HasSubstr("100x50"));
  EXPECT_THAT(processor.error().message, HasSubstr("256x128"));
  EXPECT_THAT(processor.error().message, HasSubstr("mask.png"));
}

TEST_F(BadInput, AMissingMaskIsRefused) {
  CreateWhole();
  PipelineOptions options = testing::QuickOptions();
  options.mask_file = (path() / "nowhere.png").string();
  const auto processor = SessionProcessor::Open(path(), {}, options, {});
  ASSERT_FALSE(processor);
  EXPECT_THAT(processor.error().message, HasSubstr("nowhere.png"));
}

// While it lives, no file of this process can grow beyond `bytes`: writing stops half-way, as on a
// full disk.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) {
    ::signal(SIGXFSZ, SIG_IGN);
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{bytes, before_.rlim_max};
    EXPECT_EQ(::setrlimit(RLIMIT_FSIZE, &limit), 0);
  }
  ~FileSizeLimit() { ::setrlimit(RLIMIT_FSIZE, &before_); }

 private:
  rlimit before_{};
};

TEST_F(BadInput, AFullDiskStopsTheViewAndItIsCompletedWhenThereIsRoom) {
  CreateWhole();
  const TemporaryDirectory undisturbed;
  ProcessAll(path(), undisturbed.path());
  for (const rlim_t bytes : {rlim_t{0}, rlim_t{1000}, rlim_t{60'000}}) {
    const TemporaryDirectory output;
    Said said;
    const auto processor = testing::OpenProcessor(path(), &said, output.path());
    ASSERT_NE(processor, nullptr);
    {
      const FileSizeLimit limit(bytes);
      const Status full = processor->Finish();
      ASSERT_FALSE(full) << "with room for " << bytes;
      EXPECT_THAT(full.error().message, HasSubstr("view 0"));
      EXPECT_THAT(full.error().message, HasSubstr("too large"));
      // And again: still full, still said, still nothing half-done.
      EXPECT_FALSE(processor->Step());
      EXPECT_TRUE(ViewBytes(output.path()).empty());
    }
    ASSERT_TRUE(processor->Finish());
    EXPECT_TRUE(SameBytes(ViewBytes(undisturbed.path()), ViewBytes(output.path())));
  }
}

// Temporal: several frames at one position.

SessionPlan Standing() {
  SessionPlan plan = Plan(3);
  for (Pose& pose : plan.poses) pose = Pose{};
  return plan;
}

FrameRecord AtPosition(FrameRecord record, std::int64_t position) {
  record.position = PositionId{position};
  return record;
}

TEST_F(BadInput, TemporalModeMergesTheFramesOfEachPosition) {
  const SessionPlan plan = Standing();
  const Frames frames = testing::RenderFrames(plan);
  Create(plan);
  for (std::size_t k = 0; k < 3; ++k) Append(AtPosition(RecordOf(plan, k), 0), frames[k]);
  PipelineOptions options = testing::QuickOptions();
  options.mode = ProcessMode::kTemporal;
  const Processed done = ProcessAll(path(), {}, options);
  ASSERT_THAT(Views(), ElementsAre(0));
  EXPECT_THAT(done.said.warnings, IsEmpty());
  const ViewRecord record = RecordOfView(0);
  EXPECT_EQ(record.mode, "temporal");
  EXPECT_THAT(record.frames, ElementsAre(0U, 1U, 2U));
  EXPECT_EQ(record.reference, 1U) << "the exposure in the middle";
  EXPECT_FALSE(fs::exists(path() / "views" / "000000" / "disparity.exr"));
  ExpectSoundViews();
}

TEST_F(BadInput, TemporalModeWithOneFrameSaysThatNothingIsGained) {
  const SessionPlan plan = Plan(1);
  Create(plan);
  Append(RecordOf(plan, 0), FiveFrames()[0]);
  PipelineOptions options = testing::QuickOptions();
  options.mode = ProcessMode::kTemporal;
  ProcessAll(path(), {}, options);
  EXPECT_TRUE(Mentions(RecordOfView(0).warnings, "one exposure"));
}

TEST_F(BadInput, APerspectiveSessionIsMergedInTime) {
  const SessionPlan plan = Standing();
  const Frames frames = testing::RenderFrames(plan);
  SessionInfo info = InfoOf(plan);
  info.camera.layout = Layout::kPerspective;
  info.camera.intrinsics = {200.0, 200.0, 128.0, 64.0};
  info.bracket->frames_per_position = 3;
  Result<SessionWriter> writer = SessionWriter::Create(path(), info);
  ASSERT_TRUE(writer) << writer.error().message;
  for (std::size_t k = 0; k < 3; ++k) {
    ASSERT_TRUE(writer->Append(AtPosition(RecordOf(plan, k), 0), frames[k]));
  }
  const Processed done = ProcessAll(path());
  ASSERT_THAT(Views(), ElementsAre(0));
  EXPECT_EQ(RecordOfView(0).mode, "temporal");
  const Result<ExrImage> radiance = ReadExr(path() / "views" / "000000" / "radiance.exr");
  ASSERT_TRUE(radiance);
  EXPECT_EQ(radiance->width, 256);  // its own grid, no sphere
  EXPECT_EQ(radiance->height, 128);
}

TEST_F(BadInput, APerspectiveSessionCannotBeFusedAlongADrive) {
  SessionInfo info = InfoOf(Plan());
  info.camera.layout = Layout::kPerspective;
  info.camera.intrinsics = {200.0, 200.0, 128.0, 64.0};
  testing::WriteText(path() / "session.json", FormatSessionInfo(info));
  PipelineOptions options = testing::QuickOptions();
  options.mode = ProcessMode::kSpatiotemporal;
  const auto processor = SessionProcessor::Open(path(), {}, options, {});
  ASSERT_FALSE(processor);
  EXPECT_THAT(processor.error().message, HasSubstr("temporal"));
}

}  // namespace
}  // namespace omnihdr::bad_input_test
