#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/photo.hpp>
#include <random>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/photometry/measure.h"
#include "tests/support/room.h"

// Three exposures of one place, eight times apart, 8-bit linear: speed at the size of the thesis's
// panoramas, and the error of ln radiance against the bound of the noise.
namespace omnihdr {
namespace {

constexpr int kWidth = 1536;
constexpr int kHeight = 1152;
// Full well of 10 ke, read noise of 4 e.
constexpr NoiseModel kNoise{.read = 0.1, .gain = 0.0255, .prnu = 0.0};
// Radiance is 0.01 to 20 and exposures 1/32, 1/4 and 2; a gain brings the brightest light of the
// shortest exposure to value 255.
constexpr double kGain = 255.0 / 128.0 * 32.0 / 20.0;
const std::vector<double> kTimes = {kGain / 32.0, kGain / 4.0, kGain * 2.0};

struct Bracket {
  Image<float> truth;
  std::vector<DecodedImage> images;
  std::vector<ExposedFrame> frames;
  std::vector<cv::Mat> mats;  // the same pixels
  std::vector<float> times;
  cv::Mat response;  // value to exposure, as OpenCV wants it

  // Radiance evenly spread in the logarithm: in areas, as pictures have it, or pixel by pixel.
  Bracket(int width, int height, bool in_areas) : truth(width, height, 3) {
    std::mt19937 generator(4);
    std::uniform_real_distribution<double> share(0.0, 1.0);
    const double range = std::log(20.0 / 0.01);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        double at = share(generator);
        if (in_areas) at = 0.05 * at + 0.95 * std::abs(2.0 * x / width - 1.0);
        const auto e = static_cast<float>(0.01 * std::exp(range * at));
        for (int c = 0; c < 3; ++c) truth.at(x, y, c) = e;
      }
    }
    for (std::size_t k = 0; k < kTimes.size(); ++k) {
      images.push_back(
          testing::Expose(truth, kTimes[k], static_cast<std::uint32_t>(k) + 1, kNoise));
    }
    for (std::size_t k = 0; k < kTimes.size(); ++k) {
      frames.push_back({&images[k], {ExposureTime::Seconds(kTimes[k]), GainDb{}}});
      auto& pixels = std::get<Image<std::uint8_t>>(images[k].pixels);
      mats.emplace_back(height, width, CV_8UC3, pixels.data());
      times.push_back(static_cast<float>(kTimes[k]));
    }
    response = cv::Mat(256, 1, CV_32FC3);
    for (int z = 0; z < 256; ++z) {
      response.at<cv::Vec3f>(z) = cv::Vec3f::all(std::max(static_cast<float>(z), 0.25F) / 128.0F);
    }
  }
};

const Bracket& Large() {
  static const Bracket bracket(kWidth, kHeight, true);
  return bracket;
}

void CountPixels(benchmark::State& state) {
  state.counters["Mpx/s"] =
      benchmark::Counter(static_cast<double>(state.iterations()) * kWidth * kHeight / 1e6,
                         benchmark::Counter::kIsRate);
}

Measurement MeasureBracket(const Bracket& b, std::size_t count, MergeWeights weights,
                           const Response& response, double read_noise = kNoise.read) {
  MeasureOptions options;
  options.noise = kNoise;
  options.noise.read = read_noise;
  options.weights = weights;
  Result<Measurement> m = Measure(std::span(b.frames).subspan(b.frames.size() - count),
                                  Projection::Equirectangular(b.truth.width(), b.truth.height()),
                                  response, 8, {}, options);
  return std::move(*m);
}

void Merge(benchmark::State& state, std::size_t count, MergeWeights weights) {
  Large();  // made outside the timing
  for (auto _ : state) {
    benchmark::DoNotOptimize(MeasureBracket(Large(), count, weights, *Response::Linear()));
  }
  CountPixels(state);
}

// A curve that must be looked up.
void MergeCurve(benchmark::State& state) {
  Large();
  const Response response = *Response::LogLinear({{{0.02, -3.0}, {0.02, -3.0}, {0.02, -3.0}}});
  for (auto _ : state) {
    benchmark::DoNotOptimize(MeasureBracket(Large(), 3, MergeWeights::kInverseVariance, response));
  }
  CountPixels(state);
}

void MergeEstimatingNoise(benchmark::State& state) {
  Large();
  for (auto _ : state) {
    benchmark::DoNotOptimize(
        MeasureBracket(Large(), 3, MergeWeights::kInverseVariance, *Response::Linear(), 0.0));
  }
  CountPixels(state);
}

void MergeDebevec(benchmark::State& state) {
  const cv::Ptr<cv::MergeDebevec> merge = cv::createMergeDebevec();
  cv::Mat radiance;
  Large();
  for (auto _ : state) merge->process(Large().mats, radiance, Large().times, Large().response);
  CountPixels(state);
}

void MergeRobertson(benchmark::State& state) {
  const cv::Ptr<cv::MergeRobertson> merge = cv::createMergeRobertson();
  cv::Mat radiance;
  Large();
  for (auto _ : state) merge->process(Large().mats, radiance, Large().times, Large().response);
  CountPixels(state);
}

