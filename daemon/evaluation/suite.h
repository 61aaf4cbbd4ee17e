#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/pipeline/options.h"
#include "daemon/evaluation/evaluation.h"
#include "drivers/sim/simulation.h"

namespace omnihdr {

// A simulated drive whose views are judged.
struct SuiteCase {
  std::string name;               // "hall-1.6-triangle": also its folder's name
  sim::SimulateOptions simulate;  // RunSuiteCase sets the bracket's start by the scene's light
  // The case the strictest targets are set for: 1.6 stops, saw-tooth, 0.3 m, as the scene's first
  // seed has it.
  bool is_base = false;
};

// Which drives there are. kQuick: two scenes, small pictures, minutes. kTargets: every scene at its
// base case and with one thing changed at a time: the step (0.8, 3.0 stops), the order (triangle),
// the baseline (1.0 m), the turning (10, 60 degrees a position), the swaying, the projection, raw
// frames of a rig, other seeds.
enum class SuiteKind { kQuick, kTargets };
std::vector<SuiteCase> SuiteCases(SuiteKind kind);

// The exposure, in seconds, at which the scene's median luminance reads value 50: at 1.6 stops to
// either side the shortest frame shows lamps and sky, the longest the shadows.
double MiddleExposure(const sim::Simulation& simulation);

// A number that has to be reached.
struct SuiteCheck {
  std::string what;
  double value = 0.0;
  double must = 0.0;
  bool at_least = false;  // else: at most
  bool met() const { return at_least ? value >= must : value <= must; }
};

struct SuiteScore {
  SuiteCase drive;
  SessionScore ours;
  SessionScore oracle;        // true poses and disparity
  SessionScore unregistered;  // averaged along equal directions
  SessionScore thesis;        // the thesis's parts in our pipeline
  double cpu_s = 0.0;         // of ours, a view, all threads
  double wall_s = 0.0;
  std::vector<SuiteCheck> checks;
  // Of the means: how far our error is from the oracle's.
  double OracleRatio() const;
};

// Simulates, processes and judges one case in DIRECTORY/NAME: session, views and those of the
// rivals, and a contact sheet DIRECTORY/NAME.png. A folder that is already there is an error: a
// suite judges what it made itself. Errors: files that cannot be written; whatever a part refuses.
Result<SuiteScore> RunSuiteCase(const SuiteCase& drive, const PipelineOptions& options,
                                const std::filesystem::path& directory);

// Of all cases' disparities together.
ReliabilityCurve ReliabilityOf(const std::vector<SuiteScore>& scores);

// One line a case: our error beside the oracle's, the thesis's, the own frame's and no
// registration; disparity; poses; time; what was missed.
std::string FormatSuiteTable(const std::vector<SuiteScore>& scores);
// The same with every number, as Markdown, pictures linked.
std::string FormatSuiteMarkdown(const std::vector<SuiteScore>& scores);
std::string FormatSuiteJson(const std::vector<SuiteScore>& scores);

}  // namespace omnihdr
