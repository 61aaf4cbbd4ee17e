#include "core/stereo/view_synthesis.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/base/parallel_for.h"
#include "core/sphere/projection.h"

namespace omnihdr {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// Rays of a lat-long picture, the trigonometry of rows and columns made once.
class LatLongRays {
 public:
  LatLongRays(int width, int height) : grid_(Projection::Equirectangular(width, height)) {
    for (int y = 0; y < height; ++y) {
      const Eigen::Vector3d ray = grid_.RayFromPixel(0.5 * width, y + 0.5);
      rows_.emplace_back(std::hypot(ray.x(), ray.y()), ray.z());
    }
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector3d ray = grid_.RayFromPixel(x + 0.5, 0.5 * height);
      columns_.emplace_back(ray.head<2>().normalized());
    }
  }
  Eigen::Vector3d At(int x, int y) const {
    const Eigen::Vector2d& row = rows_[static_cast<std::size_t>(y)];
    const Eigen::Vector2d& column = columns_[static_cast<std::size_t>(x)];
    return {row.x() * column.x(), row.x() * column.y(), row.y()};
  }
  const Projection& grid() const { return grid_; }

 private:
  Projection grid_;
  std::vector<Eigen::Vector2d> rows_;     // cosine and sine of the elevation
  std::vector<Eigen::Vector2d> columns_;  // of the azimuth
};

// A direction or point seen from another viewpoint: homogeneous, so that what is infinitely far
// moves with the axes alone. `point` = ray + disparity·offset, in the viewpoint's axes, has the
// length old distance's inverse over the new one's.
struct Moved {
  Eigen::Matrix3d rotation;  // target from source
  Eigen::Vector3d offset;    // the source's centre in the target's axes
  Moved(const Pose& world_from_source, const Pose& world_from_target)
      : rotation((world_from_target.rotation.conjugate() * world_from_source.rotation)
                     .toRotationMatrix()),
        offset(world_from_target.CameraFromWorld(world_from_source.translation)) {}
  Eigen::Vector3d Apply(const Eigen::Vector3d& ray, double disparity) const {
    return rotation * ray + disparity * offset;
  }
};

float Tolerance(float disparity, float distance, const SynthesisOptions& options) {
  const float parallax = distance > 0.0F ? options.parallax_tolerance / distance : 0.0F;
  return std::max(options.relative_tolerance * disparity, parallax);
}

// How far from a pixel's centre, in pixels, what lands still covers it.
constexpr double kFootprint = 0.75;

// The nearest surface of a source at every pixel of the target.
Image<float> WarpForward(const SynthesisSource& source, const LatLongRays& rays,
                         const LatLongRays& target, const Moved& moved) {
  const int width = target.grid().width();
  const int height = target.grid().height();
  Image<float> nearest(width, height, 1, kNaN);
  for (int y = 0; y < source.disparity.height(); ++y) {
    for (int x = 0; x < source.disparity.width(); ++x) {
      const float disparity = source.disparity.at(x, y);
      if (!std::isfinite(disparity) || disparity < 0.0F) continue;
      const Eigen::Vector3d point = moved.Apply(rays.At(x, y), static_cast<double>(disparity));
      const double length = point.norm();
      if (!(length > 1e-9)) continue;
      const auto value = static_cast<float>(static_cast<double>(disparity) / length);
      const Eigen::Vector2d at = target.grid().PixelFromRay(point);
      const int x0 = static_cast<int>(std::floor(at.x() - 0.5));
      const int y0 = static_cast<int>(std::floor(at.y() - 0.5));
      for (int dy = 0; dy < 2; ++dy) {
        const int row = y0 + dy;
        if (row < 0 || row >= height || std::abs(row + 0.5 - at.y()) > kFootprint) continue;
        for (int dx = 0; dx < 2; ++dx) {
          if (std::abs(x0 + dx + 0.5 - at.x()) > kFootprint) continue;
          float& z = nearest.at((x0 + dx + width) % width, row);
          if (!(z >= value)) z = value;  // NaN too
        }
      }
    }
  }
  return nearest;
}

