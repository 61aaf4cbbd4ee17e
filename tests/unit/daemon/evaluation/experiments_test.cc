#include "daemon/evaluation/experiments.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "daemon/evaluation/experiments_bench.h"
#include "daemon/evaluation/experiments_matrix.h"
#include "daemon/evaluation/experiments_parts.h"
#include "daemon/evaluation/experiments_report.h"
#include "daemon/evaluation/suite.h"
#include "drivers/sim/simulation.h"
#include "tests/support/small_session.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::experiments_test {
namespace {

namespace fs = std::filesystem;
using experiments::DataMatrix;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

constexpr int kPositions = 5;
constexpr int kExposures = 7;

// Two thirds of a stop between exposures, seven of them: steps of about 0.8 and 1.6 stops about #3.
sim::SimulateOptions SmallMatrix() {
  sim::SimulateOptions simulate;
  simulate.simulation.width = 256;
  simulate.simulation.projection = ProjectionKind::kCylindrical;
  simulate.simulation.samples = 1;
  simulate.simulation.scene = sim::SceneKind::kYard;  // rich in features
  simulate.positions = kPositions;
  simulate.spacing_m = 0.2;
  simulate.bracket.count = kExposures;
  simulate.bracket.frames_per_position = kExposures;
  simulate.bracket.step = Stops{2.0 / 3};
  simulate.bracket.start = ExposureTime::Seconds(MiddleExposure(simulate.simulation)) + Stops{-2.0};
  simulate.created = "2026-01-01T00:00:00Z";
  return simulate;
}

PipelineOptions SmallPipeline() {
  PipelineOptions options;
  options.stereo_width = 128;
  options.labels = 24;
  return options;
}

// One matrix for all tests: rendering is the slow part.
class Experiments : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    directory_ = new testing::TemporaryDirectory;
    const Status written = sim::WriteSimulatedSession(Matrix(), SmallMatrix(), {});
    ASSERT_TRUE(written) << written.error().message;
  }
  static void TearDownTestSuite() {
    delete directory_;
    directory_ = nullptr;
  }
  static fs::path Matrix() { return directory_->path() / "matrix"; }

  // The report's JSON; the error's message when it failed.
  static Json Run(const std::vector<std::string>& names, const fs::path& matrix,
                  const fs::path& out) {
    ExperimentOptions options;
    options.names = names;
    options.matrix = matrix;
    options.pipeline = SmallPipeline();
    const Result<ExperimentReport> report = RunExperiments(options, out, {});
    if (!report) return Json(report.error().message);
    EXPECT_EQ(testing::FileText(out / "experiments.json"), report->json);
    EXPECT_EQ(testing::FileText(out / "experiments.md"), report->markdown);
    return Json::parse(report->json);
  }
  // A copy of the matrix's journal lines that `keep` wants; pictures are linked.
  static fs::path Thinned(const fs::path& to, const std::function<bool(int line)>& keep) {
    fs::create_directories(to);
    fs::create_directory_symlink(Matrix() / "raw", to / "raw");
    fs::copy_file(Matrix() / "session.json", to / "session.json");
    std::istringstream lines(testing::FileText(Matrix() / "frames.jsonl"));
    std::string kept;
    int number = 0;
    for (std::string line; std::getline(lines, line); ++number) {
      if (keep(number)) kept += line + "\n";
    }
    testing::WriteText(to / "frames.jsonl", kept);
    return to;
  }
  static const Json& Experiment(const Json& report, const std::string& name) {
    for (const Json& each : report.at("experiments")) {
      if (each.at("name") == name) return each;
    }
    ADD_FAILURE() << name;
    return report;
  }

  testing::TemporaryDirectory out_;

 private:
  static inline testing::TemporaryDirectory* directory_ = nullptr;
};

TEST_F(Experiments, AMatrixHasEveryExposureAtEveryPositionAndCountsFromTheMiddle) {
  const Result<std::unique_ptr<DataMatrix>> opened = DataMatrix::Open(Matrix(), SmallPipeline());
  ASSERT_TRUE(opened) << opened.error().message;
  const DataMatrix& matrix = **opened;
  EXPECT_EQ(matrix.positions(), kPositions);
  EXPECT_EQ(matrix.exposures(), kExposures);
  ASSERT_EQ(matrix.middle(), 3);
  EXPECT_NEAR(matrix.StopsFromMiddle(0), -2.0, 1e-6);
  EXPECT_EQ(matrix.AtStops(0.8), 4);   // 0.67
  EXPECT_EQ(matrix.AtStops(-1.6), 1);  // 1.33
  EXPECT_EQ(matrix.AtStops(3.0), std::nullopt);
  EXPECT_EQ(matrix.NearestTo(3.0), 6);
  EXPECT_EQ(Value(matrix.frame(2, 4).position), 2);
  ASSERT_TRUE(matrix.reference());
  const Result<std::optional<Pose>> pose = matrix.TruePose(1);
  ASSERT_TRUE(pose && *pose);
}

