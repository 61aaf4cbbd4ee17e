#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <numeric>

#include "core/base/units.h"
#include "core/pose/feature_image.h"
#include "core/pose/features.h"
#include "core/pose/link.h"
#include "core/pose/matching.h"
#include "core/pose/pose_tracker.h"
#include "core/quality/pose_metrics.h"
#include "daemon/evaluation/experiments_parts.h"

namespace omnihdr::experiments {
namespace {

constexpr double kAbsent = std::numeric_limits<double>::quiet_NaN();
constexpr int kFirstMoved = 2;  // positions 0 and 1 keep their frames: they set the unit of length
constexpr float kPlainRatio = 0.9F;  // of the ratio test, as links between positions have it

// Poses by images alone (no odometer), one a position of the sequence; those that are not on the
// first one's chain are absent.
Result<std::vector<std::optional<Pose>>> TrackPoses(Bench& bench,
                                                    const std::vector<int>& exposures) {
  const PipelineOptions options = bench.OptionsOf(Method::kOurs);
  PoseOptions pose;
  pose.min_baseline_ratio = options.min_baseline_ratio;
  OMNIHDR_ASSIGN(const std::unique_ptr<PoseTracker> tracker, PoseTracker::Create(pose));
  std::vector<std::optional<Pose>> poses(exposures.size());
  for (std::size_t i = 0; i < exposures.size(); ++i) {
    const std::array<int, 1> exposure = {exposures[i]};
    const auto position = static_cast<int>(i);
    OMNIHDR_ASSIGN(const Measurement measurement,
                   bench.matrix().Measure(position, exposure, options));
    tracker->Push(PositionId{position}, measurement, std::nullopt, std::nullopt);
    for (const PoseEstimate& estimate : tracker->Window()) {
      std::optional<Pose>& kept = poses[static_cast<std::size_t>(Value(estimate.position))];
      kept.reset();
      if (estimate.chain == 0) kept = estimate.world_from_camera;
    }
  }
  return poses;
}

// Against the poses of one exposure everywhere: equations 6.2 and 6.3 of the thesis, the rotation
// by the angle between the two rather than the difference of their angles.
struct OrderError {
  double rotation_deg = kAbsent;
  double distance_percent = kAbsent;
};

std::vector<OrderError> CompareOrders(const std::vector<std::optional<Pose>>& poses,
                                      const std::vector<std::optional<Pose>>& same) {
  std::vector<OrderError> errors(poses.size());
  for (std::size_t i = 1; i < poses.size(); ++i) {
    if (!poses[i] || !same[i] || !poses[0] || !same[0]) continue;
    const Pose first_from_here = poses[0]->Inverse() * *poses[i];
    const Pose expected = same[0]->Inverse() * *same[i];
    errors[i].rotation_deg =
        Radians(first_from_here.rotation.angularDistance(expected.rotation)).degrees();
    const double distance = expected.translation.norm();
    if (distance > 0.0) {
      errors[i].distance_percent = 100.0 * (first_from_here.translation.norm() / distance - 1.0);
    }
  }
  return errors;
}

struct WorstError {
  double rotation_deg = 0.0;
  double distance_percent = 0.0;
  int missing = 0;
};

WorstError WorstOf(const std::vector<OrderError>& errors) {
  WorstError worst;
  for (std::size_t i = kFirstMoved; i < errors.size(); ++i) {
    if (!std::isfinite(errors[i].rotation_deg)) {
      ++worst.missing;
      continue;
    }
    worst.rotation_deg = std::max(worst.rotation_deg, errors[i].rotation_deg);
    worst.distance_percent = std::max(worst.distance_percent, std::abs(errors[i].distance_percent));
  }
  return worst;
}

// Largest errors against the truth, the length unit fitted; absent without truth or with a broken
// chain.
std::optional<PoseErrors> AgainstTruth(const DataMatrix& matrix,
                                       const std::vector<std::optional<Pose>>& poses) {
  std::vector<Pose> estimated;
  std::vector<Pose> truth;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Result<std::optional<Pose>> known = matrix.TruePose(static_cast<int>(i));
    if (!known || !*known || !poses[i]) return std::nullopt;
    estimated.push_back(*poses[i]);
    truth.push_back(**known);
  }
  PoseErrors largest;
  for (const PoseErrors& each : ComparePoses(estimated, truth, /*fit_scale=*/true).positions) {
    largest.rotation_deg = std::max(largest.rotation_deg, each.rotation_deg);
    largest.translation_percent = std::max(largest.translation_percent, each.translation_percent);
  }
  return largest;
}

Status OrderOf(Bench& bench, Section* section, std::vector<Plot>* plots) {
  const auto length = static_cast<std::size_t>(std::min(bench.matrix().positions(), 8));
  const int middle = bench.matrix().middle();
  OMNIHDR_ASSIGN(const std::vector<std::optional<Pose>> same,
                 TrackPoses(bench, std::vector<int>(length, middle)));
  Table table;
  table.title =
      fmt::format("{}: error against the poses of #{} at every position", bench.place(), middle);
  table.columns = {"step", "order", "position", "exposure", "rotation (degrees)", "distance (%)"};
  Table summary;
  summary.title = fmt::format("{}: the largest errors", bench.place());
  summary.columns = {"step",
                     "order",
                     fmt::format("rotation against #{}'s (degrees)", middle),
                     fmt::format("distance against #{}'s (%)", middle),
                     "positions not linked",
                     "rotation against truth (degrees)",
                     "place against truth (% of the way)"};
  const auto with_truth = [&](const std::vector<std::optional<Pose>>& poses) {
    const std::optional<PoseErrors> truth = AgainstTruth(bench.matrix(), poses);
    return std::pair(Number(truth ? std::optional(truth->rotation_deg) : std::nullopt, 4),
                     Number(truth ? std::optional(truth->translation_percent) : std::nullopt, 3));
  };
  {
    const auto [rotation, place] = with_truth(same);
    summary.rows.push_back(
        {Words("0"), Words("one exposure"), Words("-"), Words("-"), Number(0, 0), rotation, place});
  }
  Plot plot;
  plot.title = fmt::format("{}: error of distance, %", bench.place());
  plot.x_label = "position";
  WorstError worst;
  std::size_t colour = 0;
  for (const double stops : {0.8, 1.6}) {
    std::string why_not;
    const std::optional<Steps> steps = bench.StepsOf(stops, &why_not);
    if (!steps) {
      section->notes.push_back(why_not);
      continue;
    }
    for (const Order order : {Order::kSawTooth, Order::kTriangle}) {
      const char* name = order == Order::kSawTooth ? "saw tooth" : "triangle";
      std::vector<int> exposures(kFirstMoved, middle);
      const std::vector<int> moved = OrderedExposures(*steps, order, length - kFirstMoved);
      exposures.insert(exposures.end(), moved.begin(), moved.end());
      OMNIHDR_ASSIGN(const std::vector<std::optional<Pose>> poses, TrackPoses(bench, exposures));
      const std::vector<OrderError> errors = CompareOrders(poses, same);
      PlotSeries curve = Curve(fmt::format("{} stops, {}", stops, name), colour++, {}, {});
      for (std::size_t i = kFirstMoved; i < length; ++i) {
        table.rows.push_back({Number(stops, 1), Words(name), Number(static_cast<double>(i), 0),
                              Words(Numbered(exposures[i])), Number(errors[i].rotation_deg, 4),
                              Number(errors[i].distance_percent, 3)});
        curve.x.push_back(static_cast<double>(i));
        curve.y.push_back(errors[i].distance_percent);
      }
      plot.series.push_back(std::move(curve));
      const WorstError of = WorstOf(errors);
      const auto [rotation, place] = with_truth(poses);
      summary.rows.push_back({Number(stops, 1), Words(name), Number(of.rotation_deg, 4),
                              Number(of.distance_percent, 3), Number(of.missing, 0), rotation,
                              place});
      worst.rotation_deg = std::max(worst.rotation_deg, of.rotation_deg);
      worst.distance_percent = std::max(worst.distance_percent, of.distance_percent);
      worst.missing += of.missing;
    }
  }
  if (plot.series.empty()) return {};
  section->found += fmt::format(
      "{}{}: rotation off by at most {:.3f} degrees, distance by {:.2f} %{}",
      section->found.empty() ? "" : "; ", bench.place(), worst.rotation_deg, worst.distance_percent,
      worst.missing > 0 ? fmt::format(" ({} not linked)", worst.missing) : std::string());
  section->tables.push_back(std::move(summary));
  section->tables.push_back(std::move(table));
  plots->push_back(std::move(plot));
  return {};
}

struct FeatureLinks {
  std::array<int, 3> features{};
  struct Pair {
    int from = 0;
    int to = 0;
    int matches = 0;
    int inliers = 0;
  };
  std::vector<Pair> pairs;
};

class FeatureBench {
 public:
  explicit FeatureBench(Bench& bench)
      : bench_(bench), finder_([] {
          FeatureOptions options;
          options.max_features = PoseOptions{}.max_features;
          return options;
        }()) {}

