#include "daemon/evaluation/contact_sheet.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/image/image_io.h"
#include "core/photometry/tonemap.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "daemon/evaluation/false_colour.h"
#include "daemon/evaluation/own_frame.h"
#include "daemon/evaluation/reference.h"
#include "daemon/evaluation/view_files.h"

namespace omnihdr {
namespace {

constexpr int kGap = 6;
constexpr int kTitleHeight = 30;
constexpr int kLabelHeight = 22;
constexpr double kErrorFull = 0.3;  // a factor of two

// The cells of one row, already at their size.
struct Row {
  std::string label;
  std::vector<Image<std::uint8_t>> cells;
  Image<float> disparity;  // what the disparity's cell will show
};
constexpr std::size_t kDisparityCell = 2;

cv::Mat Mat(Image<std::uint8_t>& image) {
  return {image.height(), image.width(), CV_8UC(image.channels()), image.data()};
}

Image<std::uint8_t> Shrunk(Image<std::uint8_t> picture, int width, int height) {
  Image<std::uint8_t> small(width, height, 3);
  cv::Mat target = Mat(small);
  cv::resize(Mat(picture), target, target.size(), 0.0, 0.0, cv::INTER_AREA);
  return small;
}

// Not averaged: between near and far lies nothing. Unknown everywhere for a view without disparity.
Image<float> SampledDisparity(const Image<float>& disparity, int width, int height) {
  Image<float> small(width, height, 1, std::numeric_limits<float>::quiet_NaN());
  if (disparity.empty()) return small;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      small.at(x, y) = disparity.at((2 * x + 1) * disparity.width() / (2 * width),
                                    (2 * y + 1) * disparity.height() / (2 * height));
    }
  }
  return small;
}

Image<float> ShrunkRadiance(const Image<float>& radiance, int width, int height) {
  Image<float> from = radiance.Clone();
  Image<float> small(width, height, 3);
  cv::Mat target(height, width, CV_32FC3, small.data());
  cv::resize(cv::Mat(from.height(), from.width(), CV_32FC3, from.data()), target, target.size(),
             0.0, 0.0, cv::INTER_AREA);
  return small;
}

// Marks as unknown what the position's own frame did not see: the mask, the camera's edge.
void LeaveOutUnseen(const Image<float>& own, Image<float>& truth) {
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      const float seen = own.at((2 * x + 1) * own.width() / (2 * truth.width()),
                                (2 * y + 1) * own.height() / (2 * truth.height()));
      if (std::isnan(seen)) {
        std::fill_n(truth.pixel(x, y), 3, std::numeric_limits<float>::quiet_NaN());
      }
    }
  }
}

// The input frame as its sensor saw it: linear values, shown with the sRGB curve.
Image<std::uint8_t> FramePicture(const Image<float>& radiance, double exposure_s) {
  Image<std::uint8_t> picture(radiance.width(), radiance.height(), 3);
  const auto scale = static_cast<float>(exposure_s * 128.0 / 255.0);
  for (std::size_t i = 0; i < radiance.size(); ++i) {
    picture.data()[i] = EncodeSrgb(radiance.data()[i] * scale);
  }
  return picture;
}

std::vector<PositionId> Sampled(const std::vector<PositionId>& positions, int rows) {
  if (static_cast<int>(positions.size()) <= rows) return positions;
  std::vector<PositionId> sampled;
  for (int i = 0; i < rows; ++i) {
    const double at =
        static_cast<double>(i) * static_cast<double>(positions.size() - 1) / std::max(rows - 1, 1);
    sampled.push_back(positions[static_cast<std::size_t>(std::lround(at))]);
  }
  return sampled;
}

void Text(cv::Mat& sheet, const std::string& text, int x, int y, double size) {
  cv::putText(sheet, text, {x, y}, cv::FONT_HERSHEY_SIMPLEX, size, {225, 225, 225}, 1, cv::LINE_AA);
}

}  // namespace

