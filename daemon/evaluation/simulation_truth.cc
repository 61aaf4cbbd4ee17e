#include "daemon/evaluation/simulation_truth.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "core/base/parallel_for.h"
#include "drivers/sim/movers.h"
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

std::optional<double> OdometerOf(const std::string& truth_json) {
  const auto json = nlohmann::json::parse(truth_json, nullptr, false);
  if (!json.is_object() || !json.contains("odometer_m") || !json["odometer_m"].is_number()) {
    return std::nullopt;
  }
  return json["odometer_m"].get<double>();
}

sim::Vec3 ToVec3(const Eigen::Vector3d& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

class SimulationTruth final : public Reference {
 public:
  SimulationTruth(std::shared_ptr<const sim::World> world, const sim::Simulation& simulation)
      : world_(std::move(world)),
        simulation_(simulation),
        walks_(simulation.PlanWalks(*world_)),
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
    OMNIHDR_ASSIGN(const sim::MoverGroup movers, MoversAt(frame));
    sim::RenderedView rendered = world_->Render(output_pose, output, simulation_.samples, &movers);
    Picture picture;
    picture.radiance = std::move(rendered.radiance);
    picture.disparity = std::move(rendered.distance);
    for (float& value : picture.disparity.values()) value = 1.0F / value;
    return picture;
  }

  Result<Movers> FindMovers(const FrameRecord& frame, const std::vector<Other>& others,
                            const Projection& output,
                            const Eigen::Quaterniond& camera_from_output) const override {
    Movers found;
    if (walks_.empty()) return found;
    OMNIHDR_ASSIGN(const std::optional<Pose> camera, TruePose(frame));
    OMNIHDR_ASSIGN(const sim::MoverGroup here, MoversAt(frame));
    if (!camera || here.empty()) return found;
    struct Witness {
      Eigen::Vector3d place;
      sim::MoverGroup movers;
      MeasurableRange range;
    };
    std::vector<Witness> witnesses;
    for (const Other& other : others) {
      OMNIHDR_ASSIGN(const std::optional<Pose> pose, TruePose(*other.frame));
      OMNIHDR_ASSIGN(sim::MoverGroup movers, MoversAt(*other.frame));
      if (pose) witnesses.push_back({pose->translation, std::move(movers), other.range});
    }
    const Pose output_pose = *camera * Pose{camera_from_output, Eigen::Vector3d::Zero()};
    sim::RenderedView view = world_->Render(output_pose, output, simulation_.samples, &here);
    const int width = output.width();
    const int height = output.height();
    found.background = std::move(view.background);
    found.here = Image<std::uint8_t>(width, height);
    found.in_sight = Image<std::uint8_t>(width, height);
    found.witnesses = Image<std::uint8_t>(width, height);
    ParallelFor(height, 8, [&](int begin, int end) {
      constexpr double kSky = 1e4;  // metres; the simulator's sky is at infinity
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < width; ++x) {
          found.here.at(x, y) = view.movers.at(x, y) > 0.0F ? 1 : 0;
          const double distance =
              std::min(static_cast<double>(view.background_distance.at(x, y)), kSky);
          const Eigen::Vector3d surface =
              output_pose.translation +
              distance *
                  (output_pose.rotation * output.RayFromPixel(x + 0.5, y + 0.5)).normalized();
          for (const Witness& witness : witnesses) {
            const Eigen::Vector3d towards = surface - witness.place;
            const double length = towards.norm();
            const bool is_hidden = witness.movers.Hides(
                ToVec3(witness.place), ToVec3(towards / length), static_cast<float>(length));
            if (is_hidden) found.in_sight.at(x, y) = 1;
            if (!is_hidden && witness.range.Has(found.background.pixel(x, y)) &&
                world_->IsClear(witness.place, surface)) {
              ++found.witnesses.at(x, y);
            }
          }
        }
      }
    });
    return found;
  }

 private:
  Result<sim::MoverGroup> MoversAt(const FrameRecord& frame) const {
    if (walks_.empty()) return sim::MoverGroup();
    const std::optional<double> odometer = OdometerOf(frame.truth_json);
    if (!odometer) {
      return Fail(ErrorKind::kData,
                  "frames.jsonl: frame {}: truth.odometer_m: missing, expected the metres driven, "
                  "which say where the movers are",
                  Value(frame.frame));
    }
    return simulation_.MoversAt(*world_, walks_, *odometer);
  }

  std::shared_ptr<const sim::World> world_;
  sim::Simulation simulation_;
  std::vector<sim::Walk> walks_;
  std::string name_;
};

}  // namespace

Result<std::unique_ptr<Reference>> OpenSimulationTruth(const std::string& extra_json,
                                                       const std::string& session_file) {
  OMNIHDR_ASSIGN(const sim::Simulation simulation,
                 sim::ParseSimulation(extra_json).Context(session_file));
  return std::make_unique<SimulationTruth>(sim::World::Create(simulation.scene, simulation.seed),
                                           simulation);
}

}  // namespace omnihdr
