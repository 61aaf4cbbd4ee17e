#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "core/sphere/sphere_grid.h"
#include "core/sphere/sphere_remap.h"
#include "tests/bench/bench.h"

namespace omnihdr {
namespace {

// A lat-long picture into an RD-map of 1.77 million pixels, as large as the source's.
const SphereGrid& Source() {
  static const SphereGrid grid = SphereGrid::Equirectangular(2048, 1024);
  return grid;
}
const SphereGrid& Target() {
  static const SphereGrid grid = SphereGrid::RhombicDodecahedron(384);
  return grid;
}
SphereRemapOptions Bilinear() {
  SphereRemapOptions options;
  options.area = false;
  return options;
}
const SphereRemap& Remap() {
  static const SphereRemap remap(Target(), Source(), Bilinear());
  return remap;
}

template <typename T>
Image<T> Picture() {
  const Image<float> scene = BenchScene(Source().width(), Source().height());
  Image<T> picture(scene.width(), scene.height(), 3);
  for (std::size_t i = 0; i < scene.size(); ++i) {
    picture.data()[i] = static_cast<T>(std::fmin(scene.data()[i] * 64.0F, 255.0F));
  }
  return picture;
}

// Tables as OpenCV wants them for its fixed-point interpolation.
void OpencvMaps(cv::Mat* points, cv::Mat* fractions) {
  cv::Mat x(Target().height(), Target().width(), CV_32F);
  cv::Mat y(Target().height(), Target().width(), CV_32F);
  for (int i = 0; i < x.rows; ++i) {
    for (int j = 0; j < x.cols; ++j) {
      const auto p = Source().PixelFromRay(*Target().RayFromPixel(j + 0.5, i + 0.5));
      x.at<float>(i, j) = static_cast<float>(p->x() - 0.5);
      y.at<float>(i, j) = static_cast<float>(p->y() - 0.5);
    }
  }
  cv::convertMaps(x, y, *points, *fractions, CV_16SC2);
}

template <typename T>
void OmnihdrResample(benchmark::State& state) {
  const Image<T> picture = Picture<T>();
  Image<T> out(Target().width(), Target().height(), 3);
  const SphereRemap& remap = Remap();
  for (auto _ : state) {
    remap.Apply(picture, out.view());
    benchmark::DoNotOptimize(out.data());
  }
}

template <typename T>
void OpencvResample(benchmark::State& state, int type) {
  Image<T> picture = Picture<T>();
  const cv::Mat source(picture.height(), picture.width(), type, picture.data());
  cv::Mat points;
  cv::Mat fractions;
  OpencvMaps(&points, &fractions);
  cv::Mat out;
  for (auto _ : state) {
    cv::remap(source, out, points, fractions, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
    benchmark::DoNotOptimize(out.data);
  }
}

void OmnihdrBytes(benchmark::State& state) { OmnihdrResample<std::uint8_t>(state); }
OMNIHDR_BENCHMARK(OmnihdrBytes, "Resample/omnihdr");
void OpencvBytes(benchmark::State& state) { OpencvResample<std::uint8_t>(state, CV_8UC3); }
OMNIHDR_BENCHMARK(OpencvBytes, "Resample/opencv");

void OmnihdrFloats(benchmark::State& state) { OmnihdrResample<float>(state); }
OMNIHDR_BENCHMARK(OmnihdrFloats, "ResampleFloat/omnihdr");
void OpencvFloats(benchmark::State& state) { OpencvResample<float>(state, CV_32FC3); }
OMNIHDR_BENCHMARK(OpencvFloats, "ResampleFloat/opencv");

// The table itself, made once a grid.
void OmnihdrTable(benchmark::State& state) {
  for (auto _ : state) {
    benchmark::DoNotOptimize(SphereRemap(Target(), Source(), Bilinear()).Bytes());
  }
}
OMNIHDR_BENCHMARK(OmnihdrTable, "ResampleTable/omnihdr");
void OpencvTable(benchmark::State& state) {
  cv::Mat points;
  cv::Mat fractions;
  for (auto _ : state) {
    OpencvMaps(&points, &fractions);
    benchmark::DoNotOptimize(points.data);
  }
}
OMNIHDR_BENCHMARK(OpencvTable, "ResampleTable/opencv");

}  // namespace
}  // namespace omnihdr
