#include "daemon/evaluation/evaluation.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/session/journal.h"
#include "core/session/view_writer.h"
#include "daemon/evaluation/contact_sheet.h"
#include "drivers/sim/movers.h"
#include "drivers/sim/world.h"

namespace omnihdr::evaluation_test {
namespace {

constexpr int kWidth = 128;
constexpr int kHeight = 64;
constexpr double kK = 2.0;  // how.json: a frame's value is 255·k·radiance·exposure
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr std::array<double, 3> kExposures = {0.05, 0.2, 2.0};

double SrgbToLinear(double v) {
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

// A photograph with a smooth pattern, the same at every position.
Image<std::uint8_t> Photo() {
  Image<std::uint8_t> photo(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double wave = std::sin(2.0 * std::numbers::pi * x / kWidth) * std::cos(0.1 * y);
      for (int c = 0; c < 3; ++c) {
        photo.at(x, y, c) = static_cast<std::uint8_t>(std::lround(140.0 + 75.0 * wave + 5.0 * c));
      }
    }
  }
  return photo;
}

// Its radiance in our unit.
Image<float> Truth() {
  const Image<std::uint8_t> photo = Photo();
  Image<float> truth(kWidth, kHeight, 3);
  for (std::size_t i = 0; i < truth.size(); ++i) {
    truth.data()[i] =
        static_cast<float>(255.0 * kK / 128.0 * SrgbToLinear(photo.data()[i] / 255.0));
  }
  return truth;
}

struct View {
  Image<float> radiance;
  Image<float> disparity;
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  Pose pose = {};
  bool metric = false;
  std::vector<std::uint64_t> frames = {};  // empty: its own alone
  std::string resume_json = {};
  Image<float> sources = {};
};

class Evaluation : public ::testing::Test {
 protected:
  void SetUp() override {
    directory_ = std::filesystem::path(::testing::TempDir()) /
                 ("evaluation_" +
                  std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()));
    std::filesystem::remove_all(directory_);
    info_.created = "2026-01-01T00:00:00Z";
    info_.camera.width = kWidth;
    info_.camera.height = kHeight;
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  // A session of three positions, one exposure each, of one unmoving scene; `truth` is radiance.
  void WriteSession(const Image<float>& truth, const std::vector<std::string>& truth_json = {}) {
    auto writer = SessionWriter::Create(directory_, info_);
    ASSERT_TRUE(writer) << writer.error().message;
    for (std::size_t i = 0; i < kExposures.size(); ++i) {
      Image<std::uint8_t> frame(kWidth, kHeight, 3);
      for (std::size_t p = 0; p < frame.size(); ++p) {
        const double value = 128.0 * static_cast<double>(truth.data()[p]) * kExposures[i];
        frame.data()[p] = static_cast<std::uint8_t>(std::lround(std::min(value, 255.0)));
      }
      const auto png = EncodePng(frame.view());
      ASSERT_TRUE(png);
      FrameRecord record;
      record.frame = FrameId{i};
      record.position = PositionId{static_cast<std::int64_t>(i)};
      record.file = fmt::format("raw/{:06}.png", i);
      record.exposure.time = ExposureTime::Seconds(kExposures[i]);
      if (i < truth_json.size()) record.truth_json = truth_json[i];
      const Status appended = writer->Append(record, *png);
      ASSERT_TRUE(appended) << appended.error().message;
    }
  }

  void WritePhotographs(
      const std::string& how = R"({"k": 2.0, "contrast": 1.0, "gain": [1, 1, 1]})") {
    std::filesystem::create_directories(directory_ / "reference");
    ASSERT_TRUE(WriteFileAtomic(directory_ / "reference" / "how.json", how));
    const auto png = EncodePng(Photo().view());  // read by content, so that nothing is lost to JPEG
    ASSERT_TRUE(png);
    for (std::size_t i = 0; i < kExposures.size(); ++i) {
      ASSERT_TRUE(WriteFileAtomic(directory_ / "reference" / fmt::format("{:06}.jpg", i), *png));
    }
  }

