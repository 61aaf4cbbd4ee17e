#include "tests/soak/soak_judge.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <utility>

#include "daemon/evaluation/plot.h"

namespace omnihdr::soak {
namespace {

// How long the frames that waited for the storage take to be stored.
constexpr std::chrono::minutes kTroubleEnds(2);

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::nan("");
  std::sort(values.begin(), values.end());
  const auto last = static_cast<double>(values.size() - 1);
  return values[static_cast<std::size_t>(std::llround(share * last))];
}

// The median of a quarter of the day, 0 to 3.
template <typename Row>
double QuarterMedian(const std::vector<Row>& rows, int quarter, double (*value)(const Row&)) {
  std::vector<double> values;
  const std::size_t from = rows.size() * static_cast<std::size_t>(quarter) / 4;
  const std::size_t to = rows.size() * static_cast<std::size_t>(quarter + 1) / 4;
  for (std::size_t i = from; i < to; ++i) {
    if (std::isfinite(value(rows[i]))) values.push_back(value(rows[i]));
  }
  return Quantile(std::move(values), 0.5);
}

// The first quarter fills caches and pools.
template <typename Row>
void MustBeFlat(const char* what, const std::vector<Row>& rows, double (*value)(const Row&),
                double factor, double slack, std::vector<std::string>& problems) {
  const double early = QuarterMedian(rows, 1, value);
  const double late = QuarterMedian(rows, 3, value);
  if (!(late <= factor * early + slack)) {
    problems.push_back(fmt::format("{} grows: {:.4g} in the second quarter, {:.4g} in the last",
                                   what, early, late));
  }
}

}  // namespace

std::vector<Latency> LatenciesOf(const std::vector<FrameRecord>& journal, HostTime start,
                                 double hours, double speed, int parts) {
  std::vector<std::vector<double>> by_part(static_cast<std::size_t>(parts));
  for (const FrameRecord& record : journal) {
    if (record.status != FrameStatus::kOk) continue;
    const double hour = static_cast<double>((record.trigger_time - start).count()) / 3.6e12;
    const auto part = static_cast<std::size_t>(
        std::clamp(hour / hours * parts, 0.0, static_cast<double>(parts - 1)));
    const double to_middle_s =
        static_cast<double>((record.timestamp - record.trigger_time).count()) * 1e-9;
    by_part[part].push_back(1e3 * (to_middle_s - record.exposure.time.seconds() / 2.0) / speed);
  }
  std::vector<Latency> latencies;
  for (std::size_t part = 0; part < by_part.size(); ++part) {
    latencies.push_back({(static_cast<double>(part) + 0.5) * hours / parts,
                         Quantile(by_part[part], 0.5), Quantile(by_part[part], 0.95)});
  }
  return latencies;
}

MissCauses CausesOf(const SoakResult& result) {
  const auto contains = [](const std::string& text, const char* part) {
    return text.find(part) != std::string::npos;
  };
  MissCauses causes;
  for (const FrameRecord& record : result.journal) {
    if (record.status != FrameStatus::kMissedTrigger) continue;
    if (contains(record.detail, "vanished at trigger") ||
        contains(record.detail, "the camera is not open yet")) {
      ++causes.unplugged;
    } else if (contains(record.detail, "no free frame buffer")) {
      const bool made =
          std::any_of(result.troubles.begin(), result.troubles.end(), [&](const Trouble& trouble) {
            return record.trigger_time >= trouble.from &&
                   record.trigger_time <= trouble.to + Nanoseconds(kTroubleEnds);
          });
      ++(made ? causes.storage : causes.slow);
    } else if (contains(record.detail, "busy") ||
               contains(record.detail, "lost this event before it was read")) {
      ++causes.slow;
    } else {
      causes.other.push_back(record.detail);
    }
  }
  return causes;
}