  Result<const FeatureSet*> Features(int position, int exposure) {
    const std::pair<int, int> key(position, exposure);
    if (const auto found = sets_.find(key); found != sets_.end()) return &found->second;
    const std::array<int, 1> one = {exposure};
    OMNIHDR_ASSIGN(const Measurement measurement,
                   bench_.matrix().Measure(position, one, bench_.OptionsOf(Method::kOurs)));
    return &sets_
                .emplace(key,
                         finder_.Find(MakeFeatureImage(measurement, options_.feature_image_width)))
                .first->second;
  }

  // Mutual nearest neighbours that pass the ratio test, and those that one motion explains.
  Result<FeatureLinks::Pair> Match(int from, int from_exposure, int to, int to_exposure) {
    OMNIHDR_ASSIGN(const FeatureSet* a, Features(from, from_exposure));
    OMNIHDR_ASSIGN(const FeatureSet* b, Features(to, to_exposure));
    const Link link = LinkPositions(PositionId{from}, *a, PositionId{to}, *b, options_);
    return FeatureLinks::Pair{from, to, static_cast<int>(MatchFeatures(*a, *b, kPlainRatio).size()),
                              link.ok() ? static_cast<int>(link.inliers.size()) : 0};
  }

  Result<FeatureLinks> LinkThree(const std::array<int, 3>& exposures) {
    FeatureLinks links;
    for (int i = 0; i < 3; ++i) {
      OMNIHDR_ASSIGN(const FeatureSet* set, Features(i, exposures[static_cast<std::size_t>(i)]));
      links.features[static_cast<std::size_t>(i)] = set->size();
    }
    for (const auto& [from, to] : {std::pair(0, 1), std::pair(0, 2), std::pair(1, 2)}) {
      OMNIHDR_ASSIGN(const FeatureLinks::Pair pair,
                     Match(from, exposures[static_cast<std::size_t>(from)], to,
                           exposures[static_cast<std::size_t>(to)]));
      links.pairs.push_back(pair);
    }
    return links;
  }