  void WriteViewOf(int position, const View& view) {
    ViewRecord record;
    record.position = PositionId{position};
    record.reference = static_cast<std::uint64_t>(position);
    record.frames = {record.reference};
    if (!view.frames.empty()) record.frames = view.frames;
    record.resume_json = view.resume_json;
    record.mode = "spatiotemporal";
    record.orientation = view.orientation;
    record.pose = view.pose;
    record.metric_scale = view.metric;
    const Status written =
        WriteView(directory_ / "views", record.position, false,
                  [&](const std::filesystem::path& folder) -> Status {
                    std::vector<ExrChannel> channels;
                    for (int c = 0; c < 3; ++c) {
                      channels.push_back({std::string(1, "RGB"[c]), view.radiance.view(),
                                          ExrPixelType::kFloat, c});
                    }
                    if (!view.sources.empty()) {
                      channels.push_back({"sources", view.sources.view(), ExrPixelType::kHalf, 0});
                    }
                    OMNIHDR_TRY(WriteExr(folder / "radiance.exr", channels, {}));
                    if (!view.disparity.empty()) {
                      OMNIHDR_TRY(WriteExr(
                          folder / "disparity.exr",
                          {{"disparity", view.disparity.view(), ExrPixelType::kFloat, 0}}, {}));
                    }
                    return WriteFileAtomic(folder / "view.json", FormatViewRecord(record));
                  });
    ASSERT_TRUE(written) << written.error().message;
  }

  SessionScore Evaluate(const EvaluationOptions& options = {}) {
    auto score = EvaluateSession(directory_, options, {});
    EXPECT_TRUE(score) << score.error().message;
    return score ? *std::move(score) : SessionScore{};
  }

  std::filesystem::path directory_;
  SessionInfo info_;
};

TEST_F(Evaluation, AViewThatIsTheTruthHasNoErrorAndAnOwnFrameThatClippedHasOne) {
  WriteSession(Truth());
  WritePhotographs();
  for (int i = 0; i < 3; ++i) WriteViewOf(i, {Truth(), {}});
  const SessionScore score = Evaluate();
  EXPECT_EQ(score.reference, "photographs");
  ASSERT_EQ(score.positions.size(), 3U);
  for (const PositionScore& position : score.positions) {
    ASSERT_TRUE(position.view);
    EXPECT_NEAR(position.view->errors.log10_rmse, 0.0, 1e-5);
    EXPECT_NEAR(position.view->errors.scale, 1.0, 1e-4);
    EXPECT_NEAR(position.view->ssim, 1.0, 1e-6);
    EXPECT_NEAR(position.covered, 1.0, 1e-12);
    EXPECT_FALSE(position.disparity);
  }
  EXPECT_LT(score.positions[0].own_frame->errors.log10_rmse, 0.03);  // only quantised
  EXPECT_GT(score.positions[2].own_frame->errors.log10_rmse, 0.1);   // clipped
  ASSERT_TRUE(score.mean);
  EXPECT_EQ(score.mean->positions, 3);
  EXPECT_NEAR(score.improvement(), 1.0, 1e-3);
}

TEST_F(Evaluation, AViewWithAnotherOrientationIsComparedInThatOrientation) {
  WriteSession(Truth());
  WritePhotographs();
  // A quarter turn to the left: what the view shows at column x is what the camera shows at x −
  // W/4.
  View view{Image<float>(kWidth, kHeight, 3), {}};
  view.orientation =
      Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2.0, Eigen::Vector3d::UnitZ()));
  const Image<float> truth = Truth();
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c)
        view.radiance.at(x, y, c) = truth.at((x + 3 * kWidth / 4) % kWidth, y, c);
    }
  }
  WriteViewOf(0, view);
  const SessionScore score = Evaluate();
  ASSERT_TRUE(score.positions[0].view);
  EXPECT_LT(score.positions[0].view->errors.log10_rmse, 1e-4);
  EXPECT_LT(score.positions[0].own_frame->errors.log10_rmse, 0.03);
}

