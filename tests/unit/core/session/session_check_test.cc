// CheckSession and RepairSession on sessions made byte by byte; that repaired sessions process is
// tests/unit/core/pipeline/session_repair_test.cc.
#include "core/session/session_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/session/journal.h"
#include "core/session/session_reader.h"
#include "core/session/session_repair.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::session_check_test {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int kFrames = 4;
constexpr int kSide = 64;
const UtcTime kNow = UtcTime::FromNanoseconds(1'767'225'600'000'000'000);

std::vector<std::byte> Png(int seed, int width = kSide, int height = kSide) {
  Image<std::uint8_t> image(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      image.at(x, y) = static_cast<std::uint8_t>((x * 7 + y * 13 + seed * 31) % 251);
    }
  }
  return EncodePng(image.view()).value();
}

SessionInfo Info() {
  SessionInfo info = test::SampleInfo();
  info.camera.width = kSide;
  info.camera.height = kSide;
  return info;
}

void WriteRadiance(const fs::path& file, int width, int position, float blue = 0.5F) {
  Image<float> rgb(width, 16, 3);
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < width; ++x) {
      rgb.at(x, y, 0) = 1.0F;
      rgb.at(x, y, 1) = static_cast<float>(x);
      rgb.at(x, y, 2) = blue;
    }
  }
  Image<float> origin(width, 16);
  std::fill(origin.values().begin(), origin.values().end(), 1.0F);
  ExrAttributes attributes;
  attributes.strings["omnihdrPosition"] = fmt::format("{}", position);
  const Status written = WriteExr(file,
                                  {{"R", rgb, ExrPixelType::kHalf, 0},
                                   {"G", rgb, ExrPixelType::kHalf, 1},
                                   {"B", rgb, ExrPixelType::kHalf, 2},
                                   {"origin", origin, ExrPixelType::kHalf, 0}},
                                  attributes);
  EXPECT_TRUE(written) << written.error().message;
}

void WriteDisparity(const fs::path& file, const char* name, int position) {
  const Image<float> zero(32, 16);
  ExrAttributes attributes;
  attributes.strings["omnihdrPosition"] = fmt::format("{}", position);
  EXPECT_TRUE(WriteExr(
      file, {{name, zero, ExrPixelType::kFloat, 0}, {"confidence", zero, ExrPixelType::kHalf, 0}},
      attributes));
}

void FillView(const fs::path& directory, int position) {
  ViewRecord record = test::SampleView(position);
  const auto frame = static_cast<std::uint64_t>(position);
  record.frames = {frame};
  record.reference = frame;
  test::Spill(directory / "view.json", FormatViewRecord(record));
  WriteRadiance(directory / "radiance.exr", 32, position);
  WriteDisparity(directory / "disparity.exr", "disparity", position);
  const Image<std::uint8_t> grey(32, 16, 3);
  const auto jpeg = EncodeJpeg(grey.view(), 90, false).value();
  test::Spill(directory / "preview.jpg",
              std::string(reinterpret_cast<const char*>(jpeg.data()), jpeg.size()));
}

class SessionCheck : public ::testing::Test {
 protected:
  // Frames 0 to 3, one a position, each with its view.
  void SetUp() override {
    Result<SessionWriter> writer = SessionWriter::Create(path(), Info());
    ASSERT_TRUE(writer) << writer.error().message;
    for (int k = 0; k < kFrames; ++k) Append(*writer, k);
    for (int k = 0; k < kFrames; ++k) {
      const Status written =
          WriteView(path() / "views", PositionId{k}, false, [k](const fs::path& directory) {
            FillView(directory, k);
            return Status();
          });
      ASSERT_TRUE(written) << written.error().message;
    }
  }
  static void Append(SessionWriter& writer, int k) {
    const Status status =
        writer.Append(test::SampleRecord(static_cast<std::uint64_t>(k), k), Png(k));
    ASSERT_TRUE(status) << status.error().message;
  }
  SessionReport Check(bool quick = false) const {
    SessionCheckOptions options;
    options.quick = quick;
    Result<SessionReport> report = CheckSession(path(), options);
    EXPECT_TRUE(report) << report.error().message;
    return report ? *report : SessionReport{};
  }
  RepairReport Repair(bool apply = true) const {
    RepairOptions options;
    options.apply = apply;
    Result<RepairReport> report = RepairSession(path(), kNow, options);
    EXPECT_TRUE(report) << report.error().message;
    return report ? *report : RepairReport{};
  }
  std::map<std::string, std::string> Files() const {
    std::map<std::string, std::string> files;
    for (const auto& entry : fs::recursive_directory_iterator(path())) {
      if (entry.is_regular_file()) {
        files[fs::relative(entry.path(), path()).string()] = test::Slurp(entry.path());
      }
    }
    return files;
  }
  std::string Journal() const { return test::Slurp(path() / "frames.jsonl"); }
  void SetJournal(const std::string& text) const { test::Spill(path() / "frames.jsonl", text); }
  const fs::path& path() const { return directory_.path(); }