TEST_F(Experiments, AnExposureThatOnePositionLacksIsLeftOut) {
  // Of position 2 the shortest frame.
  const fs::path thinned =
      Thinned(out_.path() / "thinned", [](int line) { return line != 2 * kExposures; });
  const Result<std::unique_ptr<DataMatrix>> matrix = DataMatrix::Open(thinned, SmallPipeline());
  ASSERT_TRUE(matrix) << matrix.error().message;
  EXPECT_EQ((*matrix)->exposures(), kExposures - 1);
  EXPECT_EQ((*matrix)->positions(), kPositions);
}

TEST_F(Experiments, ASessionWithOneExposureAPositionIsNoMatrix) {
  const fs::path drive = Thinned(out_.path() / "drive",
                                 [](int line) { return line % kExposures == line / kExposures; });
  EXPECT_THAT(Run({"counts"}, drive, out_.path() / "out").get<std::string>(),
              HasSubstr("1 exposures at most at one position and 0 that every position has"));
}

TEST(ExperimentOrders, AreThoseOfTheThesis) {
  const experiments::Steps steps = {1.6, 2, 7, 12};
  EXPECT_THAT(experiments::OrderedExposures(steps, experiments::Order::kSawTooth, 5),
              ElementsAre(2, 7, 12, 2, 7));
  EXPECT_THAT(experiments::OrderedExposures(steps, experiments::Order::kTriangle, 6),
              ElementsAre(2, 7, 12, 7, 2, 7));
}

TEST_F(Experiments, EveryExperimentRunsOnAMatrixAndFindsWhatHasToBe) {
  const Json report = Run({}, Matrix(), out_.path());
  ASSERT_TRUE(report.is_object()) << report;
  for (const std::string& name : ExperimentNames()) {
    const Json& experiment = Experiment(report, name);
    EXPECT_TRUE(experiment.at("run")) << experiment.at("notes");
    EXPECT_FALSE(experiment.at("tables").empty()) << name;
    for (const Json& figure : experiment.at("figures")) {
      EXPECT_TRUE(fs::exists(out_.path() / figure.at("file").get<std::string>())) << figure;
    }
  }
  const auto rows = [&report](const char* name, std::size_t table) {
    return Experiment(report, name).at("tables").at(table).at("rows");
  };

  // The longer the exposure the fewer pixels are under-exposed and the more over-exposed.
  const Json counts = rows("counts", 0);
  ASSERT_EQ(counts.size(), static_cast<std::size_t>(kExposures));
  EXPECT_GE(counts.front().at("under, %"), counts.back().at("under, %"));
  EXPECT_LT(counts.front().at("over, %"), counts.back().at("over, %"));

  // A view of three exposures is nearer to their temporal HDR than one frame, and its range is.
  for (const std::size_t table : {0U, 1U}) {
    const Json mean = rows("step", table).back();
    EXPECT_GT(mean.at("SSIM ours"), mean.at("SSIM own frame"));
    EXPECT_LT(mean.at("RMSE to truth temporal HDR"), mean.at("RMSE to truth own frame"));
  }
  for (const Json& row : rows("range", 0)) {
    EXPECT_GE(row.at("temporal stops").get<double>(), row.at("frame stops").get<double>() - 0.3);
  }
  const Json ranges = rows("temporal-range", 0);
  EXPECT_GT(ranges.front().at("stops"), ranges.back().at("stops"));
  EXPECT_EQ(ranges.front().at("SSIM to the first"), 1.0);

  // Pixel by pixel forward leaves cracks that closing surfaces mends; backward reads through the
  // target's own map. Which of these two leaves less depends on the scene: here half a percent.
  const Json warped = rows("warp", 0);
  const auto hole = [&warped](std::size_t row) {
    return warped.at(row).at("without a value, %").get<double>();
  };
  for (const std::size_t source : {0U, 1U}) {
    for (const std::size_t closed : {2U, 4U}) {
      EXPECT_GT(hole(source), 5.0 * hole(closed + source));
      EXPECT_LT(hole(closed + source), 1.0);
    }
  }

  // The same pictures give the same poses: nothing in the order's own way is compared with itself.
  for (const Json& row : rows("order", 0)) {
    EXPECT_LT(row.at("rotation against truth (degrees)"), 1.0) << row;
  }
  // At no difference of exposure most matches remain.
  const Json sweep = rows("features", 2);
  EXPECT_GE(sweep.at(3).at("agreeing with one motion"), sweep.at(0).at("agreeing with one motion"));
  EXPECT_EQ(rows("outdoor", 1).at(1).at("position 5, #7"), 0.99);
  EXPECT_EQ(rows("outdoor", 1).at(1).at("here"), "not run");
}

