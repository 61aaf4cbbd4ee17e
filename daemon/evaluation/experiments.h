#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/pipeline/options.h"

namespace omnihdr {

// The experiments of the thesis's chapter 6 (and of 4.3, features), run again by this program on
// data matrices - the same exposures at every position - from which temporal and spatiotemporal
// sequences are drawn as the thesis does.
struct ExperimentOptions {
  // Names as ExperimentNames has them; empty = all.
  std::vector<std::string> names;
  // A session to draw from, for every experiment; empty = simulated ones, made in the output
  // folder: an indoor and an outdoor one of the thesis's shape (15 exposures a third of a stop
  // apart, 30 cm and ten degrees from one position to the next).
  std::filesystem::path matrix;
  int width = 1024;   // of the simulated panoramas
  int positions = 8;  // of the simulated matrices
  // How views are made (`ours`); orientation and output width are set by the experiments.
  PipelineOptions pipeline;
  Status Validate() const;
};

std::vector<std::string> ExperimentNames();

struct ExperimentReport {
  std::string markdown;
  std::string json;
  std::string summary;  // a line an experiment, for the terminal
};

// Runs them and writes OUT/experiments.md and OUT/experiments.json with their plots and pictures
// beside, and the simulated matrices as OUT/matrix-hall and OUT/matrix-yard. `progress` hears what
// begins. What a matrix does not allow (steps it has not, truth that is not known) is said in the
// report. Equal inputs give equal reports. Errors: an unknown name (kUsage), a matrix that is none
// (kData), simulated matrices that are already there, files that cannot be read or written.
Result<ExperimentReport> RunExperiments(const ExperimentOptions& options,
                                        const std::filesystem::path& out,
                                        const std::function<void(const std::string&)>& progress);

}  // namespace omnihdr
