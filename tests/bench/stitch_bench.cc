#include <fmt/format.h>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <variant>
#include <vector>

#include "core/photometry/stitch.h"
#include "core/session/rig_file.h"
#include "tests/bench/bench.h"
#include "tests/support/ring.h"

// Six raw Bayer sensors of 1024×768 to a panorama of 2.1 million pixels in linear radiance: ours,
// and what is put together from OpenCV's parts, with all maps made before.
namespace omnihdr {
namespace {

const Rig& Head() {
  static const Rig rig = [] {
    Result<Rig> read =
        ReadRig(std::filesystem::path(OMNIHDR_SOURCE_DIR) / "config" / "rigs" / "ladybug2.toml");
    if (!read) std::abort();
    return *std::move(read);
  }();
  return rig;
}

// Shades, edges and lamps on a far sphere.
Eigen::Vector3d Scene(const Eigen::Vector3d& point) {
  const Eigen::Vector3d u = point.normalized();
  double level = 0.15 * std::pow(4.0, u.x() + 0.5 * u.z());
  if (std::sin(40.0 * u.x()) * std::sin(37.0 * u.y()) * std::sin(43.0 * u.z()) > 0.0) level *= 2.0;
  if ((u - Eigen::Vector3d(0.8, 0.0, 0.6)).norm() < 0.05) level = 20.0;
  return {level * (1.0 + 0.2 * u.y()), level, level * (1.0 - 0.2 * u.y())};
}

const DecodedImage& RawFrame() {
  static const DecodedImage image =
      testing::ShootRing(Head(), Scene, Head().sphere_radius_m, 1.0, 8, 0.7);
  return image;
}

SphereGrid LatLong() { return SphereGrid::Equirectangular(2048, 1024); }
SphereGrid RdMap() { return SphereGrid::RhombicDodecahedron(418); }

// --- ours

void StitchOnce(Stitcher& stitcher, double read_noise, Demosaic demosaic, Measurement* out) {
  MeasureOptions options;
  options.noise.read = read_noise;
  options.demosaic = demosaic;
  const std::vector<RigFrame> frames = {{&RawFrame(), {{ExposureTime::Seconds(1.0), GainDb{}}}}};
  static const std::vector<Response> responses = {*Response::Linear()};
  if (!stitcher.Stitch(frames, responses, 8, options, out)) std::abort();
}

void Omnihdr(benchmark::State& state, const SphereGrid& grid, double read_noise,
             Demosaic demosaic) {
  Stitcher stitcher = Stitcher::Create(Head(), grid, {}).value();
  Measurement out;
  StitchOnce(stitcher, read_noise, demosaic, &out);
  for (auto _ : state) {
    StitchOnce(stitcher, read_noise, demosaic, &out);
    benchmark::DoNotOptimize(out.radiance.data());
  }
}

// --- OpenCV's parts: demosaic a sensor, remap what the panorama shows of it, weigh and add up

int DemosaicCode(BayerOrder order) {
  switch (order) {
    case BayerOrder::kRggb:  // OpenCV names the colours of the second row and column
      return cv::COLOR_BayerBG2RGB;
    case BayerOrder::kGrbg:
      return cv::COLOR_BayerGB2RGB;
    case BayerOrder::kGbrg:
      return cv::COLOR_BayerGR2RGB;
    case BayerOrder::kBggr:
      return cv::COLOR_BayerRG2RGB;
    case BayerOrder::kNone:
      break;
  }
  std::abort();
}

class OpencvStitcher {
 public:
  explicit OpencvStitcher(const SphereGrid& grid) : grid_(grid) {
    const StitchTable table = BuildStitchTable(Head(), grid, {}).value();
    // Tight rectangles: of the faces, or of tiles of a lat-long.
    const int tile_width = grid.faces() > 1 ? grid.face_width() : 256;
    const int tile_height = grid.faces() > 1 ? grid.face_height() : 256;
    std::map<std::pair<std::size_t, int>, cv::Rect> tiles;  // by sensor and tile
    const auto visit = [&](const auto& apply) {
      for (int y = 0; y < table.height; ++y) {
        for (const StitchSegment& s : table.rows[static_cast<std::size_t>(y)]) {
          for (std::size_t k = 0; k < s.count; ++k) {
            for (int x = s.x0; x < s.x1; ++x) {
              const std::size_t i = s.first + k * static_cast<std::size_t>(s.x1 - s.x0) +
                                    static_cast<std::size_t>(x - s.x0);
              const int tile = y / tile_height * 64 + x / tile_width;
              apply(x, y, s.sensors[k], tile, i);
            }
          }
        }
      }
    };
    visit([&](int x, int y, std::size_t sensor, int tile, std::size_t) {
      cv::Rect& r = tiles[{sensor, tile}];
      r = r.empty() ? cv::Rect(x, y, 1, 1) : r | cv::Rect(x, y, 1, 1);
    });
    pieces_.resize(Head().sensors.size());
    std::map<std::pair<std::size_t, int>, std::size_t> index;
    for (const auto& [key, rect] : tiles) {
      index[key] = pieces_[key.first].size();
      Piece piece;
      piece.rect = rect;
      piece.weight = cv::Mat::zeros(rect.size(), CV_32FC3);
      cv::Mat x(rect.size(), CV_32F, cv::Scalar(-10.0));
      cv::Mat y(rect.size(), CV_32F, cv::Scalar(-10.0));
      for (int i = 0; i < rect.height; ++i) {
        for (int j = 0; j < rect.width; ++j) {
          const auto ray = grid.RayFromPixel(rect.x + j + 0.5, rect.y + i + 0.5);
          const auto at =
              ray ? SensorPixelFromRay(Head().sensors[key.first], *ray, Head().sphere_radius_m)
                  : std::nullopt;
          if (!at) continue;
          x.at<float>(i, j) = static_cast<float>(at->x() - 0.5);
          y.at<float>(i, j) = static_cast<float>(at->y() - 0.5);
        }
      }
      cv::convertMaps(x, y, piece.points, piece.fractions, CV_16SC2);
      pieces_[key.first].push_back(std::move(piece));
    }
    visit([&](int x, int y, std::size_t sensor, int tile, std::size_t i) {
      Piece& piece = pieces_[sensor][index[{sensor, tile}]];
      auto& weight = piece.weight.at<cv::Vec3f>(y - piece.rect.y, x - piece.rect.x);
      for (int c = 0; c < 3; ++c) {
        weight[c] = static_cast<float>(ShareOf(table.packed[i])) / static_cast<float>(kFullShare) *
                    table.shade[i] *
                    static_cast<float>(Head().sensors[sensor].gain[static_cast<std::size_t>(c)]) /
                    128.0F;
      }
    });
    radiance = cv::Mat(grid.height(), grid.width(), CV_32FC3);
  }

