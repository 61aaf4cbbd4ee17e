#include "core/pose/tracker_state.h"

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

namespace omnihdr {
namespace {

using Json = nlohmann::json;

constexpr int kVersion = 2;
constexpr std::size_t kMaxWindow = 1000;
constexpr std::size_t kMaxKeyframes = 10'000;

Json VectorJson(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

Eigen::Vector3d VectorFrom(const Json& json) {
  const auto v = json.get<std::array<double, 3>>();
  return {v[0], v[1], v[2]};
}

void NotesToJson(const PoseEstimate& e, Json* json) {
  if (e.sigma) {
    (*json)["sigma"] = {VectorJson(e.sigma->rotation_deg), VectorJson(e.sigma->translation)};
  }
  if (!e.dead_reckoned.empty()) (*json)["dead_reckoned"] = e.dead_reckoned;
  if (e.relocalised) {
    const Relocalisation& r = *e.relocalised;
    (*json)["relocalised"] = {Value(r.place), Value(r.seen_from), r.from_chain, r.matches};
  }
  if (e.loop) {
    const LoopClosure& loop = *e.loop;
    (*json)["loop"] = {{"place", Value(loop.place)},
                       {"seen_from", Value(loop.seen_from)},
                       {"matches", loop.matches},
                       {"rotation", loop.drift_rotation_deg},
                       {"translation", loop.drift_translation},
                       {"scale", loop.drift_scale},
                       {"corrected", loop.corrected}};
  }
}

void NotesFromJson(const Json& json, PoseEstimate* e) {
  if (json.contains("sigma")) {
    e->sigma = PoseSigma{VectorFrom(json.at("sigma").at(0)), VectorFrom(json.at("sigma").at(1))};
  }
  e->dead_reckoned = json.value("dead_reckoned", std::string());
  if (json.contains("relocalised")) {
    const Json& r = json.at("relocalised");
    e->relocalised = Relocalisation{PositionId{r.at(0).get<std::int64_t>()},
                                    PositionId{r.at(1).get<std::int64_t>()}, r.at(2).get<int>(),
                                    r.at(3).get<int>()};
  }
  if (json.contains("loop")) {
    const Json& loop = json.at("loop");
    e->loop = LoopClosure{PositionId{loop.at("place").get<std::int64_t>()},
                          PositionId{loop.at("seen_from").get<std::int64_t>()},
                          loop.at("matches").get<int>(),
                          loop.at("rotation").get<double>(),
                          loop.at("translation").get<double>(),
                          loop.at("scale").get<double>(),
                          loop.at("corrected").get<bool>()};
  }
}

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
               {"ordinal", tracked.ordinal},
               {"group", e.group},
               {"revision", e.revision},
               {"median_inverse_distance", e.median_inverse_distance},
               {"max_inverse_distance", e.max_inverse_distance}};
  if (!e.chain_reason.empty()) json["chain_reason"] = e.chain_reason;
  if (tracked.odometer_m) json["odometer_m"] = *tracked.odometer_m;
  if (tracked.heading_deg) json["heading_deg"] = *tracked.heading_deg;
  NotesToJson(e, &json);
  for (const AdoptedPairs& adopted : tracked.adopted) {
    json["adopted"].push_back({{"from", Value(adopted.from)}, {"features", adopted.features}});
  }
  for (const Anchor& anchor : tracked.anchors) {
    json["anchors"].push_back({anchor.feature, VectorJson(anchor.point.reference),
                               VectorJson(anchor.point.direction), anchor.point.inverse_distance});
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
  tracked.ordinal = json.at("ordinal").get<std::int64_t>();
  e.group = json.at("group").get<int>();
  e.revision = json.at("revision").get<int>();
  NotesFromJson(json, &e);
  if (json.contains("odometer_m")) tracked.odometer_m = json.at("odometer_m").get<double>();
  if (json.contains("heading_deg")) tracked.heading_deg = json.at("heading_deg").get<double>();
  if (json.contains("adopted")) {
    for (const Json& entry : json.at("adopted")) {
      tracked.adopted.push_back({PositionId{entry.at("from").get<std::int64_t>()},
                                 entry.at("features").get<std::vector<std::pair<int, int>>>()});
    }
  }
  if (json.contains("anchors")) {
    for (const Json& entry : json.at("anchors")) {
      BundlePoint point;
      point.reference = VectorFrom(entry.at(1));
      point.direction = VectorFrom(entry.at(2));
      point.inverse_distance = entry.at(3).get<double>();
      point.fixed = true;
      tracked.anchors.push_back({entry.at(0).get<int>(), point});
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
                      {"unit_to", Value(chain.unit_to)},
                      {"path", chain.path}});
  }
  Json keyframes = Json::array();
  for (const KeyframeEntry& entry : state.keyframes) {
    keyframes.push_back({Value(entry.position), entry.ordinal, entry.chain, entry.crc});
  }
  const Json json = {{"version", kVersion},
                     {"next_chain", state.next_chain},
                     {"next_group", state.next_group},
                     {"revision", state.revision},
                     {"pushed", state.pushed},
                     {"spacing", state.spacing},
                     {"keyframes", std::move(keyframes)},
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
      chain.path = entry.at("path").get<double>();
      state.chains[entry.at("chain").get<int>()] = chain;
    }
    state.next_group = json.at("next_group").get<int>();
    state.revision = json.at("revision").get<int>();
    state.pushed = json.at("pushed").get<std::int64_t>();
    state.spacing = json.at("spacing").get<std::int64_t>();
    if (state.spacing < 1) {
      return Fail(ErrorKind::kData, "pose state: spacing {}, expected at least 1", state.spacing);
    }
    if (json.at("keyframes").size() > kMaxKeyframes) {
      return Fail(ErrorKind::kData, "pose state: {} keyframes, at most {}",
                  json.at("keyframes").size(), kMaxKeyframes);
    }
    for (const Json& entry : json.at("keyframes")) {
      state.keyframes.push_back({PositionId{entry.at(0).get<std::int64_t>()},
                                 entry.at(1).get<std::int64_t>(), entry.at(2).get<int>(),
                                 entry.at(3).get<std::uint32_t>()});
      if (!state.chains.contains(state.keyframes.back().chain)) {
        return Fail(ErrorKind::kData, "pose state: keyframe {} is of chain {}, which is not listed",
                    Value(state.keyframes.back().position), state.keyframes.back().chain);
      }
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
