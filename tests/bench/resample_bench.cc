#include <Eigen/Geometry>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "core/sphere/projection.h"
#include "core/sphere/sphere_remap.h"
#include "tests/bench/bench.h"

namespace omnihdr {
namespace {

// A lat-long picture turned by some rotation, 1.77 Mpx in and out: by a table that is ready.
constexpr int kWidth = 1882;
constexpr int kHeight = 941;

Eigen::Matrix3d Rotation() {
  return Eigen::AngleAxisd(0.4, Eigen::Vector3d(0.3, -0.5, 0.8).normalized()).toRotationMatrix();
}

const SphereRemap& Table() {
  static const SphereRemap table(SphereGrid::Equirectangular(kWidth, kHeight),
                                 SphereGrid::Equirectangular(kWidth, kHeight), {.area = false},
                                 Rotation());
  return table;
}

// The peer's table of the same geometry, in the form it is fastest with.
struct OpencvMaps {
  OpencvMaps() {
    const Projection projection = Projection::Equirectangular(kWidth, kHeight);
    const Eigen::Matrix3d rotation = Rotation();
    cv::Mat x(kHeight, kWidth, CV_32FC1);
    cv::Mat y(kHeight, kWidth, CV_32FC1);
    for (int row = 0; row < kHeight; ++row) {
      for (int column = 0; column < kWidth; ++column) {
        const Eigen::Vector2d at =
            projection.PixelFromRay(rotation * projection.RayFromPixel(column + 0.5, row + 0.5));
        x.at<float>(row, column) = static_cast<float>(at.x() - 0.5);
        y.at<float>(row, column) = static_cast<float>(at.y() - 0.5);
      }
    }
    cv::convertMaps(x, y, whole, fraction, CV_16SC2);
  }
  cv::Mat whole;
  cv::Mat fraction;
};

const Image<float>& FloatPicture() {
  static const Image<float> picture = BenchScene(kWidth, kHeight);
  return picture;
}

const Image<std::uint8_t>& BytePicture() {
  static const Image<std::uint8_t> picture = [] {
    Image<std::uint8_t> codes(kWidth, kHeight, 3);
    for (std::size_t i = 0; i < codes.size(); ++i) {
      codes.data()[i] = static_cast<std::uint8_t>(
          std::min(255.0F, 255.0F * std::sqrt(FloatPicture().data()[i] / 200.0F)));
    }
    return codes;
  }();
  return picture;
}

template <typename T>
void Omnihdr(benchmark::State& state, const Image<T>& picture) {
  Image<T> out(kWidth, kHeight, 3);
  const SphereRemap& table = Table();
  for (auto _ : state) {
    table.Apply(picture.view(), out.view());
    benchmark::DoNotOptimize(out.data());
    benchmark::ClobberMemory();
  }
}

template <typename T>
void Opencv(benchmark::State& state, const Image<T>& picture, int type) {
  static const OpencvMaps maps;
  Image<T> copy = picture.Clone();
  const cv::Mat source(kHeight, kWidth, type, copy.data());
  cv::Mat out(kHeight, kWidth, type);
  for (auto _ : state) {
    cv::remap(source, out, maps.whole, maps.fraction, cv::INTER_LINEAR, cv::BORDER_WRAP);
    benchmark::DoNotOptimize(out.data);
    benchmark::ClobberMemory();
  }
}

void OmnihdrBytes(benchmark::State& state) { Omnihdr(state, BytePicture()); }
OMNIHDR_BENCHMARK(OmnihdrBytes, "Resample/omnihdr");
void OpencvBytes(benchmark::State& state) { Opencv(state, BytePicture(), CV_8UC3); }
OMNIHDR_BENCHMARK(OpencvBytes, "Resample/opencv");
void OmnihdrFloats(benchmark::State& state) { Omnihdr(state, FloatPicture()); }
OMNIHDR_BENCHMARK(OmnihdrFloats, "ResampleFloat/omnihdr");
void OpencvFloats(benchmark::State& state) { Opencv(state, FloatPicture(), CV_32FC3); }
OMNIHDR_BENCHMARK(OpencvFloats, "ResampleFloat/opencv");

}  // namespace
}  // namespace omnihdr
