#include "daemon/evaluation/evaluation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <utility>

#include "core/base/file.h"
#include "core/base/parallel_for.h"
#include "core/photometry/exposure_report.h"
#include "core/photometry/measure.h"
#include "core/photometry/tonemap.h"
#include "core/quality/picture_metrics.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "daemon/evaluation/mover_score.h"
#include "daemon/evaluation/reference.h"
#include "daemon/evaluation/view_files.h"

namespace omnihdr {
namespace {

// A trigger's place: its journal lines and, once made, its view.
struct Place {
  const FrameRecord* own = nullptr;  // the view's reference frame, or the first with pixels, or any
  bool has_view = false;
  ViewRecord view;
  std::optional<Pose> true_pose;
  // What the view's chain says: the place in the chain and the chain's truth length per estimated
  // one.
  std::optional<PoseErrors> pose;
  double metres_per_unit = 1.0;
};

using Places = std::map<PositionId, Place>;

Result<Places> ReadPlaces(const SessionContents& contents, const std::filesystem::path& views) {
  Places places;
  for (const FrameRecord& frame : contents.journal.frames) {
    Place& place = places[frame.position];
    if (place.own == nullptr ||
        (place.own->status != FrameStatus::kOk && frame.status == FrameStatus::kOk)) {
      place.own = &frame;
    }
  }
  OMNIHDR_ASSIGN(const std::vector<PositionId> complete, CompleteViews(views));
  for (const PositionId position : complete) {
    const auto found = places.find(position);
    if (found == places.end()) continue;  // a view of another session says nothing about this one
    OMNIHDR_ASSIGN(found->second.view, ReadViewRecord(views, position));
    found->second.has_view = true;
    for (const FrameRecord& frame : contents.journal.frames) {
      if (Value(frame.frame) == found->second.view.reference) found->second.own = &frame;
    }
  }
  return places;
}

// Seconds a view took, from the timings file that lies beside the views: one line a view, the
// latest counts. Timings are a convenience: a line that is not understood says nothing.
std::map<PositionId, double> ReadTimings(const std::filesystem::path& views) {
  std::map<PositionId, double> timings;
  const Result<std::string> text = ReadTextFile(views.parent_path() / "timings.jsonl");
  if (!text) return timings;
  std::istringstream lines(*text);
  for (std::string line; std::getline(lines, line);) {
    const auto json = nlohmann::json::parse(line, nullptr, false);
    if (!json.is_object() || !json.contains("position") || !json["position"].is_number_integer() ||
        !json.contains("seconds") || !json["seconds"].is_object()) {
      continue;
    }
    double sum = 0.0;
    for (const auto& [step, seconds] : json["seconds"].items()) {
      if (seconds.is_number()) sum += seconds.get<double>();
    }
    timings[PositionId{json["position"].get<std::int64_t>()}] = sum;
  }
  return timings;
}

// Pose errors chain by chain, and what a chain's length unit is in metres.
void ScorePoses(Places& places) {
  std::map<int, std::vector<Place*>> chains;
  for (auto& [position, place] : places) {
    if (place.has_view && place.true_pose) chains[place.view.chain].push_back(&place);
  }
  for (auto& [number, chain] : chains) {
    std::vector<Pose> estimated;
    std::vector<Pose> truth;
    for (const Place* place : chain) {
      estimated.push_back(place->view.pose);
      truth.push_back(*place->true_pose);
    }
    const bool fit_scale = !chain.front()->view.metric_scale;
    const ChainErrors errors = ComparePoses(estimated, truth, fit_scale);
    for (std::size_t i = 0; i < chain.size(); ++i) {
      chain[i]->pose = errors.positions[i];
      if (fit_scale) chain[i]->metres_per_unit = errors.scale;
    }
  }
}

// Mean distance in metres from a place to its neighbours in the journal; nothing without truth or
// alone.
std::optional<double> MeanBaseline(const Places& places, Places::const_iterator at) {
  double sum = 0.0;
  int count = 0;
  const auto add = [&](const Place& other) {
    if (!other.true_pose || !at->second.true_pose) return;
    sum += (other.true_pose->translation - at->second.true_pose->translation).norm();
    ++count;
  };
  if (at != places.begin()) add(std::prev(at)->second);
  if (std::next(at) != places.end()) add(std::next(at)->second);
  if (count == 0 || !(sum > 0.0)) return std::nullopt;
  return sum / count;
}

// The radiance that frames can measure: from the usable range's low end at the longest exposure to
// its high end at the shortest.
MeasurableRange RangeOf(const SessionContents& contents, double longest_s, double shortest_s) {
  const MeasureOptions usable;
  MeasurableRange range;
  range.low =
      static_cast<float>(contents.info.response.ExposureFromValue(1, usable.value_low) / longest_s);
  range.high = static_cast<float>(contents.info.response.ExposureFromValue(1, usable.value_high) /
                                  shortest_s);
  return range;
}

MeasurableRange BracketRange(const SessionContents& contents) {
  double longest = 0.0;
  double shortest = std::numeric_limits<double>::infinity();
  for (const FrameRecord& frame : contents.journal.frames) {
    if (frame.status != FrameStatus::kOk) continue;
    longest = std::max(longest, frame.exposure.EffectiveSeconds());
    shortest = std::min(shortest, frame.exposure.EffectiveSeconds());
  }
  return longest > 0.0 ? RangeOf(contents, longest, shortest) : MeasurableRange{};
}

// A frame of each other position that contributed to a view.
std::vector<Reference::Other> OtherFrames(const SessionContents& contents, const Place& place) {
  std::vector<Reference::Other> others;
  for (const FrameRecord& frame : contents.journal.frames) {
    const std::vector<std::uint64_t>& used = place.view.frames;
    if (frame.position == place.own->position ||
        std::find(used.begin(), used.end(), Value(frame.frame)) == used.end() ||
        (!others.empty() && others.back().frame->position == frame.position)) {
      continue;
    }
    const double seconds = frame.exposure.EffectiveSeconds();
    others.push_back({&frame, RangeOf(contents, seconds, seconds)});
  }
  return others;
}

// Whether a view was made to show the background instead of what moves: its methods are in what the
// pipeline continues from.
bool RemovesMovers(const ViewRecord& view) {
  const auto resume = nlohmann::json::parse(view.resume_json, nullptr, false);
  return resume.is_object() && resume.contains("methods") && resume["methods"].is_string() &&
         resume["methods"].get<std::string>().find("merge.movers = remove") != std::string::npos;
}

bool Known(const float* rgb) {
  return std::isfinite(rgb[0]) && std::isfinite(rgb[1]) && std::isfinite(rgb[2]);
}

Status ScorePictures(const std::filesystem::path& session, const SessionContents& contents,
                     const ViewFiles& view, const Place& place, const Reference& reference,
                     std::optional<double> baseline, FrameMeasurer& measurer, PositionScore& score,
                     ReliabilityCurve& reliability) {
  const int width = view.radiance.width();
  const int height = view.radiance.height();
  const Projection output = Projection::Equirectangular(width, height);
  OMNIHDR_ASSIGN(Reference::Picture truth,
                 reference.Render(*place.own, output, view.record.orientation));
  OMNIHDR_ASSIGN(const Reference::Movers movers,
                 reference.FindMovers(*place.own, OtherFrames(contents, place), output,
                                      view.record.orientation));
  const bool removes = RemovesMovers(view.record);
  const Image<float> now = truth.radiance.Clone();
  // What such a view should show.
  if (removes && !movers.background.empty()) truth.radiance = movers.background.Clone();
  OMNIHDR_ASSIGN(const Image<float> own,
                 OwnFrameRadiance(session, measurer, *place.own, output, view.record.orientation));
  const MeasurableRange range = BracketRange(contents);
  ComparisonArea area = SphereArea(output);
  Image<std::uint8_t> compared(width, height, 1);
  Image<std::uint8_t> seen(width, height, 1);  // by the own frame
  double wanted = 0.0;
  double have = 0.0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float* want = truth.radiance.pixel(x, y);
      if (!Known(own.pixel(x, y))) continue;
      seen.at(x, y) = 255;
      if (!Known(want) || *std::max_element(want, want + 3) > range.high ||
          Luminance(want) < range.low) {
        continue;
      }
      wanted += area.Weight(y);
      if (!Known(view.radiance.pixel(x, y))) continue;
      have += area.Weight(y);
      compared.at(x, y) = 255;
    }
  }
  score.covered = wanted > 0.0 ? have / wanted : 0.0;
  area.mask = compared.view();
  const std::array<ImageView<const float>, 2> tested = {view.radiance, own};
  std::array<RadianceScore, 2> scores;
  ParallelFor(2, 1, [&](int begin, int end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      scores[i] = ScoreRadiance(tested[i], truth.radiance, area);
    }
  });
  score.view = scores[0];
  score.own_frame = scores[1];
  if (!view.sources.empty() && view.sources.width() == width) {
    score.seams = FindSeams(view.radiance, truth.radiance, view.sources, area, /*wraps=*/true);
  }
  if (!movers.background.empty()) {
    const double seconds = place.own->exposure.EffectiveSeconds();
    score.movers = ScoreMovers({.view = view.radiance,
                                .view_scale = score.view->errors.scale,
                                .own_frame = own,
                                .own_scale = score.own_frame->errors.scale,
                                .truth = now,
                                .movers = movers,
                                .bracket = range,
                                .own = RangeOf(contents, seconds, seconds),
                                .removes = removes},
                               area);
  }
  const double stops = RangeOfRadiance(truth.radiance, compared).Stops();
  score.range_share = stops > 0.0 ? RangeOfRadiance(view.radiance, compared).Stops() / stops : 0.0;

  if (!truth.disparity.empty() && !view.disparity.empty() && baseline) {
    Image<float> metric(width, height, 1);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        metric.at(x, y) = view.disparity.at(x, y) / static_cast<float>(place.metres_per_unit);
      }
    }
    area.mask = seen.view();
    score.disparity = CompareDisparity(metric, truth.disparity, *baseline, area);
    if (!view.confidence.empty()) {
      reliability.Add(metric, view.confidence, truth.disparity, *baseline, area);
    }
  }
  return {};
}

