#include "daemon/evaluation/simulation_truth.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <utility>

#include "drivers/sim/world.h"

namespace omnihdr {
namespace {

// Rays a pixel: 2×2, so that an edge is not judged by one lucky ray.
constexpr int kSamples = 4;

// `count` finite numbers of a JSON array.
template <std::size_t count>
std::optional<std::array<double, count>> Numbers(const nlohmann::json& json) {
  if (!json.is_array() || json.size() != count) return std::nullopt;
  std::array<double, count> numbers{};
  for (std::size_t i = 0; i < count; ++i) {
    if (!json[i].is_number() || !std::isfinite(json[i].get<double>())) return std::nullopt;
    numbers[i] = json[i].get<double>();
  }
  return numbers;
}

// {"pose": {"q": [w, x, y, z], "t": [x, y, z]}} of a journal line's "truth".
std::optional<Pose> PoseOf(const std::string& truth_json) {
  const auto json = nlohmann::json::parse(truth_json, nullptr, false);
  if (!json.is_object() || !json.contains("pose") || !json["pose"].is_object()) return std::nullopt;
  const auto q = Numbers<4>(json["pose"].value("q", nlohmann::json()));
  const auto t = Numbers<3>(json["pose"].value("t", nlohmann::json()));
  if (!q || !t) return std::nullopt;
  const Eigen::Quaterniond rotation((*q)[0], (*q)[1], (*q)[2], (*q)[3]);
  if (!(rotation.norm() > 1e-6)) return std::nullopt;
  return Pose{rotation.normalized(), Eigen::Vector3d((*t)[0], (*t)[1], (*t)[2])};
}

class SimulationTruth final : public Reference {
 public:
  explicit SimulationTruth(std::shared_ptr<const sim::World> world)
      : world_(std::move(world)),
        name_(fmt::format("simulation ({}, seed {})", sim::ToString(world_->scene()),
                          world_->seed())) {}

  std::string_view name() const override { return name_; }

  Result<std::optional<Pose>> TruePose(const FrameRecord& frame) const override {
    if (frame.truth_json.empty()) return std::optional<Pose>();
    const std::optional<Pose> pose = PoseOf(frame.truth_json);
    if (!pose) {
      return Fail(
          ErrorKind::kData,
          "frames.jsonl: frame {}: truth: {}, expected {{\"pose\": {{\"q\": [4 numbers], \"t\": [3 "
          "numbers]}}}}",
          Value(frame.frame), frame.truth_json);
    }
    return pose;
  }

  Result<Picture> Render(const FrameRecord& frame, const Projection& output,
                         const Eigen::Quaterniond& camera_from_output) const override {
    OMNIHDR_ASSIGN(const std::optional<Pose> camera, TruePose(frame));
    if (!camera) {
      return Fail(ErrorKind::kData,
                  "frames.jsonl: frame {}: truth: missing, expected the simulator's pose",
                  Value(frame.frame));
    }
    const Pose output_pose = *camera * Pose{camera_from_output, Eigen::Vector3d::Zero()};
    sim::RenderedView rendered = world_->Render(output_pose, output, kSamples);
    Picture picture;
    picture.radiance = std::move(rendered.radiance);
    picture.disparity = std::move(rendered.distance);
    for (float& value : picture.disparity.values()) value = 1.0F / value;
    return picture;
  }

 private:
  std::shared_ptr<const sim::World> world_;
  std::string name_;
};

}  // namespace

Result<std::unique_ptr<Reference>> OpenSimulationTruth(const std::string& simulation_json,
                                                       const std::string& session_file) {
  const auto json = nlohmann::json::parse(simulation_json, nullptr, false);
  const auto bad = [&](const char* expected) {
    return Fail(ErrorKind::kData, "{}: simulation: {}, expected {}", session_file, simulation_json,
                expected);
  };
  if (!json.is_object() || !json.contains("scene") || !json["scene"].is_string()) {
    return bad("an object with \"scene\" and \"seed\"");
  }
  const auto scene = sim::SceneKindFromString(json["scene"].get<std::string>());
  if (!scene) return bad("\"scene\" one of hall, yard, tunnel, street");
  if (!json.contains("seed") || !json["seed"].is_number_unsigned())
    return bad("\"seed\" a whole number");
  return std::make_unique<SimulationTruth>(
      sim::World::Create(*scene, json["seed"].get<std::uint64_t>()));
}

}  // namespace omnihdr
