#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <utility>
#include <vector>

#include "core/pose/bundle_adjustment.h"
#include "core/pose/relative_pose.h"
#include "core/pose/resection.h"
#include "core/pose/scale.h"
#include "core/pose/tracks.h"

namespace omnihdr::geometry_test {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kDegree = M_PI / 180.0;

class World {
 public:
  explicit World(std::uint32_t seed) : random_(seed) {}
  double Uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(random_()) / 4294967296.0;
  }
  double Normal() {
    double sum = -6.0;
    for (int k = 0; k < 12; ++k) sum += Uniform(0.0, 1.0);
    return sum;
  }
  Vector3d Direction() {
    const double z = Uniform(-1.0, 1.0);
    const double a = Uniform(-M_PI, M_PI);
    const double r = std::sqrt(1.0 - z * z);
    return {r * std::cos(a), r * std::sin(a), z};
  }
  Vector3d Point() { return Uniform(1.5, 12.0) * Direction(); }
  Vector3d Noisy(const Vector3d& v, double sigma) {
    const Vector3d noise{Normal(), Normal(), Normal()};  // braces: in this order
    return (v.normalized() + sigma * noise).normalized();
  }
  Pose Motion(double turn_deg, double length) {
    return {Quaterniond(Eigen::AngleAxisd(turn_deg * kDegree, Direction())), length * Direction()};
  }
  // Pairs of rays of two cameras; `outliers` is the share that has nothing to do with the motion.
  // The better come first, roughly, as after matching.
  std::vector<RayPair> Pairs(const Pose& b_from_a, int count, double outliers, double sigma) {
    std::vector<RayPair> pairs;
    for (int i = 0; i < count; ++i) {
      const double share = outliers * 2.0 * i / count;
      if (Uniform(0.0, 1.0) < share) {
        pairs.push_back({Direction(), Direction()});
      } else {
        const Vector3d p = Point();
        pairs.push_back({Noisy(p, sigma), Noisy(b_from_a.WorldFromCamera(p), sigma)});
      }
    }
    return pairs;
  }

 private:
  std::mt19937 random_;
};

double AngleDeg(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) / kDegree;
}

TEST(RelativePose, IsFoundInAnyWorldWithNoiseAndOutliers) {
  for (std::uint32_t seed = 1; seed <= 40; ++seed) {
    World world(seed);
    const Pose truth = world.Motion(world.Uniform(0.0, 50.0), world.Uniform(0.2, 0.6));
    const double outliers = world.Uniform(0.0, 0.45);
    const auto pairs = world.Pairs(truth, 600, outliers, 5e-4);
    const RelativePose found = EstimateRelativePose(pairs, seed, {});
    ASSERT_EQ(found.verdict, RelativePose::Verdict::kBaseline) << seed;
    EXPECT_LT(found.b_from_a.rotation.angularDistance(truth.rotation) / kDegree, 0.05) << seed;
    EXPECT_LT(AngleDeg(found.b_from_a.translation, truth.translation), 0.5) << seed;
    EXPECT_NEAR(found.b_from_a.translation.norm(), 1.0, 1e-9);
    EXPECT_GT(static_cast<int>(found.inliers.size()),
              static_cast<int>(600 * (1.0 - outliers) * 0.9));
  }
}

TEST(RelativePose, ManyMoreWrongPairsThanRightOnesStillLeadToTheMotion) {
  World world(3);
  const Pose truth = world.Motion(4.0, 0.3);
  const auto pairs = world.Pairs(truth, 500, 0.62, 5e-4);
  RelativePoseOptions options;
  const RelativePose found = EstimateRelativePose(pairs, 1, options);
  ASSERT_EQ(found.verdict, RelativePose::Verdict::kBaseline);
  EXPECT_LT(AngleDeg(found.b_from_a.translation, truth.translation), 1.0);
}

TEST(RelativePose, ATurnOnTheSpotIsARotationAlone) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    World world(seed);
    const Pose truth{world.Motion(world.Uniform(0.0, 40.0), 0.0)};
    const RelativePose found = EstimateRelativePose(world.Pairs(truth, 400, 0.2, 5e-4), seed, {});
    ASSERT_EQ(found.verdict, RelativePose::Verdict::kRotation) << seed;
    EXPECT_LT(found.b_from_a.rotation.angularDistance(truth.rotation) / kDegree, 0.02);
    EXPECT_EQ(found.b_from_a.translation, Vector3d::Zero());
  }
}

