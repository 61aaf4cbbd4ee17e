#include "core/photometry/stitch_table.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "core/base/parallel_for.h"
#include "core/photometry/mosaic.h"

namespace omnihdr {
namespace {

constexpr std::size_t kMaxBlended = 4;

// Lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012): squared distances along a line,
// in place. `f` holds the squared distances so far.
void TransformLine(std::vector<double>& f, std::vector<int>& v, std::vector<double>& z,
                   std::vector<double>& out) {
  const int n = static_cast<int>(f.size());
  v.resize(f.size());
  z.resize(f.size() + 1);
  out.resize(f.size());
  const auto at = [&f](int i) { return f[static_cast<std::size_t>(i)]; };
  int k = 0;
  v[0] = 0;
  z[0] = -std::numeric_limits<double>::infinity();
  z[1] = std::numeric_limits<double>::infinity();
  for (int q = 1; q < n; ++q) {
    double s = 0.0;
    for (;;) {
      const int p = v[static_cast<std::size_t>(k)];
      s = ((at(q) + static_cast<double>(q) * q) - (at(p) + static_cast<double>(p) * p)) /
          (2.0 * (q - p));
      if (s > z[static_cast<std::size_t>(k)] || k == 0) break;
      --k;
    }
    if (s <= z[static_cast<std::size_t>(k)]) {
      v[static_cast<std::size_t>(k)] = q;
      continue;
    }
    ++k;
    v[static_cast<std::size_t>(k)] = q;
    z[static_cast<std::size_t>(k)] = s;
    z[static_cast<std::size_t>(k) + 1] = std::numeric_limits<double>::infinity();
  }
  k = 0;
  for (int q = 0; q < n; ++q) {
    while (z[static_cast<std::size_t>(k) + 1] < q) ++k;
    const int p = v[static_cast<std::size_t>(k)];
    out[static_cast<std::size_t>(q)] = static_cast<double>(q - p) * (q - p) + at(p);
  }
  f = out;
}

// Angle from a sensor's pixel to the edge of what the sensor sees, on nodes.
class EdgeMap {
 public:
  EdgeMap(const RigSensor& sensor, ImageView<const std::uint8_t> mask) {
    const Lens& lens = sensor.lens;
    // Edges are smooth, and feathers wide.
    node_ = std::clamp(std::min(lens.width(), lens.height()) / 128, 1, 8);
    // One node beyond each side: the border is an edge.
    columns_ = (lens.width() + node_ - 1) / node_ + 2;
    rows_ = (lens.height() + node_ - 1) / node_ + 2;
    angle_ = Image<float>(columns_, rows_);
    constexpr double kFar = 1e12;
    std::vector<double> squared(angle_.size(), 0.0);
    Image<float> scale(columns_, rows_);
    ParallelFor(rows_ - 2, 4, [&](int begin, int end) {
      for (int i = begin + 1; i < end + 1; ++i) {
        for (int j = 1; j < columns_ - 1; ++j) {
          const double x = (j - 0.5) * node_;
          const double y = (i - 0.5) * node_;
          if (!Usable(mask, j, i)) continue;
          const auto ray = lens.RayFromPixel(x, y);
          if (!ray ||
              (lens.PixelFromRay(*ray).value_or(Eigen::Vector2d(-9, -9)) - Eigen::Vector2d(x, y))
                      .norm() > 0.5) {
            continue;
          }
          const auto right = lens.RayFromPixel(x + 1.0, y);
          const auto below = lens.RayFromPixel(x, y + 1.0);
          squared[Index(j, i)] = kFar;
          if (right && below) {
            scale.at(j, i) =
                static_cast<float>(std::sqrt((*right - *ray).cross(*below - *ray).norm()));
          }
        }
      }
    });
    std::vector<double> line;
    std::vector<double> out;
    std::vector<double> z;
    std::vector<int> v;
    for (int i = 0; i < rows_; ++i) {
      line.assign(squared.begin() + static_cast<std::ptrdiff_t>(Index(0, i)),
                  squared.begin() + static_cast<std::ptrdiff_t>(Index(0, i)) + columns_);
      TransformLine(line, v, z, out);
      std::copy(line.begin(), line.end(),
                squared.begin() + static_cast<std::ptrdiff_t>(Index(0, i)));
    }
    for (int j = 0; j < columns_; ++j) {
      line.resize(static_cast<std::size_t>(rows_));
      for (int i = 0; i < rows_; ++i) line[static_cast<std::size_t>(i)] = squared[Index(j, i)];
      TransformLine(line, v, z, out);
      for (int i = 0; i < rows_; ++i) squared[Index(j, i)] = line[static_cast<std::size_t>(i)];
    }
    // Where a node has no neighbour inside, the picture's mean scale serves.
    double sum = 0.0;
    int count = 0;
    for (const float s : scale.values()) {
      if (s <= 0.0F) continue;
      sum += s;
      ++count;
    }
    const auto mean = static_cast<float>(count > 0 ? sum / count : 0.0);
    for (int i = 0; i < rows_; ++i) {
      for (int j = 0; j < columns_; ++j) {
        const float radians_per_pixel = scale.at(j, i) > 0.0F ? scale.at(j, i) : mean;
        // The edge lies up to a node before the first unusable one, nodes are interpolated, and a
        // block reaches three pixels towards it.
        const double pixels = std::max(0.0, node_ * (std::sqrt(squared[Index(j, i)]) - 1.5) - 3.0);
        angle_.at(j, i) = static_cast<float>(pixels) * radians_per_pixel;
      }
    }
  }