  test::TemporaryDirectory directory_;
};

auto Finding(FindingKind kind, const std::string& code, const std::string& file,
             const std::string& message = "") {
  return AllOf(Field(&SessionFinding::kind, kind), Field(&SessionFinding::code, code),
               Field(&SessionFinding::file, file),
               Field(&SessionFinding::message, HasSubstr(message)));
}
auto Damage(const std::string& code, const std::string& file, const std::string& message = "") {
  return Finding(FindingKind::kDamage, code, file, message);
}

std::string Told(const SessionReport& report) {
  std::string text;
  for (const SessionFinding& finding : report.findings) {
    text += fmt::format("{} {} {}:{} {}\n", ToString(finding.kind), finding.code, finding.file,
                        finding.line, finding.message);
  }
  return text;
}

TEST_F(SessionCheck, AnUntouchedSessionHasNothingToTell) {
  const SessionReport report = Check();
  EXPECT_THAT(report.findings, IsEmpty()) << Told(report);
  EXPECT_EQ(report.lines, 4U);
  EXPECT_EQ(report.lines_sealed, 4U);
  EXPECT_EQ(report.pictures, 4U);
  EXPECT_EQ(report.positions, 4U);
  EXPECT_EQ(report.views, 4U);
  std::uint64_t bytes = 0;
  for (int k = 0; k < kFrames; ++k) bytes += Png(k).size();
  EXPECT_EQ(report.picture_bytes, bytes);
  EXPECT_FALSE(report.is_being_written);
  EXPECT_THAT(Repair().actions, IsEmpty());
}

