#include "core/pose/tracker_state.h"

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

namespace omnihdr {
namespace {

using Json = nlohmann::json;

constexpr int kVersion = 1;
constexpr std::size_t kMaxWindow = 1000;

Json PositionToJson(const TrackedPosition& tracked) {
  const PoseEstimate& e = tracked.estimate;
  const auto& q = e.world_from_camera.rotation;
  const auto& t = e.world_from_camera.translation;
  Json json = {{"position", Value(e.position)},
               {"q", {q.w(), q.x(), q.y(), q.z()}},
               {"t", {t.x(), t.y(), t.z()}},
               {"chain", e.chain},
               {"metric", e.metric},
               {"has_baseline", e.has_baseline},
               {"given", tracked.given},
               {"median_inverse_distance", e.median_inverse_distance},
               {"max_inverse_distance", e.max_inverse_distance}};
  if (!e.chain_reason.empty()) json["chain_reason"] = e.chain_reason;
  if (tracked.odometer_m) json["odometer_m"] = *tracked.odometer_m;
  for (const AdoptedPairs& adopted : tracked.adopted) {
    json["adopted"].push_back({{"from", Value(adopted.from)}, {"features", adopted.features}});
  }
  return json;
}

TrackedPosition PositionFromJson(const Json& json) {
  TrackedPosition tracked;
  PoseEstimate& e = tracked.estimate;
  e.position = PositionId{json.at("position").get<std::int64_t>()};
  const auto q = json.at("q").get<std::array<double, 4>>();
  const auto t = json.at("t").get<std::array<double, 3>>();
  e.world_from_camera.rotation = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  e.world_from_camera.translation = {t[0], t[1], t[2]};
  e.chain = json.at("chain").get<int>();
  e.chain_reason = json.value("chain_reason", std::string());
  e.metric = json.at("metric").get<bool>();
  e.has_baseline = json.at("has_baseline").get<bool>();
  e.median_inverse_distance = json.at("median_inverse_distance").get<double>();
  e.max_inverse_distance = json.at("max_inverse_distance").get<double>();
  tracked.given = json.at("given").get<bool>();
  if (json.contains("odometer_m")) tracked.odometer_m = json.at("odometer_m").get<double>();
  if (json.contains("adopted")) {
    for (const Json& entry : json.at("adopted")) {
      tracked.adopted.push_back({PositionId{entry.at("from").get<std::int64_t>()},
                                 entry.at("features").get<std::vector<std::pair<int, int>>>()});
    }
  }
  return tracked;
}

}  // namespace

std::string TrackerStateToJson(const TrackerState& state) {
  Json window = Json::array();
  for (const TrackedPosition& tracked : state.window) window.push_back(PositionToJson(tracked));
  Json chains = Json::array();
  for (const auto& [id, chain] : state.chains) {
    chains.push_back({{"chain", id},
                      {"first", Value(chain.first)},
                      {"metric", chain.metric},
                      {"scaled", chain.scaled},
                      {"given", chain.given},
                      {"unit_from", Value(chain.unit_from)},
                      {"unit_to", Value(chain.unit_to)}});
  }
  const Json json = {{"version", kVersion},
                     {"next_chain", state.next_chain},
                     {"chains", std::move(chains)},
                     {"window", std::move(window)}};
  return json.dump();
}

Result<TrackerState> TrackerStateFromJson(const std::string& text) {
  try {
    const Json json = Json::parse(text);
    if (const int version = json.at("version").get<int>(); version != kVersion) {
      return Fail(ErrorKind::kData, "pose state: version {}, expected {}", version, kVersion);
    }
    TrackerState state;
    state.next_chain = json.at("next_chain").get<int>();
    for (const Json& entry : json.at("chains")) {
      Chain chain;
      chain.first = PositionId{entry.at("first").get<std::int64_t>()};
      chain.metric = entry.at("metric").get<bool>();
      chain.scaled = entry.at("scaled").get<bool>();
      chain.given = entry.at("given").get<bool>();
      chain.unit_from = PositionId{entry.at("unit_from").get<std::int64_t>()};
      chain.unit_to = PositionId{entry.at("unit_to").get<std::int64_t>()};
      state.chains[entry.at("chain").get<int>()] = chain;
    }
    const Json& window = json.at("window");
    if (window.size() > kMaxWindow) {
      return Fail(ErrorKind::kData, "pose state: window of {} positions, at most {}", window.size(),
                  kMaxWindow);
    }
    for (const Json& entry : window) {
      state.window.push_back(PositionFromJson(entry));
      const PoseEstimate& estimate = state.window.back().estimate;
      if (!(std::fabs(estimate.world_from_camera.rotation.norm() - 1.0) < 1e-6)) {
        return Fail(ErrorKind::kData, "pose state: position {}: \"q\" is not a unit quaternion",
                    Value(estimate.position));
      }
      const int chain = estimate.chain;
      if (!state.chains.contains(chain)) {
        return Fail(ErrorKind::kData, "pose state: position {} is of chain {}, which is not listed",
                    Value(estimate.position), chain);
      }
    }
    return state;
  } catch (const std::exception& error) {
    return Fail(ErrorKind::kData, "pose state: {}", error.what());
  }
}

}  // namespace omnihdr