// Where a surface is stretched, its warped pixels leave cracks, through which a farther one may
// shine: a pixel most of whose neighbours are nearer by more than the tolerance, or known while it
// is not, becomes their median.
Image<float> CloseCracks(const Image<float>& map, float distance, const SynthesisOptions& options) {
  Image<float> closed(map.width(), map.height(), 1, kNaN);
  ParallelFor(map.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < map.width(); ++x) {
        const float own = map.at(x, y);
        std::array<float, 8> nearer{};
        std::size_t count = 0;
        for (int dy = -1; dy <= 1; ++dy) {
          if (y + dy < 0 || y + dy >= map.height()) continue;
          for (int dx = -1; dx <= 1; ++dx) {
            const float other = map.at((x + dx + map.width()) % map.width(), y + dy);
            if (!std::isfinite(other)) continue;
            if (std::isnan(own) || other > own + Tolerance(other, distance, options)) {
              nearer[count++] = other;
            }
          }
        }
        closed.at(x, y) = own;
        if (count < 5) continue;
        const auto middle = nearer.begin() + static_cast<std::ptrdiff_t>(count / 2);
        std::nth_element(nearer.begin(), middle,
                         nearer.begin() + static_cast<std::ptrdiff_t>(count));
        closed.at(x, y) = *middle;
      }
    }
  });
  return closed;
}

// A source as the target uses it.
struct Prepared {
  const SynthesisSource* source = nullptr;
  Moved to_source;      // from the target
  Image<float> warped;  // its disparity from the target's viewpoint
  float distance = 0.0F;
  float weight = 0.0F;
};

struct Fetched {
  bool seen = false;    // the source sees the surface
  bool hidden = false;  // another one is in its way
  std::array<float, 3> rgb{};
};

// Bilinear, from those of the four pixels that show the surface.
Fetched Fetch(const Prepared& from, const Eigen::Vector3d& ray, float disparity,
              const SynthesisOptions& options) {
  Fetched fetched;
  const SynthesisSource& source = *from.source;
  const int width = source.radiance.width();
  const int height = source.radiance.height();
  const Eigen::Vector3d point = from.to_source.Apply(ray, static_cast<double>(disparity));
  const double length = point.norm();
  if (!(length > 1e-9)) return fetched;
  const auto expected = static_cast<float>(static_cast<double>(disparity) / length);
  const Eigen::Vector2d at = Projection::Equirectangular(width, height).PixelFromRay(point);
  const double fx = at.x() - 0.5;
  const double fy = at.y() - 0.5;
  const int x0 = static_cast<int>(std::floor(fx));
  const int y0 = static_cast<int>(std::floor(fy));
  const float tolerance = Tolerance(expected, from.distance, options);
  float sum = 0.0F;
  bool nearer = false;
  for (int dy = 0; dy < 2; ++dy) {
    const int row = std::clamp(y0 + dy, 0, height - 1);
    const double wy = dy == 0 ? 1.0 - (fy - y0) : fy - y0;
    for (int dx = 0; dx < 2; ++dx) {
      const int column = (x0 + dx + width) % width;
      const float own = source.disparity.at(column, row);
      const float* rgb = source.radiance.pixel(column, row);
      if (!std::isfinite(own) || !std::isfinite(rgb[0] + rgb[1] + rgb[2])) continue;
      if (std::abs(own - expected) > tolerance) {
        nearer = nearer || own > expected;
        continue;
      }
      const auto w = static_cast<float>(wy * (dx == 0 ? 1.0 - (fx - x0) : fx - x0));
      for (std::size_t c = 0; c < 3; ++c) fetched.rgb[c] += w * rgb[c];
      sum += w;
    }
  }
  fetched.seen = sum > 1e-3F;
  fetched.hidden = !fetched.seen && nearer;
  if (fetched.seen) {
    for (float& v : fetched.rgb) v /= sum;
  }
  return fetched;
}