TEST_F(SessionCheck, EveryDamageIsToldByItsFileAndWhatWasExpected) {
  const fs::path views = path() / "views";
  const std::string line = Journal().substr(0, Journal().find('\n'));
  struct Case {
    std::string what;
    std::function<void()> change;
    std::string code;
    std::string file;
    std::string message;
  };
  const auto spill = [&](const std::string& file, const std::string& text) {
    return [this, file, text] { test::Spill(path() / file, text); };
  };
  const auto png = Png(9, 80, 64);
  const std::string other_size(reinterpret_cast<const char*>(png.data()), png.size());
  const std::vector<Case> cases = {
      {"no session.json", [&] { fs::remove(path() / "session.json"); }, "info-unreadable",
       "session.json", "No such file"},
      {"a wrong session.json", spill("session.json", "{}"), "info-unreadable", "session.json",
       "expected \"omnihdr-session\""},
      {"a line that is no record", [&] { SetJournal("{\"frame\": 1}\n" + Journal()); },
       "line-rejected", "frames.jsonl", "position: missing"},
      {"a frame number twice", [&] { SetJournal(Journal() + line + "\n"); }, "line-rejected",
       "frames.jsonl", "expected a number not used before"},
      {"an edited exposure",
       [&] {
         std::string text = Journal();
         text.replace(text.find("0.004"), 5, "0.008");
         SetJournal(text);
       },
       "line-changed", "frames.jsonl", "line_crc32c"},
      {"a wrong count of an ended session", spill("ended.json", R"({"frames": 5})"), "end-count",
       "ended.json", "frames: 5, expected 4"},
      {"a missing picture", [&] { fs::remove(path() / "raw/000002.png"); }, "raw-missing",
       "raw/000002.png", "frames.jsonl:3"},
      {"an empty picture", spill("raw/000002.png", ""), "raw-empty", "raw/000002.png", "0 bytes"},
      {"a picture that is another's",
       [&] {
         fs::copy_file(path() / "raw/000001.png", path() / "raw/000002.png",
                       fs::copy_options::overwrite_existing);
       },
       "raw-checksum", "raw/000002.png", "as journaled"},
      {"a picture beyond the journal", spill("raw/000009.png", "x"), "raw-unjournaled",
       "raw/000009.png", "no line of frame 9"},
      {"a line that is gone", [&] { SetJournal(Journal().substr(Journal().find('\n') + 1)); },
       "raw-unjournaled", "raw/000000.png", "no line of frame 0"},
      {"no view.json", [&] { fs::remove(views / "000001/view.json"); }, "view-incomplete",
       "views/000001/view.json", "No such file"},
      {"another view's view.json",
       [&] {
         fs::copy_file(views / "000000/view.json", views / "000001/view.json",
                       fs::copy_options::overwrite_existing);
       },
       "view-incomplete", "views/000001/view.json", "position: 0, expected 1"},
      {"no radiance", [&] { fs::remove(views / "000001/radiance.exr"); }, "view-unreadable",
       "views/000001/radiance.exr", "missing"},
      {"radiance cut short",
       [&] {
         const fs::path file = views / "000001/radiance.exr";
         fs::resize_file(file, fs::file_size(file) / 2);
       },
       "view-unreadable", "views/000001/radiance.exr", ""},
      {"a channel of another name",
       [&] { WriteDisparity(views / "000001/disparity.exr", "depth", 1); }, "view-channels",
       "views/000001/disparity.exr", "no channel disparity, expected disparity, confidence"},
      {"radiance of another size", [&] { WriteRadiance(views / "000001/radiance.exr", 48, 1); },
       "view-size", "views/000001/disparity.exr", "32x16, expected 48x16"},
      {"negative radiance", [&] { WriteRadiance(views / "000001/radiance.exr", 32, 1, -1.0F); },
       "view-values", "views/000001/radiance.exr", "512 negative or infinite values"},
      {"another position's radiance", [&] { WriteRadiance(views / "000001/radiance.exr", 32, 2); },
       "view-mismatch", "views/000001/radiance.exr", "omnihdrPosition: 2, expected 1"},
      {"no preview", spill("views/000001/preview.jpg", "no jpeg"), "view-unreadable",
       "views/000001/preview.jpg", ""},
      {"a view of frames that never were",
       [&] {
         ViewRecord record = test::SampleView(1);
         record.frames = {1, 77};
         record.reference = 2;
         test::Spill(views / "000001/view.json", FormatViewRecord(record));
       },
       "view-journal", "views/000001/view.json", "made from frame 77"},
  };
  const fs::path original = path().string() + ".original";
  fs::copy(path(), original, fs::copy_options::recursive);
  for (const Case& one : cases) {
    one.change();
    const SessionReport report = Check();
    EXPECT_THAT(report.findings, Contains(Damage(one.code, one.file, one.message)))
        << one.what << "\n"
        << Told(report);
    EXPECT_GT(report.damage, 0U) << one.what;
    fs::remove_all(path());
    fs::copy(original, path(), fs::copy_options::recursive);
  }
  fs::remove_all(original);
  EXPECT_THAT(Check().findings, IsEmpty());
}

TEST_F(SessionCheck, APictureOfAnotherSizeThanSessionJsonSaysIsTold) {
  const auto record = test::SampleRecord(4, 4);
  Result<SessionWriter> writer = SessionWriter::Resume(path());
  ASSERT_TRUE(writer);
  ASSERT_TRUE(writer->Append(record, Png(4, 80, 64)));
  EXPECT_THAT(Check().findings,
              Contains(Damage("raw-size", "raw/000004.png", "80x64, expected 64x64")));
}

TEST_F(SessionCheck, QuickReadsNoPixels) {
  std::string picture = test::Slurp(path() / "raw/000001.png");
  picture[picture.size() / 2] ^= 1;
  test::Spill(path() / "raw/000001.png", picture);
  EXPECT_THAT(Check(true).findings, IsEmpty());
  fs::remove(path() / "raw/000002.png");
  EXPECT_THAT(Check(true).findings, Contains(Damage("raw-missing", "raw/000002.png")));
}