TEST(RelativePose, AShortBaselineIsStillABaseline) {
  World world(5);
  const Pose truth = world.Motion(2.0, 0.03);  // about 1/200 of the distances
  const RelativePose found = EstimateRelativePose(world.Pairs(truth, 800, 0.2, 3e-4), 1, {});
  ASSERT_EQ(found.verdict, RelativePose::Verdict::kBaseline);
  EXPECT_LT(AngleDeg(found.b_from_a.translation, truth.translation), 3.0);
}

TEST(RelativePose, UnrelatedRaysAgreeWithNothing) {
  World world(6);
  const RelativePose found = EstimateRelativePose(world.Pairs({}, 400, 1e9, 1e-3), 1, {});
  EXPECT_EQ(found.verdict, RelativePose::Verdict::kNone);
  EXPECT_TRUE(found.inliers.empty());
  EXPECT_LT(found.agreeing, 100);
  EXPECT_EQ(EstimateRelativePose({}, 1, {}).verdict, RelativePose::Verdict::kNone);
}

TEST(RelativePose, TheSameSeedGivesTheSameBits) {
  World world(8);
  const auto pairs = world.Pairs(world.Motion(5.0, 0.3), 300, 0.3, 5e-4);
  const RelativePose a = EstimateRelativePose(pairs, 11, {});
  const RelativePose b = EstimateRelativePose(pairs, 11, {});
  EXPECT_EQ(a.b_from_a.rotation.coeffs(), b.b_from_a.rotation.coeffs());
  EXPECT_EQ(a.b_from_a.translation, b.b_from_a.translation);
  EXPECT_EQ(a.inliers, b.inliers);
}

TEST(Resection, FindsTheCameraAmongKnownPointsThoughMostPairsAreWrong) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    World world(seed);
    const Pose truth = world.Motion(world.Uniform(0.0, 170.0), 2.0);
    std::vector<PointSight> sights;
    for (int i = 0; i < 60; ++i) {
      const Vector3d p = world.Point();
      BundlePoint point;
      point.reference = 0.3 * world.Direction();
      point.direction = (p - point.reference).normalized();
      point.inverse_distance = 1.0 / (p - point.reference).norm();
      const Vector3d ray = i % 4 == 0 ? truth.CameraFromWorld(p) : world.Direction();
      sights.push_back({point, world.Noisy(ray, 5e-4)});
    }
    const auto found = EstimatePoseFromPoints(sights, seed, {});
    ASSERT_TRUE(found.has_value()) << seed;
    EXPECT_GE(found->inliers.size(), 13U);
    EXPECT_LT(found->world_from_camera.rotation.angularDistance(truth.rotation) / kDegree, 0.1);
    EXPECT_LT((found->world_from_camera.translation - truth.translation).norm(), 0.01);
  }
}

TEST(Resection, WrongPairsAndTooFewGiveNoPose) {
  World world(50);
  std::vector<PointSight> sights;
  for (int i = 0; i < 300; ++i) {
    BundlePoint point;
    point.direction = world.Direction();
    point.inverse_distance = world.Uniform(0.1, 0.7);
    sights.push_back({point, world.Direction()});
  }
  EXPECT_FALSE(EstimatePoseFromPoints(sights, 1, {}).has_value());
  sights.resize(9);
  EXPECT_FALSE(EstimatePoseFromPoints(sights, 1, {}).has_value());
  EXPECT_FALSE(EstimatePoseFromPoints({}, 1, {}).has_value());
}

