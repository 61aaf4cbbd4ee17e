#include <cmath>
#include <cstdlib>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/photo.hpp>

#include "core/base/parallel_for.h"
#include "tests/bench/bench.h"
#include "tests/bench/bench_session.h"
#include "tests/bench/opencv_parts.h"

// The whole chain for one more position of a drive, 2048×1024 pixels in, one exposure a position:
// ours, from the PNG file to the view's durable files, and a chain of OpenCV's parts, from the same
// file's bytes to a tone-mapped JPEG (no radiance map is written: less than ours does).
namespace omnihdr {
namespace {

constexpr int kFull = 6;  // positions until every view has all its neighbours

void OnePosition(benchmark::State& state, const BenchDrive& drive, int workers) {
  SetWorkerCount(workers);
  BenchSession session(drive);
  session.RecordAndProcess(kFull);
  for (auto _ : state) {
    state.PauseTiming();
    session.Record();
    session.Forget();
    state.ResumeTiming();
    session.Process();
  }
  SetWorkerCount(0);
}
void OmnihdrPosition(benchmark::State& state) { OnePosition(state, LargeDrive(), 0); }
void OmnihdrPositionOneThread(benchmark::State& state) { OnePosition(state, LargeDrive(), 1); }
OMNIHDR_BENCHMARK(OmnihdrPosition, "Position/omnihdr")->Iterations(3);
// The same work on two threads and on one: the ratio of wall times is what the second one gains.
OMNIHDR_BENCHMARK(OmnihdrPosition, "Threads/omnihdr")->Iterations(3);
OMNIHDR_BENCHMARK(OmnihdrPositionOneThread, "Threads/one")->Iterations(3);
// What writing a view's EXR files may cost is measured against the whole view.
OMNIHDR_BENCHMARK(OmnihdrPosition, "ExrPair/view")->Iterations(3);

void OmnihdrExrPair(benchmark::State& state) {
  constexpr int kWidth = 2048;
  const Image<float> radiance = BenchScene(kWidth, kWidth / 2);
  const Image<float> origin(kWidth, kWidth / 2, 1, 1.0F);
  Image<float> disparity(kWidth, kWidth / 2);
  for (int y = 0; y < disparity.height(); ++y) {
    for (int x = 0; x < kWidth; ++x) disparity.at(x, y) = 0.2F + 0.1F * std::sin(0.01F * x) * y;
  }
  const testing::TemporaryDirectory directory;
  for (auto _ : state) {
    const Status first = WriteExr(directory.path() / "radiance.exr",
                                  {{"R", radiance, ExrPixelType::kHalf, 0},
                                   {"G", radiance, ExrPixelType::kHalf, 1},
                                   {"B", radiance, ExrPixelType::kHalf, 2},
                                   {"origin", origin, ExrPixelType::kHalf, 0}},
                                  {}, ExrCompression::kPiz);
    const Status second = WriteExr(directory.path() / "disparity.exr",
                                   {{"disparity", disparity, ExrPixelType::kFloat, 0},
                                    {"confidence", origin, ExrPixelType::kHalf, 0}},
                                   {}, ExrCompression::kZip);
    if (!first || !second) std::abort();
  }
}
OMNIHDR_BENCHMARK(OmnihdrExrPair, "ExrPair/omnihdr");

// --- the chain of parts

constexpr int kWidth = 2048;
constexpr int kHeight = 1024;
constexpr int kDisparities = 128;
constexpr float kPi = std::numbers::pi_v<float>;

cv::Point2f PixelOf(const Eigen::Vector3f& ray) {
  const float theta = std::atan2(ray.y(), ray.x());
  const float phi = std::acos(std::clamp(ray.z(), -1.0F, 1.0F));
  return {kWidth * (kPi - theta) / (2.0F * kPi) - 0.5F, kHeight * phi / kPi - 0.5F};
}
Eigen::Vector3f RayOf(float x, float y) {
  const float theta = kPi * (1.0F - 2.0F * (x + 0.5F) / kWidth);
  const float phi = kPi * (y + 0.5F) / kHeight;
  return {std::sin(phi) * std::cos(theta), std::sin(phi) * std::sin(theta), std::cos(phi)};
}

template <typename Function>
cv::Mat MapOf(int width, int height, const Function& function) {
  cv::Mat map(height, width, CV_32FC2);
  cv::parallel_for_({0, height}, [&](const cv::Range& rows) {
    for (int y = rows.start; y < rows.end; ++y) {
      for (int x = 0; x < width; ++x) map.at<cv::Point2f>(y, x) = function(x, y);
    }
  });
  return map;
}

// Turned so that both panoramas' poles lie on their baseline: what moves, moves along the rows.
// Columns are the angle from the pole that points from the other one here, rows go round it.
struct Rectification {
  Eigen::Matrix3f world_from_pair;
  explicit Rectification(const Eigen::Vector3f& from_other) {
    const Eigen::Vector3f z = from_other.normalized();
    const Eigen::Vector3f x = z.unitOrthogonal();
    world_from_pair << x, z.cross(x), z;
  }
  Eigen::Vector3f Ray(float column, float row) const {
    const float phi = kPi * (column + 0.5F) / kHeight;
    const float theta = 2.0F * kPi * (row + 0.5F) / kWidth;
    return world_from_pair * Eigen::Vector3f(std::sin(phi) * std::cos(theta),
                                             std::sin(phi) * std::sin(theta), std::cos(phi));
  }
  cv::Point2f Pixel(const Eigen::Vector3f& ray) const {
    const Eigen::Vector3f v = world_from_pair.transpose() * ray;
    const float theta = std::atan2(v.y(), v.x());
    return {kHeight * std::acos(std::clamp(v.z(), -1.0F, 1.0F)) / kPi - 0.5F,
            kWidth * (theta < 0.0F ? theta + 2.0F * kPi : theta) / (2.0F * kPi) - 0.5F};
  }
};

// The other panorama as it would look from here.
cv::Mat Warped(const cv::Mat& here, const Pose& here_pose, const cv::Mat& other,
               const Pose& other_pose, const cv::Ptr<cv::StereoSGBM>& matcher) {
  const Rectification pair((here_pose.translation - other_pose.translation).cast<float>());
  const Eigen::Matrix3f here_from_world =
      here_pose.rotation.conjugate().toRotationMatrix().cast<float>();
  const Eigen::Matrix3f other_from_world =
      other_pose.rotation.conjugate().toRotationMatrix().cast<float>();
  const auto rectified = [&](const cv::Mat& image, const Eigen::Matrix3f& camera_from_world) {
    const cv::Mat map = MapOf(kHeight, kWidth, [&](int x, int y) {
      return PixelOf(camera_from_world * pair.Ray(static_cast<float>(x), static_cast<float>(y)));
    });
    cv::Mat turned;
    cv::Mat grey;
    cv::remap(image, turned, map, {}, cv::INTER_LINEAR, cv::BORDER_WRAP);
    cv::cvtColor(turned, grey, cv::COLOR_RGB2GRAY);
    cv::equalizeHist(grey, grey);  // another exposure
    return grey;
  };
  cv::Mat disparity;
  matcher->compute(rectified(here, here_from_world), rectified(other, other_from_world), disparity);
  const Eigen::Matrix3f world_from_here = here_from_world.transpose();
  const cv::Mat map = MapOf(kWidth, kHeight, [&](int x, int y) {
    const Eigen::Vector3f ray =
        world_from_here * RayOf(static_cast<float>(x), static_cast<float>(y));
    const cv::Point2f at = pair.Pixel(ray);
    const int column = std::clamp(cvRound(at.x), 0, kHeight - 1);
    const int row = std::clamp(cvRound(at.y), 0, kWidth - 1);
    const float d = std::max(disparity.at<short>(row, column), short{0}) / 16.0F;
    return PixelOf(other_from_world * pair.Ray(at.x - d, at.y));
  });
  cv::Mat warped;
  cv::remap(other, warped, map, {}, cv::INTER_LINEAR, cv::BORDER_WRAP);
  return warped;
}

// What a chain of parts keeps from one position for the next.
enum class Parts {
  kPerTarget,    // nothing: each position with its two neighbours by itself, as scripts do it
  kIncremental,  // pictures and features: one picture, one SIFT, one match a position
};

void OpencvChain(benchmark::State& state, const BenchDrive& drive, Parts parts) {
  constexpr int kFeatures = 6000;
  const auto matcher = opencv_parts::Matcher(kDisparities, cv::StereoSGBM::MODE_SGBM_3WAY);
  const cv::Ptr<cv::MergeDebevec> merge = cv::createMergeDebevec();
  const cv::Ptr<cv::TonemapReinhard> tonemap = cv::createTonemapReinhard(2.2F);
  std::size_t position = 3;
  const auto decoded = [&drive](std::size_t at) {
    cv::Mat image;
    const std::vector<std::byte>& file = drive.files[drive.Place(at)];
    const cv::Mat bytes(1, static_cast<int>(file.size()), CV_8U,
                        const_cast<std::byte*>(file.data()));
    cv::cvtColor(cv::imdecode(bytes, cv::IMREAD_COLOR), image, cv::COLOR_BGR2RGB);
    return image;
  };
  const auto find = [](const cv::Mat& image) { return opencv_parts::FindSift(image, kFeatures); };
  const auto pose = [](const opencv_parts::Sift& from, const opencv_parts::Sift& to) {
    cv::Matx33d rotation;
    cv::Vec3d direction;
    opencv_parts::RelativePoseOf(from, to, opencv_parts::MatchSift(from, to), kWidth, &rotation,
                                 &direction);
  };
  std::vector<cv::Mat> images = {decoded(0), decoded(1), decoded(2)};
  opencv_parts::Sift before = find(images.back());
  for (auto _ : state) {
    if (parts == Parts::kIncremental) {
      images.erase(images.begin());
      images.push_back(decoded(position));
      opencv_parts::Sift now = find(images.back());
      pose(before, now);
      before = std::move(now);
    } else {
      for (std::size_t k = 0; k < 3; ++k) images[k] = decoded(position - 2 + k);
      const opencv_parts::Sift middle = find(images[1]);
      for (const std::size_t other : {0U, 2U}) pose(middle, find(images[other]));
    }
    // What follows goes on with the true poses: its time does not depend on them, its result would.
    std::vector<cv::Mat> exposures = {images[1]};
    std::vector<float> times = {
        static_cast<float>(drive.Exposure(drive.Place(position - 1)).seconds())};
    for (const std::size_t other : {0U, 2U}) {
      const std::size_t at = position - 2 + other;
      exposures.push_back(Warped(images[1], drive.plan.poses[drive.Place(position - 1)],
                                 images[other], drive.plan.poses[drive.Place(at)], matcher));
      times.push_back(static_cast<float>(drive.Exposure(drive.Place(at)).seconds()));
    }
    cv::Mat radiance;
    cv::Mat picture;
    merge->process(exposures, radiance, times);
    tonemap->process(radiance, picture);
    picture.convertTo(picture, CV_8UC3, 255.0);
    std::vector<uchar> jpeg;
    cv::imencode(".jpg", picture, jpeg);
    benchmark::DoNotOptimize(jpeg.data());
    ++position;
    // At a turning point the next place is where the one before was.
    if (drive.Place(position) == drive.Place(position - 2)) ++position;
  }
}
void OpencvPosition(benchmark::State& state) {
  OpencvChain(state, LargeDrive(), Parts::kPerTarget);
}
void OpencvIncremental(benchmark::State& state) {
  OpencvChain(state, LargeDrive(), Parts::kIncremental);
}
OMNIHDR_BENCHMARK(OpencvPosition, "Position/opencv")->Iterations(1);
OMNIHDR_BENCHMARK(OpencvIncremental, "Position/opencv_incremental")->Iterations(1);

// The same over a recorded walk, when there is one.
void OmnihdrWalk(benchmark::State& state) { OnePosition(state, RecordedWalk(), 0); }
void OpencvWalk(benchmark::State& state) { OpencvChain(state, RecordedWalk(), Parts::kPerTarget); }
void OpencvWalkIncremental(benchmark::State& state) {
  OpencvChain(state, RecordedWalk(), Parts::kIncremental);
}
[[maybe_unused]] const bool kWalkRegistered = [] {
  if (RecordedWalkPath() == nullptr) return false;
  const auto add = [](const char* name, void (*function)(benchmark::State&), int iterations) {
    benchmark::RegisterBenchmark(name, function)
        ->Unit(benchmark::kMillisecond)
        ->MeasureProcessCPUTime()
        ->UseRealTime()
        ->Iterations(iterations);
  };
  add("Walk/omnihdr", OmnihdrWalk, 3);
  add("Walk/opencv", OpencvWalk, 1);
  add("Walk/opencv_incremental", OpencvWalkIncremental, 1);
  return true;
}();

}  // namespace
}  // namespace omnihdr
