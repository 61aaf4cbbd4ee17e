#include "drivers/sim/world.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <ostream>
#include <vector>

#include "core/base/parallel_for.h"
#include "drivers/sim/geometry.h"

namespace omnihdr::sim::world_test {
namespace {

const std::vector<SceneKind> kScenes{SceneKind::kHall, SceneKind::kYard, SceneKind::kTunnel,
                                     SceneKind::kStreet};

const World& Get(SceneKind scene) {
  static std::map<SceneKind, std::shared_ptr<const World>> worlds;
  auto& world = worlds[scene];
  if (!world) world = World::Create(scene, 1);
  return *world;
}

bool SameBytes(const Image<float>& a, const Image<float>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

std::vector<float> SortedLuminance(const RenderedView& view) {
  std::vector<float> luminance;
  for (int y = 0; y < view.radiance.height(); ++y) {
    for (int x = 0; x < view.radiance.width(); ++x) {
      const float* p = view.radiance.pixel(x, y);
      luminance.push_back(0.2126F * p[0] + 0.7152F * p[1] + 0.0722F * p[2]);
    }
  }
  std::sort(luminance.begin(), luminance.end());
  return luminance;
}

class WorldScenes : public testing::TestWithParam<SceneKind> {};

TEST(World, EqualSeedsGiveEqualBytesOnAnyNumberOfThreadsAndOtherSeedsAnotherWorld) {
  const auto projection = Projection::Equirectangular(160, 80);
  const World& world = Get(SceneKind::kYard);
  const RenderedView first = world.Render(world.PoseAt(1.0), projection, 4);
  SetWorkerCount(1);
  const auto again = World::Create(SceneKind::kYard, 1);
  const RenderedView second = again->Render(again->PoseAt(1.0), projection, 4);
  SetWorkerCount(0);
  EXPECT_TRUE(SameBytes(first.radiance, second.radiance));
  EXPECT_TRUE(SameBytes(first.distance, second.distance));
  const auto other = World::Create(SceneKind::kYard, 2);
  const RenderedView different = other->Render(other->PoseAt(1.0), projection, 4);
  EXPECT_FALSE(SameBytes(first.radiance, different.radiance));
  EXPECT_FALSE(SameBytes(first.distance, different.distance));
}

TEST_P(WorldScenes, RadianceSpansFourDecadesAndIsPositiveEverywhere) {
  const World& world = Get(GetParam());
  for (const double s : {0.0, 2.1, 10.0}) {
    const RenderedView view =
        world.Render(world.PoseAt(s), Projection::Equirectangular(512, 256), 4);
    const std::vector<float> luminance = SortedLuminance(view);
    ASSERT_TRUE(std::all_of(luminance.begin(), luminance.end(),
                            [](float v) { return std::isfinite(v) && v > 0.0F; }));
    const auto last = static_cast<double>(luminance.size() - 1);
    const float low = luminance[static_cast<std::size_t>(0.001 * last)];
    const float high = luminance[static_cast<std::size_t>(0.999 * last)];
    EXPECT_GE(std::log10(high / low), 4.0) << ToString(GetParam()) << " at " << s << " m";
  }
}

TEST_P(WorldScenes, ThePathKeepsClearOfEverythingForThirtyMetres) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto world = seed == 1 ? nullptr : World::Create(GetParam(), seed);
    const World& tested = world ? *world : Get(GetParam());
    for (double s = 0.0; s <= 30.0; s += 0.05) {
      const Pose pose = tested.PoseAt(s);
      ASSERT_GT(tested.Clearance(pose.translation), 0.4)
          << ToString(GetParam()) << " seed " << seed << " at " << s << " m";
      ASSERT_GE(pose.translation.z(), 1.45);
      ASSERT_LE(pose.translation.z(), 2.05);
    }
  }
}

TEST_P(WorldScenes, TheWayDrivenIsTheDistanceAskedForAndTurnsSlowly) {
  const World& world = Get(GetParam());
  double way = 0.0;
  for (double s = 0.1; s <= 20.0; s += 0.1) {
    const Pose before = world.PoseAt(s - 0.1);
    const Pose after = world.PoseAt(s);
    const Eigen::Vector3d step = after.translation - before.translation;
    way += std::hypot(step.x(), step.y());
    ASSERT_LT(before.rotation.angularDistance(after.rotation), 0.06) << s;
  }
  EXPECT_NEAR(way, 20.0, 0.02 * 20.0);
}

// The one law everything else rests on: a point seen from A, carried by its true distance and the
// true poses to B, has the same radiance there, wherever B sees it too.
TEST_P(WorldScenes, APointHasTheSameRadianceFromTwoPlaces) {
  const World& world = Get(GetParam());
  Random random(20240);
  for (int round = 0; round < 4; ++round) {
    const double s = random.Range(0.0F, 25.0F);
    const double step = random.Range(0.1F, 0.6F);
    MotionOptions motion;
    motion.yaw_deg_per_m = random.Range(-60.0F, 60.0F);
    const auto projection = round % 2 == 0 ? Projection::Equirectangular(512, 256)
                                           : Projection::Cylindrical(512, 384, -2.356, 2.356);
    const Pose pose_a = world.PoseAt(s, motion);
    const Pose pose_b = world.PoseAt(s + step, motion);
    const RenderedView a = world.Render(pose_a, projection, 9);
    const RenderedView b = world.Render(pose_b, projection, 9);
    int seen = 0;
    int agree = 0;
    for (int y = 8; y < projection.height() - 8; y += 2) {
      for (int x = 0; x < projection.width(); x += 2) {
        const float range = a.distance.at(x, y);
        if (!std::isfinite(range)) continue;
        const Eigen::Vector3d in_world =
            pose_a.WorldFromCamera(projection.RayFromPixel(x + 0.5, y + 0.5) * range);
        const Eigen::Vector3d in_b = pose_b.CameraFromWorld(in_world);
        if (!projection.Covers(in_b)) continue;
        const Eigen::Vector2d at = projection.PixelFromRay(in_b);
        const int bx = std::clamp(static_cast<int>(at.x()), 1, projection.width() - 2);
        const int by = std::clamp(static_cast<int>(at.y()), 1, projection.height() - 2);
        // Visible, and not at an edge: the range there and around is what it should be.
        bool visible = true;
        float low = 1e30F;
        float high = 0.0F;
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            const double other = b.distance.at(bx + dx, by + dy);
            visible = visible && std::abs(other / in_b.norm() - 1.0) < 0.05;
            const float value = b.radiance.at(bx + dx, by + dy, 1);
            low = std::min(low, value);
            high = std::max(high, value);
          }
        }
        if (!visible) continue;
        ++seen;
        const float value = a.radiance.at(x, y, 1);
        // Between the darkest and brightest of the nine pixels there, with the textures' blur.
        if (value > 0.85F * low && value < 1.15F * high) ++agree;
      }
    }
    EXPECT_GT(seen, 2000);
    EXPECT_GT(agree, 0.97 * seen) << "from " << s << " m to " << s + step << " m, of " << seen;
  }
}