std::optional<SessionScore::Mean> MeanOf(const std::vector<PositionScore>& positions) {
  SessionScore::Mean mean;
  double bad1 = 0.0;
  double relative = 0.0;
  double mover_weight = 0.0;
  double mover_off = 0.0;
  double mover_own_off = 0.0;
  double seam_noise = 0.0;
  double seam_log10 = 0.0;
  int with_seams = 0;
  int with_disparity = 0;
  int with_relative = 0;
  for (const PositionScore& p : positions) {
    if (p.pose) {
      mean.rotation_deg = std::max(mean.rotation_deg.value_or(0.0), p.pose->rotation_deg);
      mean.translation_percent =
          std::max(mean.translation_percent.value_or(0.0), p.pose->translation_percent);
    }
    if (p.movers && p.movers->view.pixels > 0) {
      mover_weight += p.movers->view.weight;
      mover_off += p.movers->view.weight * p.movers->view.share_off;
      mover_own_off += p.movers->view.weight * p.movers->own_frame.share_off;
    }
    if (p.seams && p.seams->borders > 0) {
      ++with_seams;
      seam_noise += p.seams->excess_noise;
      seam_log10 += p.seams->excess_log10;
    }
    if (!p.view || !std::isfinite(p.view->errors.log10_rmse)) continue;
    ++mean.positions;
    mean.view_rmse += p.view->errors.log10_rmse;
    mean.own_rmse += p.own_frame->errors.log10_rmse;
    mean.view_p95 += p.view->errors.log10_p95;
    mean.own_p95 += p.own_frame->errors.log10_p95;
    mean.view_ssim += p.view->ssim;
    mean.own_ssim += p.own_frame->ssim;
    mean.view_psnr_mu += p.view->psnr_mu;
    mean.own_psnr_mu += p.own_frame->psnr_mu;
    mean.covered += p.covered;
    mean.range_share += p.range_share;
    if (p.disparity && std::isfinite(p.disparity->bad1)) {
      ++with_disparity;
      bad1 += p.disparity->bad1;
    }
    if (p.disparity && std::isfinite(p.disparity->median_relative)) {
      ++with_relative;
      relative += p.disparity->median_relative;
    }
  }
  if (mean.positions == 0) return std::nullopt;
  for (double* sum :
       {&mean.view_rmse, &mean.own_rmse, &mean.view_p95, &mean.own_p95, &mean.view_ssim,
        &mean.own_ssim, &mean.view_psnr_mu, &mean.own_psnr_mu, &mean.covered, &mean.range_share}) {
    *sum /= mean.positions;
  }
  if (mover_weight > 0.0) {
    mean.movers_off = mover_off / mover_weight;
    mean.movers_own_off = mover_own_off / mover_weight;
  }
  if (with_seams > 0) {
    mean.seam_noise = seam_noise / with_seams;
    mean.seam_log10 = seam_log10 / with_seams;
  }
  if (with_disparity > 0) mean.disparity_bad1 = bad1 / with_disparity;
  if (with_relative > 0) mean.disparity_relative = relative / with_relative;
  return mean;
}

}  // namespace