TEST_F(Evaluation, WhatAViewLeavesUnknownIsCountedAsNotCovered) {
  WriteSession(Truth());
  WritePhotographs();
  View view{Truth(), {}};
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth / 2; ++x) view.radiance.at(x, y, 1) = kNaN;
  }
  WriteViewOf(1, view);
  const SessionScore score = Evaluate();
  ASSERT_TRUE(score.positions[1].view);
  EXPECT_GT(score.positions[1].covered, 0.3);
  EXPECT_LT(score.positions[1].covered, 0.7);
  EXPECT_NEAR(score.positions[1].view->errors.log10_rmse, 0.0, 1e-5);
}

TEST_F(Evaluation, TheMaskedBottomDoesNotCount) {
  WriteSession(Truth());
  WritePhotographs();
  View view{Truth(), {}};
  for (int y = kHeight * 3 / 4; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) view.radiance.at(x, y, 0) *= 5.0F;
  }
  WriteViewOf(0, view);
  EXPECT_GT(Evaluate().positions[0].view->errors.log10_rmse, 0.02);
  EvaluationOptions options;
  options.mask.ignore_bottom = 0.30;
  EXPECT_NEAR(Evaluate(options).positions[0].view->errors.log10_rmse, 0.0, 1e-5);
}

TEST_F(Evaluation, APositionWithoutAViewIsListedAsIncomplete) {
  WriteSession(Truth());
  WritePhotographs();
  WriteViewOf(1, {Truth(), {}});
  const SessionScore score = Evaluate();
  EXPECT_EQ(score.complete, 1);
  EXPECT_FALSE(score.positions[0].complete);
  EXPECT_TRUE(score.positions[1].complete);
  EXPECT_NE(FormatScoreTable(score).find("1 of 3 positions have their view"), std::string::npos);
}

TEST_F(Evaluation, WithoutAnythingToCompareWithOnlyTheViewsAreListed) {
  WriteSession(Truth());
  WriteViewOf(0, {Truth(), {}});
  const SessionScore score = Evaluate();
  EXPECT_EQ(score.reference, "");
  EXPECT_FALSE(score.mean);
  EXPECT_FALSE(score.positions[0].view);
  EXPECT_EQ(score.complete, 1);
}

TEST_F(Evaluation, JsonHasANumberForEveryPositionAndNullForWhatIsNotKnown) {
  WriteSession(Truth());
  WritePhotographs();
  WriteViewOf(0, {Truth(), {}});
  const auto json = nlohmann::json::parse(FormatScoreJson(Evaluate()));
  EXPECT_EQ(json["positions"].size(), 3U);
  EXPECT_TRUE(json["positions"][0]["view"]["log10_rmse"].is_number());
  EXPECT_FALSE(json["positions"][1].contains("view"));
  EXPECT_TRUE(json["mean"]["disparity_bad1"].is_null());
}

TEST_F(Evaluation, AMaskOfAnotherSizeIsRefusedByName) {
  WriteSession(Truth());
  const auto png = EncodePng(Image<std::uint8_t>(8, 8, 1, 255).view());
  ASSERT_TRUE(WriteFileAtomic(directory_ / "mask.png", *png));
  EvaluationOptions options;
  options.mask.file = directory_ / "mask.png";
  const auto score = EvaluateSession(directory_, options, {});
  ASSERT_FALSE(score);
  EXPECT_NE(score.error().message.find("mask.png: 8x8 pixels, expected the frames' size 128x64"),
            std::string::npos)
      << score.error().message;
}

TEST_F(Evaluation, AHowJsonThatIsWrongIsRefusedByKey) {
  WriteSession(Truth());
  WritePhotographs(R"({"k": -1, "contrast": 1.0, "gain": [1, 1, 1]})");
  const auto score = EvaluateSession(directory_, {}, {});
  ASSERT_FALSE(score);
  EXPECT_NE(score.error().message.find("how.json: k: -1, expected a positive number"),
            std::string::npos)
      << score.error().message;
}

