#include "daemon/cli/exposure_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <span>
#include <utility>

namespace omnihdr {
namespace {

std::string_view NameOf(RefineVerdict verdict) {
  switch (verdict) {
    case RefineVerdict::kLabelRight:
      return "label-right";
    case RefineVerdict::kRefined:
      return "corrected";
    case RefineVerdict::kBeyondLimit:
      return "beyond-limit";
    case RefineVerdict::kNoOverlap:
      return "not-tested";
    case RefineVerdict::kInconsistent:
      return "inconsistent";
  }
  return "?";
}

std::string LabelColumn(const RefinedExposure& r) {
  if (r.verdict == RefineVerdict::kNoOverlap) return "not tested";
  const double percent = 100.0 * (r.measured - 1.0);
  switch (r.verdict) {
    case RefineVerdict::kRefined:
      return fmt::format("{:+.1f} % corrected", percent);
    case RefineVerdict::kBeyondLimit:
    case RefineVerdict::kInconsistent:
      return fmt::format("{:+.1f} % refused", percent);
    default:
      return fmt::format("{:+.1f} %", percent);
  }
}

nlohmann::json RangeJson(const RadianceRange& range) {
  if (range.pixels == 0) return nullptr;
  return {{"min", range.min},
          {"max", range.max},
          {"percentile_0.1", range.low},
          {"percentile_99.9", range.high},
          {"stops", range.Stops()},
          {"decades", range.Decades()},
          {"stops_min_max", range.FullStops()}};
}

std::string RangeText(const RadianceRange& range) {
  if (range.pixels == 0) return "nothing measured";
  return fmt::format(
      "{:.4g} to {:.4g} (99.8 % of the pixels): {:.1f} stops, {:.2f} decades; {:.4g} to {:.4g} in "
      "all: {:.1f} stops",
      range.low, range.high, range.Stops(), range.Decades(), range.min, range.max,
      range.FullStops());
}

// Columns of what views recovered, where there are views.
bool HasRecovered(const ExposureSummary& summary) {
  return std::any_of(summary.lines.begin(), summary.lines.end(),
                     [](const ExposureRow& line) { return line.recovered.pixels > 0; });
}

}  // namespace

RadianceRange RangeOf(const Measurement& m) {
  Image<std::uint8_t> counted(m.flags.width(), m.flags.height());
  std::transform(m.flags.values().begin(), m.flags.values().end(), counted.values().begin(),
                 [](std::uint8_t flags) { return static_cast<std::uint8_t>(flags == 0 ? 1 : 0); });
  return RangeOfRadiance(m.radiance, counted);
}

Result<MergedBracket> MergeBracket(std::vector<ExposedFrame> frames,
                                   const std::vector<std::string>& names,
                                   const MeasureFrames& measure, const Response& response, int bits,
                                   ImageView<const std::uint8_t> mask,
                                   const MeasureOptions& options, double refine_limit,
                                   bool with_ranges) {
  MergedBracket merged;
  std::vector<RefinedExposure> refined(frames.size());
  if (refine_limit > 0.0) {
    RefineOptions refine;
    refine.limit = refine_limit;
    refine.value_low = options.value_low;
    refine.value_high = options.value_high;
    refine.noise = options.noise;
    OMNIHDR_ASSIGN(refined, RefineExposures(frames, response, bits, mask, refine));
  }
  if (refine_limit > 0.0) merged.notes = RefinementNotes(refined, frames, names, refine_limit);
  for (std::size_t k = 0; k < frames.size(); ++k) {
    ExposureRow line;
    line.name = names[k];
    line.exposure = frames[k].exposure;
    line.refined = refined[k];
    frames[k].exposure.time =
        ExposureTime::Seconds(frames[k].exposure.time.seconds() * refined[k].scale);
    line.count = CountExposure(*frames[k].image, bits, mask);
    if (with_ranges) {
      OMNIHDR_ASSIGN(const Measurement one, measure(std::span(frames).subspan(k, 1)));
      line.range = RangeOf(one);
    }
    merged.summary.lines.push_back(std::move(line));
  }
  OMNIHDR_ASSIGN(merged.measurement, measure(frames));
  std::stable_sort(merged.summary.lines.begin(), merged.summary.lines.end(),
                   [](const ExposureRow& a, const ExposureRow& b) {
                     return a.exposure.EffectiveSeconds() < b.exposure.EffectiveSeconds();
                   });
  std::size_t seen = 0;
  std::size_t clipped = 0;
  std::size_t dark = 0;
  for (const std::uint8_t flags : merged.measurement.flags.values()) {
    if ((flags & kMasked) != 0) continue;
    ++seen;
    if ((flags & kSaturatedAny) != 0) {
      ++clipped;
    } else if ((flags & kDarkAny) == kDarkAny) {
      ++dark;
    }
  }
  if (seen > 0) {
    merged.summary.clipped_percent =
        100.0 * static_cast<double>(clipped) / static_cast<double>(seen);
    merged.summary.dark_percent = 100.0 * static_cast<double>(dark) / static_cast<double>(seen);
  }
  merged.summary.merged = RangeOf(merged.measurement);
  return merged;
}

std::string TextOf(const ExposureSummary& summary) {
  std::size_t widest = 8;
  for (const ExposureRow& line : summary.lines) widest = std::max(widest, line.name.size());
  std::string text = summary.title + "\n";
  const bool has_recovered = HasRecovered(summary);
  text += fmt::format("  {:<{}}  {:>12}  {:>21}  {:>21}  {:>6}  {}{}\n", "exposure", widest, "time",
                      "under-exposed (<5)", "over-exposed (>250)", "stops",
                      has_recovered ? "in view  " : "", "label");
  for (const ExposureRow& line : summary.lines) {
    std::string time = fmt::format("{:.6g} ms", 1e3 * line.exposure.time.seconds());
    if (line.exposure.gain.value != 0.0) {
      time += fmt::format(" {:+.3g} dB", line.exposure.gain.value);
    }
    text += fmt::format("  {:<{}}  {:>12}  {:>10} {:>8.3f} %  {:>10} {:>8.3f} %  {:>6.1f}  {}{}\n",
                        line.name, widest, time, line.count.under, line.count.UnderPercent(),
                        line.count.over, line.count.OverPercent(), line.range.Stops(),
                        has_recovered ? fmt::format("{:>7.1f}  ", line.recovered.Stops()) : "",
                        LabelColumn(line.refined));
  }
  if (summary.merged.pixels > 0) {
    text += fmt::format("  radiance {}\n", RangeText(summary.merged));
    text += fmt::format("  {:.3f} % clipped in every exposure, {:.3f} % dark in every exposure\n",
                        summary.clipped_percent, summary.dark_percent);
  }
  return text;
}

std::string JsonOf(const ExposureSummary& summary) {
  nlohmann::json lines = nlohmann::json::array();
  for (const ExposureRow& line : summary.lines) {
    lines.push_back({{"name", line.name},
                     {"exposure_s", line.exposure.time.seconds()},
                     {"gain_db", line.exposure.gain.value},
                     {"pixels", line.count.pixels},
                     {"under", line.count.under},
                     {"under_percent", line.count.UnderPercent()},
                     {"over", line.count.over},
                     {"over_percent", line.count.OverPercent()},
                     {"radiance", RangeJson(line.range)},
                     {"view_radiance", RangeJson(line.recovered)},
                     {"label",
                      {{"verdict", NameOf(line.refined.verdict)},
                       {"measured", line.refined.measured},
                       {"scale", line.refined.scale},
                       {"samples", line.refined.samples}}}});
  }
  const nlohmann::json all = {{"title", summary.title},
                              {"exposures", std::move(lines)},
                              {"radiance", RangeJson(summary.merged)},
                              {"clipped_percent", summary.clipped_percent},
                              {"dark_percent", summary.dark_percent}};
  return all.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace omnihdr
