#include <array>
#include <cmath>
#include <opencv2/calib3d.hpp>

#include "core/pipeline/view_pipeline.h"
#include "core/stereo/coarse_match.h"
#include "core/stereo/fuse.h"
#include "core/stereo/sgm.h"
#include "core/stereo/sweep.h"
#include "tests/bench/bench.h"
#include "tests/bench/bench_drive.h"
#include "tests/bench/opencv_parts.h"

// Matching of one view on a grid of 2048×1024 with 64 hypotheses: ours with four neighbours in
// radiance, searched as the pipeline does - in the ranges that a match of half the size leaves in
// question - and all hypotheses everywhere beside it; OpenCV's semi-global
// matchers one pair of the same pixels.
namespace omnihdr {
namespace {

constexpr int kMapWidth = 2048;
// The grid of stereo.width, at which the pipeline matches pictures of that size.
constexpr int kPipelineWidth = 1024;
constexpr int kLabels = 64;

// Five places; the one in the middle is matched.
struct StereoInput {
  std::vector<StereoView> views;
  std::vector<StereoView> halves;
  std::vector<SweepNeighbour> neighbours;
  std::vector<SweepNeighbour> half_neighbours;
  std::vector<std::size_t> places = {2, 1, 3, 0, 4};
  LogScale scale;
  int width = 0;  // of the grid
};

const StereoInput& Input(int width = kMapWidth) {
  static const auto make = [](int map_width) {
    const BenchDrive& drive = LargeDrive();
    StereoInput in;
    in.width = map_width;
    float floor = 1e9F;
    float brightest = 0.0F;
    for (const std::size_t place : in.places) {
      const Measurement& m = drive.measurements[place];
      floor = std::min(floor, m.noise_floor);
      brightest = std::max(brightest, *std::max_element(m.saturation.begin(), m.saturation.end()));
    }
    in.scale = LogScale::For(floor, brightest);
    in.views.reserve(in.places.size());
    for (const std::size_t place : in.places) {
      in.views.push_back(MakeStereoView(drive.measurements[place], drive.plan.poses[place].rotation,
                                        2 * map_width, in.scale));
    }
    for (const StereoView& view : in.views) in.halves.push_back(HalveStereoView(view));
    const Eigen::Vector3d centre = drive.plan.poses[in.places[0]].translation;
    for (std::size_t k = 1; k < in.places.size(); ++k) {
      in.half_neighbours.push_back(
          {&in.halves[k], (drive.plan.poses[in.places[k]].translation - centre).cast<float>()});
      in.neighbours.push_back(
          {&in.views[k], (drive.plan.poses[in.places[k]].translation - centre).cast<float>()});
    }
    return in;
  };
  static const StereoInput full = make(kMapWidth);
  static const StereoInput reduced = make(kPipelineWidth);
  return width == kMapWidth ? full : reduced;
}

SweepOptions Labels() {
  SweepOptions options;
  options.labels = kLabels;
  options.max_disparity = 0.8;
  return options;
}

std::vector<SweepNeighbour> Some(const std::vector<SweepNeighbour>& all, std::size_t count) {
  return {all.begin(), all.begin() + static_cast<std::ptrdiff_t>(count)};
}

DisparityMap MatchOnce(const StereoView& reference, std::size_t neighbours, bool everywhere,
                       int width = kMapWidth) {
  const StereoInput& input = Input(width);
  SweepOptions options = Labels();
  if (!everywhere) {
    const StereoView half = HalveStereoView(reference);
    const DisparityMap guide =
        MatchCoarse(StereoCost::kInterval, half, Some(input.half_neighbours, neighbours), options);
    options.ranges = RangesAround(guide, width, width / 2, options.labels, options.max_disparity,
                                  RangeOptions{});
  }
  return OptimiseSemiGlobal(SweepCosts(reference, Some(input.neighbours, neighbours), options),
                            reference, SgmOptions{});
}

StereoView Prepared(std::size_t place, int width = kMapWidth) {
  const BenchDrive& drive = LargeDrive();
  return MakeStereoView(drive.measurements[place], drive.plan.poses[place].rotation, 2 * width,
                        Input(width).scale);
}

// One more position's panorama prepared, and the view matched with its four neighbours.
void OmnihdrStereo(benchmark::State& state) {
  Input();
  for (auto _ : state) {
    benchmark::DoNotOptimize(MatchOnce(Prepared(Input().places[0]), 4, false));
  }
}
OMNIHDR_BENCHMARK(OmnihdrStereo, "Stereo/omnihdr")->Iterations(1);

// The same on the grid that the pipeline uses by default, on which the targets of disparity are
// met.
void OmnihdrStereoView(benchmark::State& state) {
  Input(kPipelineWidth);
  for (auto _ : state) {
    benchmark::DoNotOptimize(
        MatchOnce(Prepared(Input().places[0], kPipelineWidth), 4, false, kPipelineWidth));
  }
}
OMNIHDR_BENCHMARK(OmnihdrStereoView, "StereoView/omnihdr");

void OmnihdrStereoEverywhere(benchmark::State& state) {
  Input();
  for (auto _ : state) {
    benchmark::DoNotOptimize(MatchOnce(Prepared(Input().places[0]), 4, true));
  }
}
OMNIHDR_BENCHMARK(OmnihdrStereoEverywhere, "Stereo/all_labels")->Iterations(1);

// All that the pipeline does for a view's disparity: beside that, a map of the next view with the
// three neighbours it has by then, votes of all maps, and holes filled.
void OmnihdrStereoFused(benchmark::State& state) {
  const DisparityMap before = MatchOnce(Input().views[0], 2, false);
  for (auto _ : state) {
    const StereoView reference = Prepared(Input().places[0]);
    const DisparityMap own = MatchOnce(reference, 4, false);
    const DisparityMap ahead = MatchOnce(reference, 3, false);
    std::vector<NeighbourMap> maps;
    for (std::size_t k = 0; k < 3; ++k) {
      maps.push_back({k == 1 ? &ahead : &before, Input().neighbours[k].offset});
    }
    DisparityMap fused =
        FuseDisparity(own, maps, {.tolerance = 1.5 * Labels().max_disparity / (kLabels - 1)});
    FillHoles(MapBrightness(reference), FillOptions{}, &fused);
    benchmark::DoNotOptimize(fused);
  }
}
OMNIHDR_BENCHMARK(OmnihdrStereoFused, "StereoFused/omnihdr")->Iterations(1);

void OpencvPair(benchmark::State& state, int mode) {
  const BenchDrive& drive = LargeDrive();
  const auto matcher = opencv_parts::Matcher(kLabels, mode);
  // Grey pictures, equalised for their exposures, ready to be matched: no rectification is timed.
  std::array<cv::Mat, 2> grey;
  for (std::size_t k = 0; k < 2; ++k) {
    cv::cvtColor(opencv_parts::MatOf(drive.images[2 + k]), grey[k], cv::COLOR_RGB2GRAY);
    cv::equalizeHist(grey[k], grey[k]);
  }
  cv::Mat disparity;
  for (auto _ : state) {
    matcher->compute(grey[0], grey[1], disparity);
    benchmark::DoNotOptimize(disparity.data);
  }
}
void OpencvSgbm(benchmark::State& state) { OpencvPair(state, cv::StereoSGBM::MODE_SGBM); }
void Opencv3Way(benchmark::State& state) { OpencvPair(state, cv::StereoSGBM::MODE_SGBM_3WAY); }
OMNIHDR_BENCHMARK(OpencvSgbm, "Stereo/opencv_sgbm");
OMNIHDR_BENCHMARK(Opencv3Way, "Stereo/opencv_3way");
OMNIHDR_BENCHMARK(OpencvSgbm, "StereoView/opencv_sgbm");
OMNIHDR_BENCHMARK(Opencv3Way, "StereoView/opencv_3way");
OMNIHDR_BENCHMARK(OpencvSgbm, "StereoFused/opencv_sgbm");

}  // namespace
}  // namespace omnihdr