TEST_F(SessionCheck, AFlippedBitAnywhereInTheJournalIsFound) {
  const std::string journal = Journal();
  for (std::size_t k = 0; k < journal.size(); ++k) {
    std::string flipped = journal;
    flipped[k] = static_cast<char>(static_cast<unsigned char>(flipped[k]) ^ (1U << (k % 8)));
    SetJournal(flipped);
    EXPECT_THAT(Check(true).findings, ::testing::Not(IsEmpty()))
        << "byte " << k << " of " << journal;
  }
}

TEST_F(SessionCheck, AFlippedBitAnywhereInAPictureIsFound) {
  const std::string picture = test::Slurp(path() / "raw/000001.png");
  for (std::size_t k = 0; k < picture.size(); k += 37) {
    std::string flipped = picture;
    flipped[k] = static_cast<char>(static_cast<unsigned char>(flipped[k]) ^ (1U << (k % 8)));
    test::Spill(path() / "raw/000001.png", flipped);
    EXPECT_THAT(Check().findings, Contains(Damage("raw-checksum", "raw/000001.png"))) << k;
  }
}

TEST_F(SessionCheck, AJournalCutAtAnyByteIsFoundAndMended) {
  const std::string journal = Journal();
  const std::map<std::string, std::string> before = Files();
  for (std::size_t cut = journal.size() - 1; cut > 0; --cut) {
    SCOPED_TRACE(cut);
    fs::remove_all(path() / "lost+found");
    for (int k = 0; k < kFrames; ++k) {
      const std::string file = fmt::format("raw/{:06}.png", k);
      test::Spill(path() / file, before.at(file));
    }
    SetJournal(journal.substr(0, cut));
    EXPECT_GT(Check(true).damage + Check(true).leftovers, 0U);

    RepairOptions options;
    options.apply = true;
    options.check.quick = true;
    const Result<RepairReport> repaired = RepairSession(path(), kNow, options);
    ASSERT_TRUE(repaired) << repaired.error().message;
    ASSERT_THAT(repaired->actions, ::testing::Not(IsEmpty()));
    // Not a byte is lost: cut lines and pictures are somewhere.
    const std::map<std::string, std::string> after = Files();
    const auto torn = after.find("lost+found/frames.jsonl.torn");
    const std::string kept = torn == after.end() ? "" : torn->second;
    const std::string whole = Journal();
    EXPECT_TRUE(whole.empty() || whole.back() == '\n');
    const bool got_newline = journal[cut] == '\n';
    EXPECT_EQ(whole + kept, journal.substr(0, cut + (got_newline ? 1 : 0)));
    for (int k = 0; k < kFrames; ++k) {
      const std::string file = fmt::format("raw/{:06}.png", k);
      const bool stays = after.contains(file);
      EXPECT_EQ(after.at(stays ? file : "lost+found/" + file), before.at(file));
    }
    // Nothing more to do, and a reader has nothing to say.
    const Result<RepairReport> again = RepairSession(path(), kNow, options);
    ASSERT_TRUE(again) << again.error().message;
    EXPECT_THAT(again->actions, IsEmpty());
    EXPECT_EQ(again->found.leftovers, 0U);
    if (!whole.empty()) {
      EXPECT_THAT(ReadSession(path())->journal.warnings, IsEmpty());
    }
  }
}

TEST_F(SessionCheck, APictureWithoutALineIsPutAsideSoThatTheNextFrameDoesNotOverwriteIt) {
  const std::string journal = Journal();
  const std::string picture = test::Slurp(path() / "raw/000003.png");
  SetJournal(journal.substr(0, journal.rfind('\n', journal.size() - 2) + 1));
  const RepairReport report = Repair();
  ASSERT_EQ(report.actions.size(), 1U);
  EXPECT_EQ(report.actions[0].kind, RepairKind::kPutFileAside);
  EXPECT_EQ(report.actions[0].put_to, "lost+found/raw/000003.png");
  {
    Result<SessionWriter> writer = SessionWriter::Resume(path());
    ASSERT_TRUE(writer);
    ASSERT_TRUE(writer->Append(test::SampleRecord(3, 3), Png(77)));
  }
  EXPECT_NE(test::Slurp(path() / "raw/000003.png"), picture);
  EXPECT_EQ(test::Slurp(path() / "lost+found/raw/000003.png"), picture);
  const std::string list = test::Slurp(path() / "lost+found/list.jsonl");
  EXPECT_THAT(list, HasSubstr(R"("from": "raw/000003.png")"));
  EXPECT_THAT(list, HasSubstr(fmt::format(R"("bytes": {})", picture.size())));
  EXPECT_THAT(list, HasSubstr(R"("put_aside_utc_ns": 1767225600000000000)"));
  EXPECT_THAT(list, HasSubstr(R"("crc32c": )"));
}