TEST(Scale, KnownPointsGiveTheLengthOfTheNextBaselineDespiteOutliers) {
  World world(9);
  const Pose old_pose = world.Motion(30.0, 2.0);
  Pose new_from_old = world.Motion(6.0, 0.7);
  std::vector<ScaleClue> clues;
  for (int i = 0; i < 60; ++i) {
    const Vector3d p_in_old = world.Point();
    const Vector3d p = old_pose.WorldFromCamera(p_in_old);
    BundlePoint point;
    point.direction = p.normalized();
    point.inverse_distance = 1.0 / p.norm();
    const Vector3d seen = i % 5 == 0 ? world.Direction() : new_from_old.WorldFromCamera(p_in_old);
    clues.push_back({point, world.Noisy(seen, 3e-4)});
  }
  new_from_old.translation.normalize();
  const auto baseline = BaselineFromPoints(clues, old_pose, new_from_old, 8);
  ASSERT_TRUE(baseline.has_value());
  EXPECT_NEAR(*baseline, 0.7, 0.02);
  clues.resize(5);
  EXPECT_FALSE(BaselineFromPoints(clues, old_pose, new_from_old, 8).has_value());
}

TEST(Scale, TheChordOfAQuarterCircleIsShorterThanItsArc) {
  EXPECT_NEAR(ChordOfArc(M_PI / 2.0, M_PI / 2.0), std::sqrt(2.0), 1e-12);
  EXPECT_EQ(ChordOfArc(1.25, 0.0), 1.25);
}

TEST(Tracks, JoinSightingsAcrossPositionsAndDropContradictions) {
  const std::vector<FeaturePairs> pairs{
      {0, 1, {{0, 0}, {1, 1}, {2, 2}}}, {1, 2, {{0, 5}, {1, 6}}}, {0, 2, {{2, 7}, {1, 8}}}};
  const auto tracks = BuildTracks({4, 4, 9}, pairs);
  // Feature 1 of position 0 would be at two places of position 2 (6 and 8).
  ASSERT_EQ(tracks.size(), 2U);
  using Sightings = std::vector<std::pair<int, int>>;
  EXPECT_EQ(tracks[0].sightings, (Sightings{{0, 0}, {1, 0}, {2, 5}}));
  EXPECT_EQ(tracks[1].sightings, (Sightings{{0, 2}, {1, 2}, {2, 7}}));
  std::vector<FeaturePairs> reversed(pairs.rbegin(), pairs.rend());
  const auto again = BuildTracks({4, 4, 9}, reversed);
  ASSERT_EQ(again.size(), 2U);
  EXPECT_EQ(again[0].sightings, tracks[0].sightings);
  EXPECT_EQ(again[1].sightings, tracks[1].sightings);
}

TEST(Tracks, APointIsTriangulatedFromSeveralRaysAndInfinityIsInverseDistanceZero) {
  World world(12);
  const std::array<Pose, 3> poses{world.Motion(10, 0.5), world.Motion(20, 0.5),
                                  world.Motion(5, 0.5)};
  const Vector3d p(3.0, 2.0, 0.5);
  const Vector3d far = 1e7 * p;
  std::vector<Sighting> near_sightings;
  std::vector<Sighting> far_sightings;
  for (const Pose& pose : poses) {
    near_sightings.push_back({&pose, pose.CameraFromWorld(p).normalized()});
    far_sightings.push_back({&pose, pose.CameraFromWorld(far).normalized()});
  }
  const BundlePoint point = Triangulate(near_sightings);
  EXPECT_LT((point.reference + point.direction / point.inverse_distance - p).norm(), 1e-9);
  EXPECT_NEAR(Triangulate(far_sightings).inverse_distance, 0.0, 1e-6);
  EXPECT_GT(LargestParallax(near_sightings), 0.05);
  EXPECT_LT(LargestParallax(far_sightings), 1e-6);
}

// Six cameras on a path and what they see of 300 points, a tenth of them very far away.
struct Scene {
  std::vector<Pose> truth;
  Bundle bundle;  // with rays from the truth, poses and points still true
};

Scene MakeScene(World& world, double sigma) {
  Scene scene;
  for (int c = 0; c < 6; ++c) {
    Pose pose = world.Motion(5.0, 0.02);
    pose.translation += Vector3d(0.3 * c, 0.02 * c * c, 0.0);
    scene.truth.push_back(pose);
    scene.bundle.cameras.push_back({pose, c == 0});
  }
  for (int i = 0; i < 300; ++i) {
    Vector3d p = world.Point();
    if (i % 10 == 0) p *= 1e4;
    std::vector<Sighting> sightings;
    for (int c = i % 3; c < std::min(6, i % 3 + 4); ++c) {
      const Pose& pose = scene.truth[static_cast<std::size_t>(c)];
      const Vector3d ray = world.Noisy(pose.CameraFromWorld(p), sigma);
      scene.bundle.observations.push_back({c, i, ray, 1.0});
      sightings.push_back({&pose, ray});
    }
    scene.bundle.points.push_back(Triangulate(sightings));
  }
  return scene;
}

