#include "daemon/evaluation/experiments.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <system_error>
#include <utility>

#include "core/base/file.h"
#include "daemon/evaluation/experiments_parts.h"
#include "daemon/evaluation/suite.h"
#include "drivers/sim/simulation.h"

namespace omnihdr {
namespace experiments {
namespace {

constexpr int kExposures = 15;  // the thesis's #0 to #14
constexpr int kMiddle = kExposures / 2;
constexpr double kStepStops = 1.0 / 3;  // (3.2)
constexpr double kSpacing = 0.3;        // metres (6.1)
constexpr double kTurn = 10.0;          // degrees from one position to the next (6.5)

sim::SimulateOptions MatrixOptions(sim::SceneKind scene, const ExperimentOptions& options) {
  sim::SimulateOptions simulate;
  simulate.simulation.scene = scene;
  simulate.simulation.projection = ProjectionKind::kCylindrical;
  simulate.simulation.width = options.width;
  simulate.simulation.motion.yaw_deg_per_m = kTurn / kSpacing;
  simulate.positions = options.positions;
  simulate.spacing_m = kSpacing;
  simulate.bracket.step = Stops{kStepStops};
  simulate.bracket.count = kExposures;
  simulate.bracket.frames_per_position = kExposures;
  simulate.created = "2026-01-01T00:00:00Z";
  return simulate;
}

Result<std::unique_ptr<Bench>> OpenBench(const std::filesystem::path& session,
                                         const ExperimentOptions& options,
                                         const std::string& place) {
  OMNIHDR_ASSIGN(std::unique_ptr<DataMatrix> matrix, DataMatrix::Open(session, options.pipeline));
  return std::make_unique<Bench>(std::move(matrix), options.pipeline, place);
}

Result<std::unique_ptr<Bench>> SimulateBench(sim::SceneKind scene, const std::string& place,
                                             const ExperimentOptions& options,
                                             const std::filesystem::path& out,
                                             const std::function<void(const std::string&)>& tell) {
  const std::filesystem::path session = out / fmt::format("matrix-{}", sim::ToString(scene));
  std::error_code error;
  if (std::filesystem::exists(session, error)) {
    return Fail(ErrorKind::kUsage,
                "{}: already there, expected a new folder; --matrix {} runs on what is there",
                session.string(), session.string());
  }
  tell(
      fmt::format("{} matrix: {} positions of {} exposures", place, options.positions, kExposures));
  sim::SimulateOptions simulate = MatrixOptions(scene, options);
  simulate.bracket.start =
      ExposureTime::Seconds(MiddleExposure(simulate.simulation)) + Stops{-kStepStops * kMiddle};
  OMNIHDR_TRY(sim::WriteSimulatedSession(session, simulate, {}));
  return OpenBench(session, options, place);
}

MatrixNote NoteOf(const Bench& bench) {
  const DataMatrix& matrix = bench.matrix();
  MatrixNote note;
  note.place = bench.place();
  note.session = matrix.session().filename().string();
  if (matrix.reference() != nullptr) note.scene = matrix.reference()->name();
  note.positions = matrix.positions();
  for (int k = 0; k < matrix.exposures(); ++k) note.exposures_s.push_back(matrix.Seconds(k));
  note.middle = matrix.middle();
  return note;
}

Result<std::vector<const Experiment*>> Chosen(const std::vector<std::string>& names) {
  std::vector<const Experiment*> chosen;
  for (const Experiment& experiment : AllExperiments()) {
    if (names.empty() || std::find(names.begin(), names.end(), experiment.name) != names.end()) {
      chosen.push_back(&experiment);
    }
  }
  for (const std::string& name : names) {
    if (std::none_of(chosen.begin(), chosen.end(),
                     [&name](const Experiment* each) { return name == each->name; })) {
      return Fail(ErrorKind::kUsage, "--experiments: {}: no such experiment, expected all or of {}",
                  name, fmt::join(ExperimentNames(), ", "));
    }
  }
  return chosen;
}

}  // namespace

const std::vector<Experiment>& AllExperiments() {
  static const std::vector<Experiment> kAll = {
      {"counts", "Under- and over-exposed pixels",
       "Every frame of one position: pixels with a grey level below 5 and above 250.",
       "Indoors no pixel is under-exposed from #14 on and 0.014 % are over-exposed at the shortest "
       "time, #0; outdoors none is over-exposed at #0 and none under-exposed at #14 (tables 6.2 "
       "and "
       "6.4).",
       true, true, RunCounts},
      {"features", "Features and matches",
       "Features of the first three positions, and matches between them, at one exposure and at "
       "exposures two stops apart; then between two positions at every difference of exposures.",
       "Outdoors: fewer features in the short exposure and more in the long one; the number of "
       "matches falls a lot with the difference of exposures, but suffices for the poses (tables "
       "4.1 and 4.2).",
       true, true, RunFeatures},
      {"temporal-range", "Temporal HDR: exposure range",
       "All exposures of one position, then ever fewer about the middle, merged; SSIM to the "
       "widest.",
       "The dynamic range falls with the exposure range (#0 to #14, #2 to #12, #4 to #8), the SSIM "
       "to the widest stays about 0.98: bright points are few (6.2).",
       true, true, RunTemporalRange},
      {"warp", "Warping method",
       "#2, #7 and #12 at positions 0, 1 and 2: the frames of positions 0 and 2 warped to position "
       "1, by their own disparity (forward) or by the target's (backward), then merged with the "
       "own frame.",
       "Forward leaves many pixels without a value; backward is much smoother. In the HDR the "
       "difference is slight: most artefacts vanish in the merge (figs. 6.5 to 6.7).",
       true, false, RunWarp},
      {"step", "Step size",
       "Short, medium and long exposure repeated in a saw tooth over six positions, a small and a "
       "large step apart; every view against the temporal HDR of the same three exposures.",
       "0.8 stops (#5, #7, #9): SSIM 0.86, 0.86, 0.87 at positions 1 to 3. 1.6 stops (#2, #7, "
       "#12): "
       "0.83, 0.80 at positions 1 and 2 (6.3.2).",
       true, false, RunStep},
      {"range", "Radiance range",
       "Radiance measured (neither clipped nor dark) in single frames, in the spatiotemporal HDR "
       "and in the temporal HDR of the step-size sequences, where the position's own camera sees.",
       "The spatiotemporal HDR recovers about the range of the temporal one, and a larger one with "
       "the larger step (tables 6.5 and 6.6).",
       true, false, RunRange},
      {"baseline", "Baseline",
       "The sequence of 1.6 stops; disparity from the next positions with their other exposures, "
       "or from the position three further on with the same exposure; pixels from the next ones "
       "in both cases.",
       "A slight further reduction of the SSIM; fattening at the edges of lamps (fig. 6.14).", true,
       false, RunBaseline},
      {"order", "Order of exposures",
       "Poses from the images alone, of sequences in a saw tooth (short, medium, long, short, …) "
       "and "
       "in a triangle (short, medium, long, medium, …), against those of one exposure at every "
       "position; the first two frames are the same in all and set the unit of length, as in the "
       "thesis.",
       "No significant error of rotation; errors of distance below 5 %, with no sum along the way "
       "(tables 6.7 to 6.9).",
       true, true, RunOrder},
      {"outdoor", "Outdoor scene, and methods without disparity",
       "#2, #7, #12, #7 repeated over eight positions: a triangle of 1.6 stops.",
       "SSIM 0.87, 0.91, 0.89 at positions 4 to 6. Hu et al. 2013 0.88, 0.99, 0.92 and Sen et al. "
       "2012 0.79, 0.99, 0.87, depending on the reference frame (6.3.5, 6.4).",
       false, true, RunOutdoor},
  };
  return kAll;
}

}  // namespace experiments

Status ExperimentOptions::Validate() const {
  if (positions < 3 || positions > 100) {
    return Fail(ErrorKind::kUsage, "positions: {}, expected 3 to 100", positions);
  }
  if (width < 128 || width > 8192 || width % 2 != 0) {
    return Fail(ErrorKind::kUsage, "--width: {}, expected an even number of 128 to 8192", width);
  }
  return pipeline.Validate();
}

std::vector<std::string> ExperimentNames() {
  std::vector<std::string> names;
  for (const experiments::Experiment& experiment : experiments::AllExperiments()) {
    names.emplace_back(experiment.name);
  }
  return names;
}

Result<ExperimentReport> RunExperiments(const ExperimentOptions& options,
                                        const std::filesystem::path& out,
                                        const std::function<void(const std::string&)>& progress) {
  namespace parts = experiments;
  OMNIHDR_TRY(options.Validate());
  OMNIHDR_ASSIGN(const std::vector<const parts::Experiment*> chosen, parts::Chosen(options.names));
  const auto tell = [&progress](const std::string& what) {
    if (progress) progress(what);
  };
  std::error_code error;
  std::filesystem::create_directories(out, error);
  if (error) return Fail(ErrorKind::kCannotCreate, "{}: {}", out.string(), error.message());

  std::unique_ptr<parts::Bench> indoor;
  std::unique_ptr<parts::Bench> outdoor;
  parts::Benches benches;
  if (!options.matrix.empty()) {
    const std::filesystem::path folder =
        options.matrix.filename().empty() ? options.matrix.parent_path() : options.matrix;
    OMNIHDR_ASSIGN(indoor, parts::OpenBench(folder, options, folder.filename().string()));
    benches = {indoor.get(), indoor.get()};
  } else {
    const auto needed = [&chosen](bool parts::Experiment::*place) {
      return std::any_of(chosen.begin(), chosen.end(),
                         [place](const parts::Experiment* each) { return each->*place; });
    };
    if (needed(&parts::Experiment::needs_indoor)) {
      OMNIHDR_ASSIGN(indoor,
                     parts::SimulateBench(sim::SceneKind::kHall, "indoor", options, out, tell));
    }
    if (needed(&parts::Experiment::needs_outdoor)) {
      OMNIHDR_ASSIGN(outdoor,
                     parts::SimulateBench(sim::SceneKind::kYard, "outdoor", options, out, tell));
    }
    benches = {indoor.get(), outdoor.get()};
  }
  std::vector<parts::MatrixNote> matrices;
  for (const parts::Bench* bench : benches.all()) matrices.push_back(parts::NoteOf(*bench));

  ExperimentReport report;
  std::vector<parts::Section> sections;
  for (const parts::Experiment* experiment : chosen) {
    tell(fmt::format("{} ({} of {})", experiment->name, sections.size() + 1, chosen.size()));
    parts::Section section;
    section.name = experiment->name;
    section.title = experiment->title;
    section.design = experiment->design;
    section.thesis = experiment->thesis;
    // An experiment that wants one place gets no other.
    const parts::Benches wanted = {experiment->needs_indoor ? benches.indoor : nullptr,
                                   experiment->needs_outdoor ? benches.outdoor : nullptr};
    OMNIHDR_TRY(experiment->run(wanted, out, &section).Context(experiment->name));
    sections.push_back(std::move(section));
    // After each: minutes of work are not lost with the last.
    report.markdown = parts::FormatMarkdown(matrices, sections);
    report.json = parts::FormatJson(matrices, sections);
    OMNIHDR_TRY(WriteFileAtomic(out / "experiments.md", report.markdown));
    OMNIHDR_TRY(WriteFileAtomic(out / "experiments.json", report.json));
  }
  report.summary = parts::FormatSummary(sections);
  return report;
}

}  // namespace omnihdr