Result<Image<std::uint8_t>> MakeContactSheet(const std::filesystem::path& session,
                                             const ContactSheetOptions& options) {
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  if (contents.info.camera.layout == Layout::kPerspective) {
    return Fail(ErrorKind::kData,
                "{}: layout: \"{}\", a contact sheet needs \"panorama\" or \"rig\"",
                (session / "session.json").string(), ToString(contents.info.camera.layout));
  }
  const std::filesystem::path views =
      options.evaluation.views.empty() ? session / "views" : options.evaluation.views;
  OMNIHDR_ASSIGN(const std::vector<PositionId> complete, CompleteViews(views));
  if (complete.empty()) return Fail(ErrorKind::kNoInput, "{}: no complete view", views.string());
  OMNIHDR_ASSIGN(const std::unique_ptr<Reference> reference,
                 OpenReference(session, contents, options.evaluation.photographs));
  OMNIHDR_ASSIGN(FrameMeasurer measurer,
                 OpenOwnFrames(session, contents.info, options.evaluation.mask));
  const std::vector<PositionId> positions = Sampled(complete, options.rows);

  const int width = options.cell_width;
  const int height = width / 2;
  std::vector<std::string> titles = {"input frame", "HDR view, tone-mapped",
                                     "disparity: near warm, far cool"};
  if (reference) titles.emplace_back("error: red too bright, blue too dark (2x)");
  std::vector<Row> rows;
  double nearest = 0.0;
  for (const PositionId position : positions) {
    OMNIHDR_ASSIGN(const ViewFiles view, ReadView(views, position));
    const auto frame = std::find_if(
        contents.journal.frames.begin(), contents.journal.frames.end(),
        [&](const FrameRecord& record) { return Value(record.frame) == view.record.reference; });
    if (frame == contents.journal.frames.end()) {
      return Fail(ErrorKind::kData, "{}: reference: {}, expected a frame of this session",
                  (views / ViewDirectoryName(position) / "view.json").string(),
                  view.record.reference);
    }
    const Projection output =
        Projection::Equirectangular(view.radiance.width(), view.radiance.height());
    OMNIHDR_ASSIGN(const Image<float> own,
                   OwnFrameRadiance(session, measurer, *frame, output, view.record.orientation));
    Row row;
    row.label = fmt::format("position {}   exposure {:.3g} s   {} frames", Value(position),
                            frame->exposure.EffectiveSeconds(), view.record.frames.size());
    row.cells.push_back(
        Shrunk(FramePicture(own, frame->exposure.EffectiveSeconds()), width, height));
    row.cells.push_back(
        Shrunk(ToneMap(view.radiance, {.shape = PictureShape::kSphere}), width, height));
    row.disparity = SampledDisparity(view.disparity, width, height);
    nearest = std::max(nearest, NearDisparity(row.disparity));
    row.cells.emplace_back();
    if (reference) {
      OMNIHDR_ASSIGN(Reference::Picture truth,
                     reference->Render(*frame, Projection::Equirectangular(width, height),
                                       view.record.orientation));
      LeaveOutUnseen(own, truth.radiance);
      row.cells.push_back(
          ErrorColours(ShrunkRadiance(view.radiance, width, height), truth.radiance, kErrorFull));
    }
    rows.push_back(std::move(row));
  }

  // One colour scale for all rows, so that near is the same colour everywhere.
  for (Row& row : rows) row.cells[kDisparityCell] = DisparityColours(row.disparity, nearest);

  const int columns = static_cast<int>(titles.size());
  Image<std::uint8_t> sheet(
      columns * (width + kGap) + kGap,
      kTitleHeight + static_cast<int>(rows.size()) * (height + kLabelHeight + kGap), 3, 32);
  cv::Mat canvas = Mat(sheet);
  for (int column = 0; column < columns; ++column) {
    Text(canvas, titles[static_cast<std::size_t>(column)], kGap + column * (width + kGap), 20,
         0.55);
  }
  int y = kTitleHeight;
  for (Row& row : rows) {
    Text(canvas, row.label, kGap, y + 15, 0.45);
    y += kLabelHeight;
    for (int column = 0; column < columns; ++column) {
      Mat(row.cells[static_cast<std::size_t>(column)])
          .copyTo(canvas(cv::Rect(kGap + column * (width + kGap), y, width, height)));
    }
    y += height + kGap;
  }
  return sheet;
}

}  // namespace omnihdr
