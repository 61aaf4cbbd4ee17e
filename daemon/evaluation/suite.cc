#include "daemon/evaluation/suite.h"

#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <memory>
#include <utility>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/pipeline/session_processor.h"
#include "core/quality/radiance_metrics.h"
#include "daemon/evaluation/contact_sheet.h"
#include "daemon/evaluation/rivals.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

constexpr std::array kScenes = {sim::SceneKind::kHall, sim::SceneKind::kYard,
                                sim::SceneKind::kTunnel, sim::SceneKind::kStreet};

SuiteCase MakeCase(sim::SceneKind scene, std::uint64_t seed, double stops, int width,
                   int positions) {
  SuiteCase made;
  made.simulate.simulation.scene = scene;
  made.simulate.simulation.seed = seed;
  made.simulate.simulation.projection = ProjectionKind::kCylindrical;
  made.simulate.simulation.width = width;
  made.simulate.simulation.motion.yaw_deg_per_m = 10.0;
  made.simulate.positions = positions;
  made.simulate.spacing_m = 0.3;
  made.simulate.bracket.step = Stops{stops};
  made.simulate.bracket.count = 3;
  made.simulate.created = "2026-01-01T00:00:00Z";
  made.name = fmt::format("{}-{:.1f}", sim::ToString(scene), stops);
  return made;
}

double CpuSeconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

Status Process(const fs::path& session, const fs::path& output, const PipelineOptions& options) {
  OMNIHDR_ASSIGN(const std::unique_ptr<SessionProcessor> processor,
                 SessionProcessor::Open(session, output, options, {}));
  while (true) {
    OMNIHDR_ASSIGN(const SessionProcessor::Progress progress, processor->Step());
    if (progress == SessionProcessor::Progress::kNothingNew) break;
  }
  return processor->Finish();
}

// What the product has to reach in this case. The scenes' limits on disparity, and 1.15 times the
// oracle's error, are set for the base case; anywhere else 1.25 times it.
std::vector<SuiteCheck> ChecksOf(const SuiteScore& score) {
  std::vector<SuiteCheck> checks;
  checks.push_back({"views made", static_cast<double>(score.ours.complete),
                    static_cast<double>(score.ours.positions.size()), true});
  if (!score.ours.mean || !score.oracle.mean) return checks;
  const SessionScore::Mean& mean = *score.ours.mean;
  checks.push_back({"error over oracle's", score.OracleRatio(), score.drive.is_base ? 1.15 : 1.25});
  if (score.drive.is_base) {
    double worst_ssim = 1.0;
    double worst_gain = 1.0;
    for (const PositionScore& p : score.ours.positions) {
      if (!p.view) continue;
      worst_ssim = std::min(worst_ssim, p.view->ssim);
      worst_gain = std::min(worst_gain, p.view->ssim - p.own_frame->ssim);
    }
    checks.push_back({"lowest SSIM", worst_ssim, 0.95, true});
    checks.push_back({"SSIM over own frame's", worst_gain, 0.01, true});
  }
  const sim::SceneKind scene = score.drive.simulate.simulation.scene;
  if (mean.disparity_bad1 && scene != sim::SceneKind::kStreet && score.drive.is_base) {
    const double must = scene == sim::SceneKind::kHall   ? 0.14
                        : scene == sim::SceneKind::kYard ? 0.12
                                                         : 0.07;
    checks.push_back({"disparity bad1", *mean.disparity_bad1, must});
  }
  if (mean.rotation_deg) checks.push_back({"rotation, deg", *mean.rotation_deg, 0.1});
  if (mean.translation_percent) {
    checks.push_back({"translation, %", *mean.translation_percent, 0.5});
  }
  checks.push_back({"range recovered", mean.range_share, 0.99, true});
  return checks;
}

}  // namespace

double MiddleExposure(const sim::Simulation& simulation) {
  const auto world = sim::World::Create(simulation.scene, simulation.seed);
  const sim::RenderedView view =
      world->Render(simulation.PoseAt(*world, 0.0), Projection::Equirectangular(128, 64), 1);
  Image<float> luminance = LuminanceOf(view.radiance);
  // All but the uppermost quarter of the rows counts: whoever exposes for a place does not for the
  // sky above it.
  const auto values = luminance.values();
  std::vector<float> sorted(values.begin() + static_cast<std::ptrdiff_t>(values.size() / 4),
                            values.end());
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  return 50.0 / 128.0 / std::max(static_cast<double>(*middle), 1e-6);
}