 private:
  Bench& bench_;
  PoseOptions options_;
  FeatureFinder finder_;
  std::map<std::pair<int, int>, FeatureSet> sets_;
};

Status FeaturesOf(Bench& bench, Section* section, std::vector<Plot>* plots) {
  const DataMatrix& matrix = bench.matrix();
  FeatureBench features(bench);
  const int middle = matrix.middle();
  std::string why_not;
  const std::optional<Steps> steps = bench.StepsOf(2.0, &why_not);
  if (!steps) section->notes.push_back(why_not);
  if (steps) {
    OMNIHDR_ASSIGN(const FeatureLinks same, features.LinkThree({middle, middle, middle}));
    const std::array<int, 3> other = steps->all();
    OMNIHDR_ASSIGN(const FeatureLinks different, features.LinkThree(other));
    Table found;
    found.title = fmt::format("{}: features found (thesis table 4.1)", bench.place());
    found.columns = {"position", fmt::format("same exposure, #{}", middle), "different exposure",
                     "features at that"};
    for (std::size_t i = 0; i < 3; ++i) {
      found.rows.push_back({Number(static_cast<double>(i), 0), Number(same.features[i], 0),
                            Words(Numbered(other[i])), Number(different.features[i], 0)});
    }
    Table matched;
    matched.title = fmt::format("{}: matches (thesis table 4.2)", bench.place());
    matched.columns = {"positions",
                       "matches, same exposure",
                       "agreeing with one motion, same exposure",
                       "exposures",
                       "matches, different exposures",
                       "agreeing with one motion, different exposures"};
    for (std::size_t k = 0; k < same.pairs.size(); ++k) {
      const FeatureLinks::Pair& a = same.pairs[k];
      const FeatureLinks::Pair& b = different.pairs[k];
      matched.rows.push_back({Words(fmt::format("{}, {}", a.from, a.to)), Number(a.matches, 0),
                              Number(a.inliers, 0),
                              Words(fmt::format("#{}, #{}", other[static_cast<std::size_t>(a.from)],
                                                other[static_cast<std::size_t>(a.to)])),
                              Number(b.matches, 0), Number(b.inliers, 0)});
    }
    section->found += fmt::format(
        "{}{}: features {}, {}, {} at #{}, #{}, #{} ({} to {} at #{}); agreeing matches {} to {} "
        "with different exposures, {} to {} with the same",
        section->found.empty() ? "" : "; ", bench.place(), different.features[0],
        different.features[1], different.features[2], other[0], other[1], other[2],
        *std::min_element(same.features.begin(), same.features.end()),
        *std::max_element(same.features.begin(), same.features.end()), middle,
        std::min(
            {different.pairs[0].inliers, different.pairs[1].inliers, different.pairs[2].inliers}),
        std::max(
            {different.pairs[0].inliers, different.pairs[1].inliers, different.pairs[2].inliers}),
        std::min({same.pairs[0].inliers, same.pairs[1].inliers, same.pairs[2].inliers}),
        std::max({same.pairs[0].inliers, same.pairs[1].inliers, same.pairs[2].inliers}));
    section->tables.push_back(std::move(found));
    section->tables.push_back(std::move(matched));
  }
  // Position 0 at the middle exposure against position 1 at every one.
  std::vector<double> stops;
  std::vector<double> found;
  std::vector<double> matches;
  std::vector<double> inliers;
  Table sweep;
  sweep.title = fmt::format("{}: position 0 at #{} against position 1 at every exposure",
                            bench.place(), middle);
  sweep.columns = {"exposure at position 1", "stops apart", "features", "matches",
                   "agreeing with one motion"};
  for (int exposure = 0; exposure < matrix.exposures(); ++exposure) {
    OMNIHDR_ASSIGN(const FeatureSet* set, features.Features(1, exposure));
    OMNIHDR_ASSIGN(const FeatureLinks::Pair pair, features.Match(0, middle, 1, exposure));
    stops.push_back(matrix.StopsFromMiddle(exposure));
    found.push_back(set->size());
    matches.push_back(pair.matches);
    inliers.push_back(pair.inliers);
    sweep.rows.push_back({Words(Numbered(exposure)), Number(stops.back(), 2),
                          Number(set->size(), 0), Number(pair.matches, 0),
                          Number(pair.inliers, 0)});
  }
  if (!steps) {
    section->found += fmt::format("{}{}: agreeing matches {} at {:+.2f} stops, {} at {:+.2f}",
                                  section->found.empty() ? "" : "; ", bench.place(),
                                  inliers.front(), stops.front(), inliers.back(), stops.back());
  }
  section->tables.push_back(std::move(sweep));
  if (*std::max_element(found.begin(), found.end()) >= PoseOptions{}.max_features) {
    section->notes.push_back(fmt::format("{}: of more than {} features the strongest are kept",
                                         bench.place(), PoseOptions{}.max_features));
  }
  Plot plot;
  plot.title = fmt::format("{}: position 0 at #{}, position 1 at ...", bench.place(), middle);
  plot.x_label = "stops from the middle exposure";
  plot.y_label = "count";
  plot.series = {Curve("features at position 1", 7, stops, std::move(found)),
                 Curve("matches", 0, stops, std::move(matches)),
                 Curve("agreeing with one motion", 2, stops, std::move(inliers))};
  plots->push_back(std::move(plot));
  return {};
}

}  // namespace

Status RunOrder(const Benches& benches, const std::filesystem::path& out, Section* section) {
  std::vector<Plot> plots;
  for (Bench* bench : benches.all()) {
    if (bench->matrix().positions() < kFirstMoved + 2) {
      section->notes.push_back(fmt::format("{}: {} positions, expected {} or more: not run",
                                           bench->place(), bench->matrix().positions(),
                                           kFirstMoved + 2));
      continue;
    }
    OMNIHDR_TRY(OrderOf(*bench, section, &plots));
  }
  if (plots.empty()) return {};
  OMNIHDR_TRY(WriteCurves(out / "order.png", plots));
  section->figures.push_back(
      {"order.png", "Distance from position 0 against that of one exposure everywhere"});
  return {};
}

Status RunFeatures(const Benches& benches, const std::filesystem::path& out, Section* section) {
  std::vector<Plot> plots;
  for (Bench* bench : benches.all()) OMNIHDR_TRY(FeaturesOf(*bench, section, &plots));
  OMNIHDR_TRY(WriteCurves(out / "features.png", plots));
  section->figures.push_back({"features.png", "Features and matches by exposure"});
  return {};
}

}  // namespace omnihdr::experiments
