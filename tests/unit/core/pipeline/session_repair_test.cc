// What a repaired session is for: it processes, to the views of an undisturbed run.
#include "core/session/session_repair.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "core/session/journal.h"
#include "core/session/session_check.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::session_repair_test {
namespace {

namespace fs = std::filesystem;
using testing::FileText;
using testing::SameBytes;
using testing::ViewBytes;
using testing::WriteText;

constexpr int kPositions = 4;

testing::SessionPlan Plan() {
  testing::SessionPlan plan;
  plan.projection = Projection::Equirectangular(128, 64);
  plan.poses = testing::GentleBend(kPositions, 0.2);
  plan.with_prior_poses = true;
  return plan;
}

// The undisturbed session with its views, made once.
const fs::path& Whole() {
  static const testing::TemporaryDirectory directory;
  static const fs::path session = directory.path() / "whole";
  if (!fs::exists(session)) {
    testing::WriteSession(session, Plan(), testing::RenderFrames(Plan()));
    testing::ProcessAll(session);
  }
  return session;
}

SessionReport Check(const fs::path& session) {
  Result<SessionReport> report = CheckSession(session);
  EXPECT_TRUE(report) << report.error().message;
  return report ? *report : SessionReport{};
}

RepairReport Repair(const fs::path& session) {
  RepairOptions options;
  options.apply = true;
  Result<RepairReport> report = RepairSession(session, UtcTime::FromNanoseconds(0), options);
  EXPECT_TRUE(report) << report.error().message;
  return report ? *report : RepairReport{};
}

// One thing that power loss or a bad disk does. `loses`: captured data are gone by it.
struct Blow {
  std::string what;
  bool loses = false;
};

class Blows {
 public:
  Blows(fs::path session, std::uint32_t seed) : session_(std::move(session)), random_(seed) {}

  Blow Any() {
    const std::string frame = fmt::format("{:06}", Below(kPositions));
    const fs::path view = session_ / "views" / frame;
    switch (Below(9)) {
      case 0:
        WriteText(session_ / "frames.jsonl",
                  FileText(session_ / "frames.jsonl") + R"({"frame": 4, "posi)");
        return {"a torn line"};
      case 1: {
        std::string journal = FileText(session_ / "frames.jsonl");
        const std::size_t last = journal.rfind('\n', journal.size() - 2) + 1;
        journal.resize(last + Below(journal.size() - last));
        WriteText(session_ / "frames.jsonl", journal);
        return {"the last line is cut", true};
      }
      case 2:
        WriteText(session_ / "raw/000004.png.tmp", "half");
        return {"an unfinished picture"};
      case 3:
        fs::create_directories(session_ / "views" / ("." + frame + ".tmp"));
        WriteText(session_ / "views" / ("." + frame + ".tmp") / "radiance.exr", "half");
        return {"an unfinished view"};
      case 4: {
        const std::vector<std::string> files = {"view.json", "radiance.exr", "disparity.exr",
                                                "preview.jpg"};
        fs::remove(view / files[Below(files.size())]);
        return {"a file of a view is gone"};
      }
      case 5: {
        const fs::path file = view / "radiance.exr";
        std::error_code error;
        if (fs::exists(file)) fs::resize_file(file, Below(fs::file_size(file)), error);
        return {"a view is cut"};
      }
      case 6:
        Flip(session_ / "raw" / (frame + ".png"));
        return {"a bit of a picture is flipped", true};
      case 7:
        fs::remove(session_ / "raw" / (frame + ".png"));
        return {"a picture is gone", true};
      default:
        Flip(session_ / "frames.jsonl");
        return {"a bit of the journal is flipped", true};
    }
  }

 private:
  std::size_t Below(std::size_t end) {
    return end == 0 ? 0 : std::uniform_int_distribution<std::size_t>(0, end - 1)(random_);
  }
  void Flip(const fs::path& path) {
    if (!fs::exists(path)) return;
    std::string text = FileText(path);
    if (text.empty()) return;
    const std::size_t at = Below(text.size());
    text[at] = static_cast<char>(static_cast<unsigned char>(text[at]) ^ (1U << Below(8)));
    WriteText(path, text);
  }

  const fs::path session_;
  std::mt19937 random_;
};

TEST(SessionRepair, WhatPowerLossAndBadDisksDoIsFoundAndWhatIsLeftProcesses) {
  const std::map<std::string, std::string> undisturbed = ViewBytes(Whole());
  ASSERT_FALSE(undisturbed.empty());
  int lossless = 0;
  for (std::uint32_t seed = 0; seed < 60; ++seed) {
    const testing::TemporaryDirectory directory;
    const fs::path session = directory.path() / "s";
    fs::copy(Whole(), session, fs::copy_options::recursive);
    Blows blows(session, seed);
    std::string what = fmt::format("seed {}", seed);
    bool loses = false;
    for (std::uint32_t k = 0; k <= seed % 3; ++k) {
      const Blow blow = blows.Any();
      what += "; " + blow.what;
      loses = loses || blow.loses;
    }
    SCOPED_TRACE(what);
    const SessionReport found = Check(session);
    EXPECT_GT(found.findings.size(), 0U);

    Repair(session);
    const RepairReport again = Repair(session);
    EXPECT_TRUE(again.actions.empty());
    EXPECT_EQ(again.found.leftovers, 0U);
    const testing::Processed processed = testing::ProcessAll(session);
    EXPECT_GT(processed.counts.views_complete, 0);
    const SessionReport after = Check(session);
    EXPECT_EQ(after.leftovers, 0U);
    for (const SessionFinding& finding : after.findings) {
      // A view made from a frame that is lost since is kept: it is all there is of it.
      EXPECT_TRUE(!finding.file.starts_with("views/") || finding.kind == FindingKind::kNote ||
                  finding.code == "view-journal")
          << finding.file << ": " << finding.message;
    }
    if (loses) continue;
    ++lossless;
    EXPECT_EQ(after.damage, 0U);
    EXPECT_TRUE(SameBytes(ViewBytes(session), undisturbed));
  }
  EXPECT_GT(lossless, 10);
}

TEST(SessionRepair, ViewsOfAProcessedSessionHaveNothingToTell) {
  const SessionReport report = Check(Whole());
  std::string told;
  for (const SessionFinding& finding : report.findings) {
    told += finding.file + ": " + finding.message + "\n";
  }
  EXPECT_EQ(told, "");
  EXPECT_EQ(report.views, std::size_t{kPositions});
}

}  // namespace
}  // namespace omnihdr::session_repair_test