  // 0 outside and at the edge.
  double At(const Eigen::Vector2d& pixel) const {
    const double gx = std::clamp(pixel.x() / node_ + 0.5, 0.0, columns_ - 1.000001);
    const double gy = std::clamp(pixel.y() / node_ + 0.5, 0.0, rows_ - 1.000001);
    const int j = static_cast<int>(gx);
    const int i = static_cast<int>(gy);
    const double u = gx - j;
    const double v = gy - i;
    return (1 - v) * ((1 - u) * angle_.at(j, i) + u * angle_.at(j + 1, i)) +
           v * ((1 - u) * angle_.at(j, i + 1) + u * angle_.at(j + 1, i + 1));
  }

 private:
  std::size_t Index(int j, int i) const {
    return static_cast<std::size_t>(i) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(j);
  }
  bool Usable(ImageView<const std::uint8_t> mask, int j, int i) const {
    if (mask.empty()) return true;
    for (int y = (i - 1) * node_; y < std::min(i * node_, mask.height()); ++y) {
      for (int x = (j - 1) * node_; x < std::min(j * node_, mask.width()); ++x) {
        if (mask.at(x, y) < 128) return false;
      }
    }
    return true;
  }

  int node_ = 1;  // pixels between nodes
  int columns_ = 0;
  int rows_ = 0;
  Image<float> angle_;
};

// The picture point from which vignetting is measured: where the axis meets the raw picture (of a
// grid lens, centre() belongs to the rectified one).
Eigen::Vector2d PictureCentre(const Lens& lens) {
  if (lens.kind() != LensKind::kGrid) return lens.centre();
  return lens.PixelFromRay(Eigen::Vector3d::UnitZ())
      .value_or(Eigen::Vector2d(0.5 * lens.width(), 0.5 * lens.height()));
}

// A sensor as the loop over the panorama needs it.
struct Eye {
  const RigSensor* sensor = nullptr;
  EdgeMap edge;
  ImageView<const std::uint8_t> mask;
  Eigen::Vector2d centre;
  double half_diagonal = 1.0;
  Eigen::Vector3d axis_in_camera;
  double least_cosine = -1.0;
  std::uint32_t first = 0;  // index of its first value in the stacked frame
  int red_x = 0;            // place of red in the tile
  int red_y = 0;
};

struct Sample {
  std::uint8_t sensor = 0;
  std::uint32_t block = 0;
  std::uint32_t packed = 0;  // without the share
  double edge = 0.0;
  double share = 0.0;
  float shade = 1.0F;
};

// The sample of one sensor; nothing when it does not see the point with a whole block round it.
std::optional<Sample> SampleOf(const Eye& eye, int stack_width, const Eigen::Vector3d& ray,
                               double distance) {
  const Pose& pose = eye.sensor->camera_from_sensor;
  const Eigen::Vector3d towards =
      std::isinf(distance) ? ray : Eigen::Vector3d(ray * distance - pose.translation);
  if (towards.dot(eye.axis_in_camera) < eye.least_cosine * towards.norm()) return std::nullopt;
  const auto pixel = SensorPixelFromRay(*eye.sensor, ray, distance);
  if (!pixel) return std::nullopt;
  const double x = pixel->x() - 0.5;
  const double y = pixel->y() - 0.5;
  const int i = static_cast<int>(std::floor(x));
  const int j = static_cast<int>(std::floor(y));
  const Lens& lens = eye.sensor->lens;
  if (i < 1 || j < 1 || i + 2 >= lens.width() || j + 2 >= lens.height()) return std::nullopt;
  if (!eye.mask.empty()) {
    for (int dy = -1; dy <= 2; ++dy) {
      for (int dx = -1; dx <= 2; ++dx) {
        if (eye.mask.at(i + dx, j + dy) < 128) return std::nullopt;
      }
    }
  }
  Sample s;
  s.edge = eye.edge.At(*pixel);
  if (!(s.edge > 0.0)) return std::nullopt;
  const auto fraction = [](double v) {
    return std::min(255U, static_cast<std::uint32_t>(std::lround(256.0 * v)));
  };
  s.block = eye.first + static_cast<std::uint32_t>((j - 1) * stack_width + i - 1);
  s.packed = fraction(x - i) | fraction(y - j) << 8U |
             static_cast<std::uint32_t>((i - 1 - eye.red_x) & 1) << 30U |
             static_cast<std::uint32_t>((j - 1 - eye.red_y) & 1) << 31U;
  const double rho = (*pixel - eye.centre).norm() / eye.half_diagonal;
  s.shade = static_cast<float>(1.0 / eye.sensor->vignetting.At(rho));
  return s;
}

// Shares of the sensors that see a pixel, largest first; those that round to nothing are dropped.
void Blend(std::vector<Sample>& samples, double blend_width) {
  double widest = 0.0;
  for (const Sample& s : samples) widest = std::max(widest, s.edge);
  double total = 0.0;
  const double width = std::max(blend_width, 1e-9);
  for (Sample& s : samples) {
    s.share = std::min(1.0, s.edge / width) * std::max(0.0, 1.0 - (widest - s.edge) / width);
    total += s.share;
  }
  for (Sample& s : samples) s.share /= total;
  std::stable_sort(samples.begin(), samples.end(),
                   [](const Sample& a, const Sample& b) { return a.share > b.share; });
  if (samples.size() > kMaxBlended) samples.resize(kMaxBlended);
  while (samples.size() > 1 && samples.back().share * kFullShare < 0.5) samples.pop_back();
  // Segments are runs of equal sensor sets: one order for a set.
  std::sort(samples.begin(), samples.end(),
            [](const Sample& a, const Sample& b) { return a.sensor < b.sensor; });
  for (Sample& s : samples) {
    const std::uint32_t share =
        samples.size() == 1
            ? kFullShare
            : std::clamp(static_cast<std::uint32_t>(std::lround(s.share * kFullShare)), 1U,
                         kFullShare);
    s.packed |= share << 16U;
  }
}

// Σ of the squared weights of the values a colour is interpolated from, per channel.
std::array<double, 3> SquaredWeights(BayerOrder bayer, std::uint32_t packed) {
  const double fx = static_cast<double>(packed & 255U) / 256.0;
  const double fy = static_cast<double>(packed >> 8U & 255U) / 256.0;
  if (bayer == BayerOrder::kNone) {
    const double one = ((1 - fx) * (1 - fx) + fx * fx) * ((1 - fy) * (1 - fy) + fy * fy);
    return {one, one, one};
  }
  // Columns 0 and 2 of the block, then 1 and 3.
  const std::array<double, 2> sx = {(1 + fx * fx) / 2, 1 - fx + fx * fx / 2};
  const std::array<double, 2> sy = {(1 + fy * fy) / 2, 1 - fy + fy * fy / 2};
  std::array<double, 3> sum{};
  for (std::size_t row = 0; row < 2; ++row) {
    for (std::size_t column = 0; column < 2; ++column) {
      const std::size_t c = (column ^ (packed >> 30U & 1U)) + (row ^ packed >> 31U);
      sum[c] += (c == 1 ? 0.25 : 1.0) * sx[column] * sy[row];
    }
  }
  return sum;
}

struct RowOfSamples {
  std::vector<StitchSegment> segments;  // first counts from the row's first sample
  std::vector<std::uint32_t> block;
  std::vector<std::uint32_t> packed;
  std::vector<float> shade;
  int covered = 0;
};

void AppendSegment(const std::vector<std::vector<Sample>>& pixels, int x0, int x1,
                   RowOfSamples* row) {
  StitchSegment segment;
  segment.x0 = x0;
  segment.x1 = x1;
  segment.first = static_cast<std::uint32_t>(row->block.size());
  const std::vector<Sample>& front = pixels[static_cast<std::size_t>(x0)];
  segment.count = static_cast<std::uint8_t>(front.size());
  for (std::size_t k = 0; k < front.size(); ++k) {
    segment.sensors[k] = front[k].sensor;
    for (int x = x0; x < x1; ++x) {
      const Sample& s = pixels[static_cast<std::size_t>(x)][k];
      row->block.push_back(s.block);
      row->packed.push_back(s.packed);
      row->shade.push_back(s.shade);
    }
  }
  row->segments.push_back(segment);
}

bool SameSensors(const std::vector<Sample>& a, const std::vector<Sample>& b) {
  return a.size() == b.size() &&
         std::equal(a.begin(), a.end(), b.begin(),
                    [](const Sample& p, const Sample& q) { return p.sensor == q.sensor; });
}

void CountNoise(const Rig& rig, StitchTable* table) {
  table->noise_gain.resize(rig.sensors.size());
  table->largest_shade.assign(rig.sensors.size(), 0.0F);
  double pixels = 0.0;
  for (const std::vector<StitchSegment>& segments : table->rows) {
    for (const StitchSegment& segment : segments) {
      const auto length = static_cast<std::size_t>(segment.x1 - segment.x0);
      pixels += static_cast<double>(length);
      for (std::size_t k = 0; k < segment.count; ++k) {
        const std::uint8_t s = segment.sensors[k];
        const RigSensor& sensor = rig.sensors[s];
        StitchNoiseGain& noise = table->noise_gain[s];
        for (std::size_t i = segment.first + k * length; i < segment.first + (k + 1) * length;
             ++i) {
          const double share = static_cast<double>(ShareOf(table->packed[i])) / kFullShare;
          const double shade = table->shade[i];
          table->largest_shade[s] = std::max(table->largest_shade[s], table->shade[i]);
          const std::array<double, 3> squares = SquaredWeights(sensor.bayer, table->packed[i]);
          for (std::size_t c = 0; c < 3; ++c) {
            const double factor = shade * sensor.gain[c];
            noise.floor[c] += share * share * factor * factor * squares[c];
            noise.per_radiance[c] += share * share * factor * squares[c];
          }
        }
      }
    }
  }
  for (StitchNoiseGain& noise : table->noise_gain) {
    for (std::size_t c = 0; c < 3; ++c) {
      noise.floor[c] /= std::max(1.0, pixels);
      noise.per_radiance[c] /= std::max(1.0, pixels);
    }
  }
  table->covered = pixels / (static_cast<double>(table->width) * table->height);
}

}  // namespace

Result<StitchTable> BuildStitchTable(const Rig& rig, const SphereGrid& grid,
                                     const StitchMasks& masks) {
  OMNIHDR_TRY(rig.Validate());
  OMNIHDR_ASSIGN(const std::vector<int> stacked, StackedRows(rig));
  const int stack_width = rig.sensors.front().lens.width();
  const auto check = [](const char* what, ImageView<const std::uint8_t> mask, int width,
                        int height) -> Status {
    if (mask.empty() || (mask.width() == width && mask.height() == height)) return {};
    return Fail(ErrorKind::kData, "{} mask of {}x{}, expected {}x{}", what, mask.width(),
                mask.height(), width, height);
  };
  OMNIHDR_TRY(check("sensor", masks.sensors, stack_width, stacked.back()));
  OMNIHDR_TRY(check("panorama", masks.panorama, grid.width(), grid.height()));

  std::vector<Eye> eyes;
  for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
    const RigSensor& sensor = rig.sensors[s];
    const ImageView<const std::uint8_t> mask =
        masks.sensors.empty()
            ? masks.sensors
            : masks.sensors.Crop(0, stacked[s], stack_width, sensor.lens.height());
    Eye eye{.sensor = &sensor,
            .edge = EdgeMap(sensor, mask),
            .mask = mask,
            .centre = PictureCentre(sensor.lens),
            .axis_in_camera = {}};
    eye.half_diagonal = 0.5 * std::hypot(sensor.lens.width(), sensor.lens.height());
    eye.axis_in_camera = sensor.camera_from_sensor.rotation * Eigen::Vector3d::UnitZ();
    eye.least_cosine = std::cos(std::min(sensor.lens.max_angle() + 1e-6, std::numbers::pi));
    eye.first = static_cast<std::uint32_t>(stacked[s]) * static_cast<std::uint32_t>(stack_width);
    if (sensor.bayer != BayerOrder::kNone) {
      while (BayerChannel(sensor.bayer, eye.red_x, eye.red_y) != 0) {
        eye.red_y += eye.red_x;
        eye.red_x ^= 1;
      }
    }
    eyes.push_back(std::move(eye));
  }