TEST_F(Evaluation, ASimulatedSessionIsComparedWithTheRenderedTruth) {
  info_.extra_json = R"({"simulation": {"scene": "tunnel", "seed": 1}})";
  const auto world = sim::World::Create(sim::SceneKind::kTunnel, 1);
  const Projection projection = Projection::Equirectangular(kWidth, kHeight);
  std::vector<sim::RenderedView> rendered;
  std::vector<Pose> poses;
  std::vector<std::string> truth;
  for (int i = 0; i < 3; ++i) {
    poses.push_back(world->PoseAt(0.5 * i));
    rendered.push_back(world->Render(poses.back(), projection));
    const auto& q = poses.back().rotation;
    const auto& t = poses.back().translation;
    truth.push_back(fmt::format(R"({{"pose": {{"q": [{}, {}, {}, {}], "t": [{}, {}, {}]}}}})",
                                q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()));
  }
  WriteSession(rendered[0].radiance, truth);
  // What a perfect pipeline without an odometer would write: lengths in units of half a metre.
  for (int i = 0; i < 3; ++i) {
    View view;
    view.radiance = rendered[static_cast<std::size_t>(i)].radiance.Clone();
    view.disparity = rendered[static_cast<std::size_t>(i)].distance.Clone();
    for (float& value : view.disparity.values()) value = 0.5F / value;
    view.pose = poses[0].Inverse() * poses[static_cast<std::size_t>(i)];
    view.pose.translation *= 2.0;
    WriteViewOf(i, view);
  }
  const SessionScore score = Evaluate();
  EXPECT_NE(score.reference.find("tunnel"), std::string::npos);
  for (const PositionScore& position : score.positions) {
    ASSERT_TRUE(position.view && position.disparity && position.pose);
    EXPECT_NEAR(position.view->errors.log10_rmse, 0.0, 1e-4);
    EXPECT_NEAR(position.disparity->bad1, 0.0, 1e-6);
    EXPECT_NEAR(position.disparity->median_relative, 0.0, 1e-4);
    EXPECT_NEAR(position.pose->rotation_deg, 0.0, 1e-4);
    EXPECT_NEAR(position.pose->translation_percent, 0.0, 1e-4);
  }
}

// A simulated drive of three positions with movers.
struct MoverDrive {
  std::vector<sim::RenderedView> rendered;
  std::vector<Pose> poses;
  std::vector<std::string> truth;

  MoverDrive() {
    const auto world = sim::World::Create(sim::SceneKind::kTunnel, 1);
    sim::MoverOptions options;
    options.count = 3;
    const std::vector<sim::Walk> walks = world->PlanWalks(options, 0.0);
    for (int i = 0; i < 3; ++i) {
      const double odometer = 0.5 * i;
      poses.push_back(world->PoseAt(odometer));
      const sim::MoverGroup movers = world->MoversAt(walks, options.speed * odometer);
      rendered.push_back(
          world->Render(poses.back(), Projection::Equirectangular(kWidth, kHeight), 4, &movers));
      const auto& q = poses.back().rotation;
      const auto& t = poses.back().translation;
      truth.push_back(fmt::format(
          R"({{"pose": {{"q": [{}, {}, {}, {}], "t": [{}, {}, {}]}}, "odometer_m": {}}})", q.w(),
          q.x(), q.y(), q.z(), t.x(), t.y(), t.z(), odometer));
    }
  }
  View ViewOf(int position, const Image<float>& radiance) const {
    View view;
    view.radiance = radiance.Clone();
    view.pose = poses[static_cast<std::size_t>(position)];
    view.metric = true;
    view.frames = {0, 1, 2};
    return view;
  }
};

