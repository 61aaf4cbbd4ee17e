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

// The other operators, for which no target is set.
void OmnihdrOperator(benchmark::State& state, ToneOperator tone_operator) {
  ToneMapOptions options;
  options.tone_operator = tone_operator;
  for (auto _ : state) benchmark::DoNotOptimize(ToneMap(Scene(), options).data());
}
void OmnihdrReinhardLocal(benchmark::State& state) {
  OmnihdrOperator(state, ToneOperator::kReinhardLocal);
}
OMNIHDR_BENCHMARK(OmnihdrReinhardLocal, "ToneMapLocal/omnihdr");
void OmnihdrDrago(benchmark::State& state) { OmnihdrOperator(state, ToneOperator::kDrago); }
OMNIHDR_BENCHMARK(OmnihdrDrago, "ToneMapDrago/omnihdr");
void OmnihdrDurand(benchmark::State& state) { OmnihdrOperator(state, ToneOperator::kDurand); }
OMNIHDR_BENCHMARK(OmnihdrDurand, "ToneMapDurand/omnihdr");

void OpencvDrago(benchmark::State& state) {
  const cv::Mat scene = SceneMat();
  const auto drago = cv::createTonemapDrago(2.2F, 1.0F, 0.85F);
  for (auto _ : state) {
    cv::Mat mapped;
    cv::Mat codes;
    drago->process(scene, mapped);
    mapped.convertTo(codes, CV_8UC3, 255.0);
    benchmark::DoNotOptimize(codes.data);
  }
}
OMNIHDR_BENCHMARK(OpencvDrago, "ToneMapDrago/opencv");

}  // namespace
}  // namespace omnihdr