TEST_F(SessionCheck, APictureWhoseLineCannotBeUsedStaysForItsLineMayBeMendedByHand) {
  std::string journal = Journal();
  journal.replace(journal.find("\"position\""), 10, "\"somewhere\"");
  SetJournal(journal);
  const RepairReport report = Repair();
  EXPECT_THAT(report.actions, IsEmpty());
  EXPECT_THAT(report.remaining, Contains(Damage("line-rejected", "frames.jsonl")));
  EXPECT_TRUE(fs::exists(path() / "raw/000000.png"));
}

TEST_F(SessionCheck, ASecondPictureOfOneNameGetsANameOfItsOwn) {
  for (int k = 0; k < 3; ++k) {
    test::Spill(path() / "raw/000004.png", fmt::format("picture {}", k));
    Repair();
  }
  EXPECT_EQ(test::Slurp(path() / "lost+found/raw/000004.png"), "picture 0");
  EXPECT_EQ(test::Slurp(path() / "lost+found/raw/000004.png.1"), "picture 1");
  EXPECT_EQ(test::Slurp(path() / "lost+found/raw/000004.png.2"), "picture 2");
}

TEST_F(SessionCheck, WithoutApplyNothingIsWritten) {
  SetJournal(Journal() + "{\"frame\": 4, \"pos");
  test::Spill(path() / "raw/000004.png.tmp", "half");
  test::Spill(path() / "views/.000004.tmp/radiance.exr", "half");
  fs::remove(path() / "views/000002/radiance.exr");
  const auto before = Files();
  const RepairReport report = Repair(false);
  EXPECT_EQ(report.actions.size(), 4U);
  EXPECT_EQ(Files(), before);
  EXPECT_TRUE(fs::exists(path() / "views/.000004.tmp"));
}

TEST_F(SessionCheck, NothingCapturedIsTouchedByARepair) {
  SetJournal(Journal() + "{\"frame\": 4, \"pos");
  test::Spill(path() / "raw/000004.png", "of no line");
  std::string damaged = test::Slurp(path() / "raw/000001.png");
  damaged[100] ^= 1;
  test::Spill(path() / "raw/000001.png", damaged);
  std::map<std::string, std::pair<ino_t, std::int64_t>> before;
  const auto look = [&](const std::string& file) {
    struct stat status {};
    EXPECT_EQ(::stat((path() / file).c_str(), &status), 0) << file;
    return std::pair{status.st_ino,
                     std::int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec};
  };
  std::vector<std::string> files = {"session.json"};
  for (int k = 0; k < kFrames; ++k) files.push_back(fmt::format("raw/{:06}.png", k));
  for (const std::string& file : files) before[file] = look(file);
  const RepairReport report = Repair();
  EXPECT_THAT(report.remaining, Contains(Damage("raw-checksum", "raw/000001.png")));
  for (const std::string& file : files) EXPECT_EQ(look(file), before[file]) << file;
  EXPECT_EQ(test::Slurp(path() / "raw/000001.png"), damaged);
}