void Disturb(World& world, Scene* scene) {
  for (BundleCamera& camera : scene->bundle.cameras) {
    if (!camera.fixed)
      camera.world_from_camera = camera.world_from_camera * world.Motion(0.5, 0.02);
  }
  for (BundlePoint& point : scene->bundle.points) {
    point.direction = world.Noisy(point.direction, 5e-3);
    point.inverse_distance *= world.Uniform(0.8, 1.2);
  }
}

TEST(BundleAdjustment, DisturbedCamerasReturnToTheTruthAndKnownDistancesGiveTheScale) {
  for (std::uint32_t seed = 1; seed <= 5; ++seed) {
    World world(seed);
    Scene scene = MakeScene(world, 2e-4);
    for (int c = 1; c < 6; ++c) {
      const double length = (scene.truth[static_cast<std::size_t>(c)].translation -
                             scene.truth[static_cast<std::size_t>(c - 1)].translation)
                                .norm();
      scene.bundle.distances.push_back({c - 1, c, length, 1e-3});
    }
    Disturb(world, &scene);
    ASSERT_TRUE(AdjustBundle({1e-3, 30}, &scene.bundle));
    for (std::size_t c = 0; c < 6; ++c) {
      const Pose& found = scene.bundle.cameras[c].world_from_camera;
      EXPECT_LT(found.rotation.angularDistance(scene.truth[c].rotation) / kDegree, 0.02);
      EXPECT_LT((found.translation - scene.truth[c].translation).norm(), 2e-3);
    }
  }
}

// The same cost in the plainest form, for Ceres to differentiate.
struct AngleCost {
  BundlePoint start;
  Vector3d ray;
  double weight;
  template <typename T>
  bool operator()(const T* camera, const T* point, T* residual) const {
    const Vector3d t1 = start.direction.unitOrthogonal();
    const Vector3d t2 = start.direction.cross(t1);
    T seen[3];
    for (int i = 0; i < 3; ++i) {
      seen[i] = start.direction[i] + point[0] * t1[i] + point[1] * t2[i] +
                point[2] * (T(start.reference[i]) - camera[3 + i]);
    }
    const T back[3] = {-camera[0], -camera[1], -camera[2]};
    T turned[3];
    ceres::AngleAxisRotatePoint(back, seen, turned);
    const T length =
        ceres::sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2]);
    const Vector3d e1 = ray.unitOrthogonal();
    const Vector3d e2 = ray.cross(e1);
    for (int k = 0; k < 2; ++k) {
      const Vector3d& e = k == 0 ? e1 : e2;
      residual[k] =
          (turned[0] * e[0] + turned[1] * e[1] + turned[2] * e[2]) * (weight / 1e-3) / length;
    }
    return true;
  }
};