// The disparity most sources agree on at a pixel of the target, by their weights; of equals the
// nearer surface. NaN where none has a value.
float Agreed(const std::vector<Prepared>& sources, int x, int y, const SynthesisOptions& options) {
  float best = kNaN;
  float best_support = 0.0F;
  for (const Prepared& candidate : sources) {
    const float value = candidate.warped.at(x, y);
    if (std::isnan(value)) continue;
    float support = 0.0F;
    float sum = 0.0F;
    for (const Prepared& other : sources) {
      const float its = other.warped.at(x, y);
      if (std::isnan(its) ||
          std::abs(its - value) > Tolerance(std::max(its, value), other.distance, options)) {
        continue;
      }
      support += other.weight;
      sum += other.weight * its;
    }
    if (support > best_support || (support == best_support && value > best)) {
      best_support = support;
      best = sum / support;
    }
  }
  return best;
}

// Over the sources that see a surface; hidden: some other cannot.
struct Blended {
  std::array<float, 3> rgb{};  // sum, to be divided by
  float weight = 0.0F;
  bool hidden = false;
  bool seen() const { return weight > 0.0F; }
};

Blended BlendSeen(const std::vector<Prepared>& sources, const Eigen::Vector3d& ray, float disparity,
                  const SynthesisOptions& options) {
  Blended blended;
  if (std::isnan(disparity)) return blended;
  for (const Prepared& source : sources) {
    const Fetched fetched = Fetch(source, ray, disparity, options);
    blended.hidden = blended.hidden || fetched.hidden;
    if (!fetched.seen) continue;
    for (std::size_t c = 0; c < 3; ++c) blended.rgb[c] += source.weight * fetched.rgb[c];
    blended.weight += source.weight;
  }
  return blended;
}

// A pixel missing among at least five that are known becomes their mean: no source's grid hit it.
void CloseDots(SynthesizedView* view) {
  const int width = view->disparity.width();
  const int height = view->disparity.height();
  struct Dot {
    int x = 0;
    int y = 0;
    std::array<float, 4> value{};  // R, G, B, disparity
  };
  std::vector<std::vector<Dot>> dots(static_cast<std::size_t>(height));
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        if (!std::isnan(view->disparity.at(x, y))) continue;
        Dot dot{x, y, {}};
        float known = 0.0F;
        for (int row = std::max(y - 1, 0); row <= std::min(y + 1, height - 1); ++row) {
          for (int dx = -1; dx <= 1; ++dx) {
            const int column = (x + dx + width) % width;
            if (std::isnan(view->disparity.at(column, row))) continue;
            const float* rgb = view->radiance.pixel(column, row);
            for (std::size_t c = 0; c < 3; ++c) dot.value[c] += rgb[c];
            dot.value[3] += view->disparity.at(column, row);
            known += 1.0F;
          }
        }
        if (known < 5.0F) continue;
        for (float& v : dot.value) v /= known;
        dots[static_cast<std::size_t>(y)].push_back(dot);
      }
    }
  });
  for (const std::vector<Dot>& row : dots) {
    for (const Dot& dot : row) {
      std::copy_n(dot.value.begin(), 3, view->radiance.pixel(dot.x, dot.y));
      view->disparity.at(dot.x, dot.y) = dot.value[3];
    }
  }
}

Status CheckSources(std::span<const SynthesisSource> sources, const Pose& target, int width) {
  if (sources.empty()) return Fail(ErrorKind::kData, "no view to start from, expected one or more");
  if (width < 16 || width % 2 != 0) {
    return Fail(ErrorKind::kData, "a width of {} pixels, expected an even number from 16 on",
                width);
  }
  const auto finite = [](const Pose& pose) {
    return pose.rotation.coeffs().allFinite() && pose.translation.allFinite();
  };
  if (!finite(target)) return Fail(ErrorKind::kData, "the new viewpoint's pose is not finite");
  const int first = sources.front().radiance.width();
  for (const SynthesisSource& source : sources) {
    if (!finite(source.world_from_output)) {
      return Fail(ErrorKind::kData, "a view's pose is not finite");
    }
    if (source.radiance.width() != first ||
        source.radiance.width() != 2 * source.radiance.height() ||
        source.disparity.width() != first || source.disparity.height() != first / 2) {
      return Fail(
          ErrorKind::kData,
          "radiance of {}x{} and disparity of {}x{}, expected lat-long pictures of one size",
          source.radiance.width(), source.radiance.height(), source.disparity.width(),
          source.disparity.height());
    }
  }
  return {};
}

}  // namespace

