#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <vector>

#include "core/photometry/measure.h"
#include "core/stereo/fuse.h"
#include "core/stereo/sgm.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"
#include "tests/support/room.h"

namespace omnihdr::testing {

inline constexpr int kFrameWidth = 256;
inline constexpr int kMapWidth = 256;

inline Measurement MeasureOne(const DecodedImage& image, double seconds,
                              const Projection& projection, const NoiseModel& noise = {},
                              ImageView<const std::uint8_t> mask = {}) {
  MeasureOptions options;
  options.noise = noise;
  const std::vector<ExposedFrame> frames = {{&image, {ExposureTime::Seconds(seconds), {}}}};
  Result<Measurement> m = Measure(frames, projection, *Response::Linear(), 8, mask, options);
  EXPECT_TRUE(m) << m.error().message;
  return std::move(*m);
}

// Radiance without any limit or noise as a measurement.
inline Measurement Perfect(const Image<float>& radiance, const Projection& projection) {
  Measurement m;
  m.projection = projection;
  m.radiance = Image<float>(radiance.width(), radiance.height(), 4);
  m.flags = Image<std::uint8_t>(radiance.width(), radiance.height());
  for (int y = 0; y < radiance.height(); ++y) {
    for (int x = 0; x < radiance.width(); ++x) {
      for (int c = 0; c < 3; ++c) m.radiance.at(x, y, c) = radiance.at(x, y, c);
      m.radiance.at(x, y, 3) = 1.0F;
    }
  }
  m.saturation = {1000.0F, 1000.0F, 1000.0F};
  m.variance_floor = {1e-8F, 1e-8F, 1e-8F};
  m.variance_per_radiance = {1e-6F, 1e-6F, 1e-6F};
  m.noise_floor = 1e-3F;
  m.longest_exposure_s = m.shortest_exposure_s = 1.0;
  return m;
}

// The room as seen from places along a line, and the truth of it.
struct Drive {
  Room room;
  std::vector<Pose> poses;
  std::vector<Truth> truths;
  Projection projection = Projection::Equirectangular(kFrameWidth, kFrameWidth / 2);

  static Drive Through(Room room, const std::vector<Pose>& poses) {
    Drive drive;
    drive.room = std::move(room);
    drive.poses = poses;
    for (const Pose& pose : poses)
      drive.truths.push_back(Render(drive.room, drive.projection, pose));
    return drive;
  }
  Eigen::Vector3f Offset(std::size_t from, std::size_t to) const {
    return (poses[to].translation - poses[from].translation).cast<float>();
  }
  // True disparity seen from place k, on the world-aligned grid of a map.
  DisparityMap TrueDisparity(std::size_t k) const {
    Pose aligned;
    aligned.translation = poses[k].translation;
    const Projection grid = Projection::Equirectangular(kMapWidth, kMapWidth / 2);
    DisparityMap map;
    map.disparity = Image<float>(kMapWidth, kMapWidth / 2);
    map.confidence = Image<float>(kMapWidth, kMapWidth / 2, 1, 1.0F);
    for (int y = 0; y < map.disparity.height(); ++y) {
      for (int x = 0; x < map.disparity.width(); ++x) {
        const Room::Hit hit = room.Look(aligned.translation, grid.RayFromPixel(x + 0.5, y + 0.5));
        map.disparity.at(x, y) = static_cast<float>(1.0 / hit.distance);
      }
    }
    return map;
  }
};

inline Room FurnishedRoom() {
  Room room;
  room.balls.push_back({{2.5, 1.2, 0.0}, 0.6, 1.0F});
  room.balls.push_back({{-1.0, -1.6, -0.5}, 0.5, 1.5F});
  room.balls.push_back({{0.5, 2.2, 0.6}, 0.7, 0.7F});
  return room;
}

// Five places a quarter of a metre apart along X, the third at the origin.
inline std::vector<Pose> FivePlaces(double step = 0.25) {
  std::vector<Pose> poses;
  for (int k = -2; k <= 2; ++k) {
    Pose pose;
    pose.translation = {step * k, 0.0, 0.0};
    poses.push_back(pose);
  }
  return poses;
}

// Share of pixels, away from the poles, where `predicate(x, y)` holds among those where `counts`
// does.
template <typename Counts, typename Predicate>
double Share(int width, int height, Counts counts, Predicate predicate) {
  int all = 0;
  int good = 0;
  for (int y = height / 16; y < height - height / 16; ++y) {
    for (int x = 0; x < width; ++x) {
      if (!counts(x, y)) continue;
      ++all;
      good += predicate(x, y) ? 1 : 0;
    }
  }
  return all == 0 ? 0.0 : static_cast<double>(good) / all;
}

}  // namespace omnihdr::testing
