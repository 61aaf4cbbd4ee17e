#include "core/stereo/slic.h"

#include "core/stereo/superpixel_fill.h"
#include "tests/bench/bench.h"

namespace omnihdr {
namespace {

// No peer among the packages: OpenCV's ximgproc is not one of our dependencies.
void OmnihdrSlic(benchmark::State& state) {
  const Image<float> scene = BenchScene();
  const Image<std::uint8_t> picture = LogColours(scene, LogScale::For(1e-3F, 200.0F));
  int count = 0;
  for (auto _ : state) count = FindSuperpixels(picture, {}).count;
  state.counters["superpixels"] = count;
}
OMNIHDR_BENCHMARK(OmnihdrSlic, "Slic/omnihdr");

}  // namespace
}  // namespace omnihdr
