#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "daemon/evaluation/experiments_bench.h"
#include "daemon/evaluation/experiments_report.h"

namespace omnihdr::experiments {

// The matrices of a run. Those an experiment asks for are there; of a person's session both are the
// same.
struct Benches {
  Bench* indoor = nullptr;
  Bench* outdoor = nullptr;
  // Each once.
  std::vector<Bench*> all() const;
};

// An experiment: fills the section's tables, notes and `found` (left empty when the matrix does not
// allow it, with a note that says why), writes its figures into `out`. Errors: files that cannot be
// read or written.
using RunExperiment = Status (*)(const Benches& benches, const std::filesystem::path& out,
                                 Section* section);

struct Experiment {
  const char* name;
  const char* title;
  const char* design;
  const char* thesis;
  bool needs_indoor;
  bool needs_outdoor;
  RunExperiment run;
};
// In the thesis's order.
const std::vector<Experiment>& AllExperiments();

Status RunCounts(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunFeatures(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunTemporalRange(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunWarp(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunStep(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunRange(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunBaseline(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunOrder(const Benches& benches, const std::filesystem::path& out, Section* section);
Status RunOutdoor(const Benches& benches, const std::filesystem::path& out, Section* section);

// The first `count` positions, or as many as there are, in an order of exposures.
Sequence DrawSequence(const Bench& bench, const Steps& steps, Order order, int count);

// What a section and its figures share.
Image<std::uint8_t> Shown(const MergedView& view);  // tone-mapped; no data is black
// The frame as its sensor had it: clipped is white.
Image<std::uint8_t> ShownFrame(const MergedView& alone, double exposure_s);
// "#7", with the number of an exposure in the matrix.
std::string Numbered(int exposure);
// "#2, #7, #12"
std::string Numbered(const std::vector<int>& exposures);

// How the views of a sequence compare, position by position.
struct JudgedView {
  int position = 0;
  int exposure = 0;
  ViewScore ours;
  std::optional<ViewScore> thesis_parts;
  ViewScore own;       // the position's own frame alone
  ViewScore temporal;  // the temporal HDR itself: only its numbers against the truth say something
};
Result<std::vector<JudgedView>> Judge(Bench& bench, const Sequence& sequence, const Steps& steps);
// A table of them with the thesis's SSIM beside, by position, and a last row with the means of the
// positions that have neighbours on both sides.
Table JudgedTable(const std::string& title, const std::vector<JudgedView>& judged,
                  const std::map<int, double>& thesis_ssim);
// Those means: SSIM, and the RMSE to the truth when there is one.
struct JudgedMean {
  double ours_ssim = 0.0;
  std::optional<double> thesis_parts_ssim;
  double own_ssim = 0.0;
  std::optional<double> ours_rmse;
  std::optional<double> thesis_parts_rmse;
  std::optional<double> own_rmse;
  std::optional<double> temporal_rmse;
};
JudgedMean MeanOf(const std::vector<JudgedView>& judged);
// Frames, temporal HDR, and what each method makes of the sequence, at some positions.
Status WriteJudgedPictures(Bench& bench, const Sequence& sequence, const Steps& steps,
                           const std::vector<int>& positions, const std::filesystem::path& file);

}  // namespace omnihdr::experiments