TEST_F(Experiments, EqualInputsGiveEqualReports) {
  const std::vector<std::string> names = {"temporal-range", "features"};
  EXPECT_EQ(Run(names, Matrix(), out_.path() / "a"), Run(names, Matrix(), out_.path() / "b"));
  EXPECT_EQ(testing::FileText(out_.path() / "a" / "features.png"),
            testing::FileText(out_.path() / "b" / "features.png"));
}

TEST_F(Experiments, ASessionWithoutTruthIsComparedWithItsTemporalHdrAlone) {
  const fs::path unknown = Thinned(out_.path() / "unknown", [](int) { return true; });
  Json info = Json::parse(testing::FileText(unknown / "session.json"));
  ASSERT_EQ(info.erase("simulation"), 1U);
  fs::remove(unknown / "session.json");
  testing::WriteText(unknown / "session.json", info.dump());
  const Json report = Run({"temporal-range"}, unknown, out_.path() / "out");
  ASSERT_TRUE(report.is_object()) << report;
  EXPECT_TRUE(report.at("matrices").at(0).at("scene").is_null());
  const Json row = Experiment(report, "temporal-range").at("tables").at(0).at("rows").at(1);
  EXPECT_TRUE(row.at("RMSE to truth, where they can measure").is_null());
  EXPECT_GT(row.at("SSIM to the first"), 0.5);
  EXPECT_THAT(testing::FileText(out_.path() / "out" / "experiments.md"),
              HasSubstr("nothing is compared with the truth"));
}

TEST_F(Experiments, StepsThatAMatrixHasNotAreSaidAndNotRun) {
  // Every third exposure: two stops apart.
  const fs::path coarse =
      Thinned(out_.path() / "coarse", [](int line) { return line % kExposures % 3 == 0; });
  const Json report = Run({"order"}, coarse, out_.path() / "out");
  ASSERT_TRUE(report.is_object()) << report;
  const Json& order = Experiment(report, "order");
  EXPECT_THAT(order.at("notes").at(0).get<std::string>(),
              HasSubstr("no exposures 0.8 stops apart"));
  for (const Json& row : order.at("tables").at(1).at("rows")) {
    EXPECT_EQ(row.at("step"), 1.6);  // which two stops stand for
  }
}

TEST_F(Experiments, AnUnknownNameIsRefusedWithThoseThereAre) {
  EXPECT_THAT(Run({"steps"}, Matrix(), out_.path()).get<std::string>(),
              HasSubstr("--experiments: steps: no such experiment, expected all or of counts, "));
}

TEST(ExperimentReport, WhatWasNotRunIsSaidAndMissingNumbersAreNull) {
  experiments::Section run;
  run.name = "one";
  run.title = "One";
  run.found = "so much";
  run.tables.push_back({"Numbers",
                        {"what", "value", "other"},
                        {{experiments::Words("a"), experiments::Number(0.123456, 3),
                          experiments::Number(std::nullopt, 3)}}});
  experiments::Section skipped;
  skipped.name = "two";
  skipped.title = "Two";
  skipped.notes = {"there is no such exposure"};
  const experiments::MatrixNote matrix = {"here", "here", "", 3, {0.001, 0.002, 0.004}, 1};
  const std::string markdown = experiments::FormatMarkdown({matrix}, {run, skipped});
  EXPECT_THAT(markdown, HasSubstr("| what | value | other |\n| --- | ---: | --- |\n"
                                  "| a | 0.123 | - |"));
  EXPECT_THAT(markdown, HasSubstr("| [Two](#two) |  | not run, see there |"));
  EXPECT_THAT(markdown, HasSubstr("- there is no such exposure"));
  const Json json = Json::parse(experiments::FormatJson({matrix}, {run, skipped}));
  EXPECT_EQ(json["experiments"][0]["tables"][0]["rows"][0]["value"], 0.123456);
  EXPECT_TRUE(json["experiments"][0]["tables"][0]["rows"][0]["other"].is_null());
  EXPECT_FALSE(json["experiments"][1]["run"]);
  EXPECT_EQ(experiments::FormatSummary({run, skipped}),
            "one: so much\ntwo: there is no such exposure\n");
}

TEST(LastUsed, KeepsWhatWasAskedForLast) {
  experiments::LastUsed<int, std::string> kept(2);
  kept.Put(1, "one");
  kept.Put(2, "two");
  ASSERT_TRUE(kept.Find(1));
  kept.Put(3, "three");
  EXPECT_EQ(*kept.Find(1), "one");
  EXPECT_EQ(kept.Find(2), nullptr);
  EXPECT_EQ(*kept.Find(3), "three");
}

}  // namespace
}  // namespace omnihdr::experiments_test
