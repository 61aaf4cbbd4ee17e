#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "core/base/units.h"
#include "core/photometry/exposure_refine.h"
#include "core/photometry/exposure_report.h"

namespace omnihdr {

// One exposure of a place: a line of the thesis's tables 6.2 and 6.4.
struct ExposureRow {
  std::string name;  // of the frame or file
  Exposure exposure;
  ExposureCount count;
  RefinedExposure refined;
  RadianceRange range;      // of what this exposure alone measures
  RadianceRange recovered;  // of the view made at its position; 0 pixels = not known
};
struct ExposureSummary {
  std::string title;
  std::vector<ExposureRow> lines;  // shortest first
  RadianceRange merged;            // 0 pixels = not known
  double clipped_percent = 0.0;    // of the merged pixels: saturated in every exposure
  double dark_percent = 0.0;       // below the usable range in every exposure
};

std::string TextOf(const ExposureSummary& summary);
// One JSON object.
std::string JsonOf(const ExposureSummary& summary);

// A bracket of one place, with the exposures corrected where their overlap says so.
struct MergedBracket {
  Measurement measurement;
  ExposureSummary summary;         // shortest exposure first
  std::vector<std::string> notes;  // what the user should know about the labels
};
// How frames of one place become a measurement: Measure, or a FrameMeasurer's for a rig.
using MeasureFrames = std::function<Result<Measurement>(std::span<const ExposedFrame>)>;
// `refine_limit`: the largest correction, 0 = take the labels as they are. `names`: of the frames.
// `mask`: of the frames, for counting and refining. `with_ranges`: measure every exposure alone as
// well. Errors: as `measure` and RefineExposures.
Result<MergedBracket> MergeBracket(std::vector<ExposedFrame> frames,
                                   const std::vector<std::string>& names,
                                   const MeasureFrames& measure, const Response& response, int bits,
                                   ImageView<const std::uint8_t> mask,
                                   const MeasureOptions& options, double refine_limit,
                                   bool with_ranges);
// Range of what a measurement measured.
RadianceRange RangeOf(const Measurement& measurement);
}  // namespace omnihdr
