#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "daemon/evaluation/plot.h"

namespace omnihdr::experiments {

// What a cell of a table says: words, or a number and how many decimals of it are shown.
struct Cell {
  std::string text;
  std::optional<double> number;  // as measured, for programs
};
Cell Words(std::string text);
// "-" and no number when there is none, or it is not finite.
Cell Number(std::optional<double> value, int decimals);

struct Table {
  std::string title;
  std::vector<std::string> columns;
  std::vector<std::vector<Cell>> rows;  // a cell a column
};

struct Figure {
  std::string file;  // relative to the report
  std::string caption;
};

// One experiment's part of the report.
struct Section {
  std::string name;    // as on the command line
  std::string title;   // for people
  std::string design;  // what is varied, and how it is drawn from the matrix
  std::string thesis;  // what the thesis found
  std::string found;   // the same of this run, in a line; "" when it could not be run
  std::vector<Table> tables;
  std::vector<Figure> figures;
  std::vector<std::string> notes;  // what was left out, and why
};

// What the sections were measured on.
struct MatrixNote {
  std::string place;    // "indoor", "outdoor", or the session's name
  std::string session;  // its folder
  std::string scene;    // what is known of it: "simulation (hall, seed 1)", or ""
  int positions = 0;
  std::vector<double> exposures_s;
  int middle = 0;
};

std::string FormatMarkdown(const std::vector<MatrixNote>& matrices,
                           const std::vector<Section>& sections);
// One object: "matrices" and "experiments"; a table's rows are objects with a key a column.
std::string FormatJson(const std::vector<MatrixNote>& matrices,
                       const std::vector<Section>& sections);
// For the terminal: one line an experiment.
std::string FormatSummary(const std::vector<Section>& sections);

// Pictures in rows under a title a column, all brought to one size; a row's label stands above it.
// Empty pictures leave their cell free.
struct PictureRow {
  std::string label;
  std::vector<Image<std::uint8_t>> pictures;  // RGB
};
Status WritePictures(const std::filesystem::path& file, const std::vector<std::string>& titles,
                     const std::vector<PictureRow>& rows);

// A curve in one of eight colours.
PlotSeries Curve(std::string name, std::size_t colour, std::vector<double> x, std::vector<double> y,
                 bool dots = false);
// Plots of one kind, with room for the legend of the one that has most to name.
Status WriteCurves(const std::filesystem::path& file, std::vector<Plot> plots);

}  // namespace omnihdr::experiments