// What the merge cannot do without: every frame read, four floats and a flag a pixel written.
void MemoryFloor(benchmark::State& state) {
  const Bracket& b = Large();
  for (auto _ : state) {
    Image<float> radiance(kWidth, kHeight, 4);
    Image<std::uint8_t> flags(kWidth, kHeight);
    ParallelFor(kHeight, 16, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        std::uint64_t sum = 0;
        for (const DecodedImage& image : b.images) {
          const std::uint8_t* p = std::get<Image<std::uint8_t>>(image.pixels).row(y);
          for (int x = 0; x < 3 * kWidth; ++x) sum += p[x];
        }
        const auto value = static_cast<float>(sum);
        std::fill_n(radiance.row(y), 4 * kWidth, value);
        std::memset(flags.row(y), static_cast<int>(sum & 1U), kWidth);
      }
    });
    benchmark::DoNotOptimize(radiance.data());
  }
  CountPixels(state);
}

const Bracket& Small() {
  static const Bracket bracket(768, 576, false);
  return bracket;
}

// Root mean square of the error of ln green, after the best scale of the whole picture.
template <typename GreenAt>
double RmsLn(const GreenAt& green_at) {
  const Image<float>& truth = Small().truth;
  double sum = 0.0;
  double squares = 0.0;
  const double n = static_cast<double>(truth.width()) * truth.height();
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      const double e = std::log(std::max<double>(green_at(x, y), 1e-9) / truth.at(x, y, 1));
      sum += e;
      squares += e * e;
    }
  }
  return std::sqrt(squares / n - (sum / n) * (sum / n));
}

void Report(benchmark::State& state, double rms) {
  for (auto _ : state) benchmark::DoNotOptimize(rms);
  state.counters["rms_ln"] = rms;
}

void QualityOmnihdr(benchmark::State& state, MergeWeights weights) {
  const Measurement m = MeasureBracket(Small(), 3, weights, *Response::Linear());
  Report(state, RmsLn([&](int x, int y) { return m.radiance.at(x, y, 1); }));
}

// Total of the light over total of the time, where not clipped (Hanji et al. 2020).
void QualityPoisson(benchmark::State& state) {
  const Bracket& b = Small();
  Report(state, RmsLn([&](int x, int y) {
           double light = 0.0;
           double time = 0.0;
           for (std::size_t k = 0; k < kTimes.size(); ++k) {
             const int z = std::get<Image<std::uint8_t>>(b.images[k].pixels).at(x, y, 1);
             if (z > 254) continue;
             light += z / 128.0;
             time += kTimes[k];
           }
           return time > 0.0 ? light / time : 255.0 / 128.0 / kTimes.front();
         }));
}

void QualityOpenCv(benchmark::State& state, const cv::Ptr<cv::MergeExposures>& merge) {
  cv::Mat radiance;
  merge->process(Small().mats, radiance, Small().times, Small().response);
  Report(state, RmsLn([&](int x, int y) { return radiance.at<cv::Vec3f>(y, x)[1]; }));
}

// The least any unbiased estimate of ln E can do, by the Fisher information of the frames that are
// not clipped.
void QualityBound(benchmark::State& state) {
  const Image<float>& truth = Small().truth;
  double sum = 0.0;
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      double information = 0.0;
      for (const double t : kTimes) {
        const double z = 128.0 * truth.at(x, y, 1) * t;
        if (z <= 255.0) information += z * z / kNoise.VarianceOfValue(z);
      }
      sum += 1.0 / information;
    }
  }
  Report(state, std::sqrt(sum / (static_cast<double>(truth.width()) * truth.height())));
}

void Register() {
  const auto time = [](benchmark::internal::Benchmark* b) {
    b->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();
  };
  constexpr MergeWeights kVariance = MergeWeights::kInverseVariance;
  time(benchmark::RegisterBenchmark("Merge/omnihdr", Merge, std::size_t{3}, kVariance));
  time(benchmark::RegisterBenchmark("MergeHat/omnihdr", Merge, std::size_t{3}, MergeWeights::kHat));
  time(benchmark::RegisterBenchmark("MergeCurve/omnihdr", MergeCurve));
  time(benchmark::RegisterBenchmark("MergeEstimatingNoise/omnihdr", MergeEstimatingNoise));
  time(benchmark::RegisterBenchmark("Merge/opencv", MergeDebevec));
  time(benchmark::RegisterBenchmark("Merge/opencv_robertson", MergeRobertson));
  time(benchmark::RegisterBenchmark("Merge/floor", MemoryFloor));
  time(benchmark::RegisterBenchmark("MeasureOne/omnihdr", Merge, std::size_t{1}, kVariance));
  const auto once = [](benchmark::internal::Benchmark* b) { b->Iterations(1); };
  once(benchmark::RegisterBenchmark("MergeQuality/omnihdr", QualityOmnihdr, kVariance));
  once(benchmark::RegisterBenchmark("MergeQuality/hat", QualityOmnihdr, MergeWeights::kHat));
  once(benchmark::RegisterBenchmark("MergeQuality/poisson", QualityPoisson));
  once(benchmark::RegisterBenchmark("MergeQuality/opencv_debevec", QualityOpenCv,
                                    cv::Ptr<cv::MergeExposures>(cv::createMergeDebevec())));
  once(benchmark::RegisterBenchmark("MergeQuality/opencv_robertson", QualityOpenCv,
                                    cv::Ptr<cv::MergeExposures>(cv::createMergeRobertson())));
  once(benchmark::RegisterBenchmark("MergeQuality/fisher_bound", QualityBound));
}

[[maybe_unused]] const bool kRegistered = [] {
  Register();
  return true;
}();

}  // namespace
}  // namespace omnihdr