TEST_F(Evaluation, WhereSomethingMovedAViewMustShowOneInstant) {
  info_.extra_json =
      R"({"simulation": {"scene": "tunnel", "seed": 1, "movers": 3, "mover_speed": 1.4}})";
  const MoverDrive drive;
  WriteSession(drive.rendered[0].radiance, drive.truth);
  // Position 0 shows its own instant, 1 a blend of it and the background, 2 the background.
  WriteViewOf(0, drive.ViewOf(0, drive.rendered[0].radiance));
  Image<float> blend = drive.rendered[1].radiance.Clone();
  for (std::size_t i = 0; i < blend.size(); ++i) {
    blend.data()[i] =
        std::sqrt(blend.data()[i] * std::max(drive.rendered[1].background.data()[i], 1e-6F));
  }
  WriteViewOf(1, drive.ViewOf(1, blend));
  View removed = drive.ViewOf(2, drive.rendered[2].background);
  removed.resume_json = R"({"methods": "merge.movers = remove"})";
  WriteViewOf(2, removed);
  const SessionScore score = Evaluate();
  for (const PositionScore& position : score.positions) {
    ASSERT_TRUE(position.movers) << Value(position.position);
    EXPECT_GT(position.movers->view.pixels, 20U);
  }
  EXPECT_EQ(score.positions[0].movers->view.share_off, 0.0);
  EXPECT_GT(score.positions[1].movers->view.share_off, 0.02);
  EXPECT_EQ(score.positions[2].movers->view.share_off, 0.0);
  EXPECT_FALSE(score.positions[0].movers->removes);
  EXPECT_TRUE(score.positions[2].movers->removes);
  ASSERT_TRUE(score.mean && score.mean->movers_off);
  EXPECT_GT(*score.mean->movers_off, 0.0);
  const auto json = nlohmann::json::parse(FormatScoreJson(score));
  EXPECT_EQ(json["positions"][2]["movers"]["mode"], "remove");
  EXPECT_NE(FormatScoreTable(score).find("movers"), std::string::npos);
}

TEST_F(Evaluation, AViewThatTellsItsSourcesIsSearchedForSeams) {
  WriteSession(Truth());
  WritePhotographs();
  for (int i = 0; i < 2; ++i) {
    View view{Truth(), {}};
    view.sources = Image<float>(kWidth, kHeight, 1, 1.0F);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = kWidth / 4; x < kWidth / 2; ++x) {
        view.sources.at(x, y) = 3.0F;
        for (int c = 0; c < 3; ++c) view.radiance.at(x, y, c) *= i == 0 ? 1.0F : 1.2F;
      }
    }
    WriteViewOf(i, view);
  }
  const SessionScore score = Evaluate();
  ASSERT_TRUE(score.positions[0].seams && score.positions[1].seams);
  EXPECT_GT(score.positions[0].seams->borders, 60U);
  EXPECT_LT(score.positions[0].seams->excess_log10, 0.002);
  EXPECT_NEAR(score.positions[1].seams->excess_log10, std::log10(1.2), 0.01);
  EXPECT_TRUE(
      nlohmann::json::parse(FormatScoreJson(score))["mean"]["seam_excess_noise"].is_number());
}

TEST_F(Evaluation, TheContactSheetHasARowForEveryViewAndAColumnForTheErrorWhenThereIsTruth) {
  WriteSession(Truth());
  for (int i = 0; i < 3; ++i) WriteViewOf(i, {Truth(), Image<float>(kWidth, kHeight, 1, 0.5F)});
  ContactSheetOptions options;
  options.cell_width = 100;
  const auto without = MakeContactSheet(directory_, options);
  ASSERT_TRUE(without) << without.error().message;
  WritePhotographs();
  const auto with = MakeContactSheet(directory_, options);
  ASSERT_TRUE(with) << with.error().message;
  EXPECT_EQ(with->width() - without->width(), 106);
  options.rows = 2;
  const auto fewer = MakeContactSheet(directory_, options);
  ASSERT_TRUE(fewer);
  EXPECT_LT(fewer->height(), with->height());
}

TEST_F(Evaluation, AContactSheetWithoutAnyViewIsAnError) {
  WriteSession(Truth());
  const auto sheet = MakeContactSheet(directory_, {});
  ASSERT_FALSE(sheet);
  EXPECT_NE(sheet.error().message.find("no complete view"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::evaluation_test
