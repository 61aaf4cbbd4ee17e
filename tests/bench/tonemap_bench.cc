#include "core/photometry/tonemap.h"

#include <opencv2/core.hpp>
#include <opencv2/photo.hpp>

#include "tests/bench/bench.h"

namespace omnihdr {
namespace {

const Image<float>& Scene() {
  static const Image<float> scene = BenchScene();
  return scene;
}

// The peer takes BGR; the order of the channels changes nothing in its time.
cv::Mat SceneMat() {
  static Image<float> scene = BenchScene();
  return {scene.height(), scene.width(), CV_32FC3, scene.data()};
}

void OmnihdrReinhard(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(ToneMapReinhard(Scene(), {}).data());
}
OMNIHDR_BENCHMARK(OmnihdrReinhard, "ToneMap/omnihdr");

// Both end at 8 bits: OpenCV's operator applies its gamma itself and leaves floats in 0..1.
void OpencvReinhard(benchmark::State& state) {
  const cv::Mat scene = SceneMat();
  const auto reinhard = cv::createTonemapReinhard(2.2F, 0.0F, 1.0F, 0.0F);
  for (auto _ : state) {
    cv::Mat mapped;
    cv::Mat codes;
    reinhard->process(scene, mapped);
    mapped.convertTo(codes, CV_8UC3, 255.0);
    benchmark::DoNotOptimize(codes.data);
  }
}
OMNIHDR_BENCHMARK(OpencvReinhard, "ToneMap/opencv");

}  // namespace
}  // namespace omnihdr