TEST_P(WorldScenes, AWallOrFloorIsNeverNearerThanTheClearanceSays) {
  const World& world = Get(GetParam());
  const Pose pose = world.PoseAt(3.0);
  const RenderedView view = world.Render(pose, Projection::Equirectangular(256, 128), 1);
  const double clearance = world.Clearance(pose.translation);
  for (const float range : view.distance.values()) ASSERT_GE(range, clearance * 0.999);
}

INSTANTIATE_TEST_SUITE_P(AllScenes, WorldScenes, testing::ValuesIn(kScenes),
                         [](const auto& parameter) {
                           return std::string(ToString(parameter.param));
                         });

TEST(World, SceneNamesGoThereAndBack) {
  for (const SceneKind scene : kScenes) EXPECT_EQ(SceneKindFromString(ToString(scene)), scene);
  EXPECT_FALSE(SceneKindFromString("moon"));
}

TEST(World, TheSkyIsInfinitelyFarAndTheLawnIsNot) {
  const World& world = Get(SceneKind::kYard);
  const RenderedView view =
      world.Render(world.PoseAt(0.0, {0.0, 0.0}), Projection::Equirectangular(256, 128), 1);
  EXPECT_TRUE(std::isinf(view.distance.at(10, 1)));
  EXPECT_NEAR(view.distance.at(10, 126), 1.7, 0.1);
}

}  // namespace
}  // namespace omnihdr::sim::world_test
