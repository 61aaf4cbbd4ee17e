#include "core/pose/tracker_state.h"

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

namespace omnihdr {
namespace {

using Json = nlohmann::json;

constexpr int kVersion = 3;
constexpr std::size_t kMaxWindow = 1000;
constexpr std::size_t kMaxKeyframes = 10'000;
constexpr std::size_t kMaxFixes = 1000;

Json VectorJson(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

Eigen::Vector3d VectorFrom(const Json& json) {
  const auto v = json.get<std::array<double, 3>>();
  return {v[0], v[1], v[2]};
}

Json ScaleJson(const GnssScale& scale) {
  return {scale.metres_per_unit, scale.sigma, scale.fixes, scale.outliers};
}

GnssScale ScaleFrom(const Json& json) {
  return {json.at(0).get<double>(), json.at(1).get<double>(), json.at(2).get<int>(),
          json.at(3).get<int>()};
}

Json ClueJson(const GnssClue& clue) {
  return {clue.place.lat_deg, clue.place.lon_deg, clue.place.alt_m, clue.sigma_m};
}

GnssClue ClueFrom(const Json& json) {
  return {{json.at(0).get<double>(), json.at(1).get<double>(), json.at(2).get<double>()},
          json.at(3).get<double>()};
}

void NotesToJson(const PoseEstimate& e, Json* json) {
  if (e.gnss_scale) (*json)["gnss_scale"] = ScaleJson(*e.gnss_scale);
  if (!e.scale_note.empty()) (*json)["scale_note"] = e.scale_note;
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
  if (json.contains("gnss_scale")) e->gnss_scale = ScaleFrom(json.at("gnss_scale"));
  e->scale_note = json.value("scale_note", std::string());
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
  if (tracked.gnss) json["gnss"] = ClueJson(*tracked.gnss);
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
  if (json.contains("gnss")) tracked.gnss = ClueFrom(json.at("gnss"));
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

Json FixesJson(const Chain& chain) {
  Json samples = Json::array();
  for (const GnssSample& sample : chain.fixes) {
    samples.push_back({VectorJson(sample.translation), ClueJson(sample.clue)});
  }
  Json json = {{"fixes", std::move(samples)},
               {"seen", chain.fixes_seen},
               {"spacing", chain.fix_spacing},
               {"contradicted", chain.contradicted}};
  if (chain.gnss_scale) json["scale"] = ScaleJson(*chain.gnss_scale);
  return json;
}

Status FixesFrom(const Json& json, Chain* chain) {
  const Json& fixes = json.at("fixes");
  if (fixes.size() > kMaxFixes) {
    return Fail(ErrorKind::kData, "pose state: {} fixes, at most {}", fixes.size(), kMaxFixes);
  }
  for (const Json& fix : fixes) {
    chain->fixes.push_back({VectorFrom(fix.at(0)), ClueFrom(fix.at(1))});
  }
  chain->fixes_seen = json.at("seen").get<std::int64_t>();
  chain->fix_spacing = json.at("spacing").get<std::int64_t>();
  if (chain->fix_spacing < 1) {
    return Fail(ErrorKind::kData, "pose state: fixes' spacing {}, expected at least 1",
                chain->fix_spacing);
  }
  chain->contradicted = json.at("contradicted").get<bool>();
  if (json.contains("scale")) chain->gnss_scale = ScaleFrom(json.at("scale"));
  return {};
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
                      {"source", ToString(chain.source)},
                      {"unit_from", Value(chain.unit_from)},
                      {"unit_to", Value(chain.unit_to)},
                      {"unit_length", chain.unit_length},
                      {"path", chain.path}});
    if (chain.fixes_seen > 0) chains.back()["gnss"] = FixesJson(chain);
  }
  Json keyframes = Json::array();
  for (const KeyframeEntry& entry : state.keyframes) {
    keyframes.push_back(
        {Value(entry.position), entry.ordinal, entry.chain, entry.crc, entry.scale});
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
      const auto source = ScaleSourceFromString(entry.at("source").get<std::string>());
      if (!source) return Fail(ErrorKind::kData, "pose state: unknown source of scale");
      chain.source = *source;
      chain.unit_length = entry.at("unit_length").get<double>();
      chain.path = entry.at("path").get<double>();
      if (entry.contains("gnss")) OMNIHDR_TRY(FixesFrom(entry.at("gnss"), &chain));
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
                                 entry.at(3).get<std::uint32_t>(), entry.at(4).get<double>()});
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
      PoseEstimate& estimate = state.window.back().estimate;
      if (!(std::fabs(estimate.world_from_camera.rotation.norm() - 1.0) < 1e-6)) {
        return Fail(ErrorKind::kData, "pose state: position {}: \"q\" is not a unit quaternion",
                    Value(estimate.position));
      }
      const int chain = estimate.chain;
      if (!state.chains.contains(chain)) {
        return Fail(ErrorKind::kData, "pose state: position {} is of chain {}, which is not listed",
                    Value(estimate.position), chain);
      }
      estimate.scale_source = state.chains.at(chain).source;
    }
    return state;
  } catch (const std::exception& error) {
    return Fail(ErrorKind::kData, "pose state: {}", error.what());
  }
}

}  // namespace omnihdr
