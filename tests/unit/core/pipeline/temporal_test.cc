#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "core/image/exr.h"
#include "core/photometry/measure.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/view_files.h"
#include "tests/unit/core/pipeline/processing.h"

namespace omnihdr::temporal_test {
namespace {

namespace fs = std::filesystem;
using testing::ProcessAll;
using testing::Processed;
using testing::SessionPlan;
using testing::TemporaryDirectory;

// Three brackets taken standing still.
SessionPlan Standing() {
  SessionPlan plan;
  plan.exposures_s = {0.08, 0.5, 3.0};
  plan.frames_per_position = 3;
  plan.projection = Projection::Equirectangular(128, 64);
  const std::vector<Pose> places = testing::GentleBend(2, 0.4);
  for (const Pose& place : places) plan.poses.insert(plan.poses.end(), 3, place);
  return plan;
}

// Its session, the label of frame 1 off by `error`.
void Write(const fs::path& directory, double error) {
  const SessionPlan plan = Standing();
  const std::vector<std::vector<std::byte>> frames = testing::RenderFrames(plan);
  Result<SessionWriter> writer = SessionWriter::Create(directory, testing::InfoOf(plan));
  ASSERT_TRUE(writer);
  for (std::size_t k = 0; k < frames.size(); ++k) {
    FrameRecord record = testing::RecordOf(plan, k);
    record.position = PositionId{static_cast<std::int64_t>(k / 3)};
    if (k == 1) {
      record.exposure.time = ExposureTime::Seconds(record.exposure.time.seconds() / error);
    }
    ASSERT_TRUE(writer->Append(record, frames[k]));
  }
}

PipelineOptions Temporal() {
  PipelineOptions options = testing::QuickOptions();
  options.mode = ProcessMode::kTemporal;
  return options;
}

ExrImage RadianceOf(const fs::path& directory, int position) {
  Result<ExrImage> exr =
      ReadExr(directory / "views" / ViewDirectoryName(PositionId{position}) / "radiance.exr");
  EXPECT_TRUE(exr) << exr.error().message;
  return exr ? std::move(*exr) : ExrImage{};
}

double MedianRatio(const ExrImage& a, const ExrImage& b) {
  std::vector<double> ratios;
  const Image<float>& ga = a.channels.at("G");
  const Image<float>& gb = b.channels.at("G");
  for (std::size_t k = 0; k < ga.size(); ++k) ratios.push_back(ga.data()[k] / gb.data()[k]);
  const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
  std::nth_element(ratios.begin(), middle, ratios.end());
  return *middle;
}

double LargestGap(const ExrImage& a, const ExrImage& b) {
  double largest = 0.0;
  const Image<float>& ga = a.channels.at("G");
  const Image<float>& gb = b.channels.at("G");
  for (std::size_t k = 0; k < ga.size(); ++k) {
    if (a.channels.at("origin").data()[k] != 1.0F) continue;
    largest = std::max(largest, std::abs(std::log(double{ga.data()[k]} / gb.data()[k])));
  }
  return largest;
}

TEST(TemporalMode, BracketsOfAPanoramaBecomeOneViewEach) {
  const TemporaryDirectory directory;
  Write(directory.path(), 1.0);
  const Processed done = ProcessAll(directory.path(), {}, Temporal());
  EXPECT_THAT(done.said.Positions(), ::testing::ElementsAre(0, 1));
  const Result<ViewRecord> record = ReadViewRecord(directory.path() / "views", PositionId{1});
  ASSERT_TRUE(record);
  EXPECT_THAT(record->frames, ::testing::ElementsAre(3U, 4U, 5U));
  EXPECT_EQ(record->reference, 4U);
  EXPECT_EQ(record->mode, "temporal");
  EXPECT_THAT(record->warnings, ::testing::IsEmpty());
  const ExrImage exr = RadianceOf(directory.path(), 1);
  EXPECT_EQ(exr.width, 128);
  EXPECT_EQ(exr.attributes.strings.at("omnihdrOrigin"), kOriginMeaning);
}

TEST(TemporalMode, AWrongExposureTimeIsCorrectedAndStandsInTheWarnings) {
  const TemporaryDirectory right;
  const TemporaryDirectory wrong;
  const TemporaryDirectory as_labelled;
  Write(right.path(), 1.0);
  Write(wrong.path(), 1.15);
  ProcessAll(right.path(), {}, Temporal());
  ProcessAll(wrong.path(), {}, Temporal());
  PipelineOptions trusting = Temporal();
  trusting.refine_exposure = false;
  ProcessAll(wrong.path(), as_labelled.path(), trusting);
  const ExrImage truth = RadianceOf(right.path(), 0);
  EXPECT_NEAR(MedianRatio(RadianceOf(wrong.path(), 0), truth), 1.0, 0.01);
  EXPECT_LT(LargestGap(RadianceOf(wrong.path(), 0), truth), 0.02);
  EXPECT_GT(LargestGap(RadianceOf(as_labelled.path(), 0), truth), 0.05);
  const Result<ViewRecord> record = ReadViewRecord(wrong.path() / "views", PositionId{0});
  ASSERT_TRUE(record);
  EXPECT_THAT(record->warnings, ::testing::ElementsAre(::testing::AllOf(
                                    ::testing::HasSubstr("frame 1: exposure 0.434783 s: +1"),
                                    ::testing::HasSubstr("corrected"))));
}

TEST(TemporalMode, AnErrorBeyondTheLimitIsToldAndLeftAlone) {
  const TemporaryDirectory directory;
  Write(directory.path(), 1.4);
  ProcessAll(directory.path(), {}, Temporal());
  const Result<ViewRecord> record = ReadViewRecord(directory.path() / "views", PositionId{0});
  ASSERT_TRUE(record);
  EXPECT_THAT(record->warnings, ::testing::ElementsAre(::testing::HasSubstr("kept as labelled")));
}

TEST(TemporalMode, TheWeightsAreThoseAskedFor) {
  const TemporaryDirectory directory;
  const TemporaryDirectory hat;
  Write(directory.path(), 1.0);
  ProcessAll(directory.path(), {}, Temporal());
  PipelineOptions options = Temporal();
  options.weights = MergeWeights::kHat;
  ProcessAll(directory.path(), hat.path(), options);
  const ExrImage a = RadianceOf(directory.path(), 0);
  const ExrImage b = RadianceOf(hat.path(), 0);
  EXPECT_FALSE(std::ranges::equal(a.channels.at("G").values(), b.channels.at("G").values()));
  EXPECT_NEAR(MedianRatio(b, a), 1.0, 0.01);
}

// A neutral sun, clipped in all steps, with a halo in which green clips first, over a grey ground.
struct SunPicture {
  std::vector<DecodedImage> images;
  std::vector<ExposedFrame> frames;
  MeasureOptions options;
  static constexpr int kSize = 64;