TEST_F(SessionCheck, AHalfViewIsRemovedWhenItCanBeMadeAgainAndPutAsideWhenNot) {
  fs::remove(path() / "views/000001/view.json");
  fs::remove(path() / "views/000002/disparity.exr");
  std::string damaged = test::Slurp(path() / "raw/000002.png");
  damaged[100] ^= 1;
  test::Spill(path() / "raw/000002.png", damaged);
  test::Spill(path() / "views/.000003.tmp/radiance.exr", "half");
  Repair();
  EXPECT_FALSE(fs::exists(path() / "views/000001"));
  EXPECT_FALSE(fs::exists(path() / "views/000002"));
  EXPECT_FALSE(fs::exists(path() / "views/.000003.tmp"));
  EXPECT_TRUE(fs::exists(path() / "lost+found/views/000002/radiance.exr"));
  EXPECT_FALSE(fs::exists(path() / "lost+found/views/000001"));
  EXPECT_TRUE(fs::exists(path() / "views/000003/radiance.exr"));
}

TEST_F(SessionCheck, WhatAWriterIsDoingIsNoLeftoverAndNoRepair) {
  Result<SessionWriter> writer = SessionWriter::Resume(path());
  ASSERT_TRUE(writer);
  test::Spill(path() / "raw/000004.png.tmp", "half");
  test::Spill(path() / "raw/000004.png", "not journaled yet");
  SetJournal(Journal() + "{\"frame\": 4, \"pos");
  const SessionReport report = Check();
  EXPECT_TRUE(report.is_being_written);
  EXPECT_THAT(report.findings, IsEmpty()) << Told(report);
  RepairOptions options;
  options.apply = true;
  const Result<RepairReport> refused = RepairSession(path(), kNow, options);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kTemporary);
}

TEST_F(SessionCheck, ALineThatLostItsNewlineGetsIt) {
  const std::string journal = Journal();
  SetJournal(journal.substr(0, journal.size() - 1));
  EXPECT_THAT(Check().findings,
              Contains(Finding(FindingKind::kLeftover, "line-unterminated", "frames.jsonl")));
  Repair();
  EXPECT_EQ(Journal(), journal);
}

TEST_F(SessionCheck, ThatPositionsHaveNoViewIsWorthKnowing) {
  fs::remove_all(path() / "views/000002");
  const SessionReport report = Check();
  EXPECT_EQ(report.damage, 0U);
  EXPECT_THAT(report.findings, Contains(Finding(FindingKind::kNote, "views-missing", "views",
                                                "1 of 4 positions have no view, the first is 2")));
}

TEST_F(SessionCheck, WhatDoesNotBelongIsWorthKnowing) {
  test::Spill(path() / "raw/thumbs.db", "x");
  test::Spill(path() / "notes.txt", "x");
  test::Spill(path() / "views/000001/more.txt", "x");
  const SessionReport report = Check();
  EXPECT_EQ(report.damage + report.leftovers, 0U);
  for (const char* file : {"raw/thumbs.db", "notes.txt", "views/000001/more.txt"}) {
    EXPECT_THAT(report.findings, Contains(Field(&SessionFinding::file, file)));
  }
  const auto before = Files();
  Repair();
  EXPECT_EQ(Files(), before);
}

TEST_F(SessionCheck, FindingsBeyondTheLimitAreCounted) {
  for (int k = 0; k < 20; ++k) test::Spill(path() / fmt::format("raw/{:06}.png", 10 + k), "x");
  SessionCheckOptions options;
  options.max_findings = 5;
  const Result<SessionReport> report = CheckSession(path(), options);
  ASSERT_TRUE(report);
  EXPECT_EQ(report->findings.size(), 5U);
  EXPECT_EQ(report->damage, 20U);
}

TEST_F(SessionCheck, PicturesOfALostJournalStayWhereTheyAre) {
  fs::remove(path() / "frames.jsonl");
  const auto before = Files();
  const RepairReport report = Repair();
  EXPECT_THAT(report.actions, IsEmpty());
  EXPECT_THAT(report.remaining, Contains(Damage("journal-unreadable", "frames.jsonl")));
  EXPECT_EQ(Files(), before);
}

TEST(SessionCheckErrors, ADirectoryThatIsNoSessionIsAnError) {
  const test::TemporaryDirectory directory;
  const Result<SessionReport> report = CheckSession(directory.path());
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().kind, ErrorKind::kNoInput);
  EXPECT_THAT(report.error().message, HasSubstr("expected a session directory"));
  EXPECT_FALSE(CheckSession(directory.path() / "none"));
}

}  // namespace
}  // namespace omnihdr::session_check_test
