#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <random>
#include <span>
#include <vector>

#include "core/photometry/measure.h"
#include "core/pose/pose_tracker.h"
#include "drivers/sim/world.h"

namespace omnihdr::pose_accuracy_test {
namespace {

constexpr int kPositions = 6;
constexpr double kStep = 0.3;  // metres
constexpr double kDegree = M_PI / 180.0;

struct Ride {
  Projection projection;
  std::vector<Pose> poses;
  std::vector<Image<float>> radiance;
  double median = 0.0;  // of the first picture's radiance
};

Ride Drive(sim::SceneKind kind, const Projection& projection) {
  const auto world = sim::World::Create(kind, 11);
  Ride ride;
  ride.projection = projection;
  for (int i = 0; i < kPositions; ++i) {
    sim::MotionOptions motion;
    motion.yaw_deg_per_m = 5.0;
    ride.poses.push_back(world->PoseAt(kStep * i, motion));
    ride.radiance.push_back(world->Render(ride.poses.back(), projection, 4).radiance);
  }
  std::vector<float> green;
  for (std::size_t k = 1; k < ride.radiance[0].size(); k += 3) {
    green.push_back(ride.radiance[0].values()[k]);
  }
  const auto middle = green.begin() + static_cast<std::ptrdiff_t>(green.size() / 2);
  std::nth_element(green.begin(), middle, green.end());
  ride.median = static_cast<double>(*middle);
  return ride;
}

// What a linear, noisy, clipping 8-bit sensor makes of it.
Measurement Expose(const Ride& ride, int i, double exposure_s) {
  const Image<float>& radiance = ride.radiance[static_cast<std::size_t>(i)];
  std::mt19937 random(static_cast<std::uint32_t>(i) + 1);
  Image<std::uint8_t> picture(radiance.width(), radiance.height(), 3);
  for (int y = 0; y < radiance.height(); ++y) {
    for (int k = 0; k < 3 * radiance.width(); ++k) {
      const double value = 128.0 * static_cast<double>(radiance.row(y)[k]) * exposure_s;
      double noise = -3.0;
      for (int n = 0; n < 3; ++n) noise += static_cast<double>(random()) / 2147483648.0;
      picture.row(y)[k] = static_cast<std::uint8_t>(
          std::clamp(value + noise * std::sqrt(0.25 + 0.02 * value) + 0.5, 0.0, 255.0));
    }
  }
  const DecodedImage image{std::move(picture)};
  const ExposedFrame frame{&image, Exposure{ExposureTime::Seconds(exposure_s), GainDb{0.0}}};
  return *Measure(std::span(&frame, 1), ride.projection, *Response::Linear(), 8, {}, {});
}

// Largest errors of a chain against the truth, in the frame of its first position: degrees, and
// share of the distance from the first; without odometer after the one scale that fits best.
struct Errors {
  double rotation_deg = 0.0;
  double translation_share = 0.0;
  // Root mean squares of the errors in sigmas, axis by axis; relative to the first position, which
  // is what is held.
  double rotation_sigmas = 0.0;
  double translation_sigmas = 0.0;
};

Errors Track(const Ride& ride, double stops, bool triangle, bool odometer) {
  const auto tracker = std::move(*PoseTracker::Create({}));
  // The longest exposure clips about half of the picture.
  const double middle_exposure_s = 255.0 / std::exp2(stops) / 128.0 / ride.median;
  for (int i = 0; i < kPositions; ++i) {
    const int step = triangle ? std::array{0, 1, 2, 1}[static_cast<std::size_t>(i % 4)] : i % 3;
    const double exposure_s = middle_exposure_s * std::exp2(stops * (step - 1));
    const double driven = 7.0 + kStep * i;
    tracker->Push(PositionId{i}, Expose(ride, i, exposure_s),
                  odometer ? std::optional(driven) : std::nullopt, std::nullopt);
  }
  const auto window = tracker->Window();
  double dot = 0.0;
  double square = 0.0;
  std::vector<Pose> found;
  std::vector<Pose> truth;
  for (std::size_t i = 0; i < window.size(); ++i) {
    EXPECT_EQ(window[i].chain, 0) << window[i].chain_reason;
    EXPECT_EQ(window[i].metric, odometer);
    found.push_back(window.front().world_from_camera.Inverse() * window[i].world_from_camera);
    truth.push_back(ride.poses.front().Inverse() * ride.poses[i]);
    dot += found[i].translation.dot(truth[i].translation);
    square += found[i].translation.squaredNorm();
  }
  const double scale = odometer ? 1.0 : dot / square;
  // The unit of a chain without odometer is its first baseline.
  const double unit = odometer ? 1.0 : truth[1].translation.norm();
  Errors errors;
  int axes = 0;
  for (std::size_t i = 1; i < window.size(); ++i) {
    if (odometer || i > 1) {
      const Eigen::AngleAxisd turn(truth[i].rotation.conjugate() * found[i].rotation);
      const Eigen::Vector3d turned = turn.angle() / kDegree * turn.axis();
      const Eigen::Vector3d moved = window[0].world_from_camera.rotation *
                                    (found[i].translation - truth[i].translation / unit);
      for (Eigen::Index k = 0; k < 3; ++k) {
        const double z = turned[k] / window[i].sigma->rotation_deg[k];
        const double w = moved[k] / window[i].sigma->translation[k];
        errors.rotation_sigmas += z * z;
        errors.translation_sigmas += w * w;
        ++axes;
      }
    }
    errors.rotation_deg = std::max(errors.rotation_deg,
                                   found[i].rotation.angularDistance(truth[i].rotation) / kDegree);
    errors.translation_share = std::max(
        errors.translation_share,
        (scale * found[i].translation - truth[i].translation).norm() / truth[i].translation.norm());
  }
  errors.rotation_sigmas = std::sqrt(errors.rotation_sigmas / axes);
  errors.translation_sigmas = std::sqrt(errors.translation_sigmas / axes);
  std::printf("%.1f stops, %s, %s odometer: %.3f deg, %.2f %%; %.2f and %.2f sigmas\n", stops,
              triangle ? "triangle" : "saw tooth", odometer ? "with" : "without",
              errors.rotation_deg, 100.0 * errors.translation_share, errors.rotation_sigmas,
              errors.translation_sigmas);
  return errors;
}

// Fifteen axes of one ride, hanging together: measured were 0.7 to 1.9.
void ExpectCalibrated(const Errors& errors) {
  for (const double sigmas : {errors.rotation_sigmas, errors.translation_sigmas}) {
    EXPECT_GT(sigmas, 0.4);
    EXPECT_LT(sigmas, 2.5);
  }
}

void ExpectAccurate(const Ride& ride) {
  for (const bool triangle : {false, true}) {
    const Errors errors = Track(ride, 1.6, triangle, !triangle);
    EXPECT_LT(errors.rotation_deg, 0.1);
    EXPECT_LT(errors.translation_share, 0.005);
    ExpectCalibrated(errors);
  }
  // Six stops between neighbours: the positions of equal exposure hold the chain together.
  const Errors errors = Track(ride, 3.0, false, false);
  EXPECT_LT(errors.rotation_deg, 0.2);
  EXPECT_LT(errors.translation_share, 0.02);
  ExpectCalibrated(errors);
}

TEST(PoseAccuracy, InAHallOnEquirectangularPictures) {
  ExpectAccurate(Drive(sim::SceneKind::kHall, Projection::Equirectangular(1024, 512)));
}

TEST(PoseAccuracy, InAYardOnCylinders) {
  ExpectAccurate(Drive(sim::SceneKind::kYard, Projection::Cylindrical(1024, 768, -2.356, 2.356)));
}

TEST(PoseAccuracy, InATunnelOnEquirectangularPictures) {
  ExpectAccurate(Drive(sim::SceneKind::kTunnel, Projection::Equirectangular(1024, 512)));
}

}  // namespace
}  // namespace omnihdr::pose_accuracy_test