  SunPicture() {
    options.white_balance = {2.0, 1.0, 1.5};
    for (const double t : {0.01, 0.08, 0.64}) {
      Image<std::uint8_t> image(kSize, kSize, 3);
      for (int y = 0; y < kSize; ++y) {
        for (int x = 0; x < kSize; ++x) {
          const double r = std::hypot(x - 31.5, y - 31.5);
          const double light = r < 8.0 ? 1e5 : 2.0 + 600.0 * std::exp(-(r - 8.0) / 4.0);
          for (int c = 0; c < 3; ++c) {
            const double z = 128.0 * light / options.white_balance[static_cast<std::size_t>(c)] * t;
            image.at(x, y, c) = static_cast<std::uint8_t>(std::clamp(z + 0.5, 0.0, 255.0));
          }
        }
      }
      images.push_back({std::move(image)});
    }
    const std::array<double, 3> times = {0.01, 0.08, 0.64};
    for (std::size_t k = 0; k < 3; ++k) {
      frames.push_back({&images[k], {ExposureTime::Seconds(times[k]), GainDb{}}});
    }
  }
  MergedView View() const {
    Result<Measurement> m = Measure(frames, Projection::Equirectangular(kSize, kSize),
                                    *Response::Linear(), 8, {}, options);
    EXPECT_TRUE(m);
    return ViewOfMeasurement(*m);
  }
};

TEST(ClippedSun, ReadsNeutralAtItsLowerBoundAndIsMarked) {
  const MergedView view = SunPicture().View();
  const float* sun = view.radiance.pixel(32, 32);
  const double bound = 2.0 * 255.0 / 128.0 / 0.01;  // red's: the largest of the three
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(sun[c], bound, 0.01 * bound);
  EXPECT_EQ(view.origin.at(32, 32), static_cast<std::uint8_t>(PixelOrigin::kClipped));
}

TEST(ClippedSun, NoPixelOfANeutralSceneIsPinkOrGreen) {
  const MergedView view = SunPicture().View();
  for (int y = 0; y < SunPicture::kSize; ++y) {
    for (int x = 0; x < SunPicture::kSize; ++x) {
      const float* p = view.radiance.pixel(x, y);
      const float largest = std::max({p[0], p[1], p[2]});
      const float least = std::min({p[0], p[1], p[2]});
      EXPECT_LT(largest, 1.07F * least) << x << ", " << y;
    }
  }
  const Image<std::uint8_t> preview = ToneMapReinhard(view.radiance, ToneMapOptions{});
  for (int y = 0; y < SunPicture::kSize; ++y) {
    for (int x = 0; x < SunPicture::kSize; ++x) {
      const std::uint8_t* p = preview.pixel(x, y);
      EXPECT_LE(std::max({p[0], p[1], p[2]}) - std::min({p[0], p[1], p[2]}), 12);
    }
  }
}

TEST(NanPixels, StandOnlyWhereTheyWereAskedFor) {
  Image<std::uint8_t> origin(4, 1);
  for (int x = 0; x < 4; ++x) origin.at(x, 0) = static_cast<std::uint8_t>(x);
  const auto nan_at = [&](NanPixels nan) {
    Image<float> radiance(4, 1, 3, 1.0F);
    MarkNan(origin, nan, &radiance);
    std::string where;
    for (int x = 0; x < 4; ++x) where += std::isnan(radiance.at(x, 0, 2)) ? '1' : '0';
    return where;
  };
  EXPECT_EQ(nan_at(NanPixels::kNever), "0000");
  EXPECT_EQ(nan_at(NanPixels::kNoData), "1000");
  EXPECT_EQ(nan_at(NanPixels::kUnmeasured), "1011");
}

TEST(NanPixels, AreInTheFileButNotInThePreview) {
  const TemporaryDirectory directory;
  Write(directory.path(), 1.0);
  PipelineOptions options = Temporal();
  options.nan = NanPixels::kUnmeasured;
  options.value_low = 60.0;  // so that something is dark
  ProcessAll(directory.path(), {}, options);
  const ExrImage exr = RadianceOf(directory.path(), 0);
  int marked = 0;
  for (std::size_t k = 0; k < exr.channels.at("origin").size(); ++k) {
    const bool measured = exr.channels.at("origin").data()[k] == 1.0F;
    ASSERT_EQ(std::isnan(exr.channels.at("G").data()[k]), !measured);
    marked += measured ? 0 : 1;
  }
  EXPECT_GT(marked, 10);
  const Result<ViewRecord> record = ReadViewRecord(directory.path() / "views", PositionId{0});
  ASSERT_TRUE(record);
  EXPECT_TRUE(std::isfinite(record->radiance_max));
}

}  // namespace
}  // namespace omnihdr::temporal_test