  void Stitch(bool blend) {
    auto& pixels = const_cast<Image<std::uint8_t>&>(  // cv::Mat has no constant pixels
        std::get<Image<std::uint8_t>>(RawFrame().pixels));
    if (blend) radiance.setTo(0.0);
    int row = 0;
    for (std::size_t s = 0; s < pieces_.size(); ++s) {
      const Lens& lens = Head().sensors[s].lens;
      const cv::Mat raw(lens.height(), lens.width(), CV_8UC1, pixels.row(row));
      row += lens.height();
      cv::demosaicing(raw, colour_, DemosaicCode(Head().sensors[s].bayer));
      for (const Piece& piece : pieces_[s]) {
        cv::remap(colour_, warped_, piece.points, piece.fractions, cv::INTER_LINEAR,
                  cv::BORDER_CONSTANT);
        if (!blend) continue;
        warped_.convertTo(floats_, CV_32FC3);
        cv::Mat target = radiance(piece.rect);
        cv::accumulateProduct(floats_, piece.weight, target);
      }
    }
  }

  // Median relative difference of green from our panorama, where that is measured.
  double DifferenceFromOurs() {
    Stitcher stitcher = Stitcher::Create(Head(), grid_, {}).value();
    Measurement ours;
    StitchOnce(stitcher, 0.5, Demosaic::kBilinear, &ours);
    Stitch(true);
    std::vector<double> differences;
    for (int y = 0; y < grid_.height(); y += 3) {
      for (int x = 0; x < grid_.width(); x += 3) {
        if (ours.flags.at(x, y) != 0) continue;
        differences.push_back(
            std::abs(radiance.at<cv::Vec3f>(y, x)[1] / ours.radiance.at(x, y, 1) - 1.0F));
      }
    }
    if (differences.empty()) return 1.0;
    std::nth_element(differences.begin(), differences.begin() + differences.size() / 2,
                     differences.end());
    return differences[differences.size() / 2];
  }

  cv::Mat radiance;

 private:
  struct Piece {
    cv::Rect rect;
    cv::Mat points;
    cv::Mat fractions;
    cv::Mat weight;
  };
  SphereGrid grid_;
  std::vector<std::vector<Piece>> pieces_;  // by sensor
  cv::Mat colour_;
  cv::Mat warped_;
  cv::Mat floats_;
};

void Opencv(benchmark::State& state, const SphereGrid& grid, bool blend) {
  OpencvStitcher stitcher(grid);
  const double difference = stitcher.DifferenceFromOurs();
  if (difference > 0.02) {
    state.SkipWithError(fmt::format("differs from ours by {:.3f}", difference).c_str());
  }
  for (auto _ : state) {
    stitcher.Stitch(blend);
    benchmark::DoNotOptimize(stitcher.radiance.data);
  }
}

void Register() {
  const auto time = [](benchmark::internal::Benchmark* b) {
    b->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();
  };
  constexpr Demosaic kBilinear = Demosaic::kBilinear;
  time(benchmark::RegisterBenchmark("Stitch/omnihdr", Omnihdr, LatLong(), 0.5, kBilinear));
  time(benchmark::RegisterBenchmark("Stitch/opencv", Opencv, LatLong(), true));
  time(benchmark::RegisterBenchmark("Stitch/opencv_unblended", Opencv, LatLong(), false));
  time(benchmark::RegisterBenchmark("StitchRdMap/omnihdr", Omnihdr, RdMap(), 0.5, kBilinear));
  time(benchmark::RegisterBenchmark("StitchRdMap/opencv", Opencv, RdMap(), true));
  time(benchmark::RegisterBenchmark("StitchRdMap/opencv_unblended", Opencv, RdMap(), false));
  time(benchmark::RegisterBenchmark("StitchEdgeAware/omnihdr", Omnihdr, LatLong(), 0.5,
                                    Demosaic::kEdgeAware));
  // The read noise measured on every frame.
  time(benchmark::RegisterBenchmark("StitchEstimatingNoise/omnihdr", Omnihdr, LatLong(), 0.0,
                                    kBilinear));
}

[[maybe_unused]] const bool kRegistered = [] {
  Register();
  return true;
}();

}  // namespace
}  // namespace omnihdr
