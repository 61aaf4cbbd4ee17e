#include "daemon/evaluation/experiments_report.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "core/base/file.h"
#include "core/image/image_io.h"

namespace omnihdr::experiments {
namespace {

using OrderedJson = nlohmann::ordered_json;

constexpr int kCellWidth = 480;
constexpr int kBetween = 6;
constexpr int kHeading = 30;
constexpr int kRowLabel = 22;

OrderedJson CellJson(const Cell& cell) {
  if (cell.number) return *cell.number;
  if (cell.text == "-") return nullptr;
  return cell.text;
}

// A column of numbers is set to the right.
bool HoldsNumbers(const Table& table, std::size_t column) {
  return std::any_of(table.rows.begin(), table.rows.end(),
                     [column](const auto& row) { return row[column].number.has_value(); });
}

std::string TableMarkdown(const Table& table) {
  std::string out = fmt::format("**{}**\n\n|", table.title);
  for (const std::string& column : table.columns) out += fmt::format(" {} |", column);
  out += "\n|";
  for (std::size_t k = 0; k < table.columns.size(); ++k) {
    out += HoldsNumbers(table, k) ? " ---: |" : " --- |";
  }
  for (const std::vector<Cell>& row : table.rows) {
    out += "\n|";
    for (const Cell& cell : row) out += fmt::format(" {} |", cell.text);
  }
  return out + "\n\n";
}

cv::Mat Wrapped(Image<std::uint8_t>& image) {
  return {image.height(), image.width(), CV_8UC3, image.data()};
}

void Label(cv::Mat& canvas, const std::string& text, int x, int y, double size) {
  cv::putText(canvas, text, {x, y}, cv::FONT_HERSHEY_SIMPLEX, size, {225, 225, 225}, 1,
              cv::LINE_AA);
}

}  // namespace

Cell Words(std::string text) { return {std::move(text), std::nullopt}; }

Cell Number(std::optional<double> value, int decimals) {
  if (!value || !std::isfinite(*value)) return {"-", std::nullopt};
  return {fmt::format("{:.{}f}", *value, decimals), value};
}

std::string FormatMarkdown(const std::vector<MatrixNote>& matrices,
                           const std::vector<Section>& sections) {
  std::string out =
      "# The experiments of the thesis, reproduced\n\n"
      "F. Zhou, *Omnidirectional High Dynamic Range Imaging with a Moving Camera*, University of "
      "Ottawa, 2014, chapter 6 (and 4.3 for features). From a data matrix, the same exposures at "
      "every position, sequences with one exposure a position are drawn and made into HDR views, "
      "which are held against the temporal HDR image of the same exposures at the same position, "
      "as the thesis does, and against the truth where the scene is known.\n\n"
      "- SSIM: of luminance as Reinhard's operator shows it, the temporal HDR image's parameters "
      "for both.\n"
      "- RMSE: of log10 luminance after one factor a picture; against the truth where the bracket "
      "can measure. 0.301 is one stop.\n"
      "- Ours: the pipeline's default methods. Thesis's parts: the same pipeline with the "
      "thesis's cost, fusion, filter, fill and merge (`config/thesis.toml`), semi-global matching "
      "in place of its multi-scale matcher.\n"
      "- The thesis's own numbers are of its own pictures (a library and a front yard taken with a "
      "Ladybug 2), other scenes than those here: compare the directions of change, not digits.\n\n"
      "| matrix | scene | positions | exposures | from (ms) | to (ms) | middle |\n"
      "| --- | --- | ---: | ---: | ---: | ---: | ---: |\n";
  for (const MatrixNote& matrix : matrices) {
    out += fmt::format(
        "| {} | {} | {} | {} | {:.4g} | {:.4g} | #{} |\n", matrix.place,
        matrix.scene.empty() ? "not known: nothing is compared with the truth" : matrix.scene,
        matrix.positions, matrix.exposures_s.size(), 1e3 * matrix.exposures_s.front(),
        1e3 * matrix.exposures_s.back(), matrix.middle);
  }
  out += "\n| experiment | the thesis | here |\n| --- | --- | --- |\n";
  for (const Section& section : sections) {
    out += fmt::format("| [{}](#{}) | {} | {} |\n", section.title, section.name, section.thesis,
                       section.found.empty() ? "not run, see there" : section.found);
  }
  for (const Section& section : sections) {
    out += fmt::format("\n<a id=\"{}\"></a>\n## {}\n\n{}\n\nThe thesis: {}\n\n", section.name,
                       section.title, section.design, section.thesis);
    if (!section.found.empty()) out += fmt::format("Here: {}\n\n", section.found);
    for (const Table& table : section.tables) out += TableMarkdown(table);
    for (const std::string& note : section.notes) out += fmt::format("- {}\n", note);
    if (!section.notes.empty()) out += "\n";
    for (const Figure& figure : section.figures) {
      out += fmt::format("![{0}]({1})\n\n{0}\n\n", figure.caption, figure.file);
    }
  }
  return out;
}

std::string FormatJson(const std::vector<MatrixNote>& matrices,
                       const std::vector<Section>& sections) {
  OrderedJson document;
  document["matrices"] = OrderedJson::array();
  for (const MatrixNote& matrix : matrices) {
    document["matrices"].push_back(
        {{"place", matrix.place},
         {"session", matrix.session},
         {"scene", matrix.scene.empty() ? OrderedJson(nullptr) : OrderedJson(matrix.scene)},
         {"positions", matrix.positions},
         {"exposures_s", matrix.exposures_s},
         {"middle", matrix.middle}});
  }
  document["experiments"] = OrderedJson::array();
  for (const Section& section : sections) {
    OrderedJson tables = OrderedJson::array();
    for (const Table& table : section.tables) {
      OrderedJson rows = OrderedJson::array();
      for (const std::vector<Cell>& row : table.rows) {
        OrderedJson object = OrderedJson::object();
        for (std::size_t k = 0; k < row.size(); ++k) object[table.columns[k]] = CellJson(row[k]);
        rows.push_back(std::move(object));
      }
      tables.push_back({{"title", table.title}, {"rows", std::move(rows)}});
    }
    OrderedJson figures = OrderedJson::array();
    for (const Figure& figure : section.figures) {
      figures.push_back({{"file", figure.file}, {"caption", figure.caption}});
    }
    document["experiments"].push_back({{"name", section.name},
                                       {"title", section.title},
                                       {"run", !section.found.empty()},
                                       {"design", section.design},
                                       {"thesis", section.thesis},
                                       {"found", section.found},
                                       {"tables", std::move(tables)},
                                       {"figures", std::move(figures)},
                                       {"notes", section.notes}});
  }
  return document.dump(2, ' ', false, OrderedJson::error_handler_t::replace) + "\n";
}

std::string FormatSummary(const std::vector<Section>& sections) {
  std::string out;
  for (const Section& section : sections) {
    out += fmt::format(
        "{}: {}\n", section.name,
        section.found.empty() && !section.notes.empty() ? section.notes.front() : section.found);
  }
  return out;
}

Status WritePictures(const std::filesystem::path& file, const std::vector<std::string>& titles,
                     const std::vector<PictureRow>& rows) {
  int height = kCellWidth / 2;
  for (const PictureRow& row : rows) {
    for (const Image<std::uint8_t>& picture : row.pictures) {
      if (!picture.empty()) height = kCellWidth * picture.height() / picture.width();
    }
  }
  const auto columns = static_cast<int>(titles.size());
  Image<std::uint8_t> sheet(
      columns * (kCellWidth + kBetween) + kBetween,
      kHeading + static_cast<int>(rows.size()) * (height + kRowLabel + kBetween), 3, 32);
  cv::Mat canvas = Wrapped(sheet);
  for (int k = 0; k < columns; ++k) {
    Label(canvas, titles[static_cast<std::size_t>(k)], kBetween + k * (kCellWidth + kBetween), 20,
          0.5);
  }
  int y = kHeading;
  for (const PictureRow& row : rows) {
    Label(canvas, row.label, kBetween, y + 15, 0.45);
    y += kRowLabel;
    for (std::size_t k = 0; k < row.pictures.size(); ++k) {
      if (row.pictures[k].empty()) continue;
      Image<std::uint8_t> picture = row.pictures[k].Clone();
      cv::Mat place = canvas(cv::Rect(kBetween + static_cast<int>(k) * (kCellWidth + kBetween), y,
                                      kCellWidth, height));
      cv::resize(Wrapped(picture), place, place.size(), 0.0, 0.0, cv::INTER_AREA);
    }
    y += height + kBetween;
  }
  OMNIHDR_ASSIGN(const std::vector<std::byte> png, EncodePng(sheet.view(), 6));
  return WriteFileAtomic(file, png);
}

PlotSeries Curve(std::string name, std::size_t colour, std::vector<double> x, std::vector<double> y,
                 bool dots) {
  constexpr std::array<std::array<std::uint8_t, 3>, 8> kColours = {{{31, 119, 180},
                                                                    {214, 39, 40},
                                                                    {44, 160, 44},
                                                                    {148, 103, 189},
                                                                    {255, 127, 14},
                                                                    {140, 86, 75},
                                                                    {23, 190, 207},
                                                                    {127, 127, 127}}};
  PlotSeries series;
  series.name = std::move(name);
  series.colour = kColours[colour % kColours.size()];
  series.x = std::move(x);
  series.y = std::move(y);
  series.dots = dots;
  return series;
}

Status WriteCurves(const std::filesystem::path& file, std::vector<Plot> plots) {
  constexpr double kLine = 0.055;  // of the plot's height, a line of the legend
  std::size_t most = 0;
  for (const Plot& plot : plots) most = std::max(most, plot.series.size());
  for (Plot& plot : plots) plot.headroom = kLine * static_cast<double>(most);
  return WritePlots(file.string(), plots);
}

}  // namespace omnihdr::experiments