Result<SynthesizedView> SynthesizeView(std::span<const SynthesisSource> sources,
                                       const Pose& world_from_target, int width,
                                       const SynthesisOptions& options) {
  OMNIHDR_TRY(CheckSources(sources, world_from_target, width));
  const int height = width / 2;
  const LatLongRays target(width, height);
  const LatLongRays rays(sources.front().radiance.width(), sources.front().radiance.height());
  std::vector<Prepared> prepared;
  float least = std::numeric_limits<float>::infinity();
  for (const SynthesisSource& source : sources) {
    const double distance =
        (source.world_from_output.translation - world_from_target.translation).norm();
    prepared.push_back({&source,
                        Moved(world_from_target, source.world_from_output),
                        {},
                        static_cast<float>(distance),
                        0.0F});
    least = std::min(least, prepared.back().distance);
  }
  for (Prepared& p : prepared) {
    // At a source's own place the others count little, and never nothing.
    const float scale = std::max(least, 0.01F * p.distance);
    p.weight = p.distance > 0.0F ? std::pow(scale / p.distance, options.nearness) : 1.0F;
  }
  ParallelFor(static_cast<int>(prepared.size()), 1, [&](int begin, int end) {
    for (auto k = static_cast<std::size_t>(begin); k < static_cast<std::size_t>(end); ++k) {
      const Moved moved(sources[k].world_from_output, world_from_target);
      prepared[k].warped = WarpForward(sources[k], rays, target, moved);
    }
  });
  for (Prepared& p : prepared) p.warped = CloseCracks(p.warped, p.distance, options);

  SynthesizedView view;
  view.radiance = Image<float>(width, height, 3, kNaN);
  view.disparity = Image<float>(width, height, 1, kNaN);
  std::vector<int> hidden(static_cast<std::size_t>(height));  // pixels of a row that one cannot see
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      int& hidden_here = hidden[static_cast<std::size_t>(y)];
      for (int x = 0; x < width; ++x) {
        const Eigen::Vector3d ray = target.At(x, y);
        float disparity = Agreed(prepared, x, y, options);
        Blended blended = BlendSeen(prepared, ray, disparity, options);
        // A warped edge may cover a pixel too many, where no source sees that surface: then it is
        // another that one of them has there.
        for (std::size_t k = 0; k < prepared.size() && !blended.seen(); ++k) {
          disparity = prepared[k].warped.at(x, y);
          blended = BlendSeen(prepared, ray, disparity, options);
        }
        if (!blended.seen()) continue;
        for (std::size_t c = 0; c < 3; ++c) {
          view.radiance.at(x, y, static_cast<int>(c)) = blended.rgb[c] / blended.weight;
        }
        view.disparity.at(x, y) = disparity;
        if (blended.hidden) ++hidden_here;
      }
    }
  });
  CloseDots(&view);
  double hole_area = 0.0;
  double shown_area = 0.0;
  double hidden_area = 0.0;
  for (int y = 0; y < height; ++y) {
    const double angle = target.grid().PixelSolidAngle(y);
    for (int x = 0; x < width; ++x) {
      (std::isnan(view.disparity.at(x, y)) ? hole_area : shown_area) += angle;
    }
    hidden_area += angle * hidden[static_cast<std::size_t>(y)];
  }
  view.holes = hole_area / (hole_area + shown_area);
  view.occluded = shown_area > 0.0 ? hidden_area / shown_area : 0.0;
  return view;
}

}  // namespace omnihdr
