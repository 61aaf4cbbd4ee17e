#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "core/photometry/exposure_report.h"
#include "daemon/evaluation/experiments_parts.h"

namespace omnihdr::experiments {
namespace {

// The position the thesis counts at, or the last.
int CountedPosition(const Bench& bench) { return std::min(4, bench.matrix().positions() - 1); }

std::vector<int> Between(const DataMatrix& matrix, double from_stops, double to_stops) {
  const int first = matrix.NearestTo(from_stops);
  const int last = matrix.NearestTo(to_stops);
  std::vector<int> exposures(static_cast<std::size_t>(last - first + 1));
  std::iota(exposures.begin(), exposures.end(), first);
  return exposures;
}

}  // namespace

Status RunCounts(const Benches& benches, const std::filesystem::path& out, Section* section) {
  std::vector<Plot> plots;
  for (Bench* bench : benches.all()) {
    const DataMatrix& matrix = bench->matrix();
    const int position = CountedPosition(*bench);
    Table table;
    table.title = fmt::format("{}, position {}, frames of {}x{} pixels", bench->place(), position,
                              matrix.info().camera.width, matrix.info().camera.height);
    table.columns = {"exposure", "time (ms)",      "under (Z < 5)",
                     "under, %", "over (Z > 250)", "over, %"};
    std::vector<double> stops;
    std::vector<double> under;
    std::vector<double> over;
    for (int exposure = 0; exposure < matrix.exposures(); ++exposure) {
      OMNIHDR_ASSIGN(const DecodedImage image, matrix.Frame(position, exposure));
      const ExposureCount count =
          CountExposure(image, matrix.info().camera.bits, matrix.frame_mask());
      table.rows.push_back(
          {Words(Numbered(exposure)), Number(1e3 * matrix.Seconds(exposure), 4),
           Number(static_cast<double>(count.under), 0), Number(count.UnderPercent(), 3),
           Number(static_cast<double>(count.over), 0), Number(count.OverPercent(), 3)});
      stops.push_back(matrix.StopsFromMiddle(exposure));
      under.push_back(count.UnderPercent());
      over.push_back(count.OverPercent());
    }
    section->found += fmt::format(
        "{}{}: under {:.2f} % at #0, {:.3f} % at #{}; over {:.3f} % at #0, {:.2f} % at #{}",
        section->found.empty() ? "" : "; ", bench->place(), under.front(), under.back(),
        matrix.exposures() - 1, over.front(), over.back(), matrix.exposures() - 1);
    section->tables.push_back(std::move(table));
    Plot plot;
    plot.title = fmt::format("{}, position {}", bench->place(), position);
    plot.x_label = "stops from the middle exposure";
    plot.y_label = "pixels, %";
    plot.series = {Curve("under-exposed", 0, stops, std::move(under)),
                   Curve("over-exposed", 1, stops, std::move(over))};
    plots.push_back(std::move(plot));
  }
  OMNIHDR_TRY(WriteCurves(out / "counts.png", plots));
  section->figures.push_back({"counts.png", "Pixels that say nothing, by exposure"});
  return {};
}

Status RunTemporalRange(const Benches& benches, const std::filesystem::path& out,
                        Section* section) {
  std::vector<PictureRow> rows;
  for (Bench* bench : benches.all()) {
    const DataMatrix& matrix = bench->matrix();
    const int position = std::min(5, matrix.positions() - 1);
    // #0 to #14, #2 to #12 and #4 to #8 of thirds of a stop round #7.
    const std::vector<std::pair<double, double>> wanted = {
        {-7.0 / 3, 7.0 / 3}, {-5.0 / 3, 5.0 / 3}, {-1.0, 1.0 / 3}};
    Table table;
    table.title = fmt::format("{}, position {}", bench->place(), position);
    table.columns = {"exposures",
                     "from (ms)",
                     "to (ms)",
                     "dynamic range (largest over smallest radiance)",
                     "stops",
                     "stops, 0.1 to 99.9 %",
                     "clipped, %",
                     "SSIM to the first",
                     "RMSE to truth, where they can measure"};
    std::vector<std::vector<int>> sets;
    PictureRow row;
    row.label = table.title;
    std::string found;
    for (const auto& [from, to] : wanted) {
      const std::vector<int> exposures = Between(matrix, from, to);
      if (std::find(sets.begin(), sets.end(), exposures) != sets.end()) {
        section->notes.push_back(
            fmt::format("{}: its exposures do not tell {:+.2f} to {:+.2f} stops from a wider range",
                        bench->place(), from, to));
        continue;
      }
      sets.push_back(exposures);
      OMNIHDR_ASSIGN(const MergedView* view, bench->Temporal(position, exposures));
      // Held against the widest bracket (thesis 6.2.1).
      OMNIHDR_ASSIGN(const ViewScore score, bench->Score(position, sets.front(), *view));
      OMNIHDR_ASSIGN(const ViewScore own, bench->Score(position, exposures, *view));
      const RadianceRange range = Bench::MeasuredRange(*view, *view);
      std::size_t clipped = 0;
      std::size_t seen = 0;
      for (const std::uint8_t origin : view->origin.values()) {
        seen += origin != static_cast<std::uint8_t>(PixelOrigin::kNoData) ? 1 : 0;
        clipped += origin == static_cast<std::uint8_t>(PixelOrigin::kClipped) ? 1 : 0;
      }
      table.rows.push_back({Words(fmt::format("#{} to #{}", exposures.front(), exposures.back())),
                            Number(1e3 * matrix.Seconds(exposures.front()), 3),
                            Number(1e3 * matrix.Seconds(exposures.back()), 3),
                            Number(range.max / range.min, 0), Number(range.FullStops(), 2),
                            Number(range.Stops(), 2),
                            Number(100.0 * static_cast<double>(clipped) /
                                       static_cast<double>(std::max<std::size_t>(seen, 1)),
                                   3),
                            Number(score.ssim, 3), Number(own.rmse_truth, 4)});
      found += fmt::format("{}#{} to #{}: {:.1f} stops, SSIM {:.3f}", found.empty() ? "" : ", ",
                           exposures.front(), exposures.back(), range.FullStops(), score.ssim);
      row.pictures.push_back(Shown(*view));
    }
    section->tables.push_back(std::move(table));
    section->found +=
        fmt::format("{}{}: {}", section->found.empty() ? "" : "; ", bench->place(), found);
    rows.push_back(std::move(row));
  }
  std::size_t columns = 0;
  for (const PictureRow& row : rows) columns = std::max(columns, row.pictures.size());
  std::vector<std::string> titles = {"widest", "middle", "narrowest"};
  titles.resize(columns);
  OMNIHDR_TRY(WritePictures(out / "temporal-range.png", titles, rows));
  section->figures.push_back(
      {"temporal-range.png", "Temporal HDR of ever fewer exposures (thesis figs. 6.2 and 6.4)"});
  return {};
}

}  // namespace omnihdr::experiments