  const int width = grid.width();
  const int height = grid.height();
  const double blend_width = rig.blend_width_deg * std::numbers::pi / 180.0;
  std::vector<RowOfSamples> rows(static_cast<std::size_t>(height));
  ParallelFor(height, 4, [&](int begin, int end) {
    std::vector<std::vector<Sample>> pixels(static_cast<std::size_t>(width));
    for (int y = begin; y < end; ++y) {
      RowOfSamples& row = rows[static_cast<std::size_t>(y)];
      for (int x = 0; x < width; ++x) {
        std::vector<Sample>& samples = pixels[static_cast<std::size_t>(x)];
        samples.clear();
        if (!masks.panorama.empty() && masks.panorama.at(x, y) < 128) continue;
        const std::optional<Eigen::Vector3d> ray = grid.RayFromPixel(x + 0.5, y + 0.5);
        if (!ray) continue;
        for (std::size_t s = 0; s < eyes.size(); ++s) {
          if (auto sample = SampleOf(eyes[s], stack_width, *ray, rig.sphere_radius_m)) {
            sample->sensor = static_cast<std::uint8_t>(s);
            samples.push_back(*sample);
          }
        }
        if (!samples.empty()) {
          Blend(samples, blend_width);
          ++row.covered;
        }
      }
      for (int x0 = 0; x0 < width;) {
        const std::vector<Sample>& front = pixels[static_cast<std::size_t>(x0)];
        int x1 = x0 + 1;
        while (x1 < width && SameSensors(front, pixels[static_cast<std::size_t>(x1)])) ++x1;
        if (!front.empty()) AppendSegment(pixels, x0, x1, &row);
        x0 = x1;
      }
    }
  });

  StitchTable table;
  table.width = width;
  table.height = height;
  std::size_t total = kStitchPadding;
  for (const RowOfSamples& row : rows) total += row.block.size();
  table.block.reserve(total);
  table.packed.reserve(total);
  table.shade.reserve(total);
  for (RowOfSamples& row : rows) {
    for (StitchSegment& segment : row.segments) {
      segment.first += static_cast<std::uint32_t>(table.block.size());
    }
    table.rows.push_back(std::move(row.segments));
    table.block.insert(table.block.end(), row.block.begin(), row.block.end());
    table.packed.insert(table.packed.end(), row.packed.begin(), row.packed.end());
    table.shade.insert(table.shade.end(), row.shade.begin(), row.shade.end());
    row = {};
  }
  table.block.resize(total, 0);
  table.packed.resize(total, 0);
  table.shade.resize(total, 0.0F);
  CountNoise(rig, &table);
  return table;
}

}  // namespace omnihdr