RadianceScore ScoreRadiance(ImageView<const float> tested, ImageView<const float> truth,
                            const ComparisonArea& area) {
  const Image<float> truth_luminance = LuminanceOf(truth);
  RadianceScore score;
  score.errors = CompareRadiance(tested, truth, area);
  Image<float> scaled(tested.width(), tested.height(), 3);
  for (int y = 0; y < tested.height(); ++y) {
    for (int x = 0; x < tested.width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        scaled.at(x, y, c) = tested.at(x, y, c) * static_cast<float>(score.errors.scale);
      }
    }
  }
  const ReinhardParameters parameters = ReinhardParametersOf(truth_luminance, area);
  const double white = parameters.white * parameters.log_average / 0.18;
  score.psnr_mu = PsnrMu(scaled, truth, white, area);
  score.ssim = Ssim(ReinhardDisplay(LuminanceOf(scaled), parameters),
                    ReinhardDisplay(truth_luminance, parameters), 1.0, area, /*wraps=*/true);
  return score;
}

Result<SessionScore> EvaluateSession(const std::filesystem::path& session,
                                     const EvaluationOptions& options,
                                     const std::function<void(int, int)>& progress) {
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  if (contents.info.camera.layout == Layout::kPerspective) {
    return Fail(ErrorKind::kData,
                "{}: layout: \"{}\", only \"panorama\" and \"rig\" can be evaluated",
                (session / "session.json").string(), ToString(contents.info.camera.layout));
  }
  const std::filesystem::path views = options.views.empty() ? session / "views" : options.views;
  OMNIHDR_ASSIGN(const std::unique_ptr<Reference> reference,
                 OpenReference(session, contents, options.photographs));
  OMNIHDR_ASSIGN(FrameMeasurer measurer, OpenOwnFrames(session, contents.info, options.mask));
  OMNIHDR_ASSIGN(Places places, ReadPlaces(contents, views));
  if (reference) {
    for (auto& [position, place] : places) {
      OMNIHDR_ASSIGN(place.true_pose, reference->TruePose(*place.own));
    }
    ScorePoses(places);
  }

  const std::map<PositionId, double> timings = ReadTimings(views);
  SessionScore score;
  if (reference) score.reference = reference->name();
  for (auto at = places.cbegin(); at != places.cend(); ++at) {
    const Place& place = at->second;
    PositionScore position;
    position.position = at->first;
    position.exposure = place.own->exposure;
    position.status = place.own->status;
    position.complete = place.has_view;
    if (place.has_view) {
      ++score.complete;
      position.frames = static_cast<int>(place.view.frames.size());
      position.chain = place.view.chain;
      position.valid_fraction = place.view.valid_fraction;
      position.warnings = place.view.warnings;
      position.pose = place.pose;
      if (const auto timing = timings.find(at->first); timing != timings.end()) {
        position.seconds = timing->second;
      }
      if (reference && place.own->status == FrameStatus::kOk) {
        OMNIHDR_ASSIGN(const ViewFiles view, ReadView(views, at->first));
        OMNIHDR_TRY(ScorePictures(session, contents, view, place, *reference,
                                  MeanBaseline(places, at), measurer, position, score.reliability)
                        .Context(fmt::format("position {}", Value(at->first))));
      }
    }
    score.positions.push_back(std::move(position));
    if (progress)
      progress(static_cast<int>(score.positions.size()), static_cast<int>(places.size()));
  }
  score.mean = MeanOf(score.positions);
  return score;
}

}  // namespace omnihdr
