#include <cstdlib>

#include "core/pose/pose_tracker.h"
#include "tests/bench/bench.h"
#include "tests/bench/bench_drive.h"
#include "tests/bench/opencv_parts.h"

// Features, matches and the pose of one more position, 2048×1024 pixels: ours, with links to three
// positions and the adjustment of the window, and OpenCV's SIFT at full size with exact matching to
// one position and an essential matrix.
namespace omnihdr {
namespace {

void OmnihdrPose(benchmark::State& state) {
  const BenchDrive& drive = LargeDrive();
  const auto tracker = PoseTracker::Create({});
  if (!tracker) std::abort();
  std::size_t position = 0;
  const auto push = [&] {
    (*tracker)->Push(PositionId{static_cast<std::int64_t>(position)},
                     drive.measurements[drive.Place(position)], std::nullopt, std::nullopt);
    ++position;
  };
  while (position < 8) push();  // a full window
  for (auto _ : state) push();
}
OMNIHDR_BENCHMARK(OmnihdrPose, "Pose/omnihdr");

void OpencvPose(benchmark::State& state) {
  const BenchDrive& drive = LargeDrive();
  std::size_t position = 1;
  opencv_parts::Sift before = opencv_parts::FindSift(opencv_parts::MatOf(drive.images[0]), 4000);
  double keypoints = 0.0;
  for (auto _ : state) {
    opencv_parts::Sift now =
        opencv_parts::FindSift(opencv_parts::MatOf(drive.images[drive.Place(position)]), 4000);
    cv::Matx33d rotation;
    cv::Vec3d direction;
    opencv_parts::RelativePoseOf(before, now, opencv_parts::MatchSift(before, now), 2048, &rotation,
                                 &direction);
    keypoints = static_cast<double>(now.keypoints.size());
    before = std::move(now);
    ++position;
  }
  state.counters["keypoints"] = keypoints;
}
OMNIHDR_BENCHMARK(OpencvPose, "Pose/opencv");

}  // namespace
}  // namespace omnihdr
