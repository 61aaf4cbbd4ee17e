#include "daemon/evaluation/simulation_truth.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <utility>

#include "drivers/sim/simulation.h"
#include "drivers/sim/world.h"

namespace omnihdr {
namespace {

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
  SimulationTruth(std::shared_ptr<const sim::World> world, int samples)
      : world_(std::move(world)),
        samples_(samples),
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
    sim::RenderedView rendered = world_->Render(output_pose, output, samples_);
    Picture picture;
    picture.radiance = std::move(rendered.radiance);
    picture.disparity = std::move(rendered.distance);
    for (float& value : picture.disparity.values()) value = 1.0F / value;
    return picture;
  }

 private:
  std::shared_ptr<const sim::World> world_;
  int samples_;
  std::string name_;
};

}  // namespace

Result<std::unique_ptr<Reference>> OpenSimulationTruth(const std::string& extra_json,
                                                       const std::string& session_file) {
  OMNIHDR_ASSIGN(const sim::Simulation simulation,
                 sim::ParseSimulation(extra_json).Context(session_file));
  return std::make_unique<SimulationTruth>(sim::World::Create(simulation.scene, simulation.seed),
                                           simulation.samples);
}

}  // namespace omnihdr