std::vector<std::string> Judge(const SoakResult& result) {
  std::vector<std::string> problems;
  using S = Sample;
  MustBeFlat<S>(
      "memory, MB", result.samples, [](const S& s) { return s.memory_mb; }, 1.1, 4.0, problems);
  MustBeFlat<S>(
      "descriptors", result.samples, [](const S& s) { return s.descriptors; }, 1.0, 2.0, problems);
  MustBeFlat<S>(
      "threads", result.samples, [](const S& s) { return s.threads; }, 1.0, 2.0, problems);
  MustBeFlat<Latency>(
      "latency, ms", result.latencies, [](const Latency& l) { return l.median_ms; }, 1.5, 2.0,
      problems);

  const std::vector<FrameRecord>& journal = result.journal;
  if (journal.size() < 2) return {"no frames"};
  for (std::size_t i = 0; i < journal.size(); ++i) {
    if (Value(journal[i].frame) != i) {
      problems.push_back(fmt::format("line {} is frame {}", i + 1, Value(journal[i].frame)));
      break;
    }
  }
  const auto silent = std::count_if(journal.begin(), journal.end(), [](const FrameRecord& record) {
    return record.status != FrameStatus::kOk && record.detail.empty();
  });
  if (silent > 0) problems.push_back(fmt::format("{} frames lost without a reason", silent));
  const MissCauses causes = CausesOf(result);
  if (!causes.other.empty()) {
    problems.push_back(fmt::format("{} triggers missed for a reason that nobody made: {}",
                                   causes.other.size(), causes.other.front()));
  }
  if (static_cast<std::size_t>(causes.slow) * 5 > journal.size()) {
    problems.push_back(
        fmt::format("{} of {} triggers missed because this computer is too slow for the speed of "
                    "the day: see --speed",
                    causes.slow, journal.size()));
  }
  // The timer's times are those of its beats, so the first and the last tell how many there were.
  const double span_s =
      static_cast<double>((journal.back().trigger_time - journal.front().trigger_time).count()) *
      1e-9;
  const auto due = static_cast<std::uint64_t>(std::llround(span_s / result.interval_s)) + 1;
  if (journal.size() + result.unlisted != due) {
    problems.push_back(fmt::format("{} triggers were due, {} have a line and {} are counted", due,
                                   journal.size(), result.unlisted));
  }
  return problems;
}

Status Draw(const SoakResult& result, const std::filesystem::path& file) {
  const auto series = [](const char* name, bool second) {
    PlotSeries made;
    made.name = name;
    made.colour = second ? std::array<std::uint8_t, 3>{255, 127, 14}
                         : std::array<std::uint8_t, 3>{31, 119, 180};
    return made;
  };
  PlotSeries memory = series("", false);
  PlotSeries descriptors = series("descriptors", false);
  PlotSeries threads = series("threads", true);
  for (const Sample& sample : result.samples) {
    for (PlotSeries* one : {&memory, &descriptors, &threads}) one->x.push_back(sample.hour);
    memory.y.push_back(sample.memory_mb);
    descriptors.y.push_back(sample.descriptors);
    threads.y.push_back(sample.threads);
  }
  PlotSeries median = series("median", false);
  PlotSeries high = series("95 of 100", true);
  for (const Latency& latency : result.latencies) {
    for (PlotSeries* one : {&median, &high}) one->x.push_back(latency.hour);
    median.y.push_back(latency.median_ms);
    high.y.push_back(latency.high_ms);
  }
  const auto plot = [](const char* title, const char* unit, std::vector<PlotSeries> drawn) {
    Plot made;
    made.title = title;
    made.x_label = "hours";
    made.y_label = unit;
    made.headroom = 0.2;
    made.series = std::move(drawn);
    return made;
  };
  return WritePlots(file.string(),
                    {plot("memory", "MB", {memory}),
                     plot("descriptors and threads", "count", {descriptors, threads}),
                     plot("trigger to exposure", "ms", {median, high})});
}

}  // namespace omnihdr::soak
