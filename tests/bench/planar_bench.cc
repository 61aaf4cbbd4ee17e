#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/stereo/fuse.h"
#include "core/stereo/sgm.h"
#include "core/stereo/sweep.h"
#include "core/stereo/wavelet_filter.h"
#include "tests/bench/bench.h"
#include "tests/bench/opencv_parts.h"

// Disparity between two plain pictures of different exposure: Middlebury's pairs (Scharstein,
// Szeliski, Pal, Hirschmueller), when OMNIHDR_BENCH_MIDDLEBURY names a folder of them, each side
// multiplied by its gain, rounded to 8 bits and clipped. Counter bad_percent: of the pixels that
// both pictures see, those whose disparity is off by more than a pixel once all holes are filled,
// mean over the pairs. Ours sees the pair as two panoramas that are blind but for a field of 60
// degrees; the peers are OpenCV's matchers, with the brightness as it is or with the right
// picture's histogram made the left one's.
namespace omnihdr {
namespace {

constexpr double kFieldDegrees = 60.0;
constexpr int kDisparities = 96;
constexpr int kLabels = 2 * kDisparities;  // of ours, half a pixel apart

struct Pair {
  cv::Mat left;  // 8-bit RGB
  cv::Mat right;
  cv::Mat truth;  // CV_32F, pixels; 0 = unknown, or hidden from the right picture
};

struct Gains {
  double left;
  double right;
};
constexpr std::array<Gains, 3> kGains = {{{1.0, 0.25}, {2.0, 0.25}, {4.0, 0.25}}};

cv::Mat Load(const std::filesystem::path& path) {
  const Result<DecodedImage> image = ReadImage(path);
  if (!image || image->channels() != (path.filename().string().rfind("disp", 0) == 0 ? 1 : 3)) {
    fmt::print(stderr, "benchmark: {}: not a readable picture of a pair\n", path.string());
    std::exit(66);
  }
  const auto& pixels = std::get<Image<std::uint8_t>>(image->pixels);
  return cv::Mat(pixels.height(), pixels.width(), image->channels() == 1 ? CV_8UC1 : CV_8UC3,
                 const_cast<std::uint8_t*>(pixels.data()))
      .clone();
}

// What the left picture's disparity says that the right one's contradicts is hidden there.
cv::Mat Truth(const cv::Mat& left, const cv::Mat& right, float scale) {
  cv::Mat truth(left.size(), CV_32F, cv::Scalar(0.0));
  for (int y = 0; y < left.rows; ++y) {
    for (int x = 0; x < left.cols; ++x) {
      const float d = static_cast<float>(left.at<uchar>(y, x)) / scale;
      const int there = cvRound(static_cast<float>(x) - d);
      if (d <= 0.0F || there < 0) continue;
      const float back = static_cast<float>(right.at<uchar>(y, there)) / scale;
      if (back > 0.0F && std::abs(back - d) <= 1.0F) truth.at<float>(y, x) = d;
    }
  }
  return truth;
}

const std::vector<Pair>& Pairs() {
  static const std::vector<Pair> pairs = [] {
    const std::filesystem::path folder = std::getenv("OMNIHDR_BENCH_MIDDLEBURY");
    std::vector<Pair> found;
    for (const char* name : {"Art", "Books", "Dolls", "Laundry", "Moebius", "Reindeer"}) {
      const std::filesystem::path at = folder / name;
      if (!std::filesystem::exists(at / "view1.png")) continue;
      found.push_back({Load(at / "view1.png"), Load(at / "view5.png"),
                       Truth(Load(at / "disp1.png"), Load(at / "disp5.png"), 3.0F)});
    }
    if (found.empty()) {
      fmt::print(stderr, "benchmark: {}: no pair there (Art/view1.png, ...)\n", folder.string());
      std::exit(66);
    }
    return found;
  }();
  return pairs;
}

cv::Mat Exposed(const cv::Mat& image, double gain) {
  cv::Mat exposed;
  image.convertTo(exposed, CV_8U, gain);  // rounds and clips
  return exposed;
}

// Holes take the farther of their neighbours along the row, as Middlebury's evaluation does.
void FillRows(cv::Mat* disparity) {
  for (int y = 0; y < disparity->rows; ++y) {
    auto* row = disparity->ptr<float>(y);
    for (int x = 0; x < disparity->cols; ++x) {
      if (row[x] >= 0.0F) continue;
      int right = x;
      while (right < disparity->cols && row[right] < 0.0F) ++right;
      const float a = x > 0 ? row[x - 1] : 1e9F;
      const float b = right < disparity->cols ? row[right] : 1e9F;
      const float fill = std::min(a, b) < 1e9F ? std::min(a, b) : 0.0F;
      std::fill(row + x, row + right, fill);
      x = right - 1;
    }
  }
}

double BadPercent(const cv::Mat& disparity, const cv::Mat& truth) {
  double known = 0.0;
  double bad = 0.0;
  for (int y = 0; y < truth.rows; ++y) {
    for (int x = 0; x < truth.cols; ++x) {
      const float d = truth.at<float>(y, x);
      if (d <= 0.0F) continue;
      known += 1.0;
      if (!(std::abs(disparity.at<float>(y, x) - d) <= 1.0F)) bad += 1.0;
    }
  }
  return 100.0 * bad / known;
}

// --- ours

struct Plane {
  int width;
  int height;
  double focal;
  explicit Plane(const cv::Mat& image)
      : width(image.cols),
        height(image.rows),
        focal(0.5 * image.cols / std::tan(kFieldDegrees * std::numbers::pi / 360.0)) {}
  // Of a map that is nowhere coarser than the picture.
  int MapWidth() const {
    return 64 * static_cast<int>(std::ceil(2.0 * std::numbers::pi * focal / 64.0));
  }
};

// A picture as a panorama's measurement: masked where it does not look, saturated or dark where any
// pixel beside is.
Measurement Panorama(const cv::Mat& image, double gain, const Plane& plane) {
  DecodedImage decoded;
  Image<std::uint8_t> pixels(image.cols, image.rows, 3);
  std::copy_n(image.data, 3 * image.cols * image.rows, pixels.data());
  decoded.pixels = std::move(pixels);
  const std::vector<ExposedFrame> frames = {{&decoded, {ExposureTime::Seconds(gain), GainDb{}}}};
  // What these pictures are: rounded to 8 bits, clipped at 255, and nothing else.
  MeasureOptions options;
  options.value_low = 1.5;
  options.value_high = 254.5;
  options.noise = {.read = 0.3, .gain = 0.005, .prnu = 0.0};
  const Result<Measurement> flat =
      Measure(frames, Projection::Equirectangular(image.cols, image.rows), *Response::Linear(), 8,
              {}, options);
  if (!flat) std::abort();
  Measurement out;
  out.saturation = flat->saturation;
  out.variance_floor = flat->variance_floor;
  out.variance_per_radiance = flat->variance_per_radiance;
  out.noise_floor = flat->noise_floor;
  out.longest_exposure_s = flat->longest_exposure_s;
  out.shortest_exposure_s = flat->shortest_exposure_s;
  const int width = 2 * plane.MapWidth();
  out.projection = Projection::Equirectangular(width, width / 2);
  out.radiance = Image<float>(width, width / 2, 4, 0.0F);
  out.flags = Image<std::uint8_t>(width, width / 2, 1, static_cast<std::uint8_t>(kMasked));
  // A quarter of the way round, and a quarter up and down, is more than the field.
  for (int y = width / 8; y < 3 * width / 8; ++y) {
    for (int x = 3 * width / 8; x < 5 * width / 8; ++x) {
      const Eigen::Vector3d ray = out.projection.RayFromPixel(x + 0.5, y + 0.5);
      const double px = 0.5 * plane.width - plane.focal * ray.y() / ray.x() - 0.5;
      const double py = 0.5 * plane.height - plane.focal * ray.z() / ray.x() - 0.5;
      const int x0 = static_cast<int>(std::floor(px));
      const int y0 = static_cast<int>(std::floor(py));
      if (x0 < 0 || y0 < 0 || x0 + 1 >= plane.width || y0 + 1 >= plane.height) continue;
      std::uint8_t flags = 0;
      std::array<double, 4> sum{};
      for (int k = 0; k < 4; ++k) {
        const int i = x0 + k % 2;
        const int j = y0 + k / 2;
        const double wx = k % 2 == 0 ? 1.0 - (px - x0) : px - x0;
        const double wy = k / 2 == 0 ? 1.0 - (py - y0) : py - y0;
        if (wx * wy > 0.05) flags = static_cast<std::uint8_t>(flags | flat->flags.at(i, j));
        for (int c = 0; c < 4; ++c) {
          sum[static_cast<std::size_t>(c)] += wx * wy * flat->radiance.at(i, j, c);
        }
      }
      for (int c = 0; c < 3; ++c) {
        out.radiance.at(x, y, c) = static_cast<float>(sum[static_cast<std::size_t>(c)]);
      }
      out.radiance.at(x, y, 3) = flags == 0 ? 1.0F : 0.0F;
      out.flags.at(x, y) = flags;
    }
  }
  return out;
}

// All disparities in the field of view, hardly any beside it.
std::vector<LabelRange> RangesInField(int width) {
  const int tiles = CostVolume::TilesPerRow(width);
  const int height = width / 2;
  std::vector<LabelRange> ranges(static_cast<std::size_t>(tiles * height),
                                 LabelRange{0, kTileLabels});
  for (int y = height / 4; y < 3 * height / 4; ++y) {
    for (int t = 3 * tiles / 8; t <= 5 * tiles / 8; ++t) {
      ranges[static_cast<std::size_t>(y * tiles + t)] = {0, kLabels};
    }
  }
  return ranges;
}

// The pipeline's steps for two views: both matched, votes of both maps, filter, holes filled.
cv::Mat OurDisparity(const Pair& pair, const Gains& gains) {
  const Plane plane(pair.left);
  const int width = plane.MapWidth();
  const Measurement left = Panorama(Exposed(pair.left, gains.left), gains.left, plane);
  const Measurement right = Panorama(Exposed(pair.right, gains.right), gains.right, plane);
  LogScale scale =
      LogScale::For(std::min(left.noise_floor, right.noise_floor),
                    std::max(*std::max_element(left.saturation.begin(), left.saturation.end()),
                             *std::max_element(right.saturation.begin(), right.saturation.end())));
  scale.gradient_codes_per_ln = 200.0F;  // there is little noise
  const Eigen::Quaterniond level = Eigen::Quaterniond::Identity();
  const StereoView left_view = MakeStereoView(left, level, 2 * width, scale);
  const StereoView right_view = MakeStereoView(right, level, 2 * width, scale);
  SweepOptions options;
  options.labels = kLabels;
  options.max_disparity = kDisparities;
  options.ranges = RangesInField(width);
  // One over the focal length to the right: an inverse depth is a disparity in pixels.
  const Eigen::Vector3f to_right(0.0F, -1.0F / static_cast<float>(plane.focal), 0.0F);
  const auto match = [&](const StereoView& own, const StereoView& other,
                         const Eigen::Vector3f& offset) {
    return OptimiseSemiGlobal(SweepCosts(own, {{&other, offset}}, options), own, SgmOptions{});
  };
  const DisparityMap own = match(left_view, right_view, to_right);
  const DisparityMap other = match(right_view, left_view, -to_right);
  const double tolerance = 1.5 * options.max_disparity / (options.labels - 1);
  DisparityMap fused = FuseDisparity(own, {{&other, to_right}}, {.tolerance = tolerance});
  FilterWavelet({.tolerance = tolerance}, &fused);
  FillHoles(MapBrightness(left_view), FillOptions{}, &fused);

  const Projection map = Projection::Equirectangular(width, width / 2);
  cv::Mat disparity(pair.left.size(), CV_32F);
  for (int y = 0; y < disparity.rows; ++y) {
    for (int x = 0; x < disparity.cols; ++x) {
      const Eigen::Vector3d ray =
          Eigen::Vector3d(plane.focal, 0.5 * plane.width - x - 0.5, 0.5 * plane.height - y - 0.5)
              .normalized();
      const Eigen::Vector2d at = map.PixelFromRay(ray);
      disparity.at<float>(y, x) =
          fused.disparity.at(static_cast<int>(at.x()), static_cast<int>(at.y())) /
          static_cast<float>(ray.x());
    }
  }
  return disparity;
}

// --- the peers

// The values of `image` changed so that they are spread as those of `like`.
cv::Mat HistogramMatched(const cv::Mat& image, const cv::Mat& like) {
  const auto shares = [](const cv::Mat& m) {
    std::array<double, 256> sum{};
    for (int y = 0; y < m.rows; ++y) {
      for (int x = 0; x < m.cols; ++x) sum[m.at<uchar>(y, x)] += 1.0;
    }
    for (std::size_t k = 1; k < 256; ++k) sum[k] += sum[k - 1];
    return sum;
  };
  const auto from = shares(image);
  const auto to = shares(like);
  cv::Mat table(1, 256, CV_8U);
  int value = 0;
  for (int k = 0; k < 256; ++k) {
    while (value < 255 && to[static_cast<std::size_t>(value)] < from[static_cast<std::size_t>(k)]) {
      ++value;
    }
    table.at<uchar>(0, k) = static_cast<uchar>(value);
  }
  cv::Mat matched;
  cv::LUT(image, table, matched);
  return matched;
}

cv::Mat OpencvDisparity(const Pair& pair, const Gains& gains, int mode, bool histograms) {
  cv::Mat left;
  cv::Mat right;
  cv::cvtColor(Exposed(pair.left, gains.left), left, cv::COLOR_RGB2GRAY);
  cv::cvtColor(Exposed(pair.right, gains.right), right, cv::COLOR_RGB2GRAY);
  if (histograms) right = HistogramMatched(right, left);
  // A border on the left, so that its columns are matched as well.
  cv::copyMakeBorder(left, left, 0, 0, kDisparities, 0, cv::BORDER_REPLICATE);
  cv::copyMakeBorder(right, right, 0, 0, kDisparities, 0, cv::BORDER_REPLICATE);
  cv::Mat found;
  opencv_parts::Matcher(kDisparities, mode)->compute(left, right, found);
  cv::Mat disparity;
  found.colRange(kDisparities, found.cols).convertTo(disparity, CV_32F, 1.0 / 16.0);
  FillRows(&disparity);
  return disparity;
}

template <typename Function>
void MeanBad(benchmark::State& state, const Function& match) {
  double bad = 0.0;
  for (auto _ : state) {
    bad = 0.0;
    for (const Pair& pair : Pairs()) bad += BadPercent(match(pair), pair.truth);
  }
  state.counters["bad_percent"] = bad / static_cast<double>(Pairs().size());
}

[[maybe_unused]] const bool kRegistered = [] {
  if (std::getenv("OMNIHDR_BENCH_MIDDLEBURY") == nullptr) return false;
  for (const Gains& gains : kGains) {
    const std::string subject = fmt::format("Planar{:g}x", gains.left / gains.right);
    const auto add = [&](const char* who, auto match) {
      benchmark::RegisterBenchmark(fmt::format("{}/{}", subject, who).c_str(),
                                   [match](benchmark::State& state) { MeanBad(state, match); })
          ->Unit(benchmark::kMillisecond)
          ->MeasureProcessCPUTime()
          ->UseRealTime()
          ->Iterations(1);
    };
    add("omnihdr", [gains](const Pair& pair) { return OurDisparity(pair, gains); });
    add("opencv_hh_matched", [gains](const Pair& pair) {
      return OpencvDisparity(pair, gains, cv::StereoSGBM::MODE_HH, true);
    });
    add("opencv_sgbm_matched", [gains](const Pair& pair) {
      return OpencvDisparity(pair, gains, cv::StereoSGBM::MODE_SGBM, true);
    });
    add("opencv_sgbm", [gains](const Pair& pair) {
      return OpencvDisparity(pair, gains, cv::StereoSGBM::MODE_SGBM, false);
    });
  }
  return true;
}();

}  // namespace
}  // namespace omnihdr