std::vector<SuiteCase> SuiteCases(SuiteKind kind) {
  std::vector<SuiteCase> cases;
  if (kind == SuiteKind::kQuick) {
    for (const sim::SceneKind scene : {sim::SceneKind::kHall, sim::SceneKind::kYard}) {
      cases.push_back(MakeCase(scene, 1, 1.6, 768, 5));
      cases.back().is_base = true;
    }
    return cases;
  }
  constexpr int kWidth = 1536;
  constexpr int kPositions = 6;
  for (const sim::SceneKind scene : kScenes) {
    SuiteCase base = MakeCase(scene, 1, 1.6, kWidth, kPositions);
    const std::string name = base.name;
    base.is_base = true;
    cases.push_back(base);
    const auto vary = [&](const char* how, const auto& change) {
      SuiteCase varied = base;
      varied.is_base = false;
      varied.name = fmt::format("{}-{}", name, how);
      change(varied.simulate);
      cases.push_back(std::move(varied));
    };
    cases.push_back(MakeCase(scene, 1, 0.8, kWidth, kPositions));
    cases.push_back(MakeCase(scene, 1, 3.0, kWidth, kPositions));
    cases.push_back(MakeCase(scene, 1, 3.0, kWidth, kPositions));
    cases.back().name += "-triangle";
    cases.back().simulate.bracket.order = BracketOrder::kTriangle;
    vary("triangle", [](auto& s) { s.bracket.order = BracketOrder::kTriangle; });
    vary("1m", [](auto& s) {
      s.spacing_m = 1.0;
      s.simulation.motion.yaw_deg_per_m = 3.0;
    });
    vary("turn10", [](auto& s) { s.simulation.motion.yaw_deg_per_m = 10.0 / s.spacing_m; });
    vary("turn60", [](auto& s) { s.simulation.motion.yaw_deg_per_m = 60.0 / s.spacing_m; });
    vary("sway", [](auto& s) { s.simulation.motion.sway_deg = 8.0; });
    vary("latlong", [](auto& s) { s.simulation.projection = ProjectionKind::kEquirectangular; });
    vary("rig", [](auto& s) { s.simulation.layout = Layout::kRig; });
    for (const std::uint64_t seed : {2, 3}) {
      cases.push_back(MakeCase(scene, seed, 1.6, kWidth, kPositions));
      cases.back().name += fmt::format("-seed{}", seed);
    }
  }
  return cases;
}

double SuiteScore::OracleRatio() const {
  return ours.mean && oracle.mean ? ours.mean->view_rmse / oracle.mean->view_rmse : 0.0;
}

Result<SuiteScore> RunSuiteCase(const SuiteCase& drive, const PipelineOptions& options,
                                const fs::path& directory) {
  const fs::path folder = directory / drive.name;
  const fs::path session = folder / "session";
  std::error_code error;
  if (fs::exists(folder, error)) {
    return Fail(ErrorKind::kUsage, "{}: already there, expected a new folder", folder.string());
  }
  fs::create_directories(folder, error);
  if (error) return Fail(ErrorKind::kIo, "{}: {}", folder.string(), error.message());
  SuiteScore score;
  score.drive = drive;
  sim::SimulateOptions& simulate = score.drive.simulate;
  simulate.bracket.start = ExposureTime::Seconds(MiddleExposure(simulate.simulation) *
                                                 std::exp2(-simulate.bracket.step.value));
  OMNIHDR_TRY(sim::WriteSimulatedSession(session, simulate, {}));
  const double cpu_before = CpuSeconds();
  const auto start = std::chrono::steady_clock::now();
  OMNIHDR_TRY(Process(session, session, options));
  score.cpu_s = (CpuSeconds() - cpu_before) / drive.simulate.positions;
  score.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() /
                 drive.simulate.positions;
  OMNIHDR_ASSIGN(score.ours, EvaluateSession(session, {}, {}));

  const auto judge = [&](const char* name) {
    EvaluationOptions evaluation;
    evaluation.views = folder / name / "views";
    return EvaluateSession(session, evaluation, {});
  };
  OMNIHDR_TRY(
      WriteRivalViews(session, Rival::kOracle, {}, options.output_width, folder / "oracle"));
  OMNIHDR_ASSIGN(score.oracle, judge("oracle"));
  OMNIHDR_TRY(WriteRivalViews(session, Rival::kUnregistered, {}, options.output_width,
                              folder / "unregistered"));
  OMNIHDR_ASSIGN(score.unregistered, judge("unregistered"));
  if (drive.simulate.simulation.layout != Layout::kRig) {  // hat weights know no mosaics
    PipelineOptions thesis = PipelineOptions::Thesis();
    thesis.output_width = options.output_width;
    thesis.stereo_width = options.stereo_width;
    thesis.labels = options.labels;
    OMNIHDR_TRY(Process(session, folder / "thesis", thesis));
    OMNIHDR_ASSIGN(score.thesis, judge("thesis"));
  }
  score.checks = ChecksOf(score);

  ContactSheetOptions sheet;
  OMNIHDR_ASSIGN(const Image<std::uint8_t> picture, MakeContactSheet(session, sheet));
  OMNIHDR_ASSIGN(const std::vector<std::byte> png, EncodePng(picture.view()));
  OMNIHDR_TRY(WriteFileAtomic(directory / (drive.name + ".png"), png));
  return score;
}

}  // namespace omnihdr