TEST(BundleAdjustment, EndsWhereCeresEnds) {
  World world(31);
  Scene scene = MakeScene(world, 6e-4);
  scene.bundle.cameras[1].fixed = true;  // scale
  for (std::size_t i = 0; i < scene.bundle.observations.size(); i += 30) {
    auto& ray = scene.bundle.observations[i].ray;
    ray = world.Noisy(ray, 5e-3);
  }
  Disturb(world, &scene);
  Bundle reference = scene.bundle;

  std::vector<std::array<double, 6>> cameras;
  std::vector<std::array<double, 3>> points;
  for (const BundleCamera& camera : reference.cameras) {
    const Eigen::AngleAxisd turn(camera.world_from_camera.rotation);
    const Vector3d w = turn.angle() * turn.axis();
    const Vector3d t = camera.world_from_camera.translation;
    cameras.push_back({w.x(), w.y(), w.z(), t.x(), t.y(), t.z()});
  }
  for (const BundlePoint& p : reference.points) {
    points.push_back({0.0, 0.0, p.inverse_distance});
  }
  ceres::Problem::Options ownership;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::HuberLoss huber(1.0);
  ceres::Problem problem(ownership);
  for (const BundleObservation& o : reference.observations) {
    const auto c = static_cast<std::size_t>(o.camera);
    const auto p = static_cast<std::size_t>(o.point);
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<AngleCost, 2, 6, 3>(
                                 new AngleCost{reference.points[p], o.ray, o.weight}),
                             &huber, cameras[c].data(), points[p].data());
  }
  for (std::size_t c = 0; c < 2; ++c) problem.SetParameterBlockConstant(cameras[c].data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-14;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  ASSERT_TRUE(summary.IsSolutionUsable());

  ASSERT_TRUE(AdjustBundle({1e-3, 60}, &scene.bundle));
  for (std::size_t c = 0; c < 6; ++c) {
    const Vector3d w(cameras[c][0], cameras[c][1], cameras[c][2]);
    const Quaterniond expected(Eigen::AngleAxisd(w.norm(), w.normalized()));
    const Pose& found = scene.bundle.cameras[c].world_from_camera;
    EXPECT_LT(found.rotation.angularDistance(expected), 2e-6);
    EXPECT_LT((found.translation - Vector3d(cameras[c].data() + 3)).norm(), 1e-5);
  }
}

TEST(BundleAdjustment, FixedCamerasStayToTheLastBit) {
  World world(21);
  Scene scene = MakeScene(world, 3e-4);
  scene.bundle.cameras[1].fixed = true;
  Disturb(world, &scene);
  ASSERT_TRUE(AdjustBundle({1e-3, 30}, &scene.bundle));
  for (std::size_t c = 0; c < 2; ++c) {
    EXPECT_EQ(scene.bundle.cameras[c].world_from_camera.translation, scene.truth[c].translation);
    EXPECT_EQ(scene.bundle.cameras[c].world_from_camera.rotation.coeffs(),
              scene.truth[c].rotation.coeffs());
  }
  EXPECT_LT(
      (scene.bundle.cameras[5].world_from_camera.translation - scene.truth[5].translation).norm(),
      5e-3);
}

// Normalised squared errors of the free cameras (6 degrees of freedom each), over many noises.
struct SquaredErrors {
  double sum = 0.0;
  int cameras = 0;
  void Add(const Bundle& bundle, const std::vector<Pose>& truth,
           const std::vector<PoseCovariance>& covariances, std::size_t first) {
    ASSERT_EQ(covariances.size(), truth.size());
    for (std::size_t c = first; c < truth.size(); ++c) {
      const Pose& found = bundle.cameras[c].world_from_camera;
      const Eigen::AngleAxisd turn(truth[c].rotation.conjugate() * found.rotation);
      Eigen::Matrix<double, 6, 1> error;
      error << turn.angle() * turn.axis(), found.translation - truth[c].translation;
      sum += error.dot(covariances[c].ldlt().solve(error));
      ++cameras;
    }
  }
  double Mean() const { return sum / cameras; }
};

TEST(BundleCovariance, ErrorsSpreadAsItSaysWhateverTheNoiseOfRaysAndDistances) {
  // The angles' noise is a tenth and twice the unit they are weighted in.
  for (const auto& [ray_sigma, length_sigma] :
       {std::pair(1e-4, 3e-3), std::pair(4e-4, 1e-3), std::pair(2e-3, 5e-3)}) {
    SquaredErrors errors;
    for (std::uint32_t seed = 1; seed <= 200; ++seed) {
      World world(seed);
      Scene scene = MakeScene(world, ray_sigma);
      for (int c = 1; c < 6; ++c) {
        const double length = (scene.truth[static_cast<std::size_t>(c)].translation -
                               scene.truth[static_cast<std::size_t>(c - 1)].translation)
                                  .norm();
        const double told = length + length_sigma * world.Normal();
        scene.bundle.distances.push_back({c - 1, c, told, length_sigma});
      }
      const BundleOptions options{20e-3, 30};
      ASSERT_TRUE(AdjustBundle(options, &scene.bundle));
      errors.Add(scene.bundle, scene.truth, CameraCovariances(options, scene.bundle, {}), 1);
    }
    EXPECT_NEAR(errors.Mean(), 6.0, 0.75) << ray_sigma << ", " << length_sigma;
  }
}

TEST(BundleCovariance, ABaselineCanBeTheUnitOfLength) {
  SquaredErrors errors;
  for (std::uint32_t seed = 1; seed <= 60; ++seed) {
    World world(seed);
    Scene scene = MakeScene(world, 3e-4);
    const BundleOptions options{20e-3, 30};
    ASSERT_TRUE(AdjustBundle(options, &scene.bundle));
    const Vector3d origin = scene.truth[0].translation;
    const auto length = [&](const Pose& pose) { return (pose.translation - origin).norm(); };
    const double scale = length(scene.truth[1]) / length(scene.bundle.cameras[1].world_from_camera);
    std::vector<PoseCovariance> covariances =
        CameraCovariances(options, scene.bundle, BundleDistance{0, 1, 1.0, 1.0});
    ASSERT_EQ(covariances.size(), 6U);
    // Camera 1 cannot be wrong along the baseline.
    const Vector3d along =
        (scene.bundle.cameras[1].world_from_camera.translation - origin).normalized();
    EXPECT_LT(along.dot(covariances[1].bottomRightCorner<3, 3>() * along), 1e-11);
    for (std::size_t c = 1; c < 6; ++c) {
      Vector3d& t = scene.bundle.cameras[c].world_from_camera.translation;
      t = origin + scale * (t - origin);
      covariances[c].bottomRows<3>() *= scale;
      covariances[c].rightCols<3>() *= scale;
    }
    errors.Add(scene.bundle, scene.truth, covariances, 2);
  }
  EXPECT_NEAR(errors.Mean(), 6.0, 0.9);
}

TEST(BundleCovariance, FixedPointsHoldTheFrameAndTooFewRaysSayNothing) {
  SquaredErrors errors;
  for (std::uint32_t seed = 1; seed <= 60; ++seed) {
    World world(seed);
    Scene scene = MakeScene(world, 3e-4);
    // Known exactly; no camera is held.
    scene.bundle.cameras[0].fixed = false;
    for (std::size_t p = 0; p < scene.bundle.points.size(); ++p) {
      if (p % 3 != 0 || p % 10 == 0) continue;
      BundlePoint& point = scene.bundle.points[p];
      for (BundleObservation& o : scene.bundle.observations) {
        if (o.point != static_cast<int>(p)) continue;
        const Pose& pose = scene.truth[static_cast<std::size_t>(o.camera)];
        o.ray = world.Noisy(RayFromPoint(pose, point), 3e-4);
      }
      point.fixed = true;
    }
    const Bundle before = scene.bundle;
    const BundleOptions options{20e-3, 30};
    ASSERT_TRUE(AdjustBundle(options, &scene.bundle));
    EXPECT_EQ(scene.bundle.points[3].direction, before.points[3].direction);
    EXPECT_NE(scene.bundle.points[1].direction, before.points[1].direction);
    errors.Add(scene.bundle, scene.truth, CameraCovariances(options, scene.bundle, {}), 0);
  }
  EXPECT_NEAR(errors.Mean(), 6.0, 0.9);

  World world(3);
  Scene scene = MakeScene(world, 3e-4);
  scene.bundle.observations.resize(20);
  EXPECT_TRUE(CameraCovariances({1e-3, 30}, scene.bundle, {}).empty());
}

TEST(BundleAdjustment, AFewWildRaysHardlyMatter) {
  World world(22);
  Scene scene = MakeScene(world, 2e-4);
  scene.bundle.cameras[1].fixed = true;
  for (std::size_t i = 0; i < scene.bundle.observations.size(); i += 25) {
    auto& ray = scene.bundle.observations[i].ray;
    ray = world.Noisy(ray, 1e-2);
  }
  ASSERT_TRUE(AdjustBundle({1e-3, 30}, &scene.bundle));
  for (std::size_t c = 0; c < 6; ++c) {
    EXPECT_LT(
        (scene.bundle.cameras[c].world_from_camera.translation - scene.truth[c].translation).norm(),
        4e-3);
  }
}

}  // namespace
}  // namespace omnihdr::geometry_test
